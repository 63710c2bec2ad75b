//! Forms make valid shaders, and refuse what has none by name.

use super::*;
use crate::params::{Input, check};
use crate::technique::Info;
use crate::techniques::REGISTRY;
use naga::valid::{Capabilities, ValidationFlags, Validator};

fn validated(name: &str, source: &str) -> naga::Module {
    let module = naga::front::wgsl::parse_str(source)
        .unwrap_or_else(|error| panic!("{name}: {}", error.emit_to_string(source)));
    let validated = Validator::new(ValidationFlags::all(), Capabilities::empty()).validate(&module);
    validated.unwrap_or_else(|error| panic!("{name}: {}", error.emit_to_string(source)));
    module
}

fn form(info: &Info, given: &[(&str, &str)]) -> Result<Form> {
    let table = info.param_table();
    let owned = |(name, value): &(&str, &str)| ((*name).to_owned(), Input::Text((*value).to_owned()));
    let checked = check(info.id, &table, &given.iter().map(owned).collect::<Vec<_>>())?;
    let make = info.gpu.unwrap_or_else(|| panic!("{} has no form", info.id));
    make(&checked.resolve(&table, &View::ORDINARY), &View::ORDINARY)
}

/// The bytes of the uniform block `Params`, and of all entry points the names.
fn interface(module: &naga::Module) -> (Option<u32>, Vec<&str>) {
    let uniform = module.global_variables.iter().find(|(_, v)| v.name.as_deref() == Some("params"));
    let size = uniform.map(|(_, v)| module.types[v.ty].inner.size(module.to_ctx()));
    (size, module.entry_points.iter().map(|e| e.name.as_str()).collect())
}

#[test]
fn every_form_is_a_valid_shader_with_the_entry_points_and_params_it_names() {
    let forms: Vec<_> = REGISTRY.iter().filter(|info| info.gpu.is_some()).collect();
    assert!(forms.len() >= 8, "{}", forms.len());
    let others = [("lwboit", ("storage", "ll")), ("tfm", ("project", "transmittance"))];
    let others = others.map(|(id, given)| (crate::techniques::find(id).unwrap(), vec![given]));
    for (info, given) in forms.into_iter().map(|info| (*info, vec![])).chain(others) {
        let form = form(info, &given).unwrap();
        let module = validated(info.id, &form.module());
        let (size, names) = interface(&module);
        let needed = match &form.path {
            Path::Blended(blending) => {
                let draws = blending.draws.iter().map(|draw| draw.shader);
                ["place", "cover_all", blending.resolve].into_iter().chain(draws).collect()
            }
            Path::Listed(listing) => vec!["place", "count_fragment", "sort_lists", listing.resolve],
            Path::Streamed(_) => vec!["place", "count_fragment", "sort_lists", "resolve_stream"],
            Path::Sampled(sampling) => {
                vec!["place_around", "cover_all", sampling.cover, sampling.look, sampling.resolve]
            }
            Path::Peeled(peeling) => {
                vec!["place", "cover_all", peeling.peel, peeling.composite, peeling.resolve]
            }
        };
        if let Path::Blended(blending) = &form.path {
            assert!(blending.draws.iter().all(|draw| draw.targets.end <= blending.targets.len()));
        }
        assert!(needed.iter().all(|name| names.contains(name)), "{}: {names:?}", info.id);
        let bytes = u32::try_from(4 * form.numbers.len()).unwrap();
        // a block may end in padding
        assert_eq!(size.unwrap_or(0).next_multiple_of(16), bytes.next_multiple_of(16), "{}", info.id);
    }
}

