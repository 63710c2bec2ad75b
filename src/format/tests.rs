//! Exhaustive where a format has few numbers, against arithmetic in integers elsewhere.
#![expect(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "small numbers, chosen here"
)]

use super::*;
use half::{bf16, f16};
use proptest::prelude::*;

/// A stored number, and which of its neighbours is even.
type Number = (f64, bool);

/// The finite numbers from 0 up of a float with so many bits of mantissa, the least exponent −14 and an exponent of 5
/// bits, decoded by definition.
fn small_floats(mantissa: i32) -> Vec<Number> {
    let codes = 0..31_i32 << mantissa;
    let decode = |code: i32| {
        let (exponent, low) = (code >> mantissa, code & ((1 << mantissa) - 1));
        let (leading, exponent) = if exponent == 0 { (0, 1) } else { (1 << mantissa, exponent) };
        f64::from(leading + low) * 2.0_f64.powi(exponent - 15 - mantissa)
    };
    codes.map(|code| (decode(code), code % 2 == 0)).collect()
}

fn halves() -> Vec<Number> {
    (0..0x7c00_u16).map(|bits| (f16::from_bits(bits).to_f64(), bits % 2 == 0)).collect()
}

fn brain_floats() -> Vec<Number> {
    (0..0x7f80_u16).map(|bits| (bf16::from_bits(bits).to_f64(), bits % 2 == 0)).collect()
}

/// Every number is its own rounding; what is between two of them goes to the nearer, and to the even one from the
/// middle.
fn rounds_to_nearest_even(numbers: &[Number], round: impl Fn(f64) -> f64) {
    for pair in numbers.windows(2) {
        let [(low, low_is_even), (high, _)] = pair else { unreachable!() };
        assert_eq!((round(*low), round(*high)), (*low, *high));
        let middle = 0.5 * (low + high);
        let even = if *low_is_even { *low } else { *high };
        assert_eq!(round(middle), even, "between {low} and {high}");
        assert_eq!((round(middle.next_down()), round(middle.next_up())), (*low, *high));
    }
    let (last, before) = (numbers[numbers.len() - 1].0, numbers[numbers.len() - 2].0);
    let limit = last + 0.5 * (last - before);
    assert_eq!((round(limit.next_down()), round(limit), round(1e300)), (last, f64::INFINITY, f64::INFINITY));
}

#[test]
fn every_float_of_16_bits_and_what_is_between_them() {
    for (format, numbers) in [(Format::F16, halves()), (Format::Bf16, brain_floats())] {
        rounds_to_nearest_even(&numbers, |x| format.round(x));
        rounds_to_nearest_even(&numbers, |x| -format.round(-x));
        assert_eq!(format.max_finite(0), numbers[numbers.len() - 1].0);
        assert_eq!(format.smallest_positive(), numbers[1].0);
        assert!(format.round(-1e-300).is_sign_negative() && format.round(f64::NAN).is_nan());
        assert_eq!(format.round(f64::NEG_INFINITY), f64::NEG_INFINITY);
    }
    assert_eq!(
        (Format::F16.smallest_normal(), Format::F16.unit_roundoff()),
        (6.103_515_625e-5, 2.0_f64.powi(-11))
    );
}

#[test]
fn every_number_of_r11g11b10f_and_what_is_between_them() {
    for (channel, mantissa, largest) in [(0, 6, 65_024.0), (1, 6, 65_024.0), (2, 5, 64_512.0)] {
        let numbers = small_floats(mantissa);
        let round = |x| Format::R11g11b10f.round_channel(x, channel);
        rounds_to_nearest_even(&numbers, round);
        assert_eq!(numbers[numbers.len() - 1].0, largest);
        assert_eq!(Format::R11g11b10f.max_finite(channel), largest);
        assert_eq!(Format::R11g11b10f.read_texel([f64::INFINITY; 3])[channel], largest);
        assert_eq!([-1e-9, -3.0, f64::NEG_INFINITY, -0.0].map(round).map(f64::to_bits), [0; 4]);
        assert!(round(f64::NAN).is_nan());
    }
    // halves decoded by definition, too
    assert_eq!(small_floats(10), halves());
}

