//! The GPU backend.

use super::custom::Named;
use super::fragments::PyFragments;
use super::frame::PyFrame;
use super::function::Failures;
#[cfg(feature = "gpu")]
use super::run::interruptible;
use super::run::{AnySource, options, requests};
use super::scene::PyScene;
use crate::gpu::form::tiled::RasterPath;
#[cfg(feature = "gpu")]
use crate::threads::On;
use pyo3::prelude::*;
use pyo3::types::PyDict;
#[cfg(feature = "gpu")]
use std::sync::Arc;

/// What a build without the feature says.
#[cfg(not(feature = "gpu"))]
fn none_here<T>() -> PyResult<T> {
    let problem = "this build has no GPU backend; one that `pip install .` makes has (cargo feature \"gpu\")";
    Err(crate::Error::Gpu(problem.to_owned()).into())
}

/// Renders `source` once per variant on the GPU, for one set-up of its geometry.
#[pyfunction]
pub fn render_gpu<'py>(
    py: Python<'py>,
    source: &Bound<'py, PyAny>,
    variants: Vec<(Named<'py>, Bound<'py, PyDict>)>,
    threads: Option<i64>,
    skip: bool,
    path: &str,
) -> PyResult<Vec<PyFrame>> {
    let source = AnySource::extract(source)?;
    let failures = Failures::default();
    let requests = requests(variants, &failures)?;
    let options = options(threads, skip)?;
    let raster = RasterPath::from_name(path)?;
    #[cfg(feature = "gpu")]
    {
        let shared = source.share();
        let frames = interruptible(py, On::Own, &failures, move |stop| {
            crate::render::render_on_gpu(shared.as_source(), &requests, &options, raster, stop)
        })?;
        Ok(frames.into_iter().map(|frame| PyFrame::new(frame, source.share())).collect())
    }
    #[cfg(not(feature = "gpu"))]
    {
        _ = (py, source, requests, options, raster);
        none_here()
    }
}

/// Refuses what `render_gpu` would refuse of the variants before it draws anything: with `asks_device`, also what the device
/// of this process cannot do.
#[pyfunction]
pub fn check_gpu<'py>(
    py: Python<'py>,
    source: &Bound<'py, PyAny>,
    variants: Vec<(Named<'py>, Bound<'py, PyDict>)>,
    path: &str,
    asks_device: bool,
) -> PyResult<()> {
    let source = AnySource::extract(source)?;
    let failures = Failures::default();
    let requests = requests(variants, &failures)?;
    let raster = RasterPath::from_name(path)?;
    #[cfg(feature = "gpu")]
    {
        interruptible(py, On::Own, &failures, move |_| {
            crate::render::check_on_gpu(source.as_source(), &requests, raster, asks_device)
        })
    }
    #[cfg(not(feature = "gpu"))]
    {
        _ = (py, source, requests, raster, asks_device);
        none_here()
    }
}

/// The fragments of every pixel of a scene as the GPU finds them.
#[pyfunction]
pub fn capture_gpu(py: Python<'_>, scene: &Bound<'_, PyScene>) -> PyResult<PyFragments> {
    #[cfg(feature = "gpu")]
    {
        let (scene, options) = (Arc::clone(&scene.get().0), options(None, true)?);
        let work =
            move |stop: &(dyn Fn() -> bool + Sync)| crate::render::capture_on_gpu(&scene, &options, stop);
        let fragments = interruptible(py, On::Own, &Failures::default(), work)?;
        Ok(PyFragments(Arc::new(fragments)))
    }
    #[cfg(not(feature = "gpu"))]
    {
        _ = (py, scene);
        none_here()
    }
}

/// Bytes per second that the device reads and writes when it copies.
#[pyfunction]
pub fn gpu_copy_bandwidth(py: Python<'_>) -> PyResult<f64> {
    #[cfg(feature = "gpu")]
    {
        interruptible(py, On::Own, &Failures::default(), crate::gpu::copy_bandwidth)
    }
    #[cfg(not(feature = "gpu"))]
    {
        _ = py;
        none_here()
    }
}

/// The device, and for each technique without a form that it can run, why.
#[pyfunction]
pub fn gpu_info(py: Python<'_>) -> PyResult<Bound<'_, PyDict>> {
    #[cfg(feature = "gpu")]
    {
        let info = interruptible(py, On::Own, &Failures::default(), |_| crate::gpu::info())?;
        let dict = PyDict::new(py);
        for (name, text) in info.texts {
            dict.set_item(name, text)?;
        }
        let (features, limits, refused) = (PyDict::new(py), PyDict::new(py), PyDict::new(py));
        for (name, is_there) in info.features {
            features.set_item(name, is_there)?;
        }
        for (name, limit) in info.limits {
            limits.set_item(name, limit)?;
        }
        for (id, why) in info.refused {
            refused.set_item(id, why)?;
        }
        dict.set_item("features", features)?;
        dict.set_item("limits", limits)?;
        dict.set_item("techniques", info.techniques)?;
        dict.set_item("refused", refused)?;
        Ok(dict)
    }
    #[cfg(not(feature = "gpu"))]
    {
        _ = py;
        none_here()
    }
}
