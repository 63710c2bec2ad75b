//! Deep shadow maps (Lokovic & Veach 2000): the exact transmittance curve, compressed to a polyline.

use crate::continuum::oracle::{Composite, Oracle};
use crate::continuum::polyline::{Label, Vertex, count_in_front, evaluate, evaluate_behind, triangle};
use crate::continuum::stored_oracle::{NODE_DEPTH, NODES, StoredOracle, technique};
use crate::error::Result;
use crate::format::{Formats, SUMMATION, Target};
use crate::fragments::{Fragment, List};
use crate::gpu::form::{Form, Listing, Number, Path, Sorting, only, only_single_formats, saturated};
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::technique::{AnyTechnique, Axes, Cost, DepthComplexity, Info, Pixel, Properties};
use crate::techniques::ANY_ORDER;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// The registry entry.
pub static INFO: Info = Info {
    id: "deep_shadow_maps",
    aliases: &[],
    name: "Deep Shadow Maps",
    citation: &["Lokovic2000"],
    doc: "Sorts a pixel's fragments and compresses their transmittance, two vertices per fragment, to a polyline \
          within eps of it, or to the given number of vertices by removing the one that matters least; a second \
          pass sees each fragment through the polyline.",
    axes: Axes {
        memory: "k line segments",
        insertion: "always",
        merge: "merge w/smallest error",
        normalize: "no",
        opacity: "alpha",
    },
    params: &[
        ParamSpec::new(
            "vertices",
            Kind::at_least(0),
            Value::Int(0),
            "vertices kept per pixel, 2 or more; 0 keeps what eps asks for",
        ),
        ParamSpec::new(
            "eps",
            Kind::float(0.0, 1.0),
            Value::Float(0.01),
            "largest error of the transmittance",
        )
        .when(|p| p.size("vertices") == 0),
        Composite::param("none"),
        SUMMATION,
    ],
    targets: &TARGETS,
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "2",
    bytes_per_pixel: "transmittance and depth per vertex, 4 sums and R: 8 vertices + 20 in f32, 4 vertices + 10 in f16; by eps at \
                      most 2 n vertices and 4 more (n = mean depth complexity)",
    build,
    gpu: Some(gpu),
};

fn build(params: &Params, _view: &View) -> Result<Box<dyn AnyTechnique>> {
    let compression = match params.size("vertices") {
        0 => Compression::Within(params.float("eps")),
        1 => return Err(params.error("parameter \"vertices\" is 1", "allowed is 0 or an integer >= 2")),
        vertices => Compression::To(vertices),
    };
    Ok(technique(DeepShadowMaps { compression }, &TARGETS, params))
}

static TARGETS: [Target; 4] = [NODES, NODE_DEPTH, Target::ACCUMULATION, Target::REVEALAGE];

/// Its form on a GPU: over sorted lists.
fn gpu(params: &Params, _view: &View) -> Result<Form> {
    only_single_formats(params, &TARGETS)?;
    only(params, "summation", "plain")?;
    Ok(Form {
        weight: None,
        shader: include_str!("../../shaders/deep_shadow_maps.wgsl"),
        numbers: vec![
            saturated(params.size("vertices")),
            Number::float(params.float("eps")),
            Composite::from_params(params).number(),
        ],
        path: Path::Listed(Listing {
            resolve: "resolve",
            sorted: Sorting::Depth,
            layers: None,
            sizes: Vec::new(),
        }),
        shows_zero_fragments: false,
        colored_transmittance: false,
    })
}

/// When a polyline is short enough.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Compression {
    /// As soon as the next segment would be farther from the curve than this.
    Within(f64),
    /// With this many vertices.
    To(usize),
}

/// A polyline per pixel.
struct DeepShadowMaps {
    compression: Compression,
}

/// One pixel's polyline, and what compressing it needs.
#[derive(Debug, Default)]
struct Map {
    curve: Vec<Vertex>,
    polyline: Vec<Vertex>,
    removal: Removal,
}

/// The exact curve: each fragment's front and back. Fragments of one label are one step.
fn step_curve(sorted: List<'_>, curve: &mut Vec<Vertex>) {
    curve.clear();
    let mut transmittance = 1.0;
    for f in sorted.iter() {
        let (front, back) = (Label::front(&f), Label::back(&f, f.depth));
        if curve.last().is_some_and(|last| last.label == back) {
            curve.pop();
        } else {
            curve.push(Vertex { label: front, transmittance });
        }
        transmittance *= 1.0 - f64::from(f.alpha);
        curve.push(Vertex { label: back, transmittance });
    }
}

/// A segment under construction: the slopes from its origin that stay within eps of the curve.
struct Segment {
    origin: Vertex,
    slopes: (f64, f64),
}

