//! Sample masks: fragments cover samples of a multisampled depth buffer, as many of a pixel's at a time as the device has; then
//! all fragments once more, which find what of them is shown.

use super::device::Connection;
use super::draw::{Gpu, Image, Stop, attachment, draw_primitives, group};
use super::draws::Draws;
use super::form::{BlendTarget, Form, Sampling};
use super::layouts::{Entry, blended, plain};
use super::peel::ends_ties_by_order;
use super::picture::Picture;
use super::recorder::{PASSES, Recorder, Stage, Times};
use crate::error::{Error, Result};
use std::sync::Arc;
use wgpu::{
    BindGroup, BindingResource, Color, ColorWrites, Extent3d, LoadOp, RenderPipeline, StoreOp,
    TextureDescriptor, TextureDimension, TextureFormat, TextureUsages, TextureView, TextureViewDescriptor,
};

const DEPTHS: TextureFormat = TextureFormat::Depth32Float;
/// Of primitives, in two halves: every device has samples of it.
const OWNERS: TextureFormat = TextureFormat::Rg16Uint;
/// Samples of a pixel that a device may have, the most first; all have 4.
const COUNTS: [u32; 3] = [16, 8, 4];

/// Parts that one recorder times, each two passes over the geometry.
const PARTS: u32 = PASSES / 2;

impl Connection {
    /// How many samples of a pixel the device draws at a time.
    ///
    /// # Errors
    /// [`Error::Argument`] if it does not.
    pub fn samples_at_a_time(&self) -> Result<u32> {
        let has = |count: &&u32| {
            [DEPTHS, OWNERS]
                .iter()
                .all(|&format| self.format_features(format).flags.sample_count_supported(**count))
        };
        COUNTS.iter().find(has).copied().ok_or_else(|| {
            let problem =
                format!("{} has no samples of a pixel; path=\"hardware\" does without", self.info.name);
            Error::argument("path", problem)
        })
    }
}

/// What is drawn into, and what draws.
struct Sampler<'a> {
    picture: &'a Picture,
    depths: TextureView,
    owners: TextureView,
    sums: Vec<TextureView>,
    /// The samples, for whoever looks at them.
    shown: BindGroup,
    cover: Arc<RenderPipeline>,
    look: Arc<RenderPipeline>,
}

/// A target of the image's size with so many samples.
fn target(connection: &Connection, picture: &Picture, format: TextureFormat, samples: u32) -> TextureView {
    let texture = connection.device.create_texture(&TextureDescriptor {
        label: Some("samples"),
        size: Extent3d { width: picture.width, height: picture.height, depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: samples,
        dimension: TextureDimension::D2,
        format,
        usage: TextureUsages::RENDER_ATTACHMENT | TextureUsages::TEXTURE_BINDING,
        view_formats: &[],
    });
    texture.create_view(&TextureViewDescriptor::default())
}

impl Gpu {
    /// Every part of the samples, and the resolve.
    pub(super) fn sampled(
        &mut self,
        picture: &Picture,
        form: &Form,
        sampling: &Sampling,
        stop: Stop<'_>,
    ) -> Result<Image> {
        let samples = self.connection.samples_at_a_time()?;
        let params: Vec<_> = form.numbers.iter().map(|number| number.bits()).collect();
        let frame = self.frame(picture, &(0..picture.height), &params);
        let sampler = self.sampler(picture, form, sampling, samples)?;
        let parts: Vec<_> = (0..sampling.samples.div_ceil(samples)).collect();
        let mut times = Times::default();
        for parts in parts.chunks(PARTS as usize) {
            let mut recorder = Recorder::new(&self.connection, stop);
            for &part in parts {
                sampler.draw(&mut recorder, sampling, part, &frame)?;
            }
            times = times.plus(recorder.finish_all(&[])?.1);
        }
        let mut image = Image { times, ..Image::default() };
        self.resolve_targets(picture, form, sampling.resolve, &sampler.sums, &mut image, stop)?;
        Ok(image)
    }

    fn sampler<'a>(
        &mut self,
        picture: &'a Picture,
        form: &Form,
        sampling: &Sampling,
        count: u32,
    ) -> Result<Sampler<'a>> {
        let Self { connection, layouts, .. } = self;
        let formats = sampling.sums.iter().map(|sum| connection.target_format(sum));
        let formats = formats.collect::<Result<Vec<_>>>()?;
        let [depths, owners] = [DEPTHS, OWNERS].map(|format| target(connection, picture, format, count));
        let sums = formats.iter().map(|format| target(connection, picture, *format, 1)).collect();
        let layout = layouts.samples.clone();
        let shown = group(connection, &layout, &[&depths, &owners].map(BindingResource::TextureView));
        let module = form.module();
        let entry = |point| Entry { module: &module, point };
        let draws =
            |covers| Draws::Samples { count, covers, known: picture.known(form.shows_zero_fragments) };
        let device = &connection.device;
        let owner = plain(OWNERS, ColorWrites::ALL);
        let depth = Some(ends_ties_by_order(DEPTHS));
        let cover = layouts.render_with(device, entry(sampling.cover), draws(true), &[owner], None, depth);
        let states: Vec<_> =
            sampling.sums.iter().zip(&formats).map(|(sum, format)| blended(sum, *format)).collect();
        let look =
            layouts.render_with(device, entry(sampling.look), draws(false), &states, Some(&layout), None);
        Ok(Sampler { picture, depths, owners, sums, shown, cover, look })
    }
}

impl Sampler<'_> {
    /// Some samples of every pixel: what they show, and what that adds to the sums.
    fn draw(
        &self,
        recorder: &mut Recorder<'_>,
        sampling: &Sampling,
        part: u32,
        frame: &BindGroup,
    ) -> Result<()> {
        let rows = 0..self.picture.height;
        let owners = attachment(&self.owners, LoadOp::Clear(Color::TRANSPARENT), StoreOp::Store);
        let depths = Some((&self.depths, StoreOp::Store));
        recorder.render_with_depth(Stage::Raster, &[owners], depths, |pass| {
            pass.set_pipeline(&self.cover);
            pass.set_bind_group(0, frame, &[]);
            draw_primitives(pass, self.picture, &rows, part);
        })?;
        let sum = |(view, sum): (_, &BlendTarget)| {
            let [r, g, b, a] = sum.clear;
            let load = if part == 0 { LoadOp::Clear(Color { r, g, b, a }) } else { LoadOp::Load };
            attachment(view, load, StoreOp::Store)
        };
        let sums: Vec<_> = self.sums.iter().zip(&sampling.sums).map(sum).collect();
        recorder.render(Stage::Raster, &sums, |pass| {
            pass.set_pipeline(&self.look);
            pass.set_bind_group(0, frame, &[]);
            pass.set_bind_group(2, &self.shown, &[]);
            draw_primitives(pass, self.picture, &rows, part);
        })
    }
}
