//! Params and registry entries between Python and the core.

use super::function::{Failures, PyFunction};
use crate::own::Callback;
use crate::params::{Default as ParamDefault, Input, ParamSpec, Setting, Value};
use crate::technique::Info;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyFloat, PyInt, PyString, PyTuple};
use std::sync::Arc;

/// A Python value as a technique's param. NumPy scalars are unwrapped by their `item` method.
fn input(value: &Bound<'_, PyAny>, name: &str, failures: &Failures) -> PyResult<Input> {
    if value.is_instance_of::<PyBool>() {
        return Ok(Input::Bool(value.extract()?));
    }
    if value.is_instance_of::<PyInt>() {
        let number = value.extract::<i64>();
        return Ok(
            number.map_or_else(|_| Input::Other(format!("the integer {value}, beyond 64 bits")), Input::Int)
        );
    }
    if value.is_instance_of::<PyFloat>() {
        return Ok(Input::Float(value.extract()?));
    }
    if value.is_instance_of::<PyString>() {
        return Ok(Input::Text(value.extract()?));
    }
    let is_numpy = value.get_type().module().is_ok_and(|m| m == "numpy");
    if is_numpy && value.getattr("ndim").and_then(|n| n.extract::<usize>()).is_ok_and(|n| n == 0) {
        return input(&value.call_method0("item")?, name, failures);
    }
    if let Ok(numbers) = value.extract::<Vec<f64>>() {
        return Ok(Input::Floats(numbers));
    }
    if value.is_callable() {
        let function = PyFunction::new(value, name, failures);
        return Ok(Input::Function(Callback(Arc::new(function))));
    }
    let what = value.repr().map_or_else(|_| "something unprintable".to_owned(), |r| r.to_string());
    Ok(Input::Other(format!("{what} ({})", value.get_type().name()?)))
}

/// A dict of params. `None` stands for a param's default, as it does in `frame.params`. What functions among them raise
/// goes to `failures`.
///
/// # Errors
/// `TypeError` for a key that is not a string.
pub fn inputs(params: &Bound<'_, PyDict>, failures: &Failures) -> PyResult<Vec<(String, Input)>> {
    let pair = |(key, value): (Bound<'_, PyAny>, Bound<'_, PyAny>)| {
        let name = key.extract::<String>();
        let name = name.map_err(|_| PyTypeError::new_err(format!("param name {key} is not a string")))?;
        let value = input(&value, &name, failures)?;
        Ok((name, value))
    };
    params.iter().filter(|(_, value)| !value.is_none()).map(pair).collect()
}

/// A resolved param as Python sees it: functions are what they were given as.
pub fn setting<'py>(py: Python<'py>, setting: &Setting) -> PyResult<Bound<'py, PyAny>> {
    match setting {
        Setting::Plain(plain) => value(py, *plain),
        Setting::Written(source) => Ok(PyString::new(py, source.text()).into_any()),
        Setting::Called(Callback(function)) => {
            let function = function.as_any().downcast_ref::<PyFunction>();
            let function = function.ok_or_else(|| PyTypeError::new_err("a function that is not Python's"))?;
            Ok(function.callable(py))
        }
    }
}

/// A value of a table as Python sees it.
pub fn value(py: Python<'_>, value: Value) -> PyResult<Bound<'_, PyAny>> {
    Ok(match value {
        Value::None => py.None().into_bound(py),
        Value::Bool(b) => PyBool::new(py, b).to_owned().into_any(),
        Value::Int(i) => i.into_pyobject(py)?.into_any(),
        Value::Float(x) => PyFloat::new(py, x).into_any(),
        Value::Text(text) => PyString::new(py, text).into_any(),
        Value::Pair(lo, hi) => PyTuple::new(py, [lo, hi])?.into_any(),
        Value::Rgb(rgb) => PyTuple::new(py, rgb)?.into_any(),
    })
}

/// A registry entry as a dict.
pub fn info<'py>(py: Python<'py>, info: &Info) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("id", info.id)?;
    dict.set_item("name", info.name)?;
    dict.set_item("aliases", info.aliases.to_vec())?;
    dict.set_item("citation", info.citation.to_vec())?;
    dict.set_item("doc", info.doc)?;
    let axes = PyDict::new(py);
    axes.set_item("memory", info.axes.memory)?;
    axes.set_item("insertion", info.axes.insertion)?;
    axes.set_item("merge", info.axes.merge)?;
    axes.set_item("normalize", info.axes.normalize)?;
    axes.set_item("opacity", info.axes.opacity)?;
    dict.set_item("axes", axes)?;
    dict.set_item("properties", properties(py, info)?)?;
    let params = info.param_table().iter().map(|spec| param(py, spec)).collect::<PyResult<Vec<_>>>()?;
    dict.set_item("params", params)?;
    dict.set_item("backends", info.backends())?;
    dict.set_item("geometry_passes", info.geometry_passes)?;
    dict.set_item("bytes_per_pixel", info.bytes_per_pixel)?;
    Ok(dict)
}

/// The promises under default params.
fn properties<'py>(py: Python<'py>, info: &Info) -> PyResult<Bound<'py, PyDict>> {
    let technique = info.with_defaults();
    let p = technique.properties();
    let dict = PyDict::new(py);
    dict.set_item("order_independent", p.order_independent)?;
    dict.set_item("unbiased", p.unbiased)?;
    dict.set_item("consistent", p.consistent)?;
    dict.set_item("exact_for_one", p.exact_for_one)?;
    dict.set_item("exact_for_one_color", p.exact_for_one_color)?;
    dict.set_item("exact_coverage", p.exact_coverage)?;
    dict.set_item("colored_transmittance", technique.colored_transmittance())?;
    Ok(dict)
}

fn param<'py>(py: Python<'py>, spec: &ParamSpec) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("name", spec.name)?;
    dict.set_item("type", spec.kind.type_name())?;
    dict.set_item("range", spec.kind.to_string())?;
    match spec.default {
        ParamDefault::Fixed(fixed) => dict.set_item("default", value(py, fixed)?)?,
        ParamDefault::Derived { text, .. } => dict.set_item("default", text)?,
    }
    dict.set_item("doc", spec.doc)?;
    Ok(dict)
}
