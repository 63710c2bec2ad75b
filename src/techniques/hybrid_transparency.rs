//! Hybrid transparency (Maule et al. 2013): the k nearest layers exactly, the others blended behind them.

use crate::continuum::insertion::Always;
use crate::continuum::layers::{StoredLayers, Stream};
use crate::continuum::merge::DiscardFurthest;
use crate::continuum::nodes::{Nodes, bytes_of_sums, sums};
use crate::continuum::normalize::{Core, Global, Normalize, Tail, sums_of};
use crate::continuum::opacity::Alpha;
use crate::continuum::stored_sums::Recipe;
use crate::continuum::stored_tail::{StoredGlobal, StoredTail, stored_sums_of};
use crate::error::Result;
use crate::format::{Formats, Target};
use crate::gpu::form::{Form, Number, Path, Streaming, layers, only_single_formats};
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::technique::{AnyTechnique, Axes, Cost, Info, Pixel, Properties, Resolved};
use crate::techniques::ANY_ORDER;

/// The registry entry.
pub static INFO: Info = Info {
    id: "hybrid_transparency",
    aliases: &[],
    name: "Hybrid transparency",
    citation: &["Maule2013"],
    doc: "Keeps the k nearest layers exactly; what they push out goes into blended sums behind them. \
          tail=\"count\" gives the sums the coverage of as many mean fragments, as common implementations do; \
          correction=\"global\" scales core and tail together to the exact coverage (W16 eq. 9).",
    axes: Axes {
        memory: "k layers",
        insertion: "always",
        merge: "discard furthest",
        normalize: "α-weighted average",
        opacity: "alpha",
    },
    params: &[
        ParamSpec::new("layers", Kind::at_least(0), Value::Int(8), "layers kept exactly"),
        ParamSpec::new(
            "tail",
            Kind::Choice(&["exact", "count"]),
            Value::Text("exact"),
            "what the tail covers: as much as its fragments do together, or as that many of their mean",
        ),
        ParamSpec::new(
            "correction",
            Kind::Choice(&["tail", "global"]),
            Value::Text("tail"),
            "what is scaled to the exact coverage: the tail, or everything",
        ),
    ],
    targets: &TARGETS,
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "1",
    bytes_per_pixel: "20 layers + 20 in f32, half of that in f16, 8 layers as rgba8 and an f32",
    build,
    gpu: Some(gpu),
};

fn build(params: &Params, view: &View) -> Result<Box<dyn AnyTechnique>> {
    let layers = params.size("layers");
    let formats = Formats::from_params(INFO.targets, params);
    let nodes = Nodes::new(&formats, view);
    let cost = Cost::list(layers, nodes.bytes, bytes_of_sums(&formats));
    let choice = (params.text("correction"), params.text("tail"));
    if !nodes.are_default {
        return Ok(build_stored(layers, choice, cost, nodes, sums(&formats)));
    }
    Ok(match choice {
        ("global", "count") => Box::new(hybrid(layers, CountedGlobal, cost, COUNTED)),
        ("global", _) => Box::new(hybrid(layers, Global, cost, EXACT)),
        (_, "count") => Box::new(hybrid(layers, CountedTail, cost, COUNTED)),
        (_, _) => Box::new(hybrid(layers, Tail { weighting: None }, cost, EXACT)),
    })
}

/// Its form on a GPU, with nodes and sums in f32.
fn gpu(params: &Params, _view: &View) -> Result<Form> {
    only_single_formats(params, INFO.targets)?;
    let is_counted = params.text("tail") == "count";
    let is_global = params.text("correction") == "global";
    Ok(Form {
        weight: None,
        shader: include_str!("../../shaders/hybrid_transparency.wgsl"),
        numbers: vec![Number::Whole(is_counted.into()), Number::Whole(is_global.into())],
        // no order of submission changes more than the rounding of sums
        path: Path::Streamed(Streaming::in_any_order().of_layers(layers(params)?)),
        shows_zero_fragments: is_counted,
        colored_transmittance: false,
    })
}