impl Segment {
    fn from(origin: Vertex) -> Self {
        Self { origin, slopes: (f64::NEG_INFINITY, f64::INFINITY) }
    }

    /// Goes on to `next`, if that keeps it within `eps`.
    fn extend(&mut self, next: &Vertex, eps: f64) -> bool {
        let step = next.transmittance - self.origin.transmittance;
        let length = next.label.depth() - self.origin.label.depth();
        if length == 0.0 {
            return step.abs() <= eps;
        }
        let lo = self.slopes.0.max((step - eps) / length);
        let hi = self.slopes.1.min((step + eps) / length);
        if lo <= hi {
            self.slopes = (lo, hi);
        }
        lo <= hi
    }

    /// Where the segment ends, at the face `label`, with the middle slope; `None` if it has no length yet.
    fn end(&self, label: Label) -> Option<Vertex> {
        let length = label.depth() - self.origin.label.depth();
        let slope = 0.5 * (self.slopes.0 + self.slopes.1);
        let transmittance = self.origin.transmittance + slope * length;
        (length > 0.0).then_some(Vertex { label, transmittance })
    }
}

/// The greedy compressor: a polyline at most `eps` from the curve (sheet 2.5).
fn compress(curve: &[Vertex], eps: f64, polyline: &mut Vec<Vertex>) {
    polyline.clear();
    polyline.extend(curve.first());
    let Some(mut segment) = curve.first().map(|v| Segment::from(*v)) else { return };
    for pair in curve.windows(2) {
        if segment.extend(&pair[1], eps) {
            continue;
        }
        if let Some(end) = segment.end(pair[0].label) {
            polyline.push(end);
            segment = Segment::from(end);
        }
        if !segment.extend(&pair[1], eps) {
            polyline.push(pair[1]);
            segment = Segment::from(pair[1]);
        }
    }
    polyline.extend(curve.last().and_then(|last| segment.end(last.label)));
    keep_falling(polyline);
}

/// Transmittance does not rise, so the running minimum is no farther from it.
fn keep_falling(polyline: &mut [Vertex]) {
    let mut least = 1.0_f64;
    for vertex in polyline {
        least = least.min(vertex.transmittance);
        vertex.transmittance = least;
    }
}

/// Removes vertices by the area that goes with them, smallest first.
#[derive(Debug, Default)]
struct Removal {
    /// Area (as bits, in the same order) and place; out of date where `area` disagrees.
    queue: BinaryHeap<Reverse<(u64, usize)>>,
    area: Vec<u64>,
    neighbors: Vec<(usize, usize)>,
}

/// The area of a vertex that is gone.
const GONE: u64 = u64::MAX;

impl Removal {
    fn reduce(&mut self, curve: &[Vertex], budget: usize, polyline: &mut Vec<Vertex>) {
        let n = curve.len();
        self.queue.clear();
        self.area.clear();
        self.area.resize(n, 0);
        self.neighbors.clear();
        self.neighbors.extend((0..n).map(|i| (i.saturating_sub(1), i + 1)));
        (1..n.saturating_sub(1)).for_each(|i| self.measure(curve, i));
        for _ in budget..n {
            self.remove_least(curve);
        }
        polyline.clear();
        polyline.extend(curve.iter().zip(&self.area).filter(|(_, area)| **area != GONE).map(|(v, _)| *v));
    }

    fn measure(&mut self, curve: &[Vertex], i: usize) {
        let (before, after) = self.neighbors[i];
        self.area[i] = triangle(&curve[before], &curve[i], &curve[after]).to_bits();
        self.queue.push(Reverse((self.area[i], i)));
    }

    fn remove_least(&mut self, curve: &[Vertex]) {
        while let Some(Reverse((area, i))) = self.queue.pop() {
            if self.area[i] != area {
                continue;
            }
            self.area[i] = GONE;
            let (before, after) = self.neighbors[i];
            self.neighbors[before].1 = after;
            self.neighbors[after].0 = before;
            for i in [before, after] {
                if i > 0 && i + 1 < curve.len() {
                    self.measure(curve, i);
                }
            }
            return;
        }
    }
}

impl Oracle for DeepShadowMaps {
    type Map = Map;
    const NEEDS_SORTED: bool = true;

    fn build(&self, pixel: &Pixel<'_>, Map { curve, polyline, removal }: &mut Map) {
        step_curve(pixel.sorted, curve);
        match self.compression {
            Compression::Within(eps) => compress(curve, eps, polyline),
            Compression::To(vertices) => removal.reduce(curve, vertices, polyline),
        }
    }

    fn in_front_of(&self, map: &Map, fragment: &Fragment) -> f64 {
        evaluate(&map.polyline, Label::front(fragment))
    }

