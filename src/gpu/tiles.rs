//! The raster in compute: primitives are sorted into tiles, and a workgroup per tile draws its own.

use super::device::Connection;
use super::draw::{Gpu, Image, Stop, group};
use super::form::tiled::bins_module;
use super::form::{Form, Path};
use super::layouts::{Entry, Layouts};
use super::picture::{Picture, buffer, bytes_of};
use super::recorder::{Recorder, Stage};
use crate::error::Result;
use plan::Plan;
use std::ops::Range;
use std::sync::Arc;
use wgpu::{
    BindGroup, BindGroupLayout, BindingResource, Buffer, BufferUsages, ComputePass, ComputePipeline,
    TextureView,
};

mod images;
mod lists;
mod plan;

pub(super) use lists::TiledRows;
pub use plan::Planned;

/// Pixels along a tile's side.
const TILE: u32 = 8;
/// Primitives that a workgroup takes at a time.
const CHUNK: u32 = 256;
/// Bins that are filled at a time, and tiles of a bin, at most.
const CELLS: u32 = 256;
/// Words of what is known of a bin.
const BIN: usize = 4;

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

/// Where tiles are drawn to: textures, for which group 2 has places, or what group 3 is.
struct Drawing<'a> {
    module: &'a str,
    constants: Vec<(&'static str, f64)>,
    layout: BindGroupLayout,
    textures: &'a [TextureView],
    written: Option<(BindGroupLayout, BindGroup)>,
}

/// The kernels that put primitives into bins and tiles.
struct Binning {
    group: BindGroup,
    kernels: Vec<(Arc<ComputePipeline>, u32, u32)>,
}

/// The kernel that draws the tiles of an extent in pixels.
struct TileKernel<'a> {
    group: BindGroup,
    written: Option<&'a BindGroup>,
    pipeline: Arc<ComputePipeline>,
    extent: (u32, u32),
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
        let most = |of: fn(&plan::Part) -> u64| plan.parts.iter().map(of).max().unwrap_or(0);
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
        let binning = self.binning((connection, layouts), rows, drawing.is_some());
        let kernel =
            drawing.map(|(drawing, extent)| self.kernel((connection, layouts), drawing, rows, extent));
        recorder.clear(&self.cells);
        recorder.compute(Stage::Raster, |pass| {
            self.record(pass, frame, &binning);
            if let Some(kernel) = &kernel {
                kernel.record(pass);
            }
        })
    }

    /// What counts the entries of some rows of bins and, if there is room, fills those and their tiles.
    fn binning(
        &self,
        (connection, layouts): (&Connection, &mut Layouts),
        rows: &Range<u32>,
        fills: bool,
    ) -> Binning {
        let module = bins_module();
        let layout = layouts.tiles.clone();
        let mut kernel = |point| {
            let entry = Entry { module: &module, point };
            layouts.compute_with(&connection.device, entry, true, Some(&layout), None, &[])
        };
        let most = connection.limits.max_compute_workgroups_per_dimension;
        let chunks = self.primitives.div_ceil(CHUNK);
        let (wide, high) = (chunks.min(most), chunks.div_ceil(most));
        let mut kernels = vec![(kernel("count_bins"), wide, high), (kernel("place_bins"), 1, 1)];
        if fills {
            kernels.push((kernel("fill_bins"), wide, high));
            kernels.push((kernel("fill_tiles"), self.columns * (rows.end - rows.start), 1));
        }
        Binning { group: self.group(connection, &layout, rows, &[]), kernels }
    }

    fn record(&self, pass: &mut ComputePass<'_>, frame: &BindGroup, binning: &Binning) {
        pass.set_bind_group(0, frame, &[]);
        pass.set_bind_group(1, &self.geometry, &[]);
        pass.set_bind_group(2, &binning.group, &[]);
        for (pipeline, x, y) in &binning.kernels {
            pass.set_pipeline(pipeline);
            pass.dispatch_workgroups(*x, *y, 1);
        }
    }

    /// What draws tiles of some rows of bins, once they are filled.
    fn kernel<'a>(
        &self,
        (connection, layouts): (&Connection, &mut Layouts),
        drawing: &'a Drawing<'_>,
        rows: &Range<u32>,
        extent: (u32, u32),
    ) -> TileKernel<'a> {
        let Drawing { module, constants, layout, textures, written } = drawing;
        let entry = Entry { module, point: "draw_tiles" };
        let written_layout = written.as_ref().map(|(layout, _)| layout);
        let pipeline =
            layouts.compute_with(&connection.device, entry, true, Some(layout), written_layout, constants);
        let group = self.group(connection, layout, rows, textures);
        TileKernel { group, written: written.as_ref().map(|(_, group)| group), pipeline, extent }
    }
}

impl TileKernel<'_> {
    /// Groups 0 and 1 are those that primitives were put into tiles with.
    fn record(&self, pass: &mut ComputePass<'_>) {
        let (width, height) = self.extent;
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(2, &self.group, &[]);
        if let Some(written) = self.written {
            pass.set_bind_group(3, written, &[]);
        }
        pass.dispatch_workgroups(width.div_ceil(TILE), height.div_ceil(TILE), 1);
    }
}

/// Whether all loops came to their ends, which the number of the first bin's tiles tells.
fn check_bin(connection: &Connection, first_bin: &[u32]) -> Result<()> {
    if first_bin.last() == Some(&u32::MAX) { Err(connection.cut_short()) } else { Ok(()) }
}

impl Gpu {
    /// The image of a form, drawn by compute shaders alone.
    pub(super) fn tiled(&mut self, picture: &Picture, form: &Form, stop: Stop<'_>) -> Result<Image> {
        debug_assert!(picture.batches.len() <= 1, "more of them are drawn in bands");
        let module = form.tiled_module()?;
        let plan = self.plan(picture, stop)?;
        // lists have what does nothing, too: it is counted
        let shows_zero_fragments = form.shows_zero_fragments || form.is_listed_in_tiles();
        let (_, mut constants) = picture.draws(shows_zero_fragments).vertex();
        let layout = self.layouts.tiles.clone();
        if form.is_listed_in_tiles() {
            let drawing = Drawing { module: &module, constants, layout, textures: &[], written: None };
            return self.tiled_lists(picture, form, plan, &drawing, stop);
        }
        constants.extend(form.is_backwards_in_tiles().then_some(("backwards", 1.0)));
        constants.extend(form.capacity().map(|capacity| ("capacity", capacity.fragments.into())));
        let drawing = Drawing { module: &module, constants, layout, textures: &[], written: None };
        match &form.path {
            Path::Blended(blending) if blending.in_registers.is_none() => {
                self.tiled_targets(picture, form, blending, plan, drawing, stop)
            }
            _ => self.tiled_image(picture, form, plan, drawing, stop),
        }
    }
}
