//! The image cut into tiles.

use super::cover::{Rect, centers};

/// The image cut into square tiles.
#[derive(Debug, Clone, Copy)]
pub struct Tiling {
    width: i32,
    height: i32,
    size: i32,
    /// 1 / `size`: there are quicker ways to divide than to divide.
    per_pixel: f32,
}

impl Tiling {
    /// Tiles of `size` pixels for an image of the given size.
    #[expect(clippy::cast_possible_wrap, clippy::cast_precision_loss, reason = "all are at most MAX_SIZE")]
    pub fn new(width: u32, height: u32, size: u32) -> Self {
        Self {
            width: width as i32,
            height: height as i32,
            size: size as i32,
            per_pixel: (size as f32).recip(),
        }
    }
    /// Columns of pixels.
    pub fn width(&self) -> i32 {
        self.width
    }
    /// Rows of pixels.
    pub fn height(&self) -> i32 {
        self.height
    }
    /// The inverse of a tile's size.
    pub fn per_pixel(&self) -> f32 {
        self.per_pixel
    }
    /// Tiles per row.
    #[expect(clippy::cast_sign_loss, reason = "never negative")]
    pub fn columns(&self) -> usize {
        ((self.width + self.size - 1) / self.size) as usize
    }
    /// Rows of tiles.
    #[expect(clippy::cast_sign_loss, reason = "never negative")]
    pub fn rows(&self) -> usize {
        ((self.height + self.size - 1) / self.size) as usize
    }
    /// The pixels of a tile.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_possible_wrap,
        reason = "fewer tiles than pixels"
    )]
    pub fn rect(&self, column: usize, row: usize) -> Rect {
        let (x0, y0) = (column as i32 * self.size, row as i32 * self.size);
        let (x1, y1) = ((x0 + self.size).min(self.width), (y0 + self.size).min(self.height));
        Rect { x0, y0, x1, y1 }
    }

    /// The tiles that the sub-pixel bounds touch, as ranges of columns and rows; `None` when the bounds hold
    /// no pixel centre of the image.
    pub fn touched(&self, points: impl Iterator<Item = (i32, i32)>) -> Option<TileRange> {
        let (mut lo, mut hi) = ((i32::MAX, i32::MAX), (i32::MIN, i32::MIN));
        for (x, y) in points {
            lo = (lo.0.min(x), lo.1.min(y));
            hi = (hi.0.max(x), hi.1.max(y));
        }
        let axis = |lo, hi, limit: i32| {
            let (first, last) = centers(lo, hi);
            let (first, last) = (first.max(0), last.min(limit));
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "within the image")]
            let tile = |pixel| tile_of(pixel, self.per_pixel) as u16;
            (first < last).then(|| (tile(first), tile(last - 1)))
        };
        let (x0, x1) = axis(lo.0, hi.0, self.width)?;
        let (y0, y1) = axis(lo.1, hi.1, self.height)?;
        Some(TileRange { x0, y0, x1, y1 })
    }
}

/// Columns and rows of tiles, all inclusive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TileRange {
    pub x0: u16,
    pub y0: u16,
    pub x1: u16,
    pub y1: u16,
}

impl TileRange {
    /// Calls `visit` with the tiles' numbers, row by row.
    #[inline]
    pub fn for_each(self, columns: usize, mut visit: impl FnMut(usize)) {
        (self.y0..=self.y1).for_each(|y| {
            let row = usize::from(y) * columns;
            (self.x0..=self.x1).for_each(|x| visit(row + usize::from(x)));
        });
    }
}

/// The column or row of tiles that a pixel of the image is in. Half a pixel off, no rounding matters: positions are
/// below 2^17, and errors 2^-24 of them.
#[inline(always)]
#[expect(
    clippy::cast_precision_loss,
    clippy::cast_possible_wrap,
    reason = "pixels of the image, and the last bits"
)]
pub fn tile_of(pixel: i32, per_pixel: f32) -> i32 {
    // adding it leaves no place for fractions, so that what is added is rounded; half less, it is rounded down
    const ROUND: f32 = 12_582_912.0; // 1.5 * 2^23
    let rounded = (pixel as f32 + 0.5) * per_pixel - 0.5 + ROUND;
    rounded.to_bits() as i32 - ROUND.to_bits() as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pixel_is_in_the_tile_that_division_says() {
        for size in (1..=130).chain([255, 256, 257, 999, 4096, 10_007, 32_767, 65_535, 65_536]) {
            let tiling = Tiling::new(65_536, 65_536, size);
            for pixel in 0..65_536 {
                let tile = i32::try_from(pixel / size).unwrap();
                assert_eq!(tile_of(pixel.cast_signed(), tiling.per_pixel()), tile, "{pixel} {size}");
            }
        }
    }
}
