//! Screen-door transparency (Fuchs et al. 1985) by alpha to coverage: the same samples for the same alpha.

use crate::continuum::door::Thresholds;
use crate::continuum::nodes::{AsTheyAre, Keep, Nodes, SAMPLES};
use crate::continuum::placed::Placed;
use crate::continuum::samples::{Shown, uncovered, unmultiplied};
use crate::continuum::steps::Steps;
use crate::diagnosis::{Diagnosis, Faults};
use crate::error::Result;
use crate::fragments::{Fragment, List};
use crate::gpu::form::{Form, Number, Path, Streaming, at_most, only_single_formats};
use crate::order::sort_key;
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::technique::{
    AnyTechnique, Axes, Cost, DepthComplexity, Info, Pixel, Properties, Resolved, Technique,
};
use crate::techniques::ANY_ORDER;

/// The registry entry.
pub static INFO: Info = Info {
    id: "screen_door",
    aliases: &[],
    name: "Screen-door transparency",
    citation: &["Fuchs1985", "Mulder1998"],
    doc: "A fragment covers those of a pixel's samples whose fixed threshold its alpha exceeds, and each sample \
          shows its nearest fragment. Masks are nested, so of two layers of one alpha the nearer hides the \
          other altogether, however many samples there are.",
    axes: Axes {
        memory: "k z-samples",
        insertion: "always",
        merge: "z-test, discard occluded",
        normalize: "no",
        opacity: "coverage",
    },
    params: &[ParamSpec::new(
        "samples",
        Kind::at_least(1),
        Value::Int(16),
        "depth and colour samples per pixel",
    )],
    targets: &SAMPLES,
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "1",
    bytes_per_pixel: "20 samples in f32 (a depth and a colour each), 10 in f16, 8 as rgb8 and an f32",
    build,
    gpu: Some(gpu),
};

fn build(params: &Params, view: &View) -> Result<Box<dyn AnyTechnique>> {
    let nodes = Nodes::from_params(INFO.targets, params, view);
    let thresholds = Thresholds { samples: params.size("samples") };
    let bytes = nodes.bytes;
    if nodes.are_default {
        return Ok(Box::new(ScreenDoor { thresholds, colors: AsTheyAre, bytes }));
    }
    Ok(Box::new(Placed::new(ScreenDoor { thresholds, colors: nodes, bytes }, nodes.depths)))
}

/// Its form on a GPU, with nodes in f32.
fn gpu(params: &Params, _view: &View) -> Result<Form> {
    only_single_formats(params, INFO.targets)?;
    Ok(Form {
        weight: None,
        shader: include_str!("../../shaders/screen_door.wgsl"),
        numbers: vec![Number::Whole(at_most(params, "samples", MOST_SAMPLES)?)],
        path: Path::Streamed(Streaming::nearest_first()),
        shows_zero_fragments: false,
        colored_transmittance: false,
    })
}

/// So many are counted without rounding.
const MOST_SAMPLES: u32 = 1 << 24;

struct ScreenDoor<K> {
    thresholds: Thresholds,
    colors: K,
    /// Of a sample.
    bytes: f64,
}

impl<K> ScreenDoor<K> {
    /// Calls `show` with every fragment that some sample shows, nearest first, with how many do and how many
    /// are covered then. A fragment that covers more samples than those in front shows in the surplus.
    fn each_shown(&self, sorted: List<'_>, mut show: impl FnMut(&Fragment, usize, usize)) {
        let mut covered = 0;
        for fragment in sorted.iter() {
            let coverage = self.thresholds.coverage(fragment.alpha);
            if coverage > covered {
                show(&fragment, coverage - covered, coverage);
                covered = coverage;
            }
        }
    }
}

impl<K: Keep> Technique for ScreenDoor<K> {
    type Scratch = ();
    const NEEDS_SORTED: bool = true;

    fn resolve(&self, pixel: &Pixel<'_>, (): &mut ()) -> Resolved {
        let mut shown = Shown::BACKGROUND;
        self.each_shown(pixel.sorted, |fragment, visible, _| {
            shown.add(visible, self.colors.keep(unmultiplied(fragment)));
        });
        shown.over(self.thresholds.samples, pixel.background)
    }

    fn transmittance(&self, pixel: &Pixel<'_>, depths: &[f32], (): &mut ()) -> Option<Vec<f64>> {
        let mut steps = Steps::default();
        self.each_shown(pixel.sorted, |fragment, _, covered| {
            steps.push(
                sort_key(fragment.depth, fragment.primitive),
                uncovered(covered, self.thresholds.samples),
            );
        });
        Some(depths.iter().map(|&depth| steps.at(depth)).collect())
    }

