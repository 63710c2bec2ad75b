//! Deep opacity maps (Yuksel & Keyser 2008): opacity layers that follow each pixel's first surface.

use crate::continuum::absorbance::{
    S_MAX, SELF_CORRECT, absorbance, absorbances, transmittance, transmittances,
};
use crate::continuum::binned::BinnedAbsorbance;
use crate::continuum::oracle::{CHUNK, Composite, Oracle, chunks, see_one};
use crate::continuum::range::{DepthRange, cell};
use crate::continuum::stored_oracle::{BINS, StoredOracle, technique};
use crate::continuum::two_pass_form::{Own, two_pass_form};
use crate::error::Result;
use crate::format::{Formats, SUMMATION, Target};
use crate::fragments::{Fragment, List};
use crate::gpu::form::blocks::{self, FUNCTIONS, INTERVAL, OUTPUTS, TWO_PASS};
use crate::gpu::form::{Form, Number};
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::technique::{AnyTechnique, Axes, Cost, DepthComplexity, Info, Pixel, Properties};
use crate::techniques::ANY_ORDER;

/// The registry entry.
pub static INFO: Info = Info {
    id: "deep_opacity_maps",
    aliases: &[],
    name: "Deep Opacity Maps",
    citation: &["Yuksel2008"],
    doc: "Opacity shadow maps whose few layers begin at each pixel's first surface, so that it is never hidden; \
          by default each layer is twice as deep as the one in front of it.",
    axes: Axes {
        memory: "k bins",
        insertion: "always",
        merge: "α-weighted sum",
        normalize: "no",
        opacity: "alpha",
    },
    params: &[
        ParamSpec::new("bins", Kind::at_least(1), Value::Int(4), "layers behind the first surface"),
        ParamSpec::new(
            "spacing",
            Kind::Choice(&["exponential", "uniform"]),
            Value::Text("exponential"),
            "how deep the layers are: each twice the one in front of it, or all the same",
        ),
        DepthRange::param("pixel"),
        SELF_CORRECT,
        S_MAX,
        Composite::param("none"),
        SUMMATION,
    ],
    targets: &[BINS, Target::ACCUMULATION, Target::REVEALAGE],
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "3",
    bytes_per_pixel: "first depth, bins, 4 sums and R: 4 + 4 bins + 20 in f32, 4 + 2 bins + 10 in f16",
    build,
    gpu: Some(gpu),
};

fn build(params: &Params, view: &View) -> Result<Box<dyn AnyTechnique>> {
    Ok(technique(DeepOpacityMaps::from_params(params, view), INFO.targets, params))
}

/// Its form on a GPU.
fn gpu(params: &Params, view: &View) -> Result<Form> {
    let spacing = Spacing::from_params(params);
    let layers = match spacing {
        Spacing::Uniform => params.size("bins"),
        Spacing::Exponential => params.size("bins").min(FINEST_IN_SINGLE),
    };
    let (doubling, self_correct) = (spacing == Spacing::Exponential, params.bool("self_correct"));
    let flags = [doubling, self_correct, false].map(|flag| Number::Whole(flag.into()));
    two_pass_form(
        params,
        view,
        &Own {
            shader: include_str!("../../shaders/deep_opacity_maps.wgsl"),
            blocks: &[FUNCTIONS, INTERVAL, OUTPUTS, TWO_PASS, blocks::BINS],
            targets: INFO.targets,
            map: (BINS.name, "bins"),
            count: layers,
            needs_bounds: true,
            numbers: &[&[Number::size(layers)], &flags[..]].concat(),
            ..Own::BARE
        },
    )
}

/// How deep the layers are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Spacing {
    /// Each twice the one in front.
    Exponential,
    /// All the same.
    Uniform,
}

/// More doubling layers than these differ by less than f32 depths do.
const FINEST: usize = 1000;
/// The same where powers of two are f32: the first of so many layers is 2^-120 of all of them deep, and there is no depth
/// behind the first surface but one that is behind it by more.
const FINEST_IN_SINGLE: usize = 120;

impl Spacing {
    fn from_params(params: &Params) -> Self {
        if params.text("spacing") == "uniform" { Self::Uniform } else { Self::Exponential }
    }

    /// The layer of a depth behind the first surface, in units of the extent, and how far inside the layer it
    /// is; the last layer is open, but what lies beyond the extent counts as at its end.
    fn layer(self, x: f64, count: usize) -> (usize, f64) {
        let x = x.clamp(0.0, 1.0);
        match self {
            Self::Uniform => cell(x, count),
            Self::Exponential => doubling_layer(x, count.min(FINEST)),
        }
    }
}

/// The layer among `count` whose k-th boundary is (2^k − 1)/(2^count − 1).
fn doubling_layer(x: f64, count: usize) -> (usize, f64) {
    let position = x * (power_of_two(count) - 1.0);
    let layer = exponent(1.0 + position).min(count - 1);
    let width = power_of_two(layer);
    (layer, ((position - (width - 1.0)) / width).clamp(0.0, 1.0))
}

