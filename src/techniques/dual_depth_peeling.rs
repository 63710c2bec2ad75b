//! Dual depth peeling (Bavoil & Myers 2008): the nearest and the furthest layer in every geometry pass.

use crate::continuum::nodes::{Nodes, PEELED};
use crate::continuum::placed::Placed;
use crate::continuum::sums::blend;
use crate::error::Result;
use crate::format::{Format, Formats};
use crate::fragments::Fragment;
use crate::gpu::form::{BlendTarget, Ends, Form, Path, Peeling, Streaming, only_default_formats, saturated};
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::technique::{
    AnyTechnique, Axes, Cost, DepthComplexity, Info, Pixel, Properties, Resolved, Technique,
};
use crate::techniques::ANY_ORDER;
use glam::{DVec3, Vec3};

/// The registry entry.
pub static INFO: Info = Info {
    id: "dual_depth_peeling",
    aliases: &[],
    name: "Dual depth peeling",
    citation: &["Bavoil2008"],
    doc: "Each pass peels the nearest remaining layer under the front and the furthest over the back, so that \
          half as many passes as in depth peeling see all. When stopped early, the layers in the middle are \
          missing.",
    axes: Axes {
        memory: "2 layers",
        insertion: "if closest or furthest",
        merge: "discard between",
        normalize: "no",
        opacity: "either",
    },
    params: &[ParamSpec::new(
        "passes",
        Kind::at_least(0),
        Value::Int(0),
        "peeling passes after the one that finds the first depths; 0 goes on until nothing is left",
    )],
    targets: &PEELED,
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "1 + passes, at most 1 + ceil(n / 2) (n = largest depth complexity)",
    bytes_per_pixel: "two depth pairs, two front colours and a back colour: 64 in f32, 32 in f16, 28 as rgba8 and f32",
    build,
    gpu: Some(gpu),
};

fn build(params: &Params, view: &View) -> Result<Box<dyn AnyTechnique>> {
    let passes = match params.size("passes") {
        0 => usize::MAX,
        passes => passes,
    };
    let formats = Formats::from_params(INFO.targets, params);
    let nodes = Nodes::peeled(&formats, view);
    let bytes = 3.0 * nodes.color_bytes + 4.0 * formats.bytes_of("depth");
    let peeling = DualDepthPeeling { passes, bytes };
    if nodes.are_default {
        return Ok(Box::new(peeling));
    }
    Ok(Box::new(Placed::new(StoredDualPeeling { peeling, nodes }, nodes.depths)))
}

/// Its form on a GPU: as published, where it goes on until nothing is left; a stream, where passes are limited, since how many
/// of the fragments at one depth are within the limit is nothing that a blend unit could know.
fn gpu(params: &Params, _view: &View) -> Result<Form> {
    only_default_formats(params, INFO.targets)?;
    let passes = params.size("passes");
    let path = if passes == 0 {
        Path::Peeled(Peeling {
            ends: Ends::Both,
            peel: "peel",
            composite: "put_over",
            resolve: "resolve",
            sums: vec![
                BlendTarget::front("color_format", Format::F32),
                BlendTarget::back("color_format", Format::F32),
            ],
            passes: None,
        })
    } else {
        Path::Streamed(Streaming::nearest_first().in_walks())
    };
    Ok(Form {
        weight: None,
        shader: include_str!("../../shaders/dual_depth_peeling.wgsl"),
        numbers: vec![saturated(if passes == 0 { usize::MAX } else { passes })],
        path,
        shows_zero_fragments: false,
        colored_transmittance: false,
    })
}

struct DualDepthPeeling {
    passes: usize,
    bytes: f64,
}

/// Premultiplied colour and what shows through it.
#[derive(Debug, Clone, Copy)]
struct Side {
    color: DVec3,
    transmittance: f64,
}

impl Side {
    const CLEAR: Self = Self { color: DVec3::ZERO, transmittance: 1.0 };

