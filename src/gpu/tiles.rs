//! The raster in compute: primitives are sorted into tiles, and a workgroup per tile draws its own.

use super::device::Connection;
use super::draw::{Gpu, Image, Stop, group, texel_bytes};
use super::form::tiled::bins_module;
use super::form::{Blending, Form, Path};
use super::geometry::PRIMITIVE;
use super::layouts::{Entry, Layouts, tile_entries};
use super::picture::{Picture, ToDraw, buffer, bytes_of, rows_of, texture};
use super::recorder::{Recorder, Stage, Times, read};
use crate::error::{Error, Result};
use std::ops::Range;
use std::sync::{Arc, OnceLock};
use wgpu::{
    BindGroup, BindGroupLayout, BindGroupLayoutDescriptor, BindingResource, Buffer, BufferUsages,
    ComputePipeline, TextureFormat, TextureUsages, TextureView, TextureViewDescriptor,
};

/// Pixels along a tile's side.
const TILE: u32 = 8;
/// Primitives that a workgroup takes at a time.
const CHUNK: u32 = 256;
/// Bins that are filled at a time, and tiles of a bin, at most.
const CELLS: u32 = 256;
/// Words of what is known of a bin.
const BIN: usize = 4;

/// How an image is cut into bins, and bins into parts that are drawn one after the other.
#[derive(Debug)]
pub struct Plan {
    /// Tiles along a bin's side.
    side: u32,
    columns: u32,
    parts: Vec<Part>,
}

/// Some rows of bins.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Part {
    rows: Range<u32>,
    /// Entries of bins, and of their tiles.
    entries: u64,
    tile_entries: u64,
}

/// What is known of the tiles of a picture once they have been counted.
pub type Planned = OnceLock<Plan>;

/// The buffers of one part after the other.
struct Bins {
    primitives: u32,
    side: u32,
    columns: u32,
    geometry: BindGroup,
    bounds: Buffer,
    chunk_counts: Buffer,
    cells: Buffer,
    bin_entries: Buffer,
    tiles: Buffer,
    tile_entries: Buffer,
}

/// Where tiles are drawn to: group 2 has a place for it, or the image is written.
struct Drawing<'a> {
    module: &'a str,
    constants: Vec<(&'static str, f64)>,
    layout: BindGroupLayout,
    textures: &'a [TextureView],
    image: Option<BindGroup>,
}

impl Bins {
    fn new(
        gpu: &Gpu,
        picture: &Picture,
        (side, columns): (u32, u32),
        (entries, tile_entries): (u64, u64),
    ) -> Self {
        let connection = &gpu.connection;
        let words = |label, count: u64| {
            buffer(connection, label, 4 * count, BufferUsages::STORAGE | BufferUsages::COPY_SRC)
        };
        let (geometry, primitives) = picture.batches.first().cloned().unwrap_or_else(|| {
            let record = words("no primitives", 28);
            let all = [(); 3].map(|()| record.as_entire_binding());
            (group(connection, &gpu.layouts.geometry, &all), 0)
        });
        let most_cells = u64::from(CELLS);
        Self {
            primitives,
            side,
            columns,
            geometry,
            bounds: words("bounds", 2 * u64::from(primitives)),
            chunk_counts: words("chunk counts", u64::from(primitives.div_ceil(CHUNK)) * most_cells),
            cells: words("bins", BIN as u64 * most_cells),
            bin_entries: words("bin entries", entries),
            tiles: words("tiles", 2 * most_cells * most_cells),
            tile_entries: words("tile entries", tile_entries),
        }
    }

    /// Room for the largest part.
    fn of_plan(gpu: &Gpu, picture: &Picture, plan: &Plan) -> Self {
        let most = |of: fn(&Part) -> u64| plan.parts.iter().map(of).max().unwrap_or(0);
        let entries = (most(|part| part.entries), most(|part| part.tile_entries));
        Self::new(gpu, picture, (plan.side, plan.columns), entries)
    }

