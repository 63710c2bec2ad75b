//! A scene on the device: its primitives, and the opaque surfaces behind them.

use super::device::Connection;
use super::draws::{Draws, Known, flag};
use super::geometry::{Packed, Traits, Viewport};
use super::layouts::Layouts;
use super::tiles::Planned;
use crate::error::{Error, Result};
use crate::params;
use crate::raster::{Drawn, Rect, pixel_bounds_of};
use std::ops::Range;
use std::sync::OnceLock;
use wgpu::{
    BindGroup, BindGroupDescriptor, BindGroupEntry, Buffer, BufferDescriptor, BufferUsages, Extent3d,
    Texture, TextureDescriptor, TextureDimension, TextureFormat, TextureUsages, TextureView,
};

/// The opaque surfaces of an image, row by row from the top.
#[derive(Debug, Default)]
pub struct Opaque {
    /// The depth of the nearest one; infinite where there is none.
    pub depth: Vec<f32>,
    /// Linear colour, that of the background where there is none.
    pub color: Vec<[f32; 4]>,
}

/// What is drawn, as the CPU has set it up.
#[derive(Debug)]
pub struct View {
    pub width: u32,
    pub height: u32,
    pub perspective: bool,
    pub background: [f32; 3],
    /// None where there are no opaque surfaces.
    pub opaque: Option<Opaque>,
}

/// Primitives as they come.
pub type Primitives<'a> = Box<dyn Iterator<Item = Drawn<'a>> + 'a>;

/// Primitives in the order in which they are drawn, which may be asked for several times.
pub struct ToDraw<'a> {
    pub view: View,
    /// Near, far and the depth range.
    pub range: params::View,
    /// Whether lists of them may be sorted by that order: of a scene, where it is neither that of the ids nor the reverse.
    pub ranked: bool,
    pub primitives: &'a dyn Fn() -> Primitives<'a>,
}

/// What there is of a scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Totals {
    pub fragments: u64,
    /// Those of the deepest pixel.
    pub deepest: u64,
    /// Draw calls.
    pub batches: usize,
}

/// Every fragment of an image, pixel by pixel as they were submitted.
#[derive(Debug, Default)]
pub struct Given {
    /// Fragments per pixel.
    pub counts: Vec<u32>,
    /// The bits of the depth, and the primitive.
    pub keys: Vec<[u32; 2]>,
    /// Premultiplied colour and coverage.
    pub colors: Vec<[f32; 4]>,
}

/// A scene on the device, in one order of its primitives.
#[derive(Debug)]
pub struct Picture {
    pub width: u32,
    pub height: u32,
    /// The rows that its primitives are of.
    pub part: Range<u32>,
    pub perspective: bool,
    pub background: [f32; 3],
    pub viewport: Viewport,
    /// What its primitives have.
    pub traits: Traits,
    pub has_opaque: bool,
    pub opaque_depth: TextureView,
    pub opaque_color: TextureView,
    /// Draw calls: buffers and the number of primitives in them.
    pub batches: Vec<(BindGroup, u32)>,
    /// The ids of primitives in the order in which they are drawn, where lists may be sorted by that.
    order: Vec<u32>,
    ranks: OnceLock<Buffer>,
    /// Fragments of each row, and of its deepest pixel; empty until they have been counted.
    pub rows: Vec<[u32; 2]>,
    /// Fragments that are there already, instead of primitives.
    pub given: Option<Given>,
    /// How the raster in compute cuts it up, once it has.
    pub plan: Planned,
    /// Bytes on the device.
    pub bytes: u64,
}

