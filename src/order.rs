//! Submission order as an experiment parameter: the same fragments, handed over in another order (sheet 0.4).

use crate::fragments::{List, Lists, ListsRef};
use crate::random::hash32;
use rayon::slice::ParallelSliceMut;
use std::collections::HashMap;

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

/// The places of primitives when sorted back to front by the view depth of their centroid, larger id first on
/// ties.
#[derive(Debug, Clone)]
pub enum CentroidOrder {
    /// Indexed by primitive id.
    All(Vec<u32>),
    /// Only the primitives that occur.
    Some(HashMap<u32, u32>),
}

impl CentroidOrder {
    /// The order of primitives whose depths are listed by id.
    #[expect(clippy::cast_possible_truncation, reason = "primitive ids are u32")]
    pub fn of_all(depths: &[f64]) -> Self {
        let mut places = vec![0; depths.len()];
        let ids = (0..depths.len() as u32).map(|id| (id, depths[id as usize]));
        for (place, id) in back_to_front(ids).into_iter().enumerate() {
            places[id as usize] = place as u32;
        }
        Self::All(places)
    }

    /// The order of some primitives, given with their depths.
    pub fn of_some(primitives: impl Iterator<Item = (u32, f64)>) -> Self {
        Self::Some(back_to_front(primitives).into_iter().zip(0..).collect())
    }

    /// The place of `primitive`, 0 for the farthest. One that is not known is taken as nearest.
    fn place(&self, primitive: u32) -> u32 {
        match self {
            Self::All(places) => places[primitive as usize],
            Self::Some(places) => places.get(&primitive).copied().unwrap_or(u32::MAX),
        }
    }
}

fn back_to_front(primitives: impl Iterator<Item = (u32, f64)>) -> Vec<u32> {
    let mut sorted: Vec<_> = primitives.collect();
    sorted.par_sort_unstable_by(|a, b| b.1.total_cmp(&a.1).then(b.0.cmp(&a.0)));
    sorted.into_iter().map(|(id, _)| id).collect()
}

impl SubmissionOrder {
    /// Whether it is one of whole primitives, so that every pixel gets its fragments in the same one.
    pub fn is_of_primitives(self) -> bool {
        !matches!(self, Self::Sorted | Self::BackToFront)
    }

    /// Where in the list of primitive `ids` the first primitive is that comes in this order, where the second, and so on;
    /// as they are in an order of fragments.
    #[expect(clippy::cast_possible_truncation, reason = "primitive ids are u32")]
    pub fn of_primitives(self, ids: &[u32], centroids: Option<&CentroidOrder>) -> Vec<u32> {
        let mut places: Vec<_> = (0..ids.len() as u32).collect();
        let id = |place: &u32| ids[*place as usize];
        match self {
            Self::AsIs | Self::Sorted | Self::BackToFront => {}
            Self::Reversed => places.reverse(),
            Self::Shuffled { seed } => {
                places.par_sort_by_key(|place| (hash32(0, 0, id(place), seed, SHUFFLE_BLOCK), id(place)));
            }
            Self::Centroid => {
                places.par_sort_by_key(|place| centroids.map_or(0, |order| order.place(id(place))));
            }
        }
        places
    }
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
        centroids: Option<&CentroidOrder>,
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
    fn sort_row(&mut self, row: List<'_>, order: SubmissionOrder, centroids: Option<&CentroidOrder>) {
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
                let place = |primitive| centroids.map_or(0, |order| order.place(primitive));
                self.key_by(row, |i| u64::from(place(row.primitive[i])));
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
        let centroids = CentroidOrder::of_all(depths);
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

    /// In a pixel that every primitive has a fragment in.
    #[test]
    fn primitives_come_as_their_fragments_do() {
        let depths = [5.0, 4.0, 9.0, 5.0];
        let ids: Vec<_> = LIST.iter().map(|fragment| fragment.1).collect();
        let centroids = CentroidOrder::of_all(&depths);
        let orders = [SubmissionOrder::AsIs, SubmissionOrder::Reversed, SubmissionOrder::Centroid];
        for order in orders.into_iter().chain((0..3).map(|seed| SubmissionOrder::Shuffled { seed })) {
            let places = order.of_primitives(&ids, Some(&centroids));
            let got: Vec<_> = places.iter().map(|place| ids[*place as usize]).collect();
            assert!(order.is_of_primitives());
            assert_eq!(got, primitives(LIST, order, &depths), "{order:?}");
        }
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