    /// Group 2 for some rows of bins.
    fn group(
        &self,
        connection: &Connection,
        layout: &BindGroupLayout,
        rows: &Range<u32>,
        textures: &[TextureView],
    ) -> BindGroup {
        let count = rows.end - rows.start;
        let chunks = self.primitives.div_ceil(CHUNK);
        let tiling = [self.primitives, chunks, self.side, self.columns, count, rows.start, 0, 0];
        let uniform = buffer(connection, "tiling", 32, BufferUsages::UNIFORM);
        connection.queue.write_buffer(&uniform, 0, bytes_of(&tiling));
        let Self { bounds, chunk_counts, cells, bin_entries, tiles, tile_entries, .. } = self;
        let all = [&uniform, bounds, chunk_counts, cells, bin_entries, tiles, tile_entries];
        let mut resources: Vec<_> = all.iter().map(|buffer| buffer.as_entire_binding()).collect();
        resources.extend(textures.iter().map(BindingResource::TextureView));
        group(connection, layout, &resources)
    }

    /// Counts the entries of some rows of bins and, if there is something to draw and so room for them, puts primitives into
    /// tiles and draws those. All is one pass: stamps between dispatches are not to be trusted everywhere.
    fn pass(
        &self,
        (connection, layouts): (&Connection, &mut Layouts),
        recorder: &mut Recorder<'_>,
        rows: &Range<u32>,
        frame: &BindGroup,
        drawing: Option<(&Drawing<'_>, (u32, u32))>,
    ) -> Result<()> {
        let module = bins_module();
        let layout = layouts.tiles.clone();
        let group = self.group(connection, &layout, rows, &[]);
        let mut kernel = |point| {
            let entry = Entry { module: &module, point };
            layouts.compute_with(&connection.device, entry, true, Some(&layout), false, &[])
        };
        let most = connection.limits.max_compute_workgroups_per_dimension;
        let chunks = self.primitives.div_ceil(CHUNK);
        let (wide, high) = (chunks.min(most), chunks.div_ceil(most));
        let mut steps = vec![(kernel("count_bins"), wide, high), (kernel("place_bins"), 1, 1)];
        if drawing.is_some() {
            steps.push((kernel("fill_bins"), wide, high));
            steps.push((kernel("fill_tiles"), self.columns * (rows.end - rows.start), 1));
        }
        let drawing = drawing.map(|(drawing, extent)| {
            let pipeline = drawing.pipeline(connection, layouts);
            (drawing, self.group(connection, &drawing.layout, rows, drawing.textures), pipeline, extent)
        });
        recorder.clear(&self.cells);
        recorder.compute(Stage::Raster, |pass| {
            pass.set_bind_group(0, frame, &[]);
            pass.set_bind_group(1, &self.geometry, &[]);
            pass.set_bind_group(2, &group, &[]);
            for (pipeline, x, y) in &steps {
                pass.set_pipeline(pipeline);
                pass.dispatch_workgroups(*x, *y, 1);
            }
            if let Some((drawing, group, pipeline, (width, height))) = &drawing {
                pass.set_pipeline(pipeline);
                pass.set_bind_group(2, group, &[]);
                if let Some(image) = &drawing.image {
                    pass.set_bind_group(3, image, &[]);
                }
                pass.dispatch_workgroups(width.div_ceil(TILE), height.div_ceil(TILE), 1);
            }
        })
    }
}

impl Drawing<'_> {
    fn pipeline(&self, connection: &Connection, layouts: &mut Layouts) -> Arc<ComputePipeline> {
        let entry = Entry { module: self.module, point: "draw_tiles" };
        let writes_image = self.image.is_some();
        let layout = Some(&self.layout);
        layouts.compute_with(&connection.device, entry, true, layout, writes_image, &self.constants)
    }
}

/// Tiles along a bin's side: few, as long as there is room for so many bins.
fn bin_side(width: u32, height: u32) -> u32 {
    let bins = |side: u32| width.div_ceil(TILE * side) * height.div_ceil(TILE * side);
    if bins(8) <= CELLS { 8 } else { 16 }
}

/// Whether all loops came to their ends, which the number of the first bin's tiles tells.
fn check_bin(connection: &Connection, first_bin: &[u32]) -> Result<()> {
    if first_bin.last() == Some(&u32::MAX) { Err(connection.cut_short()) } else { Ok(()) }
}

