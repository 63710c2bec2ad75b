//! Passes over lists: every fragment is counted, then stored where there is exactly as much room, then sorted.

mod band;

use super::device::Connection;
use super::draw::{Gpu, Image, Stop, group};
use super::form::{Form, Sorting};
use super::picture::{Given, Picture, RANK, buffer, bytes_of};
use super::recorder::{Recorder, Stage, read};
use crate::error::{Error, Result};
pub(super) use band::{Band, Origin, raster_into};
use std::ops::Range;
use wgpu::{BindGroup, Buffer, BufferUsages};

/// Bytes of a fragment's colour, the larger part of what is kept of it.
const COLOR: u64 = 16;
/// Bytes of its depth and primitive.
const KEY: u64 = 8;
/// Bytes of a pixel's number of fragments.
const COUNT: u64 = 4;

/// The buffers of lists, by their bindings.
pub(super) struct ListBuffers {
    pub group: BindGroup,
    counts: Buffer,
    places: Buffer,
    row_sums: Buffer,
    row_places: Buffer,
    keys: Buffer,
    colors: Buffer,
}

impl Gpu {
    /// Counts the fragments of each pixel and row.
    ///
    /// # Errors
    /// As [`Gpu::image`].
    pub fn count(&mut self, picture: &mut Picture, stop: Stop<'_>) -> Result<()> {
        let most = self.rows_of_counts(picture).min(picture.height);
        let lists = self.lists(picture, most, 0, None);
        let mut sums = Vec::new();
        for first in (0..picture.height).step_by(most as usize) {
            let rows = first..(first + most).min(picture.height);
            let frame = self.frame(picture, &rows, &[]);
            let mut band = self.band(picture, &frame, &lists, &rows, |on| Recorder::new(on, stop));
            band.count(Origin::Raster)?;
            sums = band.recorder.finish(&lists.row_sums, 8 * u64::from(picture.height))?.0;
        }
        picture.rows = sums;
        Ok(())
    }

