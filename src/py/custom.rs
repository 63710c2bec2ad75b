//! Techniques written in Python: a callable over the lists of many pixels, called from the core's workers with the
//! interpreter attached. What the callable takes and gives is checked on the Python side; an exception travels
//! through the core as it is.

use super::arrays::{contiguous, rows};
use super::convert::inputs;
use super::function::Failures;
use super::visit::attached;
use crate::diagnosis::{Diagnosis, Faults};
use crate::error::{Error, Result};
use crate::fragments::{List, Lists};
use crate::order::SubmissionOrder;
use crate::params::View;
use crate::render::{Custom, Request};
use crate::technique::{AnyTechnique, Batch, Cost, DepthComplexity, Pixel, Properties, Resolved, Streamed};
use glam::DVec3;
use numpy::{
    Element, IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError};

/// A technique written in Python, with its params bound.
#[pyclass(frozen, name = "CustomTechnique", module = "oitlab._oitlab")]
pub struct PyTechnique(pub Custom);

/// A technique as it is named: by its id, or itself if it is written in Python.
#[derive(FromPyObject)]
pub enum Named<'py> {
    /// One of the registry.
    Id(String),
    /// One of Python's.
    Custom(Bound<'py, PyTechnique>),
}

impl Named<'_> {
    /// The technique with these params; those of one that is written in Python are bound already.
    ///
    /// # Errors
    /// `TypeError` for a key that is not a string.
    pub fn request(self, params: &Bound<'_, PyDict>, failures: &Failures) -> PyResult<Request> {
        Ok(match self {
            Self::Id(id) => (id, inputs(params, failures)?).into(),
            Self::Custom(technique) => Request::Custom(technique.get().0.clone()),
        })
    }
}

/// The callables, and what the core has to know of them.
struct Callables {
    resolve: Py<PyAny>,
    transmittance: Option<Py<PyAny>>,
    sorted: bool,
    colored: bool,
    properties: Properties,
}

/// The callables on a view.
struct OnView {
    callables: Arc<Callables>,
    view: View,
}

#[pymethods]
impl PyTechnique {
    #[new]
    #[expect(clippy::too_many_arguments, reason = "one per fact about a technique")]
    fn new(
        id: &str,
        identity: String,
        submission_order: &str,
        seed: u64,
        sorted: bool,
        colored: bool,
        promises: [bool; 6],
        resolve: Py<PyAny>,
        transmittance: Option<Py<PyAny>>,
    ) -> Self {
        let properties = properties(promises);
        let callables = Arc::new(Callables { resolve, transmittance, sorted, colored, properties });
        let make = move |view: &View| -> Result<Box<dyn AnyTechnique>> {
            Ok(Box::new(OnView { callables: Arc::clone(&callables), view: *view }))
        };
        let order = SubmissionOrder::from_name(submission_order, seed);
        Self(Custom { id: kept(id), identity, order, make: Arc::new(make) })
    }
}

fn properties(promises: [bool; 6]) -> Properties {
    let [order_independent, unbiased, consistent, exact_for_one, exact_for_one_color, exact_coverage] =
        promises;
    Properties { order_independent, unbiased, consistent, exact_for_one, exact_for_one_color, exact_coverage }
}

/// The id for as long as the process lives, as the core's own ids do; once for each different one.
fn kept(id: &str) -> &'static str {
    static IDS: Mutex<BTreeSet<&'static str>> = Mutex::new(BTreeSet::new());
    let mut ids = IDS.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(known) = ids.get(id) {
        return known;
    }
    let new: &'static str = Box::leak(id.to_owned().into_boxed_str());
    ids.insert(new);
    new
}

/// What a call gave, as an error of the core if it raised one; cancelled when the program ends.
fn reported<T>(given: Option<PyResult<T>>) -> Result<T> {
    given.map_or(Err(Error::Cancelled), |given| given.map_err(Error::raised))
}

impl OnView {
    /// The arguments that every callable begins with: the lists of some pixels, and the view.
    fn arguments<'py>(
        &self,
        py: Python<'py>,
        lists: Lists,
        background: &[[f32; 3]],
        pixels: &[[i32; 2]],
    ) -> PyResult<Vec<Bound<'py, PyAny>>> {
        let View { near, far, depth_range } = self.view;
        Ok(vec![
            line(py, lists.offsets),
            line(py, lists.depth),
            table(py, &lists.color)?,
            line(py, lists.alpha),
            line(py, lists.primitive),
            table(py, background)?,
            table(py, pixels)?,
            near.into_pyobject(py)?.into_any(),
            far.into_pyobject(py)?.into_any(),
            depth_range.into_pyobject(py)?.into_any(),
        ])
    }

    /// Which of a pixel's lists the callable is to see.
    fn list<'a>(&self, pixel: &Pixel<'a>) -> List<'a> {
        if self.callables.sorted { pixel.sorted } else { pixel.list }
    }
}

