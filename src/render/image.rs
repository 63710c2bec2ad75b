//! The buffers of a render, and their distribution over threads without locks or overlap.

use super::Tally;
use crate::frame::Sample;
use crate::raster::Rect;
use crate::resolve::Variant;
use crate::technique::{Batch, Resolved};

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
    pub first_depth: Vec<f32>,
    pub fragment_count: Vec<u32>,
}

impl<S: Sample> Target<S> {
    /// Buffers for variants whose transmittances have the given numbers of channels.
    pub fn new(width: u32, height: u32, channels: Vec<usize>) -> Self {
        let pixels = width as usize * height as usize;
        let image = |channels| VariantImage {
            color: vec![S::default(); 3 * pixels],
            transmittance: vec![S::default(); channels * pixels],
            channels,
        };
        Self {
            width,
            height,
            images: channels.into_iter().map(image).collect(),
            first_depth: vec![f32::INFINITY; pixels],
            fragment_count: vec![0; pixels],
        }
    }

    /// The buffers cut into bands of `rows` rows.
    pub fn bands(&mut self, rows: u32) -> Vec<Band<'_, S>> {
        let pixels = self.first_depth.len();
        let band = self.width as usize * rows as usize;
        let ends: Vec<_> = (1..=pixels.div_ceil(band)).map(|i| (i * band).min(pixels)).collect();
        self.runs(&ends).into_iter().map(|(_, band)| band).collect()
    }

    /// The buffers cut after the given ascending numbers of pixels, each part with its first pixel.
    pub fn runs(&mut self, ends: &[usize]) -> Vec<(usize, Band<'_, S>)> {
        let width = self.width as usize;
        let mut rest = Band {
            width,
            images: self
                .images
                .iter_mut()
                .map(|image| ImageSlice {
                    color: &mut image.color,
                    transmittance: &mut image.transmittance,
                    channels: image.channels,
                })
                .collect(),
            first_depth: &mut self.first_depth,
            fragment_count: &mut self.fragment_count,
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
    images: Vec<ImageSlice<'a, S>>,
    first_depth: &'a mut [f32],
    fragment_count: &'a mut [u32],
}

impl<S: Sample> Band<'_, S> {
    /// The number of pixels.
    pub fn pixels(&self) -> usize {
        self.first_depth.len()
    }

    fn split(self, pixels: usize) -> (Self, Self) {
        let (d0, d1) = self.first_depth.split_at_mut(pixels);
        let (n0, n1) = self.fragment_count.split_at_mut(pixels);
        let (mut head, mut tail) = (Vec::new(), Vec::new());
        for ImageSlice { color, transmittance, channels } in self.images {
            let (c0, c1) = color.split_at_mut(3 * pixels);
            let (t0, t1) = transmittance.split_at_mut(channels * pixels);
            head.push(ImageSlice { color: c0, transmittance: t0, channels });
            tail.push(ImageSlice { color: c1, transmittance: t1, channels });
        }
        let width = self.width;
        (
            Self { width, images: head, first_depth: d0, fragment_count: n0 },
            Self { width, images: tail, first_depth: d1, fragment_count: n1 },
        )
    }

    /// Stores a piece that covers the whole run.
    pub fn store_run(&mut self, piece: &Piece<S>) {
        for (image, (color, transmittance)) in self.images.iter_mut().zip(&piece.images) {
            image.color.copy_from_slice(color);
            image.transmittance.copy_from_slice(transmittance);
        }
        self.first_depth.copy_from_slice(&piece.first_depth);
        self.fragment_count.copy_from_slice(&piece.fragment_count);
    }

    /// Stores a tile of a band of whole rows; without a piece the background shows alone.
    pub fn store(&mut self, rect: &Rect, piece: Option<&Piece<S>>, background: [f32; 3]) {
        let background = background.map(|c| S::from_f64(f64::from(c)));
        let (columns, rows) = (rect.width(), rect.height());
        #[expect(clippy::cast_sign_loss, reason = "tiles lie in the image")]
        let x0 = rect.x0 as usize;
        for row in 0..rows {
            let to = row * self.width + x0..row * self.width + x0 + columns;
            let from = row * columns..(row + 1) * columns;
            let scaled = |r: &std::ops::Range<usize>, n| n * r.start..n * r.end;
            let Some(piece) = piece else {
                for image in &mut self.images {
                    image.color[scaled(&to, 3)].as_chunks_mut().0.fill(background);
                    image.transmittance[scaled(&to, image.channels)].fill(S::from_f64(1.0));
                }
                continue;
            };
            for (image, (color, transmittance)) in self.images.iter_mut().zip(&piece.images) {
                let channels = image.channels;
                image.color[scaled(&to, 3)].copy_from_slice(&color[scaled(&from, 3)]);
                image.transmittance[scaled(&to, channels)]
                    .copy_from_slice(&transmittance[scaled(&from, channels)]);
            }
            self.first_depth[to.clone()].copy_from_slice(&piece.first_depth[from.clone()]);
            self.fragment_count[to].copy_from_slice(&piece.fragment_count[from]);
        }
    }
}

/// Resolved pixels on their way into a band.
pub struct Piece<S> {
    /// Colour and transmittance per variant.
    images: Vec<(Vec<S>, Vec<S>)>,
    channels: Vec<usize>,
    first_depth: Vec<f32>,
    fragment_count: Vec<u32>,
}

impl<S: Sample> Piece<S> {
    /// An empty piece with room for so many pixels.
    pub fn with_capacity(pixels: usize, variants: &[Variant]) -> Self {
        let channels: Vec<_> =
            variants.iter().map(|v| if v.technique.colored_transmittance() { 3 } else { 1 }).collect();
        Self {
            images: channels
                .iter()
                .map(|c| (Vec::with_capacity(3 * pixels), Vec::with_capacity(c * pixels)))
                .collect(),
            channels,
            first_depth: Vec::with_capacity(pixels),
            fragment_count: Vec::with_capacity(pixels),
        }
    }

    /// Appends a batch's pixels and counts its fragments.
    #[expect(clippy::cast_possible_truncation, reason = "a pixel's list is far shorter than 2^32")]
    pub fn append(&mut self, batch: &Batch<'_>, resolved: &[Vec<Resolved>], tally: &mut Tally) {
        for (((color, transmittance), channels), pixels) in
            self.images.iter_mut().zip(&self.channels).zip(resolved)
        {
            for pixel in pixels {
                color.extend(pixel.color.to_array().map(S::from_f64));
                let share = pixel.transmittance.to_array().map(S::from_f64);
                transmittance.extend_from_slice(&share[..*channels]);
            }
        }
        for i in 0..batch.lists.len() {
            let list = batch.lists.row(i);
            tally.count(list.len());
            self.fragment_count.push(list.len() as u32);
            self.first_depth.push(list.depth_bounds().map_or(f32::INFINITY, |(first, _)| first));
        }
    }
}
