//! Absorbance summed in depth bins: what opacity shadow maps and their kin store.

/// The bins of one pixel. Only those that hold something are stored, so that neither time nor memory depends on
/// their number. Sums are kept in f64: taking a fragment's own share out of a bin that it dominates cancels.
#[derive(Debug, Default)]
pub struct BinnedAbsorbance {
    bins: Vec<Bin>,
    total: f64,
}

#[derive(Debug, Clone, Copy)]
struct Bin {
    index: usize,
    /// Σ s of the nearer bins.
    before: f64,
    /// Σ s of this one.
    own: f64,
}

impl BinnedAbsorbance {
    /// Sums (bin, absorbance) pairs, in place of what was there.
    pub fn fill(&mut self, deposits: impl Iterator<Item = (usize, f64)>) {
        self.bins.clear();
        self.bins.extend(deposits.map(|(index, own)| Bin { index, before: 0.0, own }));
        self.bins.sort_by_key(|bin| bin.index);
        self.bins.dedup_by(|bin, kept| {
            let same = bin.index == kept.index;
            if same {
                kept.own += bin.own;
            }
            same
        });
        self.total = 0.0;
        for bin in &mut self.bins {
            bin.before = self.total;
            self.total += bin.own;
        }
    }

    /// The absorbance of the bins in front of bin `index`, and its own.
    pub fn at(&self, index: usize) -> (f64, f64) {
        let i = self.bins.partition_point(|bin| bin.index < index);
        match self.bins.get(i) {
            Some(bin) if bin.index == index => (bin.before, bin.own),
            Some(bin) => (bin.before, 0.0),
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

#[cfg(test)]
mod tests {
    use super::BinnedAbsorbance;

    #[test]
    fn prefix_sums_of_what_there_is() {
        let mut bins = BinnedAbsorbance::default();
        for _ in 0..2 {
            bins.fill([(7, 1.0), (2, 0.5), (7, 2.0), (usize::MAX, 4.0)].into_iter());
            assert_eq!(
                [0, 2, 3, 7, 8].map(|i| bins.at(i)),
                [(0.0, 0.0), (0.0, 0.5), (0.5, 0.0), (0.5, 3.0), (3.5, 0.0)]
            );
            assert_eq!((bins.lerp((7, 0.5)), bins.total()), (2.0, 7.5));
        }
        bins.fill(std::iter::empty());
        assert_eq!((bins.at(3), bins.total()), ((0.0, 0.0), 0.0));
    }
}
