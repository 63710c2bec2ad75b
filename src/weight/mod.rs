//! Depth weights: how much a fragment counts in a blended average, given its depth and coverage.
//!
//! A weight maps slices to a slice, so that a formula vectorises and a user's own weight enters through the
//! same door as the published ones. The formulas are those of `McGuire` & Bavoil 2013 (MB13) and of the
//! I3D 2016 shaders of the phenomenological model. A constant factor cancels in every technique. What is stored in more
//! than f32, or in multiples of a power of two, takes weights in f64 or their logarithms (`log.rs`).

mod fill;
mod gpu;
mod log;
mod own;

pub use own::Own;

pub use gpu::Shading;

use crate::continuum::functions::{exp, ln};
use crate::error::Result;
use crate::own::Signature;
use crate::params::{Kind, ParamSpec, Params, Setting, Value};
use fill::{Alphas, Fragments, Seen, bounded, fill, fill_below_ceiling};
use multiversion::multiversion;

/// Weights stay within these bounds. Where all weights underflow to the floor the average is unweighted
/// (MB13 eq. 5) instead of 0/0; the ceiling leaves the sums of 10⁴ bright fragments finite in f32.
pub const WEIGHT_BOUNDS: (f32, f32) = (1e-30, 1e30);

/// The smallest depth a weight sees: keeps `z^-k` finite at the eye.
pub const MIN_DEPTH: f32 = 1e-4;

/// The published weights.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Formula {
    /// 1: MB13 eq. 5.
    One,
    /// MB13 eq. 7.
    Mb7,
    /// MB13 eq. 8.
    Mb8,
    /// MB13 eq. 9.
    Mb9,
    /// MB13 eq. 10, a function of window depth.
    Mb10(Planes),
    /// `z^-k`: MB13's scenes use k = 4 and 5.
    InvPow {
        /// The exponent.
        k: f32,
    },
    /// `exp(-k z)`: what lies behind a uniform medium (Beer-Lambert, MB13 §3.2).
    Exp {
        /// The absorbance per unit of depth.
        k: f32,
    },
    /// MB13 Fig. 1.
    Fig1,
    /// MB13 Fig. 6, two puffs of smoke.
    Smoke6,
    /// MB13 Fig. 10, tuned by k.
    Fig10 {
        /// The inverse depth at which the weight has fallen to 1/11 of its maximum.
        k: f32,
    },
    /// The clamped cubic of the phenomenological model's shaders (I3D 2016).
    I3d16(Planes),
}

/// Near and far plane as window depth needs them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Planes {
    scale: f32,
    inverse_far: f32,
}

impl Planes {
    /// Planes at view depths `near < far`.
    #[expect(clippy::cast_possible_truncation, reason = "weights are evaluated in f32")]
    pub fn new(near: f64, far: f64) -> Self {
        Self { scale: (near * (far / (far - near))) as f32, inverse_far: far.recip() as f32 }
    }

    /// What the params [`NEAR`] and [`FAR`] ask for.
    ///
    /// # Errors
    /// `Error::Param` if near is not below far.
    pub fn from_params(params: &Params) -> Result<Self> {
        let (near, far) = (params.float("near"), params.float("far"));
        if near >= far {
            let problem = format!("parameter \"near\" is {near:?}, but \"far\" is {far:?}");
            return Err(params.error(problem, "near must be less than far"));
        }
        Ok(Self::new(near, far))
    }

    /// Whether so much is between them that [`Planes::one_minus_depth`] loses no digits before it is next to nothing.
    fn are_apart(self) -> bool {
        // near / (far - near)
        self.scale * self.inverse_far <= 0.01
    }

    /// 1 − d with d of MB13 eq. 11 clamped to [0, 1]: 1 at the near plane, 0 at the far one. Written as a
    /// difference of inverses, since 1 − d itself cancels for most of the scene.
    fn one_minus_depth(self, z: f32) -> f32 {
        (self.scale * (z.recip() - self.inverse_far)).clamp(0.0, 1.0)
    }
}

