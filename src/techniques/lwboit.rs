//! Layered weighted blended OIT (Friederichs, Eisemann & Eisemann 2021, FEE21): weighted blending within
//! depth bins, `over` between them.

mod stored;

use self::stored::{BIN_SUMMATION, StoredBins, Storing, TARGETS};
use crate::continuum::absorbance::{S_MAX, absorbance};
use crate::continuum::bins::{
    BATCH, BinFunction, Bins, OwnBins, REACH, SUPPORT, Shares, share_out, shares_of,
};
use crate::continuum::normalize::{Core, sums_of_all};
use crate::continuum::oracle::{CHUNK, chunks};
use crate::continuum::range::DepthRange;
use crate::continuum::sums::BlendSums;
use crate::diagnosis::{Diagnosis, Faults};
use crate::error::Result;
use crate::fragments::{List, Lists};
use crate::gpu::form::{Form, Listing, Number, Path, Sorting, only, only_default_formats};
use crate::own::Signature;
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::technique::{
    AnyTechnique, Axes, Cost, DepthComplexity, Info, Pixel, Properties, Resolved, Technique,
};
use crate::techniques::ANY_ORDER;
use crate::weight::{self, Weighting};
use glam::DVec3;
use multiversion::multiversion;

/// The registry entry.
pub static INFO: Info = Info {
    id: "lwboit",
    aliases: &[],
    name: "Layered weighted blended OIT",
    citation: &["Friederichs2021"],
    doc: "Depth is divided into bins; fragments of a bin blend by weight, bins composite front to back. \
          smooth fades fragments over neighbouring bins, normalize restores the exact coverage, shape lets \
          the bins start at each pixel's first surface. partition=\"absorbance\" splits a fragment so that its \
          parts together cover as much as it does: as bins narrow, the image tends to the exact one.",
    axes: Axes {
        memory: "k bins",
        insertion: "always",
        merge: "α-weighted average",
        normalize: "renormalize alpha",
        opacity: "alpha",
    },
    params: &[
        ParamSpec::new("bins", Kind::Int { min: 1, max: 512 }, Value::Int(32), "depth bins"),
        ParamSpec::new(
            "smooth",
            Kind::Bool,
            Value::Bool(true),
            "fade fragments over neighbouring bins (FEE21 section 3.2)",
        ),
        ParamSpec::new(
            "normalize",
            Kind::Bool,
            Value::Bool(true),
            "scale the colour to the exact coverage of all fragments (FEE21 section 3.3)",
        ),
        ParamSpec::new(
            "shape",
            Kind::Bool,
            Value::Bool(true),
            "measure bins and weights from each pixel's first surface (FEE21 section 3.4)",
        ),
        ParamSpec::new(
            "bin_function",
            Kind::Function { names: &["bell", "tent"], signature: &BIN_SIGNATURE },
            Value::Text("bell"),
            "how a fragment fades with its distance x from a bin's centre, in bin widths; it reaches 2.5 of them. One's \
             own gives shares >= 0, at most 1 of which counts with partition=\"none\"",
        )
        .when(|p| p.bool("smooth")),
        ParamSpec::new(
            "partition",
            Kind::Choice(&["none", "absorbance"]),
            Value::Text("none"),
            "what smooth bins share: none fades the coverage, as published; absorbance divides the absorbance \
             in shares that sum to 1",
        )
        .when(|p| p.bool("smooth")),
        ParamSpec::new(
            "shape_anchor",
            Kind::Choice(&["center", "edge"]),
            Value::Text("center"),
            "where in the first bin the first surface lies",
        )
        .when(|p| p.bool("shape")),
        ParamSpec::new(
            "storage",
            Kind::Choice(&["lr", "ll"]),
            Value::Text("lr"),
            "layered rendering into all bins, 32 per pass, or linked lists binned in the resolve",
        ),
        ParamSpec::new(
            "capacity",
            Kind::at_least(0),
            Value::Int(0),
            "fragments kept per pixel in submission order, the others dropped and counted; 0 is unlimited",
        )
        .when(|p| p.text("storage") == "ll"),
        BIN_SUMMATION,
        weight::WEIGHT,
        weight::WEIGHT_K,
        weight::WEIGHT_SCALE,
        weight::WEIGHT_SHIFT,
        weight::NEAR,
        weight::FAR,
        DepthRange::param("scene"),
        S_MAX.when(|p| p.bool("smooth") && p.text("partition") == "absorbance"),
    ],
    targets: &TARGETS,
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "lr: ceil(bins / 32), 1 more to normalize, 1 more for shape or range=\"pixel\"; ll: 1",
    bytes_per_pixel: "lr: 20 bins in f32, 10 in f16, one R more to normalize, 4 more for shape or range=\"pixel\"; \
                      ll: 24 n + 4 in f32, 14 n + 4 in f16 (n = mean depth complexity)",
    build,
    gpu: Some(gpu),
};

