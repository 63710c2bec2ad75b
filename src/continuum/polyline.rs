//! Piecewise linear transmittance: vertices that say which face of which fragment they are, so that coincident
//! fragments occlude each other as the reference has it (sheet 0.1).

use super::search::count_leading;
use crate::fragments::Fragment;
use crate::order::sort_key;

/// A face of a fragment. Faces are ordered as a ray from the eye meets them: by depth, then primitive, front
/// before back. Depths are not negative, so that their sign has room for that in one integer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Label(u64);

impl Label {
    fn new(depth: f32, primitive: u32, back: bool) -> Self {
        Self(sort_key(depth, primitive) << 1 | u64::from(back))
    }
    /// The nearest label at a depth: strictly in front of every fragment there.
    pub fn at(depth: f32) -> Self {
        Self::new(depth, 0, false)
    }
    /// A fragment's front.
    pub fn front(fragment: &Fragment) -> Self {
        Self::new(fragment.depth, fragment.primitive, false)
    }
    /// The back of a fragment that ends at `depth`.
    pub fn back(fragment: &Fragment, depth: f32) -> Self {
        Self::new(depth, fragment.primitive, true)
    }
    /// Where it is.
    pub fn depth(self) -> f64 {
        f32::from_bits((self.0 >> 33) as u32).into()
    }
}

/// Transmittance at a face.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Vertex {
    /// The face.
    pub label: Label,
    /// What reaches it.
    pub transmittance: f64,
}

/// Transmittance at `label` of a polyline with ascending labels: the vertex of that label, the last one of several;
/// else the value at that depth in front of the label, or behind it; else interpolated. 1 before the first vertex,
/// constant behind the last.
pub fn evaluate(vertices: &[Vertex], label: Label) -> f64 {
    evaluate_behind(vertices, count_in_front(vertices, label), label)
}

/// How many vertices are not behind `label`.
pub fn count_in_front(vertices: &[Vertex], label: Label) -> usize {
    count_leading(vertices, |v| v.label <= label)
}

/// [`evaluate`], given how many vertices are not behind the label.
pub fn evaluate_behind(vertices: &[Vertex], in_front: usize, label: Label) -> f64 {
    let (front, behind) = vertices.split_at(in_front);
    let Some(a) = front.last() else { return 1.0 };
    let z = label.depth();
    let transmittance = match behind.first() {
        _ if a.label.depth() == z => a.transmittance,
        None => a.transmittance,
        Some(b) if b.label.depth() == z => b.transmittance,
        Some(b) => {
            let share = (z - a.label.depth()) / (b.label.depth() - a.label.depth());
            a.transmittance + share * (b.transmittance - a.transmittance)
        }
    };
    transmittance.clamp(0.0, 1.0)
}

/// Twice the area of the triangle of three neighbours: what removing the middle one changes.
pub fn triangle(a: &Vertex, b: &Vertex, c: &Vertex) -> f64 {
    let (x, y) = (|v: &Vertex| v.label.depth(), |v: &Vertex| v.transmittance);
    ((x(c) - x(a)) * (y(c) - y(b)) - (x(c) - x(b)) * (y(c) - y(a))).abs()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn vertex(depth: f32, primitive: u32, back: bool, transmittance: f64) -> Vertex {
        Vertex { label: Label::new(depth, primitive, back), transmittance }
    }

    fn label(depth: f32, primitive: u32, back: bool) -> Label {
        vertex(depth, primitive, back, 0.0).label
    }

    #[test]
    fn every_case_of_the_evaluation() {
        let line = [
            vertex(1.0, 5, false, 1.0),
            vertex(1.0, 5, true, 0.8),
            vertex(3.0, 2, false, 0.4),
            vertex(3.0, 2, true, 0.1),
        ];
        let cases = [
            (label(0.5, 0, false), 1.0), // nothing before
            (label(1.0, 2, false), 1.0), // in front of the first at its depth
            (label(1.0, 5, false), 1.0), // the vertex itself
            (label(1.0, 5, true), 0.8),  // and the next
            (label(1.0, 9, false), 0.8), // behind it at its depth
            (label(2.0, 0, false), 0.6), // between two
            (label(3.0, 1, false), 0.4), // at the depth of the one behind
            (label(3.0, 2, false), 0.4),
            (label(3.0, 7, false), 0.1),
            (label(9.0, 0, false), 0.1), // behind the last
        ];
        for (label, expected) in cases {
            assert!((evaluate(&line, label) - expected).abs() < 1e-15, "{label:?}");
        }
        assert_eq!(evaluate(&[], label(1.0, 0, false)), 1.0);
    }

    #[test]
    fn faces_of_coincident_fragments_are_in_order() {
        let f = |depth, primitive| Fragment { depth, color: [0.0; 3], alpha: 0.5, primitive };
        let (a, b) = (f(2.0, 1), f(2.0, 2));
        let faces =
            [Label::at(2.0), Label::front(&a), Label::back(&a, 2.0), Label::front(&b), Label::back(&b, 2.0)];
        assert!(faces.is_sorted());
        assert!(Label::back(&b, 2.0) < Label::at(2.000_001));
        assert_eq!(Label::back(&a, 7.25).depth(), 7.25);
    }

    #[test]
    fn a_triangle_of_a_line_has_no_area() {
        let v = |z, t| vertex(z, 0, false, t);
        assert_eq!(triangle(&v(1.0, 1.0), &v(2.0, 0.75), &v(5.0, 0.0)), 0.0);
        assert_eq!(triangle(&v(1.0, 1.0), &v(1.0, 0.5), &v(3.0, 0.5)), 1.0);
    }
}