#[test]
fn every_memory_of_the_continuum_has_its_entry_point() {
    let continuum = crate::techniques::find("continuum").unwrap();
    let memories: [&[_]; 5] = [
        &[("memory", "none"), ("insertion", "never"), ("merge", "none")],
        &[("merge", "smallest_error"), ("accumulate", "all")],
        &[("memory", "unbounded"), ("merge", "none")],
        &[("memory", "samples"), ("merge", "discard_occluded"), ("opacity", "coverage")],
        &[("memory", "bins"), ("merge", "sum"), ("accumulate", "all")],
    ];
    for given in memories {
        let form = form(continuum, given).unwrap();
        let resolve = if let Path::Listed(listing) = &form.path { listing.resolve } else { "resolve_stream" };
        let module = validated("continuum", &form.module());
        let (size, names) = interface(&module);
        assert!(names.contains(&resolve), "{names:?}");
        let bytes = u32::try_from(4 * form.numbers.len()).unwrap();
        assert_eq!(size.unwrap().next_multiple_of(16), bytes.next_multiple_of(16), "{given:?}");
    }
    let slab = form(crate::techniques::find("slab").unwrap(), &[("replay", "as_is")]).unwrap();
    assert_eq!(slab.shader, form(continuum, &[]).unwrap().shader);
    assert_eq!(slab.numbers.len(), form(continuum, &[]).unwrap().numbers.len());
}

#[test]
fn sums_of_splats_are_blended_unless_sigma_is_a_pixels_own() {
    let splats = crate::techniques::find("gs_wsr").unwrap();
    for (variant, resolve) in [("direct", "resolve"), ("exp", "resolve"), ("linear", "resolve_stream")] {
        let form = form(splats, &[("variant", variant)]).unwrap();
        let chosen = match &form.path {
            Path::Blended(blending) => blending.resolve,
            Path::Streamed(_) => "resolve_stream",
            other => panic!("{other:?}"),
        };
        assert_eq!(chosen, resolve);
        assert!(interface(&validated("gs_wsr", &form.module())).1.contains(&resolve));
    }
}

#[test]
fn masks_of_samples_are_a_form_of_what_has_masks() {
    let by_samples = |id| form(crate::techniques::find(id).unwrap(), &[]).unwrap().by_samples();
    let form = by_samples("stochastic_transparency").unwrap();
    let Path::Sampled(sampling) = &form.path else { panic!("{form:?}") };
    let module = validated("samples", &form.module());
    let (size, names) = interface(&module);
    for name in ["place_around", "cover_all", sampling.cover, sampling.look, sampling.resolve] {
        assert!(names.contains(&name), "{names:?}");
    }
    let bytes = u32::try_from(4 * form.numbers.len()).unwrap();
    assert_eq!(size.unwrap().next_multiple_of(16), bytes.next_multiple_of(16));
    assert!(by_samples("wboit").unwrap_err().to_string().contains("no masks of samples"));
}

#[test]
fn what_is_made_of_lists_may_have_linked_ones() {
    let is_listed = |id, given: &[(&str, &str)]| {
        form(crate::techniques::find(id).unwrap(), given).unwrap().check_lists().is_ok()
    };
    assert!(is_listed("a_buffer", &[]) && is_listed("deep_shadow_maps", &[]));
    assert!(is_listed("lwboit", &[("storage", "ll")]) && !is_listed("lwboit", &[("storage", "lr")]));
    assert!(!is_listed("wboit", &[]));
}

#[test]
fn shared_modules_are_valid() {
    let lists = list_module();
    let names = interface(&validated("lists", &lists)).1.join(" ");
    for name in ["place", "count_fragment", "store_fragment", "sum_rows", "shift_rows", "sort_lists"] {
        assert!(names.contains(name), "{names}");
    }
    validated("background", &background_module());
    validated("copy", &copy_module());
    let names = |module: String| interface(&validated("linked lists", &module)).1.join(" ");
    assert!(names(link_module()).contains("link_fragment"));
    assert!(names(unlink_module()).contains("count_nodes unlink"));
}