    /// The fragments come sorted, so that what is in front of one is in front of the next too.
    fn see(&self, map: &Map, list: List<'_>, seen: &mut [f64]) {
        let first = list.iter().next();
        let mut in_front = first.map_or(0, |f| count_in_front(&map.polyline, Label::front(&f)));
        for (seen, fragment) in seen.iter_mut().zip(list.iter()) {
            let label = Label::front(&fragment);
            in_front += map.polyline[in_front..].iter().take_while(|v| v.label <= label).count();
            *seen = evaluate_behind(&map.polyline, in_front, label);
        }
    }

    fn at(&self, map: &Map, depth: f32) -> f64 {
        evaluate(&map.polyline, Label::at(depth))
    }

    fn total(&self, map: &Map) -> f64 {
        map.polyline.last().map_or(1.0, |last| last.transmittance.max(0.0))
    }

    #[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
    fn cost(&self, complexity: &DepthComplexity) -> Cost {
        let bytes_per_pixel = match self.compression {
            Compression::Within(_) => 16.0 * complexity.mean + 24.0,
            Compression::To(vertices) => 8.0 * vertices as f64 + 20.0,
        };
        Cost { geometry_passes: 2.0, bytes_per_pixel }
    }

    fn properties(&self, composite: Composite) -> Properties {
        let lossless = self.compression == Compression::Within(0.0);
        if lossless {
            return Properties::EXACT;
        }
        // the first vertex and the last are always kept, if only within eps of where they were
        let whole = composite != Composite::None || matches!(self.compression, Compression::To(_));
        Properties {
            order_independent: true,
            unbiased: false,
            consistent: true,
            exact_for_one: whole,
            exact_for_one_color: composite == Composite::Normalize,
            exact_coverage: whole,
        }
    }
}

impl StoredOracle for DeepShadowMaps {
    /// Who has sorted a pixel's fragments compresses them, and writes each vertex once.
    fn build_stored(&self, pixel: &Pixel<'_>, formats: &Formats, map: &mut Map) {
        let format = formats.of(NODES.name);
        self.build(pixel, map);
        map.polyline.iter_mut().for_each(|vertex| vertex.transmittance = format.round(vertex.transmittance));
    }

    #[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
    fn texels(&self, complexity: &DepthComplexity) -> Vec<(&'static str, f64)> {
        let vertices = match self.compression {
            Compression::Within(_) => 2.0 * complexity.mean,
            Compression::To(vertices) => vertices as f64,
        };
        [NODES, NODE_DEPTH].map(|target| (target.name, vertices)).into()
    }
}

#[cfg(test)]
mod tests {
    use super::{Compression, DeepShadowMaps, Map};
    use crate::continuum::oracle::Oracle;
    use crate::fragments::Fragment;
    use crate::params::Input;
    use crate::techniques::testing::{
        F32_STATE, as_pixel, assert_close, build, clear_pixels, exact_transmittance, fragment, mean_error,
        over, random_pixel, resolve, three_layers,
    };

    fn map(compression: Compression, fragments: &[Fragment]) -> (DeepShadowMaps, Map) {
        let (oracle, mut map) = (DeepShadowMaps { compression }, Map::default());
        as_pixel(fragments, |pixel| oracle.build(pixel, &mut map));
        (oracle, map)
    }

    fn pixels() -> impl Iterator<Item = Vec<Fragment>> {
        (0..65).map(|n| random_pixel(n, u64::from(n)))
    }

    /// The exact curve strictly in front of a depth.
    fn exact(fragments: &[Fragment], depth: f32) -> f64 {
        fragments.iter().filter(|f| f.depth < depth).map(|f| 1.0 - f64::from(f.alpha)).product()
    }

    #[test]
    fn two_layers_compressed_by_hand() {
        // the curve is 1 to depth 2, 0.5 to depth 4, 0.25 behind; within 0.3 of it is a step of 0.5 at depth 2,
        // then the segment whose slopes at depth 4 are those to 0.2..0.8 and -0.05..0.55
        let layers = [fragment(2.0, [1.0; 3], 0.5, 0), fragment(4.0, [1.0; 3], 0.5, 1)];
        let (oracle, map) = map(Compression::Within(0.3), &layers);
        let at: Vec<_> = [2.0, 3.0, 4.0, 5.0].map(|z| oracle.at(&map, z)).into();
        assert_eq!(map.polyline.len(), 3);
        assert!(at.iter().zip([1.0, 0.437_5, 0.375, 0.375]).all(|(a, b)| (a - b).abs() < 1e-15), "{at:?}");
    }

