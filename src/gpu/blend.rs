//! Render targets that the blend unit works on: passes over the geometry, each of which may read what those before it
//! left, then one over the image.

use super::canvas::{Canvas, Resolve};
use super::device::Connection;
use super::draw::{Gpu, Image, Stop, attachment, draw_primitives, texel_bytes};
use super::draws::{Draws, Known};
use super::form::{BlendTarget, Blending, Draw, Form, background_module};
use super::layouts::{Entry, Layouts, Reading, Reads, attachment_bytes, blended, plain};
use super::picture::{Picture, buffer};
use super::recorder::{Recorder, Stage};
use crate::error::{Error, Result};
use std::ops::Range;
use wgpu::{
    BindGroup, BindGroupDescriptor, BindGroupEntry, BindingResource, Buffer, BufferUsages, Color,
    ColorWrites, DeviceType, Extent3d, LoadOp, StoreOp, TextureDescriptor, TextureDimension, TextureFormat,
    TextureUsages, TextureView, TextureViewDescriptor, TextureViewDimension,
};

/// Attachments that a shader which draws in parts gives at a time, at most: those of `blocks/outputs.wgsl`.
const OUTPUTS: u32 = 8;

/// How many times as much as a buffer may hold all targets take together; an image of more is made in parts.
const BUFFERS: u64 = 4;

/// Rows of which fewer at a time are not worth it where all would fit.
const LEAST_ROWS: u32 = 256;

/// The targets of a form, for as many rows of the image as are worked on at a time.
#[derive(Debug)]
pub struct Targets {
    /// What they are targets of.
    made_for: MadeFor,
    formats: Vec<Option<TextureFormat>>,
    /// All layers of each.
    views: Vec<TextureView>,
    /// Each layer of each.
    layers: Vec<Vec<TextureView>>,
    readings: Vec<Option<Reading>>,
    words: Option<Buffer>,
}

/// Rows of the image on their way through a form.
struct Job<'a> {
    connection: &'a Connection,
    picture: &'a Picture,
    form: &'a Form,
    blending: &'a Blending,
    module: &'a str,
    targets: &'a Targets,
    frame: &'a BindGroup,
    rows: &'a Range<u32>,
}

impl Gpu {
    /// Hardware blending, then the resolve, in as many parts of the image as the targets ask for.
    pub(super) fn blended(
        &mut self,
        picture: &Picture,
        form: &Form,
        blending: &Blending,
        stop: Stop<'_>,
    ) -> Result<Image> {
        let formats = self.connection.target_formats(blending)?;
        let most = self.rows_of_targets(picture, form, blending, &formats)?;
        let size = (picture.width, most);
        let targets = Targets::like(self.kept.targets.take(), &self.connection, blending, formats, size);
        let canvas = self.kept.canvas(&self.connection, form, size);
        let params: Vec<_> = form.numbers.iter().map(|number| number.bits()).collect();
        let module = form.module();
        let mut image = Image::default();
        for first in (0..picture.height).step_by(most as usize) {
            let rows = first..(first + most).min(picture.height);
            let frame = self.frame(picture, &rows, &params);
            let Self { connection, layouts, .. } = self;
            let (targets, frame, module, rows) = (&targets, &frame, module.as_str(), &rows);
            let job = Job { connection, picture, form, blending, module, targets, frame, rows };
            job.run(layouts, stop, &canvas, &mut image)?;
        }
        self.kept.keep(Some(targets), canvas);
        Ok(image)
    }

    /// How many rows of the image fit into the targets, the words and the buffer of the result.
    fn rows_of_targets(
        &self,
        picture: &Picture,
        form: &Form,
        blending: &Blending,
        formats: &[Option<TextureFormat>],
    ) -> Result<u32> {
        let (width, most) = (u64::from(picture.width), self.most_bytes());
        let words = 4 * u64::from(blending.words) * width;
        if words > most {
            return Err(Error::Memory(format!(
                "the {} words of each of a row's {width} pixels; {} keeps {} at a time: a smaller image has fewer in a row",
                blending.words,
                self.connection.info.name,
                most / 4
            )));
        }
        let texels = blending.targets.iter().zip(formats);
        let bytes = texels.map(|(target, format)| {
            let texel = format.and_then(|format| format.block_copy_size(None)).unwrap_or(0);
            u64::from(texel) * target.layers.map_or(1, |(_, layers)| layers.into())
        });
        let rows = |all: u64, row: u64| u32::try_from(all / row.max(1)).unwrap_or(u32::MAX);
        let of_targets = bytes.sum::<u64>() * width;
        let fit = rows(BUFFERS * most, of_targets).min(rows(most, words));
        let cached = cached_bytes(self.connection.info.device_type, picture.primitives());
        let cached = rows(cached, of_targets + texel_bytes(form) * width).max(LEAST_ROWS);
        Ok(in_even_parts(picture.height, fit.min(self.rows_per_band(picture, form)).min(cached)))
    }
}

