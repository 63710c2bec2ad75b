//! Adaptive volumetric shadow maps (Salvi et al. 2010): a polyline of k nodes, compressed as fragments arrive.

use crate::continuum::oracle::{Composite, Oracle};
use crate::continuum::polyline::{Label, Vertex, count_in_front, evaluate, evaluate_behind, triangle};
use crate::continuum::stored_oracle::{NODE_DEPTH, NODES, StoredOracle, technique};
use crate::error::Result;
use crate::format::{Format, Formats, SUMMATION, Target};
use crate::fragments::Fragment;
use crate::gpu::form::{Form, Number, Path, Streaming, layers, only, only_single_formats};
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::technique::{AnyTechnique, Axes, Cost, DepthComplexity, Info, Pixel, Properties};
use crate::techniques::ANY_ORDER;
use std::hint::select_unpredictable;

/// The registry entry.
pub static INFO: Info = Info {
    id: "avsm",
    aliases: &[],
    name: "Adaptive Volumetric Shadow Maps",
    citation: &["Salvi2010"],
    doc: "Inserts each fragment into a piecewise linear transmittance of k nodes as it arrives; beyond k, the \
          node whose removal changes the area under the curve least goes. A second pass sees each fragment \
          through the curve.",
    axes: Axes {
        memory: "k layers",
        insertion: "always",
        merge: "merge w/smallest error",
        normalize: "no",
        opacity: "alpha",
    },
    params: &[
        ParamSpec::new("layers", Kind::at_least(2), Value::Int(8), "nodes per pixel"),
        ParamSpec::new(
            "thickness",
            Kind::NON_NEGATIVE,
            Value::Float(0.0),
            "depth over which a fragment's absorption is spread, behind its surface",
        ),
        Composite::param("none"),
        SUMMATION,
    ],
    targets: &TARGETS,
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "2",
    bytes_per_pixel: "transmittance and depth per node, 4 sums and R: 8 layers + 20 in f32, 4 layers + 10 in f16",
    build,
    gpu: Some(gpu),
};

static TARGETS: [Target; 4] = [NODES, NODE_DEPTH, Target::ACCUMULATION, Target::REVEALAGE];

fn build(params: &Params, _view: &View) -> Result<Box<dyn AnyTechnique>> {
    let oracle = Avsm {
        layers: params.size("layers"),
        thickness: params.float("thickness"),
        depth: Formats::from_params(&TARGETS, params).of(NODE_DEPTH.name),
    };
    Ok(technique(oracle, &TARGETS, params))
}

/// Its form on a GPU, with nodes and sums in f32.
fn gpu(params: &Params, _view: &View) -> Result<Form> {
    only_single_formats(params, INFO.targets)?;
    only(params, "summation", "plain")?;
    let [thickness, rest] = Number::in_two(params.float("thickness").min(f32::MAX.into()));
    Ok(Form {
        weight: None,
        shader: include_str!("../../shaders/avsm.wgsl"),
        numbers: vec![Composite::from_params(params).number(), thickness, rest],
        path: Path::Streamed(Streaming::as_submitted(params).of_layers(layers(params)?).in_walks()),
        shows_zero_fragments: false,
        colored_transmittance: false,
    })
}

/// At most `layers` nodes per pixel.
struct Avsm {
    layers: usize,
    thickness: f64,
    /// The format of depths.
    depth: Format,
}

impl Avsm {
    /// Where a fragment ends, as a node has it.
    #[expect(clippy::cast_possible_truncation, reason = "depths are f32")]
    fn end(&self, fragment: &Fragment) -> f32 {
        let end = self.depth.round(f64::from(fragment.depth) + self.thickness);
        (self.depth.read(end) as f32).min(f32::MAX)
    }

    /// Puts a fragment into the curve: its two faces, what is inside by its own linear ramp, what is behind it by
    /// all that it absorbs.
    fn insert(&self, nodes: &mut Vec<Vertex>, fragment: &Fragment) {
        let end = self.end(fragment);
        let labels = [Label::front(fragment), Label::back(fragment, end)];
        let [first, last] = labels.map(|label| count_in_front(nodes, label));
        let through = 1.0 - f64::from(fragment.alpha);
        let front = Vertex { label: labels[0], transmittance: evaluate_behind(nodes, first, labels[0]) };
        let back =
            Vertex { label: labels[1], transmittance: through * evaluate_behind(nodes, last, labels[1]) };
        let length = f64::from(end) - f64::from(fragment.depth);
        for node in nodes[first..last].iter_mut().filter(|_| length > 0.0) {
            let inside = (node.label.depth() - f64::from(fragment.depth)) / length;
            node.transmittance *= 1.0 - inside * f64::from(fragment.alpha);
        }
        nodes[last..].iter_mut().for_each(|node| node.transmittance *= through);
        nodes.extend([back; 2]);
        let end = nodes.len();
        nodes.copy_within(last..end - 2, last + 2);
        nodes.copy_within(first..last, first + 1);
        (nodes[first], nodes[last + 1]) = (front, back);
    }
}

