//! The calls that do the work, with Ctrl-C kept alive.

use super::arrays::contiguous;
use super::convert::{info, inputs};
use super::custom::Named;
use super::fragments::PyFragments;
use super::frame::PyFrame;
use super::function::Failures;
use super::scene::PyScene;
use super::visit::refuse_within_call;
use crate::Result;
use crate::fragments::Fragments;
use crate::render as core;
use crate::render::{Options, Request, Source};
use crate::scene::Scene;
use crate::technique::DepthComplexity;
use crate::techniques::REGISTRY;
use crate::threads::{On, start};
use numpy::{PyArray1, PyArrayMethods, PyReadonlyArray1};
use pyo3::exceptions::{PyRuntimeError, PyTypeError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

/// A scene or a fragment list, shared with Python.
pub enum AnySource {
    /// Geometry.
    Scene(Arc<Scene>),
    /// Fragments.
    Fragments(Arc<Fragments>),
}

impl AnySource {
    pub fn extract(source: &Bound<'_, PyAny>) -> PyResult<Self> {
        if let Ok(scene) = source.cast::<PyScene>() {
            return Ok(Self::Scene(Arc::clone(&scene.get().0)));
        }
        if let Ok(fragments) = source.cast::<PyFragments>() {
            return Ok(Self::Fragments(Arc::clone(&fragments.get().0)));
        }
        Err(PyTypeError::new_err(format!("source: {} is neither Scene nor Fragments", source.get_type())))
    }
    pub fn as_source(&self) -> Source<'_> {
        match self {
            Self::Scene(scene) => Source::Scene(scene),
            Self::Fragments(fragments) => Source::Fragments(fragments),
        }
    }
    pub fn share(&self) -> Self {
        match self {
            Self::Scene(scene) => Self::Scene(Arc::clone(scene)),
            Self::Fragments(fragments) => Self::Fragments(Arc::clone(fragments)),
        }
    }
    /// Rows and columns of the image.
    fn shape(&self) -> [usize; 2] {
        let (height, width) = match self {
            Self::Scene(scene) => (scene.height(), scene.width()),
            Self::Fragments(fragments) => (fragments.height, fragments.width),
        };
        [height as usize, width as usize]
    }
    /// Depth of the first fragment and number of fragments, per pixel.
    pub fn depth_images(&self, py: Python<'_>) -> PyResult<core::DepthImages> {
        let shared = self.share();
        interruptible(py, On::Shared, &Failures::default(), move |stop| {
            core::depth_images(shared.as_source(), &Options::default(), stop)
        })
    }
    /// The content hash in hexadecimal.
    pub fn content_hash(&self) -> String {
        match self {
            Self::Scene(scene) => scene.content_hash(),
            Self::Fragments(fragments) => fragments.content_hash(),
        }
        .to_hex()
        .to_string()
    }
}

/// How often the interpreter is asked for pending signals.
const SIGNAL_INTERVAL: Duration = Duration::from_millis(20);

/// Runs `work` on another thread, detached from the interpreter. On a signal such as Ctrl-C it is told to stop
/// and left to wind down by itself, so that the interpreter has control again at once. It is also told to stop when a
/// function of the user's own has raised something, which is raised again here.
pub fn interruptible<T: Send + 'static>(
    py: Python<'_>,
    on: On,
    failures: &Failures,
    work: impl FnOnce(&(dyn Fn() -> bool + Sync)) -> Result<T> + Send + 'static,
) -> PyResult<T> {
    refuse_within_call()?;
    let stop = Arc::new(AtomicBool::new(false));
    let stopped = Arc::clone(&stop);
    let failed = failures.clone();
    let (sender, receiver) = channel();
    let work = move || work(&|| stopped.load(Ordering::Relaxed) || failed.happened());
    start(on, work, move |result| {
        // nobody listens any more after a signal
        _ = sender.send(result);
    });
    let result = py.detach(move || {
        loop {
            match receiver.recv_timeout(SIGNAL_INTERVAL) {
                Ok(Ok(result)) => return result.map_err(PyErr::from),
                Ok(Err(_)) | Err(RecvTimeoutError::Disconnected) => {
                    let message = "a bug in oitlab's core: a worker panicked (its message is on stderr)";
                    return Err(PyRuntimeError::new_err(message));
                }
                Err(RecvTimeoutError::Timeout) => {
                    #[expect(
                        clippy::redundant_closure_for_method_calls,
                        reason = "the method itself is not general enough in its lifetime"
                    )]
                    if let Err(signal) = Python::attach(|py| py.check_signals()) {
                        stop.store(true, Ordering::Relaxed);
                        return Err(signal);
                    }
                }
            }
        }
    });
    failures.raise()?;
    result
}

