//! Peeling: passes over the geometry that each find the next layers of every pixel, until there are none.

use super::canvas::Resolve;
use super::device::Connection;
use super::draw::{Gpu, Image, Stop, attachment, draw_primitives, group};
use super::draws::Draws;
use super::form::{Blend, BlendTarget, Ends, Form, Peeling};
use super::layouts::{Entry, Layouts, Reading, Reads, blended, plain};
use super::picture::{Picture, buffer, texture};
use super::recorder::{PASSES, Recorder, Stage, Times};
use crate::error::{Error, Result};
use crate::format::Format;
use std::sync::Arc;
use wgpu::{
    BindGroup, BindGroupLayout, BindingResource, Buffer, BufferUsages, Color, ColorTargetState, ColorWrites,
    CompareFunction, DepthStencilState, LoadOp, RenderPipeline, StoreOp, TextureFormat, TextureUsages,
    TextureView, TextureViewDescriptor,
};

/// Peels that one recorder times, each over the geometry and over the image, besides the pass that begins.
const PEELS: usize = (PASSES as usize - 1) / 2;

/// A target that takes what it is given, and whose numbers are not the user's to choose.
const DEPTHS: BlendTarget = BlendTarget {
    param: "format",
    format: Format::F32,
    channels: 2,
    layers: None,
    clear: [-(f32::MAX as f64), -1.0, 0.0, 0.0],
    color: Blend::Max,
    alpha: Blend::Max,
};

const DEPTH_BUFFER: TextureFormat = TextureFormat::Depth32Float;

impl Connection {
    /// The formats of what a technique composites layers in.
    ///
    /// # Errors
    /// As [`Connection::target_format`], also for the frontier.
    pub fn peeling_formats(&self, peeling: &Peeling) -> Result<Vec<TextureFormat>> {
        if peeling.ends == Ends::Both && self.target_format(&DEPTHS).is_err() {
            let problem = format!(
                "without a limit they are peeled from both ends by blending f32, which {} does not (FLOAT32_BLENDABLE is \
                 missing); limited passes do without",
                self.info.name
            );
            return Err(Error::argument("passes", problem));
        }
        peeling.sums.iter().map(|target| self.target_format(target)).collect()
    }
}

/// What is drawn into, and what draws.
struct Peeler<'a> {
    picture: &'a Picture,
    peeling: &'a Peeling,
    /// Those of even passes and of odd ones, in turns.
    frontiers: [TextureView; 2],
    /// The layers that a pass finds: the nearest, or all that are furthest.
    layer: TextureView,
    sums: Vec<TextureView>,
    depth: Option<TextureView>,
    /// Not zero if a pass has found anything.
    has_peeled: Buffer,
    /// Of passes over the geometry, by the frontier that they read, and over the image, by the one that they have made.
    peel_groups: [BindGroup; 2],
    composite_groups: [BindGroup; 2],
    peel: Arc<RenderPipeline>,
    composite: Arc<RenderPipeline>,
}

fn clear_to([r, g, b, a]: [f64; 4]) -> LoadOp<Color> {
    LoadOp::Clear(Color { r, g, b, a })
}

fn frontier_state(ends: Ends) -> ColorTargetState {
    match ends {
        Ends::Nearest => plain(TextureFormat::Rg32Uint, ColorWrites::ALL),
        Ends::Both => blended(&DEPTHS, TextureFormat::Rg32Float),
    }
}

/// The frontier behind which nothing has been peeled, and the one behind which nothing is left.
fn begin_and_end(ends: Ends) -> [[f64; 4]; 2] {
    match ends {
        Ends::Nearest => [[0.0; 4], [f64::from(u32::MAX); 4]],
        Ends::Both => [[1.0, f64::from(f32::MAX), 0.0, 0.0], DEPTHS.clear],
    }
}

/// The layers of one pass that are furthest: in the order of their ids, each under those before it.
fn far_layers() -> BlendTarget {
    BlendTarget::front(DEPTHS.param, Format::F32)
}