/// `z^-k`; by multiplication where k is a small whole number, which is faster and as exact.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn inverse_power(at: &Fragments<'_, impl Alphas>, weights: &mut [f32], k: f32) {
    let square = |x: f32| x * x;
    match k {
        1.0 => fill(at, weights, |z, _| z.recip()),
        2.0 => fill(at, weights, |z, _| square(z.recip())),
        3.0 => fill(at, weights, |z, _| square(z.recip()) * z.recip()),
        4.0 => fill(at, weights, |z, _| square(square(z.recip()))),
        5.0 => fill(at, weights, |z, _| square(square(z.recip())) * z.recip()),
        6.0 => fill(at, weights, |z, _| square(square(z.recip()) * z.recip())),
        _ => any_inverse_power(at.seen, at.depth, weights, k),
    }
}

/// `z^-k` for any k: a plain loop of its own, which becomes one of whole vectors.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
#[expect(clippy::cast_possible_truncation, reason = "weights are evaluated in f32")]
fn any_inverse_power(seen: Seen, depth: &[f32], weights: &mut [f32], k: f32) {
    let k = f64::from(k);
    for (weight, &z) in weights.iter_mut().zip(depth) {
        let seen = f64::from(seen.see(z));
        // what the clamp changes is beyond the bounds of weights, too
        *weight = bounded(exp((-k * ln(seen)).clamp(-100.0, 100.0)) as f32);
    }
}

impl Formula {
    /// The published weight that the params name.
    fn from_params(params: &Params, planes: Planes) -> Self {
        #[expect(clippy::cast_possible_truncation, reason = "weights are evaluated in f32")]
        let k = || params.float("weight_k") as f32;
        match params.text("weight") {
            "one" => Self::One,
            "mb7" => Self::Mb7,
            "mb8" => Self::Mb8,
            "mb9" => Self::Mb9,
            "mb10" => Self::Mb10(planes),
            "inv_pow" => Self::InvPow { k: k() },
            "exp" => Self::Exp { k: k() },
            "fig1" => Self::Fig1,
            "smoke6" => Self::Smoke6,
            "fig10" => Self::Fig10 { k: k() },
            "i3d16" => Self::I3d16(planes),
            other => unreachable!("{other:?} is not a choice of \"weight\""),
        }
    }

    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    fn weigh(&self, at: &Fragments<'_, impl Alphas>, weights: &mut [f32]) {
        let square = |x: f32| x * x;
        let cube = |x: f32| x * x * x;
        let mb = |x: f32| x.clamp(1e-2, 3e3);
        // times an inverse, not divided by: the same to an ulp for a fifth of the time
        let far = |z: f32| square(cube(z * (1.0 / 200.0)));
        match *self {
            Self::One => weights.fill(1.0),
            Self::Mb7 => {
                fill_below_ceiling(at, weights, |z, a| {
                    a * mb(10.0 / (1e-5 + square(z * (1.0 / 5.0)) + far(z)))
                });
            }
            Self::Mb8 => {
                fill_below_ceiling(at, weights, |z, a| {
                    a * mb(10.0 / (1e-5 + cube(z * (1.0 / 10.0)) + far(z)))
                });
            }
            Self::Mb9 => {
                fill_below_ceiling(at, weights, |z, a| {
                    a * mb(0.03 / (1e-5 + square(square(z * (1.0 / 200.0)))))
                });
            }
            Self::Mb10(planes) => {
                fill_below_ceiling(at, weights, |z, a| a * (3e3 * cube(planes.one_minus_depth(z))).max(1e-2));
            }
            Self::InvPow { k } => inverse_power(at, weights, k),
            #[expect(clippy::cast_possible_truncation, reason = "weights are evaluated in f32")]
            Self::Exp { k } => fill(at, weights, |z, _| exp(-f64::from(k) * f64::from(z)) as f32),
            Self::Fig1 => fill(at, weights, |z, _| square((z + 5.0).recip())),
            Self::Smoke6 => fill(at, weights, |z, a| square(a / cube(z))),
            Self::Fig10 { k } => fill(at, weights, |z, _| {
                let x = k * z;
                10.0 / (1.0 + 10.0 * square(square(x)) * x)
            }),
            Self::I3d16(planes) => fill(at, weights, |z, a| {
                (1e3 * a * cube(0.01 + 0.99 * planes.one_minus_depth(z))).clamp(1e-2, 30.0)
            }),
        }
    }
}

