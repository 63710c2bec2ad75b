//! Passes: blending fragments in render targets, and making an image of what that leaves.

use super::device::Connection;
use super::form::tiled::RasterPath;
use super::form::{Blending, Form, Path, background_module};
use super::layouts::{Draws, Entry, Layouts, blended, plain};
use super::picture::{Picture, buffer, bytes_of, texture};
use super::recorder::{Recorder, Stage, Times};
use crate::error::Result;
use std::ops::Range;
use wgpu::{
    BindGroup, BindGroupDescriptor, BindGroupEntry, BindGroupLayout, BindingResource, BufferUsages, Color,
    ColorWrites, LoadOp, Operations, RenderPass, RenderPassColorAttachment, StoreOp, TextureFormat,
    TextureUsages, TextureView, TextureViewDescriptor,
};

/// Bytes of a pixel in the image that a resolve writes.
const TEXEL: u64 = 16;

/// An image, and how long it took on the device.
#[derive(Debug)]
pub struct Image {
    /// Linear colour and the background's share of each pixel, or colour, nothing, the background's share per channel and
    /// nothing.
    pub texels: Vec<f32>,
    pub times: Times,
}

/// A device and what has been made for it.
#[derive(Debug)]
pub struct Gpu {
    pub connection: Connection,
    pub layouts: Layouts,
}

pub(super) type Stop<'a> = &'a (dyn Fn() -> bool + Sync);

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
        if raster == RasterPath::Compute {
            return self.tiled(picture, form, stop);
        }
        match &form.path {
            Path::Blended(blending) => self.blended(picture, form, blending, stop),
            Path::Listed(listing) => self.listed(picture, form, (listing.resolve, listing.sorted), &[], stop),
            Path::Streamed(stream) => {
                let flag = |on: bool| f64::from(u8::from(on));
                let (zero_fragments, backwards) = (form.shows_zero_fragments, stream.backwards);
                let constants =
                    [("backwards", flag(backwards)), ("shows_zero_fragments", flag(zero_fragments))];
                self.listed(picture, form, ("resolve_stream", stream.sorted), &constants, stop)
            }
            Path::Peeled(peeling) => self.peeled(picture, form, peeling, stop),
        }
    }

    pub(super) fn most_bytes(&self) -> u64 {
        let limits = &self.connection.limits;
        limits.max_storage_buffer_binding_size.min(limits.max_buffer_size)
    }

    /// Hardware blending, then the resolve.
    fn blended(
        &mut self,
        picture: &Picture,
        form: &Form,
        blending: &Blending,
        stop: Stop<'_>,
    ) -> Result<Image> {
        let formats = self.connection.target_formats(blending)?;
        let size = (picture.width, picture.height);
        let usage = TextureUsages::RENDER_ATTACHMENT | TextureUsages::TEXTURE_BINDING;
        let views: Vec<TextureView> = formats
            .iter()
            .map(|format| {
                texture(&self.connection, "target", size, *format, usage)
                    .create_view(&TextureViewDescriptor::default())
            })
            .collect();
        let params: Vec<_> = form.numbers.iter().map(|number| number.bits()).collect();
        let module = form.module();
        let bands = self.bands_of_rows(picture, form);
        let second = views.get(1).unwrap_or(&picture.opaque_depth);
        let targets = group(
            &self.connection,
            &self.layouts.targets,
            &[BindingResource::TextureView(&views[0]), BindingResource::TextureView(second)],
        );
        let mut image = Image { texels: Vec::new(), times: Times::default() };
        for band in &bands {
            let frame = self.frame(picture, band, &params);
            let Self { connection, layouts } = self;
            let mut recorder = Recorder::new(connection, stop);
            if band.start == 0 {
                let targets = (&views[..], &formats[..]);
                draw_blended(
                    connection,
                    layouts,
                    &mut recorder,
                    picture,
                    form,
                    blending,
                    &module,
                    targets,
                    &frame,
                )?;
            }
            let entry = Entry { module: &module, point: blending.resolve };
            let pipeline = layouts.compute(&connection.device, entry, false, true, &[]);
            resolve(
                connection,
                layouts,
                recorder,
                picture,
                form,
                band,
                &pipeline,
                [&frame, &targets],
                &mut image,
            )?;
        }
        Ok(image)
    }

    /// As many rows at a time as fit into one buffer.
    pub(super) fn bands_of_rows(&self, picture: &Picture, form: &Form) -> Vec<Range<u32>> {
        let most = self.rows_per_band(picture, form);
        let starts = (0..picture.height).step_by(most as usize);
        starts.map(|first| first..(first + most).min(picture.height)).collect()
    }

    pub(super) fn rows_per_band(&self, picture: &Picture, form: &Form) -> u32 {
        let row = texel_bytes(form) * u64::from(picture.width);
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
    if form.colored_transmittance { 2 * TEXEL } else { TEXEL }
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

pub(super) fn draw_primitives(pass: &mut RenderPass<'_>, picture: &Picture, rows: &Range<u32>) {
    #[expect(clippy::cast_precision_loss, reason = "whole numbers of less than 2^24")]
    let ((x, y), size) =
        ((picture.viewport.origin.0 as f32, picture.viewport.origin.1 as f32), picture.viewport.size as f32);
    pass.set_viewport(x, y, size, size, 0.0, 1.0);
    pass.set_scissor_rect(0, rows.start, picture.width, rows.end - rows.start);
    for (geometry, primitives) in &picture.batches {
        pass.set_bind_group(1, geometry, &[]);
        pass.draw(0..3 * primitives, 0..1);
    }
}

#[expect(clippy::too_many_arguments, reason = "a pass and all that it reads")]
fn draw_blended(
    connection: &Connection,
    layouts: &mut Layouts,
    recorder: &mut Recorder<'_>,
    picture: &Picture,
    form: &Form,
    blending: &Blending,
    module: &str,
    (views, formats): (&[TextureView], &[TextureFormat]),
    frame: &BindGroup,
) -> Result<()> {
    if blending.over_background {
        let entry = Entry { module: &background_module(), point: "show_background" };
        let states = [plain(formats[0], ColorWrites::ALL)];
        let pipeline = layouts.render(&connection.device, entry, Draws::Background, &states);
        let target = attachment(&views[0], LoadOp::Clear(Color::TRANSPARENT), StoreOp::Store);
        recorder.render(Stage::Raster, &[target], |pass| {
            pass.set_pipeline(&pipeline);
            pass.set_bind_group(0, frame, &[]);
            pass.draw(0..3, 0..1);
        })?;
    }
    let states: Vec<_> =
        blending.targets.iter().zip(formats).map(|(target, format)| blended(target, *format)).collect();
    let zero_fragments = form.shows_zero_fragments;
    let draws = Draws::Primitives { perspective: picture.perspective, zero_fragments };
    let pipeline = layouts.render(&connection.device, Entry { module, point: blending.draw }, draws, &states);
    let load = |(i, [r, g, b, a]): (usize, [f64; 4])| match i {
        0 if blending.over_background => LoadOp::Load,
        _ => LoadOp::Clear(Color { r, g, b, a }),
    };
    let clears = blending.targets.iter().map(|target| target.clear).enumerate().map(load);
    let targets: Vec<_> =
        views.iter().zip(clears).map(|(view, load)| attachment(view, load, StoreOp::Store)).collect();
    recorder.render(Stage::Raster, &targets, |pass| {
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, frame, &[]);
        draw_primitives(pass, picture, &(0..picture.height));
    })
}
