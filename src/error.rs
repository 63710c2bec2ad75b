//! The one error type of the core.
//!
//! Every message names the culprit (argument, index, what was allowed), because the person who reads it
//! sits in a notebook and cannot step into the core.

use std::fmt;
use std::sync::Arc;

/// What can go wrong between a scene and a frame.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// An argument of a constructor or of `render` is not acceptable.
    #[error("{argument}: {problem}")]
    Argument {
        /// The argument's public name.
        argument: &'static str,
        /// What is wrong with it, with the index and the allowed values.
        problem: String,
    },
    /// No technique has this id.
    #[error("unknown technique {id:?}; the techniques are {known}")]
    UnknownTechnique {
        /// The id as given.
        id: String,
        /// Every registered id, comma separated.
        known: String,
    },
    /// A technique's parameter is unknown, of a wrong type or out of range.
    #[error("{technique}: {problem}; {valid}")]
    Param {
        /// The technique's id.
        technique: &'static str,
        /// What is wrong, naming the parameter.
        problem: String,
        /// The parameters or values that would have been accepted.
        valid: String,
    },
    /// There is not enough memory.
    #[error("not enough memory for {0}")]
    Memory(String),
    /// There is no device, or it does not do what it should.
    #[error("backend \"gpu\": {0}")]
    Gpu(String),
    /// The caller asked to stop.
    #[error("the render was cancelled")]
    Cancelled,
    /// A technique that was made outside of the core failed.
    #[error("{0}")]
    Raised(Raised),
}

/// What somebody else's code failed with; whoever wrote it finds the original again by downcasting.
#[derive(Debug, Clone)]
pub struct Raised(pub Arc<dyn std::error::Error + Send + Sync>);

impl fmt::Display for Raised {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl PartialEq for Raised {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

impl Eq for Raised {}

impl Error {
    /// An [`Error::Argument`].
    pub fn argument(argument: &'static str, problem: impl Into<String>) -> Self {
        Self::Argument { argument, problem: problem.into() }
    }
    /// An [`Error::Raised`].
    pub fn raised(error: impl std::error::Error + Send + Sync + 'static) -> Self {
        Self::Raised(Raised(Arc::new(error)))
    }
}

/// The core's result type.
pub type Result<T> = std::result::Result<T, Error>;