/// With nodes and sums in other formats.
fn build_stored(
    layers: usize,
    choice: (&str, &str),
    cost: Cost,
    nodes: Nodes,
    recipe: Recipe,
) -> Box<dyn AnyTechnique> {
    let (counted, exact) = (recipe.properties(COUNTED), recipe.properties(EXACT));
    let opacity = nodes.alpha();
    match choice {
        ("global", "count") => {
            let tail = StoredCount::<true> { recipe };
            hybrid(layers, tail, cost, counted).with_opacity(opacity).placed(nodes)
        }
        ("global", _) => {
            let tail = StoredGlobal { recipe };
            hybrid(layers, tail, cost, exact).with_opacity(opacity).placed(nodes)
        }
        (_, "count") => {
            let tail = StoredCount::<false> { recipe };
            hybrid(layers, tail, cost, counted).with_opacity(opacity).placed(nodes)
        }
        (_, _) => {
            let tail = StoredTail { weighting: None, recipe };
            hybrid(layers, tail, cost, exact).with_opacity(opacity).placed(nodes)
        }
    }
}

fn hybrid<N>(
    layers: usize,
    normalize: N,
    cost: Cost,
    properties: Properties,
) -> StoredLayers<Always, DiscardFurthest, Alpha, N> {
    let stream = Stream { insertion: Always, merge: DiscardFurthest, opacity: Alpha, layers };
    StoredLayers { stream, normalize, cost, properties }
}

static TARGETS: [Target; 5] = [
    Target::NODE_COLOR,
    Target::NODE_DEPTH,
    Target::ACCUMULATION,
    Target::REVEALAGE.when(|p| p.text("tail") == "exact"),
    Target::COUNT.when(|p| p.text("tail") == "count"),
];

/// A count knows nothing of how different the fragments are.
const COUNTED: Properties =
    Properties { order_independent: true, consistent: true, exact_for_one: true, ..Properties::NONE };
const EXACT: Properties = Properties { exact_for_one_color: true, exact_coverage: true, ..COUNTED };

/// The tail covers `1 − (1 − ā)^m`, as weighted average does.
struct CountedTail;

impl Normalize for CountedTail {
    const SEES_ZERO_FRAGMENTS: bool = true;

    fn resolve(&self, pixel: &Pixel<'_>, core: &Core, lost: &[u32], _weights: &mut Vec<f32>) -> Resolved {
        core.over_tail(sums_of(pixel.list, lost).read(lost.len()).over_as_mean(pixel.background))
    }
}

/// Everything is scaled to `1 − T_c (1 − ā)^m`.
struct CountedGlobal;

impl Normalize for CountedGlobal {
    const SEES_ZERO_FRAGMENTS: bool = true;

    fn resolve(&self, pixel: &Pixel<'_>, core: &Core, lost: &[u32], _weights: &mut Vec<f32>) -> Resolved {
        let tail = sums_of(pixel.list, lost);
        let (tail_coverage, tail_transmittance) = tail.read(lost.len()).mean_coverage();
        let coverage = core.coverage + core.transmittance * tail_coverage;
        core.scale_to(&tail, coverage, core.transmittance * tail_transmittance, pixel.background)
    }
}

/// [`CountedTail`] and [`CountedGlobal`] in sums and a count of other formats.
struct StoredCount<const GLOBAL: bool> {
    recipe: Recipe,
}

impl<const GLOBAL: bool> Normalize for StoredCount<GLOBAL> {
    const SEES_ZERO_FRAGMENTS: bool = true;

    fn resolve(&self, pixel: &Pixel<'_>, core: &Core, lost: &[u32], _weights: &mut Vec<f32>) -> Resolved {
        let tail = stored_sums_of(self.recipe, None, pixel.list, lost);
        if !GLOBAL {
            return core.over_tail(tail.over_as_mean(pixel.background));
        }
        let (tail_coverage, tail_transmittance) = tail.mean_coverage();
        let coverage = core.coverage + core.transmittance * tail_coverage;
        let transmittance = core.transmittance * tail_transmittance;
        core.scale_sums_to((tail.color, tail.alpha), coverage, transmittance, pixel.background)
    }
}

