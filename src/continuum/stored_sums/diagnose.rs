//! What went wrong with blended sums: they are blended once more, and each target looked at before and after.

use super::{Recipe, StoredSums, integer_bits};
use crate::continuum::sums::{Blended, Sums};
use crate::diagnosis::{Diagnosis, Fault, Faults};
use crate::format::{Format, Summation};
use crate::fragments::List;

impl Recipe {
    /// Sums in f32 and R in f64, as they are streamed.
    pub const SINGLE: Self = Self {
        rgb: Format::F32,
        alpha: Format::F32,
        revealage: Format::F64,
        count: Format::F64,
        summation: Summation::Plain,
        monochrome: false,
    };

    /// What can go wrong with its targets.
    pub fn faults(self) -> Faults {
        let mut faults = Faults::of(&[Fault::Underflow, Fault::Stagnation]);
        faults = match self.summation {
            Summation::Plain | Summation::Compensated => {
                faults.union(Faults::of_format(self.rgb)).union(Faults::of_format(self.channel(3)))
            }
            Summation::Fixed => faults.and(&[Fault::Saturation]),
            Summation::Scaled | Summation::ScaledDouble => faults,
        };
        if self.subtracts_revealage() { faults.and(&[Fault::Cancellation]) } else { faults }
    }

    /// Whether 1 − R is read from R alone.
    fn subtracts_revealage(self) -> bool {
        self.revealage != Format::F64 && self.summation != Summation::Fixed
    }

    /// The format that one channel of the sums is in by itself.
    fn channel(self, channel: usize) -> Format {
        if channel < 3 { self.rgb } else { self.alpha.of_alpha() }
    }
}

impl StoredSums {
    /// [`StoredSums::add_share`], and what it does to the targets.
    #[expect(clippy::too_many_arguments, reason = "those of add_share, and where to write")]
    pub fn add_watched(
        &mut self,
        recipe: Recipe,
        weight: f64,
        color: [f32; 3],
        alpha: f32,
        coverage: f64,
        transmittance: f64,
        found: &mut Diagnosis,
    ) {
        let before = *self;
        self.add_share(recipe, weight, color, alpha, coverage, transmittance);
        let [r, g, b] = color;
        let mut faults = Faults::NONE;
        for (channel, x) in [r, g, b, alpha].into_iter().enumerate().filter(|(_, x)| *x != 0.0) {
            // a monochrome sum has other sources, as small and as large
            let source = if recipe.summation.is_scaled() { f64::NAN } else { weight * f64::from(x) };
            faults = faults.union(self.faults_of(recipe, &before, channel, source));
        }
        if coverage != 0.0 {
            faults = faults.union(self.revealage_faults(recipe, &before, transmittance));
        }
        if self.count == before.count {
            faults = faults.and(&[Fault::Stagnation]);
        }
        found.count_all(faults);
    }

    /// What a source that is not 0 did to a channel of the sums.
    fn faults_of(&self, recipe: Recipe, before: &Self, channel: usize, source: f64) -> Faults {
        let format = recipe.channel(channel);
        let (old, new) = (before.sums[channel], self.sums[channel]);
        let same = old == new
            && before.exponent == self.exponent
            && before.rest[channel] == self.rest[channel]
            && before.integers[channel] == self.integers[channel];
        let mut faults = Faults::NONE;
        match recipe.summation {
            Summation::Fixed => {
                let largest = i128::MAX >> (128 - integer_bits(recipe.of(channel)));
                if self.integers[channel].abs() == largest {
                    return Faults::of(&[Fault::Saturation]);
                }
                if self.integers[channel] == 0 {
                    return Faults::of(&[Fault::Underflow]);
                }
            }
            Summation::Plain | Summation::Compensated => {
                if !new.is_finite() {
                    return if old.is_finite() { Faults::of(&[Fault::Overflow]) } else { Faults::NONE };
                }
                if !format.has_infinity() && old + source > format.max_finite(channel) {
                    return Faults::of(&[Fault::Saturation]);
                }
                if new.abs() < format.smallest_normal() {
                    faults = faults.and(&[Fault::Underflow]);
                }
            }
            Summation::Scaled | Summation::ScaledDouble => {}
        }
        let flushed = new == 0.0 && self.integers[channel] == 0;
        if same && !(flushed && faults.has(Fault::Underflow)) {
            faults = faults.and(&[Fault::Stagnation]);
        }
        faults
    }

