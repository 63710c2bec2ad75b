//! Primitives as the shaders have them: outlines that the hardware covers as the CPU does, and depth functions that lose
//! nothing on the way to f32.

use crate::raster::{Drawn, Linear, Mask, Outline, Paint, Rect, Shade, pixel_bounds_of};

/// Words of a `Primitive` in `shaders/blocks/fragment.wgsl`.
pub const PRIMITIVE: usize = 28;
/// Words of a `VaryingColor`.
const VARYING_COLOR: usize = 28;
/// No varying colour.
const NONE: u32 = u32::MAX;

/// The square that the hardware maps onto its clip space. What lies in it is not clipped; its size is a power of two, so that
/// no bit of a corner is lost on the way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Viewport {
    /// Its left and top edge in pixels of the image; negative.
    pub origin: (i32, i32),
    /// Its size in pixels.
    pub size: u32,
}

impl Viewport {
    /// The viewport for an image, four times as large as the image if the device allows viewports of that size.
    #[expect(clippy::cast_possible_wrap, reason = "images are at most MAX_SIZE")]
    pub fn new(width: u32, height: u32, limit: u32) -> Self {
        let most = if limit.is_power_of_two() { limit } else { limit.next_power_of_two() / 2 };
        let size = (4 * width.max(height)).next_power_of_two().min(most);
        let begin = |extent: u32| -((size as i32 - extent as i32) / 2);
        Self { origin: (begin(width), begin(height)), size }
    }

    /// Its centre in sub-pixels.
    pub fn center(&self) -> (i32, i32) {
        let half = (self.size / 2).cast_signed();
        (256 * (self.origin.0 + half), 256 * (self.origin.1 + half))
    }

    fn holds(&self, points: &[(i32, i32)]) -> bool {
        let (center, half) = (self.center(), 128 * self.size.cast_signed());
        let inside = |x: i32, center: i32| (x - center).abs() < half;
        points.iter().all(|p| inside(p.0, center.0) && inside(p.1, center.1))
    }
}

/// What primitives may have. Shaders know what there is none of, since devices that run both sides of a branch pay for it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Traits {
    /// Outlines that are not those of the triangles that are drawn.
    pub outlines: bool,
    /// Depths that vary over a primitive.
    pub slopes: bool,
    /// Colours that vary over a primitive.
    pub varying_colors: bool,
    /// Fragments that neither cover nor emit.
    pub zero_fragments: bool,
}

/// Primitives for one draw call, as words.
#[derive(Debug, Default)]
pub struct Packed {
    pub primitives: Vec<[u32; PRIMITIVE]>,
    pub varying: Vec<[u32; VARYING_COLOR]>,
    pub outlines: Vec<[i32; 2]>,
    pub traits: Traits,
}

impl Packed {
    /// The bytes of its largest part with one more primitive.
    pub fn bytes_with_one_more(&self) -> u64 {
        const CORNERS: usize = 9;
        let words = [
            (self.primitives.len() + 1) * PRIMITIVE,
            (self.varying.len() + 1) * VARYING_COLOR,
            (self.outlines.len() + CORNERS) * 2,
        ];
        4 * words.into_iter().max().unwrap_or(0) as u64
    }

    /// Adds a primitive.
    #[expect(clippy::cast_possible_truncation, reason = "buffers hold far less than 2^32 records")]
    pub fn push(&mut self, drawn: &Drawn<'_>, viewport: &Viewport, image: &Rect, perspective: bool) {
        let mut record = Record::default();
        self.outline(drawn, viewport, image, &mut record);
        record.signed([drawn.anchor.0, drawn.anchor.1]);
        let (near, far) = (drawn.range.0 as f32, drawn.range.1 as f32);
        // the power of two below the largest depth keeps inverse depths away from f32's ends
        let unit = if perspective { f64::from(f32::from_bits(far.to_bits() & 0x7f80_0000)) } else { 1.0 };
        let scaled = |l: &Linear| Linear { at: l.at * unit, x: l.x * unit, y: l.y * unit };
        let depth = scaled(&drawn.depth);
        let bounds = pixel_bounds_of(drawn.outline.points(), image);
        let [at, x, y] = in_parts(&depth, reach(&bounds, drawn.anchor));
        record.floats(at);
        record.signed([drawn.primitive.cast_signed()]);
        record.floats(x);
        record.signed([record.outline.0]);
        record.floats(y);
        record.signed([record.outline.1]);
        let varying = match drawn.paint {
            Paint::Flat(color) => {
                record.floats(color);
                NONE
            }
            Paint::Varying(shade) => {
                record.floats([0.0; 4]);
                self.varying.push(varying_color(&shade, &drawn.weights.map(|w| scaled(&w))));
                (self.varying.len() - 1) as u32
            }
        };
        record.floats([near, far]);
        record.signed([varying.cast_signed()]);
        let has = &mut self.traits;
        has.outlines |= record.outline.1 > 0;
        has.slopes |= near < far;
        has.varying_colors |= varying != NONE;
        has.zero_fragments |=
            varying != NONE || matches!(drawn.paint, Paint::Flat(color) if color == [0.0; 4]);
        self.primitives.push(record.words);
    }