/// 2^k for k up to [`FINEST`].
fn power_of_two(k: usize) -> f64 {
    f64::from_bits((k as u64 + 1023) << 52)
}

/// The largest k such that 2^k is at most `x`, which is at least 1.
fn exponent(x: f64) -> usize {
    (x.to_bits() >> 52) as usize - 1023
}

/// Absorbance in layers behind the first surface.
struct DeepOpacityMaps {
    bins: usize,
    spacing: Spacing,
    range: DepthRange,
    range_covers_scene: bool,
    self_correct: bool,
    s_max: f64,
}

/// One pixel's layers.
#[derive(Debug, Default)]
struct Map {
    first: f64,
    extent: f64,
    layers: BinnedAbsorbance,
}

impl DeepOpacityMaps {
    fn from_params(params: &Params, view: &View) -> Self {
        let range = DepthRange::from_params(params, view);
        Self {
            bins: params.size("bins"),
            spacing: Spacing::from_params(params),
            range,
            range_covers_scene: range.covers(view),
            self_correct: params.bool("self_correct"),
            s_max: params.float("s_max"),
        }
    }

    /// The first surface, and how deep the layers are together.
    fn bounds(&self, list: List<'_>) -> (f64, f64) {
        let first = list.depth_bounds().map_or(0.0, |(first, _)| first.into());
        let (lo, hi) = self.range.bounds(list);
        (first, if hi > lo { hi - lo } else { 1.0 })
    }

    fn place(&self, map: &Map, depth: f32) -> (usize, f64) {
        self.spacing.layer((f64::from(depth) - map.first) / map.extent, self.bins)
    }
}

impl Oracle for DeepOpacityMaps {
    type Map = Map;

    fn build(&self, pixel: &Pixel<'_>, map: &mut Map) {
        (map.first, map.extent) = self.bounds(pixel.list);
        let mut layers = std::mem::take(&mut map.layers);
        layers.clear(self.bins);
        let mut s = [0.0; CHUNK];
        for part in chunks(pixel.list) {
            absorbances(part.alpha, self.s_max, &mut s);
            for (&depth, &s) in part.depth.iter().zip(&s) {
                layers.add(self.place(map, depth).0, s);
            }
        }
        layers.end();
        map.layers = layers;
    }

    fn in_front_of(&self, map: &Map, fragment: &Fragment) -> f64 {
        see_one(self, map, fragment)
    }

    fn see(&self, map: &Map, list: List<'_>, seen: &mut [f64]) {
        let mut own = [0.0; CHUNK];
        if self.self_correct {
            absorbances(list.alpha, self.s_max, &mut own);
        }
        for ((seen, &depth), own) in seen.iter_mut().zip(list.depth).zip(own) {
            let place = self.place(map, depth);
            *seen = map.layers.lerp(place) - place.1 * own;
        }
        transmittances(seen);
    }

    fn at(&self, map: &Map, depth: f32) -> f64 {
        transmittance(map.layers.lerp(self.place(map, depth)))
    }

    fn total(&self, map: &Map) -> f64 {
        transmittance(map.layers.total())
    }

    #[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
    fn cost(&self, _complexity: &DepthComplexity) -> Cost {
        Cost { geometry_passes: 3.0, bytes_per_pixel: 24.0 + 4.0 * self.bins as f64 }
    }

    fn properties(&self, composite: Composite) -> Properties {
        Properties {
            // the last exponential layer keeps half of the extent, however many there are
            consistent: self.spacing == Spacing::Uniform && self.self_correct && self.range_covers_scene,
            ..composite.promises(true)
        }
    }
}

impl StoredOracle for DeepOpacityMaps {
    fn build_stored(&self, pixel: &Pixel<'_>, formats: &Formats, map: &mut Map) {
        (map.first, map.extent) = self.bounds(pixel.list);
        let mut layers = std::mem::take(&mut map.layers);
        let deposits =
            pixel.list.iter().map(|f| (self.place(map, f.depth).0, absorbance(f.alpha, self.s_max)));
        layers.fill_stored(self.bins, formats.of(BINS.name), deposits);
        map.layers = layers;
    }

    #[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
    fn texels(&self, _complexity: &DepthComplexity) -> Vec<(&'static str, f64)> {
        vec![(BINS.name, self.bins as f64)]
    }
}

#[cfg(test)]
mod tests {
    use super::{DeepOpacityMaps, INFO, Map, Spacing, doubling_layer};
    use crate::continuum::oracle::Oracle;
    use crate::params::Input;
    use crate::techniques::testing::{
        F32_STATE, VIEW, as_pixel, assert_close, clear_pixels, fragment, given, mean_error, over,
        random_pixel, resolve,
    };

    fn inputs(bins: i64, spacing: &str) -> Vec<(&'static str, Input)> {
        vec![("bins", Input::Int(bins)), ("spacing", Input::Text(spacing.into()))]
    }