impl<'a> Peeler<'a> {
    fn new(
        connection: &Connection,
        layouts: &mut Layouts,
        picture: &'a Picture,
        form: &Form,
        peeling: &'a Peeling,
    ) -> Result<Self> {
        let formats = connection.peeling_formats(peeling)?;
        let target = |format, more| {
            let usage = TextureUsages::RENDER_ATTACHMENT | more;
            texture(connection, "peeled", (picture.width, picture.height), format, usage)
                .create_view(&TextureViewDescriptor::default())
        };
        let read = TextureUsages::TEXTURE_BINDING;
        let frontier = frontier_state(peeling.ends);
        let frontiers = [(); 2].map(|()| target(frontier.format, read));
        let layer = target(TextureFormat::Rgba32Float, read);
        let sums: Vec<_> = formats.iter().map(|format| target(*format, read)).collect();
        let is_nearest = peeling.ends == Ends::Nearest;
        let depth = is_nearest.then(|| target(DEPTH_BUFFER, TextureUsages::empty()));
        let has_peeled = buffer(connection, "has peeled", 4, BufferUsages::STORAGE | BufferUsages::COPY_SRC);
        let layout = if is_nearest { &layouts.peeled_keys } else { &layouts.peeled_depths }.clone();
        let group = |frontier: &TextureView, second: &TextureView| {
            let textures = [frontier, second].map(BindingResource::TextureView);
            let [frontier, second] = textures;
            group(connection, &layout, &[frontier, second, has_peeled.as_entire_binding()])
        };
        // of both ends the blend unit alone looks at what is there
        let so_far = if is_nearest { &sums[0] } else { &picture.opaque_color };
        let peel_groups = [&frontiers[0], &frontiers[1]].map(|frontier| group(frontier, so_far));
        let composite_groups = [&frontiers[0], &frontiers[1]].map(|frontier| group(frontier, &layer));
        let [peel, composite] = pipelines(connection, layouts, picture, form, peeling, &formats, &layout);
        Ok(Self {
            picture,
            peeling,
            frontiers,
            layer,
            sums,
            depth,
            has_peeled,
            peel_groups,
            composite_groups,
            peel,
            composite,
        })
    }

    /// The pass before the first one: nothing has been peeled.
    fn begin(&self, recorder: &mut Recorder<'_>) -> Result<()> {
        let begin = clear_to(begin_and_end(self.peeling.ends)[0]);
        let mut targets = vec![attachment(&self.frontiers[1], begin, StoreOp::Store)];
        // what the first peel looks at, or blends with
        let sums = self.sums.iter().zip(&self.peeling.sums);
        targets.extend(sums.map(|(view, target)| attachment(view, clear_to(target.clear), StoreOp::Store)));
        recorder.render(Stage::Raster, &targets, |_| {})
    }

    /// One pass over the geometry and one over the image.
    fn peel(&self, recorder: &mut Recorder<'_>, number: usize, frame: &BindGroup) -> Result<()> {
        let (this, last) = (number % 2, (number + 1) % 2);
        recorder.clear(&self.has_peeled);
        let end = clear_to(begin_and_end(self.peeling.ends)[1]);
        let frontier = attachment(&self.frontiers[this], end, StoreOp::Store);
        let layer = attachment(&self.layer, clear_to(far_layers().clear), StoreOp::Store);
        let keep = |view| attachment(view, LoadOp::Load, StoreOp::Store);
        let (targets, behind) = match self.peeling.ends {
            Ends::Nearest => (vec![frontier, layer], &self.sums[0]),
            Ends::Both => (vec![frontier, keep(&self.sums[0]), layer], &self.sums[1]),
        };
        let depth = self.depth.as_ref().map(|view| (view, StoreOp::Discard));
        recorder.render_with_depth(Stage::Raster, &targets, depth, |pass| {
            pass.set_pipeline(&self.peel);
            pass.set_bind_group(0, frame, &[]);
            pass.set_bind_group(2, &self.peel_groups[last], &[]);
            draw_primitives(pass, self.picture, &(0..self.picture.height), 0);
        })?;
        recorder.render(Stage::Raster, &[keep(behind)], |pass| {
            pass.set_pipeline(&self.composite);
            pass.set_bind_group(0, frame, &[]);
            pass.set_bind_group(2, &self.composite_groups[this], &[]);
            pass.draw(0..3, 0..1);
        })
    }

    /// More passes than any pixel has layers for, and no more than are asked for.
    fn most(&self) -> usize {
        let deepest = usize::try_from(self.picture.totals().deepest).unwrap_or(usize::MAX);
        let all = match self.peeling.ends {
            // the last one finds nothing
            Ends::Nearest => deepest.saturating_add(1),
            // the first one peels nothing yet
            Ends::Both => deepest.div_ceil(2) + 1,
        };
        self.peeling.passes.unwrap_or(usize::MAX).min(all)
    }
}

/// A depth buffer in which of equals the first one stays.
pub(super) fn ends_ties_by_order(format: TextureFormat) -> DepthStencilState {
    DepthStencilState {
        format,
        depth_write_enabled: Some(true),
        depth_compare: Some(CompareFunction::Less),
        stencil: wgpu::StencilState::default(),
        bias: wgpu::DepthBiasState::default(),
    }
}

