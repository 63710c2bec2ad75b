//! What a parameter may be: its type, its range, and how what the user wrote is read.

use super::{Input, Setting, Value};
use crate::format::FormatSet;
use crate::own::{Signature, Source};
use std::fmt;
use std::sync::Arc;

/// A parameter's type and range.
#[derive(Debug, Clone, Copy)]
pub enum Kind {
    /// `True` or `False`.
    Bool,
    /// An integer in `min..=max`.
    Int {
        /// Smallest allowed.
        min: i64,
        /// Largest allowed; `i64::MAX` is no limit.
        max: i64,
    },
    /// One of a few integers.
    IntChoice(&'static [i64]),
    /// A finite number in `min..=max`, without the end points that are open.
    Float {
        /// Lower end.
        min: f64,
        /// Upper end.
        max: f64,
        /// Whether `min` itself is excluded.
        min_open: bool,
        /// Whether `max` itself is excluded.
        max_open: bool,
    },
    /// One of a few strings.
    Choice(&'static [&'static str]),
    /// A number or three of them, each in `min..=max`.
    FloatOrRgb {
        /// Smallest allowed.
        min: f64,
        /// Largest allowed.
        max: f64,
    },
    /// A depth range: `"pixel"`, `"scene"` or `(z_lo, z_hi)`.
    DepthRange,
    /// The name of a storage format.
    Format(FormatSet),
    /// The name of a published function, or one of the user's own.
    Function {
        /// The published ones.
        names: &'static [&'static str],
        /// What others may read.
        signature: &'static Signature,
    },
}

impl Kind {
    /// Any integer from `min`, limited by memory alone.
    pub const fn at_least(min: i64) -> Self {
        Self::Int { min, max: i64::MAX }
    }
    /// A number in the closed interval.
    pub const fn float(min: f64, max: f64) -> Self {
        Self::Float { min, max, min_open: false, max_open: false }
    }
    /// A finite number above zero.
    pub const POSITIVE: Self = Self::Float { min: 0.0, max: f64::INFINITY, min_open: true, max_open: true };
    /// Any finite number.
    pub const REAL: Self =
        Self::Float { min: f64::NEG_INFINITY, max: f64::INFINITY, min_open: true, max_open: true };
    /// A finite number of at least zero.
    pub const NON_NEGATIVE: Self =
        Self::Float { min: 0.0, max: f64::INFINITY, min_open: false, max_open: true };

    /// The type's name as users read it.
    pub fn type_name(&self) -> &'static str {
        match self {
            Self::Bool => "bool",
            Self::Int { .. } | Self::IntChoice(_) => "int",
            Self::Float { .. } => "float",
            Self::Choice(_) | Self::Format(_) => "str",
            Self::Function { .. } => "str or callable",
            Self::FloatOrRgb { .. } => "float or (r, g, b)",
            Self::DepthRange => "str or (z_lo, z_hi)",
        }
    }

    /// Reads `input`; what it has to be when its type or value does not fit.
    pub(super) fn read(&self, input: &Input) -> Result<Setting, String> {
        match (*self, input) {
            (Self::Function { signature, .. }, Input::Text(text)) if !Source::is_name(text, signature) => {
                let source = Source::parse(text, signature);
                source.map(|source| Setting::Written(Arc::new(source)))
            }
            (Self::Function { .. }, Input::Function(function)) => Ok(Setting::Called(function.clone())),
            _ => self.read_plain(input).map(Setting::Plain).ok_or_else(|| format!("allowed is {self}")),
        }
    }

    fn read_plain(&self, input: &Input) -> Option<Value> {
        match (*self, input) {
            (Self::Bool, Input::Bool(b)) => Some(Value::Bool(*b)),
            (Self::Int { min, max }, Input::Int(i)) => (min..=max).contains(i).then_some(Value::Int(*i)),
            (Self::IntChoice(choices), Input::Int(i)) => choices.contains(i).then_some(Value::Int(*i)),
            (Self::Float { .. }, Input::Int(_) | Input::Float(_)) => {
                let x = number(input)?;
                self.contains(x).then_some(Value::Float(x))
            }
            (Self::Choice(names) | Self::Function { names, .. }, Input::Text(text)) => choice(names, text),
            (Self::FloatOrRgb { min, max }, _) => {
                let inside = |x: &f64| (min..=max).contains(x);
                match input {
                    Input::Floats(v) if v.len() == 3 && v.iter().all(inside) => {
                        Some(Value::Rgb([v[0], v[1], v[2]]))
                    }
                    _ => number(input).filter(inside).map(|x| Value::Rgb([x; 3])),
                }
            }
            (Self::Format(formats), Input::Text(text)) => {
                formats.find(text).map(|format| Value::Text(format.name()))
            }
            (Self::DepthRange, Input::Text(text)) => choice(&["pixel", "scene"], text),
            (Self::DepthRange, Input::Floats(v)) => {
                let fits = v.len() == 2 && v.iter().all(|z| z.is_finite()) && 0.0 <= v[0] && v[0] < v[1];
                fits.then(|| Value::Pair(v[0], v[1]))
            }
            _ => None,
        }
    }

    fn contains(&self, x: f64) -> bool {
        let Self::Float { min, max, min_open, max_open } = *self else { return false };
        let above = if min_open { x > min } else { x >= min };
        let below = if max_open { x < max } else { x <= max };
        x.is_finite() && above && below
    }
}

pub(super) fn number(input: &Input) -> Option<f64> {
    match input {
        #[expect(clippy::cast_precision_loss, reason = "a param beyond 2^53 has no use as a number")]
        Input::Int(i) => Some(*i as f64),
        Input::Float(x) => Some(*x),
        _ => None,
    }
}

fn choice(choices: &[&'static str], text: &str) -> Option<Value> {
    choices.iter().find(|c| **c == text).map(|c| Value::Text(c))
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Bool => write!(f, "True or False"),
            Self::Int { min, max: i64::MAX } => write!(f, "an integer >= {min}"),
            Self::Int { min, max } => write!(f, "an integer in [{min}, {max}]"),
            Self::IntChoice(choices) => {
                write!(f, "one of {}", join(choices.iter().map(ToString::to_string)))
            }
            Self::Float { min, max, min_open, max_open } => match (min.is_finite(), max.is_finite()) {
                (false, false) => write!(f, "a finite number"),
                (true, false) => write!(f, "a finite number {} {min}", if min_open { ">" } else { ">=" }),
                _ => {
                    let (open, close) = (if min_open { '(' } else { '[' }, if max_open { ')' } else { ']' });
                    write!(f, "a number in {open}{min}, {max}{close}")
                }
            },
            Self::Choice(choices) => write!(f, "one of {}", join(choices.iter().map(|c| format!("{c:?}")))),
            Self::FloatOrRgb { min, max } => {
                write!(f, "a number in [{min}, {max}], or three of them (r, g, b)")
            }
            Self::Format(formats) => write!(f, "one of {formats}"),
            Self::Function { names, signature: Signature { entry, arguments, callable } } => {
                let arguments = join(arguments.iter().map(ToString::to_string));
                write!(f, "one of {}; ", join(names.iter().map(|name| format!("{name:?}"))))?;
                write!(f, "WGSL, an expression of {arguments} or a module with fn {entry}; ")?;
                write!(f, "or a callable {callable}")
            }
            Self::DepthRange => write!(f, "\"pixel\", \"scene\" or (z_lo, z_hi) with 0 <= z_lo < z_hi"),
        }
    }
}

pub(super) fn join(items: impl Iterator<Item = String>) -> String {
    items.collect::<Vec<_>>().join(", ")
}
