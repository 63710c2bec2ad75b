//! Passes over lists: every fragment is counted, then stored where there is exactly as much room, then sorted.

use super::device::Connection;
use super::draw::{Gpu, Image, Stop, attachment, dispatch, draw_primitives, group, resolve};
use super::draws::flag;
use super::form::{Capacity, Form, Sorting, list_module};
use super::layouts::{Entry, Layouts, Reads, plain};
use super::picture::{Given, Picture, buffer, bytes_of, texture};
use super::recorder::{Recorder, Stage, read};
use crate::error::{Error, Result};
use std::ops::Range;
use wgpu::{
    BindGroup, Buffer, BufferUsages, Color, ColorWrites, LoadOp, StoreOp, TextureFormat, TextureUsages,
    TextureViewDescriptor,
};

/// Bytes of a fragment's colour, the larger part of what is kept of it.
const COLOR: u64 = 16;
/// Bytes of its depth and primitive.
const KEY: u64 = 8;

/// The buffers of lists, by their bindings.
struct ListBuffers {
    group: BindGroup,
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
        let (lists, all) = (self.lists(picture, 0), 0..picture.height);
        let frame = self.frame(picture, &all, &[]);
        let Self { connection, layouts, .. } = self;
        let mut recorder = Recorder::new(connection, stop);
        count_fragments(connection, layouts, &mut recorder, picture, [&frame, &lists.group])?;
        picture.rows = recorder.finish(&lists.row_sums, 8 * u64::from(picture.height))?.0;
        Ok(())
    }

    /// Room for so many fragments.
    fn lists(&self, picture: &Picture, fragments: u64) -> ListBuffers {
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC;
        let storage = |label, bytes| buffer(&self.connection, label, bytes, usage);
        let rows = u64::from(picture.height);
        let places = storage("places", picture.counts.size());
        let (row_sums, row_places) = (storage("row sums", 8 * rows), storage("row places", 4 * rows));
        let (keys, colors) = (storage("keys", KEY * fragments), storage("colors", COLOR * fragments));
        let all = [&picture.counts, &places, &row_sums, &row_places, &keys, &colors, &picture.ranks];
        let group = group(&self.connection, &self.layouts.lists, &all.map(Buffer::as_entire_binding));
        ListBuffers { group, places, row_sums, row_places, keys, colors }
    }

    /// Lists of all fragments, in as many parts of the image as their number asks for.
    pub(super) fn listed(
        &mut self,
        picture: &Picture,
        form: &Form,
        (point, sorted): (&str, Sorting),
        constants: &[(&str, f64)],
        stop: Stop<'_>,
    ) -> Result<Image> {
        let bands = self.bands_of_fragments(picture, self.rows_per_band(picture, form))?;
        let lists = self.lists_for(picture, &bands);
        let params: Vec<_> = form.numbers.iter().map(|number| number.bits()).collect();
        let module = form.module();
        let mut image = Image::default();
        for band in &bands {
            let frame = self.frame(picture, band, &params);
            let Self { connection, layouts, .. } = self;
            let mut recorder = Recorder::new(connection, stop);
            let groups = [&frame, &lists.group];
            match &picture.given {
                Some(given) => lists.fill(connection, given, picture, band),
                None => draw_lists(connection, layouts, &mut recorder, picture, groups, band)?,
            }
            if let Some(capacity) = form.capacity() {
                sort_lists(connection, layouts, &mut recorder, picture, groups, band, capacity.sorted)?;
                drop_fragments(connection, layouts, &mut recorder, picture, groups, band, capacity)?;
            }
            sort_lists(connection, layouts, &mut recorder, picture, groups, band, sorted)?;
            let entry = Entry { module: &module, point };
            let constants: Vec<_> = picture.knowledge().iter().chain(constants).copied().collect();
            let pipeline = layouts.compute(&connection.device, entry, Reads::Lists, true, &constants);
            resolve(connection, layouts, recorder, picture, form, band, &pipeline, groups, &mut image)?;
        }
        Ok(image)
    }

    /// Keeps and reads back every fragment.
    ///
    /// # Errors
    /// As [`Gpu::image`].
    pub fn capture(&mut self, picture: &Picture, stop: Stop<'_>) -> Result<Given> {
        let bands = self.bands_of_fragments(picture, u32::MAX)?;
        let lists = self.lists_for(picture, &bands);
        let mut captured = Given::default();
        for band in &bands {
            let fragments = fragments_of(picture, band);
            let frame = self.frame(picture, band, &[]);
            let Self { connection, layouts, .. } = self;
            let mut recorder = Recorder::new(connection, stop);
            let groups = [&frame, &lists.group];
            draw_lists(connection, layouts, &mut recorder, picture, groups, band)?;
            sort_lists(connection, layouts, &mut recorder, picture, groups, band, Sorting::Submission)?;
            // all counts come once, with the last band
            let last = band.end == picture.height;
            let counts = if last { 4 * u64::from(picture.width) * u64::from(picture.height) } else { 0 };
            let sources = [
                (&lists.keys, KEY * fragments),
                (&lists.colors, COLOR * fragments),
                (&picture.counts, counts),
            ];
            let (landed, _) = recorder.finish_all(&sources)?;
            captured.keys.extend(read::<[u32; 2]>(&landed[0], KEY * fragments)?);
            captured.colors.extend(read::<[f32; 4]>(&landed[1], COLOR * fragments)?);
            captured.counts.extend(read::<u32>(&landed[2], counts)?);
        }
        if captured.counts.iter().any(|count| count >> 31 == 1) {
            return Err(self.connection.cut_short());
        }
        Ok(captured)
    }

    /// Room for the fragments of the fullest band, and where each row's go.
    fn lists_for(&self, picture: &Picture, bands: &[Range<u32>]) -> ListBuffers {
        let most = bands.iter().map(|band| fragments_of(picture, band)).max().unwrap_or(0);
        let lists = self.lists(picture, most);
        self.connection.queue.write_buffer(&lists.row_places, 0, bytes_of(&row_places(picture, bands)));
        lists
    }

    /// The same where their fragments have to fit, too.
    fn bands_of_fragments(&self, picture: &Picture, rows: u32) -> Result<Vec<Range<u32>>> {
        let most = self.most_bytes() / COLOR;
        let (mut bands, mut band, mut sum) = (Vec::new(), 0..0, 0);
        for (row, [fragments, _]) in (0..).zip(&picture.rows) {
            let fragments = u64::from(*fragments);
            if fragments > most {
                return Err(Error::Memory(format!(
                    "the {fragments} fragments of row {row}; {} keeps {most} at a time: a smaller image has fewer in a row",
                    self.connection.info.name
                )));
            }
            if sum + fragments > most || row - band.start >= rows {
                bands.push(std::mem::replace(&mut band, row..row));
                sum = 0;
            }
            (band.end, sum) = (row + 1, sum + fragments);
        }
        bands.push(band);
        Ok(bands)
    }
}