    /// What a factor other than 1 did to R.
    fn revealage_faults(&self, recipe: Recipe, before: &Self, factor: f64) -> Faults {
        let (old, new) = (before.transmittance, self.transmittance);
        if recipe.summation == Summation::Fixed {
            let same = before.log == self.log && before.log.shares().0 > 0.0;
            return if same { Faults::of(&[Fault::Underflow]) } else { Faults::NONE };
        }
        // in f64 R is kept together with 1 − R, and small enough long before it underflows
        if old == 0.0 || factor == 0.0 || recipe.revealage == Format::F64 {
            return Faults::NONE;
        }
        let mut faults = Faults::NONE;
        if new < recipe.revealage.smallest_normal() {
            faults = faults.and(&[Fault::Underflow]);
        }
        if old == new {
            faults = faults.and(&[Fault::Stagnation]);
        }
        faults
    }

    /// What a resolve meets when it reads the targets, of a pixel or bin where something covers.
    pub fn read_watched(&self, recipe: Recipe, found: &mut Diagnosis) -> Sums {
        let broken = self.sums.iter().filter(|x| !x.is_finite()).count();
        (0..broken).for_each(|_| found.count(Fault::NonFinite));
        if recipe.subtracts_revealage() && self.sums[3] > 0.0 {
            found.cancel(1.0, self.transmittance, recipe.revealage);
        }
        self.read(recipe)
    }
}

/// What can go wrong with a technique whose sums are stored by `recipe`.
pub fn faults<T: Blended>(technique: &T, recipe: Recipe) -> Faults {
    let subtracts = technique.subtracts_alpha();
    if subtracts { recipe.faults().and(&[Fault::Cancellation]) } else { recipe.faults() }
}

/// What went wrong with them.
pub fn diagnose<T: Blended>(technique: &T, recipe: Recipe, list: List<'_>) -> Diagnosis {
    let mut weights = Vec::new();
    recipe.weigh(technique.weighting(), list.depth, list.alpha, &mut weights);
    let (mut found, sums) = diagnose_weighted(recipe, &weights, list);
    if technique.subtracts_alpha() {
        found.cancel(1.0, sums.alpha, recipe.alpha.of_alpha());
    }
    found
}

/// What went wrong with sums of these weights, and what is read of them.
pub fn diagnose_weighted(recipe: Recipe, weights: &[f64], list: List<'_>) -> (Diagnosis, Sums) {
    let (mut sums, mut found) = (StoredSums::CLEAR, Diagnosis::CLEAR);
    for ((&weight, &color), &alpha) in weights.iter().zip(list.color).zip(list.alpha) {
        let coverage = f64::from(alpha);
        sums.add_watched(recipe, weight, color, alpha, coverage, 1.0 - coverage, &mut found);
    }
    let read = sums.read_watched(recipe, &mut found);
    (found, read)
}

#[cfg(test)]
mod tests {
    use crate::diagnosis::Fault;
    use crate::fragments::Fragment;
    use crate::params::Input;
    use crate::techniques::testing::{as_pixel, build, fragment, random_pixel};

    fn found(id: &str, inputs: &[(&str, &str)], pixel: &[Fragment]) -> Vec<(Fault, f32)> {
        let inputs: Vec<_> = inputs.iter().map(|(name, x)| (*name, Input::Text((*x).into()))).collect();
        let technique = build(id, &inputs).unwrap();
        let diagnosis = as_pixel(pixel, |pixel| technique.diagnose(pixel));
        let amounts = technique.faults().iter().map(|fault| (fault, diagnosis.amount(fault)));
        amounts.filter(|(_, amount)| *amount > 0.0).collect()
    }

    fn layers(n: u32, depth: f32, alpha: f32) -> Vec<Fragment> {
        (0..n).map(|i| fragment(depth, [1.0; 3], alpha, i)).collect()
    }

    const HALF: (&str, &str) = ("format", "f16");

    /// MB13 §3.2, sheet R12: weights of 3000 fill halves with 21 opaque layers; the 22nd overflows, in four channels.
    #[test]
    fn overflow_by_hand() {
        let stack = |n| found("wboit", &[HALF, ("revealage_format", "f64")], &layers(n, 0.1, 1.0));
        assert_eq!(stack(21), []);
        assert_eq!(stack(22), [(Fault::Overflow, 1.0), (Fault::NonFinite, 4.0)]);
        assert_eq!(stack(30), [(Fault::Overflow, 1.0), (Fault::NonFinite, 4.0)]);
        let scaled = [HALF, ("revealage_format", "f64"), ("summation", "scaled_double")];
        assert_eq!(found("wboit", &scaled, &layers(30, 0.1, 1.0)), []);
    }

