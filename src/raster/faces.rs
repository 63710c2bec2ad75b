//! A block of faces looked at together: which of them can be seen, and where. Coordinates lie side by side, and plain
//! loops over the faces become loops of vectors.

use super::project::{CENTER, SUBPIXELS, ScreenVertex};
use super::tiling::{TileRange, Tiling, tile_of};
use multiversion::multiversion;

/// Faces that are looked at together, while the vertices of as many more are fetched.
pub const BLOCK: usize = 64;

/// The faces at hand.
#[derive(Default)]
pub struct Block {
    count: usize,
    corners: Corners,
    looked: Looked,
}

/// The three corners of every face.
struct Corners {
    x: [[i32; BLOCK]; 3],
    y: [[i32; BLOCK]; 3],
    z: [[f64; BLOCK]; 3],
}

/// What was found of every face.
struct Looked {
    /// The first and the last column of tiles that it touches, and the first and the last row.
    tiles: [[i32; BLOCK]; 4],
    /// Whether it is seen, and whether it has to be clipped before that can be said.
    seen: [bool; BLOCK],
    outside: [bool; BLOCK],
    faces_camera: [bool; BLOCK],
    /// The depths of its nearest and farthest corner.
    nearest: [f64; BLOCK],
    farthest: [f64; BLOCK],
}

impl Default for Corners {
    fn default() -> Self {
        Self { x: [[0; BLOCK]; 3], y: [[0; BLOCK]; 3], z: [[0.0; BLOCK]; 3] }
    }
}

impl Default for Looked {
    fn default() -> Self {
        let (no, zero) = ([false; BLOCK], [0.0; BLOCK]);
        Self {
            tiles: [[0; BLOCK]; 4],
            seen: no,
            outside: no,
            faces_camera: no,
            nearest: zero,
            farthest: zero,
        }
    }
}

/// What becomes of a face.
pub enum Found {
    /// It covers no pixel centre for sure.
    Nothing,
    /// It is seen as it is.
    Triangle { tiles: TileRange, faces_camera: bool },
    /// It has to be clipped.
    Outside,
}

impl Block {
    /// From here on these are the faces at hand, up to [`BLOCK`], given by their corners.
    pub fn set(&mut self, faces: &[[ScreenVertex; 3]]) {
        self.count = faces.len();
        let Corners { x, y, z } = &mut self.corners;
        for (i, vertices) in faces.iter().enumerate().take(BLOCK) {
            for (corner, vertex) in vertices.iter().enumerate() {
                x[corner][i] = vertex.x;
                y[corner][i] = vertex.y;
                z[corner][i] = vertex.z;
            }
        }
    }

    /// Looks at the faces; the smallest and the largest depth of their corners.
    pub fn look(&mut self, tiling: &Tiling, double_sided: bool) -> (f64, f64) {
        let Self { count, corners, looked } = self;
        look(*count, corners, tiling, double_sided, looked);
        let lo = looked.nearest[..*count].iter().fold(f64::INFINITY, |lo, &z| lo.min(z));
        (lo, looked.farthest[..*count].iter().fold(f64::NEG_INFINITY, |hi, &z| hi.max(z)))
    }

    /// What becomes of the faces.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "tiles of the image")]
    pub fn found(&self) -> impl Iterator<Item = Found> {
        let Looked { tiles, seen, outside, faces_camera, .. } = &self.looked;
        (0..self.count).map(move |i| match (outside[i], seen[i]) {
            (true, _) => Found::Outside,
            (false, false) => Found::Nothing,
            (false, true) => {
                let tile = |k: usize| tiles[k][i] as u16;
                let tiles = TileRange { x0: tile(0), x1: tile(1), y0: tile(2), y1: tile(3) };
                Found::Triangle { tiles, faces_camera: faces_camera[i] }
            }
        })
    }
}

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
#[expect(clippy::needless_bitwise_bool, reason = "without branches")]
fn look(count: usize, corners: &Corners, tiling: &Tiling, double_sided: bool, looked: &mut Looked) {
    let Corners { x, y, z } = corners;
    let Looked { tiles, seen, outside, faces_camera, nearest, farthest } = looked;
    let count = count.min(BLOCK);
    let [x0, x1, y0, y1] = tiles;
    let mut columns = [false; BLOCK];
    touch(count, x, tiling.width(), tiling.per_pixel(), x0, x1, &mut columns);
    touch(count, y, tiling.height(), tiling.per_pixel(), y0, y1, seen);
    for i in 0..count {
        outside[i] = (x[0][i] == ScreenVertex::OUTSIDE)
            | (x[1][i] == ScreenVertex::OUTSIDE)
            | (x[2][i] == ScreenVertex::OUTSIDE);
    }
    for i in 0..count {
        // whole numbers below 2^26, whose products are exact
        let of = |of: &[[i32; BLOCK]; 3], corner: usize| f64::from(of[corner][i].wrapping_sub(of[0][i]));
        let doubled_area = of(x, 1) * of(y, 2) - of(x, 2) * of(y, 1);
        // front faces wind counter-clockwise in world space, which reads negative on a screen with y down
        seen[i] = seen[i] & columns[i] & ((doubled_area < 0.0) | (double_sided & (doubled_area > 0.0)));
    }
    for i in 0..count {
        let (lo, hi) =
            (lesser(lesser(z[0][i], z[1][i]), z[2][i]), greater(greater(z[0][i], z[1][i]), z[2][i]));
        (nearest[i], farthest[i], faces_camera[i]) = (lo, hi, lo == hi);
    }
}

