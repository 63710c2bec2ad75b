//! Typed reading of a technique's params: a table of specs checks what the user gave, fills in defaults and
//! rejects what it does not know, by name.

mod kind;

pub use kind::Kind;

use crate::error::{Error, Result};
use crate::own::{Callback, Source};
use kind::{join, number};
use std::borrow::Cow;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// A parameter value that a table can hold. Text is always one of a spec's choices, hence `'static`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Value {
    /// No value: the parameter is inactive under the other params.
    None,
    /// A switch.
    Bool(bool),
    /// A whole number.
    Int(i64),
    /// A real number.
    Float(f64),
    /// One of a spec's choices.
    Text(&'static str),
    /// A depth interval `(z_lo, z_hi)`.
    Pair(f64, f64),
    /// Three channels.
    Rgb([f64; 3]),
}

/// A resolved parameter value.
#[derive(Debug, Clone, PartialEq)]
pub enum Setting {
    /// One that a table can hold.
    Plain(Value),
    /// A function of the user's own, in WGSL.
    Written(Arc<Source>),
    /// A function of the user's own, of arrays.
    Called(Callback),
}

impl From<Value> for Setting {
    fn from(value: Value) -> Self {
        Self::Plain(value)
    }
}

/// A parameter value as the user wrote it.
#[derive(Debug, Clone, PartialEq)]
pub enum Input {
    /// `True` or `False`.
    Bool(bool),
    /// An integer.
    Int(i64),
    /// A real number.
    Float(f64),
    /// A string.
    Text(String),
    /// A tuple, list or array of numbers.
    Floats(Vec<f64>),
    /// A function of arrays.
    Function(Callback),
    /// Something else; the text says what.
    Other(String),
}

/// What a parameter is when the user says nothing.
#[derive(Clone, Copy)]
pub enum Default {
    /// A constant.
    Fixed(Value),
    /// A value that follows from the other params (those before it in the table) and the view.
    Derived {
        /// How the value follows, in words.
        text: &'static str,
        /// The rule itself.
        rule: fn(&Params, &View) -> Value,
    },
}

/// One row of a technique's parameter table.
#[derive(Clone, Copy)]
pub struct ParamSpec {
    /// The name users write.
    pub name: &'static str,
    /// Type and range.
    pub kind: Kind,
    /// Value when absent.
    pub default: Default,
    /// Meaning, in a sentence.
    pub doc: &'static str,
    /// Whether the parameter acts, given the params before it in the table.
    pub active: fn(&Params) -> bool,
    /// Whether it comes after the storage formats in the table, so that its default may follow from them.
    pub after_formats: bool,
}

impl ParamSpec {
    /// A parameter with a constant default that always acts.
    pub const fn new(name: &'static str, kind: Kind, default: Value, doc: &'static str) -> Self {
        Self { name, kind, default: Default::Fixed(default), doc, active: |_| true, after_formats: false }
    }
    /// The same parameter, acting only where `active` says so.
    pub const fn when(mut self, active: fn(&Params) -> bool) -> Self {
        self.active = active;
        self
    }
    /// The same parameter, after the storage formats in the table.
    pub const fn after_formats(mut self) -> Self {
        self.after_formats = true;
        self
    }
    /// The same parameter with a default that follows from others or from the view.
    pub const fn derived(mut self, text: &'static str, rule: fn(&Params, &View) -> Value) -> Self {
        self.default = Default::Derived { text, rule };
        self
    }
}

/// What a technique may know of the view besides a pixel's fragments.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// Near plane: view-space distance, > 0.
    pub near: f64,
    /// Far plane: view-space distance.
    pub far: f64,
    /// Depth range of the scene's transparent geometry (`range="scene"`).
    pub depth_range: (f64, f64),
}

impl View {
    /// A view for questions that no image is needed for.
    pub const ORDINARY: Self = Self { near: 0.1, far: 100.0, depth_range: (1.0, 10.0) };
}