#[test]
fn every_technique_has_a_raster_in_compute() {
    let bins = tiled::bins_module();
    let names = interface(&validated("bins", &bins)).1.join(" ");
    assert_eq!(names, "place place_around count_bins place_bins fill_bins fill_tiles");
    let lists = ("tfm", vec![("project", "transmittance")]);
    let memory = ("continuum", vec![("memory", "unbounded"), ("merge", "none")]);
    let others = [lists, memory].map(|(id, given)| (crate::techniques::find(id).unwrap(), given));
    let with_form = REGISTRY.iter().filter(|info| info.gpu.is_some()).map(|info| (*info, vec![]));
    for (info, given) in with_form.chain(others) {
        let module = form(info, &given).unwrap().tiled_module().unwrap();
        let module = validated(info.id, &module);
        let names = interface(&module).1;
        assert!(names.contains(&"draw_tiles"), "{}: {names:?}", info.id);
    }
}

#[test]
fn every_layout_of_wboit_has_its_entry_points() {
    let wboit = crate::techniques::find("wboit").unwrap();
    for layout in ["listing3", "listing4", "monochrome"] {
        let form = form(wboit, &[("layout", layout)]).unwrap();
        let Path::Blended(blending) = &form.path else { panic!("{form:?}") };
        let module = validated(layout, &form.module());
        let names = interface(&module).1;
        assert!(names.contains(&blending.draws[0].shader), "{names:?}");
        assert!(names.contains(&blending.resolve), "{names:?}");
    }
}

#[test]
fn wboit_only_weighs_depths_by_weights_that_forgive_a_unit() {
    let wboit = crate::techniques::find("wboit").unwrap();
    let near = |given: &[(&str, &str)]| {
        let form = form(wboit, given).unwrap();
        let Path::Blended(blending) = form.path else { panic!("{form:?}") };
        blending.near_depths
    };
    assert!(near(&[]) && near(&[("weight", "mb10")]));
    assert!(
        !near(&[("weight", "exp")]) && !near(&[("weight", "a / z")]),
        "no exponentials and none of one's own"
    );
}

#[test]
fn every_mode_makes_a_valid_shader() {
    let modes = [
        ("mlab_buckets", ("mode", "depth")),
        ("mlab_buckets", ("mode", "transmittance")),
        ("mlcb", ("store", "hybrid")),
    ];
    for (id, mode) in modes {
        let form = form(crate::techniques::find(id).unwrap(), &[mode]).unwrap();
        assert!(interface(&validated(mode.1, &form.module())).1.contains(&"resolve_stream"));
        validated(mode.1, &form.tiled_module().unwrap());
    }
}

#[test]
fn thresholds_decide_as_doubles_do() {
    let float = |number| match number {
        Number::Float(x) => x,
        Number::Whole(_) => panic!("{number:?}"),
    };
    for (x, alpha) in [(0.2, 0.2_f32), (0.9, 0.9), (0.5, 0.5), (-1.0, 0.0), (1e300, 1.0), (-1e300, 0.0)] {
        let (below, above) = (float(Number::below(x)), float(Number::above(x)));
        assert_eq!((alpha > below, alpha >= above), (f64::from(alpha) > x, f64::from(alpha) >= x), "{x}");
        assert!(below.is_finite() && above.is_finite());
    }
    let [a, b] = Number::in_two(0.1).map(float);
    assert!((f64::from(a) + f64::from(b) - 0.1).abs() < 1e-16);
}

#[test]
fn what_no_device_does_is_refused_by_name() {
    let refused = |id: &str, given: &[(&str, &str)]| {
        form(crate::techniques::find(id).unwrap(), given).unwrap_err().to_string()
    };
    let message = refused("wboit", &[("summation", "fixed")]);
    assert!(message.contains("wboit: summation=\"fixed\"") && message.contains("is \"plain\""), "{message}");
    let message = refused("blended_oit", &[("accumulation_format", "bf16")]);
    assert!(message.contains("accumulation_format=\"bf16\"") && message.contains("\"f16\""), "{message}");
    let message = refused("blended_oit", &[("accumulation_format", "f64")]);
    assert!(message.contains("accumulation_format=\"f64\""), "{message}");
    let message = refused("wboit", &[("format", "f16"), ("revealage_format", "f64")]);
    assert!(message.contains("revealage_format=\"f64\""), "{message}");
    assert!(refused("a_buffer", &[("format", "f16")]).contains("node_color_format=\"f16\""));
}
