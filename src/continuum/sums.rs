//! The accumulator of blended techniques: weighted sums and a product, as render targets hold them.

use crate::fragments::List;
use crate::technique::{FinishedPixels, Resolved};
use crate::weight::Weighting;
use glam::{DVec3, Vec3, Vec4};
use multiversion::multiversion;

/// What additive and multiplicative blending leave of a set of fragments (MB13 Listing 3): Σ w (C, a) in f32,
/// and the background's share R = Π (1 − a).
///
/// R is kept in f64, and so is 1 − R as long as all fragments are [faint](FAINT): R is the small one behind opaque
/// fragments, 1 − R behind faint ones, and "background coverage is exact" (MB13 §3.2) is worth having after 10⁴
/// layers too. One fragment that is not faint makes 1 − R a difference that loses no more than 11 of 53 bits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BlendSums {
    weighted: Vec4,
    transmittance: f64,
    /// 1 − R of the faint fragments.
    coverage: f64,
}

/// Coverages up to here are faint.
pub const FAINT: f64 = 1.0 / 1024.0;

/// 1 − R from both of what is kept.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
pub(super) fn precise_coverage(transmittance: f64, faint: f64) -> f64 {
    // half of it, so that no rounding makes a fragment that is not faint go unseen
    if 1.0 - transmittance > 0.5 * FAINT { 1.0 - transmittance } else { faint }
}

impl BlendSums {
    /// The targets as they are cleared.
    pub const CLEAR: Self = Self { weighted: Vec4::ZERO, transmittance: 1.0, coverage: 0.0 };

    /// Blends in a fragment.
    pub fn add(&mut self, weight: f32, color: [f32; 3], alpha: f32) {
        let alpha64 = f64::from(alpha);
        self.add_share(weight, color, alpha, alpha64, 1.0 - alpha64);
    }

    /// Blends in a fragment that covers another part of what is behind than its alpha says: `coverage`, which
    /// leaves `transmittance`.
    pub fn add_share(&mut self, weight: f32, color: [f32; 3], alpha: f32, coverage: f64, transmittance: f64) {
        self.weighted += weight * Vec3::from(color).extend(alpha);
        self.transmittance *= transmittance;
        self.coverage += (1.0 - self.coverage) * if coverage <= FAINT { coverage } else { 0.0 };
    }

    /// Σ w C; what overflows f32 counts as its largest number.
    pub fn color(&self) -> DVec3 {
        self.weighted.truncate().min(Vec3::MAX).as_dvec3()
    }

    /// Σ w a.
    pub fn alpha(&self) -> f64 {
        self.weighted.w.min(f32::MAX).into()
    }

    /// R = Π (1 − a).
    pub fn transmittance(&self) -> f64 {
        self.transmittance
    }

    /// 1 − R, precise where R is near 1.
    pub fn coverage(&self) -> f64 {
        precise_coverage(self.transmittance, self.coverage)
    }

    /// The unmultiplied average colour Σ w C / Σ w a; none where nothing covers.
    pub fn average(&self) -> Option<DVec3> {
        let alpha = self.alpha();
        (alpha > 0.0).then(|| self.color() / alpha)
    }

    /// MB13 eq. 6: the average covers 1 − R of the background. One division for all channels.
    pub fn over(&self, background: DVec3) -> Resolved {
        self.read(0).over(background)
    }

    /// What a resolve reads of the sums over `count` fragments.
    #[expect(clippy::cast_precision_loss, reason = "a pixel's list is far shorter than 2^52")]
    pub fn read(&self, count: usize) -> Sums {
        Sums {
            color: self.color(),
            alpha: self.alpha(),
            transmittance: self.transmittance(),
            coverage: self.coverage(),
            count: count as f64,
        }
    }
}

/// What a resolve reads of a pixel's targets.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sums {
    /// Σ w C.
    pub color: DVec3,
    /// Σ w a.
    pub alpha: f64,
    /// R = Π (1 − a).
    pub transmittance: f64,
    /// 1 − R.
    pub coverage: f64,
    /// The number of fragments.
    pub count: f64,
}

impl Sums {
    /// MB13 eq. 6: the average covers 1 − R of the background. One division for all channels.
    pub fn over(&self, background: DVec3) -> Resolved {
        if self.alpha > 0.0 {
            blend(self.color, self.coverage / self.alpha, self.transmittance, background)
        } else {
            // no colour, because nothing covers or because the format lost it; R is what it is
            blend(DVec3::ZERO, 0.0, self.transmittance, background)
        }
    }

