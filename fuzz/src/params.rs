//! Params dicts: arbitrary keys and values for any technique.

use crate::{Number, check_frame, render_exactly};
use arbitrary::Arbitrary;
use oitlab::error::Error;
use oitlab::fragments::{Background, Fragment, Fragments, FragmentsInput, Lists};
use oitlab::params::{Input as Value, Kind, ParamSpec, View, check};
use oitlab::render::Source;
use oitlab::technique::DepthComplexity;
use oitlab::techniques::REGISTRY;

/// Bytes as a technique and its params.
#[derive(Debug, Arbitrary)]
pub struct Input {
    technique: u8,
    params: Vec<(Key, Raw)>,
}

#[derive(Debug, Arbitrary)]
enum Key {
    /// A param of the table.
    Known(u8),
    Any(String),
}

#[derive(Debug, Arbitrary)]
enum Raw {
    Bool(bool),
    Small(i8),
    Int(i64),
    Float(Number),
    /// A choice of the param, if it has any.
    Choice(u8),
    Text(String),
    Floats(Vec<Number>),
    Other(String),
}

impl Raw {
    fn value(&self, spec: Option<&ParamSpec>) -> Value {
        match self {
            Self::Bool(b) => Value::Bool(*b),
            Self::Small(i) => Value::Int(i64::from(*i)),
            Self::Int(i) => Value::Int(*i),
            Self::Float(x) => Value::Float(x.get()),
            Self::Choice(i) => choice(spec, usize::from(*i)),
            Self::Text(text) => Value::Text(text.clone()),
            Self::Floats(xs) => Value::Floats(xs.iter().map(|x| x.get()).collect()),
            Self::Other(text) => Value::Other(text.clone()),
        }
    }
}

/// The choice of this number among those of a param.
pub fn choice(spec: Option<&ParamSpec>, i: usize) -> Value {
    match spec.map(|spec| spec.kind) {
        Some(Kind::Format(formats)) => {
            let names: Vec<_> = formats.iter().map(|format| format.name()).collect();
            Value::Text(names[i % names.len()].to_owned())
        }
        Some(Kind::Choice(words) | Kind::Function { names: words, .. }) => {
            Value::Text(words[i % words.len()].to_owned())
        }
        Some(Kind::IntChoice(numbers)) => Value::Int(numbers[i % numbers.len()]),
        Some(Kind::DepthRange) => Value::Text(["pixel", "scene"][i % 2].to_owned()),
        _ => Value::Int(i as i64),
    }
}

/// State per pixel that is worth the fuzzer's time.
const SMALL: f64 = 4096.0;

/// No panic; errors name the technique and the param; what is accepted renders a finite pixel.
pub fn run(input: &Input) {
    let info = &REGISTRY[usize::from(input.technique) % REGISTRY.len()];
    let table = info.param_table();
    let params: Vec<_> = input
        .params
        .iter()
        .map(|(key, raw)| match key {
            Key::Known(i) if !table.is_empty() => {
                let spec = &table[usize::from(*i) % table.len()];
                (spec.name.to_owned(), raw.value(Some(spec)))
            }
            Key::Known(_) => ("none".to_owned(), raw.value(None)),
            Key::Any(name) => (name.clone(), raw.value(None)),
        })
        .collect();
    let checked = match check(info.id, &table, &params) {
        Ok(checked) => checked,
        Err(error) => return names_the_culprit(&error, &params),
    };
    let Ok(technique) = (info.build)(&checked.resolve(&table, &View::ORDINARY), &View::ORDINARY) else {
        return;
    };
    let cost = technique.cost(&DepthComplexity { mean: 1.0, max: 4 });
    assert!(cost.bytes_per_pixel >= 0.0, "{}: {cost:?}", info.id);
    if cost.bytes_per_pixel <= SMALL {
        let exact = technique.properties().exact_coverage;
        match render_exactly(Source::Fragments(&pixels()), &[(info.id.to_owned(), params).into()]) {
            Ok(frames) => check_frame(&frames[0], exact),
            Err(error) => assert!(!error.to_string().is_empty()),
        }
    }
}

fn names_the_culprit(error: &Error, params: &[(String, Value)]) {
    let Error::Param { technique, problem, valid } = error else { panic!("{error:?}") };
    assert!(!technique.is_empty() && !valid.is_empty());
    let named = params.iter().any(|(name, _)| problem.contains(&format!("{name:?}")));
    assert!(named, "{problem}");
}

/// A few layers, an empty pixel, twins, and one that covers all.
pub fn pixels() -> Fragments {
    let mut lists = Lists::new();
    let fragment =
        |depth, alpha: f32, primitive| Fragment { depth, color: [alpha, 0.5 * alpha, 0.0], alpha, primitive };
    for i in [3, 0, 1, 2] {
        let i = i as f32;
        lists.push(fragment(1.0 + 2.0 * i, 0.25 * (i + 1.0), 2 * i as u32));
        lists.push(fragment(1.0 + 2.0 * i, 0.3, 2 * i as u32 + 1));
    }
    lists.end_row();
    lists.end_row();
    lists.push(fragment(2.5, 0.5, 0));
    lists.end_row();
    Fragments::new(FragmentsInput {
        width: 3,
        height: 1,
        lists,
        background: Background::Constant([0.25, 0.5, 0.75]),
        near: View::ORDINARY.near,
        far: View::ORDINARY.far,
        depth_range: Some(View::ORDINARY.depth_range),
        primitive_depth: None,
    })
    .expect("the list is valid")
}
