//! What all passes over the geometry and over the image share.

use super::blend::Targets;
use super::canvas::{Canvas, landed_row};
use super::device::Connection;
use super::form::tiled::RasterPath;
use super::form::{Form, Path};
use super::layouts::Layouts;
use super::linked::Pool;
use super::picture::{Picture, buffer, bytes_of};
use super::recorder::{Recorder, Stage, Times};
use crate::error::Result;
use std::ops::Range;
use wgpu::{
    BindGroup, BindGroupDescriptor, BindGroupEntry, BindGroupLayout, BindingResource, Buffer, BufferUsages,
    Color, LoadOp, Operations, RenderPass, RenderPassColorAttachment, StoreOp, TextureView,
};

/// Bytes of a pixel in the image that a resolve writes.
const TEXEL: u64 = 16;

/// An image, and how long it took on the device.
#[derive(Debug, Default)]
pub struct Image {
    /// Linear colour and the background's share of each pixel, or colour, nothing, the background's share per channel and
    /// nothing.
    pub texels: Vec<f32>,
    pub times: Times,
    /// Fragments whose weight of somebody's own was no weight.
    pub invalid_weights: u64,
    /// Fragments beyond the capacity.
    pub dropped: u64,
}

impl Image {
    /// Adds the rows below.
    pub fn append(&mut self, below: Self) {
        self.texels.extend(below.texels);
        self.times = self.times.plus(below.times);
        self.invalid_weights += below.invalid_weights;
        self.dropped += below.dropped;
    }

    /// Whether there is a pixel that a shader did not finish.
    pub fn is_unfinished(&self) -> bool {
        self.texels.as_chunks::<4>().0.iter().any(|texel| texel[3] <= f32::MIN)
    }
}

/// A device and what has been made for it.
#[derive(Debug)]
pub struct Gpu {
    pub connection: Connection,
    pub layouts: Layouts,
    /// Where shaders count fragments whose weight is none, and those that are dropped.
    counters: Buffer,
    /// What was drawn into last.
    pub(super) kept: Kept,
}

/// Targets, an image and a pool of nodes that wait for the next call of their kind: a device takes milliseconds to make them.
#[derive(Debug, Default)]
pub struct Kept {
    pub(super) targets: Option<Targets>,
    pub(super) canvas: Option<Canvas>,
    pub(super) pool: Option<Pool>,
}

impl Kept {
    /// Bytes of each, at most.
    const MOST: u64 = 256 << 20;

    /// The canvas for so many rows of a form's image.
    pub(super) fn canvas(&mut self, connection: &Connection, form: &Form, size: (u32, u32)) -> Canvas {
        Canvas::like(self.canvas.take(), connection, size, textures(form))
    }

    /// Keeps a pool, which has grown to what was drawn last.
    pub(super) fn keep_pool(&mut self, pool: Option<Pool>) {
        self.pool = pool.filter(|pool| pool.bytes() <= Self::MOST);
    }

    /// Keeps what can be used again.
    pub(super) fn keep(&mut self, targets: Option<Targets>, canvas: Canvas) {
        if let Some(targets) = targets.filter(|targets| targets.bytes() <= Self::MOST) {
            self.targets = Some(targets);
        }
        self.canvas = Some(canvas).filter(|canvas| canvas.bytes() <= Self::MOST);
    }
}

/// Whether to stop.
pub type Stop<'a> = &'a (dyn Fn() -> bool + Sync);

