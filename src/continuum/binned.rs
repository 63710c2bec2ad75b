//! Absorbance summed in depth bins: what opacity shadow maps and their kin store.

use crate::format::Format;
use std::collections::BTreeMap;

/// Up to so many bins there is a place for each; of more, only those that hold something are listed, so that
/// neither time nor memory depends on their number.
const PLACES: usize = 4096;

/// The bins of one pixel. Sums are kept in f64: taking a fragment's own share out of a bin that it dominates
/// cancels.
#[derive(Debug, Default)]
pub struct BinnedAbsorbance {
    /// Whether the bins are listed.
    listed: bool,
    /// Bin i in place i; beyond the touched ones they are empty.
    places: Vec<Bin>,
    /// A bit per place that holds something.
    touched: Vec<u64>,
    /// The others, by number.
    list: Vec<(usize, Bin)>,
    total: f64,
}

#[derive(Debug, Clone, Copy, Default)]
struct Bin {
    /// Σ s of the nearer bins.
    before: f64,
    /// Σ s of this one.
    own: f64,
}

impl Bin {
    /// Puts the bin behind those whose sum is `total`, which grows by it.
    fn put_behind(&mut self, total: &mut f64) {
        self.before = *total;
        *total += self.own;
    }
}

impl BinnedAbsorbance {
    /// Makes room for `count` empty bins.
    pub fn clear(&mut self, count: usize) {
        let Self { listed, places, touched, list, total } = self;
        (*listed, *total) = (count > PLACES, 0.0);
        list.clear();
        each_bit(touched, |i| places[i] = Bin::default());
        touched.clear();
        if !*listed {
            touched.resize(count.div_ceil(64), 0);
            places.resize(places.len().max(count), Bin::default());
        }
    }

    /// Adds absorbance to a bin.
    pub fn add(&mut self, index: usize, s: f64) {
        if self.listed {
            self.list.push((index, Bin { before: 0.0, own: s }));
        } else {
            self.places[index].own += s;
            self.touched[index / 64] |= 1 << (index % 64);
        }
    }

    /// Puts the bins one behind the other; nothing is asked before.
    pub fn end(&mut self) {
        let Self { places, touched, list, total, .. } = self;
        each_bit(touched, |i| places[i].put_behind(total));
        list.sort_by_key(|bin| bin.0);
        list.dedup_by(|bin, kept| {
            let same = bin.0 == kept.0;
            if same {
                kept.1.own += bin.1.own;
            }
            same
        });
        list.iter_mut().for_each(|(_, bin)| bin.put_behind(total));
    }

    /// The same from sums in a format, of which each addition is rounded.
    pub fn fill_stored(
        &mut self,
        count: usize,
        format: Format,
        deposits: impl IntoIterator<Item = (usize, f64)>,
    ) {
        let mut sums = BTreeMap::new();
        for (index, s) in deposits {
            let sum: &mut f64 = sums.entry(index).or_default();
            *sum = format.accumulate(*sum, s);
        }
        self.clear(count);
        sums.into_iter().for_each(|(index, sum)| self.add(index, format.read(sum)));
        self.end();
    }

    /// The absorbance of the bins in front of bin `index`, and its own.
    pub fn at(&self, index: usize) -> (f64, f64) {
        if self.listed {
            return self.listed_at(index);
        }
        if self.touched[index / 64] >> (index % 64) & 1 == 1 {
            let Bin { before, own } = self.places[index];
            return (before, own);
        }
        (
            last_bit_below(&self.touched, index).map_or(0.0, |i| self.places[i].before + self.places[i].own),
            0.0,
        )
    }

    fn listed_at(&self, index: usize) -> (f64, f64) {
        let i = self.list.partition_point(|bin| bin.0 < index);
        match self.list.get(i) {
            Some(bin) if bin.0 == index => (bin.1.before, bin.1.own),
            Some(bin) => (bin.1.before, 0.0),
            None => (self.total, 0.0),
        }
    }

