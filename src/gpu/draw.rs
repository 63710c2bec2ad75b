//! Passes: counting fragments, blending them or keeping them all, and making an image of what that leaves.

use super::device::Connection;
use super::form::{Blending, Form, Listing, Path, Sorting, background_module, list_module};
use super::layouts::{Draws, Entry, Layouts, blended, plain};
use super::picture::{Picture, buffer, bytes_of, texture};
use super::recorder::{Recorder, Stage, Times, read};
use crate::error::{Error, Result};
use std::ops::Range;
use wgpu::{
    BindGroup, BindGroupDescriptor, BindGroupEntry, BindGroupLayout, BindingResource, Buffer, BufferUsages,
    Color, ColorWrites, LoadOp, Operations, RenderPass, RenderPassColorAttachment, StoreOp, TextureFormat,
    TextureUsages, TextureView,
};

/// Bytes of a pixel in the image that a resolve writes.
const TEXEL: u64 = 16;
/// Bytes of a fragment's colour, the larger part of what is kept of it.
const COLOR: u64 = 16;
const KEY: u64 = 8;

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

type Stop<'a> = &'a (dyn Fn() -> bool + Sync);

/// The buffers of lists, by their bindings.
struct ListBuffers {
    group: BindGroup,
    row_sums: Buffer,
    row_places: Buffer,
    keys: Buffer,
    colors: Buffer,
}

/// Every fragment, row by row and pixel by pixel, as they were submitted.
#[derive(Debug, Default)]
pub struct Captured {
    /// Fragments per pixel.
    pub counts: Vec<u32>,
    /// The bits of the depth, and the primitive.
    pub keys: Vec<[u32; 2]>,
    /// Premultiplied colour and coverage.
    pub colors: Vec<[f32; 4]>,
}

