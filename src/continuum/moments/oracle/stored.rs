//! What storage does to moments.

use super::*;
use crate::continuum::moments::power::Powers;
use crate::params::Input;
use crate::technique::DepthComplexity;
use crate::techniques::testing::{VIEW, as_pixel, build, given, random_pixel};
use crate::techniques::{mboit_power, mboit_trig};

/// The oracle of these moments with the 16-bit table mixed in, whatever they are stored in.
struct Stored {
    oracle: MomentOracle<Powers>,
    formats: Formats,
}

impl Stored {
    fn new(format: &str, count: i64, bias: f64) -> Self {
        let inputs = [
            ("moments", Input::Int(count)),
            ("moments_format", Input::Text(format.into())),
            ("bias", Input::Float(bias)),
        ];
        let params = given(&mboit_power::INFO, &inputs);
        let powers = Powers::new(params.size("moments"), regularization(&params)).of_width(Width::Half);
        Self {
            oracle: MomentOracle::new(powers, &params, &VIEW),
            formats: Formats::from_params(mboit_power::INFO.targets, &params),
        }
    }

    /// T̂ in front of each fragment, and whether the bias was raised.
    fn see(&self, pixel: &[Fragment]) -> (Vec<f64>, bool) {
        let mut map = Map::default();
        as_pixel(pixel, |pixel| self.oracle.build_stored(pixel, &self.formats, &mut map));
        let seen = pixel.iter().map(|f| self.oracle.in_front_of(&map, f)).collect();
        (seen, map.moments.is_some_and(|m| m.retries > 0))
    }
}

/// The largest error of T̂ that is due to a format, that of 95 % of fragments, and the share of pixels whose bias had to
/// be raised.
fn errors(format: &str, count: i64, bias: f64) -> (f64, f64, f64) {
    let (exact, stored) = (Stored::new("f64", count, bias), Stored::new(format, count, bias));
    let (mut far, mut raised) = (Vec::new(), 0.0);
    for seed in 0..PIXELS {
        let pixel = random_pixel(1 + seed % 20, seed.into());
        let ((exact, _), (seen, was_raised)) = (exact.see(&pixel), stored.see(&pixel));
        far.extend(exact.iter().zip(seen).map(|(exact, seen)| (exact - seen).abs()));
        raised += f64::from(u8::from(was_raised));
    }
    far.sort_by(f64::total_cmp);
    (far[far.len() - 1], far[far.len() * 95 / 100], raised / f64::from(PIXELS))
}

const PIXELS: u32 = 300;

/// What implementations may differ by, for 95 % and at worst (sheet 2.5).
const CONFORMS: f64 = 2e-3;
const CONFORMS_AT_WORST: f64 = 0.1;

/// Sheet 2.5: sums in halves are useless below a bias of 1e-2. In a few pixels, that is: of most the error is small.
#[test]
fn sums_in_halves_are_unsafe_below_a_bias_of_a_hundredth() {
    for bias in [6e-5, 6e-4, 2.5e-3] {
        let (worst, _, raised) = errors("f16", 6, bias);
        assert!(worst > CONFORMS_AT_WORST && raised > 0.1, "{bias}: {worst} {raised}");
    }
    let (worst, _, raised) = errors("f16", 6, 1e-2);
    assert!(worst < CONFORMS_AT_WORST && raised < 0.01, "{worst} {raised}");
    // eight are, whatever the bias
    for bias in [2.5e-3, 1e-2, 1e-1] {
        assert!(errors("f16", 8, bias).0 > CONFORMS_AT_WORST, "{bias}");
    }
}

/// The transform is worth more than the bits: four moments in 16 bits are as good as another implementation's.
#[test]
fn transformed_means_in_16_bits_need_no_more_than_the_bias_of_the_paper() {
    let bias = Powers::default_bias(4, Width::Half);
    let (worst, most, raised) = errors("unorm16", 4, bias);
    assert!(worst < 0.02 && most < 0.1 * CONFORMS && raised == 0.0, "{worst} {most} {raised}");
    let (halves, ..) = errors("f16", 4, bias);
    assert!(halves > 4.0 * worst, "{halves} {worst}");
    // which they do need
    let (worst, _, raised) = errors("unorm16", 4, 0.0);
    assert!(worst > 0.05 && raised > 0.1, "{worst} {raised}");
}

#[test]
fn the_bias_follows_the_formats_unless_it_is_given() {
    let text = |name, value: &str| (name, Input::Text(value.to_owned()));
    let storages = [
        (text("format", "f32"), Width::Single),
        (text("format", "f64"), Width::Single),
        (text("accumulation_format", "f16"), Width::Single),
        (text("format", "f16"), Width::Half),
        (text("moments_format", "bf16"), Width::Half),
        (text("absorbance_format", "f16"), Width::Half),
    ];
    for (storage, expected) in storages {
        let tables = [
            (&mboit_power::INFO, [4, 6, 8], [[5e-7, 5e-6, 5e-5], [6e-5, 6e-4, 2.5e-3]]),
            (&mboit_trig::INFO, [2, 3, 4], [[4e-7, 8e-7, 1.5e-6], [4e-4, 6.5e-4, 8.5e-4]]),
        ];
        for (info, counts, table) in tables {
            let row = table[usize::from(expected == Width::Half)];
            for (count, bias) in counts.into_iter().zip(row) {
                let inputs = [("moments", Input::Int(count)), storage.clone()];
                let params = given(info, &inputs);
                assert_eq!((params.float("bias"), width(&params)), (bias, expected), "{inputs:?}");
                let stated = given(info, &[&inputs[..], &[("bias", Input::Float(0.125))]].concat());
                assert_eq!(stated.float("bias"), 0.125);
            }
        }
    }
}

#[test]
fn the_precision_is_that_of_the_coarser_format() {
    let precision = |given_formats: &[(&str, &str)]| {
        let inputs: Vec<_> =
            given_formats.iter().map(|(name, format)| (*name, Input::Text((*format).to_owned()))).collect();
        regularization(&given(&mboit_power::INFO, &inputs)).precision
    };
    assert_eq!(precision(&[]), f64::from(f32::EPSILON));
    assert_eq!(precision(&[("format", "f64")]), f64::EPSILON);
    assert_eq!(precision(&[("absorbance_format", "f16")]), 2.0_f64.powi(-10));
    assert_eq!(precision(&[("moments_format", "unorm16"), ("absorbance_format", "f16")]), 1.0 / 65_535.0);
}

#[test]
fn unorm16_is_for_the_moments_whose_transform_is_known() {
    let inputs = |count| [("moments", Input::Int(count)), ("moments_format", Input::Text("unorm16".into()))];
    let bytes = build("mboit_power", &inputs(4)).unwrap().cost(&DepthComplexity { mean: 1.0, max: 1 });
    // R32F and RGBA16, and pass B
    assert_eq!(bytes.bytes_per_pixel, 12.0 + 20.0);
    for count in [6, 8] {
        let message = build("mboit_power", &inputs(count)).err().unwrap().to_string();
        assert!(message.contains("\"unorm16\"") && message.contains("4 moments"), "{message}");
    }
    assert!(build("mboit_trig", &inputs(2)).err().is_some());
}
