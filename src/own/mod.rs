//! Functions of one's own: text in WGSL, or a function of arrays that somebody else wrote.
//!
//! Text is parsed and validated by naga (`source`), compiled once into a flat program of registers (`compile`,
//! `program`), and run on blocks of fragments (`run`). What the functions mean is their users' business: this room
//! knows neither weights nor bins.

mod batch;
mod compile;
mod lexer;
mod math;
mod program;
mod report;
mod run;
mod shader;
mod source;

pub use batch::in_batches;
pub use program::{MAX_ITERATIONS, Program};
pub use shader::{Call, callable, vectors};
pub use source::{MAX_TEXT, Source};

use crate::error::Result;
use crate::params::{Params, Setting};
use batch::Recorder;
use std::fmt;
use std::sync::Arc;

/// What a function of one's own is called and may read.
#[derive(Debug)]
pub struct Signature {
    /// The function's name in a module, and in messages.
    pub entry: &'static str,
    /// The names of its arguments, all f32. Other scalars are uniforms.
    pub arguments: &'static [&'static str],
    /// What a callable is given and returns, in words.
    pub callable: &'static str,
}

/// A function of arrays that somebody else wrote.
pub trait ArrayFunction: Send + Sync {
    /// Writes `results[i] = f(inputs[0][i], inputs[1][i], ...)`. All slices have one length. A function that fails writes
    /// whatever it likes and sees to it that the render is stopped.
    fn call(&self, inputs: &[&[f32]], results: &mut [f32]);
    /// What tells this function from others that live at the same time.
    fn id(&self) -> usize;
    /// What it is, in a few words.
    fn describe(&self) -> String;
    /// So that whoever made it can find it again.
    fn as_any(&self) -> &dyn std::any::Any;
}

/// An [`ArrayFunction`], equal to another if it is that one.
#[derive(Clone)]
pub struct Callback(pub Arc<dyn ArrayFunction>);

impl PartialEq for Callback {
    fn eq(&self, other: &Self) -> bool {
        self.0.id() == other.0.id()
    }
}

impl fmt::Debug for Callback {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0.describe())
    }
}

/// Values that a [`Callback`] computes together: so many that a call's own cost does not matter.
pub const CALL: usize = 4096;

/// A function of one's own, ready to run.
#[derive(Debug, Clone)]
pub enum OwnFunction {
    /// By text.
    Written(Arc<Program>),
    /// By somebody else.
    Called(Callback),
}

impl OwnFunction {
    /// The function that a param is set to, with its uniforms.
    ///
    /// # Errors
    /// `Error::Param` with what is wrong with its text.
    ///
    /// # Panics
    /// If the param is no function of one's own.
    pub fn from_params(setting: &Setting, name: &str, params: &Params) -> Result<Self> {
        match setting {
            Setting::Called(function) => Ok(Self::Called(function.clone())),
            Setting::Written(source) => match source.compile(&params.uniforms(name)) {
                Ok(program) => Ok(Self::Written(Arc::new(program))),
                Err(shown) => {
                    let problem = format!("parameter {name:?} cannot be run:\n{shown}\n");
                    Err(params.error(problem, "allowed are functions of scalars and vectors"))
                }
            },
            Setting::Plain(value) => panic!("{value:?} is not a function of one's own"),
        }
    }

    /// Whether two functions are known to be the same.
    pub fn is_same(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Written(mine), Self::Written(theirs)) => mine.is_same(theirs),
            (Self::Called(mine), Self::Called(theirs)) => mine == theirs,
            _ => false,
        }
    }

    /// Values that are best computed together.
    pub fn chunk(&self) -> usize {
        match self {
            Self::Written(_) => 1024,
            Self::Called(_) => CALL,
        }
    }

    /// Writes `results[i] = f(inputs[0][i], ...)`, as the function gives it, and says whether it has: within
    /// [`in_batches`] something else may stand in for it. All slices have one length.
    pub fn evaluate(&self, inputs: &[&[f32]], results: &mut [f32]) -> bool {
        match self {
            Self::Written(program) => {
                program.run(inputs, results);
                true
            }
            Self::Called(function) => Recorder::evaluate(function, inputs, results),
        }
    }
}

#[cfg(test)]
mod tests;