/// The rows of pixels that rows of bins have.
fn pixel_rows(height: u32, side: u32, rows: &Range<u32>) -> Range<u32> {
    rows.start * side * TILE..(rows.end * side * TILE).min(height)
}

/// As many rows of bins at a time as there may be, and as there is room for: `sums` has the entries of each row's bins and
/// tiles, from the `first` row on.
fn parts(first: u32, sums: &[(u64, u64)], most_rows: u32, most: u64, device: &str) -> Result<Vec<Part>> {
    let mut parts: Vec<Part> = Vec::new();
    for (row, &(entries, tile_entries)) in (first..).zip(sums) {
        if entries.max(tile_entries) > most {
            return Err(Error::Memory(format!(
                "the {tile_entries} primitives in the tiles of a row; {device} keeps {most} at a time: a smaller image has \
                 fewer, and path=\"hardware\" keeps none"
            )));
        }
        let fits = |part: &&mut Part| {
            part.rows.end - part.rows.start < most_rows
                && part.entries + entries <= most
                && part.tile_entries + tile_entries <= most
        };
        if let Some(part) = parts.last_mut().filter(fits) {
            part.rows.end = row + 1;
            part.entries += entries;
            part.tile_entries += tile_entries;
        } else {
            parts.push(Part { rows: row..row + 1, entries, tile_entries });
        }
    }
    Ok(parts)
}

/// As many rows of bins, of `size` pixels each, at a time as have no more primitives than there is room for: `begins` has the number of those that
/// begin in each row, `ends` of those that end in it.
fn bands(size: u32, begins: &[u64], ends: &[u64], most: u64, device: &str) -> Result<Vec<Range<u32>>> {
    let mut bands: Vec<Range<u32>> = Vec::new();
    // primitives of the band, and those of the row before that go on
    let (mut held, mut through) = (0, 0);
    for (row, (begin, end)) in (0..).zip(begins.iter().zip(ends)) {
        let here = through + begin;
        if here > most {
            let first = row * size;
            return Err(Error::Memory(format!(
                "the {here} primitives that reach into the {size} rows from {first} on; {device} keeps {most} at a time, and \
                 path=\"hardware\" draws them in parts"
            )));
        }
        held += begin;
        if let Some(band) = bands.last_mut().filter(|_| held <= most) {
            band.end = row + 1;
        } else {
            bands.push(row..row + 1);
            held = here;
        }
        through = here - end;
    }
    Ok(bands)
}

impl Gpu {
    /// Rows of the image that have no more primitives than one buffer holds.
    ///
    /// # Errors
    /// [`Error::Memory`] where a row of bins has more.
    pub fn bands_of_primitives(&self, drawn: &ToDraw<'_>) -> Result<Vec<Range<u32>>> {
        let (image, height) = (drawn.view.rect(), drawn.view.height);
        let side = bin_side(drawn.view.width, height);
        let size = TILE * side;
        let rows = height.div_ceil(size) as usize;
        let (mut begins, mut ends) = (vec![0; rows], vec![0; rows]);
        for rows in (drawn.primitives)().filter_map(|primitive| rows_of(&primitive, &image)) {
            begins[(rows.start / size) as usize] += 1;
            ends[((rows.end - 1) / size) as usize] += 1;
        }
        let most = self.most_bytes() / (4 * PRIMITIVE as u64);
        let bands = bands(size, &begins, &ends, most, &self.connection.info.name)?;
        Ok(bands.iter().map(|rows| pixel_rows(height, side, rows)).collect())
    }