/// What bin functions of one's own are given.
static BIN_SIGNATURE: Signature = Signature { entry: "bin", arguments: &["x"], callable: "(x) -> share" };

fn build(params: &Params, view: &View) -> Result<Box<dyn AnyTechnique>> {
    let function = match params.value("bin_function") {
        Value::Text("tent") => BinFunction::Tent,
        Value::Text(_) => BinFunction::Bell,
        _ => BinFunction::Own(OwnBins::from_params(params, params.is("partition", "none"))?),
    };
    let sharing = match (params.bool("smooth"), params.text("partition")) {
        (false, _) => Sharing::Naive,
        (true, "absorbance") => Sharing::Absorbance(function, params.float("s_max")),
        (true, _) => Sharing::Coverage(function),
    };
    let shape = params.bool("shape").then(|| match params.text("shape_anchor") {
        "edge" => 0.0,
        _ => 0.5,
    });
    let storage = match (params.text("storage"), params.size("capacity")) {
        ("lr", _) => Storage::Bins,
        (_, 0) => Storage::Lists { capacity: usize::MAX },
        (_, capacity) => Storage::Lists { capacity },
    };
    let range = DepthRange::from_params(params, view);
    Ok(Box::new(LayeredWboit {
        bins: params.size("bins"),
        sharing,
        normalize: params.bool("normalize"),
        shape,
        storage,
        storing: Storing::from_params(params),
        weighting: Weighting::from_params(params)?,
        range,
        range_covers_scene: range.covers(view),
    }))
}

/// Its form on a GPU: lists that are binned in the resolve, where shaping is free (FEE21 §4).
fn gpu(params: &Params, view: &View) -> Result<Form> {
    only(params, "storage", "ll")?;
    if params.bool("smooth") {
        only(params, "partition", "none")?;
    }
    if params.size("capacity") > 0 {
        let problem = "a capacity has no form on the backend \"gpu\", which keeps every fragment";
        return Err(params.error(problem, "there capacity is 0"));
    }
    only_default_formats(params, INFO.targets)?;
    let weights = Weighting::from_params(params)?.numbers().ok_or_else(|| {
        params.error("this weight has no form on the backend \"gpu\"", "there weights are the published ones")
    })?;
    let range = DepthRange::from_params(params, view);
    let (nearest, farthest) = match range {
        DepthRange::Pixel => (0.0, 0.0),
        DepthRange::Fixed(lo, hi) => (lo, hi),
    };
    let fading = match (params.bool("smooth"), params.value("bin_function")) {
        (false, _) => 0,
        (true, Value::Text("bell")) => 1,
        (true, Value::Text("tent")) => 2,
        _ => {
            let problem = "bin functions of one's own have no form on the backend \"gpu\"";
            return Err(params.error(problem, "there bin_function is \"bell\" or \"tent\""));
        }
    };
    let bins = u32::try_from(params.size("bins")).unwrap_or_else(|_| unreachable!("at most 512"));
    let anchor = if params.text("shape_anchor") == "edge" { 0.0 } else { 0.5 };
    let more = [
        Number::Whole(bins),
        Number::Whole(fading),
        Number::Whole(params.bool("normalize").into()),
        Number::Whole(params.bool("shape").into()),
        Number::Float(anchor),
        Number::Whole((range == DepthRange::Pixel).into()),
        Number::float(nearest),
        Number::float(farthest),
    ];
    Ok(Form {
        shader: include_str!("../../shaders/lwboit.wgsl"),
        numbers: weights.into_iter().chain(more).collect(),
        path: Path::Listed(Listing {
            resolve: "resolve",
            sorted: Sorting::Depth,
            layers: None,
            sizes: vec![],
        }),
        shows_zero_fragments: false,
        colored_transmittance: false,
    })
}

