//! Rounding of depths and nodes, and what is left of promises.

use super::*;
use crate::format::target::param_specs;
use crate::params::Input;
use crate::params::check;
use crate::techniques::testing::VIEW;

fn nodes(given: &[(&str, &str)]) -> Nodes {
    let table: Vec<_> = param_specs(&LAYERS).collect();
    let owned = |(name, value): &(&str, &str)| ((*name).to_owned(), Input::Text((*value).to_owned()));
    let checked = check("demo", &table, &given.iter().map(owned).collect::<Vec<_>>()).unwrap();
    Nodes::from_params(&LAYERS, &checked.resolve(&table, &VIEW), &VIEW)
}

#[test]
fn shares_go_where_the_layout_has_room() {
    let of = |color, depth| nodes(&[("node_color_format", color), ("node_depth_format", depth)]);
    let layout = |color, depth| {
        let nodes = of(color, depth);
        (nodes.share, nodes.bytes)
    };
    assert_eq!(layout("f32", "f32"), (Format::F64, 20.0));
    assert_eq!(layout("unorm8", "f32"), (Format::Unorm8, 8.0));
    assert_eq!(layout("f16", "f32"), (Format::F16, 12.0));
    assert_eq!(layout("rgb9e5", "f32"), (Format::F16, 10.0));
    assert_eq!(layout("rgb9e5", "d24"), (Format::Unorm8, 8.0));
    assert_eq!(layout("r11g11b10f", "d24"), (Format::Unorm8, 8.0));
    assert_eq!(layout("unorm8", "d24"), (Format::Unorm8, 7.0));
    assert_eq!(layout("srgb8", "f16"), (Format::Unorm8, 6.0));
    let samples = of("rgb9e5", "f32").without_shares();
    assert_eq!((samples.share, samples.bytes), (Format::F64, 8.0));
}

#[test]
fn nodes_round_once() {
    let bytes = nodes(&[("node_color_format", "unorm8")]);
    let step = |k: f64| DVec3::splat(k / 255.0);
    assert_eq!(bytes.keep(DVec3::new(0.5, 7.0, -1.0)), DVec3::new(128.0 / 255.0, 1.0, 0.0));
    // 10 + 128/255 · 100 = 60.196 steps
    assert_eq!(bytes.put_over(step(10.0), 128.0 / 255.0, step(100.0)), step(60.0));
    // 10 + 101 · 0.5 = 60.5 steps, to even
    assert_eq!(bytes.put_under(step(10.0), 101.0 / 255.0, DVec3::splat(0.5)), step(60.0));
    assert_eq!(bytes.multiply(254.0 / 255.0, 254.0 / 255.0), 253.0 / 255.0);
    assert_eq!(bytes.cover(254.0 / 255.0, 0.5), 127.0 / 255.0);
    let half = nodes(&[("node_color_format", "f16")]);
    assert_eq!(half.keep(DVec3::splat(1e6)), DVec3::splat(65_504.0));
    let shared = nodes(&[("node_color_format", "rgb9e5")]);
    assert_eq!(shared.keep(DVec3::new(256.0, 0.3, 0.6)), DVec3::new(256.0, 0.0, 1.0));
}

#[test]
fn promises_need_what_they_are_about() {
    let promises = |given: &[(&str, &str)]| nodes(given).promises(Properties::EXACT);
    assert_eq!(promises(&[]), Properties::EXACT);
    assert_eq!(promises(&[("format", "f64")]), Properties::EXACT);
    let order = Properties { order_independent: true, ..Properties::NONE };
    assert_eq!(promises(&[("node_color_format", "f16")]), order);
    let unordered = Properties { unbiased: false, consistent: false, ..Properties::EXACT };
    assert_eq!(promises(&[("node_depth_format", "d24")]), unordered);
}

#[test]
fn stored_depths_ascend() {
    for format in FormatSet::DEPTHS.iter() {
        let depths = Depths::new(format, &VIEW);
        let mut last = 0.0;
        for i in 0..20_000_u16 {
            let depth = f32::from(i) * f32::from(i) * 1e-6;
            let placed = depths.place(depth);
            assert!(placed >= last && placed.is_finite(), "{format:?} {depth}");
            last = placed;
        }
        assert!(depths.place(1e30).is_finite());
        assert_eq!(
            depths.are_exact(),
            depths.place(4.001) == 4.001 && depths.place(1e30) == 1e30,
            "{format:?}"
        );
    }
}
