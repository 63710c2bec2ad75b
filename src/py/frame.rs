//! Frames: images are shared with NumPy without a copy, on first access.

use super::arrays::image;
use super::convert::setting;
use super::run::AnySource;
use crate::frame::Frame;
use crate::render::DepthImages;
use numpy::{PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyDict;
use std::sync::OnceLock;

/// One technique's image.
#[pyclass(frozen, name = "Frame", module = "oitlab._oitlab")]
pub struct PyFrame {
    frame: Frame,
    source: AnySource,
    depth: OnceLock<DepthImages>,
    /// The images, once somebody looked at them.
    color: PyOnceLock<Py<PyAny>>,
    transmittance: PyOnceLock<Py<PyAny>>,
}

impl PyFrame {
    /// A frame of `source`.
    pub fn new(frame: Frame, source: AnySource) -> Self {
        let (color, transmittance) = (PyOnceLock::new(), PyOnceLock::new());
        Self { frame, source, depth: OnceLock::new(), color, transmittance }
    }
}

impl PyFrame {
    /// Depth images of the source, rendered when they are first asked for.
    fn depth(&self, py: Python<'_>) -> PyResult<&DepthImages> {
        if self.depth.get().is_none() {
            let images = self.source.depth_images(py)?;
            // another thread may have been faster, with the same images
            _ = self.depth.set(images);
        }
        Ok(self.depth.get().unwrap_or_else(|| unreachable!("just set")))
    }
}

#[pymethods]
impl PyFrame {
    #[getter]
    fn technique(&self) -> &'static str {
        self.frame.technique
    }
    #[getter]
    fn params<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let dict = PyDict::new(py);
        for (name, param) in self.frame.params.iter() {
            dict.set_item(name, setting(py, param)?)?;
        }
        Ok(dict)
    }
    #[getter]
    fn inactive_params(&self) -> Vec<String> {
        self.frame.params.inactive().map(str::to_owned).collect()
    }
    #[getter]
    fn source_hash(&self, py: Python<'_>) -> String {
        py.detach(|| self.source.content_hash())
    }
    #[getter]
    fn color(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let shape = [self.frame.height as usize, self.frame.width as usize, 3];
        let array = || image(py, &self.frame.color, &shape).map(Bound::unbind);
        self.color.get_or_try_init(py, array).map(|array| array.clone_ref(py))
    }
    #[getter]
    fn transmittance(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let shape = [self.frame.height as usize, self.frame.width as usize, 3];
        let shape = if self.frame.transmittance_channels == 3 { &shape[..] } else { &shape[..2] };
        let array = || image(py, &self.frame.transmittance, shape).map(Bound::unbind);
        self.transmittance.get_or_try_init(py, array).map(|array| array.clone_ref(py))
    }
    #[getter]
    fn first_depth<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let shape = [self.frame.height as usize, self.frame.width as usize];
        Ok(PyArray1::from_slice(py, &self.depth(py)?.first_depth).reshape(shape)?.into_any())
    }
    #[getter]
    fn fragment_count<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let shape = [self.frame.height as usize, self.frame.width as usize];
        Ok(PyArray1::from_slice(py, &self.depth(py)?.fragment_count).reshape(shape)?.into_any())
    }
    /// Of the stats, what every call looks at.
    #[getter]
    fn invalid_weights(&self) -> u64 {
        self.frame.stats.invalid_weights
    }
    #[getter]
    fn stats<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let stats = &self.frame.stats;
        let dict = PyDict::new(py);
        dict.set_item("total_ms", stats.total_ms)?;
        dict.set_item("raster_ms", stats.raster_ms)?;
        dict.set_item("resolve_ms", stats.resolve_ms)?;
        dict.set_item("fragments", stats.fragments)?;
        dict.set_item("depth_complexity_mean", stats.depth_complexity_mean)?;
        dict.set_item("depth_complexity_max", stats.depth_complexity_max)?;
        dict.set_item("geometry_passes", stats.geometry_passes)?;
        dict.set_item("bytes_per_pixel", stats.bytes_per_pixel)?;
        dict.set_item("dropped", stats.dropped)?;
        dict.set_item("invalid_weights", stats.invalid_weights)?;
        let skipped = PyDict::new(py);
        for (what, count) in &stats.skipped {
            skipped.set_item(what, count)?;
        }
        dict.set_item("skipped", skipped)?;
        dict.set_item("backend", stats.backend)?;
        dict.set_item("threads", stats.threads)?;
        Ok(dict)
    }
}