    fn oracle(bins: i64, spacing: &str, self_correct: bool, range: &str) -> DeepOpacityMaps {
        let mut inputs = inputs(bins, spacing);
        inputs.extend([("self_correct", Input::Bool(self_correct)), ("range", Input::Text(range.into()))]);
        DeepOpacityMaps::from_params(&given(&INFO, &inputs), &VIEW)
    }

    #[test]
    fn three_layers_by_hand() {
        // behind depth 2 the layers of the range 2..9 end at 3, 5 and 9: depth 4 lies half way in the second,
        // which half the light passes, depth 9 at the end of the last
        let pixel = [
            fragment(4.0, [1.0; 3], 0.75, 0),
            fragment(2.0, [1.0; 3], 0.25, 1),
            fragment(9.0, [1.0; 3], 0.5, 2),
            fragment(3.5, [1.0; 3], 0.0, 3),
        ];
        let (oracle, mut map) = (oracle(3, "exponential", true, "pixel"), Map::default());
        as_pixel(&pixel, |pixel| oracle.build(pixel, &mut map));
        let seen = pixel.map(|f| oracle.in_front_of(&map, &f));
        for (seen, expected) in seen.into_iter().zip([0.75, 1.0, 0.187_5, 0.75 * 0.25_f64.powf(0.25)]) {
            assert!((seen - expected).abs() < 1e-14, "{seen} for {expected}");
        }
        let steps = [1.0, 2.0, 4.0, 9.0, 20.0].map(|z| oracle.at(&map, z));
        for (at, expected) in steps.into_iter().zip([1.0, 1.0, 0.375, 0.093_75, 0.093_75]) {
            assert!((at - expected).abs() < 1e-14, "{at} for {expected}");
        }
    }

    #[test]
    fn each_layer_is_twice_the_one_in_front() {
        let at = |x: f64| doubling_layer(x / 7.0, 3);
        assert_eq!(
            [0.0, 0.5, 1.0, 2.5, 3.0, 5.0, 7.0].map(at),
            [(0, 0.0), (0, 0.5), (1, 0.0), (1, 0.75), (2, 0.0), (2, 0.5), (2, 1.0)]
        );
        let fine = Spacing::Exponential.layer(0.5, usize::MAX);
        assert!(fine.0 + 2 >= super::FINEST, "{fine:?}");
    }

    #[test]
    fn the_first_surface_is_never_hidden() {
        for (n, range) in (1..=64).flat_map(|n| ["pixel", "scene"].map(|range| (n, range))) {
            let pixel = random_pixel(n, u64::from(n) + 3);
            let first = pixel.iter().min_by(|a, b| a.depth.total_cmp(&b.depth)).unwrap();
            for spacing in ["exponential", "uniform"] {
                let (oracle, mut map) = (oracle(4, spacing, false, range), Map::default());
                as_pixel(&pixel, |pixel| oracle.build(pixel, &mut map));
                assert_eq!(oracle.in_front_of(&map, first), 1.0);
            }
        }
    }

    #[test]
    fn the_image_does_not_depend_on_where_the_camera_stands() {
        for spacing in ["exponential", "uniform"] {
            // depths and the shift are multiples of 1/64, so that the sums are exact in f32
            let mut pixel = random_pixel(20, 2);
            pixel.iter_mut().for_each(|f| f.depth = (f.depth * 64.0).round() / 64.0);
            let here = resolve("deep_opacity_maps", &inputs(5, spacing), &pixel);
            pixel.iter_mut().for_each(|f| f.depth += 1024.0);
            assert_eq!(resolve("deep_opacity_maps", &inputs(5, spacing), &pixel), here);
        }
    }

    /// Sheet 2.5: mean error .019 at 8 exponential layers and at 400 alike.
    #[test]
    fn uniform_layers_tend_to_over_and_exponential_ones_do_not() {
        let pixels = clear_pixels(300);
        let error =
            |bins, spacing, self_correct| mean_error(&oracle(bins, spacing, self_correct, "pixel"), &pixels);
        let (few, many) = (error(8, "exponential", true), error(400, "exponential", true));
        assert!((few / 0.019 - 1.0).abs() < 0.2 && (many / 0.019 - 1.0).abs() < 0.2, "{few} {many}");
        assert!(error(1024, "uniform", true) < 1e-3 && error(1024, "uniform", false) > 0.03);
    }

    #[test]
    fn uniform_layers_narrower_than_the_gaps_are_over() {
        for mut pixel in clear_pixels(20) {
            pixel.iter_mut().zip(0_u8..).for_each(|(f, i)| f.depth = 2.0 + f32::from(i * 3 % 8) * 0.7);
            let (color, transmittance) = over(&pixel);
            let got = resolve("deep_opacity_maps", &inputs(1 << 22, "uniform"), &pixel);
            assert_close(got, color, transmittance, F32_STATE);
        }
    }
}
