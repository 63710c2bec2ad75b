//! Blend operations with one rounding: the sum is formed exactly, or rounded to odd, before a format rounds it.

use super::Format;

/// `a + b` rounded to odd: truncated, and odd in the last bit where anything was cut off. A format of at most 51
/// digits rounds the result as it would round the exact sum (Boldo & Melquiond 2008).
pub fn sum_to_odd(a: f64, b: f64) -> f64 {
    let sum = a + b;
    let part = sum - a;
    let error = (a - (sum - part)) + (b - part);
    let bits = sum.to_bits();
    if error == 0.0 || bits & 1 == 1 || !sum.is_finite() {
        return sum;
    }
    f64::from_bits(if (error > 0.0) == (sum > 0.0) { bits + 1 } else { bits - 1 })
}

impl Format {
    /// What a blend unit makes of a source or a factor before it blends: formats that end at 1 clamp them (Vulkan,
    /// "Blending").
    pub fn clamp_source(self, x: f64) -> f64 {
        match self {
            Self::Snorm8 => x.clamp(-1.0, 1.0),
            _ if self.is_normalized() => x.clamp(0.0, 1.0),
            _ => x,
        }
    }

    /// `destination factor + source`, before it is rounded. Products of stored numbers of up to f32 and f32 factors are
    /// exact. A factor of 0 hides what has overflowed, too. In a format of equal steps the result is rounded already: it is
    /// formed in whole steps, since stored numbers are no doubles and ties would go astray.
    pub fn blend(self, destination: f64, factor: f64, source: f64) -> f64 {
        let (factor, source) = (self.clamp_source(factor), self.clamp_source(source));
        if let Some(steps) = self.steps() {
            let sum = sum_to_odd((destination * steps).round() * factor, source * steps);
            return sum.clamp(-steps, steps).round_ties_even() / steps;
        }
        let kept = if factor == 0.0 { 0.0 } else { destination * factor };
        if self == Self::F64 { kept + source } else { sum_to_odd(kept, source) }
    }

    /// `destination + shown source`, before it is rounded, of two stored numbers and a source: what goes under what is there
    /// already. As in [`Format::blend`], equal steps are counted whole.
    pub fn under(self, destination: f64, shown: f64, source: f64) -> f64 {
        let source = self.clamp_source(source);
        if let Some(steps) = self.steps() {
            let sum = sum_to_odd((destination * steps).round(), (shown * steps).round() * source);
            return sum.clamp(-steps, steps).round_ties_even() / steps;
        }
        let added = if shown == 0.0 { 0.0 } else { shown * source };
        if self == Self::F64 { destination + added } else { sum_to_odd(destination, added) }
    }

    /// `sum + x` as additive blending leaves it in a target of one channel. A shader hands the source over in f32; in
    /// f64 nothing is rounded to less.
    #[expect(clippy::cast_possible_truncation, reason = "shaders compute in f32")]
    pub fn accumulate(self, sum: f64, x: f64) -> f64 {
        let source = if self == Self::F64 { x } else { f64::from(x as f32) };
        self.round(self.blend(sum, 1.0, source))
    }

    /// What a resolve reads: an infinite number counts as the largest one.
    pub fn read(self, stored: f64) -> f64 {
        self.read_channel(stored, 0)
    }

    /// The same of one channel of a texel: those of a packed format need not end at one number.
    pub fn read_channel(self, stored: f64, channel: usize) -> f64 {
        if stored.is_infinite() { self.max_finite(channel).copysign(stored) } else { stored }
    }

