//! An image's worth of fragments.

use super::check::{
    check_background, check_clip_planes, check_depth_range, check_offsets, check_primitive_depth, check_size,
    check_values,
};
use super::{Lists, hash_words};
use crate::error::Result;
use crate::order::CentroidOrder;
use crate::params::View;
use std::collections::HashMap;
use std::sync::OnceLock;

/// What lies behind the transparent fragments: one colour, or one per pixel (opaque surfaces included).
#[derive(Debug, Clone, PartialEq)]
pub enum Background {
    /// The same linear colour everywhere.
    Constant([f32; 3]),
    /// One linear colour per pixel, row by row from the top.
    Image(Vec<[f32; 3]>),
}

impl Background {
    /// The colour behind pixel `i`.
    pub fn at(&self, i: usize) -> [f32; 3] {
        match self {
            Self::Constant(color) => *color,
            Self::Image(colors) => colors[i],
        }
    }

    /// The same with 0 for what equals it.
    fn without_negative_zeros(mut self) -> Self {
        let colors = match &mut self {
            Self::Constant(color) => std::slice::from_mut(color),
            Self::Image(colors) => colors,
        };
        colors.as_flattened_mut().iter_mut().for_each(|channel| *channel += 0.0);
        self
    }
}

/// An image's worth of fragments with all that a technique needs to resolve them.
#[derive(Debug, Clone, PartialEq)]
pub struct Fragments {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// One list per pixel, row by row from the top.
    pub lists: Lists,
    /// The colour behind the fragments.
    pub background: Background,
    /// Near, far and the scene's depth range.
    pub view: View,
    /// View depth of every primitive's centroid, by primitive id; `None` where it is not known.
    pub primitive_depth: Option<Vec<f64>>,
    hash: OnceLock<blake3::Hash>,
}

/// What [`Fragments::new`] takes, before it is checked.
#[derive(Debug, Clone)]
pub struct FragmentsInput {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// The lists.
    pub lists: Lists,
    /// The colour behind them.
    pub background: Background,
    /// Near plane, > 0.
    pub near: f64,
    /// Far plane, > near.
    pub far: f64,
    /// The scene's depth range; absent, that of the fragments that are not zero.
    pub depth_range: Option<(f64, f64)>,
    /// View depth of every primitive's centroid.
    pub primitive_depth: Option<Vec<f64>>,
}

impl Fragments {
    /// Checks and completes a fragment list.
    ///
    /// # Errors
    /// [`Error::Argument`] naming the array and the first bad index.
    pub fn new(input: FragmentsInput) -> Result<Self> {
        let FragmentsInput { width, height, lists, background, near, far, depth_range, primitive_depth } =
            input;
        check_size(width, height)?;
        check_offsets(&lists, width as usize * height as usize)?;
        check_values(&lists)?;
        check_background(&background, width, height)?;
        let background = background.without_negative_zeros();
        check_clip_planes(near, far)?;
        check_depth_range(depth_range)?;
        if let Some(depths) = &primitive_depth {
            check_primitive_depth(depths, &lists.primitive)?;
        }
        let depth_range = depth_range.unwrap_or_else(|| kept_depth_range(&lists, near, far));
        let view = View { near, far, depth_range };
        Ok(Self::captured(width, height, lists, background, view, primitive_depth))
    }

    /// Fragments that are valid by construction.
    pub(crate) fn captured(
        width: u32,
        height: u32,
        lists: Lists,
        background: Background,
        view: View,
        primitive_depth: Option<Vec<f64>>,
    ) -> Self {
        Self { width, height, lists, background, view, primitive_depth, hash: OnceLock::new() }
    }

    /// The number of pixels.
    pub fn pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// A hash of everything that decides a render of these fragments, computed once.
    pub fn content_hash(&self) -> blake3::Hash {
        *self.hash.get_or_init(|| self.compute_hash())
    }

    fn compute_hash(&self) -> blake3::Hash {
        let mut hasher = blake3::Hasher::new();
        hasher.update(b"oitlab fragments 1");
        hasher.update(&self.width.to_le_bytes());
        hasher.update(&self.height.to_le_bytes());
        let lists = &self.lists;
        hash_words(&mut hasher, &lists.offsets, i64::to_le_bytes);
        hash_words(&mut hasher, &lists.depth, f32::to_le_bytes);
        hash_words(&mut hasher, lists.color.as_flattened(), f32::to_le_bytes);
        hash_words(&mut hasher, &lists.alpha, f32::to_le_bytes);
        hash_words(&mut hasher, &lists.primitive, u32::to_le_bytes);
        for i in 0..self.pixels() {
            self.background.at(i).iter().for_each(|c| _ = hasher.update(&c.to_le_bytes()));
        }
        let View { near, far, depth_range: (lo, hi) } = self.view;
        [near, far, lo, hi].iter().for_each(|x| _ = hasher.update(&x.to_le_bytes()));
        hash_words(&mut hasher, self.primitive_depth.as_deref().unwrap_or(&[]), f64::to_le_bytes);
        hasher.finalize()
    }

    /// The primitives by centroid: their depths as given, or the mean depth (float64) of a primitive's
    /// fragments over the whole image, zero fragments left out (sheet 0.4).
    pub fn centroid_order(&self) -> CentroidOrder {
        if let Some(depths) = &self.primitive_depth {
            return CentroidOrder::of_all(depths);
        }
        CentroidOrder::of_some(self.primitive_means().into_iter())
    }