/// A weight function with the depth scale and shift it is seen through.
pub struct Weighting {
    function: Function,
    seen: Seen,
}

/// A published weight or one of somebody's own.
pub enum Function {
    /// One of the published ones.
    Published(Formula),
    /// Another one.
    Own(Own),
}

impl Weighting {
    /// `function` of `max(scale z + shift, `[`MIN_DEPTH`]`)`.
    #[expect(clippy::cast_possible_truncation, reason = "weights are evaluated in f32")]
    pub fn new(function: Function, scale: f64, shift: f64) -> Self {
        Self { function, seen: Seen { scale: scale as f32, shift: shift as f32 } }
    }

    /// The weighting that a technique's params ask for; the technique's table has [`WEIGHT`], [`WEIGHT_K`],
    /// [`WEIGHT_SCALE`], [`WEIGHT_SHIFT`], [`NEAR`] and [`FAR`].
    ///
    /// # Errors
    /// `Error::Param` if near is not below far, or if a weight of the user's own cannot be run.
    pub fn from_params(params: &Params) -> Result<Self> {
        let planes = Planes::from_params(params)?;
        let function = match params.setting("weight") {
            Setting::Plain(_) => Function::Published(Formula::from_params(params, planes)),
            own => Function::Own(Own::new(own, planes, params)?),
        };
        Ok(Self::new(function, params.float("weight_scale"), params.float("weight_shift")))
    }

    /// Whether two weightings are known to give the same weights.
    pub fn is_same(&self, other: &Self) -> bool {
        match (&self.function, &other.function) {
            (Function::Published(mine), Function::Published(theirs)) => {
                mine == theirs && self.seen == other.seen
            }
            (Function::Own(mine), Function::Own(theirs)) => mine.is_same(theirs) && self.seen == other.seen,
            _ => false,
        }
    }

    /// Whether a weight changes by a few units in the last place where its depth changes by one.
    pub fn is_gentle(&self) -> bool {
        // powers of the depth no higher than this
        const STEEPEST: f32 = 8.0;
        let gentle = match &self.function {
            Function::Published(Formula::Exp { .. }) | Function::Own(_) => false,
            Function::Published(Formula::InvPow { k }) => *k <= STEEPEST,
            Function::Published(Formula::Mb10(planes) | Formula::I3d16(planes)) => planes.are_apart(),
            Function::Published(_) => true,
        };
        // a difference takes digits away
        gentle && self.seen.scale > 0.0 && self.seen.shift >= 0.0
    }

    /// Whether it is somebody's own, which is best evaluated for many fragments at once.
    pub fn is_own(&self) -> bool {
        matches!(self.function, Function::Own(_))
    }

    /// As many fragments as are best evaluated at once.
    pub fn chunk(&self) -> usize {
        match &self.function {
            Function::Published(_) => 1,
            Function::Own(own) => own.chunk(),
        }
    }

    /// [`Weighting::evaluate`] of a published weight, of fragments of one alpha, for the caller's instruction set.
    ///
    /// # Panics
    /// If the weight is somebody's own.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    pub fn evaluate_here(&self, depth: &[f32], alpha: f32, weights: &mut [f32]) {
        match &self.function {
            Function::Published(formula) => {
                formula.weigh(&Fragments { seen: self.seen, depth, alpha }, weights);
            }
            Function::Own(_) => panic!("a weight of somebody's own is evaluated for many fragments at once"),
        }
    }

    /// The weight of every fragment, in `weights`, which is resized to fit. What is no weight is reported.
    pub fn evaluate(&self, depth: &[f32], alpha: &[f32], weights: &mut Vec<f32>) {
        self.evaluate_for(depth, alpha, weights, |_| true);
    }

    /// The same, where only some fragments' weights are used and to be reported about.
    pub fn evaluate_for(
        &self,
        depth: &[f32],
        alpha: &[f32],
        weights: &mut Vec<f32>,
        is_used: impl Fn(usize) -> bool,
    ) {
        let invalid = self.evaluate_counted(depth, alpha, weights, |i| is_used(i).into());
        if let Function::Own(own) = &self.function {
            own.report(invalid);
        }
    }

    /// The same, and how many results were no weights, the one of fragment i counted `times(i)` times. The caller
    /// reports them.
    pub fn evaluate_counted(
        &self,
        depth: &[f32],
        alpha: &[f32],
        weights: &mut Vec<f32>,
        times: impl Fn(usize) -> u64,
    ) -> u64 {
        weights.resize(depth.len(), 0.0);
        let fragments = Fragments { seen: self.seen, depth, alpha };
        match &self.function {
            Function::Published(formula) => {
                weigh_published(formula, &fragments, weights);
                0
            }
            Function::Own(own) => own.weigh(&fragments, weights, times),
        }
    }
}

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn weigh_published(formula: &Formula, fragments: &Fragments<'_, &[f32]>, weights: &mut [f32]) {
    formula.weigh(fragments, weights);
}