#[test]
fn doubles_are_not_rounded_by_way_of_floats() {
    // just beyond the middle of two halves; the nearest f32 is the middle itself, whose even neighbour is 1
    let x = 1.0 + 2.0_f64.powi(-11) + 2.0_f64.powi(-40);
    assert_eq!(f64::from(x as f32), 1.0 + 2.0_f64.powi(-11));
    assert_eq!(Format::F16.round(x), 1.0 + 2.0_f64.powi(-10));
    assert_eq!(Format::F32.round(1.0 + 2.0_f64.powi(-24)), 1.0);
    assert_eq!(Format::F64.round(x), x);
}

#[test]
fn half_precision_by_the_processor_is_the_same() {
    let bits =
        (0..200_000_u32).map(|i| i.wrapping_mul(2_654_435_769)).filter(|b| f32::from_bits(*b).is_finite());
    let numbers: Vec<_> =
        bits.map(f32::from_bits).chain([65_519.996, 65_520.0, 5.960_464_5e-8, 2.98e-8]).collect();
    for format in Format::ALL {
        let mut stored = numbers.clone();
        format.round_all_f32(&mut stored);
        for (x, stored) in numbers.iter().zip(stored) {
            assert_eq!(f64::from(stored), f64::from(format.round(f64::from(*x)) as f32), "{format:?} {x}");
        }
    }
}

/// The nearest of `steps` equal steps, ties to even, from the bits of a number in [0, 1].
fn nearest_by_integers(x: f64, steps: u128) -> u128 {
    let exponent = (x.to_bits() >> 52) as i32;
    let (mantissa, exponent) = (x.to_bits() & ((1 << 52) - 1), exponent.max(1) - 1075);
    let mantissa = u128::from(if x >= f64::MIN_POSITIVE { mantissa | 1 << 52 } else { mantissa });
    if exponent < -120 {
        return 0;
    }
    let (product, shift) = (mantissa * steps, -exponent);
    let (whole, rest) = (product >> shift, product & ((1 << shift) - 1));
    let middle = 1_u128 << (shift - 1);
    whole + u128::from(rest > middle || rest == middle && whole % 2 == 1)
}

#[test]
fn every_normalized_integer_and_what_is_between_them() {
    for (format, steps) in [(Format::Unorm8, 255_u32), (Format::Unorm16, 65_535), (Format::Snorm8, 127)] {
        let scale = f64::from(steps);
        for k in 0..steps {
            let (low, high) = (f64::from(k) / scale, f64::from(k + 1) / scale);
            assert_eq!((format.round(low), format.round(high)), (low, high));
            let middle = (f64::from(k) + 0.5) / scale;
            for x in [middle, middle.next_down(), middle.next_up(), middle.next_up().next_up(), low + 1e-9] {
                let expected = nearest_by_integers(x, steps.into()) as f64 / scale;
                assert_eq!(format.round(x), expected, "{format:?} {x}");
            }
        }
        assert_eq!([1.0, 1.5, f64::INFINITY].map(|x| format.round(x)), [1.0; 3]);
        assert_eq!(format.round(f64::NAN), 0.0);
        assert_eq!(format.smallest_positive(), scale.recip());
    }
    assert_eq!([-1.0, -0.0, f64::NEG_INFINITY].map(|x| Format::Unorm8.round(x)), [0.0; 3]);
    assert_eq!(
        [-2.0, -1.0, -0.5, -3.0 / 127.0].map(|x| Format::Snorm8.round(x) * 127.0),
        [-127.0, -127.0, -64.0, -3.0]
    );
    // 127.5 is the one middle that is a double
    assert_eq!(Format::Unorm8.round(0.5) * 255.0, 128.0);
}

