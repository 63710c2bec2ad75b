//! Colour and coverage of a primitive at a pixel.

use super::interpolate::Hit;
use crate::scene::{Colors, Material, Mesh, Shading};
use glam::DVec3;

/// The part of the light that reaches a surface from everywhere; the headlight gives the rest.
pub const AMBIENT: f64 = 0.2;

/// How bright a face is, in [`AMBIENT`]..=1: a headlight at the eye on a flat face, seen from either side.
#[expect(clippy::cast_possible_truncation, reason = "colours are f32")]
pub fn light(shading: Shading, view: [DVec3; 3], perspective: bool) -> f32 {
    if shading == Shading::Unlit {
        return 1.0;
    }
    let normal = (view[1] - view[0]).cross(view[2] - view[0]).normalize_or_zero();
    let centroid = (view[0] + view[1] + view[2]) / 3.0;
    let to_light = if perspective { centroid.normalize_or_zero() } else { DVec3::Z };
    (AMBIENT + (1.0 - AMBIENT) * normal.dot(to_light).abs()) as f32
}

/// Premultiplied linear colour and coverage.
pub type Premultiplied = [f32; 4];

/// A primitive's colours.
#[derive(Debug, Clone, Copy)]
pub enum Paint {
    /// The same at every pixel.
    Flat(Premultiplied),
    /// Different ones, or some that a mask cuts out.
    Varying(Shade),
}

/// Colours that vary over a primitive.
#[derive(Debug, Clone, Copy)]
pub struct Shade {
    corners: [Premultiplied; 3],
    mask: Option<Mask>,
}

/// What lets a pixel through: an interpolated alpha of at least the cutoff.
#[derive(Debug, Clone, Copy)]
pub struct Mask {
    /// At the corners.
    pub alphas: [f32; 3],
    /// The least.
    pub cutoff: f32,
}

/// A straight colour as the material shows it.
#[inline]
fn premultiplied(material: &Material, [r, g, b, a]: [f32; 4], light: f32) -> Premultiplied {
    let alpha = match material.opacity {
        Some(opacity) => opacity,
        None if material.is_transparent() => a,
        None => 1.0,
    };
    let [er, eg, eb] = material.emission;
    let lit = alpha * light;
    [r * lit + er, g * lit + eg, b * lit + eb, alpha]
}

/// The one colour of a face of `mesh`, if that is easily told: [`Paint::new`] has it too.
#[inline(always)]
#[expect(clippy::inline_always, reason = "set-up asks for every face")]
pub fn flat(mesh: &Mesh, face: usize, light: f32) -> Option<Premultiplied> {
    let material = mesh.material();
    match mesh.colors() {
        _ if material.is_masked() => None,
        Colors::Mesh(color) => Some(premultiplied(material, *color, light)),
        Colors::Face(colors) => Some(premultiplied(material, colors[face], light)),
        Colors::Vertex(_) => flat_of_corners(mesh, face, light),
    }
}

fn flat_of_corners(mesh: &Mesh, face: usize, light: f32) -> Option<Premultiplied> {
    match Paint::new(mesh, face, light) {
        Paint::Flat(color) => Some(color),
        Paint::Varying(_) => None,
    }
}

impl Paint {
    /// The colours of one face of `mesh`, `light` times as bright as its material.
    pub fn new(mesh: &Mesh, face: usize, light: f32) -> Self {
        let material = mesh.material();
        let straight = mesh.corner_colors(face);
        let corners = straight.map(|color| premultiplied(material, color, light));
        let mask = material
            .is_masked()
            .then(|| Mask { alphas: straight.map(|c| c[3]), cutoff: material.alpha_cutoff });
        if mask.is_none() && corners[0] == corners[1] && corners[1] == corners[2] {
            Self::Flat(corners[0])
        } else {
            Self::Varying(Shade { corners, mask })
        }
    }

    /// Whether the mask lets the pixel through.
    #[inline]
    pub fn passes(&self, hit: &Hit) -> bool {
        match self {
            Self::Flat(_) => true,
            Self::Varying(shade) => shade.passes(hit),
        }
    }

    /// Colour and coverage at the pixel.
    #[inline]
    pub fn at(&self, hit: &Hit) -> Premultiplied {
        match self {
            Self::Flat(color) => *color,
            Self::Varying(shade) => shade.at(hit),
        }
    }
}

