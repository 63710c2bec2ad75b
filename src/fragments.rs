//! Per-pixel fragment lists in arrival order, stored as compressed sparse rows.

use crate::error::{Error, Result};
use crate::params::View;
use std::sync::OnceLock;

/// One fragment: what a rasteriser hands to a transparency technique.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fragment {
    /// View-space distance along the camera's forward axis, >= 0.
    pub depth: f32,
    /// Premultiplied linear colour.
    pub color: [f32; 3],
    /// Coverage in [0, 1].
    pub alpha: f32,
    /// The primitive it comes from; breaks ties in depth.
    pub primitive: u32,
}

impl Fragment {
    /// Neither covers nor emits: a no-op for every technique but two (sheet 0.1).
    pub fn is_zero(&self) -> bool {
        self.alpha == 0.0 && self.color == [0.0; 3]
    }
}

/// The fragments of one pixel, as parallel slices.
#[derive(Debug, Clone, Copy, Default)]
pub struct List<'a> {
    /// View-space distances.
    pub depth: &'a [f32],
    /// Premultiplied linear colours.
    pub color: &'a [[f32; 3]],
    /// Coverages.
    pub alpha: &'a [f32],
    /// Primitive ids.
    pub primitive: &'a [u32],
}

impl<'a> List<'a> {
    /// The number of fragments.
    pub fn len(&self) -> usize {
        self.depth.len()
    }
    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.depth.is_empty()
    }
    /// The fragment at place `i`.
    pub fn get(&self, i: usize) -> Fragment {
        Fragment {
            depth: self.depth[i],
            color: self.color[i],
            alpha: self.alpha[i],
            primitive: self.primitive[i],
        }
    }
    /// The fragments in the list's order.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = Fragment> + 'a {
        let list = *self;
        (0..list.len()).map(move |i| list.get(i))
    }
    /// The smallest and largest depth; `None` for an empty list.
    pub fn depth_bounds(&self) -> Option<(f32, f32)> {
        let first = *self.depth.first()?;
        Some(self.depth.iter().fold((first, first), |(lo, hi), &z| (lo.min(z), hi.max(z))))
    }
}

/// The fragments of many pixels, borrowed.
#[derive(Debug, Clone, Copy)]
pub struct ListsRef<'a> {
    /// Row `i` spans `offsets[i]..offsets[i + 1]` of the arrays below, less `offsets[0]`.
    pub offsets: &'a [i64],
    /// The arrays of all rows.
    pub all: List<'a>,
}

impl<'a> ListsRef<'a> {
    /// The number of pixels.
    pub fn len(&self) -> usize {
        self.offsets.len() - 1
    }
    /// Whether there are no pixels.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "offsets index the arrays")]
    fn range(&self, first: usize, last: usize) -> std::ops::Range<usize> {
        let base = self.offsets[0];
        (self.offsets[first] - base) as usize..(self.offsets[last] - base) as usize
    }
    /// The number of fragments of pixel `i`.
    pub fn count(&self, i: usize) -> usize {
        self.range(i, i + 1).len()
    }
    /// The fragments of pixel `i`.
    pub fn row(&self, i: usize) -> List<'a> {
        self.all.slice(self.range(i, i + 1))
    }
    /// The fragments of pixels `first..last`.
    pub fn rows(&self, first: usize, last: usize) -> ListsRef<'a> {
        ListsRef { offsets: &self.offsets[first..=last], all: self.all.slice(self.range(first, last)) }
    }
}

impl<'a> List<'a> {
    fn slice(&self, range: std::ops::Range<usize>) -> List<'a> {
        List {
            depth: &self.depth[range.clone()],
            color: &self.color[range.clone()],
            alpha: &self.alpha[range.clone()],
            primitive: &self.primitive[range],
        }
    }
}

/// The fragments of many pixels, owned.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Lists {
    /// Row bounds: pixels + 1 ascending numbers, the first 0.
    pub offsets: Vec<i64>,
    /// View-space distances.
    pub depth: Vec<f32>,
    /// Premultiplied linear colours.
    pub color: Vec<[f32; 3]>,
    /// Coverages.
    pub alpha: Vec<f32>,
    /// Primitive ids.
    pub primitive: Vec<u32>,
}

