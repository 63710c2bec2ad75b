//! Submission order as an experiment parameter: the same fragments, handed over in another order (sheet 0.4).

use crate::fragments::{CentroidDepths, List, Lists, ListsRef};
use crate::random::hash32;

/// The orders that every technique accepts, as users write them; the first is the default.
pub const SUBMISSION_ORDERS: &[&str] =
    &["as_is", "reversed", "sorted", "back_to_front", "shuffled", "centroid"];

/// A submission order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SubmissionOrder {
    /// As the rasteriser or the list has them.
    AsIs,
    /// Last one first.
    Reversed,
    /// Front to back by (depth, primitive).
    Sorted,
    /// The reverse of `Sorted`.
    BackToFront,
    /// A random order of the primitives, the same in every pixel.
    Shuffled {
        /// Which one.
        seed: u64,
    },
    /// Whole primitives back to front by the depth of their centroid, larger id first on ties.
    Centroid,
}

impl SubmissionOrder {
    /// The order of that name.
    ///
    /// # Panics
    /// If the name is not in [`SUBMISSION_ORDERS`].
    pub fn from_name(name: &str, seed: u64) -> Self {
        match name {
            "as_is" => Self::AsIs,
            "reversed" => Self::Reversed,
            "sorted" => Self::Sorted,
            "back_to_front" => Self::BackToFront,
            "shuffled" => Self::Shuffled { seed },
            "centroid" => Self::Centroid,
            other => panic!("no submission order {other:?}"),
        }
    }
}

/// Distinguishes the shuffle's random numbers from the techniques' own.
const SHUFFLE_BLOCK: u32 = 0x5348_5546;

/// The pair (depth, primitive) as one integer in the same order. Depth is never negative, so its bits ascend
/// with it; adding zero turns -0 into +0.
pub fn sort_key(depth: f32, primitive: u32) -> u64 {
    u64::from((depth + 0.0).to_bits()) << 32 | u64::from(primitive)
}

/// Copies lists into another order, reusing its memory.
#[derive(Debug, Default)]
pub struct Reorderer {
    keyed: Vec<(u64, u32)>,
}

impl Reorderer {
    /// The rows of `lists` in the given `order`, into `out`. `centroids` is consulted for `Centroid` alone.
    pub fn reorder(
        &mut self,
        lists: ListsRef<'_>,
        order: SubmissionOrder,
        centroids: Option<&CentroidDepths>,
        out: &mut Lists,
    ) {
        out.clear();
        for i in 0..lists.len() {
            let row = lists.row(i);
            self.sort_row(row, order, centroids);
            for &(_, place) in &self.keyed {
                out.push(row.get(place as usize));
            }
            out.end_row();
        }
    }

    /// Fills `keyed` with the row's places in the wanted order. Equal keys keep their arrival order.
    fn sort_row(&mut self, row: List<'_>, order: SubmissionOrder, centroids: Option<&CentroidDepths>) {
        self.keyed.clear();
        match order {
            SubmissionOrder::AsIs => self.key_by(row, |_| 0),
            SubmissionOrder::Reversed => {
                self.key_by(row, |_| 0);
                self.keyed.reverse();
                return;
            }
            SubmissionOrder::Sorted | SubmissionOrder::BackToFront => {
                self.key_by(row, |i| sort_key(row.depth[i], row.primitive[i]));
            }
            SubmissionOrder::Shuffled { seed } => {
                self.key_by(row, |i| {
                    let primitive = row.primitive[i];
                    u64::from(hash32(0, 0, primitive, seed, SHUFFLE_BLOCK)) << 32 | u64::from(primitive)
                });
            }
            SubmissionOrder::Centroid => {
                self.sort_by_centroid(row, centroids);
                return;
            }
        }
        self.keyed.sort_unstable();
        if order == SubmissionOrder::BackToFront {
            self.keyed.reverse();
        }
    }