#[test]
fn depth_has_2_to_the_24_steps() {
    let last = 16_777_215.0;
    for k in (0..1 << 24).step_by(997).map(f64::from) {
        assert_eq!(Format::D24.round(k / last), k / last);
        let middle = (k + 0.5) / last;
        assert_eq!(Format::D24.round(middle), nearest_by_integers(middle, 16_777_215) as f64 / last);
    }
}

#[test]
fn srgb_codes_are_nearest_where_they_are_encoded() {
    let encode = |x: f64| if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
    for k in 0..=100_000_u32 {
        let x = f64::from(k) / 1e5;
        let code = encode(Format::Srgb8.round(x)) * 255.0;
        assert!((code - code.round()).abs() < 1e-3, "{x} is stored as {code}");
        assert!((code - encode(x) * 255.0).abs() < 0.501, "{x} is stored as {code}");
    }
    let steps = srgb8_steps();
    assert!(steps.iter().all(|x| Format::Srgb8.round(*x) == *x) && steps.is_sorted());
    assert_eq!([-1.0, 2.0, f64::NAN].map(|x| Format::Srgb8.round(x)), [0.0, 1.0, 0.0]);
    assert!((Format::Srgb8.round(0.2145) - 0.215_861).abs() < 1e-6); // code 128
}

/// The first exponent that leaves all mantissas below 2^9, in units of 2^-80.
fn shared_exponent_by_search(rgb: [f64; 3]) -> [f64; 3] {
    let unit = 2.0_f64.powi(80);
    let units = rgb.map(|x| if x > 0.0 { (x.min(65_408.0) * unit) as u128 } else { 0 });
    for exponent in 0..32 {
        let quantum = 1_u128 << (80 + exponent - 24);
        let mantissas = units.map(|x| (x + quantum / 2) / quantum);
        if mantissas.iter().all(|m| *m < 512) {
            return mantissas.map(|m| m as f64 * quantum as f64 / unit);
        }
    }
    unreachable!("65408 is 511 · 2^7")
}

#[test]
fn shared_exponents_by_hand() {
    let stored = |mut rgb: [f64; 3]| {
        Format::Rgb9e5.round_texel(&mut rgb);
        rgb
    };
    assert_eq!(stored([1.0, 0.5, 0.25]), [1.0, 0.5, 0.25]);
    assert_eq!(stored([f64::INFINITY, -1.0, f64::NAN]), [65_408.0, 0.0, 0.0]);
    // quanta of 2^-8 beside 1, ties up
    assert_eq!(stored([1.0, 0.5 / 256.0, 1.49 / 256.0]), [1.0, 1.0 / 256.0, 1.0 / 256.0]);
    // 511.5 rounds to the next exponent, which halves the others' precision
    assert_eq!(stored([511.5, 3.0, 0.99]), [512.0, 4.0, 0.0]);
    assert_eq!(stored([2.0_f64.powi(-24), 2.0_f64.powi(-26), 0.0]), [2.0_f64.powi(-24), 0.0, 0.0]);
    let mut texel = [1.0, 1.0, 1.0, 70_000.0];
    Format::Rgb9e5.round_texel(&mut texel);
    assert_eq!(texel[3], f64::INFINITY);
}

fn number() -> impl Strategy<Value = f64> {
    let of_any_size = (-1.0..1.0_f64, -30..20_i32).prop_map(|(x, exponent)| x * 2.0_f64.powi(exponent));
    prop_oneof![4 => of_any_size, 2 => 0.0..1.0_f64, 1 => any::<f64>().prop_filter("a number", |x| !x.is_nan())]
}

