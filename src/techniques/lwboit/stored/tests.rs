//! Bins and nodes in other formats.

use crate::format::Format;
use crate::technique::DepthComplexity;
use crate::techniques::lwboit::tests::{Inputs, With, naive, smooth};
use crate::techniques::testing::{build, difference, random_pixel, resolve};

#[test]
fn bins_in_other_formats_hold_the_same_within_their_precision() {
    // a column of sums per bin: FEE21 stores halves
    let cases = [
        ("f32", "compensated", 1e-5),
        ("f64", "plain", 1e-5),
        ("f16", "scaled_double", 0.02),
        ("f16", "plain", 0.02),
        ("f32", "fixed", 1e-5),
        ("f32", "scaled", 1e-5),
    ];
    for (format, summation, tolerance) in cases {
        for inputs in [naive(4), smooth(8), smooth(8).word("partition", "absorbance")] {
            for seed in 0..5 {
                let pixel = random_pixel(30, seed);
                let exact = resolve("lwboit", &inputs, &pixel);
                let stored = inputs.clone().word("format", format).word("summation", summation);
                let got = resolve("lwboit", &stored, &pixel);
                let far = difference(got, exact.color, exact.transmittance.x);
                assert!(far < tolerance && got != exact, "{format} {summation} {seed}: {far:e}");
            }
        }
    }
}

#[test]
fn nodes_of_lists_are_rounded_when_they_are_stored() {
    let lists = || smooth(8).word("storage", "ll");
    let pixel = random_pixel(30, 3);
    let exact = resolve("lwboit", &lists(), &pixel);
    let eight = resolve("lwboit", &lists().word("node_color_format", "unorm8"), &pixel);
    let far = difference(eight, exact.color, exact.transmittance.x);
    assert!((1e-5..0.02).contains(&far), "{far:e}");
    let mut rounded = pixel;
    rounded.iter_mut().for_each(|f| Format::F16.round_all_f32(std::slice::from_mut(&mut f.depth)));
    assert_eq!(
        resolve("lwboit", &lists().word("node_depth_format", "f16"), &rounded),
        resolve("lwboit", &lists(), &rounded)
    );
}

#[test]
fn bytes_follow_the_formats() {
    let complexity = DepthComplexity { mean: 3.0, max: 9 };
    let bytes = |inputs: &Inputs| build("lwboit", inputs).unwrap().cost(&complexity).bytes_per_pixel;
    let half = |inputs: Inputs| inputs.word("format", "f16");
    assert_eq!(bytes(&half(smooth(32))), 326.0);
    assert_eq!(bytes(&half(smooth(32)).word("revealage_format", "unorm8")), 293.0);
    assert_eq!(bytes(&half(smooth(32).word("storage", "ll"))), 46.0);
}
