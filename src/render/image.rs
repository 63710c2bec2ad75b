//! The buffers of a render, and their distribution over threads without locks or overlap.

use crate::error::{Error, Result};
use crate::frame::Sample;
use crate::raster::Rect;
use crate::resolve::Variant;
use crate::technique::Resolved;
use std::ops::Range;

/// One variant's images.
#[derive(Debug, Clone)]
pub struct VariantImage<S> {
    pub color: Vec<S>,
    pub transmittance: Vec<S>,
    /// Channels of the transmittance.
    pub channels: usize,
}

/// All images of a render.
#[derive(Debug)]
pub struct Target<S> {
    pub width: u32,
    pub height: u32,
    pub images: Vec<VariantImage<S>>,
}

impl<S: Sample> Target<S> {
    /// Buffers for variants whose transmittances have the given numbers of channels.
    ///
    /// # Errors
    /// [`Error::Memory`] where there is no room for them.
    pub fn new(width: u32, height: u32, channels: &[usize]) -> Result<Self> {
        let pixels = width as usize * height as usize;
        let samples = channels.iter().map(|c| (3 + c) * pixels).sum::<usize>();
        // a failing vec! would abort; zeroed memory is only claimed once it is written
        let room = Vec::<S>::new().try_reserve_exact(samples);
        room.map_err(|_| Error::Memory(format!("{} images of {width} x {height}", channels.len())))?;
        let image = |&channels| VariantImage {
            color: vec![S::default(); 3 * pixels],
            transmittance: vec![S::default(); channels * pixels],
            channels,
        };
        Ok(Self { width, height, images: channels.iter().map(image).collect() })
    }

    /// The buffers cut into bands of `rows` rows.
    pub fn bands(&mut self, rows: u32) -> Vec<Band<'_, S>> {
        let pixels = self.width as usize * self.height as usize;
        let band = self.width as usize * rows as usize;
        let ends: Vec<_> = (1..=pixels.div_ceil(band)).map(|i| (i * band).min(pixels)).collect();
        self.runs(&ends).into_iter().map(|(_, band)| band).collect()
    }

    /// The buffers cut after the given ascending numbers of pixels, each part with its first pixel.
    pub fn runs(&mut self, ends: &[usize]) -> Vec<(usize, Band<'_, S>)> {
        let width = self.width as usize;
        let mut rest = Band {
            width,
            pixels: width * self.height as usize,
            images: self
                .images
                .iter_mut()
                .map(|image| ImageSlice {
                    color: &mut image.color,
                    transmittance: &mut image.transmittance,
                    channels: image.channels,
                })
                .collect(),
        };
        let mut first = 0;
        let mut parts = Vec::with_capacity(ends.len());
        for &end in ends {
            let (part, tail) = rest.split(end - first);
            parts.push((first, part));
            rest = tail;
            first = end;
        }
        parts
    }
}

struct ImageSlice<'a, S> {
    color: &'a mut [S],
    transmittance: &'a mut [S],
    channels: usize,
}

/// A run of pixels of all images.
pub struct Band<'a, S> {
    width: usize,
    pixels: usize,
    images: Vec<ImageSlice<'a, S>>,
}

impl<S: Sample> Band<'_, S> {
    /// The number of pixels.
    pub fn pixels(&self) -> usize {
        self.pixels
    }

    fn split(self, pixels: usize) -> (Self, Self) {
        let (mut head, mut tail) = (Vec::new(), Vec::new());
        for ImageSlice { color, transmittance, channels } in self.images {
            let (c0, c1) = color.split_at_mut(3 * pixels);
            let (t0, t1) = transmittance.split_at_mut(channels * pixels);
            head.push(ImageSlice { color: c0, transmittance: t0, channels });
            tail.push(ImageSlice { color: c1, transmittance: t1, channels });
        }
        let (width, rest) = (self.width, self.pixels - pixels);
        (Self { width, pixels, images: head }, Self { width, pixels: rest, images: tail })
    }

    /// Stores a piece that covers the whole run.
    pub fn store_run(&mut self, piece: &Piece<S>) {
        for (image, (color, transmittance)) in self.images.iter_mut().zip(&piece.images) {
            image.color.copy_from_slice(color);
            image.transmittance.copy_from_slice(transmittance);
        }
    }

    /// Stores a part of the image in a band of whole rows that begins with row `top`.
    pub fn store(&mut self, rect: &Rect, top: i32, piece: &Piece<S>) {
        for row in 0..rect.height() {
            let to = self.row(rect, top, row);
            let from = row * rect.width()..(row + 1) * rect.width();
            for (image, (color, transmittance)) in self.images.iter_mut().zip(&piece.images) {
                let channels = image.channels;
                image.color[scaled(&to, 3)].copy_from_slice(&color[scaled(&from, 3)]);
                image.transmittance[scaled(&to, channels)]
                    .copy_from_slice(&transmittance[scaled(&from, channels)]);
            }
        }
    }

    /// Fills a tile of the band with the background.
    pub fn clear(&mut self, rect: &Rect, background: [f32; 3]) {
        let background = background.map(|c| S::from_f64(f64::from(c)));
        for row in 0..rect.height() {
            let to = self.row(rect, rect.y0, row);
            for image in &mut self.images {
                image.color[scaled(&to, 3)].as_chunks_mut().0.fill(background);
                image.transmittance[scaled(&to, image.channels)].fill(S::from_f64(1.0));
            }
        }
    }

    /// The pixels of a row of `rect`.
    #[expect(clippy::cast_sign_loss, reason = "tiles lie in the image")]
    fn row(&self, rect: &Rect, top: i32, row: usize) -> Range<usize> {
        let first = ((rect.y0 - top) as usize + row) * self.width + rect.x0 as usize;
        first..first + rect.width()
    }
}

/// The samples of a range of pixels.
fn scaled(pixels: &Range<usize>, channels: usize) -> Range<usize> {
    channels * pixels.start..channels * pixels.end
}

/// Resolved pixels on their way into a band.
pub struct Piece<S> {
    /// Colour and transmittance per variant.
    images: Vec<(Vec<S>, Vec<S>)>,
    channels: Vec<usize>,
}

impl<S: Sample> Piece<S> {
    /// An empty piece with room for so many pixels.
    pub fn with_capacity(pixels: usize, variants: &[Variant]) -> Self {
        let channels: Vec<_> =
            variants.iter().map(|v| if v.technique.colored_transmittance() { 3 } else { 1 }).collect();
        let room = |c: &usize| (Vec::with_capacity(3 * pixels), Vec::with_capacity(c * pixels));
        Self { images: channels.iter().map(room).collect(), channels }
    }

    /// Appends pixels of variant `v`.
    pub fn append(&mut self, v: usize, resolved: &[Resolved]) {
        let (color, transmittance) = &mut self.images[v];
        for pixel in resolved {
            color.extend(pixel.color.to_array().map(S::from_f64));
            let share = pixel.transmittance.to_array().map(S::from_f64);
            transmittance.extend_from_slice(&share[..self.channels[v]]);
        }
    }
}
