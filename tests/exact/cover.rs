//! Coverage from its definition: one pixel centre at a time, in integers that no product leaves.

/// A point in sub-pixels, 256 to a pixel.
pub type Point = (i64, i64);

/// The centre of a pixel.
fn center(x: i64, y: i64) -> Point {
    (256 * x + 128, 256 * y + 128)
}

/// Twice the area that a -> b -> p has, positive where p lies clockwise on a screen with y down.
fn edge(a: Point, b: Point, p: Point) -> i128 {
    let (dx, dy) = (i128::from(b.0 - a.0), i128::from(b.1 - a.1));
    dx * i128::from(p.1 - a.1) - dy * i128::from(p.0 - a.0)
}

/// Twice the signed area of an outline.
pub fn doubled_area(points: &[Point]) -> i128 {
    let next = |i: usize| points[(i + 1) % points.len()];
    let cross = |a: Point, b: Point| i128::from(a.0) * i128::from(b.1) - i128::from(b.0) * i128::from(a.1);
    (0..points.len()).map(|i| cross(points[i], next(i))).sum()
}

/// The rule of D3D and Vulkan: inside all three edges, or on one that is a top or a left one.
pub fn triangle_covers(triangle: [Point; 3], x: i64, y: i64) -> bool {
    let [a, mut b, mut c] = triangle;
    if edge(a, b, c) < 0 {
        (b, c) = (c, b);
    }
    let p = center(x, y);
    edge(a, b, c) != 0
        && [(a, b), (b, c), (c, a)].into_iter().all(|(from, to)| {
            let top = from.1 == to.1 && from.0 < to.0;
            let left = to.1 < from.1;
            let inside = edge(from, to, p);
            inside > 0 || (inside == 0 && (top || left))
        })
}

/// The same rule for any closed outline: a ray to the left crosses it an odd number of times, with edges that hold
/// their upper end but not their lower one, and centres on an edge to the right of it.
pub fn outline_covers(points: &[Point], x: i64, y: i64) -> bool {
    let p = center(x, y);
    let crossed = (0..points.len()).filter(|&i| {
        let (a, b) = (points[i], points[(i + 1) % points.len()]);
        let (top, bottom) = if a.1 < b.1 { (a, b) } else { (b, a) };
        // walked downwards, what lies to the right has a negative edge function
        top.1 <= p.1 && p.1 < bottom.1 && edge(top, bottom, p) <= 0
    });
    doubled_area(points) != 0 && crossed.count() % 2 == 1
}

/// The pixels of an image that can be covered by their bounding box, row by row.
pub fn candidates(points: &[Point], width: u32, height: u32) -> impl Iterator<Item = (i64, i64)> {
    let range = |of: fn(&Point) -> i64, limit: u32| {
        let least = points.iter().map(of).min().unwrap_or(0).div_euclid(256) - 1;
        let most = points.iter().map(of).max().unwrap_or(0).div_euclid(256) + 1;
        least.max(0)..(most + 1).min(i64::from(limit))
    };
    let (xs, ys) = (range(|p| p.0, width), range(|p| p.1, height));
    ys.flat_map(move |y| xs.clone().map(move |x| (x, y)))
}