impl Lists {
    /// Lists without pixels, to be filled row by row with [`Lists::push`] and [`Lists::end_row`].
    pub fn new() -> Self {
        Self { offsets: vec![0], ..Self::default() }
    }
    /// The number of fragments.
    pub fn len(&self) -> usize {
        self.depth.len()
    }
    /// Whether there are no fragments.
    pub fn is_empty(&self) -> bool {
        self.depth.is_empty()
    }
    /// Forgets every row, keeps the memory.
    pub fn clear(&mut self) {
        self.offsets.clear();
        self.offsets.push(0);
        self.depth.clear();
        self.color.clear();
        self.alpha.clear();
        self.primitive.clear();
    }
    /// Appends a fragment to the open row.
    pub fn push(&mut self, fragment: Fragment) {
        self.depth.push(fragment.depth);
        self.color.push(fragment.color);
        self.alpha.push(fragment.alpha);
        self.primitive.push(fragment.primitive);
    }
    /// Closes the open row.
    #[expect(clippy::cast_possible_wrap, reason = "a Vec holds at most isize::MAX bytes")]
    pub fn end_row(&mut self) {
        self.offsets.push(self.depth.len() as i64);
    }
    /// Makes room for rows of the given `offsets` (from 0), all fragments zero.
    pub fn reset_to(&mut self, offsets: &[i64]) {
        let total = usize::try_from(*offsets.last().unwrap_or(&0)).unwrap_or(0);
        self.offsets.clear();
        self.offsets.extend_from_slice(offsets);
        self.depth.resize(total, 0.0);
        self.color.resize(total, [0.0; 3]);
        self.alpha.resize(total, 0.0);
        self.primitive.resize(total, 0);
    }
    /// Writes `fragment` at place `i` of the arrays.
    pub fn set(&mut self, i: usize, fragment: Fragment) {
        self.depth[i] = fragment.depth;
        self.color[i] = fragment.color;
        self.alpha[i] = fragment.alpha;
        self.primitive[i] = fragment.primitive;
    }
    /// Moves the fragments at `range` to `to`, which is not behind them.
    pub fn move_rows(&mut self, range: std::ops::Range<usize>, to: usize) {
        self.depth.copy_within(range.clone(), to);
        self.color.copy_within(range.clone(), to);
        self.alpha.copy_within(range.clone(), to);
        self.primitive.copy_within(range, to);
    }
    /// Sets where row `i` ends.
    #[expect(clippy::cast_possible_wrap, reason = "a Vec holds at most isize::MAX bytes")]
    pub fn set_row_end(&mut self, i: usize, end: usize) {
        self.offsets[i + 1] = end as i64;
    }
    /// Forgets the fragments from place `len` on.
    pub fn truncate(&mut self, len: usize) {
        self.depth.truncate(len);
        self.color.truncate(len);
        self.alpha.truncate(len);
        self.primitive.truncate(len);
    }
    /// A view of all rows.
    pub fn as_ref(&self) -> ListsRef<'_> {
        ListsRef {
            offsets: &self.offsets,
            all: List {
                depth: &self.depth,
                color: &self.color,
                alpha: &self.alpha,
                primitive: &self.primitive,
            },
        }
    }
    /// Appends all rows of `other`.
    pub fn append(&mut self, other: &Self) {
        self.append_rows(other.as_ref());
    }
    /// Appends all rows of a view.
    pub fn append_rows(&mut self, rows: ListsRef<'_>) {
        let shift = self.offsets[self.offsets.len() - 1] - rows.offsets[0];
        self.offsets.extend(rows.offsets[1..].iter().map(|o| o + shift));
        self.depth.extend_from_slice(rows.all.depth);
        self.color.extend_from_slice(rows.all.color);
        self.alpha.extend_from_slice(rows.all.alpha);
        self.primitive.extend_from_slice(rows.all.primitive);
    }
}

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
        check_clip_planes(near, far)?;
        if let Some((lo, hi)) = depth_range
            && !(lo.is_finite() && hi.is_finite() && 0.0 <= lo && lo <= hi)
        {
            let problem = format!("({lo}, {hi}) is not a finite pair with 0 <= z_lo <= z_hi");
            return Err(Error::argument("depth_range", problem));
        }
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

    /// View depth by primitive id: as given, or the mean depth (float64) of the primitive's fragments over
    /// the whole image, zero fragments left out (sheet 0.4).
    pub fn centroid_depths(&self) -> CentroidDepths {
        if let Some(depths) = &self.primitive_depth {
            return CentroidDepths::Dense(depths.clone());
        }
        let mut sums: std::collections::HashMap<u32, (f64, f64)> = std::collections::HashMap::new();
        for fragment in self.lists.as_ref().all.iter().filter(|f| !f.is_zero()) {
            let (sum, count) = sums.entry(fragment.primitive).or_default();
            *sum += f64::from(fragment.depth);
            *count += 1.0;
        }
        CentroidDepths::Sparse(sums.into_iter().map(|(key, (sum, n))| (key, sum / n)).collect())
    }
}

/// View depth of primitives by id.
#[derive(Debug, Clone)]
pub enum CentroidDepths {
    /// Indexed by primitive id.
    Dense(Vec<f64>),
    /// Only the primitives that occur.
    Sparse(std::collections::HashMap<u32, f64>),
}

impl CentroidDepths {
    /// The depth of `primitive`; one that has none is taken as nearest.
    pub fn get(&self, primitive: u32) -> f64 {
        match self {
            Self::Dense(depths) => depths[primitive as usize],
            Self::Sparse(depths) => depths.get(&primitive).copied().unwrap_or(0.0),
        }
    }
}

/// The largest width and height, in pixels: twice what GPUs offer as a texture, and far inside the
/// rasteriser's guard band.
pub const MAX_SIZE: u32 = 32_768;

