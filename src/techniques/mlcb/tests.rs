#![expect(clippy::cast_precision_loss, clippy::cast_possible_wrap, reason = "small counts")]

use super::*;
use crate::continuum::coverage::Samples;
use crate::continuum::layers::{Node, Stored, StoredScratch};
use crate::continuum::masks::Mask;
use crate::params::Input;
use crate::technique::Technique;
use crate::techniques::statistics::{SEEDS, assert_mean, over_seeds};
use crate::techniques::testing::{
    Scene, as_pixel, assert_close, build, fragment, over, random_pixel, resolve, three_layers,
};

fn masks(layers: usize, bits: usize) -> Vec<(&'static str, Input)> {
    vec![("layers", Input::Int(layers as i64)), ("bits", Input::Int(bits as i64))]
}

fn hybrid(layers: usize, bits: usize) -> Vec<(&'static str, Input)> {
    let store = ("store", Input::Text("hybrid".into()));
    vec![("layers", Input::Int(layers as i64)), ("alpha_bits", Input::Int(bits as i64)), store]
}

fn scene() -> Scene {
    let coincident = |i: u8| fragment(2.0, [0.9, 0.1 * f32::from(i), 0.2], 0.4, i.into());
    vec![three_layers(), random_pixel(5, 3), random_pixel(12, 4), (0..4).map(coincident).collect()]
}

/// Sheet section 3, identity 7.
#[test]
fn the_mean_over_seeds_is_mlab() {
    let orders = ["as_is", "reversed"].into_iter().cycle();
    for (inputs, order) in [masks(2, 1), masks(1, 5), masks(2, 32), hybrid(1, 4)].into_iter().zip(orders) {
        let order = ("submission_order", Input::Text(order.into()));
        let mlab = |pixel: &[Fragment]| {
            let got = resolve("mlab", &[inputs[0].clone(), order.clone()], pixel);
            (got.color, got.transmittance.x)
        };
        let inputs = [inputs.clone(), vec![order.clone()]].concat();
        assert_mean("mlcb", &inputs, &scene(), mlab);
    }
}

#[test]
fn with_a_layer_for_every_fragment_the_mean_is_over() {
    assert_mean("mlcb", &masks(12, 7), &scene(), over);
    assert_mean("mlcb", &hybrid(12, 2), &scene(), over);
}

/// Noise variance ~ 1 / b: on a double logarithmic scale the distance from MLAB falls with slope −1/2.
#[test]
fn noise_falls_with_the_root_of_bits() {
    let pixel = vec![random_pixel(9, 17)];
    let mlab = resolve("mlab", &masks(3, 1)[..1], &pixel[0]);
    let rmse = |bits| {
        let sampled = over_seeds("mlcb", &masks(3, bits), &pixel, SEEDS / 4)[0];
        let bias = sampled.mean.truncate() - mlab.color;
        (sampled.variance.truncate() + bias * bias).element_sum().sqrt()
    };
    let (coarse, fine) = (rmse(64), rmse(1024));
    let slope = (fine / coarse).log2() / 4.0;
    assert!((slope + 0.5).abs() < 0.05, "{slope}: {coarse} {fine}");
}

#[test]
fn no_sample_counts_twice() {
    for seed in 0..20 {
        let masks = RandomMasks { bits: 24, stratified: true, seed };
        let opacity = Coverage::<OneWord>::new(masks);
        let stream = Stream { insertion: Always, merge: OverFurthest, opacity, layers: 5 };
        let mut stored = Stored::default();
        as_pixel(&random_pixel(30, seed), |pixel| stream.store(pixel, &mut stored));
        let mut union = Mask::<OneWord>::empty(24);
        for node in &stored.nodes {
            assert_eq!(node.paint.mask.count_outside(&union), node.paint.mask.count());
            union.unite(&node.paint.mask);
        }
        assert!(union.count() <= 24 && stored.nodes.len() <= 5);
    }
}

/// Screen-door masks: the samples whose threshold alpha exceeds.
struct Nested(Coverage<OneWord>);

impl Opacity for Nested {
    type Paint = Samples<OneWord>;

