//! Order of submission: it matters exactly where a technique does not promise that it does not.

use super::{OTHER_ORDER, Variant, pixels, variants};
use crate::format::Format;
use crate::fragments::Fragment;
use crate::order::SubmissionOrder;
use crate::params::{Params, Setting, Value};
use crate::techniques::testing::{Random, fragment, random_pixel, submission_order};

/// How far permutations of a pixel's fragments move its colour, relative to it.
fn sensitivity(variant: &Variant, mut pixel: Vec<Fragment>) -> f64 {
    let mut random = Random::new(9);
    let before = variant.resolve(&pixel);
    let scale = before.color.abs().max_element().max(1.0);
    let mut moved = 0.0_f64;
    pixel.reverse();
    for _ in 0..3 {
        let after = variant.resolve(&pixel);
        let transmittance = (after.transmittance - before.transmittance).abs().max_element();
        moved =
            moved.max((after.color - before.color).abs().max_element() / scale).max(transmittance / scale);
        random.shuffle(&mut pixel);
    }
    moved
}

#[test]
fn order_matters_exactly_where_it_is_not_claimed_to_be_irrelevant() {
    for variant in variants() {
        let mut sensitivities = pixels().chain([veils()]).map(|pixel| sensitivity(&variant, pixel));
        let arrival =
            matches!(submission_order(&variant.params), SubmissionOrder::AsIs | SubmissionOrder::Reversed);
        if variant.properties().order_independent {
            let allowed = if variant.technique.needs_sorted() { 0.0 } else { rounding(&variant) };
            let most = sensitivities.fold(0.0, f64::max);
            assert!(most <= allowed, "{}: moved by {most:e}", variant.name());
        } else if arrival && !hardly_ordered(&variant.params) {
            let mut telling = curtains().chain(lids()).map(|pixel| sensitivity(&variant, pixel));
            let moves = |moved| moved > 10.0 * OTHER_ORDER;
            let moved = sensitivities.any(moves) || telling.any(moves);
            assert!(moved, "{} never moved", variant.name());
        }
    }
}

/// What another order may do to sums in f32. Moments amplify their rounding: the bias of the papers keeps it
/// below what implementations may differ by, less bias below what they may at worst (sheet 2.5). Narrower formats round
/// more, once per layer.
fn rounding(variant: &Variant) -> f64 {
    let bias = variant.params.iter().find(|(name, _)| *name == "bias");
    let rounding = match bias.map(|(_, setting)| setting) {
        None => OTHER_ORDER,
        Some(Setting::Plain(Value::Float(bias))) if *bias >= 1e-7 => 2e-3,
        Some(_) => 0.1,
    };
    let has = |wanted: &str| variant.params.iter().any(|(name, _)| name == wanted);
    let fixed = has("summation") && variant.params.is("summation", "fixed");
    // weights that are seen through a map are rounded as the map's sums are
    if fixed && !has("composite") { 0.0 } else { rounding.max(narrow_rounding(&variant.params)) }
}

/// The unit roundoff of the narrowest format, twice per layer.
fn narrow_rounding(params: &Params) -> f64 {
    let is_format = |name: &str| name.ends_with("_format");
    let formats = params.identity().into_iter().filter(|(name, _)| is_format(name));
    let narrow = formats.filter_map(|(_, setting)| match setting {
        Setting::Plain(Value::Text(name)) => Format::from_name(name).filter(|format| *format != Format::F32),
        _ => None,
    });
    narrow.map(|format| 2.0 * 64.0 * format.unit_roundoff()).fold(0.0, f64::max)
}

/// Whether the size is such that order has next to nothing to decide: room for all fragments that there are,
/// or for hardly any.
fn hardly_ordered(params: &Params) -> bool {
    params.iter().any(|param| match param {
        ("opaque_threshold", Setting::Plain(Value::Float(alpha))) => *alpha < 0.1,
        (_, Setting::Plain(Value::Int(size))) => *size >= 33,
        _ => false,
    })
}

/// A layer that hides most of the many faint ones behind it, front to back: of those, only some are visible, so
/// that a list which gets them first keeps others than one which gets them last.
fn lids() -> impl Iterator<Item = Vec<Fragment>> {
    (0..32_u8).map(|i| {
        let mut random = Random::new(i.into());
        let mut faint = |k: u8| {
            let rgb = [random.unit(), random.unit(), random.unit()];
            fragment(2.0 + f32::from(k) / 8.0, rgb, 1.0 / 16.0, u32::from(k) * 32 + u32::from(i))
        };
        let alpha = [0.5, 0.7, 0.85, 0.95][usize::from(i % 4)];
        let lid = fragment(1.0, [0.9, 0.6, 0.3], alpha, 10_000 + u32::from(i));
        std::iter::once(lid).chain((0..50).map(&mut faint)).collect()
    })
}

/// Dense layers in any order behind many faint ones, which come first: those fill a list, and what is behind
/// them merges as it comes.
fn curtains() -> impl Iterator<Item = Vec<Fragment>> {
    (0..12_u8).map(|i| {
        let mut pixel = random_pixel(40, 300 + u64::from(i));
        for f in &mut pixel {
            let share = 0.02 / f.alpha.max(0.02);
            *f = Fragment { depth: 0.1 * f.depth, alpha: f.alpha * share, ..*f };
            f.color = f.color.map(|c| c * share);
        }
        pixel.extend(random_pixel(24, 400 + u64::from(i)));
        // primitives of their own, and so random numbers
        (0..).zip(&mut pixel).for_each(|(k, f)| f.primitive = 100_000 * u32::from(i) + k);
        pixel
    })
}

/// Layers so faint that the last one still shows: nothing hides what an order does to the others.
fn veils() -> Vec<Fragment> {
    let mut pixel = random_pixel(64, 200);
    for f in &mut pixel {
        *f = Fragment { color: f.color.map(|c| c / 16.0), alpha: f.alpha / 16.0, ..*f };
    }
    pixel
}