/// What the user gave, checked against a technique's table but not yet completed.
#[derive(Debug, Clone, PartialEq)]
pub struct Checked {
    technique: &'static str,
    given: Vec<(&'static str, Setting)>,
    /// The uniforms of functions that are the user's own, in the order of their texts.
    uniforms: Vec<(&'static str, String, f64)>,
}

/// Checks `inputs` against the table `specs` of `technique`.
///
/// # Errors
/// [`Error::Param`] for the first unknown name, wrong type or value out of range.
pub fn check(technique: &'static str, specs: &[ParamSpec], inputs: &[(String, Input)]) -> Result<Checked> {
    let mut given = Vec::with_capacity(inputs.len());
    for (name, input) in inputs.iter().filter(|(name, _)| uniform_of(specs, name).is_none()) {
        let Some(spec) = specs.iter().find(|spec| spec.name == name) else {
            let names = join(specs.iter().map(|s| format!("{} ({})", s.name, s.kind)));
            return Err(Error::Param {
                technique,
                problem: format!("unknown parameter {name:?}"),
                valid: format!("its parameters are {names}"),
            });
        };
        let setting =
            spec.kind.read(input).map_err(|allowed| refusal(technique, specs, spec, input, allowed))?;
        given.push((spec.name, setting));
    }
    let uniforms = uniforms(technique, specs, &given, inputs)?;
    Ok(Checked { technique, given, uniforms })
}

fn refusal(
    technique: &'static str,
    specs: &[ParamSpec],
    spec: &ParamSpec,
    input: &Input,
    allowed: String,
) -> Error {
    let is_source = matches!(
        (spec.kind, input),
        (Kind::Function { signature, .. }, Input::Text(text)) if !Source::is_name(text, signature)
    );
    if is_source {
        let problem = format!("parameter {:?} is not a function:\n{allowed}\n", spec.name);
        return Error::Param { technique, problem, valid: format!("allowed is {}", spec.kind) };
    }
    let names = join(specs.iter().map(|s| s.name.to_owned()));
    Error::Param {
        technique,
        problem: format!("parameter {:?} is {}", spec.name, describe(input)),
        valid: format!("{allowed}; its parameters are {names}"),
    }
}

/// The function whose uniform a dotted name is, and the uniform's own name.
fn uniform_of<'s, 'n>(specs: &'s [ParamSpec], name: &'n str) -> Option<(&'s ParamSpec, &'n str)> {
    let (function, uniform) = name.split_once('.')?;
    let spec =
        specs.iter().find(|spec| spec.name == function && matches!(spec.kind, Kind::Function { .. }))?;
    Some((spec, uniform))
}

/// The value of every uniform of the functions that were given.
fn uniforms(
    technique: &'static str,
    specs: &[ParamSpec],
    given: &[(&'static str, Setting)],
    inputs: &[(String, Input)],
) -> Result<Vec<(&'static str, String, f64)>> {
    let fault = |problem, valid| Error::Param { technique, problem, valid };
    let known = |function: &str| match given.iter().rev().find(|(name, _)| *name == function) {
        Some((_, Setting::Written(source))) => source.uniforms(),
        _ => &[],
    };
    let valid = |function: &str| match known(function) {
        [] => format!(
            "{function:?} has no uniforms here: they are the names in an expression that it does not know"
        ),
        names => format!("the uniforms of {function:?} are {}", join(names.iter().cloned())),
    };
    let mut values = Vec::new();
    for (name, input) in inputs {
        let Some((spec, uniform)) = uniform_of(specs, name) else { continue };
        if !known(spec.name).iter().any(|known| known == uniform) {
            return Err(fault(format!("unknown parameter {name:?}"), valid(spec.name)));
        }
        let value = number(input).filter(|x| x.is_finite() && x.abs() <= f32::MAX.into());
        let problem = || format!("parameter {name:?} is {}", describe(input));
        let value =
            value.ok_or_else(|| fault(problem(), "allowed is a finite number of f32's range".into()))?;
        values.push((spec.name, uniform, value));
    }
    let mut found = Vec::new();
    for spec in specs.iter().filter(|spec| matches!(spec.kind, Kind::Function { .. })) {
        for uniform in known(spec.name) {
            let given =
                values.iter().rev().find(|(function, name, _)| (*function, *name) == (spec.name, uniform));
            let Some((_, _, value)) = given else {
                let dotted = format!("{}.{uniform}", spec.name);
                let problem = format!("parameter {dotted:?} is missing, a uniform of {:?}", spec.name);
                return Err(fault(problem, format!("{}; give each a number", valid(spec.name))));
            };
            found.push((spec.name, uniform.clone(), *value));
        }
    }
    Ok(found)
}

fn describe(input: &Input) -> String {
    match input {
        Input::Bool(b) => format!("the bool {}", if *b { "True" } else { "False" }),
        Input::Int(i) => format!("{i}"),
        Input::Float(x) => format!("{x:?}"),
        Input::Text(t) => format!("{t:?}"),
        Input::Floats(v) => format!("({})", join(v.iter().map(|x| format!("{x:?}")))),
        Input::Function(function) => function.0.describe(),
        Input::Other(what) => what.clone(),
    }
}

/// All params of one technique, in the order of its table, uniforms after their functions.
#[derive(Debug, Clone, PartialEq)]
pub struct Params {
    technique: &'static str,
    values: Vec<(Cow<'static, str>, Setting)>,
    active: Vec<bool>,
    reports: Reports,
}

/// What the user's own functions have to report, counted by whoever calls them on behalf of these params.
#[derive(Debug, Clone, Default)]
pub struct Reports(Arc<AtomicU64>);

/// What has happened is no part of what was asked for.
impl PartialEq for Reports {
    fn eq(&self, _other: &Self) -> bool {
        true
    }
}

impl Reports {
    /// Counts results that are no weights, or no shares.
    pub fn add_invalid(&self, count: u64) {
        if count > 0 {
            self.0.fetch_add(count, Ordering::Relaxed);
        }
    }

    /// How many there were.
    pub fn invalid(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

impl Checked {
    /// Completes the params with the defaults that `view` and the other params imply.
    pub fn resolve(&self, specs: &[ParamSpec], view: &View) -> Params {
        let mut params = Params {
            technique: self.technique,
            values: Vec::new(),
            active: Vec::new(),
            reports: Reports::default(),
        };
        for spec in specs {
            let given = self.given.iter().rev().find(|(name, _)| *name == spec.name);
            let setting = match (given, spec.default) {
                (Some((_, setting)), _) => setting.clone(),
                (None, Default::Fixed(value)) => value.into(),
                (None, Default::Derived { rule, .. }) => rule(&params, view).into(),
            };
            let active = (spec.active)(&params);
            params.push(Cow::Borrowed(spec.name), setting, active);
            for (_, uniform, value) in self.uniforms.iter().filter(|(function, ..)| *function == spec.name) {
                let name = Cow::Owned(format!("{}.{uniform}", spec.name));
                params.push(name, Value::Float(*value).into(), active);
            }
        }
        params
    }
}

impl Params {
    fn push(&mut self, name: Cow<'static, str>, setting: Setting, active: bool) {
        self.values.push((name, setting));
        self.active.push(active);
    }

    /// Every param with its value.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Setting)> + '_ {
        self.values.iter().map(|(name, setting)| (&**name, setting))
    }

    /// The params that act: what tells one variant of a technique from another.
    pub fn identity(&self) -> Vec<(Cow<'static, str>, Setting)> {
        let pairs = self.values.iter().zip(&self.active);
        pairs.filter(|(_, active)| **active).map(|(pair, _)| pair.clone()).collect()
    }

    /// The names of the params that do nothing under the others.
    pub fn inactive(&self) -> impl Iterator<Item = &str> + '_ {
        let pairs = self.values.iter().zip(&self.active);
        pairs.filter(|(_, active)| !**active).map(|((name, _), _)| &**name)
    }

    /// Where the user's own functions are reported about.
    pub fn reports(&self) -> &Reports {
        &self.reports
    }

    /// Whether a function of arrays acts, which is best called for many fragments at once.
    pub fn call_out(&self) -> bool {
        self.identity().iter().any(|(_, setting)| matches!(setting, Setting::Called(_)))
    }

    /// The technique's own error about a combination of params.
    pub fn error(&self, problem: impl Into<String>, valid: impl Into<String>) -> Error {
        Error::Param { technique: self.technique, problem: problem.into(), valid: valid.into() }
    }

    /// The value of `name`.
    ///
    /// # Panics
    /// If the technique's own table has no such row, or has it after the one being resolved.
    pub fn setting(&self, name: &str) -> &Setting {
        match self.values.iter().find(|(n, _)| n == name) {
            Some((_, setting)) => setting,
            None => panic!("{} has no param {name:?}", self.technique),
        }
    }
    /// The value of `name`; none where it is a function of the user's own.
    pub fn value(&self, name: &str) -> Value {
        match self.setting(name) {
            Setting::Plain(value) => *value,
            Setting::Written(_) | Setting::Called(_) => Value::None,
        }
    }
    /// The values of the uniforms of a function that is the user's own.
    #[expect(clippy::cast_possible_truncation, reason = "functions compute in f32")]
    pub fn uniforms(&self, name: &str) -> Vec<f32> {
        let is_uniform = |dotted: &str| dotted.split_once('.').is_some_and(|(function, _)| function == name);
        let uniforms = self.iter().filter(|(dotted, _)| is_uniform(dotted));
        let values = uniforms.filter_map(|(_, setting)| match setting {
            Setting::Plain(Value::Float(x)) => Some(*x as f32),
            _ => None,
        });
        values.collect()
    }
    /// Whether `name` is this one of its choices.
    pub fn is(&self, name: &str, choice: &str) -> bool {
        matches!(self.value(name), Value::Text(text) if text == choice)
    }
    /// A switch.
    pub fn bool(&self, name: &str) -> bool {
        matches!(self.value(name), Value::Bool(true))
    }
    /// A whole number.
    pub fn int(&self, name: &str) -> i64 {
        match self.value(name) {
            Value::Int(i) => i,
            other => panic!("{}: {name:?} is {other:?}, not an integer", self.technique),
        }
    }
    /// A whole number >= 0 that counts something; larger than memory allows is as good as unlimited.
    pub fn size(&self, name: &str) -> usize {
        usize::try_from(self.int(name)).unwrap_or(usize::MAX)
    }
    /// A real number.
    pub fn float(&self, name: &str) -> f64 {
        match self.value(name) {
            Value::Float(x) => x,
            other => panic!("{}: {name:?} is {other:?}, not a number", self.technique),
        }
    }
    /// One of the spec's choices.
    pub fn text(&self, name: &str) -> &'static str {
        match self.value(name) {
            Value::Text(text) => text,
            other => panic!("{}: {name:?} is {other:?}, not text", self.technique),
        }
    }
}
#[cfg(test)]
mod tests;
