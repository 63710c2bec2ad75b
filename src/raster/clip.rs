//! Clipping of a view-space triangle against near, far and the guard band (Sutherland and Hodgman 1974).

use super::project::Projector;
use glam::DVec3;

/// What is left of the triangle: a convex polygon, empty where nothing is.
pub fn clip(projector: &Projector, triangle: [DVec3; 3]) -> Vec<DVec3> {
    let mut polygon = triangle.to_vec();
    for plane in 0..6 {
        polygon = clip_plane(&polygon, |p| projector.clip_distances(p)[plane]);
    }
    polygon
}

fn clip_plane(polygon: &[DVec3], distance: impl Fn(DVec3) -> f64) -> Vec<DVec3> {
    let mut kept = Vec::with_capacity(polygon.len() + 1);
    for (i, &b) in polygon.iter().enumerate() {
        let a = polygon[(i + polygon.len() - 1) % polygon.len()];
        let (da, db) = (distance(a), distance(b));
        if (da >= 0.0) != (db >= 0.0) {
            kept.push(intersection(a, da, b, db));
        }
        if db >= 0.0 {
            kept.push(b);
        }
    }
    kept
}

/// Always computed from the inner towards the outer end, so that two triangles that share the edge, each
/// walking it the other way, get the same bits.
fn intersection(a: DVec3, da: f64, b: DVec3, db: f64) -> DVec3 {
    let (inner, di, outer, d_o) = if da >= 0.0 { (a, da, b, db) } else { (b, db, a, da) };
    inner + (outer - inner) * (di / (di - d_o))
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
