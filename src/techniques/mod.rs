//! The registry: one line to name a technique's file, one to list it. Nothing else knows their number.

use crate::error::{Error, Result};
use crate::order::SUBMISSION_ORDERS;
use crate::params::{Kind, ParamSpec, Value};
use crate::technique::Info;

pub mod a_buffer;

/// Every technique, simplest references first.
pub static REGISTRY: &[&Info] = &[&a_buffer::INFO];

/// The technique of that id or alias.
///
/// # Errors
/// [`Error::UnknownTechnique`] with the list of ids.
pub fn find(id: &str) -> Result<&'static Info> {
    let named = |info: &&&Info| info.id == id || info.aliases.contains(&id);
    REGISTRY.iter().find(named).copied().ok_or_else(|| Error::UnknownTechnique {
        id: id.to_owned(),
        known: REGISTRY.iter().map(|info| info.id).collect::<Vec<_>>().join(", "),
    })
}

impl Info {
    /// The technique's own params and the two that every technique takes.
    pub fn param_table(&self) -> Vec<ParamSpec> {
        let order = ParamSpec::new(
            "submission_order",
            Kind::Choice(self.submission_orders),
            Value::Text(self.submission_orders[0]),
            "order in which the fragments are handed over (sheet 0.4)",
        );
        let seed = ParamSpec::new(
            "seed",
            Kind::at_least(0),
            Value::Int(0),
            "picks the shuffle and every random draw",
        );
        let seed = if self.random { seed } else { seed.when(|p| p.text("submission_order") == "shuffled") };
        self.params.iter().copied().chain([order, seed]).collect()
    }
}

/// The submission orders of a technique that takes any.
pub const ANY_ORDER: &[&str] = SUBMISSION_ORDERS;

#[cfg(test)]
pub(crate) mod testing {
    //! Hand-made pixels for the techniques' unit tests.

    use crate::fragments::{Fragment, Lists};
    use crate::order::{Reorderer, SubmissionOrder};
    use crate::params::{Input, View, check};
    use crate::technique::{Batch, Resolved};
    use glam::DVec3;

    /// Planes and depth range of the test pixels.
    pub const VIEW: View = View { near: 0.1, far: 100.0, depth_range: (1.0, 9.0) };
    /// The colour behind the test pixels.
    pub const BACKGROUND: [f32; 3] = [0.25, 0.5, 0.75];

    /// A fragment of unmultiplied colour `rgb`.
    pub fn fragment(depth: f32, rgb: [f32; 3], alpha: f32, primitive: u32) -> Fragment {
        Fragment { depth, color: rgb.map(|c| c * alpha), alpha, primitive }
    }

    /// Three layers of different colour and coverage, out of order.
    pub fn three_layers() -> Vec<Fragment> {
        vec![
            fragment(4.0, [0.1, 0.9, 0.2], 0.5, 0),
            fragment(2.0, [1.0, 0.3, 0.1], 0.25, 1),
            fragment(8.0, [0.2, 0.1, 1.0], 0.75, 2),
        ]
    }

    /// The pixel as technique `id` with `params` resolves it.
    pub fn resolve(id: &str, params: &[(&str, Input)], fragments: &[Fragment]) -> Resolved {
        let info = super::find(id).unwrap();
        let inputs: Vec<_> = params.iter().map(|(n, v)| ((*n).to_owned(), v.clone())).collect();
        let table = info.param_table();
        let params = check(info.id, &table, &inputs).unwrap().resolve(&table, &VIEW);
        let technique = (info.build)(&params, &VIEW).unwrap();
        let (mut lists, mut sorted) = (Lists::new(), Lists::new());
        fragments.iter().for_each(|f| lists.push(*f));
        lists.end_row();
        Reorderer::default().reorder(lists.as_ref(), SubmissionOrder::Sorted, None, &mut sorted);
        let batch = Batch {
            x: 0,
            y: 0,
            width: 1,
            lists: lists.as_ref(),
            sorted: Some(sorted.as_ref()),
            background: &[BACKGROUND],
        };
        let mut out = [Resolved::default()];
        technique.resolve_batch(&batch, &[0], &mut out, &|| false);
        out[0]
    }

    /// Sorted OVER by its definition (sheet 0.1), for comparison.
    pub fn over(fragments: &[Fragment]) -> (DVec3, f64) {
        let mut sorted = fragments.to_vec();
        sorted.sort_by(|a, b| a.depth.total_cmp(&b.depth).then(a.primitive.cmp(&b.primitive)));
        let (mut color, mut transmittance) = (DVec3::ZERO, 1.0);
        for f in sorted {
            color += transmittance * DVec3::from(f.color.map(f64::from));
            transmittance *= 1.0 - f64::from(f.alpha);
        }
        (color + transmittance * DVec3::from(BACKGROUND.map(f64::from)), transmittance)
    }

    /// Asserts that every channel of colour and transmittance agrees within `tolerance`.
    #[track_caller]
    pub fn assert_close(got: Resolved, color: DVec3, transmittance: f64, tolerance: f64) {
        let far = (got.color - color)
            .abs()
            .max_element()
            .max((got.transmittance - DVec3::splat(transmittance)).abs().max_element());
        assert!(far <= tolerance, "{got:?} is {far:e} away from {color:?}, {transmittance}");
    }
}
