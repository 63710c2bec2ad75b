//! NumPy arrays in and out.

use crate::frame::Image;
use numpy::ndarray::{ArrayView, ArrayView1, Dimension};
use numpy::{Element, PyArray, PyArray1, PyArrayMethods, PyReadonlyArray, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::sync::Arc;

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

/// An image that lives on in Rust, so that its memory is used again when no array looks at it any more.
#[pyclass(frozen, name = "Samples", module = "oitlab._oitlab")]
struct Samples(Arc<Image>);

/// An image as an array of the given shape. One that others hold too is copied.
pub fn image<'py>(py: Python<'py>, image: &Arc<Image>, shape: &[usize]) -> PyResult<Bound<'py, PyAny>> {
    let mine = if Arc::strong_count(image) == 1 { Arc::clone(image) } else { Arc::new((**image).clone()) };
    let owner = Bound::new(py, Samples(mine))?;
    Ok(match &*owner.get().0 {
        Image::F32(samples) => over_image(samples, owner.as_any()).reshape(shape)?.into_any(),
        Image::F64(samples) => over_image(samples, owner.as_any()).reshape(shape)?.into_any(),
    })
}

/// An array over the samples of `owner`, a [`Samples`].
#[expect(unsafe_code, reason = "NumPy offers no safe way to share memory that Rust owns")]
fn over_image<'py, T: Element>(samples: &[T], owner: &Bound<'py, PyAny>) -> Bound<'py, PyArray1<T>> {
    // SAFETY: the owner holds the image for as long as the array lives, its buffer never moves, and nothing in
    // Rust looks at it any more: the frame that is the only other holder gives out this array alone.
    unsafe { PyArray::borrow_from_array(&ArrayView1::from(samples), owner.clone()) }
}