/// Bytes of targets and image that are best worked on at a time. Where the device is the processor, they stay in its caches
/// from one pass to the next, if drawing the geometry once more for each part of the image costs little beside.
fn cached_bytes(device: DeviceType, primitives: u32) -> u64 {
    const CACHE: u64 = 20 << 20;
    const FEW_PRIMITIVES: u32 = 4096;
    if device == DeviceType::Cpu && primitives <= FEW_PRIMITIVES { CACHE } else { u64::MAX }
}

/// Rows of the parts of an image of which no more than `most` fit: about as many in each.
fn in_even_parts(height: u32, most: u32) -> u32 {
    let parts = height.div_ceil(most.max(1)).max(1);
    height.div_ceil(parts).max(1)
}

/// What tells targets apart: their formats and numbers of layers, the words beside them, and their size.
#[derive(Debug, PartialEq, Eq)]
struct MadeFor {
    targets: Vec<(Option<TextureFormat>, Option<u32>)>,
    words: u32,
    size: (u32, u32),
}

impl Targets {
    /// Those of a form: the ones that are there, if they are such. Every pass begins by clearing what it draws into.
    fn like(
        kept: Option<Self>,
        connection: &Connection,
        blending: &Blending,
        formats: Vec<Option<TextureFormat>>,
        size: (u32, u32),
    ) -> Self {
        let layers = blending.targets.iter().map(|target| target.layers.map(|(_, layers)| layers));
        let targets = formats.iter().copied().zip(layers).collect();
        let made_for = MadeFor { targets, words: blending.words, size };
        kept.filter(|kept| kept.made_for == made_for)
            .unwrap_or_else(|| Self::new(connection, blending, formats, made_for))
    }

    fn new(
        connection: &Connection,
        blending: &Blending,
        formats: Vec<Option<TextureFormat>>,
        made_for: MadeFor,
    ) -> Self {
        let size = made_for.size;
        let mut made = Self {
            made_for,
            formats,
            views: Vec::new(),
            layers: Vec::new(),
            readings: Vec::new(),
            words: (blending.words > 0).then(|| {
                let bytes = 4 * u64::from(blending.words) * u64::from(size.0) * u64::from(size.1);
                buffer(connection, "words", bytes, BufferUsages::STORAGE)
            }),
        };
        for (target, format) in blending.targets.iter().zip(made.formats.clone()) {
            made.add(connection, target, format, size);
        }
        made.readings.push(made.words.is_some().then_some(Reading::Words));
        made
    }

    fn add(
        &mut self,
        connection: &Connection,
        target: &BlendTarget,
        format: Option<TextureFormat>,
        size: (u32, u32),
    ) {
        let (width, height) = if format.is_some() { size } else { (1, 1) };
        let count = target.layers.map_or(1, |(_, layers)| layers);
        let depth_or_array_layers = if format.is_some() { count } else { 1 };
        let texture = connection.device.create_texture(&TextureDescriptor {
            label: Some("target"),
            size: Extent3d { width, height, depth_or_array_layers },
            mip_level_count: 1,
            sample_count: 1,
            dimension: TextureDimension::D2,
            format: format.unwrap_or(TextureFormat::R8Unorm),
            usage: TextureUsages::RENDER_ATTACHMENT | TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        });
        let (dimension, reading) = match target.layers {
            Some(_) => (TextureViewDimension::D2Array, Reading::Array),
            None => (TextureViewDimension::D2, Reading::Texture),
        };
        let view = |dimension, base_array_layer, layers| {
            texture.create_view(&TextureViewDescriptor {
                dimension: Some(dimension),
                base_array_layer,
                array_layer_count: Some(layers),
                ..Default::default()
            })
        };
        self.views.push(view(dimension, 0, depth_or_array_layers));
        let each = 0..depth_or_array_layers;
        self.layers.push(each.map(|layer| view(TextureViewDimension::D2, layer, 1)).collect());
        self.readings.push(Some(reading));
    }

    /// Their bytes on the device.
    pub fn bytes(&self) -> u64 {
        let texel = |format: TextureFormat| u64::from(format.block_copy_size(None).unwrap_or(0));
        let targets = self.made_for.targets.iter();
        let bytes = targets.map(|(format, layers)| format.map_or(0, texel) * u64::from(layers.unwrap_or(1)));
        let (width, height) = self.made_for.size;
        (bytes.sum::<u64>() + 4 * u64::from(self.made_for.words)) * u64::from(width) * u64::from(height)
    }

