//! Hand-made and random pixels for the techniques' unit tests.
#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    clippy::cast_sign_loss,
    reason = "test images are small"
)]

use crate::continuum::oracle::Oracle;
use crate::error::Result;
use crate::fragments::{Background, Fragment, Fragments, FragmentsInput, Lists};
use crate::order::{Reorderer, SubmissionOrder, sort_key, without_zero_fragments};
use crate::params::{Input, Params, View, check};
use crate::random::{hash32, unit};
use crate::technique::{AnyTechnique, Batch, Info, Pixel, Resolved};
use glam::DVec3;

/// Planes and depth range of the test pixels.
pub const VIEW: View = View { near: 0.1, far: 100.0, depth_range: (1.0, 9.0) };
/// The colour behind the test pixels.
pub const BACKGROUND: [f32; 3] = [0.25, 0.5, 0.75];
/// Error of a colour in [0, 1] whose sums over up to 64 fragments were kept in f32.
pub const F32_STATE: f64 = 2e-6;

/// Pixels side by side.
pub type Scene = Vec<Vec<Fragment>>;

/// A fragment of unmultiplied colour `rgb`.
pub fn fragment(depth: f32, rgb: [f32; 3], alpha: f32, primitive: u32) -> Fragment {
    Fragment { depth, color: rgb.map(|c| c * alpha), alpha, primitive }
}

/// Three layers of different colour and coverage, out of order.
pub fn three_layers() -> Vec<Fragment> {
    vec![
        fragment(4.0, [0.1, 0.9, 0.2], 0.5, 0),
        fragment(2.0, [1.0, 0.3, 0.1], 0.25, 1),
        fragment(8.0, [0.2, 0.1, 1.0], 0.75, 2),
    ]
}

/// A stream of numbers in [0, 1).
pub struct Random {
    seed: u64,
    drawn: u32,
}

impl Random {
    pub fn new(seed: u64) -> Self {
        Self { seed, drawn: 0 }
    }
    pub fn unit(&mut self) -> f32 {
        self.drawn += 1;
        unit(hash32(self.drawn, 0, 0, self.seed, 0))
    }
    pub fn index(&mut self, len: usize) -> usize {
        (f64::from(self.unit()) * len as f64) as usize
    }
    pub fn shuffle<T>(&mut self, items: &mut [T]) {
        (1..items.len()).rev().for_each(|i| items.swap(i, self.index(i + 1)));
    }
}

/// A pixel of `n` fragments within the test view's depth range: some opaque, some of alpha 0, some at equal
/// depths, each of its own primitive.
pub fn random_pixel(n: u32, seed: u64) -> Vec<Fragment> {
    let mut random = Random::new(seed);
    let one = |i: u32| {
        let depth = 1.0 + 8.0 * random.unit();
        let depth = if random.unit() < 0.2 { depth.round() } else { depth };
        let alpha = match random.unit() {
            x if x < 0.1 => 0.0,
            x if x > 0.9 => 1.0,
            _ => random.unit(),
        };
        let rgb = [random.unit(), random.unit(), random.unit()];
        fragment(depth, rgb, alpha, (i * 7919 + 11) % 65_536)
    };
    (0..n).map(one).collect()
}

/// The params of `id` with `inputs` given, resolved for the test view.
pub fn params(info: &Info, inputs: &[(String, Input)]) -> Result<Params> {
    let table = info.param_table();
    Ok(check(info.id, &table, inputs)?.resolve(&table, &VIEW))
}

fn owned(inputs: &[(&str, Input)]) -> Vec<(String, Input)> {
    inputs.iter().map(|(name, value)| ((*name).to_owned(), value.clone())).collect()
}

/// Technique `id` with these params.
pub fn build(id: &str, inputs: &[(&str, Input)]) -> Result<Box<dyn AnyTechnique>> {
    let info = super::find(id)?;
    (info.build)(&params(info, &owned(inputs))?, &VIEW)
}

/// The pixel as technique `id` with these params resolves it.
pub fn resolve(id: &str, inputs: &[(&str, Input)], pixel: &[Fragment]) -> Resolved {
    resolve_all(id, inputs, &[pixel.to_vec()])[0]
}

/// The pixels as technique `id` with these params resolves them.
pub fn resolve_all(id: &str, inputs: &[(&str, Input)], scene: &[Vec<Fragment>]) -> Vec<Resolved> {
    let info = super::find(id).unwrap();
    let params = params(info, &owned(inputs)).unwrap();
    let technique = (info.build)(&params, &VIEW).unwrap();
    run(&*technique, submission_order(&params), scene)
}

/// The submission order that the params ask for.
pub fn submission_order(params: &Params) -> SubmissionOrder {
    SubmissionOrder::from_name(params.text("submission_order"), params.size("seed") as u64)
}

