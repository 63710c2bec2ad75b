//! Weights in f64, and their logarithms, which neither overflow nor underflow however steep a weight is.

use super::{Formula, Function, MIN_DEPTH, Planes, Seen, Weighting};

/// Weights in f64 stay within these bounds: sums of 10⁴ bright fragments are finite, and where all weights underflow the
/// average is unweighted, as it is in f32.
const BOUNDS: (f64, f64) = (1e-290, 1e290);

impl Planes {
    fn one_minus_depth_f64(self, z: f64) -> f64 {
        (f64::from(self.scale) * (z.recip() - f64::from(self.inverse_far))).clamp(0.0, 1.0)
    }
}

impl Seen {
    fn see_f64(self, z: f32) -> f64 {
        (f64::from(self.scale) * f64::from(z) + f64::from(self.shift)).max(MIN_DEPTH.into())
    }
}

impl Formula {
    /// The formulas of the f32 weights, operation by operation where no bound is needed.
    fn at(self, z: f64, a: f64) -> f64 {
        let mb = |x: f64| a * x.clamp(1e-2, 3e3);
        match self {
            Self::One => 1.0,
            Self::Mb7 => mb(10.0 / (1e-5 + (z / 5.0).powi(2) + (z / 200.0).powi(6))),
            Self::Mb8 => mb(10.0 / (1e-5 + (z / 10.0).powi(3) + (z / 200.0).powi(6))),
            Self::Mb9 => mb(0.03 / (1e-5 + (z / 200.0).powi(4))),
            Self::Mb10(planes) => a * (3e3 * planes.one_minus_depth_f64(z).powi(3)).max(1e-2),
            Self::InvPow { k } => z.powf(-f64::from(k)),
            Self::Exp { k } => (-f64::from(k) * z).exp(),
            Self::Fig1 => (z + 5.0).powi(-2),
            Self::Smoke6 => (a / z.powi(3)).powi(2),
            Self::Fig10 { k } => 10.0 / (1.0 + 10.0 * (f64::from(k) * z).powi(5)),
            Self::I3d16(planes) => {
                (1e3 * a * (0.01 + 0.99 * planes.one_minus_depth_f64(z)).powi(3)).clamp(1e-2, 30.0)
            }
        }
    }

    /// log2 w. What is steep is written as the logarithm that it is.
    fn log2_at(self, z: f64, a: f64) -> f64 {
        use std::f64::consts::LOG2_E;
        match self {
            Self::InvPow { k } => -f64::from(k) * z.log2(),
            Self::Exp { k } => -f64::from(k) * z * LOG2_E,
            Self::Fig1 => -2.0 * (z + 5.0).log2(),
            Self::Smoke6 => 2.0 * a.log2() - 6.0 * z.log2(),
            // 10 / (1 + 10 x⁵), whose x⁵ may overflow
            Self::Fig10 { k } => {
                let x = f64::from(k) * z;
                if x > 1e50 { -5.0 * x.log2() } else { self.at(z, a).log2() }
            }
            _ => self.at(z, a).log2(),
        }
    }
}

impl Weighting {
    /// The weight of every fragment in f64, within [`BOUNDS`], in `weights`, which is resized to fit.
    pub fn evaluate_f64(&self, depth: &[f32], alpha: &[f32], weights: &mut Vec<f64>) {
        self.evaluate_by(
            depth,
            alpha,
            weights,
            |formula, z, a| formula.at(z, a).clamp(BOUNDS.0, BOUNDS.1),
            |w| w,
        );
    }

    /// The binary logarithm of every fragment's weight; no weight is minus infinity.
    pub fn evaluate_log2(&self, depth: &[f32], alpha: &[f32], logs: &mut Vec<f64>) {
        self.evaluate_by(depth, alpha, logs, Formula::log2_at, f64::log2);
    }

    /// A published weight by its formula, somebody's own by what it says in f32.
    fn evaluate_by(
        &self,
        depth: &[f32],
        alpha: &[f32],
        weights: &mut Vec<f64>,
        published: impl Fn(Formula, f64, f64) -> f64,
        own: impl Fn(f64) -> f64,
    ) {
        weights.clear();
        match &self.function {
            Function::Published(formula) => {
                let fragments = depth.iter().zip(alpha);
                weights.extend(fragments.map(|(&z, &a)| published(*formula, self.seen.see_f64(z), a.into())));
            }
            Function::Own(_) => {
                let mut single = Vec::new();
                self.evaluate(depth, alpha, &mut single);
                weights.extend(single.into_iter().map(|w| own(w.into())));
            }
        }
    }
}