    fn of(fragment: &Fragment) -> Self {
        Self { color: Vec3::from(fragment.color).as_dvec3(), transmittance: 1.0 - f64::from(fragment.alpha) }
    }
    fn over(self, behind: Self) -> Self {
        Self {
            color: self.color + self.transmittance * behind.color,
            transmittance: self.transmittance * behind.transmittance,
        }
    }
}

impl DualDepthPeeling {
    /// How many of `n` layers are peeled from the front and from the back. The middle one of an odd number is
    /// nearest and furthest at once, and goes to the front.
    fn peeled(&self, n: usize) -> (usize, usize) {
        let front = self.passes.min(n.div_ceil(2));
        (front, self.passes.min(n - front))
    }
}

impl Technique for DualDepthPeeling {
    type Scratch = ();
    const NEEDS_SORTED: bool = true;
    const NEEDS_ARRIVAL: bool = false;

    /// Pass p finds the places p and n − 1 − p of the sorted list.
    fn resolve(&self, pixel: &Pixel<'_>, (): &mut ()) -> Resolved {
        let sorted = pixel.sorted;
        let n = sorted.len();
        let (from_front, from_back) = self.peeled(n);
        let (mut front, mut back) = (Side::CLEAR, Side::CLEAR);
        for i in 0..from_front {
            front = front.over(Side::of(&sorted.get(i)));
        }
        for i in (n - from_back..n).rev() {
            back = Side::of(&sorted.get(i)).over(back);
        }
        let all = front.over(back);
        Resolved::new(all.color + all.transmittance * pixel.background, all.transmittance)
    }

    fn transmittance(&self, pixel: &Pixel<'_>, depths: &[f32], (): &mut ()) -> Option<Vec<f64>> {
        let sorted = pixel.sorted;
        let (from_front, from_back) = self.peeled(sorted.len());
        let peeled = |i: &usize| *i < from_front || sorted.len() - i <= from_back;
        let in_front = |&depth: &f32| {
            let count = sorted.depth.partition_point(|z| *z < depth);
            (0..count).filter(peeled).map(|i| 1.0 - f64::from(sorted.alpha[i])).product()
        };
        Some(depths.iter().map(in_front).collect())
    }

    #[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
    fn cost(&self, complexity: &DepthComplexity) -> Cost {
        let peeling = self.passes.min(complexity.max.div_ceil(2));
        Cost { geometry_passes: 1.0 + peeling as f64, bytes_per_pixel: self.bytes }
    }

    fn properties(&self) -> Properties {
        if self.passes == usize::MAX {
            return Properties::EXACT;
        }
        Properties { order_independent: true, consistent: true, exact_for_one: true, ..Properties::NONE }
    }
}

/// Peeling into targets of another format, which are rounded after every pass.
struct StoredDualPeeling {
    peeling: DualDepthPeeling,
    nodes: Nodes,
}

impl StoredDualPeeling {
    /// `F += (1 − A) C`, `A += (1 − A) a`.
    fn under(&self, front: Side, fragment: &Fragment) -> Side {
        let color = Vec3::from(fragment.color).as_dvec3();
        Side {
            color: self.nodes.put_under(front.color, front.transmittance, color),
            transmittance: self.nodes.cover(front.transmittance, fragment.alpha.into()),
        }
    }

    /// `B = C + (1 − a) B`, with what shows through the back beside.
    fn over(&self, fragment: &Fragment, back: Side) -> Side {
        let Side { color, transmittance } = Side::of(fragment);
        Side {
            color: self.nodes.put_over(color, transmittance, back.color),
            transmittance: self.nodes.multiply(back.transmittance, transmittance),
        }
    }
}

impl Technique for StoredDualPeeling {
    type Scratch = ();
    const NEEDS_SORTED: bool = true;
    const NEEDS_ARRIVAL: bool = false;

