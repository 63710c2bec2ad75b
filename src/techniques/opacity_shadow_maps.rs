//! Opacity shadow maps (Kim & Neumann 2001): absorbance summed in depth bins.

use crate::continuum::absorbance::{
    S_MAX, SELF_CORRECT, absorbance, absorbances, transmittance, transmittances,
};
use crate::continuum::binned::BinnedAbsorbance;
use crate::continuum::oracle::{CHUNK, Composite, Oracle, chunks, see_one};
use crate::continuum::range::{DepthRange, Interval, cell};
use crate::continuum::stored_oracle::{BINS, StoredOracle, technique};
use crate::continuum::two_pass_form::{Own, two_pass_form};
use crate::error::Result;
use crate::format::{Formats, SUMMATION, Target};
use crate::fragments::{Fragment, List};
use crate::gpu::form::blocks::{self, FUNCTIONS, INTERVAL, OUTPUTS, TWO_PASS};
use crate::gpu::form::{Form, Number};
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::technique::{AnyTechnique, Axes, Cost, DepthComplexity, Info, Pixel, Properties};
use crate::techniques::ANY_ORDER;

/// The registry entry.
pub static INFO: Info = Info {
    id: "opacity_shadow_maps",
    aliases: &[],
    name: "Opacity Shadow Maps",
    citation: &["Kim2001"],
    doc: "Sums the absorbance of fragments in depth bins; a second pass sees each fragment through the bins in \
          front of it and, interpolating, through a part of its own.",
    axes: Axes {
        memory: "k bins",
        insertion: "always",
        merge: "α-weighted sum",
        normalize: "no",
        opacity: "alpha",
    },
    params: &[
        ParamSpec::new("bins", Kind::at_least(1), Value::Int(64), "depth bins"),
        ParamSpec::new(
            "interp",
            Kind::Choice(&["floor", "linear"]),
            Value::Text("linear"),
            "what of its own bin hides a fragment: nothing, or as much as lies in front of it if the bin's \
             absorbance is spread evenly",
        ),
        DepthRange::param("pixel"),
        SELF_CORRECT.when(|p| p.text("interp") == "linear"),
        S_MAX,
        Composite::param("none"),
        SUMMATION,
    ],
    targets: &[BINS, Target::ACCUMULATION, Target::REVEALAGE],
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "2",
    bytes_per_pixel: "bins, 4 sums and R: 4 bins + 20 in f32, 2 bins + 10 in f16",
    build,
    gpu: Some(gpu),
};

fn build(params: &Params, view: &View) -> Result<Box<dyn AnyTechnique>> {
    Ok(technique(OpacityShadowMaps::from_params(params, view), INFO.targets, params))
}

/// Its form on a GPU.
fn gpu(params: &Params, view: &View) -> Result<Form> {
    let interpolation = match Interpolation::from_params(params) {
        Interpolation::Floor => 0,
        Interpolation::Linear => 1,
        Interpolation::SelfCorrected => 2,
    };
    let bins = params.size("bins");
    two_pass_form(
        params,
        view,
        &Own {
            shader: include_str!("../../shaders/opacity_shadow_maps.wgsl"),
            blocks: &[FUNCTIONS, INTERVAL, OUTPUTS, TWO_PASS, blocks::BINS],
            targets: INFO.targets,
            map: (BINS.name, "bins"),
            count: bins,
            numbers: &[Number::size(bins), Number::Whole(interpolation)],
            ..Own::BARE
        },
    )
}

/// What of its own bin hides a fragment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Interpolation {
    /// Nothing.
    Floor,
    /// What is in front of it if the bin's absorbance is spread evenly, its own share included.
    Linear,
    /// The same without its own share (sheet 0.3).
    SelfCorrected,
}

impl Interpolation {
    fn from_params(params: &Params) -> Self {
        match (params.text("interp"), params.bool("self_correct")) {
            ("floor", _) => Self::Floor,
            (_, false) => Self::Linear,
            (_, true) => Self::SelfCorrected,
        }
    }
}

/// Absorbance in bins of a depth range.
pub struct OpacityShadowMaps {
    /// How many.
    pub bins: usize,
    /// How they are read.
    pub interpolation: Interpolation,
    /// What they divide.
    pub range: DepthRange,
    /// Whether no fragment of the view is outside it.
    pub range_covers_scene: bool,
    /// Largest absorbance of a fragment.
    pub s_max: f64,
}