pub(crate) fn check_size(width: u32, height: u32) -> Result<()> {
    for (name, value) in [("width", width), ("height", height)] {
        if !(1..=MAX_SIZE).contains(&value) {
            return Err(Error::argument(name, format!("{value} is not in [1, {MAX_SIZE}]")));
        }
    }
    Ok(())
}

pub(crate) fn check_clip_planes(near: f64, far: f64) -> Result<()> {
    if !(near.is_finite() && near > 0.0) {
        return Err(Error::argument("near", format!("{near} is not a finite number > 0")));
    }
    if !(far.is_finite() && far > near) {
        return Err(Error::argument("far", format!("{far} is not a finite number > near = {near}")));
    }
    Ok(())
}

pub(crate) fn check_color(argument: &'static str, color: [f32; 3]) -> Result<()> {
    if color.iter().all(|c| c.is_finite() && *c >= 0.0) {
        return Ok(());
    }
    let [r, g, b] = color;
    Err(Error::argument(argument, format!("({r}, {g}, {b}) has a channel that is not finite and >= 0")))
}

/// Feeds numbers to the hasher in blocks, so that large arrays hash at memory speed.
pub(crate) fn hash_words<T: Copy, const N: usize>(
    hasher: &mut blake3::Hasher,
    words: &[T],
    bytes: fn(T) -> [u8; N],
) {
    let mut block = Vec::with_capacity(4096 * N);
    for chunk in words.chunks(4096) {
        block.clear();
        chunk.iter().for_each(|w| block.extend_from_slice(&bytes(*w)));
        hasher.update(&block);
    }
}

fn check_offsets(lists: &Lists, pixels: usize) -> Result<()> {
    let offsets = &lists.offsets;
    let fault = |problem| Err(Error::argument("offsets", problem));
    if offsets.len() != pixels + 1 {
        return fault(format!(
            "has {} entries, width * height + 1 = {} are needed",
            offsets.len(),
            pixels + 1
        ));
    }
    if offsets[0] != 0 {
        return fault(format!("starts with {}, not with 0", offsets[0]));
    }
    if let Some(i) = (0..pixels).find(|&i| offsets[i + 1] < offsets[i]) {
        return fault(format!("falls from {} to {} at index {}", offsets[i], offsets[i + 1], i + 1));
    }
    let n = lists.depth.len();
    if usize::try_from(offsets[pixels]) != Ok(n) {
        return fault(format!("ends with {}, but depth has {n} entries", offsets[pixels]));
    }
    let lengths =
        [("color", lists.color.len()), ("alpha", lists.alpha.len()), ("primitive", lists.primitive.len())];
    for (name, length) in lengths {
        if length != n {
            return Err(Error::argument(name, format!("has {length} entries, but depth has {n}")));
        }
    }
    Ok(())
}

fn check_values(lists: &Lists) -> Result<()> {
    let first = |bad: &dyn Fn(usize) -> bool| (0..lists.len()).find(|&i| bad(i));
    if let Some(i) = first(&|i| !(lists.depth[i].is_finite() && lists.depth[i] >= 0.0)) {
        let z = lists.depth[i];
        return Err(Error::argument("depth", format!("entry {i} is {z}, not a finite number >= 0")));
    }
    if let Some(i) = first(&|i| !(0.0..=1.0).contains(&lists.alpha[i])) {
        return Err(Error::argument("alpha", format!("entry {i} is {}, not in [0, 1]", lists.alpha[i])));
    }
    if let Some(i) = first(&|i| !lists.color[i].iter().all(|c| c.is_finite() && *c >= 0.0)) {
        let c = lists.color[i];
        return Err(Error::argument("color", format!("entry {i} is {c:?}, not three finite numbers >= 0")));
    }
    Ok(())
}

fn check_background(background: &Background, width: u32, height: u32) -> Result<()> {
    match background {
        Background::Constant(color) => check_color("background", *color),
        Background::Image(colors) => {
            let pixels = width as usize * height as usize;
            if colors.len() != pixels {
                let problem = format!("has {} pixels, width * height = {pixels} are needed", colors.len());
                return Err(Error::argument("background", problem));
            }
            let bad = colors.iter().position(|c| !c.iter().all(|x| x.is_finite() && *x >= 0.0));
            bad.map_or(Ok(()), |i| {
                let (x, y) = (i % width as usize, i / width as usize);
                let problem =
                    format!("pixel (x={x}, y={y}) is {:?}, not three finite numbers >= 0", colors[i]);
                Err(Error::argument("background", problem))
            })
        }
    }
}

fn check_primitive_depth(depths: &[f64], primitives: &[u32]) -> Result<()> {
    if let Some(i) = depths.iter().position(|z| !z.is_finite()) {
        return Err(Error::argument("primitive_depth", format!("entry {i} is {}, not finite", depths[i])));
    }
    match primitives.iter().position(|p| *p as usize >= depths.len()) {
        None => Ok(()),
        Some(i) => Err(Error::argument(
            "primitive",
            format!("entry {i} is {}, but primitive_depth has {} entries", primitives[i], depths.len()),
        )),
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
        assert_eq!(fragments.centroid_depths().get(1), 2.5);
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
    }
}
