//! What may come in from outside, made of arbitrary bytes, and what must hold whatever it is: no panic, no hang,
//! and either a finite image or an error that says what is wrong.

pub mod fragments;
pub mod params;
pub mod scenes;
pub mod weights;

use arbitrary::Arbitrary;
use oitlab::frame::{Frame, Image};
use oitlab::render::{Options, Request, Source, render};

/// A number that is often special, often ordinary, and sometimes any pattern of bits.
#[derive(Debug, Clone, Copy, Arbitrary)]
pub enum Number {
    /// Any pattern of bits.
    Bits(f64),
    /// One of the table.
    Special(u8),
    /// On the grid of sub-pixels, where ties happen.
    Grid(i16),
    /// Of any magnitude.
    Power(i8, i8),
}

const SPECIAL: [f64; 16] = [
    0.0,
    -0.0,
    1.0,
    -1.0,
    0.5,
    5e-324,
    1e-310,
    1e-45,
    1.2e-38,
    1e-30,
    1e30,
    3.4e38,
    -3.4e38,
    f64::INFINITY,
    f64::NAN,
    0.999_999_9,
];

impl Number {
    /// The number.
    pub fn get(self) -> f64 {
        match self {
            Self::Bits(x) => x,
            Self::Special(i) => SPECIAL[usize::from(i) % SPECIAL.len()],
            Self::Grid(i) => f64::from(i) / 256.0,
            Self::Power(m, e) => f64::from(m) * f64::from(e).exp2(),
        }
    }

    /// The nearest in single precision.
    pub fn single(self) -> f32 {
        self.get() as f32
    }
}

/// Renders in double precision, which hides no NaN behind the largest number, on one thread.
pub fn render_exactly(source: Source<'_>, requests: &[Request]) -> oitlab::Result<Vec<Frame>> {
    render::<f64>(source, requests, &Options::default(), &|| false)
}

/// The samples of a double-precision image.
pub fn samples(image: &Image) -> &[f64] {
    let Image::F64(samples) = image else { panic!("not double precision") };
    samples
}

/// Slack of a background's share that is promised to be the exact product: techniques round it to single precision.
const SHARE: f64 = 1e-6;

/// A frame has finite numbers, and where the background's share is promised to be exact it lies in [0, 1].
pub fn check_frame(frame: &Frame, exact_coverage: bool) {
    let shares = samples(&frame.transmittance);
    let id = frame.technique;
    assert!(samples(&frame.color).iter().all(|x| x.is_finite()), "{id}: {:?}", frame.color);
    assert!(shares.iter().all(|t| t.is_finite()), "{id}: {shares:?}");
    let range = -SHARE..=1.0 + SHARE;
    assert!(!exact_coverage || shares.iter().all(|t| range.contains(t)), "{id}: {shares:?}");
}

/// A frame of colours so bright that sums of them overflow in single precision: infinite at worst, which is stored as
/// the largest number, but not NaN.
pub fn check_overflow(frame: &Frame) {
    let id = frame.technique;
    assert!(samples(&frame.color).iter().all(|x| !x.is_nan()), "{id}: {:?}", frame.color);
    assert!(samples(&frame.transmittance).iter().all(|t| t.is_finite()), "{id}: {:?}", frame.transmittance);
}
