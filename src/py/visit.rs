//! Workers that call Python: one at a time, marked as being in a call, and none any more when the program ends.

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use std::cell::Cell;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

thread_local! {
    /// Whether this thread is in the middle of a call.
    static CALLS: Cell<bool> = const { Cell::new(false) };
}

/// Refuses work from within a technique or a function of the user's own: it would wait for the threads that wait for
/// the call.
///
/// # Errors
/// `RuntimeError` there.
pub fn refuse_within_call() -> PyResult<()> {
    if CALLS.get() {
        let message = "oitlab cannot render, capture or measure from within a technique or a function that a render \
                       calls: do that before, and let it use what came out";
        return Err(PyRuntimeError::new_err(message));
    }
    Ok(())
}

/// Workers that are in the interpreter or about to be, and whether the program is about to end. A thread that
/// comes back to an interpreter that is gone takes the process with it.
static VISITORS: AtomicUsize = AtomicUsize::new(0);
static ENDS: AtomicBool = AtomicBool::new(false);

/// A worker's stay in the interpreter.
struct Visit {
    /// Whether the thread had been in a call before.
    before: bool,
}

impl Visit {
    /// None when the program is about to end.
    fn begin() -> Option<Self> {
        VISITORS.fetch_add(1, Ordering::SeqCst);
        let visit = Self { before: CALLS.replace(true) };
        (!ENDS.load(Ordering::SeqCst)).then_some(visit)
    }
}

impl Drop for Visit {
    fn drop(&mut self) {
        CALLS.set(self.before);
        VISITORS.fetch_sub(1, Ordering::SeqCst);
    }
}

/// Lets no more workers into the interpreter and waits for those that are there, such as those that an interrupted
/// render left behind in the middle of a call. To be called when the program ends.
#[pyfunction]
pub fn settle(py: Python<'_>) -> PyResult<()> {
    ENDS.store(true, Ordering::SeqCst);
    while VISITORS.load(Ordering::SeqCst) > 0 {
        py.detach(|| std::thread::sleep(Duration::from_millis(5)));
        py.check_signals()?;
    }
    Ok(())
}

/// Runs `call` attached to the interpreter, on a thread that is marked as being in a call; none when the program is
/// about to end.
pub fn attached<T>(call: impl FnOnce(Python<'_>) -> PyResult<T>) -> Option<PyResult<T>> {
    let _visit = Visit::begin()?;
    Python::try_attach(call)
}