    /// What a shader finds that may read the targets before this one.
    fn before(&self, end: usize) -> Vec<Option<Reading>> {
        let is_there = |i: usize| i < end || i == self.views.len();
        self.readings.iter().enumerate().map(|(i, reading)| reading.filter(|_| is_there(i))).collect()
    }

    /// ... as a bind group; none where that is nothing.
    fn group(
        &self,
        connection: &Connection,
        layouts: &mut Layouts,
        readings: &[Option<Reading>],
    ) -> Option<BindGroup> {
        let layout = layouts.second(&connection.device, reads(readings))?;
        let resource = |i: usize| match (self.views.get(i), &self.words) {
            (Some(view), _) => BindingResource::TextureView(view),
            (None, Some(words)) => words.as_entire_binding(),
            (None, None) => unreachable!("there are no more readings"),
        };
        let there = readings.iter().enumerate().filter(|(_, reading)| reading.is_some());
        let binding = |i: usize| u32::try_from(i).unwrap_or_else(|_| unreachable!("few targets"));
        let entries: Vec<_> =
            there.map(|(i, _)| BindGroupEntry { binding: binding(i), resource: resource(i) }).collect();
        let descriptor = BindGroupDescriptor { label: Some("targets"), layout: &layout, entries: &entries };
        Some(connection.device.create_bind_group(&descriptor))
    }
}

fn reads(readings: &[Option<Reading>]) -> Reads<'_> {
    if readings.iter().all(Option::is_none) { Reads::Nothing } else { Reads::Targets(readings) }
}

/// Attachments, (target, layer), in parts of at most so many and of so many bytes.
fn in_parts(
    attachments: impl Iterator<Item = (usize, usize)>,
    formats: &[Option<TextureFormat>],
    most: u32,
    most_bytes: u32,
) -> Vec<Vec<(usize, usize)>> {
    let bytes =
        |part: &[(usize, usize)]| attachment_bytes(part.iter().filter_map(|(target, _)| formats[*target]));
    let (mut parts, mut part) = (Vec::new(), Vec::new());
    for attached in attachments {
        part.push(attached);
        if part.len() > 1 && (part.len() > most as usize || bytes(&part) > most_bytes) {
            part.pop();
            parts.push(std::mem::replace(&mut part, vec![attached]));
        }
    }
    parts.push(part);
    parts
}