impl Avsm {
    /// Inserts fragment by fragment; `write` sees the nodes that each leaves, one too many or two.
    fn insert_all(&self, pixel: &Pixel<'_>, nodes: &mut Vec<Vertex>, write: impl Fn(&mut [Vertex])) {
        let mut areas = Vec::with_capacity(self.layers.min(pixel.list.len()) + 2);
        nodes.clear();
        for fragment in pixel.list.iter() {
            self.insert(nodes, &fragment);
            write(nodes);
            reduce(nodes, self.layers, &mut areas);
        }
    }
}

/// Removes the inner nodes that matter least, the nearest of several, until `layers` are left.
fn reduce(nodes: &mut Vec<Vertex>, layers: usize, areas: &mut Vec<f64>) {
    if nodes.len() <= layers {
        return;
    }
    // place i is that of node i + 1
    areas.clear();
    areas.extend((1..nodes.len() - 1).map(|i| area(nodes, i)));
    while nodes.len() > layers {
        let mut least = (f64::INFINITY, 0);
        for (i, &area) in areas.iter().enumerate() {
            least = select_unpredictable(area < least.0, (area, i), least);
        }
        let i = least.1 + 1;
        nodes.remove(i);
        areas.remove(i - 1);
        // what was removed was a neighbour of these two
        for neighbor in [i - 1, i] {
            if neighbor > 0 && neighbor < nodes.len() - 1 {
                areas[neighbor - 1] = area(nodes, neighbor);
            }
        }
    }
}

/// What removing an inner node changes.
fn area(nodes: &[Vertex], i: usize) -> f64 {
    triangle(&nodes[i - 1], &nodes[i], &nodes[i + 1])
}

impl Oracle for Avsm {
    type Map = Vec<Vertex>;

    fn build(&self, pixel: &Pixel<'_>, nodes: &mut Vec<Vertex>) {
        self.insert_all(pixel, nodes, |_| ());
    }

    fn in_front_of(&self, nodes: &Vec<Vertex>, fragment: &Fragment) -> f64 {
        evaluate(nodes, Label::front(fragment))
    }

    fn at(&self, nodes: &Vec<Vertex>, depth: f32) -> f64 {
        evaluate(nodes, Label::at(depth))
    }

    fn total(&self, nodes: &Vec<Vertex>) -> f64 {
        nodes.last().map_or(1.0, |last| last.transmittance)
    }

    #[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
    fn cost(&self, _complexity: &DepthComplexity) -> Cost {
        Cost { geometry_passes: 2.0, bytes_per_pixel: 8.0 * self.layers as f64 + 20.0 }
    }

    fn properties(&self, composite: Composite) -> Properties {
        Properties {
            // two nodes are the nearest front and the farthest back, whatever came first
            order_independent: self.layers == 2,
            unbiased: false,
            consistent: self.thickness == 0.0,
            // the first node and the last stay, so a lone fragment and the whole product are exact
            exact_for_one: true,
            exact_for_one_color: composite == Composite::Normalize,
            exact_coverage: true,
        }
    }
}

impl StoredOracle for Avsm {
    fn build_stored(&self, pixel: &Pixel<'_>, formats: &Formats, nodes: &mut Vec<Vertex>) {
        let format = formats.of(NODES.name);
        // one that did not change is rounded already
        self.insert_all(pixel, nodes, |nodes| {
            nodes.iter_mut().for_each(|node| node.transmittance = format.round(node.transmittance));
        });
    }

    #[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
    fn texels(&self, _complexity: &DepthComplexity) -> Vec<(&'static str, f64)> {
        [NODES, NODE_DEPTH].map(|target| (target.name, self.layers as f64)).into()
    }
}

