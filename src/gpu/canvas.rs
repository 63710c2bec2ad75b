//! What a pass over render targets draws the image into, and its way back.

use super::device::Connection;
use super::draw::{Image, attachment};
use super::draws::Draws;
use super::layouts::{Entry, Layouts, Reads, plain};
use super::picture::{Picture, buffer, texture};
use super::recorder::{Recorder, Stage};
use crate::error::{Error, Result};
use std::ops::Range;
use wgpu::{
    BindGroup, Buffer, BufferUsages, COPY_BYTES_PER_ROW_ALIGNMENT, ColorWrites, CommandEncoder, Extent3d,
    LoadOp, StoreOp, TexelCopyBufferInfo, TexelCopyBufferLayout, Texture, TextureFormat, TextureUsages,
    TextureViewDescriptor,
};

const FORMAT: TextureFormat = TextureFormat::Rgba32Float;
/// Numbers of a texel.
const CHANNELS: usize = 4;

/// Room for as many rows of an image as are made at a time.
#[derive(Debug)]
pub struct Canvas {
    width: u32,
    rows: u32,
    /// Of colour and the background's share, or one for each.
    textures: Vec<Texture>,
    /// All rows of a texture, then those of the next.
    landing: Buffer,
}

/// The bytes of a row where it lands.
pub fn landed_row(width: u32) -> u64 {
    (u64::from(width) * 4 * CHANNELS as u64).next_multiple_of(COPY_BYTES_PER_ROW_ALIGNMENT.into())
}

impl Canvas {
    /// One of that size and with so many textures: that which is there, if it is such a one.
    pub fn like(
        kept: Option<Self>,
        connection: &Connection,
        (width, rows): (u32, u32),
        textures: usize,
    ) -> Self {
        let is_such = |kept: &Self| (kept.width, kept.rows, kept.textures.len()) == (width, rows, textures);
        kept.filter(is_such).unwrap_or_else(|| {
            let usage = TextureUsages::RENDER_ATTACHMENT | TextureUsages::COPY_SRC;
            let bytes = textures as u64 * u64::from(rows) * landed_row(width);
            Self {
                width,
                rows,
                textures: (0..textures)
                    .map(|_| texture(connection, "image", (width, rows), FORMAT, usage))
                    .collect(),
                landing: buffer(connection, "image", bytes, BufferUsages::MAP_READ),
            }
        })
    }

    /// Its bytes on the device.
    pub fn bytes(&self) -> u64 {
        2 * self.landing.size()
    }

    pub fn landing(&self) -> &Buffer {
        &self.landing
    }

    /// Takes some rows to where they can be read.
    pub fn land(&self, encoder: &mut CommandEncoder, rows: u32) {
        let mut offset = 0;
        for texture in &self.textures {
            let layout = TexelCopyBufferLayout {
                offset,
                bytes_per_row: u32::try_from(landed_row(self.width)).ok(),
                rows_per_image: None,
            };
            let to = TexelCopyBufferInfo { buffer: &self.landing, layout };
            let size = Extent3d { width: self.width, height: rows, depth_or_array_layers: 1 };
            encoder.copy_texture_to_buffer(texture.as_image_copy(), to, size);
            offset += u64::from(rows) * landed_row(self.width);
        }
    }

    /// Adds some rows that have landed to an image, texel by texel of each texture in turns.
    fn read(&self, rows: u32, texels: &mut Vec<f32>) -> Result<()> {
        let bytes = u64::from(rows) * landed_row(self.width);
        let view = |i| self.landing.slice(i * bytes..(i + 1) * bytes).get_mapped_range();
        let views = (0..self.textures.len() as u64).map(view).collect::<std::result::Result<Vec<_>, _>>();
        let views =
            views.map_err(|error| Error::Gpu(format!("what was made could not be read back: {error}")))?;
        let numbers: Vec<&[f32]> = views.iter().map(|view| bytemuck::cast_slice(view)).collect();
        let (width, row) = (self.width as usize, numbers[0].len() / rows as usize);
        texels.reserve(numbers.len() * CHANNELS * width * rows as usize);
        for start in (0..rows as usize).map(|i| i * row) {
            if let [only] = numbers[..] {
                texels.extend_from_slice(&only[start..start + CHANNELS * width]);
                continue;
            }
            for texel in (0..width).map(|i| start + CHANNELS * i) {
                numbers.iter().for_each(|all| texels.extend_from_slice(&all[texel..texel + CHANNELS]));
            }
        }
        drop(views);
        self.landing.unmap();
        Ok(())
    }
}

/// A pass over some rows of the image that reads render targets.
pub struct Resolve<'a> {
    pub shader: Entry<'a>,
    pub reads: Reads<'a>,
    /// Whether the targets have all rows of the image, not only these.
    pub targets_are_whole: bool,
    /// What it knows of the image, and the targets.
    pub groups: [&'a BindGroup; 2],
    pub rows: &'a Range<u32>,
}

impl Resolve<'_> {
    /// Draws, reads back and adds these rows to the image.
    pub fn run(
        &self,
        connection: &Connection,
        layouts: &mut Layouts,
        mut recorder: Recorder<'_>,
        picture: &Picture,
        canvas: &Canvas,
        image: &mut Image,
    ) -> Result<()> {
        let draws = Draws::Image { opaque: picture.has_opaque, targets_are_whole: self.targets_are_whole };
        let states = vec![plain(FORMAT, ColorWrites::ALL); canvas.textures.len()];
        let pipeline = layouts.render(&connection.device, self.shader, draws, self.reads, &states);
        let views = canvas.textures.iter().map(|t| t.create_view(&TextureViewDescriptor::default()));
        let views: Vec<_> = views.collect();
        // every texel is drawn over: to clear it first would be work
        let attachments: Vec<_> =
            views.iter().map(|view| attachment(view, LoadOp::Load, StoreOp::Store)).collect();
        let rows = self.rows.end - self.rows.start;
        recorder.render(Stage::Resolve, &attachments, |pass| {
            pass.set_pipeline(&pipeline);
            for (group, index) in self.groups.iter().zip([0, 2]) {
                pass.set_bind_group(index, *group, &[]);
            }
            pass.set_scissor_rect(0, 0, picture.width, rows);
            pass.draw(0..3, 0..1);
        })?;
        image.times = image.times.plus(recorder.finish_canvas(canvas, rows)?);
        canvas.read(rows, &mut image.texels)
    }
}
