//! Cameras, meshes and scenes.

use super::arrays::{borrowed, rows};
use crate::Error;
use crate::scene::{AlphaMode, Camera, Colors, Material, Mesh, Projection, Scene, Shading};
use glam::DVec3;
use numpy::ndarray::ArrayView2;
use numpy::{PyArray2, PyReadonlyArray2};
use pyo3::prelude::*;
use std::sync::Arc;

/// A camera.
#[pyclass(frozen, name = "Camera", module = "oitlab._oitlab")]
pub struct PyCamera(Camera);

#[pymethods]
impl PyCamera {
    #[new]
    fn new(
        eye: [f64; 3],
        target: [f64; 3],
        up: [f64; 3],
        fov_y: Option<f64>,
        ortho_height: Option<f64>,
        near: f64,
        far: f64,
    ) -> PyResult<Self> {
        let projection = match (fov_y, ortho_height) {
            (Some(fov_y), None) => Projection::Perspective { fov_y },
            (None, Some(height)) => Projection::Orthographic { height },
            _ => return Err(Error::argument("fov_y", "give either fov_y or ortho_height").into()),
        };
        let [eye, target, up] = [eye, target, up].map(DVec3::from);
        Ok(Self(Camera::new(eye, target, up, projection, near, far)?))
    }
}

/// A triangle mesh.
#[pyclass(frozen, name = "Mesh", module = "oitlab._oitlab")]
pub struct PyMesh(Arc<Mesh>);

fn choice<T: Copy>(argument: &'static str, value: &str, choices: &[(&str, T)]) -> Result<T, Error> {
    let found = choices.iter().find(|(name, _)| *name == value);
    found.map(|(_, choice)| *choice).ok_or_else(|| {
        let names: Vec<_> = choices.iter().map(|(name, _)| format!("{name:?}")).collect();
        Error::argument(argument, format!("{value:?} is not one of {}", names.join(", ")))
    })
}

fn faces(rows: &[[i64; 3]], vertices: usize) -> Result<Vec<[u32; 3]>, Error> {
    let index = |v: i64| u32::try_from(v).ok();
    let face = |(i, f): (usize, &[i64; 3])| {
        let [Some(a), Some(b), Some(c)] = f.map(index) else {
            let problem =
                format!("face {i} is ({}, {}, {}), but there are {vertices} vertices", f[0], f[1], f[2]);
            return Err(Error::argument("faces", problem));
        };
        Ok([a, b, c])
    };
    rows.iter().enumerate().map(face).collect()
}

#[pymethods]
impl PyMesh {
    #[new]
    #[expect(clippy::too_many_arguments, reason = "one per property of a mesh")]
    fn new(
        py: Python<'_>,
        vertices: PyReadonlyArray2<'_, f64>,
        faces: PyReadonlyArray2<'_, i64>,
        colors: PyReadonlyArray2<'_, f32>,
        color_domain: &str,
        alpha_mode: &str,
        alpha_cutoff: f32,
        shading: &str,
        emission: [f32; 3],
        double_sided: bool,
        opacity: Option<f32>,
    ) -> PyResult<Self> {
        let modes = [("blend", AlphaMode::Blend), ("opaque", AlphaMode::Opaque), ("mask", AlphaMode::Mask)];
        let shadings = [("unlit", Shading::Unlit), ("lambert", Shading::Lambert)];
        let alpha_mode = choice("alpha_mode", alpha_mode, &modes)?;
        let shading = choice("shading", shading, &shadings)?;
        let material = Material { alpha_mode, alpha_cutoff, shading, emission, double_sided, opacity };
        let vertices = rows::<f64, 3>("vertices", &vertices)?;
        let triangles = self::faces(rows::<i64, 3>("faces", &faces)?, vertices.len())?;
        let rgba = rows::<f32, 4>("colors", &colors)?;
        let colors = match (color_domain, rgba) {
            ("mesh", [color]) => Colors::Mesh(*color),
            ("vertex", _) => Colors::Vertex(rgba.to_vec()),
            ("face", _) => Colors::Face(rgba.to_vec()),
            _ => return Err(Error::argument("color", "one RGBA for a mesh is needed").into()),
        };
        let vertices = vertices.to_vec();
        let mesh = py.detach(|| Mesh::new(vertices, triangles, colors, material))?;
        Ok(Self(Arc::new(mesh)))
    }

    #[getter]
    #[expect(unsafe_code, reason = "shares the mesh's memory")]
    fn vertices<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let all = this.get().0.vertices();
        let view = view(all.len(), all.as_flattened())?;
        // SAFETY: the mesh is behind an Arc that `this` holds, and frozen.
        Ok(unsafe { borrowed(&view, this.clone().into_any()) })
    }
    #[getter]
    #[expect(unsafe_code, reason = "shares the mesh's memory")]
    fn faces<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray2<u32>>> {
        let all = this.get().0.faces();
        let view = view(all.len(), all.as_flattened())?;
        // SAFETY: the mesh is behind an Arc that `this` holds, and frozen.
        Ok(unsafe { borrowed(&view, this.clone().into_any()) })
    }
    #[getter]
    #[expect(unsafe_code, reason = "shares the mesh's memory")]
    fn colors<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let all = match this.get().0.colors() {
            Colors::Mesh(color) => std::slice::from_ref(color),
            Colors::Vertex(colors) | Colors::Face(colors) => colors,
        };
        let view = view(all.len(), all.as_flattened())?;
        // SAFETY: the mesh is behind an Arc that `this` holds, and frozen.
        Ok(unsafe { borrowed(&view, this.clone().into_any()) })
    }
}

/// A flat slice as a two-dimensional view of so many rows.
pub fn view<T>(rows: usize, flat: &[T]) -> PyResult<ArrayView2<'_, T>> {
    let columns = flat.len().checked_div(rows).unwrap_or(3);
    ArrayView2::from_shape((rows, columns), flat)
        .map_err(|e| pyo3::exceptions::PyRuntimeError::new_err(e.to_string()))
}

/// A scene.
#[pyclass(frozen, name = "Scene", module = "oitlab._oitlab")]
pub struct PyScene(pub Arc<Scene>);

#[pymethods]
impl PyScene {
    #[new]
    fn new(
        meshes: Vec<Bound<'_, PyMesh>>,
        camera: &Bound<'_, PyCamera>,
        width: i64,
        height: i64,
        background: [f32; 3],
    ) -> PyResult<Self> {
        let (width, height) = (size("width", width)?, size("height", height)?);
        let meshes = meshes.iter().map(|mesh| Arc::clone(&mesh.get().0)).collect();
        Ok(Self(Arc::new(Scene::new(meshes, camera.get().0, width, height, background)?)))
    }

    #[getter]
    fn content_hash(&self, py: Python<'_>) -> String {
        py.detach(|| self.0.content_hash().to_hex().to_string())
    }
}

/// A size as the core takes it; what does not fit is refused like any other size.
pub fn size(argument: &'static str, value: i64) -> Result<u32, Error> {
    let max = crate::fragments::MAX_SIZE;
    u32::try_from(value).map_err(|_| Error::argument(argument, format!("{value} is not in [1, {max}]")))
}
