//! Clipping of a view-space triangle against near, far and the guard band (Sutherland and Hodgman 1974).

use super::project::Projector;
use glam::DVec3;

/// What is left of the triangle: a convex polygon, empty where nothing is.
pub fn clip(projector: &Projector, triangle: [DVec3; 3]) -> Vec<DVec3> {
    let mut polygon = triangle.to_vec();
    for plane in 0..6 {
        polygon = clip_plane(&polygon, projector, plane);
    }
    polygon
}

fn clip_plane(polygon: &[DVec3], projector: &Projector, plane: usize) -> Vec<DVec3> {
    let distance = |p| projector.clip_distances(p)[plane];
    let mut kept = Vec::with_capacity(polygon.len() + 1);
    for (i, &b) in polygon.iter().enumerate() {
        let a = polygon[(i + polygon.len() - 1) % polygon.len()];
        let (da, db) = (distance(a), distance(b));
        if (da >= 0.0) != (db >= 0.0) {
            kept.push(projector.onto_plane(intersection(a, da, b, db), plane));
        }
        if db >= 0.0 {
            kept.push(b);
        }
    }
    kept
}

/// Always computed from the end that is nearer to the plane, and from the inner one if both are as near: two
/// triangles that share the edge, each walking it the other way, get the same bits, and a far end costs no digits of
/// a near one.
fn intersection(a: DVec3, da: f64, b: DVec3, db: f64) -> DVec3 {
    let (inner, di, outer, d_o) = if da >= 0.0 { (a, da, b, db) } else { (b, db, a, da) };
    let between = |from: DVec3, to: DVec3, d: f64, e: f64| from + (to - from) * (d / (d - e));
    if di <= -d_o { between(inner, outer, di, d_o) } else { between(outer, inner, d_o, di) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Camera, Projection};

    fn projector() -> Projector {
        let projection = Projection::Perspective { fov_y: 90.0 };
        let eye = DVec3::new(0.0, 0.0, 5.0);
        let camera = Camera::new(eye, DVec3::ZERO, DVec3::Y, projection, 1.0, 9.0).unwrap();
        Projector::new(&camera, 64, 64)
    }

    #[test]
    fn one_vertex_behind_the_near_plane_leaves_a_quadrilateral() {
        let triangle = [DVec3::new(0.0, 0.0, 0.0), DVec3::new(1.0, 0.0, 2.0), DVec3::new(0.0, 1.0, 2.0)];
        let polygon = clip(&projector(), triangle);
        assert_eq!(polygon.len(), 4);
        assert!(polygon.iter().all(|p| p.z >= 1.0));
        assert!(polygon.iter().filter(|p| p.z == 1.0).count() == 2);
    }

    /// From the far end alone the near plane would be met at depth 0, and the eye is nowhere on the screen.
    #[test]
    fn what_reaches_to_1e30_is_cut_at_the_plane() {
        let camera =
            Camera::new(DVec3::ZERO, DVec3::Z, DVec3::Y, Projection::Perspective { fov_y: 90.0 }, 1e-3, 1e38);
        let projector = Projector::new(&camera.unwrap(), 64, 64);
        let triangle = [DVec3::new(0.5, 0.5, 0.0), DVec3::new(0.0, 0.0, 1e30), DVec3::new(0.0, 0.0, 5.0)];
        let polygon = clip(&projector, triangle);
        assert!(polygon.len() == 4 && polygon.iter().all(|p| p.z >= 1e-3), "{polygon:?}");
        assert!(polygon.iter().any(|p| p.z == 1e-3 && (p.x - 0.5).abs() < 1e-3));
    }

    #[test]
    fn inside_stays_and_outside_goes() {
        let inside = [DVec3::new(0.0, 0.0, 2.0), DVec3::new(1.0, 0.0, 2.0), DVec3::new(0.0, 1.0, 2.0)];
        assert_eq!(clip(&projector(), inside), inside);
        assert!(clip(&projector(), inside.map(|p| p - DVec3::Z * 10.0)).is_empty());
        assert!(clip(&projector(), inside.map(|p| p + DVec3::Z * 10.0)).is_empty());
    }

    #[test]
    fn a_shared_edge_is_cut_at_the_same_bits() {
        let (a, b) = (DVec3::new(0.3, 0.1, 0.37), DVec3::new(0.7, -0.2, 5.13));
        let left = clip(&projector(), [a, b, DVec3::new(-3.0, 0.0, 3.0)]);
        let right = clip(&projector(), [b, a, DVec3::new(3.0, 0.0, 3.0)]);
        let cut = |polygon: &[DVec3]| *polygon.iter().find(|p| p.x > 0.3 && p.x < 0.7).unwrap();
        assert_eq!(cut(&left), cut(&right));
    }
}
