//! The accumulator of blended techniques in any storage format: the same sums as [`BlendSums`], each result of a blend
//! rounded to its target's format (sheet 1.3, "Storage").
//!
//! Sources `w C` are float32, as a shader hands them over, and so are blend factors; in f64 nothing is rounded to less.
//!
//! [`BlendSums`]: super::sums::BlendSums

use super::scaled::{Power, exponent_of, times_power};
use super::sums::{FAINT, Sums, precise_coverage};
use crate::format::{Format, Formats, Summation};
use crate::fragments::List;
use crate::params::Params;
use crate::technique::Properties;
use crate::weight::Weighting;
use glam::DVec3;

/// What is stored in which format, and how.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Recipe {
    /// Σ w C.
    pub rgb: Format,
    /// Σ w a.
    pub alpha: Format,
    /// R.
    pub revealage: Format,
    /// The number of fragments.
    pub count: Format,
    /// How the sums are kept.
    pub summation: Summation,
    /// Whether colours are stored as their luminance.
    pub monochrome: bool,
}

impl Recipe {
    /// That of the params, for sums in a target "accumulation" and all else in double precision.
    pub fn from_params(formats: &Formats, params: &Params) -> Self {
        let accumulation = formats.of("accumulation");
        Self {
            rgb: accumulation,
            alpha: accumulation,
            revealage: Format::F64,
            count: Format::F64,
            summation: Summation::from_name(params.text("summation")),
            monochrome: false,
        }
    }

    /// The bytes per pixel of these formats, of which `sums` are those of the sums.
    pub fn bytes_per_pixel(self, formats: &Formats, sums: f64) -> f64 {
        const EXPONENT: f64 = 4.0;
        let all = formats.bytes_per_pixel();
        let rest = if is_signed(self.rgb) { sums } else { Format::F16.bytes(4) };
        match self.summation {
            Summation::Plain => all,
            Summation::Compensated => all + rest,
            // R as the sum of its logarithms in 64 bits, where there is one
            Summation::Fixed => {
                let revealage = formats.bytes_of("revealage");
                let logarithm = if revealage > 0.0 { 8.0 - revealage } else { 0.0 };
                all - sums + 4.0 * f64::from(integer_bits(self.rgb)) / 8.0 + logarithm
            }
            Summation::Scaled => all + EXPONENT,
            Summation::ScaledDouble => all + rest + EXPONENT,
        }
    }

    /// What a technique with these promises still promises.
    pub fn properties(self, promises: Properties) -> Properties {
        let fixed = self.summation == Summation::Fixed;
        let single = |format| matches!(format, Format::F64 | Format::F32);
        let sums = single(self.rgb) && single(self.alpha) && !fixed && !self.monochrome;
        let coverage = self.revealage == Format::F64 && !fixed;
        Properties {
            unbiased: promises.unbiased && sums && coverage,
            consistent: promises.consistent && sums && coverage,
            exact_for_one: promises.exact_for_one && sums && coverage,
            exact_for_one_color: promises.exact_for_one_color && sums && coverage,
            exact_coverage: promises.exact_coverage && coverage,
            ..promises
        }
    }

    /// The weights of fragments as [`StoredSums::add`] wants them; all weigh the same where there is no weighting.
    pub fn weigh(self, weighting: Option<&Weighting>, depth: &[f32], alpha: &[f32], weights: &mut Vec<f64>) {
        let scaled = self.summation.is_scaled();
        let Some(weighting) = weighting else {
            weights.clear();
            return weights.resize(depth.len(), self.one());
        };
        if scaled {
            weighting.evaluate_log2(depth, alpha, weights);
        } else if self.rgb == Format::F64 {
            weighting.evaluate_f64(depth, alpha, weights);
        } else {
            let mut single = Vec::new();
            weighting.evaluate(depth, alpha, &mut single);
            weights.clear();
            weights.extend(single.into_iter().map(f64::from));
        }
    }

    /// The weight of a fragment that counts once.
    pub fn one(self) -> f64 {
        if self.summation.is_scaled() { 0.0 } else { 1.0 }
    }