fn depth_matters(params: &Params) -> bool {
    !params.is("weight", "one")
}

fn planes_matter(params: &Params) -> bool {
    match params.setting("weight") {
        Setting::Plain(weight) => matches!(weight, Value::Text("mb10" | "i3d16")),
        Setting::Written(source) => source.reads("d"),
        Setting::Called(_) => false,
    }
}

/// What weights of one's own are given: the depth that weights see, alpha, and window depth (MB13 eq. 11).
pub const SIGNATURE: Signature =
    Signature { entry: "weight", arguments: &["z", "a", "d"], callable: "(z, alpha) -> weight" };
static WEIGHT_SIGNATURE: Signature = SIGNATURE;

/// The param that picks the function.
pub const WEIGHT: ParamSpec = ParamSpec::new(
    "weight",
    Kind::Function {
        names: &["one", "mb7", "mb8", "mb9", "mb10", "inv_pow", "exp", "fig1", "smoke6", "fig10", "i3d16"],
        signature: &WEIGHT_SIGNATURE,
    },
    Value::Text("mb7"),
    "weight function of depth and coverage: mb7 to mb10 are MB13 eq. 7 to 10, fig1, smoke6 and fig10 those of \
     its figures 1, 6 and 10, inv_pow is z^-k, exp is exp(-k z), i3d16 the phenomenological model's; in WGSL, z is \
     the depth that weights see, a is alpha, d window depth (MB13 eq. 11), and any other name a uniform with a \
     param of its own (weight.k)",
);
/// The k of `inv_pow`, `exp` and `fig10`.
pub const WEIGHT_K: ParamSpec =
    ParamSpec::new("weight_k", Kind::POSITIVE, Value::None, "the k of inv_pow, exp and fig10")
        .derived("4 (inv_pow), 1 (exp), 0.01 (fig10)", |params, _| match params.value("weight") {
            Value::Text("inv_pow") => Value::Float(4.0),
            Value::Text("exp") => Value::Float(1.0),
            Value::Text("fig10") => Value::Float(0.01),
            _ => Value::None,
        })
        .when(|params| matches!(params.value("weight"), Value::Text("inv_pow" | "exp" | "fig10")));
/// The depth scale g.
pub const WEIGHT_SCALE: ParamSpec =
    ParamSpec::new("weight_scale", Kind::POSITIVE, Value::Float(1.0), "weights see scale * z + shift")
        .when(depth_matters);
/// The depth shift s.
pub const WEIGHT_SHIFT: ParamSpec = ParamSpec::new(
    "weight_shift",
    Kind::REAL,
    Value::Float(0.0),
    "weights see scale * z + shift, at least 1e-4 (FEE21 section 3.4)",
)
.when(depth_matters);
/// The near plane of mb10, i3d16 and window depth.
pub const NEAR: ParamSpec = ParamSpec::new(
    "near",
    Kind::POSITIVE,
    Value::None,
    "view depth at which window depth is 0 (MB13 eq. 11)",
)
.derived("the camera's", |_, view| Value::Float(view.near))
.when(planes_matter);
/// The far plane of mb10, i3d16 and window depth.
pub const FAR: ParamSpec =
    ParamSpec::new("far", Kind::POSITIVE, Value::None, "view depth at which window depth is 1 (MB13 eq. 11)")
        .derived("the camera's", |_, view| Value::Float(view.far))
        .when(planes_matter);

#[cfg(test)]
mod tests;
