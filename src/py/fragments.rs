//! Fragment lists.

use super::arrays::{borrowed, contiguous, rows};
use super::scene::{size, view};
use crate::Error;
use crate::fragments::{Background, Fragments, FragmentsInput, Lists};
use numpy::ndarray::{ArrayView1, ArrayView3, ArrayViewD, IxDyn};
use numpy::{
    Element, PyArray1, PyArray2, PyArrayDyn, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArrayDyn,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use std::sync::Arc;

/// The fragments of an image.
#[pyclass(frozen, name = "Fragments", module = "oitlab._oitlab")]
pub struct PyFragments(pub Arc<Fragments>);

fn default_primitives(count: usize) -> Result<Vec<u32>, Error> {
    let count = u32::try_from(count);
    count
        .map(|n| (0..n).collect())
        .map_err(|_| Error::argument("primitive", "has to be given beyond 2^32 fragments"))
}

fn background(array: &PyReadonlyArrayDyn<'_, f32>, width: u32, height: u32) -> PyResult<Background> {
    let values = contiguous("background", array)?;
    match *array.shape() {
        [3] => Ok(Background::Constant([values[0], values[1], values[2]])),
        [h, w, 3] if h == height as usize && w == width as usize => {
            Ok(Background::Image(values.as_chunks().0.to_vec()))
        }
        ref shape => {
            let problem = format!("has shape {shape:?}, not [3] or [{height}, {width}, 3]");
            Err(Error::argument("background", problem).into())
        }
    }
}

#[pymethods]
impl PyFragments {
    #[new]
    #[expect(clippy::too_many_arguments, reason = "one per array of a fragment list")]
    fn new(
        py: Python<'_>,
        width: i64,
        height: i64,
        offsets: PyReadonlyArray1<'_, i64>,
        depth: PyReadonlyArray1<'_, f32>,
        color: PyReadonlyArray2<'_, f32>,
        alpha: PyReadonlyArray1<'_, f32>,
        primitive: Option<PyReadonlyArray1<'_, u32>>,
        background: PyReadonlyArrayDyn<'_, f32>,
        near: f64,
        far: f64,
        depth_range: Option<(f64, f64)>,
        primitive_depth: Option<PyReadonlyArray1<'_, f64>>,
    ) -> PyResult<Self> {
        let (width, height) = (size("width", width)?, size("height", height)?);
        let depth = contiguous("depth", &depth)?.to_vec();
        let primitive = match &primitive {
            Some(ids) => contiguous("primitive", ids)?.to_vec(),
            None => default_primitives(depth.len())?,
        };
        let lists = Lists {
            offsets: contiguous("offsets", &offsets)?.to_vec(),
            depth,
            color: rows::<f32, 3>("color", &color)?.to_vec(),
            alpha: contiguous("alpha", &alpha)?.to_vec(),
            primitive,
        };
        let background = self::background(&background, width, height)?;
        let depths = primitive_depth.as_ref().map(|z| contiguous("primitive_depth", z));
        let primitive_depth = depths.transpose()?.map(<[f64]>::to_vec);
        let input =
            FragmentsInput { width, height, lists, background, near, far, depth_range, primitive_depth };
        Ok(Self(Arc::new(py.detach(|| Fragments::new(input))?)))
    }

    #[getter]
    fn width(&self) -> u32 {
        self.0.width
    }
    #[getter]
    fn height(&self) -> u32 {
        self.0.height
    }
    #[getter]
    fn offsets<'py>(this: &Bound<'py, Self>) -> Bound<'py, PyArray1<i64>> {
        shared(this, |fragments| &fragments.lists.offsets)
    }
    #[getter]
    fn depth<'py>(this: &Bound<'py, Self>) -> Bound<'py, PyArray1<f32>> {
        shared(this, |fragments| &fragments.lists.depth)
    }
    #[getter]
    #[expect(unsafe_code, reason = "shares the list's memory")]
    fn color<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let color = &this.get().0.lists.color;
        let view = view(color.len(), color.as_flattened())?;
        // SAFETY: the list is behind an Arc that `this` holds, and frozen.
        Ok(unsafe { borrowed(&view, this.clone().into_any()) })
    }
    #[getter]
    fn alpha<'py>(this: &Bound<'py, Self>) -> Bound<'py, PyArray1<f32>> {
        shared(this, |fragments| &fragments.lists.alpha)
    }
    #[getter]
    fn primitive<'py>(this: &Bound<'py, Self>) -> Bound<'py, PyArray1<u32>> {
        shared(this, |fragments| &fragments.lists.primitive)
    }
    #[getter]
    #[expect(unsafe_code, reason = "shares the list's memory")]
    fn background<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let fragments = &this.get().0;
        let size = (fragments.height as usize, fragments.width as usize, 3);
        let view: ArrayViewD<'_, f32> = match &fragments.background {
            Background::Constant(color) => ArrayViewD::from_shape(IxDyn(&[3]), color),
            Background::Image(colors) => {
                ArrayView3::from_shape(size, colors.as_flattened()).map(ArrayView3::into_dyn)
            }
        }
        .map_err(|e| pyo3::exceptions::PyRuntimeError::new_err(e.to_string()))?;
        // SAFETY: the list is behind an Arc that `this` holds, and frozen.
        Ok(unsafe { borrowed(&view, this.clone().into_any()) })
    }
    #[getter]
    fn near(&self) -> f64 {
        self.0.view.near
    }
    #[getter]
    fn far(&self) -> f64 {
        self.0.view.far
    }
    #[getter]
    fn depth_range(&self) -> (f64, f64) {
        self.0.view.depth_range
    }
    #[getter]
    fn primitive_depth<'py>(this: &Bound<'py, Self>) -> Option<Bound<'py, PyArray1<f64>>> {
        this.get().0.primitive_depth.as_ref()?;
        Some(shared(this, |fragments| fragments.primitive_depth.as_deref().unwrap_or(&[])))
    }
    #[getter]
    fn content_hash(&self, py: Python<'_>) -> String {
        py.detach(|| self.0.content_hash().to_hex().to_string())
    }
}

/// One of the list's arrays, without a copy.
#[expect(unsafe_code, reason = "shares the list's memory")]
fn shared<'py, T: Element>(
    this: &Bound<'py, PyFragments>,
    array: impl FnOnce(&Fragments) -> &[T],
) -> Bound<'py, PyArray1<T>> {
    let view = ArrayView1::from(array(&this.get().0));
    // SAFETY: the list is behind an Arc that `this` holds, and frozen.
    unsafe { borrowed(&view, this.clone().into_any()) }
}
