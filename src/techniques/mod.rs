//! The registry: one line to name a technique's file, one to list it. Nothing else knows their number.

use crate::error::{Error, Result};
use crate::format::target::param_specs;
use crate::order::SUBMISSION_ORDERS;
use crate::params::{Kind, ParamSpec, Value, View, check};
use crate::technique::{AnyTechnique, Info};

pub mod a_buffer;
pub mod adaptive_transparency;
pub mod alpha_compositing;
pub mod alpha_testing;
pub mod avsm;
pub mod blended_oit;
pub mod continuum;
pub mod deep_opacity_maps;
pub mod deep_shadow_maps;
pub mod density_clustering;
pub mod depth_peeling;
pub mod dual_depth_peeling;
pub mod fourier_opacity_maps;
pub mod gs_wsr;
pub mod hybrid_transparency;
pub mod k_buffer;
pub mod lwboit;
pub mod mboit_power;
pub mod mboit_trig;
pub mod mlab;
pub mod mlab_buckets;
pub mod mlcb;
pub mod multilayer_depth_peeling;
pub mod occupancy_maps;
pub mod opacity_shadow_maps;
pub mod painter;
pub mod phenomenological;
pub mod screen_door;
pub mod slab;
pub mod stochastic_transparency;
pub mod tfm;
pub mod wavelet;
pub mod wboit;
pub mod weighted_average;
pub mod weighted_sum;
pub mod z3;

/// Every technique, simplest references first.
pub static REGISTRY: &[&Info] = &[
    &a_buffer::INFO,
    &alpha_testing::INFO,
    &alpha_compositing::INFO,
    &painter::INFO,
    &screen_door::INFO,
    &z3::INFO,
    &deep_shadow_maps::INFO,
    &depth_peeling::INFO,
    &dual_depth_peeling::INFO,
    &opacity_shadow_maps::INFO,
    &density_clustering::INFO,
    &k_buffer::INFO,
    &weighted_sum::INFO,
    &deep_opacity_maps::INFO,
    &multilayer_depth_peeling::INFO,
    &occupancy_maps::INFO,
    &stochastic_transparency::INFO,
    &fourier_opacity_maps::INFO,
    &avsm::INFO,
    &tfm::INFO,
    &adaptive_transparency::INFO,
    &hybrid_transparency::INFO,
    &weighted_average::INFO,
    &blended_oit::INFO,
    &wboit::INFO,
    &mlab::INFO,
    &mlab_buckets::INFO,
    &phenomenological::INFO,
    &slab::INFO,
    &mlcb::INFO,
    &lwboit::INFO,
    &wavelet::INFO,
    &mboit_power::INFO,
    &mboit_trig::INFO,
    &gs_wsr::INFO,
    &continuum::INFO,
];

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
    /// The technique's own params, those of its storage formats, and the two that every technique takes.
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
        let (late, own): (Vec<_>, Vec<_>) = self.params.iter().partition(|spec| spec.after_formats);
        own.into_iter().chain(param_specs(self.targets)).chain(late).chain([order, seed]).collect()
    }
}

impl Info {
    /// The technique with its default params, on an ordinary view.
    ///
    /// # Panics
    /// If the technique refuses its own defaults, which is a bug that the tests would find.
    pub fn with_defaults(&self) -> Box<dyn AnyTechnique> {
        let table = self.param_table();
        let params = check(self.id, &table, &[]).map(|checked| checked.resolve(&table, &View::ORDINARY));
        let technique = params.and_then(|params| (self.build)(&params, &View::ORDINARY));
        technique.unwrap_or_else(|error| panic!("the defaults of {} are refused: {error}", self.id))
    }
}

/// The submission orders of a technique that takes any.
pub const ANY_ORDER: &[&str] = SUBMISSION_ORDERS;

#[cfg(test)]
mod identities;
#[cfg(test)]
pub(crate) mod statistics;
#[cfg(test)]
pub(crate) mod testing;
