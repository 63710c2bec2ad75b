//! Adaptive transparency (Salvi, Montgomery & Lefohn 2011): a step function of k nodes for the transmittance,
//! then every fragment through it.

use crate::continuum::insertion::Always;
use crate::continuum::layers::{StoredSteps, Stream};
use crate::continuum::merge::SmallestError;
use crate::continuum::nodes::{Nodes, bytes_of_sums, sums};
use crate::continuum::opacity::Alpha;
use crate::continuum::oracle::{Composite, TwoPass};
use crate::continuum::placed::Placed;
use crate::continuum::rounded_steps::RoundedSteps;
use crate::continuum::stored_pass::StoredPass;
use crate::error::Result;
use crate::format::{Formats, Target};
use crate::gpu::form::{Form, Number, Path, Streaming, layers, only_single_formats};
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::technique::{AnyTechnique, Axes, Cost, Info, Properties};
use crate::techniques::ANY_ORDER;

/// The registry entry.
pub static INFO: Info = Info {
    id: "adaptive_transparency",
    aliases: &[],
    name: "Adaptive transparency",
    citation: &["Salvi2011"],
    doc: "A first pass keeps each pixel's transmittance as k steps and, one too many, removes the one that \
          changes the area under the function least; a second pass adds up all fragments as that function \
          attenuates them. It never lets through too much.",
    axes: Axes {
        memory: "k layers",
        insertion: "always",
        merge: "merge w/smallest error",
        normalize: "no",
        opacity: "alpha",
    },
    params: &[
        ParamSpec::new("layers", Kind::at_least(1), Value::Int(8), "steps kept per pixel"),
        ParamSpec::new(
            "protect_front",
            Kind::Bool,
            Value::None,
            "never remove one of the first half of the steps, where errors show most",
        )
        .derived("layers >= 8", |params, _| Value::Bool(params.size("layers") >= 8)),
        Composite::param("none"),
    ],
    targets: &TARGETS,
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "2",
    bytes_per_pixel: "8 layers + 20 in f32, half of that in f16",
    build,
    gpu: Some(gpu),
};

fn build(params: &Params, view: &View) -> Result<Box<dyn AnyTechnique>> {
    let layers = params.size("layers");
    let protected = protected(params);
    let composite = Composite::from_params(params);
    let formats = Formats::from_params(INFO.targets, params);
    let nodes = Nodes::new(&formats, view);
    let cost = Cost { geometry_passes: 2.0, ..Cost::list(layers, nodes.bytes, bytes_of_sums(&formats)) };
    let properties = properties(layers, composite);
    if nodes.are_default {
        let stream = Stream { insertion: Always, merge: SmallestError { protected }, opacity: Alpha, layers };
        return Ok(Box::new(TwoPass { oracle: StoredSteps { stream, cost, properties }, composite }));
    }
    let oracle = RoundedSteps { layers, protected, nodes, cost, properties: nodes.promises(properties) };
    let technique = StoredPass { oracle, composite, recipe: sums(&formats) };
    Ok(Box::new(Placed::new(technique, nodes.depths)))
}

/// How many of the first steps are never removed.
fn protected(params: &Params) -> usize {
    if params.bool("protect_front") { (params.size("layers") / 2).max(1) } else { 1 }
}

/// Its form on a GPU, with steps and sums in f32.
#[expect(clippy::cast_possible_truncation, reason = "there are few layers")]
fn gpu(params: &Params, _view: &View) -> Result<Form> {
    only_single_formats(params, INFO.targets)?;
    let protected = Number::Whole(protected(params) as u32);
    Ok(Form {
        weight: None,
        shader: include_str!("../../shaders/adaptive_transparency.wgsl"),
        numbers: vec![protected, Composite::from_params(params).number()],
        path: Path::Streamed(Streaming::as_submitted(params).of_layers(layers(params)?).in_walks()),
        shows_zero_fragments: false,
        colored_transmittance: false,
    })
}

static TARGETS: [Target; 4] =
    [Target::NODE_SHARE, Target::NODE_DEPTH, Target::ACCUMULATION, Target::REVEALAGE];

/// The last value of the step function is never lost, so its total is exact; a single step, to it and at the
/// nearest depth, is the same in any order.
fn properties(layers: usize, composite: Composite) -> Properties {
    Properties {
        order_independent: layers == 1,
        consistent: true,
        exact_for_one: true,
        exact_for_one_color: composite == Composite::Normalize,
        exact_coverage: true,
        ..Properties::NONE
    }
}

#[cfg(test)]
mod tests {
    use crate::fragments::Fragment;
    use crate::params::Input;
    use crate::techniques::testing::{
        as_pixel, build, clear_pixels, fragment, over, random_pixel, resolve_all,
    };

    fn layers(k: i64) -> (&'static str, Input) {
        ("layers", Input::Int(k))
    }

