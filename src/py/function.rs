//! Functions of arrays that are Python's: called from the render's threads, attached to the interpreter one at a time.

use super::visit::attached;
use crate::own::ArrayFunction;
use numpy::{PyArray1, PyArrayMethods, PyReadonlyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyTuple;
use std::any::Any;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

/// The first thing that a function of a call has raised.
#[derive(Clone, Default)]
pub struct Failures(Arc<Slot>);

#[derive(Default)]
struct Slot {
    happened: AtomicBool,
    error: Mutex<Option<PyErr>>,
}

impl Failures {
    /// Whether there is no point in going on.
    pub fn happened(&self) -> bool {
        self.0.happened.load(Ordering::Relaxed)
    }

    /// Raises it.
    pub fn raise(&self) -> PyResult<()> {
        let error = self.0.error.lock().map_or_else(|_| None, |mut slot| slot.take());
        error.map_or(Ok(()), Err)
    }

    fn put(&self, error: PyErr) {
        if let Ok(mut slot) = self.0.error.lock() {
            slot.get_or_insert(error);
        }
        self.stop();
    }

    fn stop(&self) {
        self.0.happened.store(true, Ordering::Relaxed);
    }
}

/// A callable that was given for a param.
pub struct PyFunction {
    callable: Py<PyAny>,
    /// The param's name.
    name: String,
    /// Its `repr`.
    shown: String,
    failures: Failures,
}

impl PyFunction {
    pub fn new(callable: &Bound<'_, PyAny>, name: &str, failures: &Failures) -> Self {
        let shown = callable.repr().map_or_else(|_| "a callable".to_owned(), |shown| shown.to_string());
        Self { callable: callable.clone().unbind(), name: name.to_owned(), shown, failures: failures.clone() }
    }

    pub fn callable<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        self.callable.bind(py).clone()
    }

    fn compute(&self, py: Python<'_>, inputs: &[&[f32]], results: &mut [f32]) -> PyResult<()> {
        let arguments = PyTuple::new(py, inputs.iter().map(|input| PyArray1::from_slice(py, input)))?;
        let returned = self.callable.bind(py).call1(arguments)?;
        self.read(py, &returned, results)
    }

    /// Takes over what was returned, if it is an array of as many numbers.
    #[expect(clippy::cast_possible_truncation, reason = "functions compute in f32")]
    fn read(&self, py: Python<'_>, returned: &Bound<'_, PyAny>, results: &mut [f32]) -> PyResult<()> {
        let fault = |problem: String| {
            let name = &self.name;
            PyValueError::new_err(format!("{name}: {} returned {problem}", self.shown))
        };
        let numpy = py.import("numpy")?;
        if numpy.getattr("ma")?.call_method1("is_masked", (returned,))?.is_truthy()? {
            return Err(fault("masked values, which have no meaning here".to_owned()));
        }
        let array = numpy.call_method1("asarray", (returned,))?;
        let kind: String = array.getattr("dtype")?.getattr("kind")?.extract()?;
        if !matches!(&*kind, "b" | "i" | "u" | "f") {
            let dtype = array.getattr("dtype")?.str()?;
            return Err(fault(format!("an array of dtype {dtype}, not of real numbers")));
        }
        let shape: Vec<usize> = array.getattr("shape")?.extract()?;
        if shape != [results.len()] {
            let shape = array.getattr("shape")?.str()?;
            return Err(fault(format!(
                "an array of shape {shape}, not ({},) like its arguments",
                results.len()
            )));
        }
        if let Ok(single) = array.extract::<PyReadonlyArray1<'_, f32>>() {
            results.iter_mut().zip(single.as_array()).for_each(|(to, x)| *to = *x);
        } else {
            // by way of float64, which NumPy does not warn about
            let double = array.call_method1("astype", ("float64",))?;
            let double = double.cast::<PyArray1<f64>>()?.try_readonly().map_err(|e| fault(e.to_string()))?;
            results.iter_mut().zip(double.as_array()).for_each(|(to, x)| *to = *x as f32);
        }
        Ok(())
    }
}

impl ArrayFunction for PyFunction {
    fn call(&self, inputs: &[&[f32]], results: &mut [f32]) {
        results.fill(1.0);
        if self.failures.happened() {
            return;
        }
        match attached(|py| self.compute(py, inputs, results)) {
            Some(Ok(())) => {}
            Some(Err(error)) => self.failures.put(error),
            // the interpreter is going away
            None => self.failures.stop(),
        }
    }
    fn id(&self) -> usize {
        self.callable.as_ptr().addr()
    }
    fn describe(&self) -> String {
        self.shown.clone()
    }
    fn as_any(&self) -> &dyn Any {
        self
    }
}