    /// So much of a weight.
    pub fn times(self, weight: f64, share: f64) -> f64 {
        if self.summation.is_scaled() { weight + share.log2() } else { self.source(weight * share) }
    }

    /// The sums over a list.
    pub fn blend_list(
        self,
        weighting: Option<&Weighting>,
        list: List<'_>,
        weights: &mut Vec<f64>,
    ) -> StoredSums {
        let mut sums = StoredSums::CLEAR;
        self.weigh(weighting, list.depth, list.alpha, weights);
        for ((&weight, &color), &alpha) in weights.iter().zip(list.color).zip(list.alpha) {
            sums.add(self, weight, color, alpha);
        }
        sums
    }

    /// The format of one channel of the sums.
    fn of(self, channel: usize) -> Format {
        if channel < 3 { self.rgb } else { self.alpha }
    }

    fn round(self, texel: &mut [f64; 4]) {
        if self.rgb == self.alpha {
            self.rgb.round_texel(texel);
        } else {
            let (rgb, alpha) = texel.split_at_mut(3);
            self.rgb.round_texel(rgb);
            self.alpha.round_texel(alpha);
        }
    }

    /// Rounds what the sums leave, which may be negative: a half stands in where the format knows no sign.
    fn round_rest(self, texel: &mut [f64; 4]) {
        let signed = |format| if is_signed(format) { format } else { Format::F16 };
        Self { rgb: signed(self.rgb), alpha: signed(self.alpha), ..self }.round(texel);
    }

    /// A number that a shader hands over.
    #[expect(clippy::cast_possible_truncation, reason = "shaders compute in f32")]
    fn source(self, x: f64) -> f64 {
        if self.rgb == Format::F64 { x } else { f64::from(x as f32) }
    }

    /// The exponent that the largest scaled sum is kept at: two bits of headroom, for one more fragment as large.
    fn scaled_top(self) -> i64 {
        let least = |format: Format| exponent_of(format.max_finite(0)) - 2;
        least(self.rgb).min(least(self.alpha)).min(200)
    }
}

/// Whether a format has negative numbers.
fn is_signed(format: Format) -> bool {
    matches!(format, Format::F64 | Format::F32 | Format::F16 | Format::Bf16 | Format::Snorm8)
}

/// Bits of the integers that [`Summation::Fixed`] keeps sums in.
fn integer_bits(format: Format) -> u32 {
    match format {
        Format::R11g11b10f | Format::Rgb9e5 => 32,
        _ => (2 * format.bits(1)).next_power_of_two(),
    }
}

/// Rec. 709 luminance.
fn luminance(color: DVec3) -> f64 {
    color.dot(DVec3::new(0.2126, 0.7152, 0.0722))
}

/// −ln R in fixed point: a product's bits depend on the order of its factors, a sum of integers does not.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FixedLog {
    quanta: i64,
}

impl FixedLog {
    /// Quanta per unit.
    const QUANTA: f64 = 281_474_976_710_656.0; // 2^48

    /// `R ← (1 − coverage) R`; beyond 2^15 it saturates, where R has long been 0.
    #[expect(clippy::cast_possible_truncation, reason = "saturates")]
    pub fn attenuate(&mut self, coverage: f64) {
        let quanta = (-(-coverage).ln_1p() * Self::QUANTA).round_ties_even() as i64;
        self.quanta = self.quanta.saturating_add(quanta);
    }

    /// R and 1 − R.
    #[expect(clippy::cast_precision_loss, reason = "read as f64")]
    pub fn shares(self) -> (f64, f64) {
        let log = -(self.quanta as f64 / Self::QUANTA);
        (log.exp(), -log.exp_m1())
    }
}

/// What the targets of a pixel hold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StoredSums {
    /// Σ w (C, a).
    sums: [f64; 4],
    /// Its rounding errors, or what its first number leaves of it.
    rest: [f64; 4],
    /// The power of two that scaled sums are multiples of; none before the first.
    exponent: Option<i64>,
    integers: [i128; 4],
    /// R, if sums are integers.
    log: FixedLog,
    /// Whether an integer was too small.
    pub saturated: bool,
    transmittance: f64,
    /// 1 − R of faint fragments, if R is in f64.
    coverage: f64,
    count: f64,
}

