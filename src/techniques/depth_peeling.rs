//! Depth peeling (Mammen 1989; Everitt 2001): one layer per geometry pass, nearest first.

use crate::continuum::nodes::{Nodes, PEELED};
use crate::continuum::placed::Placed;
use crate::continuum::sums::blend;
use crate::error::Result;
use crate::format::{Format, Formats};
use crate::fragments::{Fragment, List};
use crate::gpu::form::{
    BlendTarget, Ends, Form, Number, Path, Peeling, SHARES, saturated, target_format, window_exponent,
};
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::technique::{
    AnyTechnique, Axes, Cost, DepthComplexity, Info, Pixel, Properties, Resolved, Streamed, Technique,
};
use crate::techniques::ANY_ORDER;
use glam::{DVec3, Vec3};

/// The registry entry.
pub static INFO: Info = Info {
    id: "depth_peeling",
    aliases: &[],
    name: "Depth peeling",
    citation: &["Everitt2001", "Mammen1989"],
    doc: "Draws the geometry once per layer; each pass keeps the nearest fragment behind the previous pass's \
          and puts it under what is there. Exact with as many passes as layers; layers beyond the last pass \
          are missing, and the background shows in their place.",
    axes: Axes {
        memory: "1 layer",
        insertion: "if closest",
        merge: "discard furthest",
        normalize: "no",
        opacity: "either",
    },
    params: &[
        ParamSpec::new(
            "passes",
            Kind::at_least(0),
            Value::Int(0),
            "peeling passes; 0 goes on until a pass writes nothing",
        ),
        ParamSpec::new(
            "early_out",
            Kind::Bool,
            Value::Bool(false),
            "stop a pixel when less than 1/1024 of the light behind it gets through",
        ),
    ],
    targets: &PEELED,
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "passes, at most the largest depth complexity + 1 (the pass that writes nothing)",
    bytes_per_pixel: "two depths and a colour: 24 in f32, 12 in f16, 12 as rgba8 and f32",
    build,
    gpu: Some(gpu),
};

/// Below this transmittance `early_out` stops peeling.
const HARDLY_VISIBLE: f64 = 1.0 / 1024.0;

#[expect(clippy::unnecessary_wraps, reason = "the signature of every technique's build")]
fn build(params: &Params, view: &View) -> Result<Box<dyn AnyTechnique>> {
    let passes = match params.size("passes") {
        0 => usize::MAX,
        passes => passes,
    };
    let enough = if params.bool("early_out") { HARDLY_VISIBLE } else { 0.0 };
    let formats = Formats::from_params(INFO.targets, params);
    let nodes = Nodes::peeled(&formats, view);
    let bytes = nodes.color_bytes + 2.0 * formats.bytes_of("depth");
    let peeling = DepthPeeling { passes, enough, bytes };
    if nodes.are_default {
        return Ok(Box::new(peeling));
    }
    Ok(Box::new(Placed::new(StoredPeeling { peeling, nodes }, nodes.depths)))
}

/// Its form on a GPU: a pass over the geometry per layer, with a depth buffer.
fn gpu(params: &Params, view: &View) -> Result<Form> {
    let formats = Formats::from_params(INFO.targets, params);
    let format = target_format(params, &formats, "color", "color_format", SHARES)?;
    target_format(params, &formats, "depth", "depth_format", &[Format::F32])?;
    let enough = if params.bool("early_out") { HARDLY_VISIBLE } else { 0.0 };
    let passes = params.size("passes");
    let most = if passes > 0 { passes } else { usize::MAX };
    let peeling = Peeling {
        ends: Ends::Nearest,
        peel: "peel",
        composite: "put_under",
        resolve: "resolve",
        sums: vec![BlendTarget::front("color_format", format)],
        passes: (passes > 0).then_some(passes),
    };
    Ok(Form {
        weight: None,
        shader: include_str!("../../shaders/depth_peeling.wgsl"),
        numbers: vec![window_exponent(view), Number::float(enough), saturated(most)],
        path: Path::Peeled(peeling),
        shows_zero_fragments: false,
        colored_transmittance: false,
    })
}

/// Peeling in (depth, primitive) order, so that coincident fragments are peeled one by one.
struct DepthPeeling {
    passes: usize,
    /// Peeling stops once transmittance falls below this.
    enough: f64,
    bytes: f64,
}

impl Technique for DepthPeeling {
    type Scratch = ();
    const NEEDS_SORTED: bool = true;

    /// Pass p finds the smallest (depth, primitive) above pass p − 1's, which is the sorted list's entry p.
    fn resolve(&self, pixel: &Pixel<'_>, (): &mut ()) -> Resolved {
        let layers = pixel.sorted.color.iter().zip(pixel.sorted.alpha);
        let (mut color, mut transmittance) = (DVec3::ZERO, 1.0);
        for (c, &alpha) in layers.take(self.passes) {
            if transmittance < self.enough {
                break;
            }
            color += transmittance * Vec3::from(*c).as_dvec3();
            transmittance *= 1.0 - f64::from(alpha);
        }
        Resolved::new(color + transmittance * pixel.background, transmittance)
    }

