//! Inputs at the ends of what is accepted: every technique gives numbers, or refuses.

mod common;

use oitlab::fragments::{Background, Fragment, Fragments, FragmentsInput, Lists};
use oitlab::frame::Image;
use oitlab::render::{Options, Request, Source, render};
use oitlab::techniques::REGISTRY;

/// One pixel per pair of depths and alphas, three fragments in each.
fn extreme_pixels() -> Vec<[Fragment; 3]> {
    let depths = [0.0, f32::MIN_POSITIVE / 4.0, 1.0, f32::MAX];
    let alphas = [0.0, f32::MIN_POSITIVE / 4.0, 0.5, 1.0 - f32::EPSILON / 2.0, 1.0];
    let colors = [0.0, f32::MIN_POSITIVE / 4.0, 1.0, f32::MAX];
    let mut pixels = Vec::new();
    for (i, depth) in depths.into_iter().enumerate() {
        for (j, alpha) in alphas.into_iter().enumerate() {
            let fragment = |n: usize| Fragment {
                depth: if n == 0 { depth } else { depths[(i + n * j) % 4] },
                color: [0, 1, 2].map(|c| colors[(i + j * n + c) % 4]),
                alpha: if n == 1 { alpha } else { alphas[(i + n) % 5] },
                primitive: [0, u32::MAX, 7][n],
            };
            pixels.push([fragment(0), fragment(1), fragment(2)]);
        }
    }
    pixels
}

fn captured(pixels: &[[Fragment; 3]], (near, far): (f64, f64)) -> Fragments {
    let mut lists = Lists::new();
    for pixel in pixels {
        pixel.iter().for_each(|f| lists.push(*f));
        lists.end_row();
    }
    let input = FragmentsInput {
        width: u32::try_from(pixels.len()).unwrap(),
        height: 1,
        lists,
        background: Background::Constant([f32::MAX, 0.0, 1.0]),
        near,
        far,
        depth_range: None,
        primitive_depth: None,
    };
    Fragments::new(input).unwrap()
}

/// Sums of colours at the largest number may overflow, which is stored as the largest number; what is not a number
/// would be stored so too, and lie.
#[test]
fn numbers_at_the_ends_of_single_precision_stay_numbers() {
    let pixels = extreme_pixels();
    let requests: Vec<Request> = REGISTRY.iter().map(|info| (info.id.to_owned(), vec![]).into()).collect();
    for planes in [(0.1, 100.0), (f64::from(f32::MIN_POSITIVE), f64::from(f32::MAX))] {
        let fragments = captured(&pixels, planes);
        let source = Source::Fragments(&fragments);
        for frame in render::<f64>(source, &requests, &Options::default(), &|| false).unwrap() {
            let (Image::F64(color), Image::F64(shares)) = (&*frame.color, &*frame.transmittance) else {
                panic!("not double precision")
            };
            let id = frame.technique;
            assert!(!color.iter().any(|x| x.is_nan()), "{id}: {color:?}");
            assert!(shares.iter().all(|t| t.is_finite()), "{id}: {shares:?}");
        }
    }
}
