//! Weights and bin functions: arbitrary text.

use crate::params::pixels;
use crate::{check_frame, render_exactly};
use oitlab::own::{Signature, Source};
use oitlab::params::Input as Value;
use oitlab::render::Source as Image;

static WEIGHT: Signature = oitlab::weight::SIGNATURE;
static BIN: Signature = Signature { entry: "bin", arguments: &["x"], callable: "" };

/// No panic and no hang; errors name the param and show something; what is accepted renders finite pixels, and the same
/// ones again.
pub fn run(text: &str) {
    one("wboit", "weight", text, &WEIGHT);
    one("lwboit", "bin_function", text, &BIN);
}

fn one(technique: &str, param: &str, text: &str, signature: &'static Signature) {
    let mut params = vec![(param.to_owned(), Value::Text(text.to_owned()))];
    if let Ok(source) = Source::parse(text, signature) {
        let values = [0.5, 2.0, -1.0, 3.0].into_iter().cycle();
        let uniforms = source.uniforms().iter().zip(values);
        params.extend(uniforms.map(|(name, x)| (format!("{param}.{name}"), Value::Float(x))));
    }
    let request = [(technique.to_owned(), params).into()];
    let pixels = pixels();
    match render_exactly(Image::Fragments(&pixels), &request) {
        Ok(frames) => {
            check_frame(&frames[0], technique == "wboit");
            let again = render_exactly(Image::Fragments(&pixels), &request).expect("what went well once");
            assert_eq!(frames[0].color, again[0].color);
        }
        Err(error) => {
            let shown = error.to_string();
            assert!(shown.contains(&format!("{param:?}")), "{shown}");
        }
    }
}
