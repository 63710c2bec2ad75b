//! What storage does to maps and to what is seen through them, against plain computations by the formulas.

use super::*;
use crate::continuum::moments::power::Powers;
use crate::continuum::moments::{Basis, MAX_STORED, Regularization, Width};
use crate::fragments::Fragment;
use crate::params::Input;
use crate::techniques::find;
use crate::techniques::testing::{BACKGROUND, build, difference, random_pixel, resolve, three_layers};
use glam::{DVec3, Vec3};
use half::f16;
use std::f64::consts::PI;

type Inputs = Vec<(&'static str, Input)>;

const IDS: [&str; 11] = [
    "opacity_shadow_maps",
    "deep_opacity_maps",
    "density_clustering",
    "occupancy_maps",
    "fourier_opacity_maps",
    "tfm",
    "wavelet",
    "avsm",
    "deep_shadow_maps",
    "mboit_power",
    "mboit_trig",
];
const COMPOSITES: [&str; 3] = ["none", "exact_bg", "normalize"];

fn text(name: &'static str, value: &str) -> (&'static str, Input) {
    (name, Input::Text(value.into()))
}

fn int(name: &'static str, value: i64) -> (&'static str, Input) {
    (name, Input::Int(value))
}

/// A format by the conversions of other libraries.
#[derive(Clone, Copy)]
struct Rounding(&'static str);

impl Rounding {
    #[expect(clippy::cast_possible_truncation, reason = "that is what it is for")]
    fn round(self, x: f64) -> f64 {
        match self.0 {
            "f16" => f16::from_f64(x).to_f64(),
            "f32" => f64::from(x as f32),
            _ => x,
        }
    }
    /// What a shader hands over.
    #[expect(clippy::cast_possible_truncation, reason = "that is what it is for")]
    fn source(self, x: f64) -> f64 {
        if self.0 == "f64" { x } else { f64::from(x as f32) }
    }
    /// The sum, term by term.
    fn sum(self, terms: impl IntoIterator<Item = f64>) -> f64 {
        terms.into_iter().fold(0.0, |sum, x| self.round(sum + self.source(x)))
    }
}

/// T̂ in front of each fragment, and T̂(∞).
type Seen = (Vec<f64>, f64);

fn s(f: &Fragment) -> f64 {
    -(1.0 - f64::from(f.alpha)).ln()
}

/// The depths' range is 2 to 8.
fn d(f: &Fragment) -> f64 {
    (f64::from(f.depth) - 2.0) / 6.0
}

fn seen(taus: impl Iterator<Item = f64>, total: f64) -> Seen {
    let transmittance = |tau: f64| (-tau.max(0.0)).exp();
    (taus.map(transmittance).collect(), transmittance(total))
}

/// Bins that end at the given d, read with linear interpolation and freed of the fragment's own share.
fn through_bins(pixel: &[Fragment], r: Rounding, ends: &[f64]) -> Seen {
    let bin = |f: &Fragment| ends.iter().position(|end| d(f) < *end).unwrap_or(ends.len() - 1);
    let sum = |j: usize| r.sum(pixel.iter().filter(|f| bin(f) == j).map(s));
    let tau = |f: &Fragment| {
        let (j, near) = (bin(f), if bin(f) == 0 { 0.0 } else { ends[bin(f) - 1] });
        let inside = (d(f) - near) / (ends[j] - near);
        (0..j).map(sum).sum::<f64>() + inside * (sum(j) - s(f))
    };
    seen(pixel.iter().map(tau), (0..ends.len()).map(sum).sum())
}

fn opacity(pixel: &[Fragment], r: Rounding) -> Seen {
    through_bins(pixel, r, &[0.5, 1.0])
}

fn deep_opacity(pixel: &[Fragment], r: Rounding) -> Seen {
    through_bins(pixel, r, &[1.0 / 7.0, 3.0 / 7.0, 1.0])
}

/// One cluster, one iteration.
fn one_cluster(pixel: &[Fragment], r: Rounding) -> Seen {
    let moment = |k: i32| r.sum(pixel.iter().map(|f| s(f) * d(f).powi(k)));
    let mean = moment(1) / moment(0);
    let deviation = (moment(2) / moment(0) - mean * mean).sqrt();
    let share = |f: &Fragment| ((d(f) - mean) / (12.0_f64.sqrt() * deviation) + 0.5).clamp(0.0, 1.0);
    seen(pixel.iter().map(|f| moment(0) * share(f)), moment(0))
}

/// Four bits in one slab: the layers at 0, 1/3 and 1 have one each.
fn four_bits(pixel: &[Fragment], r: Rounding) -> Seen {
    let sum = r.sum(pixel.iter().map(s));
    let before = |f: &Fragment| pixel.iter().filter(|g| g.depth < f.depth).count();
    #[expect(clippy::cast_precision_loss, reason = "three fragments")]
    let share = |f: &Fragment| before(f) as f64 / pixel.len() as f64;
    seen(pixel.iter().map(|f| sum * share(f)), sum)
}

/// Two frequencies.
fn fourier(pixel: &[Fragment], r: Rounding) -> Seen {
    let phase = |f: &Fragment| 0.05 + 0.9 * d(f);
    let sum = |g: &dyn Fn(f64) -> f64| r.sum(pixel.iter().map(|f| s(f) * g(phase(f))));
    let total = sum(&|_| 1.0);
    let tau = |f: &Fragment| {
        let x = phase(f);
        let term = |k: f64| {
            let (a, b) = (sum(&|x| (2.0 * PI * k * x).cos()), sum(&|x| (2.0 * PI * k * x).sin()));
            let (sin, cos) = (2.0 * PI * k * x).sin_cos();
            (a * sin + b * (1.0 - cos) - s(f) * sin) / (PI * k)
        };
        total * x + term(1.0) + term(2.0) - s(f) * x
    };
    seen(pixel.iter().map(tau), total)
}

/// Two frequencies of extinction.
fn extinction(pixel: &[Fragment], r: Rounding) -> Seen {
    let sum = |k: f64| r.sum(pixel.iter().map(|f| s(f) * (PI * k * d(f)).cos()));
    let tau = |f: &Fragment| {
        let term = |k: f64| {
            let (sin, twice) = ((PI * k * d(f)).sin(), (2.0 * PI * k * d(f)).sin());
            (2.0 * sum(k) * sin - s(f) * twice) / (PI * k)
        };
        (sum(0.0) - s(f)) * d(f) + term(1.0) + term(2.0)
    };
    seen(pixel.iter().map(tau), sum(0.0))
}

/// Two frequencies of transmittance, each coefficient written once.
fn curve(pixel: &[Fragment], r: Rounding) -> Seen {
    let taken = |f: &Fragment| in_front(pixel, f) * f64::from(f.alpha);
    let mean = r.round(1.0 - pixel.iter().map(|f| taken(f) * (1.0 - d(f))).sum::<f64>());
    let half =
        |k: f64| r.round(pixel.iter().map(|f| taken(f) * (PI * k * d(f)).sin()).sum::<f64>() / (PI * k));
    let at = |d: f64| {
        let term = |k: f64| 2.0 * half(k) * (PI * k * d).cos();
        (mean + term(1.0) + term(2.0)).clamp(0.0, 1.0)
    };
    (pixel.iter().map(|f| at(d(f))).collect(), at(1.0))
}

/// Two leaves.
fn haar(pixel: &[Fragment], r: Rounding) -> Seen {
    let x = |f: &Fragment| 0.5 * d(f);
    let scale = r.sum(pixel.iter().map(|f| s(f) * (1.0 - x(f))));
    let node = r.sum(pixel.iter().map(|f| s(f) * x(f).min(1.0 - x(f))));
    let leaves = [scale - node, scale + node];
    let tau = |f: &Fragment| match d(f) {
        // at the near edge of the last leaf
        d if d >= 1.0 => leaves[0],
        d => d * leaves[0] - s(f) * d * (1.0 - d),
    };
    seen(pixel.iter().map(tau), leaves[1])
}

fn in_front(pixel: &[Fragment], f: &Fragment) -> f64 {
    pixel.iter().filter(|g| g.depth < f.depth).map(|g| 1.0 - f64::from(g.alpha)).product()
}

/// Every step in a node of its own, those behind a new fragment multiplied as it comes.
fn arriving_steps(pixel: &[Fragment], r: Rounding) -> Seen {
    let mut nodes: Vec<(f32, f64, f64)> = Vec::new();
    for f in pixel {
        let through = 1.0 - f64::from(f.alpha);
        let before = nodes.iter().filter(|node| node.0 < f.depth).max_by(|a, b| a.0.total_cmp(&b.0));
        let front = before.map_or(1.0, |node| node.2);
        for node in nodes.iter_mut().filter(|node| node.0 > f.depth) {
            (node.1, node.2) = (r.round(node.1 * through), r.round(node.2 * through));
        }
        nodes.push((f.depth, front, r.round(front * through)));
    }
    let last = nodes.iter().max_by(|a, b| a.0.total_cmp(&b.0)).map_or(1.0, |node| node.2);
    (nodes.iter().map(|node| node.1).collect(), last)
}

/// Every step in a node of its own, written once.
fn sorted_steps(pixel: &[Fragment], r: Rounding) -> Seen {
    let total = pixel.iter().map(|f| 1.0 - f64::from(f.alpha)).product();
    (pixel.iter().map(|f| r.round(in_front(pixel, f))).collect(), r.round(total))
}

/// Four moments, summed plainly and asked as always.
fn moments(pixel: &[Fragment], r: Rounding) -> Seen {
    let ln = |z: f32| f64::from(z).ln();
    let place = |f: &Fragment| 2.0 * (ln(f.depth) - ln(2.0)) / (ln(8.0) - ln(2.0)) - 1.0;
    let total = r.sum(pixel.iter().map(s));
    let mean = |k: i32| r.sum(pixel.iter().map(|f| s(f) * place(f).powi(k))) / total;
    let mut means = [0.0; MAX_STORED];
    means.iter_mut().zip(1..=4).for_each(|(m, k)| *m = mean(k));
    let width = if r.0 == "f16" { Width::Half } else { Width::Single };
    let precision = match r.0 {
        "f16" => 2.0_f64.powi(-10),
        "f32" => 2.0_f64.powi(-23),
        _ => 2.0_f64.powi(-52),
    };
    let bias = if width == Width::Half { 6e-5 } else { 5e-7 };
    let powers = Powers::new(4, Regularization { bias, precision }).of_width(width);
    let prepared = powers.prepare(&means);
    seen(pixel.iter().map(|f| total * powers.in_front(&prepared, place(f), 0.25)), total)
}

/// A technique, the params that make it small, and what its map says.
type Case = (&'static str, Inputs, fn(&[Fragment], Rounding) -> Seen);

fn cases() -> Vec<Case> {
    vec![
        ("opacity_shadow_maps", vec![int("bins", 2)], opacity),
        ("deep_opacity_maps", vec![int("bins", 3)], deep_opacity),
        ("density_clustering", vec![int("bins", 1), int("iterations", 1)], one_cluster),
        ("occupancy_maps", vec![int("bits", 4)], four_bits),
        ("fourier_opacity_maps", vec![int("frequencies", 2)], fourier),
        ("tfm", vec![int("frequencies", 2)], extinction),
        ("tfm", vec![int("frequencies", 2), text("project", "transmittance")], curve),
        ("wavelet", vec![int("rank", 0)], haar),
        ("avsm", vec![int("layers", 6)], arriving_steps),
        ("deep_shadow_maps", vec![int("vertices", 6)], sorted_steps),
        ("mboit_power", vec![int("moments", 4)], moments),
    ]
}

/// Pass B and the resolve, by the formulas of sheet 0.3.
fn composited(pixel: &[Fragment], r: Rounding, (seen, total): &Seen, composite: &str) -> (DVec3, f64) {
    let background = Vec3::from(BACKGROUND).as_dvec3();
    let weights: Vec<_> = seen.iter().map(|t| r.source(*t)).collect();
    let sum = |of: &dyn Fn(&Fragment) -> f64| r.sum(pixel.iter().zip(&weights).map(|(f, t)| t * of(f)));
    let color = DVec3::from([0, 1, 2].map(|c| sum(&|f| f.color[c].into())));
    let factor = |f: &Fragment| r.source(1.0 - f64::from(f.alpha));
    let share = pixel.iter().fold(1.0, |share, f| r.round(share * factor(f)));
    match composite {
        "none" => (color + *total * background, *total),
        "exact_bg" => (color + share * background, share),
        _ => ((1.0 - share) / sum(&|f| f.alpha.into()) * color + share * background, share),
    }
}

/// The formulas' rounding in f64, which the map of moments amplifies.
const SAME: f64 = 1e-11;
/// An absorbance that another function rounds to the other side of a step of f32, which halves hardly ever show.
const ROUNDED_SOURCE: f64 = 2e-7;

/// What halves change at least.
const VISIBLE: f64 = 1e-5;

#[test]
fn every_map_in_every_format_is_what_the_formulas_make_of_it() {
    let pixel = three_layers();
    for (id, small, map) in cases() {
        for (format, composite) in ["f64", "f32", "f16"].into_iter().flat_map(|f| COMPOSITES.map(|c| (f, c)))
        {
            // what counts as f32 keeps some in double precision
            let single = find(id).unwrap().targets.iter().map(|target| text(target.param, format));
            let inputs: Inputs = small
                .iter()
                .cloned()
                .chain([text("format", format), text("composite", composite)])
                .chain(single)
                .collect();
            let by_hand = map(&pixel, Rounding(format));
            // who sorts accumulates sorted fragments
            let mut order: Vec<_> = pixel.iter().copied().zip(by_hand.0).collect();
            if build(id, &inputs).unwrap().needs_sorted() {
                order.sort_by(|a, b| a.0.depth.total_cmp(&b.0.depth));
            }
            let (fragments, seen): (Vec<_>, Vec<_>) = order.into_iter().unzip();
            let (color, transmittance) =
                composited(&fragments, Rounding(format), &(seen, by_hand.1), composite);
            let tolerance = if format == "f64" { SAME } else { ROUNDED_SOURCE };
            let got = resolve(id, &inputs, &pixel);
            let far = difference(got, color, transmittance);
            assert!(far <= tolerance, "{id} {inputs:?}: {far:e}, {got:?} for {color} {transmittance}");
            if format == "f16" {
                // and that is not what it is without
                let exact = resolve(id, &[&small[..], &[text("composite", composite)]].concat(), &pixel);
                let far = difference(got, exact.color, exact.transmittance.x);
                assert!(far > VISIBLE, "{id} {inputs:?}: {far:e}");
            }
        }
    }
}

/// The default's arithmetic is that of the formats that it stands for, to the bit.
#[test]
fn formats_that_change_nothing_change_no_bit() {
    for id in IDS {
        let targets = find(id).unwrap().targets;
        let usual = |target: &Target| text(target.param, if target.double { "f64" } else { "f32" });
        let stated: Inputs = targets.iter().map(usual).chain([text("format", "f32")]).collect();
        for composite in COMPOSITES.map(|composite| text("composite", composite)) {
            for seed in 0..10 {
                let pixel = random_pixel(40, seed);
                let plain = resolve(id, std::slice::from_ref(&composite), &pixel);
                let with = |more: &[(&'static str, Input)]| {
                    resolve(id, &[std::slice::from_ref(&composite), more].concat(), &pixel)
                };
                assert_eq!(with(&stated), plain, "{id}");
                // a share that nothing is stored of but R itself: the sums are those of the other struct
                if composite.1 == Input::Text("none".into()) {
                    assert_eq!(with(&[text("revealage_format", "f32")]), plain, "{id}");
                }
            }
        }
    }
}