impl StoredSums {
    /// The targets as they are cleared.
    pub const CLEAR: Self = Self {
        sums: [0.0; 4],
        rest: [0.0; 4],
        exponent: None,
        integers: [0; 4],
        log: FixedLog { quanta: 0 },
        saturated: false,
        transmittance: 1.0,
        coverage: 0.0,
        count: 0.0,
    };

    /// Blends in a fragment of a weight by [`Recipe::weigh`].
    pub fn add(&mut self, recipe: Recipe, weight: f64, color: [f32; 3], alpha: f32) {
        let coverage = f64::from(alpha);
        self.add_share(recipe, weight, color, alpha, coverage, 1.0 - coverage);
    }

    /// Blends in a fragment that covers another part of what is behind than its alpha says: `coverage`, which
    /// leaves `transmittance`.
    pub fn add_share(
        &mut self,
        recipe: Recipe,
        weight: f64,
        color: [f32; 3],
        alpha: f32,
        coverage: f64,
        transmittance: f64,
    ) {
        let color = DVec3::from(color.map(f64::from));
        let color = if recipe.monochrome { DVec3::splat(luminance(color)) } else { color };
        let texel = color.extend(alpha.into()).to_array();
        let sources = || texel.map(|x| recipe.source(weight * x));
        match recipe.summation {
            Summation::Plain => self.add_plain(recipe, sources()),
            Summation::Compensated => self.add_compensated(recipe, sources()),
            Summation::Fixed => self.add_fixed(recipe, sources()),
            Summation::Scaled | Summation::ScaledDouble => self.add_scaled(recipe, weight, texel),
        }
        self.attenuate(recipe, coverage, transmittance);
        self.count = recipe.count.round(recipe.count.blend(self.count, 1.0, 1.0));
    }

    fn add_plain(&mut self, recipe: Recipe, sources: [f64; 4]) {
        for (channel, source) in sources.into_iter().enumerate() {
            self.sums[channel] = recipe.of(channel).blend(self.sums[channel], 1.0, source);
        }
        recipe.round(&mut self.sums);
    }

    /// Neumaier's variant of Kahan's sum: what a rounding cut off, of the sum or of the source, goes to the rest.
    fn add_compensated(&mut self, recipe: Recipe, sources: [f64; 4]) {
        let before = self.sums;
        self.add_plain(recipe, sources);
        for channel in 0..4 {
            let format = recipe.of(channel);
            let source = format.clamp_source(sources[channel]);
            let (before, after) = (before[channel], self.sums[channel]);
            let (large, small) =
                if before.abs() >= source.abs() { (before, source) } else { (source, before) };
            let error = (large - after) + small;
            // what is beyond the largest number is lost, not left
            self.rest[channel] += if after.abs() < format.max_finite(channel) { error } else { 0.0 };
        }
        recipe.round_rest(&mut self.rest);
    }

    /// In integers of which half the bits count what is below 1.
    #[expect(clippy::cast_possible_truncation, reason = "what does not fit saturates")]
    fn add_fixed(&mut self, recipe: Recipe, sources: [f64; 4]) {
        for (channel, source) in sources.into_iter().enumerate() {
            let bits = integer_bits(recipe.of(channel));
            let largest = i128::MAX >> (128 - bits);
            let quanta = (source * Power::of_two(i64::from(bits / 2)).as_f64()).round_ties_even() as i128;
            let sum = self.integers[channel].saturating_add(quanta);
            self.integers[channel] = sum.clamp(-largest, largest);
            self.saturated |= self.integers[channel].abs() == largest;
        }
    }

    /// `R ← (1 − a) R`.
    #[expect(clippy::cast_possible_truncation, reason = "blend factors are f32")]
    fn attenuate(&mut self, recipe: Recipe, coverage: f64, transmittance: f64) {
        if recipe.summation == Summation::Fixed {
            self.log.attenuate(coverage);
        } else if recipe.revealage == Format::F64 {
            self.transmittance *= transmittance;
            self.coverage += (1.0 - self.coverage) * if coverage <= FAINT { coverage } else { 0.0 };
        } else {
            let factor = f64::from(transmittance as f32);
            self.transmittance =
                recipe.revealage.round(recipe.revealage.blend(self.transmittance, factor, 0.0));
        }
    }