/// What of a fragment goes to which bins.
#[derive(Debug, Clone)]
enum Sharing {
    /// All of it to its own bin.
    Naive,
    /// Each bin gets the fragment with its alpha faded (FEE21 §3.2).
    Coverage(BinFunction),
    /// Each bin gets a share of the fragment's absorbance, at most the given one; shares sum to 1.
    Absorbance(BinFunction, f64),
}

/// Where fragments are kept until the resolve (FEE21 §4).
#[derive(Debug, Clone, Copy, PartialEq)]
enum Storage {
    /// Layered rendering: nowhere, they are blended into the bins.
    Bins,
    /// Linked lists with room for `capacity` fragments per pixel.
    Lists { capacity: usize },
}

/// Bins of a depth range, blended by weight.
pub(super) struct LayeredWboit {
    bins: usize,
    sharing: Sharing,
    normalize: bool,
    /// Where in bin 1 the first surface lies, in bin widths; `None` does not shape.
    shape: Option<f64>,
    storage: Storage,
    storing: Storing,
    weighting: Weighting,
    range: DepthRange,
    range_covers_scene: bool,
}

/// One pixel's working memory.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    bins: Bins,
    shaped_depth: Vec<f32>,
    weights: Vec<f32>,
    stored: StoredBins,
    nodes: Lists,
}

/// A pixel's bins. A fragment's z' counts from the near edge of the first one.
#[derive(Debug, Clone, Copy)]
struct Slicing {
    /// The depth that z' is measured from.
    origin: f64,
    /// z' at the origin.
    offset: f64,
    /// Width of a bin.
    width: f64,
}

impl Slicing {
    /// z' of a depth, before clamping. In f64, so that depths fall on the side of a bin's edge that they
    /// should, wherever the camera stands.
    fn shifted(&self, depth: f32) -> f64 {
        f64::from(depth) - self.origin + self.offset
    }
}

/// The bin of each depth, and the distance behind its centre in bin widths. Positions outside the range belong to
/// the end bins.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
#[expect(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "0 <= position <= 512"
)]
fn locate_all(
    bins: usize,
    slicing: Slicing,
    depth: &[f32],
    owns: &mut [usize; CHUNK],
    xs: &mut [f64; CHUNK],
) {
    for ((own, x), &depth) in owns.iter_mut().zip(xs).zip(depth) {
        let position = (slicing.shifted(depth) / slicing.width).clamp(0.0, bins as f64);
        *own = (position as usize).min(bins - 1);
        *x = position - *own as f64 - 0.5;
    }
}

/// Blends fragments into their bins with their alphas faded (FEE21 §3.2).
fn blend_faded(bins: &mut Bins, shares: &Shares, part: List<'_>, weights: &[f32], own: &[usize; CHUNK]) {
    for (i, &weight) in weights.iter().enumerate() {
        let (color, alpha) = (part.color[i], part.alpha[i]);
        for (bin, shares) in bins.touch_reach(own[i]).iter_mut().zip(shares) {
            // a share of nothing changes nothing
            let coverage = f64::from(alpha) * f64::from(shares[i]);
            bin.add_share(shares[i] * weight, color, alpha, coverage, 1.0 - coverage);
        }
    }
}

impl LayeredWboit {
    /// Bins that a fragment is in or not, of unshaped depth.
    pub(super) fn naive(bins: usize, range: DepthRange, weighting: Weighting) -> Self {
        Self {
            bins,
            sharing: Sharing::Naive,
            normalize: false,
            shape: None,
            storage: Storage::Bins,
            storing: Storing::SINGLE,
            weighting,
            range,
            range_covers_scene: false,
        }
    }