    /// MB13 eq. 4: `count` copies of the mean fragment, one over the other.
    pub fn over_as_mean(&self, background: DVec3) -> Resolved {
        if self.alpha <= 0.0 {
            return Resolved::background(background);
        }
        let (coverage, transmittance) = self.mean_coverage();
        blend(self.color / self.alpha, coverage, transmittance, background)
    }

    /// What `count` copies of the mean fragment cover of the background, and what they leave of it.
    pub fn mean_coverage(&self) -> (f64, f64) {
        let mean_alpha = (self.alpha / self.count.max(1.0)).min(1.0);
        let log_transmittance = self.count * (-mean_alpha).ln_1p();
        (-log_transmittance.exp_m1(), log_transmittance.exp())
    }

    /// `(1 − R) color + R background`.
    pub fn cover(&self, color: DVec3, background: DVec3) -> Resolved {
        blend(color, self.coverage, self.transmittance, background)
    }
}

/// The sums of many pixels, and what they are to cover.
#[derive(Debug, Clone, Copy)]
pub struct SumsOf<'a> {
    /// Σ w (r, g, b, a).
    pub weighted: &'a [[f32; 4]],
    /// R.
    pub transmittance: &'a [f64],
    /// 1 − R of the faint fragments.
    pub coverage: &'a [f64],
    /// Fragments per pixel.
    pub counts: &'a [u32],
    /// The opaque colours behind them.
    pub background: Behind<'a>,
}

/// What is behind many pixels.
#[derive(Debug, Clone, Copy)]
pub enum Behind<'a> {
    /// The same everywhere.
    One([f32; 3]),
    /// A colour per pixel.
    Each(&'a [[f32; 3]]),
}

impl Behind<'_> {
    fn at(&self, pixel: usize) -> [f32; 3] {
        match self {
            Self::One(color) => *color,
            Self::Each(colors) => colors[pixel],
        }
    }
}

impl SumsOf<'_> {
    /// How many pixels there are.
    fn pixels(&self) -> usize {
        self.counts.len()
    }

    /// [`BlendSums::over`] for all pixels: its arithmetic, operation by operation.
    pub fn over(&self, out: &mut FinishedPixels) {
        out.resize(self.pixels());
        over(*self, out.planes_mut());
    }
}

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn over(sums: SumsOf<'_>, planes: [&mut [f64]; 4]) {
    match sums.background {
        Behind::One(color) => over_by(sums, |_| color, planes),
        Behind::Each(colors) => {
            let colors = &colors[..sums.pixels()];
            over_by(sums, |i| colors[i], planes);
        }
    }
}

#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn over_by(sums: SumsOf<'_>, background: impl Fn(usize) -> [f32; 3], [r, g, b, share]: [&mut [f64]; 4]) {
    // slices of one length need no checks, and the loop becomes one of vectors across the pixels
    let pixels = sums.pixels();
    let weighted = &sums.weighted[..pixels];
    let (transmittance, coverage) = (&sums.transmittance[..pixels], &sums.coverage[..pixels]);
    let (r, g, b, share) = (&mut r[..pixels], &mut g[..pixels], &mut b[..pixels], &mut share[..pixels]);
    let finite = |sum: f32| f64::from(if sum < f32::MAX { sum } else { f32::MAX });
    let largest = f64::from(f32::MAX);
    for i in 0..pixels {
        let ([red, green, blue, alpha], t) = (weighted[i], transmittance[i]);
        let alpha = finite(alpha);
        let of_average = precise_coverage(t, coverage[i]) / alpha;
        let of_sums = if alpha > 0.0 { of_average } else { 0.0 };
        let blend = |sum: f32, behind: f32| {
            let blended = of_sums * finite(sum) + t * f64::from(behind);
            if blended < largest { blended } else { largest }
        };
        let behind = background(i);
        r[i] = blend(red, behind[0]);
        g[i] = blend(green, behind[1]);
        b[i] = blend(blue, behind[2]);
        share[i] = t;
    }
}

/// A technique that is nothing but [`BlendSums`] over all fragments, in any order.
pub trait Blended: Send + Sync {
    /// The weight of a fragment; all count the same where there is none.
    fn weighting(&self) -> Option<&Weighting> {
        None
    }