    /// The same of a whole texel.
    pub fn read_texel<const N: usize>(self, stored: [f64; N]) -> [f64; N] {
        std::array::from_fn(|channel| self.read_channel(stored[channel], channel))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_round_once() {
        // 1 + 2^-11 is half way between two f16; what lies beyond f64 decides
        let (half_way, tiny) = (1.0 + 2.0_f64.powi(-11), 2.0_f64.powi(-80));
        assert_eq!(Format::F16.round(half_way + tiny), 1.0);
        assert_eq!(Format::F16.round(sum_to_odd(half_way, tiny)), 1.0 + 2.0_f64.powi(-10));
        assert_eq!(Format::F16.round(sum_to_odd(half_way, -tiny)), 1.0);
        assert_eq!(Format::F16.round(sum_to_odd(-half_way, -tiny)), -1.0 - 2.0_f64.powi(-10));
        assert_eq!(sum_to_odd(1.5, 2.25), 3.75);
        assert_eq!(sum_to_odd(f64::INFINITY, 1.0), f64::INFINITY);
    }

    /// Sheet 0.2: halves lose all increments below a 2048th of the sum.
    #[test]
    fn halves_lose_what_is_below_a_2048th_of_the_sum() {
        let add = |format: Format, sum, x| format.accumulate(sum, x);
        assert_eq!([add(Format::F16, 1.0, 1.0 / 2049.0), add(Format::F16, 1.0, 1.0 / 2048.0)], [1.0; 2]);
        assert_eq!(add(Format::F16, 1.0, 1.0 / 2047.0), 1.0 + 2.0_f64.powi(-10));
        assert_eq!(add(Format::F32, 1.0, 1.0 / 2048.0), 1.0 + 2.0_f64.powi(-11));
        // sources are f32 unless the sum is not
        assert_eq!(add(Format::F32, 0.0, 0.1), f64::from(0.1_f32));
        assert_eq!(add(Format::F64, 0.5, 0.1), 0.5 + 0.1);
    }

    #[test]
    fn overflow_stays_until_it_is_hidden() {
        let bright = Format::F16.round(Format::F16.blend(6e4, 1.0, 6e4));
        assert_eq!((bright, Format::F16.read(bright)), (f64::INFINITY, 65_504.0));
        assert_eq!(Format::F16.blend(bright, 0.5, 1.0), f64::INFINITY);
        assert_eq!(Format::F16.blend(bright, 0.0, 1.0), 1.0);
    }

    #[test]
    fn normalized_targets_clamp_their_sources() {
        assert_eq!(Format::Unorm8.blend(0.2, 1.0, -3.0), 0.2);
        assert_eq!(Format::Unorm8.blend(0.0, 1.0, 3.0), 1.0);
        assert_eq!(Format::Snorm8.blend(0.0, 1.0, -3.0), -1.0);
        assert_eq!(Format::F16.blend(0.0, 1.0, -3.0), -3.0);
    }

    #[test]
    fn what_goes_under_is_counted_in_whole_steps() {
        // 64 + 63/2 = 95.5 and 64 + 65/2 = 96.5 steps are ties
        for (shown, expected) in [(63.0, 96.0), (65.0, 96.0), (67.0, 98.0)] {
            assert_eq!(Format::Unorm8.under(64.0 / 255.0, shown / 255.0, 0.5), expected / 255.0);
        }
        assert_eq!(Format::Unorm8.under(0.5, 1.0, 7.0), 1.0);
        assert_eq!(Format::F16.under(0.25, 0.5, 0.5), 0.5);
        assert_eq!(Format::F16.under(1.0, 0.0, f64::INFINITY), 1.0);
    }

    #[test]
    fn normalized_targets_blend_in_whole_steps() {
        // 64/255 and 159/255 are no doubles, 64/2 + 255/2 = 159.5 steps is a tie all the same
        assert_eq!(Format::Unorm8.blend(64.0 / 255.0, 0.5, 0.5), 160.0 / 255.0);
        assert_eq!(Format::Unorm8.blend(62.0 / 255.0, 0.5, 0.5), 158.0 / 255.0);
        assert_eq!(Format::Unorm8.blend(1.0, 1.0, 1.0), 1.0);
        for k in 0..=255 {
            let stored = f64::from(k) / 255.0;
            assert_eq!(Format::Unorm8.round(Format::Unorm8.blend(stored, 1.0, 0.0)), stored);
        }
    }
}