    /// Whole triangles in the viewport are what they are; of others the hardware draws more, and the shader leaves out what is
    /// not theirs.
    #[expect(clippy::cast_possible_truncation, clippy::cast_possible_wrap, reason = "few corners")]
    fn outline(&mut self, drawn: &Drawn<'_>, viewport: &Viewport, image: &Rect, record: &mut Record) {
        let points = drawn.outline.points();
        if let Outline::Triangle(corners) = drawn.outline
            && viewport.holds(points)
        {
            corners.iter().for_each(|&(x, y)| record.signed([x, y]));
            return;
        }
        let Rect { x0, y0, x1, y1 } = pixel_bounds_of(points, image);
        for (x, y) in [(x0, y0), (2 * x1 - x0, y0), (x0, 2 * y1 - y0)] {
            record.signed([256 * x, 256 * y]);
        }
        record.outline = (self.outlines.len() as i32, points.len() as i32);
        self.outlines.extend(points.iter().map(|&(x, y)| [x, y]));
    }
}

/// A primitive's words as they come.
#[derive(Default)]
struct Record {
    words: [u32; PRIMITIVE],
    next: usize,
    /// Where its outline begins and how many corners it has.
    outline: (i32, i32),
}

impl Record {
    fn signed<const N: usize>(&mut self, numbers: [i32; N]) {
        numbers.iter().for_each(|n| self.word(n.cast_unsigned()));
    }
    fn floats<const N: usize>(&mut self, numbers: [f32; N]) {
        numbers.iter().for_each(|x| self.word(x.to_bits()));
    }
    fn word(&mut self, word: u32) {
        self.words[self.next] = word;
        self.next += 1;
    }
}

/// The nearest finite f32.
#[expect(clippy::cast_possible_truncation, reason = "that is what it is for")]
fn single(x: f64) -> f32 {
    x.clamp(f64::from(f32::MIN), f64::from(f32::MAX)) as f32
}

/// Pixels from the anchor to the furthest one within the bounds, along either axis.
fn reach(bounds: &Rect, anchor: (i32, i32)) -> [f64; 2] {
    let axis =
        |anchor: i32, first: i32, end: i32| f64::from((anchor - first).abs().max((end - anchor).abs()));
    [axis(anchor.0, bounds.x0, bounds.x1), axis(anchor.1, bounds.y0, bounds.y1)]
}

/// The numbers of a linear function, each in three parts. The first two are whole multiples of a power of two, small enough that
/// any sum of such parts at up to that many pixels from the anchor is exact in f32; the third is the rest.
fn in_parts(function: &Linear, reach: [f64; 2]) -> [[f32; 3]; 3] {
    const EXPONENT: u64 = 0x7ff << 52;
    let mut rests = [function.at, function.x, function.y].map(single_range);
    let mut parts = [[0.0; 3]; 3];
    for part in 0..2 {
        let most = rests[0].abs() + rests[1].abs() * reach[0] + rests[2].abs() * reach[1];
        // 24 digits, of which none is below those of f32
        let step = (f64::from_bits(most.to_bits() & EXPONENT) / f64::from(1 << 23))
            .max(f64::from(f32::from_bits(1)));
        for (rest, parts) in rests.iter_mut().zip(&mut parts) {
            let whole = (*rest / step).trunc() * step;
            parts[part] = single(whole);
            *rest -= whole;
        }
    }
    rests.iter().zip(&mut parts).for_each(|(rest, parts)| parts[2] = single(*rest));
    parts
}