    /// Whether Σ a is subtracted from 1, so that digits cancel.
    fn subtracts_alpha(&self) -> bool {
        false
    }

    /// The pixel's colour from its sums.
    fn finish(&self, sums: &Sums, background: DVec3) -> Resolved;

    /// The same for many pixels, each over its background, in place of what `out` has; those without fragments
    /// are background alone.
    fn finish_all(&self, pixels: &SumsOf<'_>, out: &mut FinishedPixels) {
        finish_each(self, pixels, out);
    }

    /// The pixel's colour from its fragments.
    fn blend_list(&self, list: List<'_>, background: DVec3, weights: &mut Vec<f32>) -> Resolved {
        let mut sums = BlendSums::CLEAR;
        if let Some(weighting) = self.weighting() {
            weighting.evaluate(list.depth, list.alpha, weights);
            for ((&weight, &color), &alpha) in weights.iter().zip(list.color).zip(list.alpha) {
                sums.add(weight, color, alpha);
            }
        } else {
            for (&color, &alpha) in list.color.iter().zip(list.alpha) {
                sums.add(1.0, color, alpha);
            }
        }
        self.finish(&sums.read(list.len()), background)
    }
}

/// [`Blended::finish`] pixel by pixel.
pub fn finish_each<T: Blended + ?Sized>(technique: &T, pixels: &SumsOf<'_>, out: &mut FinishedPixels) {
    out.resize(pixels.pixels());
    for (i, &count) in pixels.counts.iter().enumerate() {
        let sums = BlendSums {
            weighted: Vec4::from(pixels.weighted[i]),
            transmittance: pixels.transmittance[i],
            coverage: pixels.coverage[i],
        };
        let background = Vec3::from(pixels.background.at(i)).as_dvec3();
        let resolved = match count {
            0 => Resolved::background(background),
            _ => technique.finish(&sums.read(count as usize), background),
        };
        out.set(i, resolved.color.extend(resolved.transmittance.x).to_array());
    }
}

/// `coverage color + transmittance background`, finite in f32 also where fragments that emit without covering
/// have driven the average beyond it (sheet R13).
pub fn blend(color: DVec3, coverage: f64, transmittance: f64, background: DVec3) -> Resolved {
    let blended = coverage * color + transmittance * background;
    Resolved::new(blended.min(DVec3::splat(f32::MAX.into())), transmittance)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sums(fragments: &[(f32, [f32; 3], f32)]) -> BlendSums {
        let mut sums = BlendSums::CLEAR;
        for &(w, c, a) in fragments {
            sums.add(w, c, a);
        }
        sums
    }

    #[test]
    fn sums_and_product_by_hand() {
        let sums = sums(&[(2.0, [0.5, 0.0, 0.25], 0.5), (1.0, [0.0, 0.25, 0.0], 0.25)]);
        assert_eq!(sums.color(), DVec3::new(1.0, 0.25, 0.5));
        assert_eq!(sums.alpha(), 1.25);
        assert_eq!(sums.average(), Some(DVec3::new(0.8, 0.2, 0.4)));
        assert_eq!((sums.transmittance(), sums.coverage()), (0.375, 0.625));
    }

    #[test]
    fn nothing_covers_nothing() {
        assert_eq!(BlendSums::CLEAR.average(), None);
        let background = DVec3::new(1.0, 2.0, 3.0);
        assert_eq!(sums(&[(1.0, [5.0; 3], 0.0)]).over(background), Resolved::background(background));
    }

    #[test]
    fn faint_and_opaque_layers_keep_their_relative_precision() {
        let faint = sums(&[(1.0, [1e-20; 3], 1e-20); 2]);
        assert!((faint.coverage() / f64::from(2e-20_f32) - 1.0).abs() < 1e-7);
        let deep = sums(&[(1.0, [0.0; 3], 0.999); 12]);
        let t: f64 = 1.0 - f64::from(0.999_f32);
        assert!((deep.transmittance() / t.powi(12) - 1.0).abs() < 1e-13);
        assert!(deep.coverage() <= 1.0);
    }

    #[test]
    fn overflow_saturates() {
        let sums = sums(&[(1e30, [1e30; 3], 0.5), (1e30, [1e30; 3], 0.5)]);
        assert!(sums.over(DVec3::ONE).color.is_finite());
    }
}
