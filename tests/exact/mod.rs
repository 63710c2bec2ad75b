//! A rasteriser without rounding errors, from the definition alone: pixel centres, the top-left rule, 8 bits of
//! sub-pixel precision, ties to even. It shares nothing with the crate's but the camera's axes.

#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    clippy::cast_sign_loss,
    reason = "exact by construction: whole numbers far below 2^53"
)]

pub mod cover;
pub mod depth;
pub mod dyadic;
pub mod screen;

use cover::{candidates, outline_covers, triangle_covers};
use oitlab::fragments::Fragments;
use oitlab::scene::Scene;
use screen::{Outline, Screen};

/// The largest relative errors of depth that were seen.
#[derive(Debug, Clone, Copy, Default)]
pub struct Worst {
    /// On triangles that were not clipped.
    pub whole: f64,
    /// On those that were.
    pub cut: f64,
    /// Fragments that were looked at.
    pub fragments: [usize; 2],
}

impl Worst {
    /// The worse of both.
    pub fn and(self, other: Self) -> Self {
        let fragments = [0, 1].map(|i| self.fragments[i] + other.fragments[i]);
        Self { whole: self.whole.max(other.whole), cut: self.cut.max(other.cut), fragments }
    }
}

/// The pixels that an outline covers.
pub fn covered(outline: &Outline, width: u32, height: u32) -> impl Iterator<Item = (i64, i64)> {
    candidates(outline.points(), width, height).filter(move |&(x, y)| match outline {
        Outline::Whole(points, _) => triangle_covers(*points, x, y),
        Outline::Cut(points, _) => points.len() > 2 && outline_covers(points, x, y),
    })
}

/// The scene's triangles on its screen, by primitive id.
pub fn outlines(scene: &Scene) -> (Screen, Vec<Outline>) {
    let screen = Screen::new(scene);
    let corners = scene.meshes().iter().flat_map(|mesh| {
        let vertices = mesh.vertices();
        mesh.faces().iter().map(|face| face.map(|v| vertices[v as usize]))
    });
    (screen, corners.map(|corners| screen.outline(corners)).collect())
}

/// Asserts that a capture has exactly the fragments that the definition asks for, and gives the largest errors of
/// depth of every `stride`-th of them.
pub fn check(scene: &Scene, fragments: &Fragments, stride: usize, what: &str) -> Worst {
    let (screen, outlines) = outlines(scene);
    let width = scene.width();
    let mut expected = vec![Vec::new(); (width * scene.height()) as usize];
    for (id, outline) in (0_u32..).zip(&outlines) {
        for (x, y) in covered(outline, width, scene.height()) {
            expected[(y * i64::from(width) + x) as usize].push(id);
        }
    }
    let (mut worst, mut count) = (Worst::default(), 0);
    for (pixel, expected) in expected.iter().enumerate() {
        let (x, y) = (pixel as i64 % i64::from(width), pixel as i64 / i64::from(width));
        let list = fragments.lists.as_ref().row(pixel);
        assert_eq!(list.primitive, expected, "{what}: primitives at ({x}, {y}) of {outlines:?}");
        for fragment in list.iter() {
            count += 1;
            if count % stride == 0 {
                let outline = &outlines[fragment.primitive as usize];
                let error = depth::relative_error(&screen, outline, (x, y), fragment.depth);
                worst = worst.and(match outline {
                    Outline::Whole(..) => Worst { whole: error, fragments: [1, 0], ..Worst::default() },
                    Outline::Cut(..) => Worst { cut: error, fragments: [0, 1], ..Worst::default() },
                });
            }
        }
    }
    worst
}
