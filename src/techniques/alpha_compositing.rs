//! Alpha compositing (Porter & Duff 1984): the blend unit's `over`, in submission order.

use crate::diagnosis::{Diagnosis, Fault, Faults, rounding};
use crate::error::Result;
use crate::format::{Format, Formats, Target};
use crate::fragments::List;
use crate::gpu::form::{Blend, BlendTarget, Blending, Form, Path, target_format};
use crate::params::{Params, View};
use crate::technique::{
    AnyTechnique, Axes, Cost, DepthComplexity, Info, Pixel, Properties, Resolved, Streamed, Technique,
};
use crate::techniques::ANY_ORDER;
use glam::{DVec3, Vec3};

/// The registry entry.
pub static INFO: Info = Info {
    id: "alpha_compositing",
    aliases: &[],
    name: "Alpha compositing",
    citation: &["Porter1984"],
    doc: "Blends each fragment over what is already there, in submission order: right where that order is \
          back to front, and what an engine gets when it does not sort.",
    axes: Axes {
        memory: "1 layer",
        insertion: "always",
        merge: "over operator",
        normalize: "no",
        opacity: "alpha",
    },
    params: &[],
    targets: &[Target::COLOR],
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "1",
    bytes_per_pixel: "a framebuffer: 16 in f32, 8 in f16, 4 in 8 bits",
    build,
    gpu: Some(gpu),
};

#[expect(clippy::unnecessary_wraps, reason = "the signature of every technique's build")]
fn build(params: &Params, _view: &View) -> Result<Box<dyn AnyTechnique>> {
    let properties = match params.text("submission_order") {
        "back_to_front" => Properties::EXACT,
        _ => EXACT_COVERAGE,
    };
    Ok(composite(properties, &Formats::from_params(INFO.targets, params)))
}

/// Its form on a GPU: the fixed-function blend unit.
fn gpu(params: &Params, _view: &View) -> Result<Form> {
    gpu_composite(params, &Formats::from_params(INFO.targets, params))
}

/// Alpha compositing in these formats on a GPU.
pub(super) fn gpu_composite(params: &Params, formats: &Formats) -> Result<Form> {
    const COLORS: &[Format] = &[Format::F32, Format::F16, Format::Unorm8, Format::Unorm16, Format::Srgb8];
    let format = target_format(params, formats, "color", "color_format", COLORS)?;
    let color =
        BlendTarget { color: Blend::Over, ..BlendTarget::sums("color_format", format, 4).with_share() };
    let blending = if formats.are_default() {
        Blending::once("composite", "add_background", vec![color])
    } else {
        // what is left of the background is nobody's business but ours
        let share = BlendTarget::product("color_format", Format::F32, 1, Blend::Attenuate);
        let targets = vec![color, share];
        let once = Blending::once("composite_over_background", "read_framebuffer", targets);
        Blending { over_background: true, ..once }
    };
    Ok(Form {
        shader: include_str!("../../shaders/alpha_compositing.wgsl"),
        numbers: Vec::new(),
        weight: None,
        path: Path::Blended(blending),
        shows_zero_fragments: false,
        colored_transmittance: false,
    })
}

/// Alpha compositing in these formats.
pub(super) fn composite(properties: Properties, formats: &Formats) -> Box<dyn AnyTechnique> {
    if formats.are_default() {
        return Box::new(AlphaCompositing { properties });
    }
    Box::new(Framebuffer { format: formats.of("color"), bytes: formats.bytes_per_pixel(), properties })
}

/// What holds in any order: the factors of Π (1 − a) commute, and so do layers of one colour.
pub(super) const EXACT_COVERAGE: Properties =
    Properties { exact_for_one: true, exact_for_one_color: true, exact_coverage: true, ..Properties::NONE };

/// `dst ← C + (1 − a) dst`.
pub(super) struct AlphaCompositing {
    /// They follow from the submission order.
    pub properties: Properties,
}

impl Technique for AlphaCompositing {
    type Scratch = ();

    fn resolve(&self, pixel: &Pixel<'_>, (): &mut ()) -> Resolved {
        let (mut target, mut transmittance) = (Vec3::ZERO, 1.0);
        for (c, &alpha) in pixel.list.color.iter().zip(pixel.list.alpha) {
            target = (Vec3::from(*c) + (1.0 - alpha) * target).min(Vec3::MAX);
            transmittance *= 1.0 - f64::from(alpha);
        }
        let color: DVec3 = target.as_dvec3() + transmittance * pixel.background;
        Resolved::new(color, transmittance)
    }

