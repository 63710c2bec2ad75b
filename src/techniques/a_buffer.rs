//! The A-buffer (Carpenter 1984): keep every fragment, sort, composite. The reference, in float64.

use crate::continuum::nodes::{Nodes, bytes_of_sums, sums};
use crate::error::Result;
use crate::format::{Formats, Target};
use crate::fragments::List;
use crate::gpu::form::{Form, MOST_LAYERS, Path, Streaming, at_most, only_single_formats};
use crate::order::sort_key;
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::technique::{
    AnyTechnique, Axes, Cost, DepthComplexity, Info, Pixel, Properties, Resolved, Streamed, Technique,
};
use crate::techniques::ANY_ORDER;
use glam::{DVec3, Vec3};

mod stored;

/// The registry entry.
pub static INFO: Info = Info {
    id: "a_buffer",
    aliases: &["over"],
    name: "A-buffer",
    citation: &["Carpenter1984", "Yang2010"],
    doc: "Keeps every fragment of a pixel, sorts by (depth, primitive) and composites front to back in \
          float64: the exact image. With a capacity it shows what a full linked-list pool loses.",
    axes: Axes {
        memory: "none",
        insertion: "always",
        merge: "no merging",
        normalize: "no",
        opacity: "either",
    },
    params: &[
        ParamSpec::new(
            "overflow",
            Kind::Choice(&["grow", "drop", "tail_blend"]),
            Value::Text("grow"),
            "what happens to fragments beyond the capacity: kept all the same, dropped, or blended by \
             MB13 eq. 5 behind the kept ones",
        ),
        ParamSpec::new(
            "capacity",
            Kind::at_least(0),
            Value::Int(0),
            "fragments kept per pixel in submission order; 0 is unlimited",
        )
        .when(|p| p.text("overflow") != "grow"),
    ],
    targets: &TARGETS,
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "1",
    bytes_per_pixel: "28 n + 4 in f32, 18 n + 4 in f16, 16 n + 4 as rgba8 and an f32 (linked list; n = mean depth complexity)",
    build,
    gpu: Some(gpu),
};

#[expect(clippy::unnecessary_wraps, reason = "the signature of every technique's build")]
fn build(params: &Params, view: &View) -> Result<Box<dyn AnyTechnique>> {
    let capacity = match (params.text("overflow"), params.size("capacity")) {
        ("grow", _) | (_, 0) => usize::MAX,
        (_, capacity) => capacity,
    };
    let blend_tail = params.text("overflow") == "tail_blend";
    let formats = Formats::from_params(INFO.targets, params);
    let nodes = Nodes::new(&formats, view);
    let size = Size { capacity, node: nodes.bytes + LINK, tail: bytes_of_sums(&formats) };
    Ok(match (nodes.are_default, capacity) {
        (false, _) => stored::build(size, blend_tail, nodes, sums(&formats)),
        (true, usize::MAX) => Box::new(ABuffer { size }),
        (true, _) => Box::new(LimitedABuffer { size, blend_tail }),
    })
}

/// Its form on a GPU: exactly as much room as there are fragments, or as there may be, in f32.
fn gpu(params: &Params, _view: &View) -> Result<Form> {
    only_single_formats(params, INFO.targets)?;
    let blends_tail = has_tail(params);
    let capacity = if params.text("overflow") == "grow" { 0 } else { params.size("capacity") };
    let stream = if blends_tail {
        Streaming::as_submitted(params).of_layers(at_most(params, "capacity", MOST_LAYERS)?)
    } else {
        // the shader keeps none of them
        Streaming::nearest_first().of_layers(1)
    };
    let stream = match u32::try_from(capacity) {
        Ok(capacity) if capacity > 0 && !blends_tail => stream.of_fragments(capacity, params),
        // there are never so many
        _ => stream,
    };
    Ok(Form {
        weight: None,
        shader: include_str!("../../shaders/a_buffer.wgsl"),
        numbers: Vec::new(),
        path: Path::Streamed(stream.of_sizes(vec![("BLENDS_TAIL", blends_tail.into())])),
        shows_zero_fragments: false,
        colored_transmittance: false,
    })
}

static TARGETS: [Target; 4] = [
    Target::NODE_COLOR,
    Target::NODE_DEPTH,
    Target::ACCUMULATION.when(has_tail),
    Target::REVEALAGE.when(has_tail),
];

fn has_tail(params: &Params) -> bool {
    params.text("overflow") == "tail_blend" && params.size("capacity") > 0
}

/// Bytes of a node's primitive and of the link to the next node.
const LINK: f64 = 8.0;

/// How much room lists take.
#[derive(Debug, Clone, Copy)]
struct Size {
    /// Nodes per pixel, at most.
    capacity: usize,
    /// Bytes of a node.
    node: f64,
    /// Bytes of the tail.
    tail: f64,
}

impl Size {
    #[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
    fn cost(&self, complexity: &DepthComplexity) -> Cost {
        let nodes = complexity.mean.min(self.capacity as f64);
        Cost { geometry_passes: 1.0, bytes_per_pixel: self.node * nodes + 4.0 + self.tail }
    }
}

/// Front-to-back compositing of sorted fragments (sheet 0.1): colour without background, and transmittance.
fn over(sorted: List<'_>) -> (DVec3, f64) {
    let (mut color, mut transmittance) = (DVec3::ZERO, 1.0);
    for (c, &alpha) in sorted.color.iter().zip(sorted.alpha) {
        color += transmittance * Vec3::from(*c).as_dvec3();
        transmittance *= 1.0 - f64::from(alpha);
    }
    (color, transmittance)
}

