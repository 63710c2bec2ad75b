use super::*;

const VIEW: View = View { near: 0.1, far: 100.0, depth_range: (1.0, 2.0) };
const SPECS: &[ParamSpec] = &[
    ParamSpec::new("mode", Kind::Choice(&["a", "b"]), Value::Text("a"), "m"),
    ParamSpec::new("k", Kind::POSITIVE, Value::Float(4.0), "k").when(|p| p.text("mode") == "b"),
    ParamSpec::new("layers", Kind::at_least(1), Value::Int(8), "n"),
    ParamSpec::new("near", Kind::POSITIVE, Value::None, "near")
        .derived("the camera's", |_, view| Value::Float(view.near)),
    ParamSpec::new("range", Kind::DepthRange, Value::Text("pixel"), "r"),
    ParamSpec::new("tau", Kind::FloatOrRgb { min: 0.0, max: 1.0 }, Value::Rgb([0.0; 3]), "t"),
    ParamSpec::new("m", Kind::IntChoice(&[4, 6, 8]), Value::Int(4), "m"),
    ParamSpec::new("on", Kind::Bool, Value::Bool(true), "o"),
];

fn checked(inputs: &[(&str, Input)]) -> Result<Checked> {
    let inputs: Vec<_> = inputs.iter().map(|(n, v)| ((*n).to_owned(), v.clone())).collect();
    check("demo", SPECS, &inputs)
}

fn message(name: &str, input: Input) -> String {
    checked(&[(name, input)]).unwrap_err().to_string()
}

#[test]
fn defaults_follow_the_table_and_the_view() {
    let params = checked(&[]).unwrap().resolve(SPECS, &VIEW);
    assert_eq!(params.text("mode"), "a");
    assert_eq!(params.float("near"), 0.1);
    assert_eq!(params.size("layers"), 8);
    assert!(params.bool("on"));
}

#[test]
fn integers_pass_for_floats_but_not_the_other_way_round() {
    let params = checked(&[("k", Input::Int(3))]).unwrap().resolve(SPECS, &VIEW);
    assert_eq!(params.float("k"), 3.0);
    assert!(message("layers", Input::Float(3.0)).contains("an integer >= 1"));
    assert!(message("layers", Input::Bool(true)).contains("the bool True"));
    assert!(message("k", Input::Bool(true)).contains("\"k\""));
}

#[test]
fn errors_name_technique_key_keys_and_range() {
    let text = message("kk", Input::Int(3));
    assert!(text.contains("demo") && text.contains("\"kk\""), "{text}");
    assert!(text.contains("mode (one of \"a\", \"b\")") && text.contains("layers"), "{text}");
    let text = message("mode", Input::Text("c".into()));
    assert!(text.contains("\"mode\" is \"c\"") && text.contains("one of \"a\", \"b\""), "{text}");
    assert!(message("k", Input::Float(f64::NAN)).contains("> 0"));
    assert!(message("k", Input::Float(0.0)).contains("> 0"));
    assert!(message("layers", Input::Int(0)).contains(">= 1"));
    assert!(message("range", Input::Floats(vec![2.0, 1.0])).contains("z_lo < z_hi"));
    assert!(message("range", Input::Text("world".into())).contains("\"scene\""));
    assert!(message("tau", Input::Floats(vec![0.5, 1.5, 0.0])).contains("[0, 1]"));
    assert!(message("m", Input::Int(5)).contains("one of 4, 6, 8"));
    assert!(message("on", Input::Other("a dict".into())).contains("is a dict"));
}

#[test]
fn inactive_params_leave_the_identity() {
    let one = checked(&[("k", Input::Int(3))]).unwrap().resolve(SPECS, &VIEW);
    let two = checked(&[("k", Input::Int(5))]).unwrap().resolve(SPECS, &VIEW);
    assert_eq!(one.identity(), two.identity());
    assert_eq!(one.inactive().collect::<Vec<_>>(), ["k"]);
    let b = ("mode", Input::Text("b".into()));
    let one = checked(&[b.clone(), ("k", Input::Int(3))]).unwrap().resolve(SPECS, &VIEW);
    let two = checked(&[b, ("k", Input::Int(5))]).unwrap().resolve(SPECS, &VIEW);
    assert_ne!(one.identity(), two.identity());
}

#[test]
fn one_number_serves_for_three_channels() {
    let params = checked(&[("tau", Input::Float(0.5))]).unwrap().resolve(SPECS, &VIEW);
    assert_eq!(params.value("tau"), Value::Rgb([0.5; 3]));
    let params = checked(&[("range", Input::Floats(vec![1.0, 2.0]))]).unwrap();
    assert_eq!(params.resolve(SPECS, &VIEW).value("range"), Value::Pair(1.0, 2.0));
}
