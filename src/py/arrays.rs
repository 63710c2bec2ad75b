//! NumPy arrays in and out.

use numpy::ndarray::{ArrayView, Dimension};
use numpy::{Element, PyArray, PyArrayMethods, PyReadonlyArray, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// The elements of a C-contiguous array.
///
/// # Errors
/// `ValueError` naming the argument when it is not contiguous.
pub fn contiguous<'a, T: Element, D: Dimension>(
    name: &str,
    array: &'a PyReadonlyArray<'_, T, D>,
) -> PyResult<&'a [T]> {
    array.as_slice().map_err(|_| PyValueError::new_err(format!("{name}: is not a C-contiguous array")))
}

/// Rows of `N` elements.
///
/// # Errors
/// `ValueError` naming the argument when the array is not (n, N) or not contiguous.
pub fn rows<'a, T: Element, const N: usize>(
    name: &str,
    array: &'a PyReadonlyArray<'_, T, numpy::Ix2>,
) -> PyResult<&'a [[T; N]]> {
    let shape = array.shape();
    if shape[1] != N {
        let problem = format!("{name}: has shape ({}, {}), not (n, {N})", shape[0], shape[1]);
        return Err(PyValueError::new_err(problem));
    }
    Ok(contiguous(name, array)?.as_chunks().0)
}

/// A read-only array over memory that lives in `owner`; the array keeps the owner alive.
///
/// # Safety
/// `view` must point into memory that `owner` keeps in place, unchanged, for as long as it lives.
#[expect(unsafe_code, reason = "NumPy offers no safe way to share memory that Rust owns")]
pub unsafe fn borrowed<'py, T: Element, D: Dimension>(
    view: &ArrayView<'_, T, D>,
    owner: Bound<'py, PyAny>,
) -> Bound<'py, PyArray<T, D>> {
    // SAFETY: the caller vouches for the memory; it cannot be written because the flag is cleared before the
    // array is handed out.
    let array = unsafe { PyArray::borrow_from_array(view, owner) };
    array.readwrite().make_nonwriteable();
    array
}