    /// Lists of some rows whose passes `recorder` times.
    pub(super) fn band<'a>(
        &'a mut self,
        picture: &'a Picture,
        frame: &'a BindGroup,
        lists: &'a ListBuffers,
        rows: &'a Range<u32>,
        recorder: impl FnOnce(&'a Connection) -> Recorder<'a>,
    ) -> Band<'a> {
        let Self { connection, layouts, .. } = self;
        Band { recorder: recorder(connection), connection, layouts, picture, frame, lists, rows }
    }

    /// Room for so many rows and fragments.
    fn lists(&self, picture: &Picture, rows: u32, fragments: u64, ranks: Option<&Buffer>) -> ListBuffers {
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC;
        let storage = |label, bytes| buffer(&self.connection, label, bytes, usage);
        let pixels = u64::from(picture.width) * u64::from(rows);
        let (counts, places) = (storage("counts", COUNT * pixels), storage("places", 4 * pixels));
        let all_rows = u64::from(picture.height);
        let (row_sums, row_places) = (storage("row sums", 8 * all_rows), storage("row places", 4 * all_rows));
        let (keys, colors) = (storage("keys", KEY * fragments), storage("colors", COLOR * fragments));
        let no_ranks = storage("no ranks", RANK);
        let ranks = ranks.unwrap_or(&no_ranks);
        let all = [&counts, &places, &row_sums, &row_places, &keys, &colors, ranks];
        let group = group(&self.connection, &self.layouts.lists, &all.map(Buffer::as_entire_binding));
        ListBuffers { group, counts, places, row_sums, row_places, keys, colors }
    }

    /// Lists of all fragments, in as many parts of the image as their number asks for.
    pub(super) fn listed(
        &mut self,
        picture: &Picture,
        form: &Form,
        is_linked: bool,
        stop: Stop<'_>,
    ) -> Result<Image> {
        let Some(reader) = form.list_reader() else { unreachable!("it is made of lists") };
        let all_rows = 0..picture.height;
        let bands = self.bands_of_fragments(picture, &all_rows, 1, self.rows_per_band(picture, form))?;
        let by_rank = form.capacity().map(|capacity| capacity.sorted).into_iter().chain([reader.sorted]);
        let is_ranked = picture.given.is_none() && by_rank.into_iter().any(|sorted| sorted == Sorting::Rank);
        let ranks = if is_ranked { Some(picture.ranks(&self.connection)?) } else { None };
        let lists = self.lists_for(picture, &bands, ranks);
        let params: Vec<_> = form.numbers.iter().map(|number| number.bits()).collect();
        let module = form.module();
        let mut image = Image::default();
        for rows in &bands {
            let frame = self.frame(picture, rows, &params);
            let mut pool = None;
            if is_linked && picture.given.is_none() {
                let (linked, times) = self.link(picture, &frame, rows, stop)?;
                image.times = image.times.plus(times);
                pool = Some(linked);
            }
            let recorder = if pool.is_some() { Recorder::of_compute } else { Recorder::new };
            let mut band = self.band(picture, &frame, &lists, rows, |on| recorder(on, stop));
            if let Some(given) = &picture.given {
                lists.fill(band.connection, given, picture, rows); // in the order that is asked for
            } else {
                let origin = pool.as_ref().map_or(Origin::Raster, Origin::Linked);
                band.fill(origin, is_ranked)?;
                band.keep_first(form.capacity())?;
                band.sort(reader.sorted)?;
                if is_ranked {
                    band.step(Stage::Resolve, "restore_ids", &[])?;
                }
            }
            band.resolve(form, &module, &reader, &mut image)?;
            self.kept.keep_pool(pool);
        }
        Ok(image)
    }

    /// Keeps and reads back every fragment.
    ///
    /// # Errors
    /// As [`Gpu::image`].
    pub fn capture(&mut self, picture: &Picture, stop: Stop<'_>) -> Result<Given> {
        let bands =
            self.bands_of_fragments(picture, &(0..picture.height), 1, self.rows_of_counts(picture))?;
        let lists = self.lists_for(picture, &bands, None);
        let mut captured = Given::default();
        for rows in &bands {
            let frame = self.frame(picture, rows, &[]);
            let mut band = self.band(picture, &frame, &lists, rows, |on| Recorder::new(on, stop));
            band.fill(Origin::Raster, false)?;
            band.sort(Sorting::Submission)?;
            let fragments = fragments_of(picture, rows);
            let pixels = u64::from(picture.width) * u64::from(rows.end - rows.start);
            let sources = [
                (&lists.keys, KEY * fragments),
                (&lists.colors, COLOR * fragments),
                (&lists.counts, COUNT * pixels),
            ];
            let (landed, _) = band.recorder.finish_all(&sources)?;
            captured.keys.extend(read::<[u32; 2]>(&landed[0], KEY * fragments)?);
            captured.colors.extend(read::<[f32; 4]>(&landed[1], COLOR * fragments)?);
            captured.counts.extend(read::<u32>(&landed[2], COUNT * pixels)?);
        }
        if captured.counts.iter().any(|count| count >> 31 == 1) {
            return Err(self.connection.cut_short());
        }
        Ok(captured)
    }

    /// Room for the fullest band and the tallest one, and where each row's fragments go.
    pub(super) fn lists_for(
        &self,
        picture: &Picture,
        bands: &[Range<u32>],
        ranks: Option<&Buffer>,
    ) -> ListBuffers {
        let most = bands.iter().map(|band| fragments_of(picture, band)).max().unwrap_or(0);
        let rows = bands.iter().map(|band| band.end - band.start).max().unwrap_or(0);
        let lists = self.lists(picture, rows, most, ranks);
        self.connection.queue.write_buffer(&lists.row_places, 0, bytes_of(&row_places(picture, bands)));
        lists
    }

    /// As many rows as a buffer holds the counts of.
    fn rows_of_counts(&self, picture: &Picture) -> u32 {
        let row = COUNT * u64::from(picture.width);
        u32::try_from(self.most_bytes() / row).unwrap_or(u32::MAX).max(1)
    }

    /// At most so many rows of a part of the image at a time, by whole `unit`s from its first one on; their fragments have to fit,
    /// too.
    pub(super) fn bands_of_fragments(
        &self,
        picture: &Picture,
        part: &Range<u32>,
        unit: u32,
        most_rows: u32,
    ) -> Result<Vec<Range<u32>>> {
        let most = self.most_bytes() / COLOR;
        let (mut bands, mut band, mut sum) = (Vec::new(), part.start..part.start, 0);
        for row in part.clone().step_by(unit as usize) {
            let rows = row..(row + unit).min(part.end);
            let fragments = fragments_of(picture, &rows);
            if fragments > most {
                let (these, instead) = if unit == 1 {
                    (format!("row {row}"), "")
                } else {
                    (
                        format!("rows {row} to {}", rows.end - 1),
                        ", and for path=\"hardware\" one row has to fit",
                    )
                };
                return Err(Error::Memory(format!(
                    "the {fragments} fragments of {these}; {} keeps {most} at a time: a smaller image has fewer in a row{instead}",
                    self.connection.info.name
                )));
            }
            if band.end > band.start && (sum + fragments > most || rows.end - band.start > most_rows) {
                bands.push(std::mem::replace(&mut band, row..row));
                sum = 0;
            }
            (band.end, sum) = (rows.end, sum + fragments);
        }
        bands.push(band);
        Ok(bands)
    }
}

/// Where the first fragment of each row of the bands goes.
fn row_places(picture: &Picture, bands: &[Range<u32>]) -> Vec<u32> {
    let mut places = vec![0; picture.rows.len()];
    for band in bands {
        let mut next = 0;
        let rows = band.start as usize..band.end as usize;
        for (place, row) in places[rows.clone()].iter_mut().zip(&picture.rows[rows]) {
            *place = next;
            next += row[0];
        }
    }
    places
}

/// Fragments of some rows.
fn fragments_of(picture: &Picture, rows: &Range<u32>) -> u64 {
    picture.rows[rows.start as usize..rows.end as usize].iter().map(|row| u64::from(row[0])).sum()
}

impl ListBuffers {
    /// Takes fragments that are there already to the device, those of some rows.
    #[expect(clippy::cast_possible_truncation, reason = "what a buffer holds is counted in 32 bits")]
    fn fill(&self, connection: &Connection, given: &Given, picture: &Picture, rows: &Range<u32>) {
        let first = fragments_of(picture, &(0..rows.start)) as usize;
        let these = first..first + fragments_of(picture, rows) as usize;
        let width = picture.width as usize;
        let counts = &given.counts[rows.start as usize * width..rows.end as usize * width];
        let mut end = 0;
        let ends = counts.iter().map(|count| {
            end += count;
            end
        });
        let ends: Vec<u32> = ends.collect();
        connection.queue.write_buffer(&self.counts, 0, bytes_of(counts));
        connection.queue.write_buffer(&self.places, 0, bytes_of(&ends));
        connection.queue.write_buffer(&self.keys, 0, bytes_of(&given.keys[these.clone()]));
        connection.queue.write_buffer(&self.colors, 0, bytes_of(&given.colors[these]));
    }
}