impl OpacityShadowMaps {
    fn from_params(params: &Params, view: &View) -> Self {
        let range = DepthRange::from_params(params, view);
        Self {
            bins: params.size("bins"),
            interpolation: Interpolation::from_params(params),
            range,
            range_covers_scene: range.covers(view),
            s_max: params.float("s_max"),
        }
    }

    /// A position's bin, and how much of the bin is in front of it.
    fn place(&self, position: f64) -> (usize, f64) {
        let (bin, fraction) = cell(position, self.bins);
        (bin, if self.interpolation == Interpolation::Floor { 0.0 } else { fraction })
    }
}

/// One pixel's bins.
#[derive(Debug, Default)]
pub struct Map {
    interval: Interval,
    bins: BinnedAbsorbance,
}

impl Oracle for OpacityShadowMaps {
    type Map = Map;

    fn build(&self, pixel: &Pixel<'_>, Map { interval, bins }: &mut Map) {
        *interval = self.range.interval(pixel.list);
        bins.clear(self.bins);
        let (mut positions, mut s) = ([0.0; CHUNK], [0.0; CHUNK]);
        for part in chunks(pixel.list) {
            interval.positions(part.depth, &mut positions);
            absorbances(part.alpha, self.s_max, &mut s);
            for (&position, &s) in positions.iter().zip(&s).take(part.len()) {
                bins.add(self.place(position).0, s);
            }
        }
        bins.end();
    }

    fn in_front_of(&self, map: &Map, fragment: &Fragment) -> f64 {
        see_one(self, map, fragment)
    }

    fn see(&self, map: &Map, list: List<'_>, seen: &mut [f64]) {
        let mut own = [0.0; CHUNK];
        map.interval.positions(list.depth, seen);
        if self.interpolation == Interpolation::SelfCorrected {
            absorbances(list.alpha, self.s_max, &mut own);
        }
        for (seen, own) in seen.iter_mut().zip(own) {
            let place = self.place(*seen);
            *seen = map.bins.lerp(place) - place.1 * own;
        }
        transmittances(seen);
    }

    fn at(&self, map: &Map, depth: f32) -> f64 {
        transmittance(map.bins.lerp(self.place(map.interval.position(depth))))
    }

    fn total(&self, map: &Map) -> f64 {
        transmittance(map.bins.total())
    }

    #[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
    fn cost(&self, _complexity: &DepthComplexity) -> Cost {
        Cost { geometry_passes: 2.0, bytes_per_pixel: 4.0 * self.bins as f64 + 20.0 }
    }

    fn properties(&self, composite: Composite) -> Properties {
        let uncharged = self.interpolation != Interpolation::Linear;
        Properties {
            consistent: uncharged && self.range_covers_scene,
            // the nearest fragment of a pixel's own range lies at the near edge of bin 0
            ..composite.promises(uncharged || self.range == DepthRange::Pixel)
        }
    }
}

impl StoredOracle for OpacityShadowMaps {
    fn build_stored(&self, pixel: &Pixel<'_>, formats: &Formats, Map { interval, bins }: &mut Map) {
        *interval = self.range.interval(pixel.list);
        let deposits = pixel
            .list
            .iter()
            .map(|f| (self.place(interval.position(f.depth)).0, absorbance(f.alpha, self.s_max)));
        bins.fill_stored(self.bins, formats.of(BINS.name), deposits);
    }

    #[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
    fn texels(&self, _complexity: &DepthComplexity) -> Vec<(&'static str, f64)> {
        vec![(BINS.name, self.bins as f64)]
    }
}

#[cfg(test)]
mod tests {
    use super::{INFO, OpacityShadowMaps};
    use crate::fragments::Fragment;
    use crate::params::Input;
    use crate::techniques::testing::{
        F32_STATE, VIEW, assert_close, clear_pixels, fragment, given, mean_error, over, resolve, three_layers,
    };
    use glam::DVec3;

    fn bins(count: i64, interp: &str, self_correct: bool) -> Vec<(&'static str, Input)> {
        vec![
            ("bins", Input::Int(count)),
            ("interp", Input::Text(interp.into())),
            ("self_correct", Input::Bool(self_correct)),
        ]
    }

    fn oracle(count: i64, interp: &str, self_correct: bool) -> OpacityShadowMaps {
        let mut inputs = bins(count, interp, self_correct);
        inputs.push(("range", Input::Text("scene".into())));
        OpacityShadowMaps::from_params(&given(&INFO, &inputs), &VIEW)
    }

