//! Per-pixel fragment lists in arrival order, stored as compressed sparse rows.

mod check;
mod image;

pub use check::MAX_SIZE;
pub(crate) use check::{check_clip_planes, check_color, check_size};
pub use image::{Background, Fragments, FragmentsInput};

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
    /// Appends a row.
    pub fn append_list(&mut self, row: List<'_>) {
        self.depth.extend_from_slice(row.depth);
        self.color.extend_from_slice(row.color);
        self.alpha.extend_from_slice(row.alpha);
        self.primitive.extend_from_slice(row.primitive);
        self.end_row();
    }
    /// So many rows without fragments.
    pub fn empty_rows(rows: usize) -> Self {
        Self { offsets: vec![0; rows + 1], ..Self::default() }
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