    /// Blends the fragments of `list` into the bins that `whole` asks for, and composites these.
    pub(super) fn blend_bins(&self, whole: List<'_>, list: List<'_>, scratch: &mut Scratch) -> Core {
        let Scratch { bins, shaped_depth, weights, .. } = scratch;
        let slicing = self.slicing(whole);
        self.weigh(list, slicing, shaped_depth, weights);
        bins.reset(self.bins);
        for (part, weights) in chunks(list).zip(weights.chunks(CHUNK)) {
            self.blend_chunk(bins, slicing, part, weights);
        }
        bins.under_blend()
    }

    fn blend_chunk(&self, bins: &mut Bins, slicing: Slicing, part: List<'_>, weights: &[f32]) {
        let (mut own, mut xs) = ([0; CHUNK], [0.0; CHUNK]);
        locate_all(self.bins, slicing, part.depth, &mut own, &mut xs);
        let mut shares = [[0.0; CHUNK]; SUPPORT];
        let places = own.iter().zip(weights).zip(part.color.iter().zip(part.alpha));
        match &self.sharing {
            Sharing::Naive => {
                for ((&own, &weight), (&color, &alpha)) in places {
                    bins.touch(own).add(weight, color, alpha);
                }
            }
            Sharing::Coverage(function) => {
                share_out(function, &xs[..part.len()], &mut shares);
                blend_faded(bins, &shares, part, weights, &own);
            }
            Sharing::Absorbance(function, s_max) => {
                share_out(function, &xs[..part.len()], &mut shares);
                for (i, ((&own, &weight), (&color, &alpha))) in places.enumerate() {
                    self.divide(bins, shares_of(&shares, i), *s_max, own, weight, color, alpha);
                }
            }
        }
    }

    fn slicing(&self, list: List<'_>) -> Slicing {
        let (lo, hi) = self.range.bounds(list);
        #[expect(clippy::cast_precision_loss, reason = "at most 512")]
        let width = Some((hi - lo) / self.bins as f64).filter(|width| *width > 0.0).unwrap_or(1.0);
        match (self.shape, list.depth_bounds()) {
            (Some(anchor), Some((first, _))) => {
                Slicing { origin: first.into(), offset: anchor * width, width }
            }
            _ => Slicing { origin: lo, offset: 0.0, width },
        }
    }

    /// The weights w(z) or, shaped, w(z'): then moving the scene along z changes nothing.
    fn weigh(&self, list: List<'_>, slicing: Slicing, depth: &mut Vec<f32>, weights: &mut Vec<f32>) {
        self.weighting.evaluate(self.seen_depths(list, slicing, depth), list.alpha, weights);
    }

    /// What weights see of depths.
    fn seen_depths<'a>(&self, list: List<'a>, slicing: Slicing, depth: &'a mut Vec<f32>) -> &'a [f32] {
        if self.shape.is_none() {
            return list.depth;
        }
        depth.clear();
        #[expect(clippy::cast_possible_truncation, reason = "weights are evaluated in f32")]
        depth.extend(list.depth.iter().map(|&z| slicing.shifted(z) as f32));
        depth
    }

    /// Blends a fragment into its bins, each of which gets a share of its absorbance.
    #[expect(clippy::cast_possible_truncation, reason = "shares are blended in f32")]
    #[expect(clippy::too_many_arguments, reason = "a fragment and where it goes")]
    fn divide(
        &self,
        bins: &mut Bins,
        shares: [f32; SUPPORT],
        s_max: f64,
        own: usize,
        weight: f32,
        color: [f32; 3],
        alpha: f32,
    ) {
        let total: f64 = self.reach(own, shares).map(|(_, b)| f64::from(b)).sum();
        let s = absorbance(alpha, s_max);
        for (k, b) in self.reach(own, shares) {
            let beta = f64::from(b) / total;
            let absorbed = (-beta * s).exp_m1();
            let part = if alpha > 0.0 { -absorbed / f64::from(alpha) } else { beta };
            bins.touch(k).add_share(part as f32 * weight, color, alpha, -absorbed, 1.0 + absorbed);
        }
    }