    fn faults(&self) -> Faults {
        self.colors.faults()
    }

    fn diagnose(&self, pixel: &Pixel<'_>, (): &mut ()) -> Diagnosis {
        let mut found = Diagnosis::CLEAR;
        self.each_shown(pixel.sorted, |fragment, _, _| {
            found.count_all(self.colors.written(unmultiplied(fragment)));
        });
        found
    }

    fn cost(&self, _complexity: &DepthComplexity) -> Cost {
        Cost::list(self.thresholds.samples, self.bytes, 0.0)
    }

    fn properties(&self) -> Properties {
        Properties { order_independent: true, ..Properties::NONE }
    }
}

#[cfg(test)]
mod tests {
    use crate::params::Input;
    use crate::technique::Resolved;
    use crate::techniques::testing::{
        BACKGROUND, as_pixel, assert_close, build, fragment, over, random_pixel, resolve, three_layers,
    };
    use glam::{DVec3, Vec3};

    /// Rounding of u = C / a, with C and a rounded to f32.
    const UNMULTIPLIED: f64 = 1e-6;

    fn screen_door(samples: i64, pixel: &[crate::fragments::Fragment]) -> Resolved {
        resolve("screen_door", &[("samples", Input::Int(samples))], pixel)
    }

    #[test]
    fn three_layers_by_hand() {
        // alphas .25, .5, .75 from the front: four samples each, on top of the nearer ones
        let [middle, front, back] = [[0.1, 0.9, 0.2], [1.0, 0.3, 0.1], [0.2, 0.1, 1.0]].map(DVec3::from);
        let expected = 0.25 * (front + middle + back + Vec3::from(BACKGROUND).as_dvec3());
        assert_close(screen_door(16, &three_layers()), expected, 0.25, UNMULTIPLIED);
    }

    #[test]
    fn of_two_equal_layers_the_nearer_one_shows() {
        let (front, behind) = ([0.9, 0.2, 0.5], [0.1, 0.8, 0.3]);
        for samples in [1, 2, 7, 16, 64, 1000] {
            for percent in 1..100_u8 {
                let alpha = f32::from(percent) / 100.0;
                let pixel = [fragment(3.0, behind, alpha, 0), fragment(2.0, front, alpha, 1)];
                let got = screen_door(samples, &pixel);
                let shown = 1.0 - got.transmittance.x;
                #[expect(clippy::cast_precision_loss, reason = "small")]
                let rounding = 0.5 / samples as f64 + 1e-15;
                assert!((shown - f64::from(alpha)).abs() <= rounding, "{samples} {alpha}: {shown}");
                let colors = [DVec3::from(front.map(f64::from)), Vec3::from(BACKGROUND).as_dvec3()];
                let expected = shown * colors[0] + (1.0 - shown) * colors[1];
                assert_close(got, expected, 1.0 - shown, UNMULTIPLIED);
            }
        }
    }

    #[test]
    fn the_background_shows_where_the_largest_alpha_leaves_it() {
        for n in 1..40 {
            let mut pixel = random_pixel(n, n.into());
            pixel.iter_mut().for_each(|f| f.alpha *= 0.9);
            let most = pixel.iter().map(|f| f64::from(f.alpha)).fold(0.0, f64::max);
            let shown = screen_door(100_000, &pixel).transmittance.x;
            assert!((shown - (1.0 - most)).abs() <= 0.5e-5 + 1e-15, "{shown} {most}");
        }
    }

    #[test]
    fn opaque_fragments_are_exact() {
        let mut pixel = random_pixel(20, 3);
        for f in &mut pixel {
            *f = fragment(f.depth, f.color, 1.0, f.primitive);
        }
        let (color, transmittance) = over(&pixel);
        assert_close(screen_door(16, &pixel), color, transmittance, 1e-15);
    }

    #[test]
    fn the_transmittance_has_a_step_where_more_samples_are_covered() {
        let technique = build("screen_door", &[]).unwrap();
        let depths = [2.0, 3.0, 4.0, 5.0, 9.0];
        let steps = as_pixel(&three_layers(), |pixel| technique.transmittance(pixel, &depths));
        assert_eq!(steps.unwrap(), [1.0, 0.75, 0.75, 0.5, 0.25]);
    }
}