/// The first and the last column of tiles that the bounds of faces touch, or rows, and whether they hold a pixel centre
/// at all.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn touch(
    count: usize,
    at: &[[i32; BLOCK]; 3],
    limit: i32,
    per_pixel: f32,
    first: &mut [i32; BLOCK],
    last: &mut [i32; BLOCK],
    any: &mut [bool; BLOCK],
) {
    for i in 0..count {
        let (a, b, c) = (at[0][i], at[1][i], at[2][i]);
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        // `centers`, which corners that were not projected must not overflow
        let begin = (low.wrapping_add(SUBPIXELS - 1 - CENTER) >> SUBPIXELS.ilog2()).max(0);
        let end = ((high.wrapping_sub(CENTER) >> SUBPIXELS.ilog2()) + 1).min(limit);
        first[i] = tile_of(begin, per_pixel);
        last[i] = tile_of(end - 1, per_pixel);
        any[i] = begin < end;
    }
}

/// The smaller of two numbers, in one instruction: no depth is NaN.
#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn lesser(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

#[inline(always)]
#[expect(clippy::inline_always, reason = "takes on its caller's instruction set")]
fn greater(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::hash32;
    use crate::raster::cover::doubled_area;

    #[test]
    fn faces_are_found_where_each_by_itself_is() {
        let (mut triangles, mut nothing, mut clipped) = (0, 0, 0);
        for (n, size) in [(0, 64), (1, 1), (2, 7), (3, 100), (4, 65_536)] {
            let (width, height) = ([1280, 65_536][n % 2], 720);
            let tiling = Tiling::new(width, height, size);
            let random = |i: usize, k: usize, below: u32| {
                hash32(u32::try_from(n).unwrap(), u32::try_from(i).unwrap(), u32::try_from(k).unwrap(), 0, 0)
                    % below
            };
            let vertex = |i: usize, k: usize| {
                let reach = [300, 5000, 1 << 24][i % 3];
                let (x, y) = (random(i, 9, 256 * width), random(i, 10, 256 * height));
                let near = |at: u32, k| (at + random(i, k, reach)).cast_signed() - reach.cast_signed() / 2;
                ScreenVertex {
                    x: if random(i, k, 19) == 0 { ScreenVertex::OUTSIDE } else { near(x, 3 * k + 20) },
                    y: near(y, 3 * k + 21),
                    z: f64::from(random(i / 2, k, 3)),
                }
            };
            let faces: Vec<_> = (0..600).map(|f| [vertex(f, 0), vertex(f, 1), vertex(f, 2)]).collect();
            for double_sided in [false, true] {
                let (mut block, mut looked_at) = (Block::default(), 0);
                let mut range = (f64::INFINITY, f64::NEG_INFINITY);
                for faces in faces.chunks(BLOCK) {
                    block.set(faces);
                    looked_at += faces.len();
                    let (lo, hi) = block.look(&tiling, double_sided);
                    range = (range.0.min(lo), range.1.max(hi));
                    for (found, v) in block.found().zip(faces) {
                        let points = v.map(|v| (v.x, v.y));
                        let is_seen = |area: i64| area < 0 || (area > 0 && double_sided);
                        let is_outside = v.iter().any(ScreenVertex::is_outside);
                        let expected = (!is_outside).then(|| tiling.touched(points.into_iter())).flatten();
                        match (found, expected) {
                            (Found::Outside, _) => {
                                assert!(is_outside, "{v:?}");
                                clipped += 1;
                            }
                            (Found::Triangle { tiles, faces_camera }, Some(expected)) => {
                                assert!(is_seen(doubled_area(&points)) && !is_outside);
                                assert_eq!(tiles, expected, "{v:?}");
                                assert_eq!(faces_camera, v.iter().all(|corner| corner.z == v[0].z));
                                triangles += 1;
                            }
                            (Found::Nothing, expected) => {
                                assert!(!is_outside);
                                assert!(expected.is_none() || !is_seen(doubled_area(&points)), "{v:?}");
                                nothing += 1;
                            }
                            (Found::Triangle { tiles, .. }, None) => panic!("{v:?} {tiles:?}"),
                        }
                    }
                }
                assert_eq!((looked_at, range), (600, (0.0, 2.0)));
            }
        }
        assert!(triangles > 1000 && nothing > 500 && clipped > 200, "{triangles} {nothing} {clipped}");
    }
}
