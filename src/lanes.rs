//! A tile's pixels eight by eight: whole vectors, aligned as vectors like to be, and masks where a run of pixels
//! begins or ends within one. Kernels walk over blocks rather than over runs, since a compiler that sees
//! the groups follow each other gathers lanes from eight of them instead of taking one at a time.

/// Pixels of a group.
pub const LANES: usize = 8;

/// One number per pixel of a group.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub struct Group<T>(pub [T; LANES]);

/// Groups enough for so many pixels, all with the same value.
pub fn reset<T: Copy>(groups: &mut Vec<Group<T>>, pixels: usize, value: T) {
    groups.clear();
    groups.resize(pixels.div_ceil(LANES), Group([value; LANES]));
}

/// The number of one pixel, to be changed.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
pub fn at_mut<T>(groups: &mut [Group<T>], pixel: usize) -> &mut T {
    &mut groups[pixel / LANES].0[pixel % LANES]
}

/// The number of one pixel.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
pub fn at<T: Copy>(groups: &[Group<T>], pixel: usize) -> T {
    groups[pixel / LANES].0[pixel % LANES]
}

/// Some pixels of a group.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Block {
    /// Which group.
    pub group: u32,
    /// Which of its pixels: a bit each.
    pub mask: u8,
}

impl Block {
    /// The group's index.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    pub fn index(self) -> usize {
        self.group as usize
    }

    /// 1 for the pixels that are among them, 0 for the others: what to multiply with where a branch per pixel
    /// would keep the compiler from taking all at once.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
    pub fn ones(self) -> [i32; LANES] {
        let mut ones = [0; LANES];
        for (lane, one) in ones.iter_mut().enumerate() {
            *one = i32::from(self.mask) >> lane & 1;
        }
        ones
    }
}

/// Appends the blocks of `len` pixels from `first` on.
#[inline]
pub fn push_blocks(first: u32, len: u32, blocks: &mut Vec<Block>) {
    const PIXELS: u32 = 8;
    let (last, end) = ((first + len - 1) / PIXELS, (first + len) % PIXELS);
    let from_start = !0 << (first % PIXELS);
    let before_end = if end == 0 { !0 } else { !(!0 << end) };
    if first / PIXELS == last {
        return blocks.push(Block { group: last, mask: from_start & before_end });
    }
    blocks.push(Block { group: first / PIXELS, mask: from_start });
    blocks.extend((first / PIXELS + 1..last).map(|group| Block { group, mask: !0 }));
    blocks.push(Block { group: last, mask: before_end });
}

/// `t *= 1 - alpha` for some pixels.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
pub fn attenuate_block(transmittance: &mut [f64; LANES], ones: &[i32; LANES], alpha: f64) {
    let mut t = *transmittance;
    for lane in 0..LANES {
        t[lane] *= 1.0 - alpha * f64::from(ones[lane]);
    }
    *transmittance = t;
}

/// One fragment more for some pixels.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
pub fn count_block(counts: &mut [u32; LANES], ones: &[i32; LANES]) {
    let mut n = *counts;
    for lane in 0..LANES {
        n[lane] += ones[lane].cast_unsigned();
    }
    *counts = n;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_are_cut_into_blocks() {
        for (first, len) in [(0, 1), (3, 2), (7, 1), (7, 2), (8, 8), (5, 30), (16, 64), (0, 8), (1, 7)] {
            let mut blocks = Vec::new();
            push_blocks(first, len, &mut blocks);
            let pixels = blocks.iter().flat_map(|block| {
                let lanes = (0..LANES).filter(|&lane| block.ones()[lane] == 1);
                lanes.map(|lane| block.index() * LANES + lane)
            });
            assert!(pixels.eq(first as usize..(first + len) as usize), "{first} {len}");
            assert!(blocks.iter().all(|block| block.mask != 0));
        }
    }
}