    /// In 8 bits an alpha below 1/510 is a no-op; beside 2048 ones a half does not see another.
    #[test]
    fn stagnation_by_hand() {
        let faint = layers(7, 1.0, 1.0 / 511.0);
        let got = found("wboit", &[("revealage_format", "unorm8")], &faint);
        assert_eq!(got[0], (Fault::Stagnation, 7.0));
        // 1 − R is 0, whatever there was
        assert_eq!(got[1].0, Fault::Cancellation);
        assert!((got[1].1 - 510.0_f32.log2()).abs() < 1e-6);
        let many = found("weighted_average", &[HALF], &layers(2050, 1.0, 0.5));
        // sums of 1/2 end at 1024, after 2048 layers, and so does the count
        assert_eq!(many, [(Fault::Stagnation, 2.0)]);
        assert_eq!(found("weighted_average", &[("format", "f32")], &layers(2050, 1.0, 0.5)), []);
    }

    /// z^-4 a of a fragment that is far is no normal half, and none at all farther away.
    #[test]
    fn underflow_by_hand() {
        let params = [HALF, ("revealage_format", "f64"), ("weight", "inv_pow")];
        let far = |depth| found("wboit", &params, &layers(3, depth, 0.5));
        assert_eq!(far(2.0), []);
        // 1/20^4 / 2 = 3.1e-6, 1/100^4 / 2 = 5e-9
        assert_eq!(far(20.0), [(Fault::Underflow, 3.0)]);
        assert_eq!(far(100.0), [(Fault::Underflow, 3.0)]);
    }

    #[test]
    fn saturation_by_hand() {
        let stack = |n| found("weighted_sum", &[("format", "unorm8")], &layers(n, 1.0, 0.4));
        // 2/5 are 102 steps, five quarters of 1 more than there are
        assert!(stack(2).iter().all(|(fault, _)| *fault == Fault::Cancellation));
        assert_eq!(stack(4)[0], (Fault::Saturation, 2.0));
        // 32 bits, 16 of which are below the point, end at 32768: eleven layers of 3000
        let fixed = [HALF, ("summation", "fixed")];
        assert_eq!(found("wboit", &fixed, &layers(10, 0.1, 1.0)), []);
        assert_eq!(found("wboit", &fixed, &layers(11, 0.1, 1.0)), [(Fault::Saturation, 1.0)]);
    }

    /// 1 − Σ a of three layers of 1/4 is a quarter of what it is made of sevenfold.
    #[test]
    fn cancellation_by_hand() {
        let got = found("weighted_sum", &[], &layers(3, 1.0, 0.25));
        assert_eq!(got.len(), 1);
        assert!(got[0].0 == Fault::Cancellation && (got[0].1 - 7.0_f32.log2()).abs() < 1e-6);
        assert_eq!(found("weighted_sum", &[], &layers(4, 1.0, 0.25)), [(Fault::Cancellation, 24.0)]);
        // R = 3/4 in a half: the same
        let revealage = found("wboit", &[("revealage_format", "f16")], &layers(1, 1.0, 0.25));
        assert!((revealage[0].1 - 7.0_f32.log2()).abs() < 1e-6, "{revealage:?}");
    }

    #[test]
    fn ordinary_pixels_are_well() {
        for id in ["weighted_average", "blended_oit", "wboit", "phenomenological", "gs_wsr"] {
            for seed in 0..20 {
                assert_eq!(found(id, &[], &random_pixel(20, seed)), [], "{id}");
            }
        }
    }

    #[test]
    fn lists_of_lwboit_say_what_nodes_do() {
        let far = [fragment(7e4, [1.0; 3], 0.5, 0), fragment(2.0, [7e4, 1.0, 1e-6], 1.0, 1)];
        let got = found("lwboit", &[("storage", "ll"), ("node_depth_format", "f16")], &far);
        assert_eq!(got[..2], [(Fault::Overflow, 1.0), (Fault::NonFinite, 1.0)]);
        let got = found("lwboit", &[("storage", "ll"), ("node_color_format", "f16")], &far);
        assert!(got.contains(&(Fault::Overflow, 1.0)) && got.contains(&(Fault::Underflow, 1.0)), "{got:?}");
    }

    #[test]
    fn bins_of_lwboit_are_watched_one_by_one() {
        let got = found("lwboit", &[HALF, ("weight", "mb7")], &layers(30, 1.0, 1.0));
        assert_eq!(got.iter().find(|(fault, _)| *fault == Fault::Overflow).map(|x| x.1 > 0.0), Some(true));
        assert_eq!(found("lwboit", &[HALF], &[]), []);
    }
}