#[cfg(test)]
mod tests {
    use super::Avsm;
    use crate::continuum::oracle::Oracle;
    use crate::format::Format;
    use crate::fragments::Fragment;
    use crate::params::Input;
    use crate::techniques::testing::{
        F32_STATE, Random, as_pixel, assert_close, clear_pixels, fragment, mean_error, over, random_pixel,
        resolve, three_layers,
    };

    fn avsm(layers: usize, thickness: f64) -> Avsm {
        Avsm { layers, thickness, depth: Format::F32 }
    }

    fn curve(layers: usize, thickness: f64, fragments: &[Fragment], depths: &[f32]) -> Vec<f64> {
        let (oracle, mut nodes) = (avsm(layers, thickness), Vec::new());
        as_pixel(fragments, |pixel| oracle.build(pixel, &mut nodes));
        assert!(nodes.len() <= layers && nodes.is_sorted_by(|a, b| a.label <= b.label));
        assert!(nodes.is_sorted_by(|a, b| a.transmittance >= b.transmittance - 1e-15), "{nodes:?}");
        depths.iter().map(|&z| oracle.at(&nodes, z)).collect()
    }

    #[test]
    fn two_layers_in_three_nodes_by_hand() {
        // (2, 1) (2, .5) (6, .5) (6, .25): removing the third changes least, 4 * .25 against 4 * .5
        let layers = [fragment(6.0, [1.0; 3], 0.5, 0), fragment(2.0, [1.0; 3], 0.5, 1)];
        assert_eq!(curve(3, 0.0, &layers, &[2.0, 4.0, 6.0, 7.0]), [1.0, 0.375, 0.25, 0.25]);
    }

    #[test]
    fn thick_fragments_are_ramps_and_their_product() {
        let layers = [fragment(2.0, [1.0; 3], 0.5, 0), fragment(3.0, [1.0; 3], 0.5, 1)];
        let got = curve(8, 2.0, &layers, &[2.0, 2.5, 3.0, 4.0, 5.0, 6.0]);
        assert_eq!(got, [1.0, 0.875, 0.75, 0.375, 0.25, 0.25]);
    }

    #[test]
    fn two_nodes_per_fragment_are_over_in_any_order_ties_included() {
        let mut random = Random::new(3);
        for n in 1..=64 {
            let mut pixel = random_pixel(n, u64::from(n) + 7);
            random.shuffle(&mut pixel);
            let (color, transmittance) = over(&pixel);
            let got = resolve("avsm", &[("layers", Input::Int(2 * i64::from(n)))], &pixel);
            assert_close(got, color, transmittance, F32_STATE);
        }
    }

    #[test]
    fn the_last_node_keeps_the_whole_product() {
        for n in 1..=64 {
            let pixel = random_pixel(n, u64::from(n) + 70);
            for (layers, thickness) in [(2, 0.0), (5, 0.0), (5, 0.7), (8, 30.0)] {
                let got = curve(layers, thickness, &pixel, &[1e9])[0];
                assert!((got - over(&pixel).1).abs() < 1e-14, "{got}");
            }
        }
    }

    #[test]
    fn more_nodes_are_closer() {
        let pixels = clear_pixels(200);
        let errors = [2, 4, 8, 12, 16].map(|layers| mean_error(&avsm(layers, 0.0), &pixels));
        assert!(errors.is_sorted_by(|a, b| a > b) && errors[4] < 1e-14, "{errors:?}");
    }

    #[test]
    fn full_curves_depend_on_the_order_of_arrival() {
        let pixel = &mut clear_pixels(1)[0];
        let color =
            |layers, pixel: &[Fragment]| resolve("avsm", &[("layers", Input::Int(layers))], pixel).color;
        let before = [2, 4, 16].map(|layers| color(layers, pixel));
        pixel.reverse();
        let moved = [0, 1, 2].map(|i| (color([2, 4, 16][i], pixel) - before[i]).abs().max_element());
        assert!(moved[0] < F32_STATE && moved[1] > 1e-3 && moved[2] < F32_STATE, "{moved:?}");
    }

    #[test]
    fn fragments_of_one_label_are_all_kept() {
        let twin = fragment(2.0, [1.0; 3], 0.5, 7);
        for thickness in [0.0, 1.0] {
            assert_eq!(curve(8, thickness, &[twin, twin, twin], &[2.0, 3.0, 9.0]).last(), Some(&0.125));
        }
        let mut pixel = three_layers();
        pixel.push(pixel[0]);
        assert!(resolve("avsm", &[], &pixel).color.is_finite());
    }
}