/// Resources by their bindings.
fn group(connection: &Connection, layout: &BindGroupLayout, resources: &[BindingResource<'_>]) -> BindGroup {
    let entries: Vec<_> = resources
        .iter()
        .zip(0..)
        .map(|(resource, binding)| BindGroupEntry { binding, resource: resource.clone() })
        .collect();
    connection.device.create_bind_group(&BindGroupDescriptor { label: None, layout, entries: &entries })
}

impl Gpu {
    /// What shaders know of the image, some of its rows and the technique's params.
    fn frame(&self, picture: &Picture, rows: &Range<u32>, params: &[u32]) -> BindGroup {
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
    pub fn image(&mut self, picture: &Picture, form: &Form, stop: Stop<'_>) -> Result<Image> {
        match &form.path {
            Path::Blended(blending) => self.blended(picture, form, blending, stop),
            Path::Listed(listing) => self.listed(picture, form, listing, stop),
        }
    }

    /// Counts the fragments of each pixel and row.
    ///
    /// # Errors
    /// As [`Gpu::image`].
    pub fn count(&mut self, picture: &mut Picture, stop: Stop<'_>) -> Result<()> {
        let (lists, all) = (self.lists(picture, 0), 0..picture.height);
        let frame = self.frame(picture, &all, &[]);
        let mut recorder = Recorder::new(&self.connection, stop);
        recorder.clear(&picture.counts);
        draw_into_lists(
            &self.connection,
            &mut self.layouts,
            &mut recorder,
            picture,
            "count_fragment",
            &frame,
            &lists.group,
            &all,
        )?;
        sum_rows(&self.connection, &mut self.layouts, &mut recorder, picture, &frame, &lists.group)?;
        let (rows, times): (Vec<[u32; 2]>, _) =
            recorder.finish(&lists.row_sums, 8 * u64::from(picture.height))?;
        (picture.rows, picture.count_ms) = (rows, times.raster);
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
        let all = [&picture.counts, &places, &row_sums, &row_places, &keys, &colors];
        let group = group(&self.connection, &self.layouts.lists, &all.map(Buffer::as_entire_binding));
        ListBuffers { group, row_sums, row_places, keys, colors }
    }

    fn most_bytes(&self) -> u64 {
        let limits = &self.connection.limits;
        u64::from(limits.max_storage_buffer_binding_size).min(limits.max_buffer_size)
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
                texture(&self.connection, "target", size, *format, usage).create_view(&Default::default())
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

    /// Lists of all fragments, in as many parts of the image as their number asks for.
    fn listed(&mut self, picture: &Picture, form: &Form, listing: &Listing, stop: Stop<'_>) -> Result<Image> {
        let bands = self.bands_of_fragments(picture, self.rows_per_band(picture, form))?;
        let lists = self.lists_for(picture, &bands);
        let params: Vec<_> = form.numbers.iter().map(|number| number.bits()).collect();
        let module = form.module();
        let mut image = Image { texels: Vec::new(), times: Times { raster: picture.count_ms, resolve: 0.0 } };
        for band in &bands {
            let frame = self.frame(picture, band, &params);
            let Self { connection, layouts } = self;
            let mut recorder = Recorder::new(connection, stop);
            fill_lists(
                connection,
                layouts,
                &mut recorder,
                picture,
                [&frame, &lists.group],
                band,
                listing.sorted,
            )?;
            let pipeline = layouts.compute(
                &connection.device,
                Entry { module: &module, point: listing.resolve },
                true,
                true,
                &[],
            );
            let groups = [&frame, &lists.group];
            resolve(connection, layouts, recorder, picture, form, band, &pipeline, groups, &mut image)?;
        }
        Ok(image)
    }

    /// Keeps and reads back every fragment.
    ///
    /// # Errors
    /// As [`Gpu::image`].
    pub fn capture(&mut self, picture: &Picture, stop: Stop<'_>) -> Result<Captured> {
        let bands = self.bands_of_fragments(picture, u32::MAX)?;
        let lists = self.lists_for(picture, &bands);
        let mut captured = Captured::default();
        for band in &bands {
            let fragments = fragments_of(picture, band);
            let frame = self.frame(picture, band, &[]);
            let Self { connection, layouts } = self;
            let mut recorder = Recorder::new(connection, stop);
            fill_lists(
                connection,
                layouts,
                &mut recorder,
                picture,
                [&frame, &lists.group],
                band,
                Sorting::Submission,
            )?;
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
        Ok(captured)
    }

    /// Room for the fragments of the fullest band, and where each row's go.
    fn lists_for(&self, picture: &Picture, bands: &[Range<u32>]) -> ListBuffers {
        let most = bands.iter().map(|band| fragments_of(picture, band)).max().unwrap_or(0);
        let lists = self.lists(picture, most);
        self.connection.queue.write_buffer(&lists.row_places, 0, bytes_of(&row_places(picture, bands)));
        lists
    }

    /// As many rows at a time as fit into one buffer.
    fn bands_of_rows(&self, picture: &Picture, form: &Form) -> Vec<Range<u32>> {
        let most = self.rows_per_band(picture, form);
        let starts = (0..picture.height).step_by(most as usize);
        starts.map(|first| first..(first + most).min(picture.height)).collect()
    }

    fn rows_per_band(&self, picture: &Picture, form: &Form) -> u32 {
        let row = texel_bytes(form) * u64::from(picture.width);
        u32::try_from(self.most_bytes() / row).unwrap_or(u32::MAX).max(1)
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

/// Makes and reads back some rows of the image.
#[expect(clippy::too_many_arguments, reason = "a pass and all that it reads")]
fn resolve(
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

fn texel_bytes(form: &Form) -> u64 {
    if form.colored_transmittance { 2 * TEXEL } else { TEXEL }
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

/// Stores and sorts the fragments of some rows.
fn fill_lists(
    connection: &Connection,
    layouts: &mut Layouts,
    recorder: &mut Recorder<'_>,
    picture: &Picture,
    [frame, lists]: [&BindGroup; 2],
    band: &Range<u32>,
    sorting: Sorting,
) -> Result<()> {
    if band.start == 0 {
        sum_rows(connection, layouts, recorder, picture, frame, lists)?;
    }
    let module = list_module();
    let entry = |point| Entry { module: &module, point };
    let shift = layouts.compute(&connection.device, entry("shift_rows"), true, false, &[]);
    dispatch(recorder, Stage::Raster, &shift, &[frame, lists], picture, band)?;
    draw_into_lists(connection, layouts, recorder, picture, "store_fragment", frame, lists, band)?;
    let by_submission = [("by_submission", f64::from(u8::from(sorting == Sorting::Submission)))];
    let sort = layouts.compute(&connection.device, entry("sort_lists"), true, false, &by_submission);
    dispatch(recorder, Stage::Resolve, &sort, &[frame, lists], picture, band)
}

fn dispatch(
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

fn sum_rows(
    connection: &Connection,
    layouts: &mut Layouts,
    recorder: &mut Recorder<'_>,
    picture: &Picture,
    frame: &BindGroup,
    lists: &BindGroup,
) -> Result<()> {
    let entry = Entry { module: &list_module(), point: "sum_rows" };
    let pipeline = layouts.compute(&connection.device, entry, true, false, &[]);
    recorder.compute(Stage::Raster, |pass| {
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, frame, &[]);
        pass.set_bind_group(2, lists, &[]);
        pass.dispatch_workgroups(picture.height, 1, 1);
    })
}

fn attachment<'a>(
    view: &'a TextureView,
    load: LoadOp<Color>,
    store: StoreOp,
) -> Option<RenderPassColorAttachment<'a>> {
    Some(RenderPassColorAttachment {
        view,
        depth_slice: None,
        resolve_target: None,
        ops: Operations { load, store },
    })
}

fn draw_primitives(pass: &mut RenderPass<'_>, picture: &Picture, rows: &Range<u32>) {
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

/// Fragments into lists. A pass wants a target, which nothing is drawn into.
#[expect(clippy::too_many_arguments, reason = "a pass and all that it reads")]
fn draw_into_lists(
    connection: &Connection,
    layouts: &mut Layouts,
    recorder: &mut Recorder<'_>,
    picture: &Picture,
    point: &str,
    frame: &BindGroup,
    lists: &BindGroup,
    rows: &Range<u32>,
) -> Result<()> {
    let format = TextureFormat::R8Unorm;
    let unused = texture(
        connection,
        "none",
        (picture.width, picture.height),
        format,
        TextureUsages::RENDER_ATTACHMENT,
    );
    let unused = unused.create_view(&Default::default());
    let draws = Draws::Primitives { perspective: picture.perspective, zero_fragments: true };
    let entry = Entry { module: &list_module(), point };
    let pipeline = layouts.render(&connection.device, entry, draws, &[plain(format, ColorWrites::empty())]);
    let target = attachment(&unused, LoadOp::Clear(Color::TRANSPARENT), StoreOp::Discard);
    recorder.render(Stage::Raster, &[target], |pass| {
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, frame, &[]);
        pass.set_bind_group(2, lists, &[]);
        draw_primitives(pass, picture, rows);
    })
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