/// The pixels as a technique resolves them that gets their fragments in the given order.
pub fn run(technique: &dyn AnyTechnique, order: SubmissionOrder, scene: &[Vec<Fragment>]) -> Vec<Resolved> {
    let mut all = Lists::new();
    for pixel in scene {
        pixel.iter().for_each(|f| all.push(*f));
        all.end_row();
    }
    let mut seen = Lists::new();
    without_zero_fragments(all.as_ref(), &mut seen);
    let centroids = as_image(seen.clone()).centroid_order();
    if technique.sees_zero_fragments() {
        seen = all;
    }
    let (mut lists, mut sorted) = (Lists::new(), Lists::new());
    Reorderer::default().reorder(seen.as_ref(), order, Some(&centroids), &mut lists);
    Reorderer::default().reorder(seen.as_ref(), SubmissionOrder::Sorted, None, &mut sorted);
    let background = vec![BACKGROUND; scene.len()];
    let batch = Batch {
        x: 0,
        y: 0,
        width: scene.len() as u32,
        first: 0,
        lists: lists.as_ref(),
        sorted: Some(sorted.as_ref()),
        background: &background,
    };
    let mut out: Vec<_> = (0..scene.len()).map(|i| Resolved::background(batch.background(i))).collect();
    let pixels: Vec<_> = (0..scene.len() as u32).filter(|&i| lists.as_ref().count(i as usize) > 0).collect();
    technique.resolve_batch(&batch, &pixels, &mut out, &|| false).unwrap();
    out
}

fn as_image(lists: Lists) -> Fragments {
    Fragments::new(FragmentsInput {
        width: lists.as_ref().len() as u32,
        height: 1,
        lists,
        background: Background::Constant(BACKGROUND),
        near: VIEW.near,
        far: VIEW.far,
        depth_range: Some(VIEW.depth_range),
        primitive_depth: None,
    })
    .unwrap()
}

/// Sorted OVER by its definition (sheet 0.1), for comparison.
pub fn over(fragments: &[Fragment]) -> (DVec3, f64) {
    let mut sorted = fragments.to_vec();
    sorted.sort_by(|a, b| a.depth.total_cmp(&b.depth).then(a.primitive.cmp(&b.primitive)));
    let (mut color, mut transmittance) = (DVec3::ZERO, 1.0);
    for f in sorted {
        color += transmittance * DVec3::from(f.color.map(f64::from));
        transmittance *= 1.0 - f64::from(f.alpha);
    }
    (color + transmittance * DVec3::from(BACKGROUND.map(f64::from)), transmittance)
}

/// The largest difference in a channel of colour or transmittance.
pub fn difference(got: Resolved, color: DVec3, transmittance: f64) -> f64 {
    let color = (got.color - color).abs().max_element();
    let transmittance = (got.transmittance - DVec3::splat(transmittance)).abs().max_element();
    if color.is_nan() || transmittance.is_nan() { f64::NAN } else { color.max(transmittance) }
}

/// Asserts that every channel of colour and transmittance agrees within `tolerance`.
#[track_caller]
pub fn assert_close(got: Resolved, color: DVec3, transmittance: f64, tolerance: f64) {
    let far = difference(got, color, transmittance);
    assert!(far <= tolerance, "{got:?} is {far:e} away from {color:?}, {transmittance}");
}

/// The params of a technique with `inputs` given.
pub fn given(info: &Info, inputs: &[(&str, Input)]) -> Params {
    params(info, &owned(inputs)).unwrap()
}

/// Pixels of eight clear layers.
pub fn clear_pixels(count: u64) -> Scene {
    layered_pixels(count, 8)
}

/// Pixels of `layers` layers of alpha 0.1 to 0.9 anywhere in the test view's range: those of the sheet's numbers.
pub fn layered_pixels(count: u64, layers: u32) -> Scene {
    let one = |seed| {
        let mut random = Random::new(seed + 1000);
        let mut layer = |i| {
            let (z, alpha) = (1.0 + 8.0 * random.unit(), 0.1 + 0.8 * random.unit());
            fragment(z, [random.unit(), random.unit(), random.unit()], alpha, i)
        };
        (0..layers).map(&mut layer).collect()
    };
    (0..count).map(one).collect()
}

/// Hands the fragments over as a pixel, in this order.
pub fn as_pixel<R>(fragments: &[Fragment], see: impl FnOnce(&Pixel<'_>) -> R) -> R {
    let (mut lists, mut sorted) = (Lists::new(), Lists::new());
    fragments.iter().for_each(|f| lists.push(*f));
    lists.end_row();
    Reorderer::default().reorder(lists.as_ref(), SubmissionOrder::Sorted, None, &mut sorted);
    see(&Pixel {
        x: 0,
        y: 0,
        list: lists.as_ref().row(0),
        sorted: sorted.as_ref().row(0),
        background: DVec3::from(BACKGROUND.map(f64::from)),
    })
}

/// The exact transmittance in front of each fragment, ties broken by primitive.
pub fn exact_transmittance(fragments: &[Fragment]) -> Vec<f64> {
    let key = |f: &Fragment| sort_key(f.depth, f.primitive);
    let hides = |front: &Fragment, f: &Fragment| key(front) < key(f);
    let share = |f| fragments.iter().filter(|g| hides(g, f)).map(|g| 1.0 - f64::from(g.alpha)).product();
    fragments.iter().map(share).collect()
}

/// Mean |T̂ − T| over the fragments of the pixels, T̂ as the second pass sees it.
pub fn mean_error<O: Oracle>(oracle: &O, pixels: &[Vec<Fragment>]) -> f64 {
    let mut map = O::Map::default();
    let (mut sum, mut count) = (0.0, 0.0);
    for fragments in pixels {
        as_pixel(fragments, |pixel| oracle.build(pixel, &mut map));
        for (f, exact) in fragments.iter().zip(exact_transmittance(fragments)) {
            sum += (oracle.in_front_of(&map, f) - exact).abs();
            count += 1.0;
        }
    }
    sum / count
}