    fn streamed(&self) -> Option<Streamed<'_>> {
        Some(Streamed::Blend)
    }

    fn cost(&self, _complexity: &DepthComplexity) -> Cost {
        Cost { geometry_passes: 1.0, bytes_per_pixel: 16.0 }
    }

    fn faults(&self) -> Faults {
        faults(Format::F32)
    }

    fn diagnose(&self, pixel: &Pixel<'_>, (): &mut ()) -> Diagnosis {
        diagnose(Format::F32, [0.0; 3], pixel.list)
    }

    fn properties(&self) -> Properties {
        self.properties
    }
}

/// `dst ← C + (1 − a) dst` in a framebuffer of another format, which holds the background at first.
struct Framebuffer {
    format: Format,
    bytes: f64,
    properties: Properties,
}

/// The factor of what is behind: float32 but where nothing is rounded to less.
fn behind(format: Format, alpha: f32) -> f64 {
    if format == Format::F64 { 1.0 - f64::from(alpha) } else { f64::from(1.0 - alpha) }
}

fn blend(format: Format, target: &mut [f64; 3], color: [f32; 3], alpha: f32) {
    for (stored, source) in target.iter_mut().zip(color) {
        *stored = format.blend(*stored, behind(format, alpha), source.into());
    }
    format.round_texel(target);
}

/// What can go wrong in a framebuffer of that format.
fn faults(format: Format) -> Faults {
    Faults::of_format(format).and(&[Fault::Stagnation])
}

/// What goes wrong in one.
fn diagnose(format: Format, mut target: [f64; 3], list: List<'_>) -> Diagnosis {
    /// Changes so much smaller than what is there are none: a layer of the colour that it covers makes no other.
    const NO_CHANGE: f64 = 1e-12;
    let mut found = Diagnosis::CLEAR;
    for (&color, &alpha) in list.color.iter().zip(list.alpha) {
        let before = target;
        blend(format, &mut target, color, alpha);
        let channels = before.into_iter().zip(target).zip(color);
        let befell = channels.fold(Faults::NONE, |faults, ((before, after), source)| {
            if !before.is_finite() {
                return faults;
            }
            let exact = before * behind(format, alpha) + f64::from(source);
            let stuck = before == after && before != 0.0 && (exact - before).abs() > NO_CHANGE * before;
            let rounded = rounding(format, exact, after);
            // what meets the end of a format is not too small to be seen
            let stagnates = stuck && !rounded.has(Fault::Saturation);
            faults.union(if stagnates { rounded.and(&[Fault::Stagnation]) } else { rounded })
        });
        found.count_all(befell);
    }
    target.iter().filter(|x| !x.is_finite()).for_each(|_| found.count(Fault::NonFinite));
    found
}

impl Technique for Framebuffer {
    type Scratch = ();

    fn resolve(&self, pixel: &Pixel<'_>, (): &mut ()) -> Resolved {
        let format = self.format;
        let (mut target, mut transmittance) = (pixel.background.to_array(), 1.0);
        format.round_texel(&mut target);
        for (&color, &alpha) in pixel.list.color.iter().zip(pixel.list.alpha) {
            blend(format, &mut target, color, alpha);
            transmittance *= 1.0 - f64::from(alpha);
        }
        let largest = DVec3::splat(f32::MAX.into());
        Resolved::new(DVec3::from(format.read_texel(target)).min(largest), transmittance)
    }

    fn cost(&self, _complexity: &DepthComplexity) -> Cost {
        Cost { geometry_passes: 1.0, bytes_per_pixel: self.bytes }
    }

    fn faults(&self) -> Faults {
        faults(self.format)
    }

    fn diagnose(&self, pixel: &Pixel<'_>, (): &mut ()) -> Diagnosis {
        let mut background = pixel.background.to_array();
        self.format.round_texel(&mut background);
        diagnose(self.format, background, pixel.list)
    }

    fn properties(&self) -> Properties {
        let exact = matches!(self.format, Format::F64 | Format::F32);
        if exact {
            return self.properties;
        }
        let Properties { order_independent, exact_coverage, .. } = self.properties;
        Properties { order_independent, exact_coverage, ..Properties::NONE }
    }
}

#[cfg(test)]
mod tests {
    use crate::diagnosis::Fault;
    use crate::fragments::Fragment;
    use crate::params::Input;
    use crate::techniques::testing::{
        F32_STATE, as_pixel, assert_close, build, fragment, over, resolve, three_layers,
    };
    use glam::DVec3;

    #[test]
    fn three_layers_by_hand() {
        // submitted at depths 4, 2, 8: the last one lies on top
        let expected = DVec3::new(0.75 * 0.2, 0.75 * 0.1, 0.75)
            + 0.25 * DVec3::new(0.25, 0.075, 0.025)
            + 0.187_5 * DVec3::new(0.05, 0.45, 0.1)
            + 0.093_75 * DVec3::new(0.25, 0.5, 0.75);
        assert_close(resolve("alpha_compositing", &[], &three_layers()), expected, 0.093_75, F32_STATE);
    }