    /// Without a limit it is `over`, operation by operation.
    fn streamed(&self) -> Option<Streamed<'_>> {
        (self.passes == usize::MAX && self.enough == 0.0).then_some(Streamed::Over)
    }

    fn transmittance(&self, pixel: &Pixel<'_>, depths: &[f32], (): &mut ()) -> Option<Vec<f64>> {
        let mut behind = vec![1.0];
        for &alpha in pixel.sorted.alpha.iter().take(self.passes) {
            let shown = behind[behind.len() - 1];
            if shown < self.enough {
                break;
            }
            behind.push(shown * (1.0 - f64::from(alpha)));
        }
        let in_front = |&depth: &f32| pixel.sorted.depth.partition_point(|z| *z < depth);
        Some(depths.iter().map(|depth| behind[in_front(depth).min(behind.len() - 1)]).collect())
    }

    #[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
    fn cost(&self, complexity: &DepthComplexity) -> Cost {
        Cost { geometry_passes: self.passes.min(complexity.max + 1) as f64, bytes_per_pixel: self.bytes }
    }

    fn properties(&self) -> Properties {
        if self.passes == usize::MAX && self.enough == 0.0 {
            return Properties::EXACT;
        }
        Properties {
            order_independent: true,
            consistent: self.enough == 0.0,
            exact_for_one: true,
            ..Properties::NONE
        }
    }
}

/// Peeling into a target of another format, which is rounded after every pass.
struct StoredPeeling {
    peeling: DepthPeeling,
    nodes: Nodes,
}

impl StoredPeeling {
    /// Calls `show` with each layer that a pass peels and with what shows in front of it; what shows behind all.
    fn peel(&self, sorted: List<'_>, mut show: impl FnMut(&Fragment, f64)) -> f64 {
        let mut transmittance = 1.0;
        for fragment in sorted.iter().take(self.peeling.passes) {
            if transmittance < self.peeling.enough {
                break;
            }
            show(&fragment, transmittance);
            transmittance = self.nodes.multiply(transmittance, 1.0 - f64::from(fragment.alpha));
        }
        transmittance
    }
}

impl Technique for StoredPeeling {
    type Scratch = ();
    const NEEDS_SORTED: bool = true;

    fn resolve(&self, pixel: &Pixel<'_>, (): &mut ()) -> Resolved {
        let mut color = DVec3::ZERO;
        let transmittance = self.peel(pixel.sorted, |fragment, shown| {
            color = self.nodes.put_under(color, shown, Vec3::from(fragment.color).as_dvec3());
        });
        blend(color, 1.0, transmittance, pixel.background)
    }

    fn transmittance(&self, pixel: &Pixel<'_>, depths: &[f32], (): &mut ()) -> Option<Vec<f64>> {
        let mut in_front = Vec::new();
        let behind = self.peel(pixel.sorted, |_, shown| in_front.push(shown));
        in_front.push(behind);
        let count = |&depth: &f32| pixel.sorted.depth.partition_point(|z| *z < depth);
        Some(depths.iter().map(|depth| in_front[count(depth).min(in_front.len() - 1)]).collect())
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

    #[test]
    fn enough_passes_equal_over() {
        for n in 1..=64 {
            let pixel = random_pixel(n, n.into());
            let (color, transmittance) = over(&pixel);
            for passes in [0, i64::from(n), 1000] {
                let peeled = resolve("depth_peeling", &[("passes", Input::Int(passes))], &pixel);
                assert_close(peeled, color, transmittance, 1e-15);
            }
        }
    }

    #[test]
    fn truncation_shows_background_in_place_of_the_layers_behind() {
        let peeled = resolve("depth_peeling", &[("passes", Input::Int(2))], &three_layers());
        let nearest = [three_layers()[1], three_layers()[0]];
        let (color, transmittance) = over(&nearest);
        assert_close(peeled, color, transmittance, 1e-15);
    }

    #[test]
    fn coincident_fragments_are_all_peeled() {
        let layer = |primitive| fragment(2.0, [0.5, 0.25, 1.0], 0.5, primitive);
        for pixel in [vec![layer(2), layer(1), layer(0)], vec![layer(3); 3]] {
            let peeled = resolve("depth_peeling", &[], &pixel);
            let (color, transmittance) = over(&pixel);
            assert_close(peeled, color, transmittance, 1e-15);
        }
    }

    #[test]
    fn early_out_leaves_less_than_a_thousandth() {
        let pixel: Vec<_> = (0..20).map(|i| fragment(1.0, [1.0; 3], 0.5, i)).collect();
        let peeled = resolve("depth_peeling", &[("early_out", Input::Bool(true))], &pixel);
        assert_eq!(peeled.transmittance.x, 0.5_f64.powi(11));
        assert_close(peeled, over(&pixel).0, 0.0, 1.0 / 1024.0);
    }

    #[test]
    fn steps_are_those_of_the_peeled_layers() {
        let peel = build("depth_peeling", &[("passes", Input::Int(2))]).unwrap();
        let steps = as_pixel(&three_layers(), |pixel| peel.transmittance(pixel, &[2.0, 3.0, 5.0, 9.0]));
        assert_eq!(steps.unwrap(), [1.0, 0.75, 0.375, 0.375]);
    }

    #[test]
    fn ten_thousand_layers() {
        let pixel: Vec<_> = (0..10_000_u16)
            .map(|i| fragment(f32::from(i % 5000), [1.0, 0.5, 0.25], 1e-4, u32::from(i)))
            .collect();
        let (color, transmittance) = over(&pixel);
        assert_close(resolve("depth_peeling", &[], &pixel), color, transmittance, 1e-15);
    }

    #[test]
    fn the_geometry_is_drawn_once_per_layer_and_once_to_find_none_left() {
        let complexity = DepthComplexity { mean: 2.0, max: 7 };
        let passes = |n| {
            build("depth_peeling", &[("passes", Input::Int(n))]).unwrap().cost(&complexity).geometry_passes
        };
        assert_eq!([passes(0), passes(3), passes(100)], [8.0, 3.0, 8.0]);
    }
}