    /// What a resolve reads.
    pub fn read(&self, recipe: Recipe) -> Sums {
        let sums = self.read_sums(recipe);
        let (transmittance, coverage) = self.read_shares(recipe);
        Sums {
            color: DVec3::new(sums[0], sums[1], sums[2]),
            alpha: sums[3],
            transmittance,
            coverage,
            count: self.count,
        }
    }

    #[expect(clippy::cast_precision_loss, reason = "read as f64")]
    fn read_sums(&self, recipe: Recipe) -> [f64; 4] {
        let mut texel = [0.0; 4];
        for (channel, read) in texel.iter_mut().enumerate() {
            let format = recipe.of(channel);
            *read = match recipe.summation {
                Summation::Fixed => {
                    let quantum = Power::of_two(-i64::from(integer_bits(format) / 2));
                    self.integers[channel] as f64 * quantum.as_f64()
                }
                _ => format.read_channel(self.sums[channel], channel) + self.rest[channel],
            };
        }
        // how a common factor is chosen beyond f64's range makes no difference to an average
        let exponent = self.exponent.unwrap_or(0).clamp(-700, 700);
        texel.map(|x| times_power(x, exponent))
    }

    /// R and 1 − R.
    fn read_shares(&self, recipe: Recipe) -> (f64, f64) {
        if recipe.summation == Summation::Fixed {
            return self.log.shares();
        }
        let transmittance = self.transmittance;
        if recipe.revealage == Format::F64 {
            return (transmittance, precise_coverage(transmittance, self.coverage));
        }
        (transmittance, 1.0 - transmittance)
    }
}

impl StoredSums {
    /// Sums that are multiples of a power of two, which rises when the largest of them would outgrow its place; `log2`
    /// is the weight's logarithm.
    fn add_scaled(&mut self, recipe: Recipe, log2: f64, texel: [f64; 4]) {
        let weight = Power::exp2(log2);
        let largest = texel.iter().fold(0.0_f64, |largest, x| largest.max(x.abs())) * weight.mantissa;
        if largest == 0.0 {
            return;
        }
        let top = recipe.scaled_top();
        let wanted = weight.exponent + exponent_of(largest) - top;
        let exponent = *self.exponent.get_or_insert(wanted);
        if wanted > exponent {
            self.rescale(recipe, wanted);
        }
        self.add_shifted(recipe, weight, texel, top);
    }

    fn add_shifted(&mut self, recipe: Recipe, weight: Power, texel: [f64; 4], top: i64) {
        let exponent = self.exponent.unwrap_or(0);
        let sources =
            texel.map(|x| recipe.source(times_power(x * weight.mantissa, weight.exponent - exponent)));
        let total: [f64; 4] = std::array::from_fn(|i| self.sums[i] + (self.rest[i] + sources[i]));
        let largest = total.iter().fold(0.0_f64, |largest, x| largest.max(x.abs()));
        if exponent_of(largest) > top {
            self.rescale(recipe, exponent + 1);
            return self.add_shifted(recipe, weight, texel, top);
        }
        self.sums = total;
        recipe.round(&mut self.sums);
        if recipe.summation == Summation::ScaledDouble {
            self.rest = std::array::from_fn(|i| total[i] - self.sums[i]);
            recipe.round_rest(&mut self.rest);
        }
    }

    fn rescale(&mut self, recipe: Recipe, exponent: i64) {
        let by = self.exponent.unwrap_or(exponent) - exponent;
        self.exponent = Some(exponent);
        for texel in [&mut self.sums, &mut self.rest] {
            texel.iter_mut().for_each(|x| *x = times_power(*x, by));
        }
        recipe.round(&mut self.sums);
        recipe.round_rest(&mut self.rest);
    }
}

pub mod diagnose;
#[cfg(test)]
mod tests;