#[cfg(test)]
mod tests {
    use crate::fragments::Fragment;
    use crate::params::Input;
    use crate::technique::Resolved;
    use crate::techniques::testing::{
        BACKGROUND, F32_STATE, Scene, assert_close, clear_pixels, fragment, over, random_pixel, resolve,
        resolve_all,
    };
    use glam::{DVec3, Vec3};

    fn inputs(layers: i64, tail: &str, correction: &str) -> [(&'static str, Input); 3] {
        [
            ("layers", Input::Int(layers)),
            ("tail", Input::Text(tail.into())),
            ("correction", Input::Text(correction.into())),
        ]
    }

    fn hybrid(layers: i64, tail: &str, correction: &str, pixel: &[Fragment]) -> Resolved {
        resolve("hybrid_transparency", &inputs(layers, tail, correction), pixel)
    }

    /// Sheet R14: one layer kept of three of alpha 1/2.
    #[test]
    fn weights_by_hand() {
        let unit = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let pixel: Vec<_> = (1_u8..).zip(unit).map(|(z, u)| fragment(z.into(), u, 0.5, z.into())).collect();
        let behind = 0.125 * Vec3::from(BACKGROUND).as_dvec3();
        let expect = |correction, weights: [f64; 3]| {
            for tail in ["exact", "count"] {
                let got = hybrid(1, tail, correction, &pixel);
                assert_close(got, DVec3::from(weights) + behind, 0.125, F32_STATE);
            }
        };
        expect("tail", [0.5, 0.1875, 0.1875]);
        expect("global", [0.4375, 0.218_75, 0.218_75]);
    }

    fn random_scene() -> Scene {
        (1..=20).map(|n| random_pixel(3 * n, u64::from(n))).collect()
    }

    #[test]
    fn without_layers_it_is_blended_oit_or_weighted_average() {
        for correction in ["tail", "global"] {
            for (tail, twin) in [("exact", "blended_oit"), ("count", "weighted_average")] {
                let got = resolve_all("hybrid_transparency", &inputs(0, tail, correction), &random_scene());
                for (a, b) in got.iter().zip(resolve_all(twin, &[], &random_scene())) {
                    assert_close(*a, b.color, b.transmittance.x, F32_STATE);
                }
            }
        }
    }

    #[test]
    fn a_count_sees_fragments_that_are_not_there() {
        let mut pixel = vec![fragment(1.0, [1.0; 3], 0.5, 0), fragment(2.0, [1.0; 3], 1.0, 1)];
        assert_eq!(hybrid(1, "count", "tail", &pixel).transmittance.x, 0.0);
        pixel.push(fragment(3.0, [0.0; 3], 0.0, 2));
        assert!((hybrid(1, "count", "tail", &pixel).transmittance.x - 0.125).abs() < 1e-15);
        assert_eq!(hybrid(1, "exact", "tail", &pixel).transmittance.x, 0.0);
        // in front, it takes the core's only slot
        pixel[2].depth = 0.5;
        assert!((hybrid(1, "count", "tail", &pixel).transmittance.x - 0.0625).abs() < 1e-15);
    }

    /// AM-GM: equal alphas cover the least.
    #[test]
    fn a_counted_tail_never_covers_more_than_the_exact_one() {
        for pixel in random_scene() {
            let [count, exact] =
                ["count", "exact"].map(|tail| hybrid(3, tail, "tail", &pixel).transmittance.x);
            assert!(count >= exact - F32_STATE, "{count} {exact}");
        }
    }

    /// Sheet 2.3: RMSE 0.0103 against 0.0199 at k = 4, n = 8.
    #[test]
    fn an_exact_core_is_better_than_scaling_everything() {
        let rmse = |correction| {
            let pixels = clear_pixels(100);
            let got = resolve_all("hybrid_transparency", &inputs(4, "exact", correction), &pixels);
            let errors =
                got.iter().zip(&pixels).map(|(got, pixel)| (got.color - over(pixel).0).length_squared());
            (errors.sum::<f64>() / 300.0).sqrt()
        };
        assert!(rmse("tail") < 0.7 * rmse("global"), "{} {}", rmse("tail"), rmse("global"));
    }
}