    /// The absorbance in front of the point `fraction` inside bin `index`, absorbance spread evenly there.
    pub fn lerp(&self, (index, fraction): (usize, f64)) -> f64 {
        let (before, own) = self.at(index);
        before + fraction * own
    }

    /// Σ s.
    pub fn total(&self) -> f64 {
        self.total
    }
}

/// Calls `see` for each bit that is set, in order.
fn each_bit(words: &[u64], mut see: impl FnMut(usize)) {
    for (w, &word) in words.iter().enumerate() {
        let mut rest = word;
        while rest != 0 {
            see(64 * w + rest.trailing_zeros() as usize);
            rest &= rest - 1;
        }
    }
}

/// The last bit before bit `end` that is set.
fn last_bit_below(words: &[u64], end: usize) -> Option<usize> {
    let below = words[end / 64] & ((1 << (end % 64)) - 1);
    let others = words[..end / 64].iter().copied().enumerate().rev();
    let mut words = std::iter::once((end / 64, below)).chain(others);
    words.find(|(_, word)| *word != 0).map(|(w, word)| 64 * w + word.ilog2() as usize)
}

#[cfg(test)]
mod tests {
    use super::BinnedAbsorbance;
    use crate::format::Format;

    /// Bins for each of which there is a place, and more.
    const COUNTS: [usize; 3] = [9, 4096, usize::MAX];

    fn fill(bins: &mut BinnedAbsorbance, count: usize, deposits: &[(usize, f64)]) {
        bins.clear(count);
        deposits.iter().for_each(|&(index, s)| bins.add(index, s));
        bins.end();
    }

    #[test]
    fn prefix_sums_of_what_there_is() {
        let mut bins = BinnedAbsorbance::default();
        for count in COUNTS.into_iter().chain(COUNTS) {
            fill(&mut bins, count, &[(7, 1.0), (2, 0.5), (7, 2.0), (count - 1, 4.0)]);
            assert_eq!([0, 2, 3, 7].map(|i| bins.at(i)), [(0.0, 0.0), (0.0, 0.5), (0.5, 0.0), (0.5, 3.0)]);
            assert_eq!(bins.at(count - 1), (3.5, 4.0));
            assert_eq!((bins.lerp((7, 0.5)), bins.total()), (2.0, 7.5));
            fill(&mut bins, count, &[]);
            assert_eq!((bins.at(3), bins.total()), ((0.0, 0.0), 0.0));
        }
    }

    #[test]
    fn stored_sums_round_each_addition() {
        let mut bins = BinnedAbsorbance::default();
        // beside 1 a half keeps 2^-10 but neither of two 2^-12
        let deposits =
            [(1, 1.0), (0, 0.5), (1, 2.0_f64.powi(-12)), (1, 2.0_f64.powi(-12)), (1, 2.0_f64.powi(-10))];
        for (count, format) in COUNTS.into_iter().flat_map(|n| [(n, Format::F16), (n, Format::F64)]) {
            bins.fill_stored(count, format, deposits);
            let lost = if format == Format::F16 { 2.0_f64.powi(-11) } else { 0.0 };
            assert_eq!(bins.at(1), (0.5, 1.0 + 2.0_f64.powi(-10) + 2.0_f64.powi(-11) - lost));
        }
        bins.fill_stored(4, Format::F16, [(2, 6e4), (2, 6e4)]);
        assert_eq!(bins.total(), 65_504.0);
    }

    #[test]
    fn an_empty_bin_is_behind_the_last_one_in_front_of_it() {
        let mut bins = BinnedAbsorbance::default();
        for count in [200, usize::MAX] {
            fill(&mut bins, count, &[(3, 1.0), (130, 2.0), (64, 4.0)]);
            assert_eq!(
                [2, 4, 63, 65, 128, 131, 199].map(|i| bins.at(i).0),
                [0.0, 1.0, 1.0, 5.0, 5.0, 7.0, 7.0]
            );
        }
    }
}
