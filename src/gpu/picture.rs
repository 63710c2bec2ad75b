//! A scene on the device: its primitives, and the opaque surfaces behind them.

use super::device::Connection;
use super::draws::{Draws, Known, flag};
use super::geometry::{Packed, Traits, Viewport};
use super::layouts::Layouts;
use super::tiles::Planned;
use crate::error::{Error, Result};
use crate::raster::{Drawn, Rect};
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
    /// Fragments per pixel, a `u32` each.
    pub counts: Buffer,
    /// The places of primitives in the order in which they are drawn, by their ids, where that is not the order of ids.
    pub ranks: Buffer,
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

/// The places of primitives in the order in which they come, by their ids.
#[derive(Debug, Default)]
struct Ranks {
    places: Vec<u32>,
    count: u32,
}

impl Ranks {
    /// The next one.
    fn add(&mut self, primitive: u32) {
        let id = primitive as usize;
        if self.places.len() <= id {
            self.places.resize(id + 1, 0);
        }
        self.places[id] = self.count;
        self.count += 1;
    }
}

impl Picture {
    /// Takes a scene to the device, its primitives in the order in which they come. They have `ranks` if that is not the order
    /// of their ids.
    ///
    /// # Errors
    /// [`Error::Argument`] for an image beyond the device's limits, [`Error::Memory`] for more ranks than one of its buffers
    /// holds.
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
            counts: buffer(connection, "counts", 4 * pixels, BufferUsages::STORAGE | BufferUsages::COPY_SRC),
            ranks: buffer(connection, "no ranks", 4, BufferUsages::STORAGE),
            rows: Vec::new(),
            given: None,
            plan: Planned::new(),
            bytes: 4 * pixels + if view.opaque.is_some() { 20 * pixels } else { 0 },
        };
        let mut ranks = Ranks::default();
        let primitives = primitives.inspect(|drawn| {
            if ranked {
                ranks.add(drawn.primitive);
            }
        });
        picture.add_primitives(connection, layouts, primitives);
        picture.add_ranks(connection, &ranks.places)?;
        Ok(picture)
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
        connection.queue.write_buffer(&picture.counts, 0, bytes_of(&given.counts));
        let row = |counts: &[u32]| [counts.iter().sum(), counts.iter().copied().max().unwrap_or(0)];
        picture.rows = given.counts.chunks(view.width as usize).map(row).collect();
        picture.given = Some(given);
        Ok(picture)
    }

    fn add_ranks(&mut self, connection: &Connection, ranks: &[u32]) -> Result<()> {
        let (bytes, limits) = (4 * ranks.len() as u64, &connection.limits);
        let most = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        if bytes > most {
            return Err(Error::Memory(format!(
                "the order of {} primitives; {} keeps that of {}: submission_order=\"as_is\" and \"reversed\" need none",
                ranks.len(),
                connection.info.name,
                most / 4
            )));
        }
        if bytes > 0 {
            self.ranks = buffer(connection, "ranks", bytes, BufferUsages::STORAGE);
            connection.queue.write_buffer(&self.ranks, 0, bytes_of(ranks));
            self.bytes += bytes;
        }
        Ok(())
    }

    /// Primitives in as many draw calls as buffers of the device's largest size take.
    #[expect(clippy::cast_possible_wrap, reason = "images are at most MAX_SIZE")]
    fn add_primitives<'a>(
        &mut self,
        connection: &Connection,
        layouts: &Layouts,
        primitives: impl Iterator<Item = Drawn<'a>>,
    ) {
        let limits = &connection.limits;
        let most = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        let image = Rect { x0: 0, y0: 0, x1: self.width as i32, y1: self.height as i32 };
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
        Known { perspective, zero_fragments, opaque, traits }
    }

    /// The constants of a pipeline that makes its image.
    pub fn knowledge(&self) -> [(&'static str, f64); 1] {
        [("has_opaque", flag(self.has_opaque))]
    }

    /// Fragments, and those of the deepest pixel.
    pub fn totals(&self) -> (u64, u64) {
        let sum = self.rows.iter().map(|row| u64::from(row[0])).sum();
        (sum, self.rows.iter().map(|row| u64::from(row[1])).max().unwrap_or(0))
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
    let pixels = u64::from(width) * u64::from(height);
    let most = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size) / 4;
    if pixels > most {
        let problem = format!(
            "an image of {pixels} pixels; {} counts fragments of {most} at most: a smaller one fits",
            connection.info.name
        );
        return Err(Error::argument("width", problem));
    }
    Ok(())
}
