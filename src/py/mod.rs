//! The Python extension `oitlab._oitlab`: conversions and nothing else. Each function converts its arguments,
//! detaches from the interpreter, calls one core function and converts back.

mod arrays;
mod convert;
mod custom;
mod fragments;
mod frame;
mod function;
mod gpu;
mod run;
mod scene;
mod visit;

use pyo3::prelude::*;

/// The compiled core of oitlab. Use it through the package `oitlab`.
#[pymodule(name = "_oitlab")]
mod extension {
    use pyo3::prelude::*;

    #[pymodule_export]
    use super::custom::PyTechnique;
    #[pymodule_export]
    use super::fragments::PyFragments;
    #[pymodule_export]
    use super::frame::PyFrame;
    #[pymodule_export]
    use super::gpu::{capture_gpu, check_gpu, gpu_copy_bandwidth, gpu_info, render_gpu};
    #[pymodule_export]
    use super::run::{capture, check, cost, diagnose, order_sensitivity, render, techniques, transmittance};
    #[pymodule_export]
    use super::scene::{PyCamera, PyMesh, PyScene};
    #[pymodule_export]
    use super::visit::settle;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))?;
        let features = ["python", "gpu"];
        let built = features.into_iter().filter(|name| *name != "gpu" || cfg!(feature = "gpu"));
        module.add("build_features", pyo3::types::PyTuple::new(module.py(), built.collect::<Vec<_>>())?)
    }
}

impl From<crate::Error> for PyErr {
    fn from(error: crate::Error) -> Self {
        match error {
            crate::Error::Cancelled => pyo3::exceptions::PyKeyboardInterrupt::new_err(error.to_string()),
            crate::Error::Gpu(_) => pyo3::exceptions::PyRuntimeError::new_err(error.to_string()),
            crate::Error::Raised(raised) => raised.0.downcast_ref::<Self>().map_or_else(
                || pyo3::exceptions::PyRuntimeError::new_err(raised.to_string()),
                |error| Python::attach(|py| error.clone_ref(py)),
            ),
            crate::Error::Memory(_) => pyo3::exceptions::PyMemoryError::new_err(error.to_string()),
            error => pyo3::exceptions::PyValueError::new_err(error.to_string()),
        }
    }
}