    fn with(mut inputs: Vec<(&'static str, Input)>, composite: &str) -> Vec<(&'static str, Input)> {
        inputs.push(("composite", Input::Text(composite.into())));
        inputs
    }

    #[test]
    fn three_layers_by_hand() {
        // of the pixel's range [2, 8] with two bins, depth 4 lies 2/3 into the first, 2 and 8 at the outer edges;
        // what lets half and three quarters through leaves (3/4)^(2/3) in front of depth 4
        let layers = three_layers();
        let color = |f: &Fragment| DVec3::from(f.color.map(f64::from));
        let parts = |t: f64| t * color(&layers[0]) + color(&layers[1]) + 0.375 * color(&layers[2]);
        let background = DVec3::new(0.25, 0.5, 0.75) * 0.093_75;
        let lerp = resolve("opacity_shadow_maps", &bins(2, "linear", true), &layers);
        assert_close(lerp, parts(0.75_f64.powf(2.0 / 3.0)) + background, 0.093_75, F32_STATE);
        let charged = resolve("opacity_shadow_maps", &bins(2, "linear", false), &layers);
        let halves = 0.375_f64.powf(2.0 / 3.0) * color(&layers[0]) + color(&layers[1]);
        let last = 0.093_75 * color(&layers[2]);
        assert_close(charged, halves + last + background, 0.093_75, F32_STATE);
        let floor = resolve("opacity_shadow_maps", &bins(2, "floor", true), &layers);
        assert_close(floor, parts(1.0) + background, 0.093_75, F32_STATE);
    }

    /// Identity 2 of sheet section 3.
    #[test]
    fn one_bin_read_at_its_near_edge_and_normalised_is_blended_oit() {
        for (n, pixel) in (1..).zip(clear_pixels(20)) {
            let got = resolve("opacity_shadow_maps", &with(bins(1, "floor", true), "normalize"), &pixel);
            assert_eq!(got, resolve("blended_oit", &[], &pixel), "pixel {n}");
        }
    }

    #[test]
    fn bins_narrower_than_the_gaps_are_over() {
        let layer = |i: u8| {
            let (depth, alpha) = (1.0 + f32::from(3 * i % 8), 0.1 * f32::from(i) + 0.05);
            fragment(depth, [0.1, 0.9, 0.1 * f32::from(i)], alpha, i.into())
        };
        let apart: Vec<_> = (0..8).map(layer).collect();
        let (color, transmittance) = over(&apart);
        for composite in ["none", "exact_bg", "normalize"] {
            let got = resolve("opacity_shadow_maps", &with(bins(8, "floor", true), composite), &apart);
            assert_close(got, color, transmittance, F32_STATE);
        }
    }

    /// Sheet 2.5: linear interpolation stalls unless a fragment is freed of its own share.
    #[test]
    fn without_self_correction_the_error_stalls() {
        let pixels = clear_pixels(1000);
        let error = |count, interp, self_correct| mean_error(&oracle(count, interp, self_correct), &pixels);
        let (charged, freed) = (error(1024, "linear", false), error(1024, "linear", true));
        assert!((charged / 0.073 - 1.0).abs() < 0.1, "{charged}");
        assert!(charged > 0.9 * error(128, "linear", false));
        assert!((0.0002..0.001).contains(&freed), "{freed}");
        assert!(10.0 * freed < error(64, "linear", true));
        assert!(error(1024, "floor", true) < 0.002);
    }

    #[test]
    fn an_opaque_layer_leaks_what_s_max_says() {
        let pixel = [fragment(2.0, [0.0; 3], 1.0, 0), fragment(3.0, [1e4; 3], 1.0, 1)];
        let leak = |s_max: f64| {
            let inputs = with(vec![("s_max", Input::Float(s_max))], "exact_bg");
            resolve("opacity_shadow_maps", &inputs, &pixel).color.x
        };
        assert!((leak(10.0) / (1e4 * (-10.0_f64).exp()) - 1.0).abs() < 1e-6);
        assert!(leak(25.0) < 1e-6);
    }

    #[test]
    fn any_number_of_bins_costs_no_more_than_the_fragments() {
        let layers = three_layers();
        let (color, transmittance) = over(&layers);
        let got = resolve("opacity_shadow_maps", &bins(i64::MAX, "floor", true), &layers);
        assert_close(got, color, transmittance, F32_STATE);
    }
}
