//! Passes over lists: every fragment is counted, then stored where there is exactly as much room, then sorted.

use super::device::Connection;
use super::draw::{Gpu, Image, Stop, attachment, dispatch, draw_primitives, group, resolve};
use super::draws::flag;
use super::form::{Capacity, Form, ListReader, Sorting, list_module};
use super::layouts::{Entry, Layouts, Reads, plain};
use super::linked::Pool;
use super::picture::{Given, Picture, RANK, buffer, bytes_of, texture};
use super::recorder::{Recorder, Stage, Times, read};
use super::tiles::TiledRows;
use crate::error::{Error, Result};
use std::ops::Range;
use std::sync::Arc;
use wgpu::{
    BindGroup, BindGroupLayout, Buffer, BufferUsages, Color, ColorWrites, ComputePipeline, LoadOp, StoreOp,
    TextureFormat, TextureUsages, TextureViewDescriptor,
};

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

/// Lists of some rows on their way through the device.
pub(super) struct Band<'a> {
    pub connection: &'a Connection,
    pub layouts: &'a mut Layouts,
    pub recorder: Recorder<'a>,
    pub picture: &'a Picture,
    pub frame: &'a BindGroup,
    pub lists: &'a ListBuffers,
    pub rows: &'a Range<u32>,
}

/// Where the fragments of a band come from.
#[derive(Clone, Copy)]
pub(super) enum Origin<'a> {
    /// The device's own raster, which counts them before it stores them.
    Raster,
    /// Linked lists, into which they have been drawn.
    Linked(&'a Pool),
    /// Tiles, in the order in which they are drawn.
    Tiles(&'a TiledRows<'a>),
}

/// What becomes of fragments, with the entry point of the device's own raster.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Filling {
    Counts,
    Lists,
    /// With the places of ranks for ids.
    RankedLists,
}

impl Filling {
    fn point(self) -> &'static str {
        match self {
            Self::Counts => "count_fragment",
            Self::Lists => "store_fragment",
            Self::RankedLists => "store_ranked_fragment",
        }
    }
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
            let mut band = self.band(picture, &frame, &lists, &rows, stop);
            band.count(Origin::Raster)?;
            sums = band.recorder.finish(&lists.row_sums, 8 * u64::from(picture.height))?.0;
        }
        picture.rows = sums;
        Ok(())
    }

    pub(super) fn band<'a>(
        &'a mut self,
        picture: &'a Picture,
        frame: &'a BindGroup,
        lists: &'a ListBuffers,
        rows: &'a Range<u32>,
        stop: Stop<'a>,
    ) -> Band<'a> {
        let Self { connection, layouts, .. } = self;
        let recorder = Recorder::new(connection, stop);
        Band { connection, layouts, recorder, picture, frame, lists, rows }
    }

    /// The same where all that follows are compute passes.
    pub(super) fn band_of_compute<'a>(
        &'a mut self,
        picture: &'a Picture,
        frame: &'a BindGroup,
        lists: &'a ListBuffers,
        rows: &'a Range<u32>,
        stop: Stop<'a>,
    ) -> Band<'a> {
        let Self { connection, layouts, .. } = self;
        let recorder = Recorder::of_compute(connection, stop);
        Band { connection, layouts, recorder, picture, frame, lists, rows }
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
            let mut band = if pool.is_some() {
                self.band_of_compute(picture, &frame, &lists, rows, stop)
            } else {
                self.band(picture, &frame, &lists, rows, stop)
            };
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
            let mut band = self.band(picture, &frame, &lists, rows, stop);
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

impl<'a> Band<'a> {
    /// How many fragments each pixel and each row has, and where in its row each pixel's go.
    fn count(&mut self, origin: Origin<'_>) -> Result<()> {
        self.recorder.clear(&self.lists.counts);
        self.hand_over(origin, Filling::Counts)?;
        let pipeline = self.kernel("sum_rows", &[]);
        let Self { recorder, frame, lists, rows, .. } = self;
        recorder.compute(Stage::Raster, |pass| {
            pass.set_pipeline(&pipeline);
            pass.set_bind_group(0, *frame, &[]);
            pass.set_bind_group(2, &lists.group, &[]);
            pass.dispatch_workgroups(rows.end - rows.start, 1, 1);
        })
    }

    /// Stores the fragments, with the places of ranks for ids if lists are ranked. They are counted once more than their number
    /// is asked for, so that the time is that of a frame.
    ///
    /// # Errors
    /// As [`Recorder::compute`].
    pub(super) fn fill(&mut self, origin: Origin<'_>, is_ranked: bool) -> Result<()> {
        self.count(origin)?;
        self.step(Stage::Raster, "shift_rows", &[])?;
        self.hand_over(origin, if is_ranked { Filling::RankedLists } else { Filling::Lists })
    }