/// Resources by their bindings.
pub(super) fn group(
    connection: &Connection,
    layout: &BindGroupLayout,
    resources: &[BindingResource<'_>],
) -> BindGroup {
    let entries: Vec<_> = resources
        .iter()
        .zip(0..)
        .map(|(resource, binding)| BindGroupEntry { binding, resource: resource.clone() })
        .collect();
    connection.device.create_bind_group(&BindGroupDescriptor { label: None, layout, entries: &entries })
}

impl Gpu {
    /// A device of which nothing has been asked yet.
    pub fn new(connection: Connection) -> Self {
        let layouts = Layouts::new(&connection.device);
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC;
        let counters = buffer(&connection, "counters", 8, usage);
        Self { connection, layouts, counters, kept: Kept::default() }
    }

    /// What shaders know of the image, some of its rows and the technique's params.
    pub(super) fn frame(&self, picture: &Picture, rows: &Range<u32>, params: &[u32]) -> BindGroup {
        let (x, y) = picture.viewport.center();
        #[expect(clippy::cast_precision_loss, reason = "a power of two")]
        let half = (picture.viewport.size / 2) as f32;
        let [r, g, b] = picture.background.map(f32::to_bits);
        let size = [picture.width, picture.height, rows.start, rows.end - rows.start];
        let view = [x.cast_unsigned(), y.cast_unsigned(), half.to_bits(), picture.has_opaque.into()];
        let frame = [size, view, [r, g, b, 0]];
        let uniform = |words: &[u32]| {
            let mut bytes = bytes_of(words).to_vec();
            // blocks are whole multiples of 16 bytes, and one at least
            bytes.resize(bytes.len().max(1).next_multiple_of(16), 0);
            let buffer = buffer(&self.connection, "uniform", bytes.len() as u64, BufferUsages::UNIFORM);
            self.connection.queue.write_buffer(&buffer, 0, &bytes);
            buffer
        };
        let (frame, params) = (uniform(frame.as_flattened()), uniform(params));
        group(
            &self.connection,
            &self.layouts.frame,
            &[
                frame.as_entire_binding(),
                BindingResource::TextureView(&picture.opaque_depth),
                BindingResource::TextureView(&picture.opaque_color),
                params.as_entire_binding(),
                self.counters.as_entire_binding(),
            ],
        )
    }

    /// Makes the image of a form.
    ///
    /// # Errors
    /// [`Error::Argument`] for what the device cannot do, [`Error::Memory`] for what it has no room for, [`Error::Gpu`] and
    /// [`Error::Cancelled`].
    pub fn image(
        &mut self,
        picture: &Picture,
        form: &Form,
        raster: RasterPath,
        stop: Stop<'_>,
    ) -> Result<Image> {
        if form.counts() {
            self.connection.queue.write_buffer(&self.counters, 0, &[0; 8]);
        }
        let mut image = match &form.path {
            _ if raster == RasterPath::Compute => self.tiled(picture, form, stop),
            Path::Blended(blending) => self.blended(picture, form, blending, stop),
            Path::Listed(_) | Path::Streamed(_) => {
                self.listed(picture, form, raster == RasterPath::LinkedLists, stop)
            }
            Path::Sampled(sampling) => self.sampled(picture, form, sampling, stop),
            Path::Peeled(peeling) => self.peeled(picture, form, peeling, stop),
        }?;
        if form.counts() {
            let (counts, _) = Recorder::new(&self.connection, stop).finish::<u32>(&self.counters, 8)?;
            [image.invalid_weights, image.dropped] = [counts[0].into(), counts[1].into()];
        }
        Ok(image)
    }

    pub(super) fn most_bytes(&self) -> u64 {
        let limits = &self.connection.limits;
        limits.max_storage_buffer_binding_size.min(limits.max_buffer_size)
    }

    /// As many rows at a time as fit into one buffer.
    pub(super) fn bands_of_rows(&self, picture: &Picture, form: &Form) -> Vec<Range<u32>> {
        let most = self.rows_per_band(picture, form);
        let starts = picture.part.clone().step_by(most as usize);
        starts.map(|first| first..(first + most).min(picture.part.end)).collect()
    }

    pub(super) fn rows_per_band(&self, picture: &Picture, form: &Form) -> u32 {
        let row = textures(form) as u64 * landed_row(picture.width);
        u32::try_from(self.most_bytes() / row).unwrap_or(u32::MAX).max(1)
    }
}

/// Makes and reads back some rows of the image.
#[expect(clippy::too_many_arguments, reason = "a pass and all that it reads")]
pub(super) fn resolve(
    connection: &Connection,
    layouts: &Layouts,
    mut recorder: Recorder<'_>,
    picture: &Picture,
    form: &Form,
    band: &Range<u32>,
    pipeline: &wgpu::ComputePipeline,
    [frame, source]: [&BindGroup; 2],
    image: &mut Image,
) -> Result<()> {
    let bytes = texel_bytes(form) * u64::from(picture.width) * u64::from(band.end - band.start);
    let output = buffer(connection, "image", bytes, BufferUsages::STORAGE | BufferUsages::COPY_SRC);
    let written = group(connection, &layouts.output, &[output.as_entire_binding()]);
    dispatch(&mut recorder, Stage::Resolve, pipeline, &[frame, source, &written], picture, band)?;
    let (texels, times): (Vec<f32>, _) = recorder.finish(&output, bytes)?;
    if image.texels.is_empty() {
        image.texels = texels;
    } else {
        image.texels.extend(texels);
    }
    image.times = image.times.plus(times);
    Ok(())
}

pub(super) fn texel_bytes(form: &Form) -> u64 {
    textures(form) as u64 * TEXEL
}

/// Texels of a pixel of the image.
fn textures(form: &Form) -> usize {
    if form.colored_transmittance { 2 } else { 1 }
}

pub(super) fn dispatch(
    recorder: &mut Recorder<'_>,
    stage: Stage,
    pipeline: &wgpu::ComputePipeline,
    groups: &[&BindGroup],
    picture: &Picture,
    band: &Range<u32>,
) -> Result<()> {
    recorder.compute(stage, |pass| {
        pass.set_pipeline(pipeline);
        for (group, index) in groups.iter().zip([0, 2, 3]) {
            pass.set_bind_group(index, *group, &[]);
        }
        pass.dispatch_workgroups(picture.width.div_ceil(8), (band.end - band.start).div_ceil(8), 1);
    })
}

pub(super) fn attachment(
    view: &TextureView,
    load: LoadOp<Color>,
    store: StoreOp,
) -> Option<RenderPassColorAttachment<'_>> {
    Some(RenderPassColorAttachment {
        view,
        depth_slice: None,
        resolve_target: None,
        ops: Operations { load, store },
    })
}

/// Draws into targets that hold these rows of the image; shaders hear which of a pass's attachments is the first.
pub(super) fn draw_primitives(
    pass: &mut RenderPass<'_>,
    picture: &Picture,
    rows: &Range<u32>,
    first_output: u32,
) {
    #[expect(clippy::cast_precision_loss, reason = "whole numbers of less than 2^24")]
    let ((x, y), size) =
        ((picture.viewport.origin.0 as f32, picture.viewport.origin.1 as f32), picture.viewport.size as f32);
    #[expect(clippy::cast_precision_loss, reason = "likewise")]
    pass.set_viewport(x, y - rows.start as f32, size, size, 0.0, 1.0);
    pass.set_scissor_rect(0, 0, picture.width, rows.end - rows.start);
    for (geometry, primitives) in &picture.batches {
        pass.set_bind_group(1, geometry, &[]);
        pass.draw(0..3 * primitives, first_output..first_output + 1);
    }
}