    fn clear(&self) -> f64 {
        self.0.clear()
    }
    fn empty(&self) -> Self::Paint {
        self.0.empty()
    }
    fn paint(&self, _pixel: &Pixel<'_>, fragment: &Fragment) -> Option<Self::Paint> {
        let bits = self.0.masks.bits;
        let mut mask = Mask::empty(bits);
        let exceeds = |s: &usize| f64::from(fragment.alpha) > (*s as f64 + 0.5) / bits as f64;
        (0..bits).filter(exceeds).for_each(|s| mask.insert(s));
        (fragment.alpha > 0.0).then(|| Samples { mask, color: unmultiplied(fragment) })
    }
    fn occlude(&self, nodes: &mut [Node<Self::Paint>], at: usize) {
        self.0.occlude(nodes, at);
    }
    fn merge(&self, front: &mut Self::Paint, behind: &Self::Paint) {
        self.0.merge(front, behind);
    }
    fn behind(&self, shown: f64, paint: &Self::Paint) -> f64 {
        self.0.behind(shown, paint)
    }
    fn put_behind(&self, core: &mut Core, paint: &Self::Paint) {
        self.0.put_behind(core, paint);
    }
}

#[test]
fn with_nested_masks_and_room_it_is_screen_door_transparency() {
    let masks = RandomMasks { bits: 16, stratified: true, seed: 0 };
    let technique = StoredLayers {
        stream: Stream {
            insertion: Always,
            merge: OverFurthest,
            opacity: Nested(Coverage::new(masks)),
            layers: 64,
        },
        normalize: Unnormalized,
        cost: Cost::list(64, 8.0, 0.0),
        properties: Properties::NONE,
    };
    for n in 1..=64 {
        let pixel = random_pixel(n, u64::from(n) + 5);
        let got = as_pixel(&pixel, |pixel| technique.resolve(pixel, &mut StoredScratch::default()));
        let screen_door = resolve("screen_door", &[("samples", Input::Int(16))], &pixel);
        // the same sums of at most 16 terms in f64
        assert_close(got, screen_door.color, screen_door.transmittance.x, 1e-14);
    }
}

#[test]
fn opaque_fragments_are_exact() {
    let mut pixel = random_pixel(20, 3);
    for f in &mut pixel {
        *f = fragment(f.depth, f.color, 1.0, f.primitive);
    }
    let (color, transmittance) = over(&pixel);
    for inputs in [masks(1, 1), masks(3, 100), hybrid(2, 1)] {
        assert_close(resolve("mlcb", &inputs, &pixel), color, transmittance, 1e-15);
    }
}

#[test]
fn emission_without_coverage_is_lost() {
    let mut pixel = three_layers();
    let glow = Fragment { depth: 1.0, color: [5.0; 3], alpha: 0.0, primitive: 9 };
    for inputs in [masks(2, 32), hybrid(2, 4)] {
        pixel.truncate(3);
        let without = resolve("mlcb", &inputs, &pixel);
        pixel.push(glow);
        assert_eq!(resolve("mlcb", &inputs, &pixel), without);
    }
}

/// A fragment without a sample takes a slot all the same; without that the mean would not be MLAB's.
#[test]
fn an_empty_mask_merges() {
    // 8 samples of alpha 0.01 are none, at this seed
    let faint = fragment(3.0, [1.0; 3], 0.01, 2);
    let pixel = [fragment(2.0, [0.2; 3], 0.5, 0), fragment(6.0, [0.8; 3], 0.5, 1), faint];
    let layers = |layers| resolve("mlcb", &masks(layers, 8), &pixel).color;
    assert!((layers(2) - layers(3)).abs().max_element() < 1e-15);
    let opacity = Coverage::<OneWord>::new(RandomMasks { bits: 8, stratified: true, seed: 0 });
    let stream = Stream { insertion: Always, merge: OverFurthest, opacity, layers: 2 };
    let mut stored = Stored::default();
    as_pixel(&pixel, |pixel| stream.store(pixel, &mut stored));
    assert_eq!(stored.nodes.iter().map(Node::depth).collect::<Vec<_>>(), [2.0, 3.0]);
}

#[test]
fn transmittance_is_that_of_the_layers() {
    // alphas of 1/4, 1/2 and 3/4 are whole numbers of 8 bits
    let technique = build("mlcb", &masks(4, 8)).unwrap();
    let steps = as_pixel(&three_layers(), |pixel| technique.transmittance(pixel, &[2.0, 3.0, 9.0])).unwrap();
    assert_eq!(steps[..2], [1.0, 0.75]);
    assert_eq!(steps[2], resolve("mlcb", &masks(4, 8), &three_layers()).transmittance.x);
}

#[test]
fn costs_count_bits() {
    let complexity = crate::technique::DepthComplexity { mean: 3.0, max: 9 };
    let bytes = |inputs: &[(&str, Input)]| build("mlcb", inputs).unwrap().cost(&complexity).bytes_per_pixel;
    assert_eq!([bytes(&masks(4, 32)), bytes(&masks(2, 8)), bytes(&hybrid(4, 4))], [96.0, 42.0, 82.0]);
}