    /// How the picture is cut up, which is counted once.
    fn plan<'a>(&mut self, picture: &'a Picture, stop: Stop<'_>) -> Result<&'a Plan> {
        if let Some(plan) = picture.plan.get() {
            return Ok(plan);
        }
        let (width, height) = (picture.width, picture.height);
        let side = bin_side(width, height);
        let columns = width.div_ceil(TILE * side);
        let all_rows = picture.part.start / (TILE * side)..picture.part.end.div_ceil(TILE * side);
        // what is written at a time has to fit, too: colour and background's share
        let row_of_bins = 32 * u64::from(width) * u64::from(side * TILE);
        let most_rows = u32::try_from(self.most_bytes() / row_of_bins).unwrap_or(u32::MAX);
        let most_rows = most_rows.clamp(1, CELLS / columns);
        let bins = Bins::new(self, picture, (side, columns), (0, 0));
        let mut sums = Vec::new();
        for first in all_rows.clone().step_by(most_rows as usize) {
            let rows = first..(first + most_rows).min(all_rows.end);
            let frame = self.frame(picture, &pixel_rows(height, side, &rows), &[]);
            let Self { connection, layouts, .. } = &mut *self;
            let mut recorder = Recorder::new(connection, stop);
            bins.pass((connection, layouts), &mut recorder, &rows, &frame, None)?;
            let words = BIN * (columns * (rows.end - rows.start)) as usize;
            let (counts, _): (Vec<u32>, _) = recorder.finish(&bins.cells, 4 * words as u64)?;
            let row = |bins: &[u32]| {
                let sum = |which| bins.iter().skip(which).step_by(BIN).map(|n| u64::from(*n)).sum();
                (sum(1), sum(3))
            };
            sums.extend(counts.chunks(BIN * columns as usize).map(row));
        }
        let most = self.most_bytes() / 4;
        let parts = parts(all_rows.start, &sums, most_rows, most, &self.connection.info.name)?;
        Ok(picture.plan.get_or_init(|| Plan { side, columns, parts }))
    }

    /// The image of a form, drawn by compute shaders alone.
    pub(super) fn tiled(&mut self, picture: &Picture, form: &Form, stop: Stop<'_>) -> Result<Image> {
        let module = form.tiled_module()?;
        debug_assert!(picture.batches.len() <= 1, "more of them are drawn in bands");
        let plan = self.plan(picture, stop)?;
        let (_, mut constants) = picture.draws(form.shows_zero_fragments).vertex();
        constants.extend(form.is_backwards_in_tiles().then_some(("backwards", 1.0)));
        constants.extend(form.capacity().map(|capacity| ("capacity", capacity.fragments.into())));
        let layout = self.layouts.tiles.clone();
        let drawing = Drawing { module: &module, constants, layout, textures: &[], image: None };
        match &form.path {
            Path::Blended(blending) if blending.in_registers.is_none() => {
                self.tiled_targets(picture, form, blending, plan, drawing, stop)
            }
            _ => self.tiled_image(picture, form, plan, drawing, stop),
        }
    }

    /// Draws what blend units would leave, and resolves it.
    fn tiled_targets(
        &mut self,
        picture: &Picture,
        form: &Form,
        blending: &Blending,
        plan: &Plan,
        drawing: Drawing<'_>,
        stop: Stop<'_>,
    ) -> Result<Image> {
        let format = |channels| match channels {
            1 => TextureFormat::R32Float,
            _ => TextureFormat::Rgba32Float,
        };
        let formats: Vec<_> = blending.targets.iter().map(|target| format(target.channels)).collect();
        let usage = TextureUsages::STORAGE_BINDING | TextureUsages::TEXTURE_BINDING;
        let view = |format: &TextureFormat| {
            let size = (picture.width, picture.height);
            let target = texture(&self.connection, "target", size, *format, usage);
            target.create_view(&TextureViewDescriptor::default())
        };
        let textures: Vec<_> = formats.iter().map(view).collect();
        let entries = tile_entries(&formats);
        let descriptor = BindGroupLayoutDescriptor { label: Some("tiles"), entries: &entries };
        let layout = self.connection.device.create_bind_group_layout(&descriptor);
        let drawing = Drawing { layout, textures: &textures, ..drawing };
        let params: Vec<_> = form.numbers.iter().map(|number| number.bits()).collect();
        let bins = Bins::of_plan(self, picture, plan);
        let mut times = Times::default();
        for part in &plan.parts {
            let rows = pixel_rows(picture.height, plan.side, &part.rows);
            let frame = self.frame(picture, &rows, &params);
            let Self { connection, layouts, .. } = &mut *self;
            let mut recorder = Recorder::new(connection, stop);
            let extent = (picture.width, rows.end - rows.start);
            let drawing = Some((&drawing, extent));
            bins.pass((connection, layouts), &mut recorder, &part.rows, &frame, drawing)?;
            // what is read back says whether all loops came to their ends
            let (first_bin, spent): (Vec<u32>, _) = recorder.finish(&bins.cells, 4 * BIN as u64)?;
            check_bin(connection, &first_bin)?;
            times = times.plus(spent);
        }
        let mut image = Image { times, ..Image::default() };
        self.resolve_targets(picture, form, blending.resolve, &textures, &mut image, stop)?;
        Ok(image)
    }