    #[test]
    fn what_overflows_can_still_be_hidden() {
        let bright = Fragment { alpha: 0.0, ..fragment(1.0, [f32::MAX; 3], 1.0, 0) };
        let pixel = [bright, bright, bright, fragment(1.0, [0.5; 3], 1.0, 1)];
        assert_close(resolve("alpha_compositing", &[], &pixel), DVec3::splat(0.5), 0.0, 0.0);
    }

    fn in_format(format: &str, pixel: &[Fragment]) -> DVec3 {
        resolve("alpha_compositing", &[("format", Input::Text(format.into()))], pixel).color
    }

    /// The background goes into the framebuffer first; each blend is rounded to a step.
    #[test]
    fn eight_bits_by_hand() {
        let layers = [fragment(2.0, [1.0, 0.5, 0.0], 0.5, 0), fragment(1.0, [0.25; 3], 0.25, 1)];
        let step = |x: f64| (x * 255.0).round_ties_even() / 255.0;
        let stored = [(0.25, 1.0), (0.5, 0.5), (0.75, 0.0)].map(|(background, c)| {
            // in whole steps, one of which is a tie
            let first = (0.5 * step(background) * 255.0 + 127.5 * c).round_ties_even() / 255.0;
            step(0.75 * first + 0.0625)
        });
        assert_eq!(in_format("unorm8", &layers), DVec3::from(stored));
    }

    /// What is fainter than half a step changes nothing, however often it is blended.
    #[test]
    fn eight_bits_do_not_see_faint_layers() {
        let mut faint: Vec<_> = (0..1000).map(|i| fragment(1.0, [1.0; 3], 1.0 / 520.0, i)).collect();
        faint[0] = fragment(1.0, [0.0; 3], 1.0, 0);
        assert_eq!(in_format("unorm8", &faint), DVec3::ZERO);
        // where it is dark encoded steps are finer
        assert!(in_format("srgb8", &faint).x > 0.1);
        assert!((in_format("f32", &faint) - in_format("f64", &faint)).abs().max_element() < 1e-4);
    }

    #[test]
    fn wide_framebuffers_are_over_back_to_front() {
        let (color, transmittance) = over(&three_layers());
        for (format, tolerance) in
            [("f64", 1e-15), ("f16", 1e-3), ("bf16", 8e-3), ("rgb9e5", 4e-3), ("r11g11b10f", 0.03)]
        {
            let params = [
                ("format", Input::Text(format.into())),
                ("submission_order", Input::Text("back_to_front".into())),
            ];
            assert_close(
                resolve("alpha_compositing", &params, &three_layers()),
                color,
                transmittance,
                tolerance,
            );
        }
    }

    #[test]
    fn equals_over_back_to_front_and_the_worst_case_front_to_back() {
        let fragments = three_layers();
        let (color, transmittance) = over(&fragments);
        let order = |name: &str| [("submission_order", Input::Text(name.into()))];
        let sorted = resolve("alpha_compositing", &order("back_to_front"), &fragments);
        assert_close(sorted, color, transmittance, F32_STATE);
        let worst = resolve("alpha_compositing", &order("sorted"), &fragments);
        assert!((worst.color - color).abs().max_element() > 0.3, "{worst:?}");
    }

    /// A faint layer over white changes 8 bits by less than half a step; one of 7e4 is no half; 1.5 is beyond 8 bits.
    #[test]
    fn diagnoses_by_hand() {
        let found = |format: &str, pixel: &[Fragment]| {
            let technique = build("alpha_compositing", &[("format", Input::Text(format.into()))]).unwrap();
            let diagnosis = as_pixel(pixel, |pixel| technique.diagnose(pixel));
            let amounts = technique.faults().iter().map(|fault| (fault, diagnosis.amount(fault)));
            amounts.filter(|(_, amount)| *amount > 0.0).collect::<Vec<_>>()
        };
        let white = fragment(5.0, [1.0; 3], 1.0, 0);
        let faint = fragment(4.0, [0.0; 3], 1.0 / 512.0, 1);
        assert_eq!(found("unorm8", &[white, faint, faint]), [(Fault::Stagnation, 2.0)]);
        assert_eq!(found("f16", &[white, faint, faint]), []);
        let bright = fragment(5.0, [7e4, 1.0, 1.0], 1.0, 0);
        assert_eq!(found("f16", &[bright, faint]), [(Fault::Overflow, 1.0), (Fault::NonFinite, 1.0)]);
        assert_eq!(found("f32", &[bright, faint]), []);
        assert_eq!(found("unorm8", &[fragment(5.0, [1.5; 3], 1.0, 0)]), [(Fault::Saturation, 1.0)]);
        assert_eq!(found("unorm8", &[white, white]), []);
    }
}