proptest! {
    #[test]
    fn rounding_is_monotone_and_idempotent(a in number(), b in number()) {
        for format in Format::ALL {
            for channel in 0..4 {
                let round = |x| format.round_channel(x, channel);
                prop_assert!(round(a.min(b)) <= round(a.max(b)), "{format:?} {a} {b}");
                prop_assert_eq!(round(round(a)).to_bits(), round(a).to_bits(), "{:?} {}", format, a);
            }
        }
    }

    #[test]
    fn the_error_is_at_most_the_unit_roundoff(x in 0.0..1.0_f64) {
        for format in Format::ALL {
            let scale = if format.is_normalized() { 1.0 } else { x.max(format.smallest_normal()) };
            prop_assert!((format.round(x) - x).abs() <= format.unit_roundoff() * scale, "{format:?} {x}");
        }
    }

    #[test]
    fn shared_exponents_are_those_of_a_search(r in -1.0..7e4_f64, g in 0.0..1.0_f64, b in number()) {
        let b = if b.abs() < 2.0_f64.powi(-27) { 0.0 } else { b };
        for rgb in [[r, g, b], [b, g, r], [g, g * g, b.min(1.0)], [g * 1e-3, 0.0, 0.0]] {
            let rgb = rgb.map(|x| if x.abs() < 2.0_f64.powi(-27) { 0.0 } else { x });
            let mut stored = rgb;
            Format::Rgb9e5.round_texel(&mut stored);
            prop_assert_eq!(stored, shared_exponent_by_search(rgb), "{:?}", rgb);
            let once = stored;
            Format::Rgb9e5.round_texel(&mut stored);
            prop_assert_eq!(stored, once);
        }
    }

    #[test]
    fn many_at_once_are_those_of_one(numbers in prop::collection::vec(number(), 0..40)) {
        for format in Format::ALL {
            let mut all = numbers.clone();
            format.round_all(&mut all);
            for (x, stored) in numbers.iter().zip(all) {
                prop_assert_eq!(stored.to_bits(), format.round(*x).to_bits(), "{:?} {}", format, x);
            }
        }
    }
}

#[test]
fn texels_take_the_room_that_targets_have() {
    let bytes = |format: Format| [1, 2, 3, 4].map(|channels| format.bytes(channels));
    assert_eq!(bytes(Format::F64), [8.0, 16.0, 32.0, 32.0]);
    assert_eq!(bytes(Format::F32), [4.0, 8.0, 16.0, 16.0]);
    assert_eq!(bytes(Format::F16), [2.0, 4.0, 8.0, 8.0]);
    assert_eq!(bytes(Format::Unorm8), [1.0, 2.0, 4.0, 4.0]);
    assert_eq!([bytes(Format::R11g11b10f), bytes(Format::Rgb9e5)], [[4.0, 4.0, 4.0, 6.0]; 2]);
    assert_eq!(Format::D24.bytes(1), 3.0);
}

#[test]
fn names_are_those_of_the_formats() {
    let names: Vec<_> = Format::ALL.into_iter().map(Format::name).collect();
    let expected = "f64 f32 f16 bf16 r11g11b10f rgb9e5 unorm8 unorm16 snorm8 d24 srgb8";
    assert_eq!(names.join(" "), expected);
    assert!(Format::ALL.into_iter().all(|format| Format::from_name(format.name()) == Some(format)));
    assert_eq!(Format::from_name("f8"), None);
}

#[test]
fn limits_are_numbers_of_their_formats() {
    for format in Format::ALL {
        let smallest = format.smallest_positive();
        for x in [format.max_finite(0), smallest, format.smallest_normal()] {
            assert_eq!(format.round(x), x, "{format:?}");
        }
        assert!(format.round(0.2 * smallest) < smallest || format == Format::F64, "{format:?}");
        assert_eq!(format.round(f64::MAX).is_infinite(), format.has_infinity() && format != Format::F64);
    }
    let largest = |format: Format| format.max_finite(0);
    assert_eq!(largest(Format::Rgb9e5), 65_408.0);
    assert_eq!((largest(Format::F64), largest(Format::F32)), (f64::MAX, f64::from(f32::MAX)));
    assert!((Format::Srgb8.unit_roundoff() - 0.0045).abs() < 1e-4);
}