    fn resolve(&self, pixel: &Pixel<'_>, (): &mut ()) -> Resolved {
        let (sorted, n) = (pixel.sorted, pixel.sorted.len());
        let (from_front, from_back) = self.peeling.peeled(n);
        let front = (0..from_front).fold(Side::CLEAR, |front, i| self.under(front, &sorted.get(i)));
        let back = (n - from_back..n).rev().fold(Side::CLEAR, |back, i| self.over(&sorted.get(i), back));
        let all = front.over(back);
        blend(all.color, 1.0, all.transmittance, pixel.background)
    }

    /// Of the layers as they are: the targets have none in the middle.
    fn transmittance(&self, pixel: &Pixel<'_>, depths: &[f32], (): &mut ()) -> Option<Vec<f64>> {
        Technique::transmittance(&self.peeling, pixel, depths, &mut ())
    }

    fn cost(&self, complexity: &DepthComplexity) -> Cost {
        Technique::cost(&self.peeling, complexity)
    }

    fn properties(&self) -> Properties {
        self.nodes.promises(Technique::properties(&self.peeling))
    }
}

#[cfg(test)]
mod tests {
    use crate::params::Input;
    use crate::technique::DepthComplexity;
    use crate::techniques::testing::{
        as_pixel, assert_close, build, fragment, over, random_pixel, resolve, three_layers,
    };

    /// Another association of the same f64 products.
    const F64_ROUNDING: f64 = 1e-14;

    #[test]
    fn enough_passes_equal_depth_peeling() {
        for n in 1..=64 {
            let pixel = random_pixel(n, n.into());
            let peeled = resolve("depth_peeling", &[], &pixel);
            for passes in [0, i64::from(n.div_ceil(2)), 1000] {
                let dual = resolve("dual_depth_peeling", &[("passes", Input::Int(passes))], &pixel);
                assert_close(dual, peeled.color, peeled.transmittance.x, F64_ROUNDING);
            }
        }
    }

    #[test]
    fn truncation_loses_the_middle() {
        let mut pixel = three_layers();
        pixel.push(fragment(6.0, [0.5; 3], 0.5, 3));
        let one = resolve("dual_depth_peeling", &[("passes", Input::Int(1))], &pixel);
        let (color, transmittance) = over(&[pixel[1], pixel[2]]);
        assert_close(one, color, transmittance, F64_ROUNDING);
    }

    #[test]
    fn a_middle_layer_is_peeled_once() {
        let pixel = three_layers();
        let (color, transmittance) = over(&pixel);
        let two = [("passes", Input::Int(2))];
        assert_close(resolve("dual_depth_peeling", &two, &pixel), color, transmittance, F64_ROUNDING);
        let (color, transmittance) = over(&pixel[..1]);
        assert_close(resolve("dual_depth_peeling", &two, &pixel[..1]), color, transmittance, 0.0);
    }

    #[test]
    fn coincident_fragments_are_all_peeled() {
        for keys in [[3, 2, 1, 0], [5; 4]] {
            let pixel = keys.map(|key| fragment(2.0, [0.5, 0.25, 1.0], 0.5, key));
            let (color, transmittance) = over(&pixel);
            assert_close(resolve("dual_depth_peeling", &[], &pixel), color, transmittance, F64_ROUNDING);
        }
    }

    #[test]
    fn steps_are_those_of_the_peeled_layers() {
        let dual = build("dual_depth_peeling", &[("passes", Input::Int(1))]).unwrap();
        let steps = as_pixel(&three_layers(), |pixel| dual.transmittance(pixel, &[2.0, 3.0, 5.0, 9.0]));
        assert_eq!(steps.unwrap(), [1.0, 0.75, 0.75, 0.1875]);
    }

    #[test]
    fn half_as_many_passes_as_layers_and_one_to_begin_with() {
        let complexity = DepthComplexity { mean: 2.0, max: 7 };
        let passes = |n| {
            let dual = build("dual_depth_peeling", &[("passes", Input::Int(n))]).unwrap();
            dual.cost(&complexity).geometry_passes
        };
        assert_eq!([passes(0), passes(3), passes(100)], [5.0, 4.0, 5.0]);
    }
}
