//! Multi-layer depth peeling (Myers & Bavoil 2007; Liu et al. 2009): k layers per geometry pass.

use crate::continuum::insertion::Always;
use crate::continuum::layers::{StoredLayers, Stream};
use crate::continuum::merge::{DiscardFurthest, DiscardOccupied};
use crate::continuum::nodes::{LAYERS, Nodes};
use crate::continuum::normalize::Unnormalized;
use crate::continuum::opacity::Alpha;
use crate::continuum::range::DepthRange;
use crate::error::Result;
use crate::gpu::form::{Form, MOST_LAYERS, Number, Path, Streaming, only, only_default_formats};
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::technique::{AnyTechnique, Axes, Cost, Info, Properties};
use crate::techniques::ANY_ORDER;

/// The registry entry.
pub static INFO: Info = Info {
    id: "multilayer_depth_peeling",
    aliases: &[],
    name: "Multi-layer depth peeling",
    citation: &["Liu2009", "Myers2007", "Wyman2016"],
    doc: "Keeps the k nearest fragments behind the last pass's, in each of a few passes; layers beyond them are \
          missing, and the background shows in their place. mode=\"bucket\" is the published bucket sort: one \
          pass, and of the fragments in each of k depth buckets only the nearest stays.",
    axes: Axes {
        memory: "k layers",
        insertion: "if in k closest",
        merge: "discard furthest",
        normalize: "no",
        opacity: "either",
    },
    params: &[
        ParamSpec::new("layers", Kind::at_least(1), Value::Int(8), "layers per pass, or depth buckets"),
        ParamSpec::new(
            "mode",
            Kind::Choice(&["nearest", "bucket"]),
            Value::Text("nearest"),
            "which layers a pass keeps: the nearest ones, or the nearest one of each depth bucket",
        ),
        ParamSpec::new("passes", Kind::at_least(1), Value::Int(1), "peeling passes")
            .when(|p| p.text("mode") == "nearest"),
        DepthRange::param("pixel").when(|p| p.text("mode") == "bucket"),
    ],
    targets: &LAYERS,
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "passes; bucket: 1, 1 more for range=\"pixel\"",
    bytes_per_pixel: "20 layers + 8 in f32, 10 layers + 8 in f16, 8 layers + 8 as rgba8 and an f32",
    build,
    gpu: Some(gpu),
};

fn build(params: &Params, view: &View) -> Result<Box<dyn AnyTechnique>> {
    let layers = params.size("layers");
    let nodes = Nodes::from_params(INFO.targets, params, view);
    let list = Cost::list(layers, nodes.bytes, 8.0);
    if params.text("mode") == "bucket" {
        let range = DepthRange::from_params(params, view);
        let merge = DiscardOccupied { bins: layers, range };
        let buckets = StoredLayers {
            stream: Stream { insertion: Always, merge, opacity: Alpha, layers },
            normalize: Unnormalized,
            cost: Cost { geometry_passes: if range == DepthRange::Pixel { 2.0 } else { 1.0 }, ..list },
            properties: PEELED,
        };
        return Ok(buckets.stored(nodes));
    }
    let passes = params.size("passes");
    #[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
    let cost = Cost { geometry_passes: passes as f64, ..list };
    // pass p's k nearest behind pass p − 1's: together they are the p k nearest
    let layers = layers.saturating_mul(passes);
    let nearest = StoredLayers {
        stream: Stream { insertion: Always, merge: DiscardFurthest, opacity: Alpha, layers },
        normalize: Unnormalized,
        cost,
        properties: Properties { consistent: true, ..PEELED },
    };
    Ok(nearest.stored(nodes))
}

/// Its form on a GPU: as many layers as all passes keep or, where they are too many, the beginning of each list.
fn gpu(params: &Params, _view: &View) -> Result<Form> {
    only_default_formats(params, INFO.targets)?;
    only(params, "mode", "nearest")?;
    let layers = params.size("layers").saturating_mul(params.size("passes"));
    let layers = u32::try_from(layers).unwrap_or(u32::MAX);
    let stream = if layers <= MOST_LAYERS {
        Streaming::in_any_order().of_layers(layers)
    } else {
        // the shader keeps none of them
        Streaming::nearest_first().of_layers(1)
    };
    let comes_sorted = ("COMES_SORTED", u32::from(layers > MOST_LAYERS));
    Ok(Form {
        weight: None,
        shader: include_str!("../../shaders/multilayer_depth_peeling.wgsl"),
        numbers: vec![Number::Whole(layers)],
        path: Path::Streamed(stream.of_sizes(vec![comes_sorted])),
        shows_zero_fragments: false,
        colored_transmittance: false,
    })
}

/// What is kept is a function of the set of fragments.
const PEELED: Properties = Properties { order_independent: true, exact_for_one: true, ..Properties::NONE };

#[cfg(test)]
mod tests {
    use crate::fragments::Fragment;
    use crate::params::Input;
    use crate::technique::Resolved;
    use crate::techniques::testing::{Random, fragment, over, random_pixel, resolve, three_layers};

    fn peel(layers: i64, passes: i64, pixel: &[Fragment]) -> Resolved {
        let inputs = [("layers", Input::Int(layers)), ("passes", Input::Int(passes))];
        resolve("multilayer_depth_peeling", &inputs, pixel)
    }

    fn buckets(layers: i64, range: (f64, f64), pixel: &[Fragment]) -> Resolved {
        let range = Input::Floats(vec![range.0, range.1]);
        let inputs =
            [("layers", Input::Int(layers)), ("mode", Input::Text("bucket".into())), ("range", range)];
        resolve("multilayer_depth_peeling", &inputs, pixel)
    }

    #[test]
    fn as_many_layers_as_single_peels() {
        for (k, passes) in [(1, 1), (3, 1), (2, 4), (1, 9), (8, 8)] {
            let pixel = random_pixel(30, 4);
            let peeled = resolve("depth_peeling", &[("passes", Input::Int(k * passes))], &pixel);
            assert_eq!(peel(k, passes, &pixel), peeled);
        }
        let huge = peel(i64::MAX, i64::MAX, &three_layers());
        assert_eq!((huge.color, huge.transmittance.x), over(&three_layers()));
    }

    #[test]
    fn any_order_gives_the_same_bits() {
        let mut pixel = random_pixel(40, 7);
        let mut random = Random::new(1);
        let (nearest, bucket) = (peel(5, 2, &pixel), buckets(6, (1.0, 9.0), &pixel));
        for _ in 0..5 {
            random.shuffle(&mut pixel);
            assert_eq!(peel(5, 2, &pixel), nearest);
            assert_eq!(buckets(6, (1.0, 9.0), &pixel), bucket);
        }
    }

    #[test]
    fn a_bucket_keeps_its_nearest_fragment() {
        // buckets of width 2 from 1: depths 2 | 4 | 8, and 4.5 shares the second
        let mut pixel = three_layers();
        let exact = over(&pixel);
        pixel.push(fragment(4.5, [9.0; 3], 0.9, 3));
        let got = buckets(4, (1.0, 9.0), &pixel);
        assert_eq!((got.color, got.transmittance.x), exact);
        pixel.reverse();
        assert_eq!(buckets(4, (1.0, 9.0), &pixel), got);
        // depths outside the range belong to the end buckets
        let got = buckets(2, (5.0, 6.0), &pixel);
        let nearest_two = over(&[three_layers()[1], three_layers()[2]]);
        assert_eq!((got.color, got.transmittance.x), nearest_two);
    }
}
