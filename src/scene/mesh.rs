//! Triangle meshes with their colours and material.

use crate::error::{Error, Result};
use crate::fragments::{check_color, hash_words};

/// How a material uses its alpha.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AlphaMode {
    /// A transparent fragment, also where alpha is 1.
    Blend,
    /// An opaque surface whatever its alpha.
    Opaque,
    /// An opaque surface where alpha reaches the cutoff, nothing elsewhere.
    Mask,
}

/// How a material reacts to light.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shading {
    /// The colour as it is.
    Unlit,
    /// A headlight at the eye plus ambient light, on flat faces seen from either side.
    Lambert,
}

/// What a mesh's surface is made of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Material {
    /// Use of alpha.
    pub alpha_mode: AlphaMode,
    /// Smallest alpha that a mask lets through.
    pub alpha_cutoff: f32,
    /// Reaction to light.
    pub shading: Shading,
    /// Linear colour added to the premultiplied colour, whatever the alpha.
    pub emission: [f32; 3],
    /// Whether back faces (clockwise as seen) are drawn too.
    pub double_sided: bool,
    /// Replaces every alpha after the mask test and makes the surface transparent.
    pub opacity: Option<f32>,
}

impl Default for Material {
    fn default() -> Self {
        Self {
            alpha_mode: AlphaMode::Blend,
            alpha_cutoff: 0.5,
            shading: Shading::Unlit,
            emission: [0.0; 3],
            double_sided: true,
            opacity: None,
        }
    }
}

impl Material {
    /// Whether the surface yields transparent fragments rather than an opaque depth.
    pub fn is_transparent(&self) -> bool {
        self.alpha_mode == AlphaMode::Blend || self.opacity.is_some()
    }
    /// Whether fragments below the cutoff are discarded.
    pub fn is_masked(&self) -> bool {
        self.alpha_mode == AlphaMode::Mask
    }

    fn check(&self) -> Result<()> {
        check_color("emission", self.emission)?;
        if !(self.alpha_cutoff.is_finite() && self.alpha_cutoff >= 0.0) {
            let problem = format!("{} is not a finite number >= 0", self.alpha_cutoff);
            return Err(Error::argument("alpha_cutoff", problem));
        }
        match self.opacity {
            Some(opacity) if !(0.0..=1.0).contains(&opacity) => {
                Err(Error::argument("opacity", format!("{opacity} is not in [0, 1]")))
            }
            _ => Ok(()),
        }
    }
}

/// Straight linear RGBA: RGB >= 0, alpha in [0, 1].
#[derive(Debug, Clone, PartialEq)]
pub enum Colors {
    /// One for the whole mesh.
    Mesh([f32; 4]),
    /// One per vertex.
    Vertex(Vec<[f32; 4]>),
    /// One per face.
    Face(Vec<[f32; 4]>),
}

/// A triangle mesh.
#[derive(Debug, Clone)]
pub struct Mesh {
    vertices: Vec<[f64; 3]>,
    faces: Vec<[u32; 3]>,
    colors: Colors,
    material: Material,
    hash: std::sync::OnceLock<blake3::Hash>,
}

impl Mesh {
    /// A mesh of triangles `faces` between `vertices`.
    ///
    /// # Errors
    /// [`Error::Argument`] for a vertex that is not finite (or beyond the range of f32), a face that names a
    /// vertex that does not exist, as many colours as nothing has, or a colour or material value out of range.
    pub fn new(
        vertices: Vec<[f64; 3]>,
        faces: Vec<[u32; 3]>,
        colors: Colors,
        material: Material,
    ) -> Result<Self> {
        check_vertices(&vertices)?;
        check_faces(&faces, vertices.len())?;
        check_colors(&colors, vertices.len(), faces.len())?;
        material.check()?;
        Ok(Self { vertices, faces, colors, material, hash: std::sync::OnceLock::new() })
    }

    /// World positions.
    pub fn vertices(&self) -> &[[f64; 3]] {
        &self.vertices
    }
    /// Vertex indices of every triangle.
    pub fn faces(&self) -> &[[u32; 3]] {
        &self.faces
    }
    /// The colours.
    pub fn colors(&self) -> &Colors {
        &self.colors
    }
    /// The material.
    pub fn material(&self) -> &Material {
        &self.material
    }

    /// Straight RGBA at the three corners of a face.
    pub fn corner_colors(&self, face: usize) -> [[f32; 4]; 3] {
        match &self.colors {
            Colors::Mesh(color) => [*color; 3],
            Colors::Vertex(colors) => self.faces[face].map(|v| colors[v as usize]),
            Colors::Face(colors) => [colors[face]; 3],
        }
    }