/// An array of one dimension that cannot be written.
fn line<T: Element>(py: Python<'_>, values: Vec<T>) -> Bound<'_, PyAny> {
    let array = values.into_pyarray(py);
    array.readwrite().make_nonwriteable();
    array.into_any()
}

/// An array of so many columns that cannot be written.
fn table<'py, T: Element + Copy, const N: usize>(
    py: Python<'py>,
    values: &[[T; N]],
) -> PyResult<Bound<'py, PyAny>> {
    let array = PyArray1::from_slice(py, values.as_flattened()).reshape([values.len(), N])?;
    array.readwrite().make_nonwriteable();
    Ok(array.into_any())
}

#[expect(clippy::cast_possible_wrap, reason = "at most MAX_SIZE")]
fn place(pixel: &Pixel<'_>) -> [i32; 2] {
    [pixel.x as i32, pixel.y as i32]
}

/// Writes what the callable made of the listed pixels.
fn store(found: &Bound<'_, PyTuple>, pixels: &[u32], out: &mut [Resolved]) -> PyResult<()> {
    let color: PyReadonlyArray2<'_, f64> = found.get_item(0)?.extract()?;
    let color = rows::<f64, 3>("color", &color)?;
    let transmittance = found.get_item(1)?;
    let transmittance = transmittance.cast::<PyArray2<f64>>()?.readonly();
    let channels = transmittance.shape()[1];
    let transmittance = contiguous("transmittance", &transmittance)?;
    let dropped: PyReadonlyArray1<'_, u64> = found.get_item(2)?.extract()?;
    let dropped = contiguous("dropped", &dropped)?;
    for (n, &i) in pixels.iter().enumerate() {
        let share = match channels {
            1 => DVec3::splat(transmittance[n]),
            _ => DVec3::from_slice(&transmittance[channels * n..]),
        };
        out[i as usize] =
            Resolved { color: DVec3::from(color[n]), transmittance: share, dropped: dropped[n] };
    }
    Ok(())
}

impl AnyTechnique for OnView {
    fn needs_sorted(&self) -> bool {
        self.callables.sorted
    }
    fn needs_arrival(&self) -> bool {
        !self.callables.sorted
    }
    fn streamed(&self) -> Option<Streamed<'_>> {
        None
    }
    fn sees_zero_fragments(&self) -> bool {
        false
    }
    fn colored_transmittance(&self) -> bool {
        self.callables.colored
    }
    fn wants_large_batches(&self) -> bool {
        true
    }
    fn transmittance(&self, pixel: &Pixel<'_>, depths: &[f32]) -> Option<Vec<f64>> {
        self.try_transmittance(pixel, depths).ok().flatten()
    }
    fn try_transmittance(&self, pixel: &Pixel<'_>, depths: &[f32]) -> Result<Option<Vec<f64>>> {
        let Some(function) = &self.callables.transmittance else { return Ok(None) };
        let list = self.list(pixel);
        if list.is_empty() {
            return Ok(Some(vec![1.0; depths.len()]));
        }
        let mut lists = Lists::new();
        lists.append_list(list);
        let background = [pixel.background.as_vec3().to_array()];
        let found = attached(|py| {
            let mut arguments = self.arguments(py, lists, &background, &[place(pixel)])?;
            arguments.push(line(py, depths.to_vec()));
            let found = function.bind(py).call1(PyTuple::new(py, arguments)?)?;
            let found: PyReadonlyArray1<'_, f64> = found.extract()?;
            Ok(contiguous("transmittance", &found)?.to_vec())
        });
        Ok(Some(reported(found)?))
    }
    fn faults(&self) -> Faults {
        Faults::NONE
    }
    fn diagnose(&self, _: &Pixel<'_>) -> Diagnosis {
        Diagnosis::CLEAR
    }
    fn cost(&self, _: &DepthComplexity) -> Cost {
        // what the technique says of itself is known to Python alone
        Cost { geometry_passes: f64::NAN, bytes_per_pixel: f64::NAN }
    }
    fn properties(&self) -> Properties {
        self.callables.properties
    }
    fn resolve_batch(
        &self,
        batch: &Batch<'_>,
        pixels: &[u32],
        out: &mut [Resolved],
        stop: &dyn Fn() -> bool,
    ) -> Result<()> {
        if pixels.is_empty() || stop() {
            return Ok(());
        }
        let mut lists = Lists::new();
        let (mut background, mut places) = (Vec::new(), Vec::new());
        for &i in pixels {
            let pixel = batch.pixel(i as usize);
            lists.append_list(self.list(&pixel));
            background.push(batch.background[i as usize]);
            places.push(place(&pixel));
        }
        reported(attached(|py| {
            if stop() {
                return Ok(()); // while others had the interpreter
            }
            let arguments = self.arguments(py, lists, &background, &places)?;
            let found = self.callables.resolve.bind(py).call1(PyTuple::new(py, arguments)?)?;
            store(found.cast::<PyTuple>()?, pixels, out)
        }))
    }
}
