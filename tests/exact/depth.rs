//! Depth at a pixel centre without rounding, and how far a fragment's depth is from it.

use super::cover::Point;
use super::dyadic::Dyadic;
use super::screen::{Outline, Screen};
use glam::DVec3;

/// A nonnegative fraction.
struct Fraction(Dyadic, Dyadic);

impl Fraction {
    /// `|x - self| / self`.
    fn relative_error(&self, x: f64) -> f64 {
        (&(&Dyadic::from(x) * &self.1) - &self.0).abs().ratio(&self.0)
    }

    /// Whether it lies below x.
    fn is_below(&self, x: f64) -> bool {
        (&self.0 - &(&Dyadic::from(x) * &self.1)).sign() < 0
    }
}

/// The relative error of the depth `z` of a fragment of `outline` at pixel (x, y).
pub fn relative_error(screen: &Screen, outline: &Outline, (x, y): (i64, i64), z: f32) -> f64 {
    let exact = match outline {
        Outline::Whole(points, depths) => of_snapped(*points, *depths, (x, y), screen.perspective),
        Outline::Cut(_, corners) => of_ray(screen, *corners, (x, y)),
    };
    let (near, far) = screen.clip_range();
    let clipped = if exact.is_below(near) {
        Fraction(near.into(), 1.into())
    } else if exact.is_below(far) {
        exact
    } else {
        Fraction(far.into(), 1.into())
    };
    clipped.relative_error(f64::from(z))
}

/// Depths of the snapped corners, weighted by the areas that the centre cuts off; 1 / z instead in perspective.
fn of_snapped([a, b, c]: [Point; 3], z: [f64; 3], (x, y): (i64, i64), perspective: bool) -> Fraction {
    let p = (256 * x + 128, 256 * y + 128);
    let area = |a: Point, b: Point, c: Point| (b.0 - a.0) * (c.1 - a.1) - (c.0 - a.0) * (b.1 - a.1);
    let sign = area(a, b, c).signum();
    let weights = [area(p, b, c), area(a, p, c), area(a, b, p)].map(|w| Dyadic::from(sign * w));
    let whole = Dyadic::from(sign * area(a, b, c));
    let z = z.map(Dyadic::from);
    let sum = |terms: [Dyadic; 3]| &(&terms[0] + &terms[1]) + &terms[2];
    if !perspective {
        return Fraction(sum([0, 1, 2].map(|i| &weights[i] * &z[i])), whole);
    }
    // A / (sum of w_i / z_i), times the product of all z
    let others = [0, 1, 2].map(|i: usize| &z[(i + 1) % 3] * &z[(i + 2) % 3]);
    let product = &others[0] * &z[0];
    Fraction(&whole * &product, sum([0, 1, 2].map(|i| &weights[i] * &others[i])))
}

type Vector = [Dyadic; 3];

fn dot(a: &Vector, b: &Vector) -> Dyadic {
    &(&(&a[0] * &b[0]) + &(&a[1] * &b[1])) + &(&a[2] * &b[2])
}

fn cross(a: &Vector, b: &Vector) -> Vector {
    [(1, 2), (2, 0), (0, 1)].map(|(i, j)| &(&a[i] * &b[j]) - &(&a[j] * &b[i]))
}

/// A triangle's corners, and the volumes that a ray cuts off with each pair of them: of one sign where it meets the
/// triangle.
struct Seen {
    corners: [Vector; 3],
    volumes: Vector,
}

/// A triangle in view space seen through a point of the image, which is given in pixels.
fn see(screen: &Screen, corners: [DVec3; 3], [x, y]: [f64; 2]) -> Seen {
    let scale = Dyadic::from(screen.scale);
    let [dx, dy] = [x - screen.middle[0], screen.middle[1] - y].map(Dyadic::from);
    let all = corners.map(|p| p.to_array().map(Dyadic::from));
    // the ray, `scale` times as long; where it is parallel to the others, corners move to its start instead
    let (direction, seen) = if screen.perspective {
        ([dx, dy, scale], all.clone())
    } else {
        let to = |[x, y, z]: Vector| [&(&x * &scale) - &dx, &(&y * &scale) - &dy, &z * &scale];
        ([0, 0, 1].map(Dyadic::from), all.clone().map(to))
    };
    let volumes = [(1, 2), (2, 0), (0, 1)].map(|(i, j)| dot(&direction, &cross(&seen[i], &seen[j])));
    Seen { corners: all, volumes }
}

fn sum(v: &Vector) -> Dyadic {
    &(&v[0] + &v[1]) + &v[2]
}

/// Where the pixel's ray meets the triangle; beside it, weights of the corners stop at zero.
fn of_ray(screen: &Screen, corners: [DVec3; 3], (x, y): (i64, i64)) -> Fraction {
    let Seen { corners, volumes } = see(screen, corners, [x as f64 + 0.5, y as f64 + 0.5]);
    let sign = i64::from(sum(&volumes).sign());
    let weights = volumes.map(|v| {
        let turned = &v * &sign.into();
        if turned.sign() < 0 { 0.into() } else { turned }
    });
    let (whole, depths) = (sum(&weights), corners.map(|[_, _, z]| z));
    if whole.sign() == 0 { Fraction(sum(&depths), 3.into()) } else { Fraction(dot(&weights, &depths), whole) }
}

/// Whether a triangle in view space is to be seen at a point of the image, in pixels, between near and far.
pub fn is_seen(screen: &Screen, corners: [DVec3; 3], at: [f64; 2]) -> bool {
    let Seen { corners, volumes } = see(screen, corners, at);
    let whole = sum(&volumes);
    let sign = i64::from(whole.sign());
    let weights = volumes.map(|v| &v * &sign.into());
    if sign == 0 || weights.iter().any(|w| w.sign() < 0) {
        return false;
    }
    let depth = Fraction(dot(&weights, &corners.map(|[_, _, z]| z)), &whole * &sign.into());
    let (near, far) = screen.clip_range();
    !depth.is_below(near) && depth.is_below(far)
}