/// Variants as the core takes them.
pub fn requests(
    variants: Vec<(Named<'_>, Bound<'_, PyDict>)>,
    failures: &Failures,
) -> PyResult<Vec<Request>> {
    variants.into_iter().map(|(named, params)| named.request(&params, failures)).collect()
}

pub fn options(threads: Option<i64>, skip: bool) -> Result<Options> {
    let count = |n: i64| {
        let fault = || crate::Error::argument("threads", format!("{n} is not in [1, 1024]"));
        usize::try_from(n).ok().filter(|n| (1..=1024).contains(n)).ok_or_else(fault)
    };
    Ok(Options { threads: threads.map(count).transpose()?, skip, ..Options::default() })
}

/// Renders `source` once per variant, rasterising once for all.
#[pyfunction]
pub fn render<'py>(
    py: Python<'py>,
    source: &Bound<'py, PyAny>,
    variants: Vec<(Named<'py>, Bound<'py, PyDict>)>,
    threads: Option<i64>,
    skip: bool,
    float64: bool,
) -> PyResult<Vec<PyFrame>> {
    let source = AnySource::extract(source)?;
    let failures = Failures::default();
    let requests = requests(variants, &failures)?;
    let options = options(threads, skip)?;
    let shared = source.share();
    let frames = interruptible(py, On::threads(options.threads), &failures, move |stop| {
        let run = if float64 { core::render::<f64> } else { core::render::<f32> };
        run(shared.as_source(), &requests, &options, stop)
    })?;
    Ok(frames.into_iter().map(|frame| PyFrame::new(frame, source.share())).collect())
}

/// Refuses what `render` would refuse of the variants before it draws anything.
#[pyfunction]
pub fn check<'py>(
    source: &Bound<'py, PyAny>,
    variants: Vec<(Named<'py>, Bound<'py, PyDict>)>,
) -> PyResult<()> {
    let failures = Failures::default();
    let result = core::check(AnySource::extract(source)?.as_source(), &requests(variants, &failures)?);
    failures.raise()?;
    Ok(result?)
}

/// What went wrong with each pixel's numbers, one dict of images per variant.
#[pyfunction]
pub fn diagnose<'py>(
    py: Python<'py>,
    source: &Bound<'py, PyAny>,
    variants: Vec<(Named<'py>, Bound<'py, PyDict>)>,
    threads: Option<i64>,
) -> PyResult<Vec<Bound<'py, PyDict>>> {
    let source = AnySource::extract(source)?;
    let failures = Failures::default();
    let requests = requests(variants, &failures)?;
    let options = options(threads, true)?;
    let shape = source.shape();
    let work =
        move |stop: &(dyn Fn() -> bool + Sync)| core::diagnose(source.as_source(), &requests, &options, stop);
    let found = interruptible(py, On::threads(options.threads), &failures, work)?;
    let dict = |diagnostics: core::Diagnostics| {
        let dict = PyDict::new(py);
        for (fault, amounts) in diagnostics.images {
            let image = if fault.is_count() {
                #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "counts")]
                let counts = amounts.into_iter().map(|amount| amount as u32).collect();
                PyArray1::from_vec(py, counts).reshape(shape)?.into_any()
            } else {
                PyArray1::from_vec(py, amounts).reshape(shape)?.into_any()
            };
            dict.set_item(fault.name(), image)?;
        }
        Ok(dict)
    };
    found.into_iter().map(dict).collect()
}