    #[test]
    fn the_budget_removes_the_smallest_triangles() {
        // of (2, 1) (2, .75) (4, .75) (4, .375) (8, .375) (8, .094) the areas are .5, .75, 1.5, 1.125: the second goes
        let two_area = |vertices| map(Compression::To(vertices), &three_layers()).1.polyline;
        let kept = |vertices| -> Vec<_> {
            two_area(vertices).iter().map(|v| (v.label.depth(), v.transmittance)).collect()
        };
        let whole = [(2.0, 1.0), (2.0, 0.75), (4.0, 0.75), (4.0, 0.375), (8.0, 0.375), (8.0, 0.093_75)];
        assert_eq!(kept(6), whole);
        assert_eq!(kept(5), [whole[0], whole[2], whole[3], whole[4], whole[5]]);
        assert_eq!(kept(2), [whole[0], whole[5]]);
    }

    #[test]
    fn without_loss_it_is_over_ties_included() {
        for pixel in pixels().filter(|p| !p.is_empty()) {
            let (color, transmittance) = over(&pixel);
            for inputs in [("eps", Input::Float(0.0)), ("vertices", Input::Int(128))] {
                let got = resolve("deep_shadow_maps", &[inputs], &pixel);
                assert_close(got, color, transmittance, F32_STATE);
            }
        }
    }

    #[test]
    fn the_error_is_at_most_eps_and_the_curve_never_rises() {
        for pixel in pixels() {
            for eps in [0.0, 0.001, 0.03, 0.25, 1.0] {
                let (oracle, map) = map(Compression::Within(eps), &pixel);
                let bound = eps + 1e-12;
                for (f, t) in pixel.iter().zip(exact_transmittance(&pixel)) {
                    assert!((oracle.in_front_of(&map, f) - t).abs() <= bound, "{eps}: {f:?}");
                }
                let depths = (0..200_u8).map(|i| 0.9 + f32::from(i) * 0.042);
                let curve: Vec<_> = depths.clone().map(|z| oracle.at(&map, z)).collect();
                assert!(curve.iter().zip(depths).all(|(t, z)| (t - exact(&pixel, z)).abs() <= bound));
                assert!(curve.is_sorted_by(|a, b| a >= b));
                assert!((oracle.total(&map) - over(&pixel).1).abs() <= bound);
            }
        }
    }

    #[test]
    fn what_is_seen_of_fragments_and_background_adds_up() {
        // identity 10 of sheet section 3
        for pixel in pixels() {
            let (oracle, map) = map(Compression::Within(0.0), &pixel);
            let seen: f64 = pixel.iter().map(|f| oracle.in_front_of(&map, f) * f64::from(f.alpha)).sum();
            assert!((seen - (1.0 - oracle.total(&map))).abs() < 1e-14);
        }
    }

    #[test]
    fn more_vertices_and_smaller_eps_are_closer() {
        let pixels = clear_pixels(200);
        let error = |compression| mean_error(&DeepShadowMaps { compression }, &pixels);
        let budgets = [2, 4, 6, 8, 12, 16].map(|vertices| error(Compression::To(vertices)));
        assert!(budgets.is_sorted_by(|a, b| a > b) && budgets[5] < 1e-15, "{budgets:?}");
        let bounds = [0.3, 0.1, 0.03, 0.01, 0.001].map(|eps| error(Compression::Within(eps)));
        assert!(bounds.is_sorted_by(|a, b| a > b) && bounds[4] < 1e-3, "{bounds:?}");
    }

    #[test]
    fn deep_stacks_and_fragments_of_one_label_are_kept() {
        let twins = [
            fragment(2.0, [1.0; 3], 0.5, 7),
            fragment(2.0, [1.0; 3], 0.5, 7),
            fragment(3.0, [1.0; 3], 0.5, 1),
        ];
        let (oracle, map_) = map(Compression::Within(0.0), &twins);
        assert_eq!([2.0, 2.5, 4.0].map(|z| oracle.at(&map_, z)), [1.0, 0.25, 0.125]);
        let stack: Vec<_> =
            (0..10_000_u16).map(|i| fragment(f32::from(i), [1.0; 3], 3e-4, i.into())).collect();
        let (oracle, map) = map(Compression::To(32), &stack);
        let worst =
            stack.iter().map(|f| (oracle.at(&map, f.depth) - exact_power(f.depth)).abs()).fold(0.0, f64::max);
        assert!(map.polyline.len() == 32 && worst < 2e-3, "{worst}");
    }

    fn exact_power(layers: f32) -> f64 {
        (1.0 - f64::from(3e-4_f32)).powf(layers.into())
    }

    #[test]
    fn one_vertex_is_no_polyline() {
        let message = build("deep_shadow_maps", &[("vertices", Input::Int(1))]).err().unwrap().to_string();
        assert!(message.contains("vertices") && message.contains(">= 2"), "{message}");
    }
}
