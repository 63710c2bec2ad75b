//! Fragment lists into every technique of the registry.

use crate::params::choice;
use crate::{Number, check_frame, check_overflow, render_exactly};
use arbitrary::Arbitrary;
use oitlab::fragments::{Background, Fragment, Fragments, FragmentsInput, Lists};
use oitlab::params::{Input as Value, check};
use oitlab::render::{Request, Source};
use oitlab::technique::Info;
use oitlab::techniques::REGISTRY;

/// Bytes as an image of a few pixels.
#[derive(Debug, Arbitrary)]
pub struct Input {
    pixels: Vec<Vec<Raw>>,
    background: [u8; 3],
    planes: Option<(Number, Number)>,
    depth_range: Option<(Number, Number)>,
    primitive_depth: Option<Vec<Number>>,
    /// Which of its formats, and of its ways to sum, a technique is to use; its defaults if absent.
    stored: Option<(u8, u8)>,
}

#[derive(Debug, Arbitrary)]
struct Raw {
    depth: Number,
    color: [Number; 3],
    alpha: Alpha,
    primitive: Primitive,
}

#[derive(Debug, Arbitrary)]
enum Alpha {
    None,
    All,
    Share(u8),
    Any(Number),
}

#[derive(Debug, Arbitrary)]
enum Primitive {
    Few(u8),
    Any(u32),
}

impl Raw {
    fn fragment(&self) -> Fragment {
        let alpha = match self.alpha {
            Alpha::None => 0.0,
            Alpha::All => 1.0,
            Alpha::Share(share) => f32::from(share) / 255.0,
            Alpha::Any(any) => any.single(),
        };
        let primitive = match self.primitive {
            Primitive::Few(id) => u32::from(id),
            Primitive::Any(id) => id,
        };
        Fragment { depth: self.depth.single(), color: self.color.map(Number::single), alpha, primitive }
    }
}

/// Pixels of an image, and fragments of a pixel.
const MOST: usize = 8;
/// Colours above this may overflow where a technique multiplies or sums them in single precision.
const BRIGHT: f32 = 1e12;

/// Values that `Fragments::new` has to accept, if nothing else is wrong.
fn is_valid(f: &Fragment) -> bool {
    let positive = |x: f32| x.is_finite() && x >= 0.0;
    positive(f.depth) && f.color.into_iter().all(positive) && (0.0..=1.0).contains(&f.alpha)
}

fn of(input: &Input, lists: Lists, width: u32) -> oitlab::Result<Fragments> {
    let background = input.background.map(|c| f32::from(c) / 64.0);
    let (near, far) = input.planes.map_or((0.1, 100.0), |(near, far)| (near.get(), far.get()));
    Fragments::new(FragmentsInput {
        width,
        height: 1,
        lists,
        background: Background::Constant(background),
        near,
        far,
        depth_range: input.depth_range.map(|(lo, hi)| (lo.get(), hi.get())),
        primitive_depth: input.primitive_depth.as_ref().map(|z| z.iter().map(|z| z.get()).collect()),
    })
}

/// No panic; what is not a fragment is refused; every technique gives a finite image.
pub fn run(input: &Input) {
    let pixels: Vec<Vec<_>> = input
        .pixels
        .iter()
        .take(MOST)
        .map(|pixel| pixel.iter().take(MOST).map(Raw::fragment).collect())
        .collect();
    let mut lists = Lists::new();
    for pixel in &pixels {
        pixel.iter().for_each(|f| lists.push(*f));
        lists.end_row();
    }
    let fragments = of(input, lists, pixels.len() as u32);
    let valid = pixels.iter().flatten().all(is_valid);
    let Ok(fragments) = fragments else { return };
    assert!(valid, "accepted {pixels:?}");
    let bright = pixels.iter().flatten().any(|f| f.color.iter().any(|c| *c > BRIGHT));
    let asked: Vec<_> = REGISTRY.iter().map(|info| params(info, input.stored)).collect();
    let request = |(info, params): (&&Info, &Vec<_>)| (info.id.to_owned(), params.clone()).into();
    let requests: Vec<Request> = REGISTRY.iter().zip(&asked).map(request).collect();
    let frames = render_exactly(Source::Fragments(&fragments), &requests).expect("choices are valid");
    for ((info, params), frame) in REGISTRY.iter().zip(&asked).zip(&frames) {
        if bright {
            check_overflow(frame);
        } else {
            check_frame(frame, has_exact_coverage(info, params, &fragments));
        }
    }
}

/// A format of those that a technique offers and a way to sum, where it offers any.
fn params(info: &Info, stored: Option<(u8, u8)>) -> Vec<(String, Value)> {
    let Some((format, summation)) = stored else { return vec![] };
    let table = info.param_table();
    let chosen = [("format", format), ("summation", summation)].into_iter().filter_map(|(name, i)| {
        let spec = table.iter().find(|spec| spec.name == name)?;
        Some((name.to_owned(), choice(Some(spec), usize::from(i))))
    });
    chosen.collect()
}

fn has_exact_coverage(info: &Info, params: &[(String, Value)], fragments: &Fragments) -> bool {
    let table = info.param_table();
    let params = check(info.id, &table, params).expect("choices are valid").resolve(&table, &fragments.view);
    (info.build)(&params, &fragments.view).expect("choices are valid").properties().exact_coverage
}