    /// A hash of all that decides the picture, computed once.
    pub fn content_hash(&self) -> blake3::Hash {
        *self.hash.get_or_init(|| {
            let mut hasher = blake3::Hasher::new();
            let counts = [self.vertices.len(), self.faces.len()];
            counts.iter().for_each(|n| _ = hasher.update(&(*n as u64).to_le_bytes()));
            hash_words(&mut hasher, self.vertices.as_flattened(), f64::to_le_bytes);
            hash_words(&mut hasher, self.faces.as_flattened(), u32::to_le_bytes);
            let (domain, colors): (&[u8], &[[f32; 4]]) = match &self.colors {
                Colors::Mesh(color) => (b"m", std::slice::from_ref(color)),
                Colors::Vertex(colors) => (b"v", colors),
                Colors::Face(colors) => (b"f", colors),
            };
            hasher.update(domain);
            hash_words(&mut hasher, colors.as_flattened(), f32::to_le_bytes);
            hasher.update(format!("{:?}", self.material).as_bytes());
            hasher.finalize()
        })
    }
}

fn check_vertices(vertices: &[[f64; 3]]) -> Result<()> {
    let limit = f64::from(f32::MAX);
    let bad = vertices.iter().position(|v| !v.iter().all(|x| x.abs() <= limit));
    bad.map_or(Ok(()), |i| {
        let [x, y, z] = vertices[i];
        let problem = format!("vertex {i} is ({x}, {y}, {z}), not finite and within +-{limit:e}");
        Err(Error::argument("vertices", problem))
    })
}

fn check_faces(faces: &[[u32; 3]], vertices: usize) -> Result<()> {
    let bad = faces.iter().position(|f| f.iter().any(|&v| v as usize >= vertices));
    bad.map_or(Ok(()), |i| {
        let [a, b, c] = faces[i];
        let problem = format!("face {i} is ({a}, {b}, {c}), but there are {vertices} vertices");
        Err(Error::argument("faces", problem))
    })
}

fn check_colors(colors: &Colors, vertices: usize, faces: usize) -> Result<()> {
    let (argument, list, needed, what) = match colors {
        Colors::Mesh(color) => ("color", std::slice::from_ref(color), 1, "color"),
        Colors::Vertex(colors) => ("vertex_colors", colors.as_slice(), vertices, "vertices"),
        Colors::Face(colors) => ("face_colors", colors.as_slice(), faces, "faces"),
    };
    if list.len() != needed {
        let problem = format!("has {} rows, but there are {needed} {what}", list.len());
        return Err(Error::argument(argument, problem));
    }
    let fits =
        |c: &[f32; 4]| c[..3].iter().all(|x| x.is_finite() && *x >= 0.0) && (0.0..=1.0).contains(&c[3]);
    list.iter().position(|c| !fits(c)).map_or(Ok(()), |i| {
        let [r, g, b, a] = list[i];
        let row = if matches!(colors, Colors::Mesh(_)) { String::new() } else { format!("row {i} is ") };
        let problem = format!("{row}({r}, {g}, {b}, {a}); RGB must be finite and >= 0, alpha in [0, 1]");
        Err(Error::argument(argument, problem))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangle(colors: Colors, material: Material) -> Result<Mesh> {
        Mesh::new(vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], vec![[0, 1, 2]], colors, material)
    }

    #[test]
    fn errors_name_the_row_and_what_is_allowed() {
        let white = Colors::Mesh([1.0; 4]);
        let nan = vec![[0.0; 3], [0.0, f64::NAN, 0.0]];
        let mesh = |v, f| Mesh::new(v, f, white.clone(), Material::default()).unwrap_err().to_string();
        assert!(mesh(nan, vec![]).contains("vertices: vertex 1 is (0, NaN, 0)"));
        assert!(mesh(vec![[1e39, 0.0, 0.0]], vec![]).contains("vertex 0"));
        assert!(mesh(vec![[0.0; 3]], vec![[0, 0, 0], [0, 1, 0]]).contains("faces: face 1 is (0, 1, 0)"));
        let fault = |c| triangle(c, Material::default()).unwrap_err().to_string();
        assert!(fault(Colors::Vertex(vec![[1.0; 4]; 2])).contains("vertex_colors: has 2 rows"));
        assert!(fault(Colors::Face(vec![[1.0, 1.0, 1.0, 1.5]])).contains("face_colors: row 0"));
        assert!(fault(Colors::Mesh([-1.0, 0.0, 0.0, 1.0])).contains("color: (-1, 0, 0, 1)"));
        let fault = |m| triangle(white.clone(), m).unwrap_err().to_string();
        assert!(fault(Material { opacity: Some(2.0), ..Material::default() }).contains("opacity: 2"));
        assert!(fault(Material { alpha_cutoff: -1.0, ..Material::default() }).contains("alpha_cutoff: -1"));
        let nan = Material { emission: [f32::NAN, 0.0, 0.0], ..Material::default() };
        assert!(fault(nan).contains("emission"));
    }

    #[test]
    fn corners_take_the_color_of_their_domain() {
        let at = |colors| triangle(colors, Material::default()).unwrap().corner_colors(0);
        assert_eq!(at(Colors::Mesh([0.5; 4])), [[0.5; 4]; 3]);
        assert_eq!(at(Colors::Face(vec![[0.25; 4]])), [[0.25; 4]; 3]);
        let rows = vec![[0.0; 4], [0.5; 4], [1.0; 4]];
        assert_eq!(at(Colors::Vertex(rows)), [[0.0; 4], [0.5; 4], [1.0; 4]]);
    }
}