    /// Draws the image itself.
    fn tiled_image(
        &mut self,
        picture: &Picture,
        form: &Form,
        plan: &Plan,
        mut drawing: Drawing<'_>,
        stop: Stop<'_>,
    ) -> Result<Image> {
        let params: Vec<_> = form.numbers.iter().map(|number| number.bits()).collect();
        let bins = Bins::of_plan(self, picture, plan);
        let mut image = Image::default();
        for part in &plan.parts {
            let rows = pixel_rows(picture.height, plan.side, &part.rows);
            let frame = self.frame(picture, &rows, &params);
            let Self { connection, layouts, .. } = &mut *self;
            let extent = (picture.width, rows.end - rows.start);
            let bytes = texel_bytes(form) * u64::from(extent.0) * u64::from(extent.1);
            let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC;
            let output = buffer(connection, "image", bytes, usage);
            drawing.image = Some(group(connection, &layouts.output, &[output.as_entire_binding()]));
            let mut recorder = Recorder::new(connection, stop);
            let drawing = Some((&drawing, extent));
            bins.pass((connection, layouts), &mut recorder, &part.rows, &frame, drawing)?;
            let sources = [(&output, bytes), (&bins.cells, 4 * BIN as u64)];
            let (landed, times) = recorder.finish_all(&sources)?;
            check_bin(connection, &read::<u32>(&landed[1], 4 * BIN as u64)?)?;
            image.texels.extend(read::<f32>(&landed[0], bytes)?);
            image.times = image.times.plus(times);
        }
        Ok(image)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_are_few_enough_or_come_in_parts() {
        assert_eq!((bin_side(1280, 720), bin_side(3840, 2160), bin_side(1, 1)), (8, 16, 8));
        assert_eq!(pixel_rows(720, 8, &(11..12)), 704..720);
        let sums = [(1, 4), (2, 4), (1, 9), (0, 0), (0, 0), (0, 0)];
        let part = |rows, entries, tile_entries| Part { rows, entries, tile_entries };
        let cut = parts(0, &sums, 3, 10, "it").unwrap();
        assert_eq!(cut, [part(0..2, 3, 8), part(2..5, 1, 9), part(5..6, 0, 0)]);
        assert_eq!(parts(5, &sums[..1], 3, 10, "it").unwrap(), [part(5..6, 1, 4)]);
        assert!(
            parts(0, &sums, 3, 8, "it").unwrap_err().to_string().contains("the 9 primitives in the tiles")
        );
    }

    #[test]
    fn bands_hold_what_reaches_into_them() {
        // one primitive goes through all rows, two begin and end in each
        let (begins, ends) = ([3, 2, 2, 2], [2, 2, 2, 3]);
        let cut = |most| bands(64, &begins, &ends, most, "it");
        assert_eq!(cut(9).unwrap(), [0..4]);
        assert_eq!(cut(8).unwrap(), [0..3, 3..4]);
        assert_eq!(cut(6).unwrap(), [0..2, 2..4]);
        assert_eq!(cut(3).unwrap(), [0..1, 1..2, 2..3, 3..4]);
        assert!(
            cut(2)
                .unwrap_err()
                .to_string()
                .contains("the 3 primitives that reach into the 64 rows from 0 on")
        );
        assert_eq!(bands(64, &[0, 0], &[0, 0], 5, "it").unwrap(), [0..2]);
    }
}