    fn primitive_means(&self) -> HashMap<u32, f64> {
        let mut sums: HashMap<u32, (f64, f64)> = HashMap::new();
        for fragment in self.lists.as_ref().all.iter().filter(|f| !f.is_zero()) {
            let (sum, count) = sums.entry(fragment.primitive).or_default();
            *sum += f64::from(fragment.depth);
            *count += 1.0;
        }
        sums.into_iter().map(|(primitive, (sum, n))| (primitive, sum / n)).collect()
    }
}

fn kept_depth_range(lists: &Lists, near: f64, far: f64) -> (f64, f64) {
    let kept = lists.as_ref().all.iter().filter(|f| !f.is_zero()).map(|f| f64::from(f.depth));
    let (lo, hi) = kept.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), z| (lo.min(z), hi.max(z)));
    if lo <= hi { (lo, hi) } else { (near, far) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fragments::Fragment;

    fn fragment(depth: f32, primitive: u32) -> Fragment {
        Fragment { depth, color: [0.1, 0.2, 0.3], alpha: 0.5, primitive }
    }

    fn input() -> FragmentsInput {
        let mut lists = Lists::new();
        lists.push(fragment(2.0, 0));
        lists.push(fragment(1.0, 1));
        lists.end_row();
        lists.push(fragment(4.0, 1));
        lists.end_row();
        FragmentsInput {
            width: 2,
            height: 1,
            lists,
            background: Background::Constant([0.2; 3]),
            near: 0.1,
            far: 100.0,
            depth_range: None,
            primitive_depth: None,
        }
    }

    fn message(change: impl FnOnce(&mut FragmentsInput)) -> String {
        let mut input = input();
        change(&mut input);
        Fragments::new(input).unwrap_err().to_string()
    }

    #[test]
    fn rows_are_the_pixels_in_arrival_order() {
        let fragments = Fragments::new(input()).unwrap();
        let rows = fragments.lists.as_ref();
        assert_eq!(rows.len(), 2);
        assert_eq!(rows.row(0).depth, [2.0, 1.0]);
        assert_eq!(rows.row(1).depth, [4.0]);
        assert_eq!(rows.rows(1, 2).row(0).depth, [4.0]);
        assert_eq!(rows.row(0).depth_bounds(), Some((1.0, 2.0)));
    }

    #[test]
    fn depth_range_and_centroids_come_from_the_fragments_when_absent() {
        let fragments = Fragments::new(input()).unwrap();
        assert_eq!(fragments.view.depth_range, (1.0, 4.0));
        assert_eq!(fragments.primitive_means()[&1], 2.5);
    }

    #[test]
    fn zero_fragments_take_no_part_in_the_depth_range() {
        let mut input = input();
        input.lists.color[2] = [0.0; 3];
        input.lists.alpha[2] = 0.0;
        assert_eq!(Fragments::new(input).unwrap().view.depth_range, (1.0, 2.0));
    }

    #[test]
    fn errors_name_the_array_and_the_index() {
        assert!(message(|i| i.width = 0).starts_with("width: 0"));
        assert!(message(|i| i.lists.offsets[1] = 9).contains("falls from 9 to 3 at index 2"));
        assert!(message(|i| i.lists.offsets[0] = 1).contains("starts with 1"));
        assert!(message(|i| i.lists.offsets[2] = 4).contains("ends with 4"));
        assert!(message(|i| i.lists.offsets.truncate(2)).contains("has 2 entries"));
        assert!(message(|i| i.lists.depth[1] = f32::NAN).contains("depth: entry 1 is NaN"));
        assert!(message(|i| i.lists.depth[1] = -1.0).contains("depth: entry 1 is -1"));
        assert!(message(|i| i.lists.alpha[2] = 1.5).contains("alpha: entry 2 is 1.5"));
        assert!(message(|i| i.lists.color[0][1] = f32::INFINITY).contains("color: entry 0"));
        assert!(message(|i| i.lists.alpha.truncate(1)).contains("alpha: has 1 entries"));
        assert!(message(|i| i.far = 0.1).contains("far: 0.1"));
        assert!(message(|i| i.near = 0.0).contains("near: 0"));
        assert!(message(|i| i.depth_range = Some((2.0, 1.0))).contains("depth_range: (2, 1)"));
        assert!(message(|i| i.primitive_depth = Some(vec![1.0])).contains("primitive: entry 1 is 1"));
        assert!(message(|i| i.primitive_depth = Some(vec![1.0, f64::NAN])).contains("entry 1 is NaN"));
        assert!(message(|i| i.background = Background::Image(vec![[0.0; 3]])).contains("has 1 pixels"));
        assert!(message(|i| i.background = Background::Constant([f32::NAN; 3])).contains("background"));
        let image = vec![[0.0; 3], [-1.0, 0.0, 0.0]];
        assert!(message(|i| i.background = Background::Image(image)).contains("(x=1, y=0)"));
        for background in [Background::Constant([-0.0; 3]), Background::Image(vec![[-0.0; 3]; 2])] {
            assert_eq!(background.without_negative_zeros().at(0).map(f32::to_bits), [0; 3]);
        }
    }
}
