//! What a render gives back: images and what they cost.

use crate::params::Params;
use crate::spare::{Spare, bytes_of};
use multiversion::multiversion;
use std::sync::Arc;

/// A sample type of images.
pub trait Sample: Copy + Send + Sync + Default + 'static {
    /// Whether a pixel may be answered by a shortcut that is within two units of this type's last place.
    const SHORTCUTS: bool;

    /// The nearest sample; values beyond the type's range become its largest finite value.
    fn from_f64(value: f64) -> Self;
    /// Colours and background shares, channel by channel, as samples.
    fn store(pixels: [&[f64]; 4], colors: &mut [[Self; 3]], shares: &mut [Self]);
    /// Wraps a buffer of samples.
    fn wrap(samples: Vec<Self>) -> Image;
    /// Buffers that nobody needs any more.
    fn spare() -> &'static Spare<Vec<Self>>;
}

impl Sample for f32 {
    const SHORTCUTS: bool = true;

    #[inline]
    #[expect(clippy::cast_possible_truncation, reason = "rounding to the sample type is the point")]
    fn from_f64(value: f64) -> Self {
        value.clamp(f64::from(f32::MIN), f64::from(f32::MAX)) as f32
    }
    fn store(pixels: [&[f64]; 4], colors: &mut [[Self; 3]], shares: &mut [Self]) {
        store_f32(pixels, colors, shares);
    }
    fn wrap(samples: Vec<Self>) -> Image {
        Image::F32(samples)
    }
    fn spare() -> &'static Spare<Vec<Self>> {
        static SPARE: Spare<Vec<f32>> = Spare::new();
        &SPARE
    }
}

impl Sample for f64 {
    // techniques keep their state in f32, which a shortcut would go around
    const SHORTCUTS: bool = false;

    #[inline]
    fn from_f64(value: f64) -> Self {
        value
    }
    fn store(pixels: [&[f64]; 4], colors: &mut [[Self; 3]], shares: &mut [Self]) {
        let [r, g, b, share] = pixels;
        for (((color, r), g), b) in colors.iter_mut().zip(r).zip(g).zip(b) {
            *color = [*r, *g, *b];
        }
        shares.copy_from_slice(share);
    }
    fn wrap(samples: Vec<Self>) -> Image {
        Image::F64(samples)
    }
    fn spare() -> &'static Spare<Vec<Self>> {
        static SPARE: Spare<Vec<f64>> = Spare::new();
        &SPARE
    }
}

/// [`Sample::from_f64`] of finite pixels, or infinite ones, many at a time.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
#[expect(clippy::cast_possible_truncation, reason = "rounding to the sample type is the point")]
fn store_f32([r, g, b, share]: [&[f64]; 4], colors: &mut [[f32; 3]], shares: &mut [f32]) {
    let largest = f64::from(f32::MAX);
    // `clamp` also keeps what is no number, which costs another comparison
    let nearest = |value: f64| {
        let value = if value < largest { value } else { largest };
        (if value > -largest { value } else { -largest }) as f32
    };
    // slices of one length need no checks, and the loops become ones of vectors across the pixels
    let pixels = colors.len();
    let (r, g, b, share) = (&r[..pixels], &g[..pixels], &b[..pixels], &share[..pixels]);
    for i in 0..pixels {
        colors[i] = [nearest(r[i]), nearest(g[i]), nearest(b[i])];
    }
    for (to, share) in shares.iter_mut().zip(share) {
        *to = nearest(*share);
    }
}

/// Samples of an image, row by row from the top, channels together. Their memory is used again afterwards.
#[derive(Debug, Clone, PartialEq)]
pub enum Image {
    /// Single precision.
    F32(Vec<f32>),
    /// Double precision.
    F64(Vec<f64>),
}

fn give_back<S: Sample>(samples: &mut Vec<S>) {
    let (bytes, samples) = (bytes_of(samples), std::mem::take(samples));
    S::spare().give_back(samples, bytes);
}

impl Drop for Image {
    fn drop(&mut self) {
        match self {
            Self::F32(samples) => give_back(samples),
            Self::F64(samples) => give_back(samples),
        }
    }
}

/// One technique's image of a scene.
#[derive(Debug, Clone)]
pub struct Frame {
    /// The technique's id.
    pub technique: &'static str,
    /// Every param, resolved.
    pub params: Params,
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Linear RGB; shared by the frames of equal requests.
    pub color: Arc<Image>,
    /// The background's share: one channel, or three for coloured transmission.
    pub transmittance: Arc<Image>,
    /// 1 or 3.
    pub transmittance_channels: usize,
    /// What it took.
    pub stats: Stats,
}

/// What can be skipped.
const SKIPS: [&str; 10] = [
    "empty_tiles",
    "empty_pixels",
    "occluded_fragments",
    "occluded_primitives",
    "single_fragment_pixels",
    "hidden_fragments",
    "one_color_tiles",
    "layered_tiles",
    "repeated_pixels",
    "duplicate_variants",
];

/// Everything that can be skipped, with how often it was; 0 where nobody counted, as on a backend that does not skip it.
pub fn skipped(counted: &[(&'static str, u64)]) -> Vec<(&'static str, u64)> {
    debug_assert!(counted.iter().all(|(name, _)| SKIPS.contains(name)), "{counted:?}");
    let count = |name| counted.iter().find(|(counted, _)| *counted == name).map_or(0, |(_, count)| *count);
    SKIPS.iter().map(|name| (*name, count(*name))).collect()
}

/// What a render took.
#[derive(Debug, Clone, PartialEq)]
pub struct Stats {
    /// Wall time of this variant alone: set-up, its raster share and its resolve.
    pub total_ms: f64,
    /// Wall time of projecting, binning and rasterising; shared by all variants of a call.
    pub raster_ms: f64,
    /// Wall time of the technique on the fragments.
    pub resolve_ms: f64,
    /// Transparent fragments in the image.
    pub fragments: u64,
    /// Mean fragments per pixel, empty pixels included.
    pub depth_complexity_mean: f64,
    /// Most fragments in a pixel.
    pub depth_complexity_max: u64,
    /// Geometry passes that a streaming GPU implementation needs.
    pub geometry_passes: f64,
    /// Bytes per pixel that a streaming GPU implementation needs.
    pub bytes_per_pixel: f64,
    /// Fragments that the technique's storage had no room for.
    pub dropped: u64,
    /// Fragments for which a weight or bin function of the user's own gave none: see [`crate::params::Reports`].
    pub invalid_weights: u64,
    /// What was skipped, and how often; see [`skipped`].
    pub skipped: Vec<(&'static str, u64)>,
    /// What rendered it.
    pub backend: &'static str,
    /// Threads that worked.
    pub threads: usize,
}