fn single_range(x: f64) -> f64 {
    x.clamp(f64::from(f32::MIN), f64::from(f32::MAX))
}

fn varying_color(shade: &Shade, weights: &[Linear; 3]) -> [u32; VARYING_COLOR] {
    let mask = shade.mask().unwrap_or(Mask { alphas: [0.0; 3], cutoff: -1.0 });
    let weights = weights.iter().flat_map(|w| [single(w.at), single(w.x), single(w.y), 0.0]);
    let corners = shade.corners();
    let floats = weights.chain(corners.into_iter().flatten()).chain(mask.alphas).chain([mask.cutoff]);
    let mut words = [0; VARYING_COLOR];
    words.iter_mut().zip(floats).for_each(|(word, x)| *word = x.to_bits());
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_viewport_is_a_power_of_two_around_the_image() {
        let viewport = Viewport::new(1280, 720, 16_384);
        assert_eq!(viewport, Viewport { origin: (-3456, -3736), size: 8192 });
        assert_eq!(viewport.center(), (256 * 640, 256 * 360));
        assert_eq!(Viewport::new(9000, 10, 16_384).size, 16_384);
        assert_eq!(Viewport::new(5, 4, 10_000).size, 32);
        assert!(viewport.holds(&[(0, 0), (-3455 * 256, 0)]) && !viewport.holds(&[(-3456 * 256, 0)]));
    }

    #[test]
    fn parts_add_up_and_sums_of_their_products_are_exact() {
        let functions = [
            (0.123_456_789_012_345, -9.87e-7, 3.21e-5),
            (-7.77e8, 1.0, -1.0 / 3.0),
            (0.1, 55.5, -77.7),
            (1e-44, 1e-45, 0.0),
            (0.0, 0.0, 0.0),
        ];
        for ((at, x, y), reach) in
            functions.into_iter().flat_map(|f| [0_i32, 3, 1919, 16_383].map(|n| (f, n)))
        {
            let parts = in_parts(&Linear { at, x, y }, [reach.into(), reach.into()]);
            for (dx, dy) in [(reach, -reach), (-reach, -reach), (reach / 2, reach), (1, 0)] {
                if dx.abs().max(dy.abs()) > reach {
                    continue;
                }
                #[expect(clippy::cast_precision_loss, reason = "whole numbers of less than 2^24")]
                let [px, py] = [dx as f32, dy as f32];
                let (wide_x, wide_y) = (f64::from(dx), f64::from(dy));
                let mut sum = 0.0;
                for part in 0..3 {
                    let [at, x, y] = parts.map(|of| of[part]);
                    let wide = f64::from(at) + f64::from(x) * wide_x + f64::from(y) * wide_y;
                    let single = at + (x * px + y * py);
                    assert!(part == 2 || f64::from(single) == wide, "{parts:?} {dx} {dy}: {single} {wide}");
                    sum += f64::from(single);
                }
                let exact = at + x * wide_x + y * wide_y;
                let most = at.abs() + (x * wide_x).abs() + (y * wide_y).abs();
                // the last two in one, as where depths are only weighed
                let of_first = |[first, ..]: [f32; 3]| first;
                let of_rest = |[_, second, third]: [f32; 3]| second + third;
                let [first, rest] = [&of_first as &dyn Fn([f32; 3]) -> f32, &of_rest]
                    .map(|of| of(parts[0]) + (of(parts[1]) * px + of(parts[2]) * py));
                let near = (f64::from(first + rest) - exact).abs();
                assert!(near <= 6.1e-8 * exact.abs() + 2e-12 * most + 1e-40, "{parts:?} {dx} {dy}: {near}");
                // the least that an f32 holds, where numbers are that small
                let least = f64::from(f32::from_bits(1)) * (1.0 + wide_x.abs() + wide_y.abs());
                let off = (sum - exact).abs();
                assert!(off <= 2e-12 * most + least, "{parts:?} {dx} {dy}: {sum} {exact}");
            }
        }
    }
}