    fn steps(inputs: &[(&str, Input)], pixel: &[Fragment], depths: &[f32]) -> Vec<f64> {
        let adaptive = build("adaptive_transparency", inputs).unwrap();
        as_pixel(pixel, |pixel| adaptive.transmittance(pixel, depths)).unwrap()
    }

    #[test]
    fn the_step_of_least_area_goes_to_its_nearer_neighbour() {
        // T = 1/2, 1/4, 1/8 behind 1, 2, 8: areas 1 · 1/4 and 6 · 1/8
        let layer = |z, key| fragment(z, [1.0; 3], 0.5, key);
        let pixel = [layer(8.0, 0), layer(1.0, 1), layer(2.0, 2)];
        let depths = [1.0, 1.5, 2.5, 8.5];
        assert_eq!(steps(&[layers(3)], &pixel, &depths), [1.0, 0.5, 0.25, 0.125]);
        assert_eq!(steps(&[layers(2)], &pixel, &depths), [1.0, 0.25, 0.25, 0.125]);
        assert_eq!(steps(&[layers(1)], &pixel, &depths), [1.0, 0.125, 0.125, 0.125]);
    }

    #[test]
    fn the_front_half_can_be_protected() {
        // the smallest areas are in front: gaps of 0.01, then of 1
        let z = [1.0, 1.01, 1.02, 1.03, 3.0, 4.0, 5.0, 6.0, 7.0];
        let pixel: Vec<_> = (0..).zip(z).map(|(key, z)| fragment(z, [1.0; 3], 0.2, key)).collect();
        let front = [1.005, 1.015, 1.025, 1.035];
        let protected = steps(&[layers(8)], &pixel, &front);
        assert_eq!(protected, exact_at(&pixel, &front));
        let free = [layers(8), ("protect_front", Input::Bool(false))];
        assert_ne!(steps(&free, &pixel, &front), protected);
        let (few, all) = (steps(&free, &pixel, &[3.5, 9.0]), steps(&[layers(9)], &pixel, &[3.5, 9.0]));
        assert!(few.iter().zip(&all).all(|(a, b)| (a - b).abs() < F64_ROUNDING), "{few:?} {all:?}");
    }

    fn exact_at(pixel: &[Fragment], depths: &[f32]) -> Vec<f64> {
        let in_front = |z: f32| pixel.iter().filter(move |f| f.depth < z).map(|f| 1.0 - f64::from(f.alpha));
        depths.iter().map(|&z| in_front(z).product()).collect()
    }

    /// Products of up to 64 factors in another order.
    const F64_ROUNDING: f64 = 1e-13;

    #[test]
    fn transmittance_is_never_overestimated_and_its_total_is_exact() {
        for seed in 0..20 {
            let pixel = random_pixel(40, seed);
            let depths: Vec<f32> = (0..120_u8).map(|i| f32::from(i) * 0.09).chain([1e9]).collect();
            let exact = exact_at(&pixel, &depths);
            for k in [1, 2, 5, 8, 13] {
                let got = steps(&[layers(k)], &pixel, &depths);
                assert!(
                    got.iter().zip(&exact).all(|(a, b)| *a <= b + F64_ROUNDING),
                    "{k}: {got:?} {exact:?}"
                );
                assert!((got[120] - exact[120]).abs() <= F64_ROUNDING);
            }
            let all = steps(&[layers(64)], &pixel, &depths);
            assert!(all.iter().zip(&exact).all(|(a, b)| (a - b).abs() <= F64_ROUNDING));
        }
    }

    /// Sheet section 3, identity 10: Σ T̂ a = 1 − T̂(∞), equal depths aside.
    #[test]
    fn with_room_for_all_the_weights_telescope() {
        let mut pixel = random_pixel(30, 6);
        for (i, f) in (0_u8..).zip(&mut pixel) {
            f.depth = 1.0 + f32::from(i * 7 % 30) * 0.25;
        }
        let mut depths: Vec<f32> = pixel.iter().map(|f| f.depth).collect();
        depths.push(1e9);
        let got = steps(&[layers(30)], &pixel, &depths);
        let sum: f64 = got.iter().zip(&pixel).map(|(t, f)| t * f64::from(f.alpha)).sum();
        assert!((sum - (1.0 - got[30])).abs() < F64_ROUNDING);
    }

    /// Sheet 2.3: RMSE 0.022 against 0.048 at k = 4, n = 8.
    #[test]
    fn normalisation_gains_much_at_small_k() {
        let rmse = |composite: &str| {
            let inputs = [layers(4), ("composite", Input::Text(composite.into()))];
            let pixels = clear_pixels(60);
            let got = resolve_all("adaptive_transparency", &inputs, &pixels);
            let errors =
                got.iter().zip(&pixels).map(|(got, pixel)| (got.color - over(pixel).0).length_squared());
            (errors.sum::<f64>() / 180.0).sqrt()
        };
        assert!(rmse("normalize") < 0.6 * rmse("none"), "{} {}", rmse("normalize"), rmse("none"));
    }
}