    /// The bins in reach of bin `own` that exist and get a share.
    fn reach(&self, own: usize, shares: [f32; SUPPORT]) -> impl Iterator<Item = (usize, f32)> {
        let bins = self.bins;
        let in_reach = shares.into_iter().enumerate().map(move |(j, b)| (own + j, b));
        in_reach
            .filter(move |&(k, b)| b > 0.0 && (REACH..bins + REACH).contains(&k))
            .map(|(k, b)| (k - REACH, b))
    }

    /// FEE21 eq. 4, with `normalize` at the coverage of all fragments together (§3.3).
    fn composite(&self, layers: &Core, list: List<'_>, background: DVec3) -> Resolved {
        if !self.normalize {
            return layers.over(background);
        }
        let net = sums_of_all(list);
        layers.scale_to(&BlendSums::CLEAR, net.coverage(), net.transmittance(), background)
    }

    /// The fragments that the storage has room for.
    fn kept<'a>(&self, list: List<'a>) -> List<'a> {
        let Storage::Lists { capacity } = self.storage else { return list };
        let n = capacity.min(list.len());
        List {
            depth: &list.depth[..n],
            color: &list.color[..n],
            alpha: &list.alpha[..n],
            primitive: &list.primitive[..n],
        }
    }

    /// Whether a pass that finds each pixel's depths comes first.
    fn needs_depth_pass(&self) -> bool {
        self.shape.is_some() || self.range == DepthRange::Pixel
    }

    fn loses_fragments(&self) -> bool {
        matches!(self.storage, Storage::Lists { capacity } if capacity < usize::MAX)
    }
}

impl Technique for LayeredWboit {
    type Scratch = Scratch;

    fn resolve(&self, pixel: &Pixel<'_>, scratch: &mut Scratch) -> Resolved {
        let list = self.kept(pixel.list);
        let Scratch { shaped_depth, stored, nodes, .. } = scratch;
        if let Some(resolved) = self.resolve_stored(list, pixel.background, shaped_depth, stored) {
            return resolved;
        }
        let dropped = (pixel.list.len() - list.len()) as u64;
        let mut nodes = std::mem::take(nodes);
        let rounded = self.storing.round(list, &mut nodes).unwrap_or(list);
        let layers = self.blend_bins(rounded, rounded, scratch);
        let resolved = Resolved { dropped, ..self.composite(&layers, rounded, pixel.background) };
        scratch.nodes = nodes;
        resolved
    }

    fn faults(&self) -> Faults {
        self.storing.faults()
    }

    fn diagnose(&self, pixel: &Pixel<'_>, scratch: &mut Scratch) -> Diagnosis {
        self.diagnose_stored(self.kept(pixel.list), scratch)
    }

    #[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
    fn cost(&self, complexity: &DepthComplexity) -> Cost {
        if let Storage::Lists { capacity } = self.storage {
            let nodes = complexity.mean.min(capacity as f64);
            return Cost { geometry_passes: 1.0, bytes_per_pixel: self.storing.node_bytes * nodes + 4.0 };
        }
        let (net, depth) = (u8::from(self.normalize), u8::from(self.needs_depth_pass()));
        Cost {
            geometry_passes: self.bins.div_ceil(BATCH) as f64 + f64::from(net + depth),
            bytes_per_pixel: self.storing.bin_bytes * self.bins as f64
                + self.storing.net_bytes * f64::from(net)
                + f64::from(4 * depth),
        }
    }

    fn properties(&self) -> Properties {
        let whole = !self.loses_fragments();
        let exact = self.normalize || matches!(self.sharing, Sharing::Naive);
        self.storing.promises(Properties {
            order_independent: whole,
            unbiased: false,
            consistent: whole && self.range_covers_scene && !matches!(self.sharing, Sharing::Coverage(_)),
            exact_for_one: exact,
            exact_for_one_color: exact && whole,
            exact_coverage: exact && whole,
        })
    }
}

#[cfg(test)]
mod tests;