    #[expect(clippy::cast_possible_truncation, reason = "a pixel's list is far shorter than 2^32")]
    fn key_by(&mut self, row: List<'_>, key: impl Fn(usize) -> u64) {
        self.keyed.extend((0..row.len()).map(|i| (key(i), i as u32)));
    }

    fn sort_by_centroid(&mut self, row: List<'_>, centroids: Option<&CentroidDepths>) {
        self.key_by(row, |i| u64::from(row.primitive[i]));
        let depth = |primitive: u64| {
            #[expect(clippy::cast_possible_truncation, reason = "the key is a u32 primitive")]
            centroids.map_or(0.0, |c| c.get(primitive as u32))
        };
        self.keyed.sort_by(|a, b| depth(b.0).total_cmp(&depth(a.0)).then(b.0.cmp(&a.0)));
    }
}

/// Copies the rows without the fragments that neither cover nor emit.
pub fn without_zero_fragments(lists: ListsRef<'_>, out: &mut Lists) {
    out.clear();
    for i in 0..lists.len() {
        lists.row(i).iter().filter(|f| !f.is_zero()).for_each(|f| out.push(f));
        out.end_row();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fragments::Fragment;

    fn lists(fragments: &[(f32, u32)]) -> Lists {
        let mut lists = Lists::new();
        for &(depth, primitive) in fragments {
            lists.push(Fragment { depth, color: [1.0; 3], alpha: 1.0, primitive });
        }
        lists.end_row();
        lists
    }

    fn primitives(fragments: &[(f32, u32)], order: SubmissionOrder, depths: &[f64]) -> Vec<u32> {
        let (from, mut to) = (lists(fragments), Lists::new());
        let centroids = CentroidDepths::Dense(depths.to_vec());
        Reorderer::default().reorder(from.as_ref(), order, Some(&centroids), &mut to);
        to.primitive
    }

    const LIST: &[(f32, u32)] = &[(2.0, 3), (1.0, 1), (2.0, 0), (-0.0, 2)];

    #[test]
    fn each_order_by_hand() {
        let order = |o| primitives(LIST, o, &[0.0; 4]);
        assert_eq!(order(SubmissionOrder::AsIs), [3, 1, 0, 2]);
        assert_eq!(order(SubmissionOrder::Reversed), [2, 0, 1, 3]);
        assert_eq!(order(SubmissionOrder::Sorted), [2, 1, 0, 3]);
        assert_eq!(order(SubmissionOrder::BackToFront), [3, 0, 1, 2]);
        let centroid = |depths: &[f64]| primitives(LIST, SubmissionOrder::Centroid, depths);
        assert_eq!(centroid(&[5.0, 4.0, 9.0, 5.0]), [2, 3, 0, 1]);
    }

    #[test]
    fn a_shuffle_depends_on_the_set_and_the_seed_alone() {
        let fragments: Vec<_> = (0..32_u16).map(|i| (f32::from(i), u32::from(i))).collect();
        let reversed: Vec<_> = fragments.iter().rev().copied().collect();
        let shuffle = |f: &[(f32, u32)], seed| primitives(f, SubmissionOrder::Shuffled { seed }, &[]);
        assert_eq!(shuffle(&fragments, 1), shuffle(&reversed, 1));
        assert_ne!(shuffle(&fragments, 1), shuffle(&fragments, 2));
        let mut all = shuffle(&fragments, 3);
        all.sort_unstable();
        assert_eq!(all, (0..32).collect::<Vec<_>>());
    }

    #[test]
    fn zero_fragments_go_emission_stays() {
        let mut from = lists(&[(1.0, 0), (2.0, 1), (3.0, 2)]);
        from.alpha = vec![0.0, 0.0, 1.0];
        from.color[0] = [0.0; 3];
        let mut to = Lists::new();
        without_zero_fragments(from.as_ref(), &mut to);
        assert_eq!(to.primitive, [1, 2]);
    }
}