    /// Refuses rows of other numbers of fragments than the device's own raster has found, which there is room for. What has been
    /// recorded is done by then; the time that it took.
    ///
    /// # Errors
    /// [`Error::Gpu`] naming the row, and as [`Recorder::finish`].
    pub(super) fn check_counts(&mut self, stop: Stop<'a>) -> Result<Times> {
        let Self { connection, recorder, picture, lists, rows, .. } = self;
        let recorded = std::mem::replace(recorder, Recorder::of_compute(connection, stop));
        let (sums, times) = recorded.finish::<[u32; 2]>(&lists.row_sums, 8 * u64::from(picture.height))?;
        let both = sums.iter().zip(&picture.rows).zip(0..);
        let here = both.filter(|(_, row)| rows.contains(row));
        for (([found, _], [counted, _]), row) in here {
            if found != counted && found >> 31 == 0 {
                return Err(Error::Gpu(format!(
                    "tiles have {found} fragments in row {row}, and the raster of {} {counted}; path=\"hardware\" uses that alone",
                    connection.info.name
                )));
            }
        }
        Ok(times)
    }

    /// Sorts every list.
    ///
    /// # Errors
    /// As [`Recorder::compute`].
    pub(super) fn sort(&mut self, sorting: Sorting) -> Result<()> {
        let sorting = match sorting {
            Sorting::Depth => 0.0,
            Sorting::Submission => 1.0,
            Sorting::Rank => 2.0,
        };
        self.step(Stage::Resolve, "sort_lists", &[("sorting", sorting)])
    }

    /// Leaves as many fragments of each list as there may be, the first ones.
    ///
    /// # Errors
    /// As [`Recorder::compute`].
    pub(super) fn keep_first(&mut self, capacity: Option<Capacity>) -> Result<()> {
        let Some(capacity) = capacity else { return Ok(()) };
        self.sort(capacity.sorted)?;
        let constants =
            [("list_capacity", capacity.fragments.into()), ("drops_backwards", flag(capacity.backwards))];
        self.step(Stage::Resolve, "drop_fragments", &constants)
    }

    /// Something that is done to every list.
    fn step(&mut self, stage: Stage, point: &str, constants: &[(&str, f64)]) -> Result<()> {
        let pipeline = self.kernel(point, constants);
        let groups = [self.frame, &self.lists.group];
        dispatch(&mut self.recorder, stage, &pipeline, &groups, self.picture, self.rows)
    }

    fn kernel(&mut self, point: &str, constants: &[(&str, f64)]) -> Arc<ComputePipeline> {
        let entry = Entry { module: &list_module(), point };
        self.layouts.compute(&self.connection.device, entry, Reads::Lists, false, constants)
    }

    /// Counts the fragments, or stores them.
    fn hand_over(&mut self, origin: Origin<'_>, filling: Filling) -> Result<()> {
        let counts = filling == Filling::Counts;
        match origin {
            Origin::Linked(pool) => {
                let point = if counts { "count_nodes" } else { "unlink" };
                self.unlink(pool, point, filling == Filling::RankedLists)
            }
            Origin::Tiles(tiles) => {
                let Self { connection, layouts, recorder, picture, frame, lists, rows } = self;
                let extent = (picture.width, rows.end - rows.start);
                tiles.raster((connection, layouts), recorder, frame, &lists.group, (extent, !counts))
            }
            Origin::Raster => {
                let Self { connection, layouts, recorder, picture, frame, lists, rows } = self;
                let entry = Entry { module: &list_module(), point: filling.point() };
                let (layout, at) = (layouts.lists.clone(), (*frame, *rows));
                raster_into((connection, layouts), recorder, picture, at, entry, (&layout, &lists.group))
            }
        }
    }

    /// Makes the image of the lists.
    ///
    /// # Errors
    /// As [`Gpu::image`].
    pub(super) fn resolve(
        self,
        form: &Form,
        module: &str,
        reader: &ListReader,
        image: &mut Image,
    ) -> Result<()> {
        let Self { connection, layouts, recorder, picture, frame, lists, rows } = self;
        let constants: Vec<_> = picture.knowledge().iter().chain(&reader.constants).copied().collect();
        let entry = Entry { module, point: reader.point };
        let pipeline = layouts.compute(&connection.device, entry, Reads::Lists, true, &constants);
        let groups = [frame, &lists.group];
        resolve(connection, layouts, recorder, picture, form, rows, &pipeline, groups, image)
    }
}

/// Draws all fragments of some rows into buffers, which are group 2. A pass wants a target, which nothing is drawn into.
pub(super) fn raster_into(
    (connection, layouts): (&Connection, &mut Layouts),
    recorder: &mut Recorder<'_>,
    picture: &Picture,
    (frame, rows): (&BindGroup, &Range<u32>),
    entry: Entry<'_>,
    (layout, buffers): (&BindGroupLayout, &BindGroup),
) -> Result<()> {
    let format = TextureFormat::R8Unorm;
    let size = (picture.width, rows.end - rows.start);
    let unused = texture(connection, "none", size, format, TextureUsages::RENDER_ATTACHMENT);
    let unused = unused.create_view(&TextureViewDescriptor::default());
    let states = [plain(format, ColorWrites::empty())];
    let draws = picture.draws(true);
    let pipeline = layouts.render_with(&connection.device, entry, draws, &states, Some(layout), None);
    let target = attachment(&unused, LoadOp::Clear(Color::TRANSPARENT), StoreOp::Discard);
    recorder.render(Stage::Raster, &[target], |pass| {
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, frame, &[]);
        pass.set_bind_group(2, buffers, &[]);
        draw_primitives(pass, picture, rows, 0);
    })
}
