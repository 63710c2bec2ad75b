//! Images of what tiles keep in registers.

use super::plan::{Plan, pixel_rows};
use super::{BIN, Bins, Drawing, check_bin};
use crate::error::Result;
use crate::gpu::draw::{Gpu, Image, Stop, group, texel_bytes};
use crate::gpu::form::{Blending, Form};
use crate::gpu::layouts::tile_entries;
use crate::gpu::picture::{Picture, buffer, texture};
use crate::gpu::recorder::{Recorder, Times, read};
use wgpu::{BindGroupLayoutDescriptor, BufferUsages, TextureFormat, TextureUsages, TextureViewDescriptor};

impl Gpu {
    /// Draws what blend units would leave, and resolves it.
    pub(super) fn tiled_targets(
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
    pub(super) fn tiled_image(
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
            let written = group(connection, &layouts.output, &[output.as_entire_binding()]);
            drawing.written = Some((layouts.output.clone(), written));
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