impl Shade {
    /// Whether pixels have to pass a mask.
    pub fn is_masked(&self) -> bool {
        self.mask.is_some()
    }

    /// The colours of the corners.
    pub fn corners(&self) -> [Premultiplied; 3] {
        self.corners
    }
    /// What pixels have to pass.
    pub fn mask(&self) -> Option<Mask> {
        self.mask
    }

    /// Whether the mask lets the pixel through.
    #[inline]
    pub fn passes(&self, hit: &Hit) -> bool {
        self.mask.is_none_or(|mask| interpolate(mask.alphas, hit) >= mask.cutoff)
    }

    /// Colour and coverage at the pixel.
    #[inline]
    pub fn at(&self, hit: &Hit) -> Premultiplied {
        std::array::from_fn(|channel| interpolate(self.corners.map(|c| c[channel]), hit))
    }
}

/// The weighted mean of three values, never outside their range.
#[inline]
#[expect(clippy::cast_possible_truncation, reason = "colours are f32")]
fn interpolate(values: [f32; 3], hit: &Hit) -> f32 {
    let mean: f64 = (0..3).map(|i| hit.weights[i] * f64::from(values[i])).sum();
    let lo = values[0].min(values[1]).min(values[2]);
    let hi = values[0].max(values[1]).max(values[2]);
    (mean as f32).clamp(lo, hi)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::AlphaMode;

    fn shade(colors: Colors, material: Material) -> Paint {
        let vertices = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        Paint::new(&Mesh::new(vertices, vec![[0, 1, 2]], colors, material).unwrap(), 0, 0.5)
    }

    const MIDDLE: Hit = Hit { depth: 1.0, weights: [0.5, 0.25, 0.25] };

    #[test]
    fn light_times_alpha_plus_emission() {
        let material = Material { emission: [0.0, 0.0, 2.0], ..Material::default() };
        let shade = shade(Colors::Mesh([1.0, 0.5, 0.0, 0.25]), material);
        assert_eq!(shade.at(&MIDDLE), [0.125, 0.0625, 2.0, 0.25]);
    }

    #[test]
    fn interpolation_is_of_premultiplied_color() {
        let rows = vec![[1.0, 0.0, 0.0, 0.0], [1.0, 1.0, 1.0, 1.0], [1.0, 0.0, 0.0, 1.0]];
        let shade = shade(Colors::Vertex(rows), Material::default());
        assert_eq!(shade.at(&MIDDLE), [0.25, 0.125, 0.125, 0.5]);
    }

    #[test]
    fn opaque_ignores_alpha_and_masks_test_it() {
        let rows = Colors::Vertex(vec![[1.0, 1.0, 1.0, 0.0], [1.0; 4], [1.0; 4]]);
        let material = Material { alpha_mode: AlphaMode::Mask, ..Material::default() };
        let masked = shade(rows.clone(), material);
        assert_eq!(masked.at(&MIDDLE), [0.5, 0.5, 0.5, 1.0]);
        assert!(masked.passes(&MIDDLE));
        assert!(!masked.passes(&Hit { depth: 1.0, weights: [0.75, 0.25, 0.0] }));
        let replaced = shade(rows, Material { opacity: Some(0.5), ..material });
        assert_eq!(replaced.at(&MIDDLE), [0.25, 0.25, 0.25, 0.5]);
        assert!(!replaced.passes(&Hit { depth: 1.0, weights: [1.0, 0.0, 0.0] }));
    }

    #[test]
    fn the_headlight_fades_with_the_angle() {
        let facing = [DVec3::new(0.0, 0.0, 3.0), DVec3::new(1.0, 0.0, 3.0), DVec3::new(0.0, 1.0, 3.0)];
        let edge_on = [DVec3::Z, DVec3::new(0.0, 0.0, 2.0), DVec3::new(0.0, 1.0, 2.0)];
        assert_eq!(light(Shading::Unlit, edge_on, false), 1.0);
        assert_eq!(light(Shading::Lambert, facing, false), 1.0);
        assert_eq!(light(Shading::Lambert, edge_on, false), 0.2);
        assert_eq!(light(Shading::Lambert, [DVec3::ZERO; 3], true), 0.2);
    }
}