/// The A-buffer without a limit.
struct ABuffer {
    size: Size,
}

impl Technique for ABuffer {
    type Scratch = ();
    const NEEDS_SORTED: bool = true;
    const NEEDS_ARRIVAL: bool = false;

    fn resolve(&self, pixel: &Pixel<'_>, (): &mut ()) -> Resolved {
        let (color, transmittance) = over(pixel.sorted);
        Resolved::new(color + transmittance * pixel.background, transmittance)
    }

    fn streamed(&self) -> Option<Streamed<'_>> {
        Some(Streamed::Over)
    }

    fn transmittance(&self, pixel: &Pixel<'_>, depths: &[f32], (): &mut ()) -> Option<Vec<f64>> {
        let list = pixel.sorted;
        let in_front = |&depth: &f32| {
            let count = list.depth.partition_point(|z| *z < depth);
            list.alpha[..count].iter().map(|a| 1.0 - f64::from(*a)).product()
        };
        Some(depths.iter().map(in_front).collect())
    }

    fn cost(&self, complexity: &DepthComplexity) -> Cost {
        self.size.cost(complexity)
    }

    fn properties(&self) -> Properties {
        Properties::EXACT
    }
}

/// The A-buffer whose pixel lists hold `capacity` fragments.
struct LimitedABuffer {
    size: Size,
    blend_tail: bool,
}

impl LimitedABuffer {
    /// MB13 eq. 5 over the background: what lies behind the kept fragments.
    fn tail(&self, list: List<'_>, background: DVec3) -> (DVec3, f64) {
        let (mut color, mut alpha, mut transmittance) = (DVec3::ZERO, 0.0, 1.0);
        if self.blend_tail {
            for f in list.iter().skip(self.size.capacity) {
                color += Vec3::from(f.color).as_dvec3();
                alpha += f64::from(f.alpha);
                transmittance *= 1.0 - f64::from(f.alpha);
            }
        }
        let mean = if alpha > 0.0 { color / alpha } else { DVec3::ZERO };
        ((1.0 - transmittance) * mean + transmittance * background, transmittance)
    }
}

impl Technique for LimitedABuffer {
    type Scratch = Vec<(u64, u32)>;

    #[expect(clippy::cast_possible_truncation, reason = "a pixel's list is far shorter than 2^32")]
    fn resolve(&self, pixel: &Pixel<'_>, order: &mut Self::Scratch) -> Resolved {
        let list = pixel.list;
        let kept = list.len().min(self.size.capacity);
        order.clear();
        order.extend((0..kept).map(|i| (sort_key(list.depth[i], list.primitive[i]), i as u32)));
        order.sort_unstable();
        let (mut color, mut transmittance) = (DVec3::ZERO, 1.0);
        for &(_, i) in order.iter() {
            color += transmittance * Vec3::from(list.color[i as usize]).as_dvec3();
            transmittance *= 1.0 - f64::from(list.alpha[i as usize]);
        }
        let (behind, tail_transmittance) = self.tail(list, pixel.background);
        Resolved {
            dropped: if self.blend_tail { 0 } else { (list.len() - kept) as u64 },
            ..Resolved::new(color + transmittance * behind, transmittance * tail_transmittance)
        }
    }

    fn cost(&self, complexity: &DepthComplexity) -> Cost {
        self.size.cost(complexity)
    }

    fn properties(&self) -> Properties {
        limited(self.blend_tail)
    }
}

/// What a list promises that has no room for all.
fn limited(blend_tail: bool) -> Properties {
    Properties { consistent: true, exact_for_one: true, exact_coverage: blend_tail, ..Properties::NONE }
}

#[cfg(test)]
mod tests {
    use crate::params::Input;
    use crate::techniques::testing::{assert_close, over, resolve, three_layers};
    use glam::DVec3;

    #[test]
    fn three_layers_by_hand() {
        // front to back: 0.25 of (1, .3, .1), 0.375 of (.1, .9, .2), 0.28125 of (.2, .1, 1), 0.09375 of C_0
        let expected = DVec3::new(0.367_187_5, 0.487_5, 0.451_562_5);
        let got = resolve("a_buffer", &[], &three_layers());
        assert_close(got, expected, 0.093_75, 1e-7);
    }

    #[test]
    fn equals_the_definition_in_any_order_and_on_ties() {
        let mut fragments = three_layers();
        fragments[0].depth = fragments[1].depth;
        let (color, transmittance) = over(&fragments);
        assert_close(resolve("over", &[], &fragments), color, transmittance, 1e-15);
        fragments.reverse();
        assert_close(resolve("a_buffer", &[], &fragments), color, transmittance, 1e-15);
    }

    #[test]
    fn a_full_list_drops_late_fragments_and_counts_them() {
        let fragments = three_layers();
        let params = [("overflow", Input::Text("drop".into())), ("capacity", Input::Int(2))];
        let got = resolve("a_buffer", &params, &fragments);
        let (color, transmittance) = over(&fragments[..2]);
        assert_close(got, color, transmittance, 1e-15);
        assert_eq!(got.dropped, 1);
    }

    #[test]
    fn a_blended_tail_keeps_the_coverage() {
        let fragments = three_layers();
        let params = [("overflow", Input::Text("tail_blend".into())), ("capacity", Input::Int(2))];
        let got = resolve("a_buffer", &params, &fragments);
        let (color, transmittance) = over(&fragments); // the one tail fragment is also the farthest
        assert_close(got, color, transmittance, 1e-7);
        assert_eq!(got.dropped, 0);
    }
}
