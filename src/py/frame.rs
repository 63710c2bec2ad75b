//! Frames: images move into NumPy without a copy, on first access.

use super::convert::value;
use super::run::AnySource;
use crate::frame::{Frame, Image};
use crate::render::DepthImages;
use numpy::{PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::OnceLock;

/// One technique's image.
#[pyclass(frozen, name = "Frame", module = "oitlab._oitlab")]
pub struct PyFrame {
    frame: Frame,
    source: AnySource,
    depth: OnceLock<DepthImages>,
    color: Py<PyAny>,
    transmittance: Py<PyAny>,
}

/// The buffer as an array of the given shape.
fn image<'py>(py: Python<'py>, samples: Image, shape: &[usize]) -> PyResult<Bound<'py, PyAny>> {
    Ok(match samples {
        Image::F32(samples) => PyArray1::from_vec(py, samples).reshape(shape)?.into_any(),
        Image::F64(samples) => PyArray1::from_vec(py, samples).reshape(shape)?.into_any(),
    })
}

impl PyFrame {
    /// A frame of `source`, its images handed over to NumPy.
    pub fn new(py: Python<'_>, mut frame: Frame, source: AnySource) -> PyResult<Self> {
        let (h, w) = (frame.height as usize, frame.width as usize);
        let take = |image: &mut Image| std::mem::replace(image, Image::F32(Vec::new()));
        let color = image(py, take(&mut frame.color), &[h, w, 3])?.unbind();
        let shape: &[usize] = if frame.transmittance_channels == 3 { &[h, w, 3] } else { &[h, w] };
        let transmittance = image(py, take(&mut frame.transmittance), shape)?.unbind();
        Ok(Self { frame, source, depth: OnceLock::new(), color, transmittance })
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
            dict.set_item(name, value(py, param)?)?;
        }
        Ok(dict)
    }
    #[getter]
    fn source_hash(&self, py: Python<'_>) -> String {
        py.detach(|| self.source.content_hash())
    }
    #[getter]
    fn color(&self, py: Python<'_>) -> Py<PyAny> {
        self.color.clone_ref(py)
    }
    #[getter]
    fn transmittance(&self, py: Python<'_>) -> Py<PyAny> {
        self.transmittance.clone_ref(py)
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
        let skipped = PyDict::new(py);
        for (what, count) in &stats.skipped {
            skipped.set_item(what, count)?;
        }
        dict.set_item("skipped", skipped)?;
        dict.set_item("backend", "cpu")?;
        dict.set_item("threads", stats.threads)?;
        Ok(dict)
    }
}
