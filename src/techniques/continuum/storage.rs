//! How a composition stores its nodes and sums.

use crate::continuum::nodes::{Nodes, sums};
use crate::continuum::stored_sums::Recipe;
use crate::format::{Formats, Target};
use crate::params::{Params, View};

/// What there is to store, by memory and accumulation.
pub static TARGETS: [Target; 5] = [
    Target::NODE_COLOR.when(|p| keeps_nodes(p) && p.text("accumulate") == "stored"),
    Target::NODE_SHARE.when(|p| {
        keeps_nodes(p)
            && p.text("accumulate") == "all"
            && p.text("opacity") == "alpha"
            && p.text("memory") != "samples"
    }),
    Target::NODE_DEPTH.when(keeps_nodes),
    Target::ACCUMULATION.when(sums_colors),
    Target::REVEALAGE.when(|p| p.text("accumulate") == "all" || p.text("normalize") != "none"),
];

/// Whether fragments stay apart.
fn keeps_nodes(params: &Params) -> bool {
    match params.text("memory") {
        "none" => false,
        "bins" => params.text("merge") == "discard_occupied",
        _ => true,
    }
}

fn sums_colors(params: &Params) -> bool {
    let tail = params.text("normalize") != "none" && params.text("memory") != "samples";
    params.text("memory") == "none" || params.text("accumulate") == "all" || tail
}

/// Nodes, sums and their bytes.
#[derive(Debug, Clone, Copy)]
pub struct Storage {
    pub nodes: Nodes,
    pub recipe: Recipe,
    pub sums: f64,
}

impl Storage {
    /// As the params say.
    pub fn from_params(params: &Params, view: &View) -> Self {
        let formats = Formats::from_params(&TARGETS, params);
        let nodes = Nodes::new(&formats, view);
        Self {
            nodes: if params.text("opacity") == "coverage" { nodes.without_shares() } else { nodes },
            recipe: sums(&formats),
            sums: formats.bytes_of("accumulation") + formats.bytes_of("revealage"),
        }
    }

    /// Bytes of an averaged bin.
    pub const BIN: f64 = 20.0;

    /// Whether nobody has asked for other formats.
    pub fn is_default(&self) -> bool {
        self.nodes.are_default
    }
}