/// The pipelines of passes over the geometry and over the image.
fn pipelines(
    connection: &Connection,
    layouts: &mut Layouts,
    picture: &Picture,
    form: &Form,
    peeling: &Peeling,
    formats: &[TextureFormat],
    layout: &BindGroupLayout,
) -> [Arc<RenderPipeline>; 2] {
    let frontier = frontier_state(peeling.ends);
    let sums: Vec<_> =
        peeling.sums.iter().zip(formats).map(|(target, format)| blended(target, *format)).collect();
    let layer = TextureFormat::Rgba32Float;
    let (targets, behind) = match peeling.ends {
        Ends::Nearest => (vec![frontier, plain(layer, ColorWrites::ALL)], &sums[0]),
        Ends::Both => (vec![frontier, sums[0].clone(), blended(&far_layers(), layer)], &sums[1]),
    };
    let depth = (peeling.ends == Ends::Nearest).then(|| ends_ties_by_order(DEPTH_BUFFER));
    let module = form.module();
    let entry = |point| Entry { module: &module, point };
    let draws = picture.draws(form.shows_zero_fragments);
    let device = &connection.device;
    [
        layouts.render_with(device, entry(peeling.peel), draws, &targets, Some(layout), depth),
        layouts.render_with(
            device,
            entry(peeling.composite),
            Draws::Background,
            std::slice::from_ref(behind),
            Some(layout),
            None,
        ),
    ]
}

impl Gpu {
    /// Peels until a pass finds nothing, or as often as is asked for, and resolves.
    pub(super) fn peeled(
        &mut self,
        picture: &Picture,
        form: &Form,
        peeling: &Peeling,
        stop: Stop<'_>,
    ) -> Result<Image> {
        let params: Vec<_> = form.numbers.iter().map(|number| number.bits()).collect();
        let frame = self.frame(picture, &(0..picture.height), &params);
        let Self { connection, layouts, .. } = &mut *self;
        let peeler = Peeler::new(connection, layouts, picture, form, peeling)?;
        let mut image = Image { times: peel_all(connection, &peeler, &frame, stop)?, ..Image::default() };
        self.resolve_targets(picture, form, peeling.resolve, &peeler.sums, &mut image, stop)?;
        Ok(image)
    }

    /// Makes the image of one target or of two, band by band.
    pub(super) fn resolve_targets(
        &mut self,
        picture: &Picture,
        form: &Form,
        point: &str,
        views: &[TextureView],
        image: &mut Image,
        stop: Stop<'_>,
    ) -> Result<()> {
        let params: Vec<_> = form.numbers.iter().map(|number| number.bits()).collect();
        let second = views.get(1).unwrap_or(&picture.opaque_color);
        let views = [&views[0], second].map(BindingResource::TextureView);
        let reads = Reads::Targets(&[Some(Reading::Texture); 2]);
        let layout = self.layouts.second(&self.connection.device, reads);
        let Some(layout) = layout else { unreachable!("it reads targets") };
        let targets = group(&self.connection, &layout, &views);
        let module = form.module();
        let bands = self.bands_of_rows(picture, form);
        let rows = bands.first().map_or(0, |band| band.end - band.start);
        let canvas = self.kept.canvas(&self.connection, form, (picture.width, rows));
        for band in &bands {
            let frame = self.frame(picture, band, &params);
            let Self { connection, layouts, .. } = &mut *self;
            let recorder = Recorder::new(connection, stop);
            let resolve = Resolve {
                shader: Entry { module: &module, point },
                reads,
                targets_are_whole: true,
                groups: [&frame, &targets],
                rows: band,
            };
            resolve.run(connection, layouts, recorder, picture, &canvas, image)?;
        }
        self.kept.keep(None, canvas);
        Ok(())
    }
}

/// All passes; how long they took.
fn peel_all(
    connection: &Connection,
    peeler: &Peeler<'_>,
    frame: &BindGroup,
    stop: Stop<'_>,
) -> Result<Times> {
    let (most, mut done, mut times) = (peeler.most(), 0, Times::default());
    loop {
        let mut recorder = Recorder::new(connection, stop);
        if done == 0 {
            peeler.begin(&mut recorder)?;
        }
        let now = PEELS.min(most - done);
        for number in done..done + now {
            peeler.peel(&mut recorder, number, frame)?;
        }
        done += now;
        let (has_peeled, spent): (Vec<u32>, _) = recorder.finish(&peeler.has_peeled, 4)?;
        times = times.plus(spent);
        if done == most || has_peeled[0] == 0 {
            return Ok(times);
        }
    }
}