/// Where the first fragment of each row goes, band by band.
fn row_places(picture: &Picture, bands: &[Range<u32>]) -> Vec<u32> {
    let mut places = Vec::with_capacity(picture.rows.len());
    for band in bands {
        let mut place = 0;
        for row in &picture.rows[band.start as usize..band.end as usize] {
            places.push(place);
            place += row[0];
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
    fn fill(&self, connection: &Connection, given: &Given, picture: &Picture, band: &Range<u32>) {
        let first = fragments_of(picture, &(0..band.start)) as usize;
        let these = first..first + fragments_of(picture, band) as usize;
        let width = picture.width as usize;
        let pixels = band.start as usize * width..band.end as usize * width;
        let mut end = 0;
        let ends = given.counts[pixels.clone()].iter().map(|count| {
            end += count;
            end
        });
        let ends: Vec<u32> = ends.collect();
        connection.queue.write_buffer(&self.places, 4 * pixels.start as u64, bytes_of(&ends));
        connection.queue.write_buffer(&self.keys, 0, bytes_of(&given.keys[these.clone()]));
        connection.queue.write_buffer(&self.colors, 0, bytes_of(&given.colors[these]));
    }
}

/// Stores the fragments of some rows.
fn draw_lists(
    connection: &Connection,
    layouts: &mut Layouts,
    recorder: &mut Recorder<'_>,
    picture: &Picture,
    [frame, lists]: [&BindGroup; 2],
    band: &Range<u32>,
) -> Result<()> {
    if band.start == 0 {
        // once more than their number is asked for, so that the time is that of a frame
        count_fragments(connection, layouts, recorder, picture, [frame, lists])?;
    }
    let module = list_module();
    let entry = |point| Entry { module: &module, point };
    let shift = layouts.compute(&connection.device, entry("shift_rows"), Reads::Lists, false, &[]);
    dispatch(recorder, Stage::Raster, &shift, &[frame, lists], picture, band)?;
    draw_into_lists(connection, layouts, recorder, picture, "store_fragment", [frame, lists], band)
}

/// Sorts the lists of some rows.
fn sort_lists(
    connection: &Connection,
    layouts: &mut Layouts,
    recorder: &mut Recorder<'_>,
    picture: &Picture,
    groups: [&BindGroup; 2],
    band: &Range<u32>,
    sorting: Sorting,
) -> Result<()> {
    if picture.given.is_some() {
        return Ok(()); // they came in this order
    }
    let module = list_module();
    let entry = |point| Entry { module: &module, point };
    let sorting = match sorting {
        Sorting::Depth => 0.0,
        Sorting::Submission => 1.0,
        Sorting::Rank => 2.0,
    };
    let constants = [("sorting", sorting)];
    let sort = layouts.compute(&connection.device, entry("sort_lists"), Reads::Lists, false, &constants);
    dispatch(recorder, Stage::Resolve, &sort, &groups, picture, band)
}

/// Leaves as many fragments of each list as there may be.
fn drop_fragments(
    connection: &Connection,
    layouts: &mut Layouts,
    recorder: &mut Recorder<'_>,
    picture: &Picture,
    groups: [&BindGroup; 2],
    band: &Range<u32>,
    capacity: Capacity,
) -> Result<()> {
    let module = list_module();
    let entry = Entry { module: &module, point: "drop_fragments" };
    let constants =
        [("list_capacity", capacity.fragments.into()), ("drops_backwards", flag(capacity.backwards))];
    let pipeline = layouts.compute(&connection.device, entry, Reads::Lists, false, &constants);
    dispatch(recorder, Stage::Resolve, &pipeline, &groups, picture, band)
}

/// How many fragments each pixel and each row has, and where in its row each pixel's go.
fn count_fragments(
    connection: &Connection,
    layouts: &mut Layouts,
    recorder: &mut Recorder<'_>,
    picture: &Picture,
    [frame, lists]: [&BindGroup; 2],
) -> Result<()> {
    recorder.clear(&picture.counts);
    let all = 0..picture.height;
    draw_into_lists(connection, layouts, recorder, picture, "count_fragment", [frame, lists], &all)?;
    let entry = Entry { module: &list_module(), point: "sum_rows" };
    let pipeline = layouts.compute(&connection.device, entry, Reads::Lists, false, &[]);
    recorder.compute(Stage::Raster, |pass| {
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, frame, &[]);
        pass.set_bind_group(2, lists, &[]);
        pass.dispatch_workgroups(picture.height, 1, 1);
    })
}

/// Fragments into lists. A pass wants a target, which nothing is drawn into.
fn draw_into_lists(
    connection: &Connection,
    layouts: &mut Layouts,
    recorder: &mut Recorder<'_>,
    picture: &Picture,
    point: &str,
    [frame, lists]: [&BindGroup; 2],
    rows: &Range<u32>,
) -> Result<()> {
    let format = TextureFormat::R8Unorm;
    let unused = texture(
        connection,
        "none",
        (picture.width, rows.end - rows.start),
        format,
        TextureUsages::RENDER_ATTACHMENT,
    );
    let unused = unused.create_view(&TextureViewDescriptor::default());
    let draws = picture.draws(true);
    let entry = Entry { module: &list_module(), point };
    let states = [plain(format, ColorWrites::empty())];
    let pipeline = layouts.render(&connection.device, entry, draws, Reads::Lists, &states);
    let target = attachment(&unused, LoadOp::Clear(Color::TRANSPARENT), StoreOp::Discard);
    recorder.render(Stage::Raster, &[target], |pass| {
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, frame, &[]);
        pass.set_bind_group(2, lists, &[]);
        draw_primitives(pass, picture, rows, 0);
    })
}