impl Job<'_> {
    fn run(&self, layouts: &mut Layouts, stop: Stop<'_>, canvas: &Canvas, image: &mut Image) -> Result<()> {
        let parts: Vec<_> = self.blending.draws.iter().map(|draw| self.parts(draw)).collect();
        // the background comes first and the image last
        let passes = 2 + parts.iter().map(Vec::len).sum::<usize>();
        let passes = u32::try_from(passes).unwrap_or(u32::MAX);
        let mut recorder = Recorder::expecting(passes, self.connection, stop);
        if let Some(words) = &self.targets.words {
            recorder.clear(words);
        }
        if self.blending.over_background {
            self.show_background(layouts, &mut recorder)?;
        }
        for (draw, parts) in self.blending.draws.iter().zip(&parts) {
            for part in parts {
                self.draw(layouts, &mut recorder, draw, part)?;
            }
        }
        let readings = self.targets.before(self.targets.views.len());
        let group = self.targets.group(self.connection, layouts, &readings);
        let Some(targets) = group else { unreachable!("there is a target") };
        let resolve = Resolve {
            shader: Entry { module: self.module, point: self.blending.resolve },
            reads: reads(&readings),
            targets_are_whole: false,
            groups: [self.frame, &targets],
            rows: self.rows,
        };
        resolve.run(self.connection, layouts, recorder, self.picture, canvas, image)
    }

    fn show_background(&self, layouts: &mut Layouts, recorder: &mut Recorder<'_>) -> Result<()> {
        let Some(format) = self.targets.formats[0] else { unreachable!("it is drawn into") };
        let entry = Entry { module: &background_module(), point: "show_background" };
        let states = [plain(format, ColorWrites::ALL)];
        let device = &self.connection.device;
        let pipeline = layouts.render(device, entry, Draws::Background, Reads::Nothing, &states);
        let view = &self.targets.layers[0][0];
        let target = attachment(view, LoadOp::Clear(Color::TRANSPARENT), StoreOp::Store);
        recorder.render(Stage::Raster, &[target], |pass| {
            pass.set_pipeline(&pipeline);
            pass.set_bind_group(0, self.frame, &[]);
            pass.draw(0..3, 0..1);
        })
    }

    /// The attachments of a pass, (target, layer), as many at a time as the device takes.
    fn parts(&self, draw: &Draw) -> Vec<Vec<(usize, usize)>> {
        let layers = |target: usize| (0..self.targets.layers[target].len()).map(move |i| (target, i));
        let all = draw.targets.clone().flat_map(layers);
        if !draw.in_parts {
            return vec![all.collect()];
        }
        let limits = &self.connection.limits;
        let most = limits.max_color_attachments.min(OUTPUTS);
        in_parts(all, &self.targets.formats, most, limits.max_color_attachment_bytes_per_sample)
    }

    /// Draws the geometry into some of a pass's attachments.
    fn draw(
        &self,
        layouts: &mut Layouts,
        recorder: &mut Recorder<'_>,
        draw: &Draw,
        part: &[(usize, usize)],
    ) -> Result<()> {
        let device = &self.connection.device;
        let first_output = part.first().map_or(0, |&first| self.place_of(draw, first));
        let known = self.picture.known(self.form.shows_zero_fragments);
        let draws = Draws::Primitives(Known { near_depths: self.blending.near_depths, ..known });
        let state = |&(i, _): &(usize, usize)| {
            let Some(format) = self.targets.formats[i] else { unreachable!("it is drawn into") };
            blended(&self.blending.targets[i], format)
        };
        let states: Vec<_> = part.iter().map(state).collect();
        let readings = self.targets.before(draw.targets.start);
        let read = self.targets.group(self.connection, layouts, &readings);
        let entry = Entry { module: self.module, point: draw.shader };
        let pipeline = layouts.render(device, entry, draws, reads(&readings), &states);
        let attached = |&(i, layer): &(usize, usize)| {
            let [r, g, b, a] = self.blending.targets[i].clear;
            let load = match i {
                0 if self.blending.over_background => LoadOp::Load,
                _ => LoadOp::Clear(Color { r, g, b, a }),
            };
            attachment(&self.targets.layers[i][layer], load, StoreOp::Store)
        };
        let attachments: Vec<_> = part.iter().map(attached).collect();
        recorder.render(Stage::Raster, &attachments, |pass| {
            pass.set_pipeline(&pipeline);
            pass.set_bind_group(0, self.frame, &[]);
            if let Some(read) = &read {
                pass.set_bind_group(2, read, &[]);
            }
            draw_primitives(pass, self.picture, self.rows, first_output);
        })
    }

    /// Where among a pass's attachments one is.
    fn place_of(&self, draw: &Draw, (target, layer): (usize, usize)) -> u32 {
        let before = (draw.targets.start..target).map(|i| self.targets.layers[i].len());
        u32::try_from(before.sum::<usize>() + layer)
            .unwrap_or_else(|_| unreachable!("textures have few layers"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_of_an_image_are_about_even_and_none_is_too_large() {
        let parts = [(720, 720), (720, 455), (720, u32::MAX), (721, 360), (1, 5), (0, 7), (10, 0)];
        let rows = parts.map(|(height, most)| in_even_parts(height, most));
        assert_eq!(rows, [720, 360, 720, 241, 1, 1, 1]);
    }

    #[test]
    fn caches_count_where_the_processor_draws_little() {
        let all = [(DeviceType::Cpu, 4096), (DeviceType::Cpu, 4097), (DeviceType::DiscreteGpu, 5)];
        assert_eq!(all.map(|(device, count)| cached_bytes(device, count) < u64::MAX), [true, false, false]);
    }

    #[test]
    fn parts_hold_what_the_device_takes_and_nothing_is_left_out() {
        let formats = [Some(TextureFormat::Rgba32Float), Some(TextureFormat::R16Float)];
        let all: Vec<_> = (0..5).map(|layer| (0, layer)).chain([(1, 0)]).collect();
        let sizes = |most, bytes| {
            let parts = in_parts(all.iter().copied(), &formats, most, bytes);
            assert_eq!(parts.concat(), all);
            parts.iter().map(Vec::len).collect::<Vec<_>>()
        };
        // the least that WebGPU has, what desktops have, and the end of a part that bytes end
        assert_eq!(sizes(8, 32), [2, 2, 2]);
        assert_eq!(sizes(8, 128), [6]);
        assert_eq!(sizes(4, 128), [4, 2]);
        assert_eq!(sizes(8, 80), [5, 1]);
        assert_eq!(sizes(8, 82), [6]);
    }
}