/// A buffer of so many bytes and four at least, which the device may have no room for.
pub fn buffer(connection: &Connection, label: &str, bytes: u64, usage: BufferUsages) -> Buffer {
    let size = bytes.max(16).next_multiple_of(4);
    connection.device.create_buffer(&BufferDescriptor {
        label: Some(label),
        size,
        usage: usage | BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}

/// The bytes of some words.
pub fn bytes_of<T: bytemuck::Pod>(words: &[T]) -> &[u8] {
    bytemuck::cast_slice(words)
}

/// A texture of the image's size or, for nothing, of one pixel.
pub fn texture(
    connection: &Connection,
    label: &str,
    (width, height): (u32, u32),
    format: TextureFormat,
    usage: TextureUsages,
) -> Texture {
    connection.device.create_texture(&TextureDescriptor {
        label: Some(label),
        size: Extent3d { width, height, depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: TextureDimension::D2,
        format,
        usage,
        view_formats: &[],
    })
}

fn uploaded<T: bytemuck::Pod>(
    connection: &Connection,
    label: &str,
    size: (u32, u32),
    format: TextureFormat,
    texels: &[T],
) -> TextureView {
    let texture =
        texture(connection, label, size, format, TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST);
    let bytes = bytes_of(texels);
    if !bytes.is_empty() {
        let layout = wgpu::TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(size.0 * u32::try_from(size_of::<T>()).unwrap_or(0)),
            rows_per_image: None,
        };
        connection.queue.write_texture(texture.as_image_copy(), bytes, layout, texture.size());
    }
    texture.create_view(&wgpu::TextureViewDescriptor::default())
}

#[expect(clippy::cast_possible_wrap, reason = "images are at most MAX_SIZE")]
fn rect(width: u32, height: u32) -> Rect {
    Rect { x0: 0, y0: 0, x1: width as i32, y1: height as i32 }
}

impl View {
    /// All of the image.
    pub fn rect(&self) -> Rect {
        rect(self.width, self.height)
    }
}

/// The rows of an image that a primitive may have pixels in, if any.
pub fn rows_of(primitive: &Drawn<'_>, image: &Rect) -> Option<Range<u32>> {
    let Rect { y0, y1, .. } = pixel_bounds_of(primitive.outline.points(), image);
    (y0 < y1).then(|| y0.cast_unsigned()..y1.cast_unsigned())
}

/// Bytes of a primitive's rank.
pub const RANK: u64 = 8;

/// Ids in ascending order, each with the place that it has among `ids`.
fn ranks_of(ids: &[u32]) -> Vec<[u32; 2]> {
    let mut ranks: Vec<_> = ids.iter().zip(0..).map(|(id, place)| [*id, place]).collect();
    ranks.sort_unstable();
    // buffers have room for two at least, and searches look at all of it
    ranks.resize(ranks.len().max(2), [u32::MAX; 2]);
    ranks
}

impl Picture {
    /// Takes a scene to the device, its primitives in the order in which they come, by which lists can be sorted if they are
    /// `ranked`.
    ///
    /// # Errors
    /// [`Error::Argument`] for an image beyond the device's limits.
    pub fn new<'a>(
        connection: &Connection,
        layouts: &Layouts,
        view: &View,
        primitives: impl Iterator<Item = Drawn<'a>>,
        ranked: bool,
    ) -> Result<Self> {
        let (width, height) = (view.width, view.height);
        check_size(connection, width, height)?;
        let viewport = Viewport::new(width, height, connection.limits.max_texture_dimension_2d);
        let none = Opaque::default();
        let opaque = view.opaque.as_ref().unwrap_or(&none);
        let size = if view.opaque.is_some() { (width, height) } else { (1, 1) };
        let pixels = u64::from(width) * u64::from(height);
        let mut picture = Self {
            width,
            height,
            part: 0..height,
            perspective: view.perspective,
            background: view.background,
            viewport,
            traits: Traits::default(),
            has_opaque: view.opaque.is_some(),
            opaque_depth: uploaded(connection, "opaque depth", size, TextureFormat::R32Float, &opaque.depth),
            opaque_color: uploaded(
                connection,
                "opaque color",
                size,
                TextureFormat::Rgba32Float,
                &opaque.color,
            ),
            batches: Vec::new(),
            order: Vec::new(),
            ranks: OnceLock::new(),
            rows: Vec::new(),
            given: None,
            plan: Planned::new(),
            bytes: if view.opaque.is_some() { 20 * pixels } else { 0 },
        };
        let mut order = Vec::new();
        let primitives = primitives.inspect(|drawn| {
            if ranked {
                order.push(drawn.primitive);
            }
        });
        picture.add_primitives(connection, layouts, primitives);
        picture.bytes += RANK * order.len() as u64;
        picture.order = order;
        Ok(picture)
    }

    /// The same of what is in some rows, as far as it is to be drawn in compute.
    ///
    /// # Errors
    /// As [`Picture::new`].
    pub fn of_rows(
        connection: &Connection,
        layouts: &Layouts,
        drawn: &ToDraw<'_>,
        part: Range<u32>,
    ) -> Result<Self> {
        let image = drawn.view.rect();
        let touches = |primitive: &Drawn<'_>| {
            rows_of(primitive, &image).is_some_and(|rows| rows.start < part.end && rows.end > part.start)
        };
        let primitives = (drawn.primitives)().filter(touches);
        let picture = Self::new(connection, layouts, &drawn.view, primitives, false)?;
        Ok(Self { part, ..picture })
    }

    /// The same of fragments that are there already.
    ///
    /// # Errors
    /// As [`Picture::new`].
    pub fn of_fragments(
        connection: &Connection,
        layouts: &Layouts,
        view: &View,
        given: Given,
    ) -> Result<Self> {
        let mut picture = Self::new(connection, layouts, view, std::iter::empty(), false)?;
        let row = |counts: &[u32]| [counts.iter().sum(), counts.iter().copied().max().unwrap_or(0)];
        picture.rows = given.counts.chunks(view.width as usize).map(row).collect();
        picture.given = Some(given);
        Ok(picture)
    }

    /// The ids of what is drawn, in ascending order, each with its place in the order in which it is drawn.
    ///
    /// # Errors
    /// [`Error::Memory`] for more than one of the device's buffers holds.
    pub fn ranks(&self, connection: &Connection) -> Result<&Buffer> {
        let (count, limits) = (self.order.len() as u64, &connection.limits);
        let most = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size) / RANK;
        if count > most {
            return Err(Error::Memory(format!(
                "the order of the {count} primitives in sight; {} keeps that of {most}: submission_order=\"as_is\" and \"reversed\" need \
                 none",
                connection.info.name
            )));
        }
        Ok(self.ranks.get_or_init(|| {
            let ranks = ranks_of(&self.order);
            let ranked = buffer(connection, "ranks", RANK * ranks.len() as u64, BufferUsages::STORAGE);
            connection.queue.write_buffer(&ranked, 0, bytes_of(&ranks));
            ranked
        }))
    }

    /// Primitives in as many draw calls as buffers of the device's largest size take.
    fn add_primitives<'a>(
        &mut self,
        connection: &Connection,
        layouts: &Layouts,
        primitives: impl Iterator<Item = Drawn<'a>>,
    ) {
        let limits = &connection.limits;
        let most = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        let image = rect(self.width, self.height);
        let mut packed = Packed::default();
        for primitive in primitives {
            if packed.bytes_with_one_more() > most {
                let traits = packed.traits;
                self.add_batch(connection, layouts, &std::mem::take(&mut packed));
                packed.traits = traits;
            }
            packed.push(&primitive, &self.viewport, &image, self.perspective);
        }
        self.traits = packed.traits;
        if !packed.primitives.is_empty() {
            self.add_batch(connection, layouts, &packed);
        }
    }

    #[expect(clippy::cast_possible_truncation, reason = "a buffer holds far less than 2^32 primitives")]
    fn add_batch(&mut self, connection: &Connection, layouts: &Layouts, packed: &Packed) {
        let parts = [
            bytes_of(packed.primitives.as_flattened()),
            bytes_of(packed.varying.as_flattened()),
            bytes_of(packed.outlines.as_flattened()),
        ];
        let buffers = parts.map(|bytes| {
            // records are whole, also where there are none
            let size = (bytes.len() as u64).max(112);
            self.bytes += size;
            let buffer = buffer(connection, "primitives", size, BufferUsages::STORAGE);
            connection.queue.write_buffer(&buffer, 0, bytes);
            buffer
        });
        let entries: Vec<_> = buffers
            .iter()
            .zip(0..)
            .map(|(buffer, binding)| BindGroupEntry { binding, resource: buffer.as_entire_binding() })
            .collect();
        let group = connection.device.create_bind_group(&BindGroupDescriptor {
            label: Some("geometry"),
            layout: &layouts.geometry,
            entries: &entries,
        });
        self.batches.push((group, packed.primitives.len() as u32));
    }

    /// What a pipeline that draws its primitives has to know.
    pub fn draws(&self, zero_fragments: bool) -> Draws {
        Draws::Primitives(self.known(zero_fragments))
    }

    /// What is known of its primitives.
    pub fn known(&self, zero_fragments: bool) -> Known {
        let Self { perspective, has_opaque: opaque, traits, .. } = *self;
        Known { perspective, zero_fragments, near_depths: false, opaque, traits }
    }

    /// The constants of a pipeline that makes its image.
    pub fn knowledge(&self) -> [(&'static str, f64); 1] {
        [("has_opaque", flag(self.has_opaque))]
    }

    /// How many primitives there are to draw.
    pub fn primitives(&self) -> u32 {
        self.batches.iter().map(|(_, count)| count).sum()
    }

    /// What there is of it.
    pub fn totals(&self) -> Totals {
        let fragments = self.rows.iter().map(|row| u64::from(row[0])).sum();
        let deepest = self.rows.iter().map(|row| u64::from(row[1])).max().unwrap_or(0);
        Totals { fragments, deepest, batches: self.batches.len() }
    }
}

/// Refuses images that the device has no textures or buffers for.
///
/// # Errors
/// [`Error::Argument`] that says how large they may be.
pub fn check_size(connection: &Connection, width: u32, height: u32) -> Result<()> {
    let limits = &connection.limits;
    let most = limits.max_texture_dimension_2d;
    for (name, extent) in [("width", width), ("height", height)] {
        if extent > most {
            let problem = format!(
                "{extent} is more than the {most} pixels that {} has textures of",
                connection.info.name
            );
            return Err(Error::argument(name, problem));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranks_are_found_by_ids_whatever_these_are() {
        assert_eq!(ranks_of(&[7, u32::MAX, 0]), [[0, 2], [7, 0], [u32::MAX, 1]]);
        assert_eq!(ranks_of(&[5]), [[5, 0], [u32::MAX; 2]]);
    }
}