/// The fragments of every pixel of a scene.
#[pyfunction]
pub fn capture(py: Python<'_>, scene: &Bound<'_, PyScene>, threads: Option<i64>) -> PyResult<PyFragments> {
    let options = options(threads, true)?;
    let scene = Arc::clone(&scene.get().0);
    let fragments = interruptible(py, On::threads(options.threads), &Failures::default(), move |stop| {
        core::capture(&scene, &options, stop)
    })?;
    Ok(PyFragments(Arc::new(fragments)))
}

/// The exact and the technique's own transmittance strictly in front of some depths of a pixel.
#[pyfunction]
pub fn transmittance<'py>(
    py: Python<'py>,
    fragments: &Bound<'py, PyFragments>,
    technique: Named<'py>,
    params: &Bound<'py, PyDict>,
    pixel: (i64, i64),
    depths: PyReadonlyArray1<'py, f32>,
) -> PyResult<[Bound<'py, PyArray1<f64>>; 2]> {
    let failures = Failures::default();
    let request = technique.request(params, &failures)?;
    refuse_within_call()?;
    let fragments = &fragments.get().0;
    let outside = |_| {
        let problem = format!("{pixel:?} is not in the image of {} x {}", fragments.width, fragments.height);
        crate::Error::argument("pixel", problem)
    };
    let x = u32::try_from(pixel.0).map_err(outside)?;
    let y = u32::try_from(pixel.1).map_err(outside)?;
    let depths = contiguous("depths", &depths)?.to_vec();
    let found = py.detach(|| core::transmittance(fragments, &request, (x, y), &depths));
    failures.raise()?;
    let found = found?;
    Ok([PyArray1::from_vec(py, found.exact), PyArray1::from_vec(py, found.reconstructed)])
}

/// Every pixel's variance over random submission orders.
#[pyfunction]
pub fn order_sensitivity<'py>(
    py: Python<'py>,
    fragments: &Bound<'py, PyFragments>,
    technique: Named<'py>,
    params: &Bound<'py, PyDict>,
    n: i64,
    seed: u64,
    threads: Option<i64>,
) -> PyResult<Bound<'py, PyAny>> {
    let failures = Failures::default();
    let request = technique.request(params, &failures)?;
    let options = options(threads, true)?;
    let fragments = Arc::clone(&fragments.get().0);
    let shape = [fragments.height as usize, fragments.width as usize];
    let shuffles = usize::try_from(n).unwrap_or(0);
    let variance = interruptible(py, On::threads(options.threads), &failures, move |stop| {
        core::order_sensitivity(&fragments, &request, shuffles, seed, &options, stop)
    })?;
    Ok(PyArray1::from_vec(py, variance).reshape(shape)?.into_any())
}

/// Geometry passes and bytes per pixel of a technique on an image so deep.
#[pyfunction]
pub fn cost(
    technique: String,
    params: &Bound<'_, PyDict>,
    depth_complexity_mean: f64,
    depth_complexity_max: usize,
) -> PyResult<(f64, f64)> {
    let complexity = DepthComplexity { mean: depth_complexity_mean, max: depth_complexity_max };
    let cost = core::cost(&(technique, inputs(params, &Failures::default())?).into(), &complexity)?;
    Ok((cost.geometry_passes, cost.bytes_per_pixel))
}

/// The registry, one dict per technique.
#[pyfunction]
pub fn techniques(py: Python<'_>) -> PyResult<Vec<Bound<'_, PyDict>>> {
    REGISTRY.iter().map(|technique| info(py, technique)).collect()
}
