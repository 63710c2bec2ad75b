//! Bins in other storage formats, and rounded list nodes.

use super::{LayeredWboit, Scratch, Sharing, Slicing, locate_all};
use crate::continuum::absorbance::absorbance;
use crate::continuum::bins::{SUPPORT, share_out, shares_of};
use crate::continuum::normalize::Core;
use crate::continuum::oracle::{CHUNK, chunks};
use crate::continuum::stored_sums::{Recipe, StoredSums};
use crate::continuum::sums::{BlendSums, Sums};
use crate::diagnosis::{Diagnosis, Fault, Faults, rounding};
use crate::format::{Format, FormatSet, Formats, SUMMATION, Summation, Target};
use crate::fragments::{List, Lists};
use crate::params::{ParamSpec, Params};
use crate::technique::{Properties, Resolved};
use glam::DVec3;

/// The bins' targets where they are rendered into, else what a list's nodes are made of.
pub(super) static TARGETS: [Target; 4] = [
    Target::ACCUMULATION.when(in_bins),
    Target::REVEALAGE.when(in_bins),
    Target {
        name: "node_color",
        param: "node_color_format",
        doc: "format of a node's colour and alpha (ll)",
        formats: FormatSet::SMALL_SUMS,
        channels: 4,
        double: false,
        active: |params| !in_bins(params),
    },
    Target {
        name: "node_depth",
        param: "node_depth_format",
        doc: "format of a node's depth, a distance (ll)",
        formats: FormatSet::FLOATS,
        channels: 1,
        double: false,
        active: |params| !in_bins(params),
    },
];

fn in_bins(params: &Params) -> bool {
    params.text("storage") == "lr"
}

/// How the bins' sums are kept.
pub(super) const BIN_SUMMATION: ParamSpec = SUMMATION.when(in_bins);

/// How fragments are stored.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Storing {
    /// Sums of bins, and the bytes of one bin.
    recipe: Option<Recipe>,
    pub bin_bytes: f64,
    /// Nodes' colours and depths, and the bytes of a node with the number of the next one.
    node: Option<(Format, Format)>,
    pub node_bytes: f64,
    /// Bytes of the share of all fragments together.
    pub net_bytes: f64,
}

impl Storing {
    /// The default.
    pub const SINGLE: Self =
        Self { recipe: None, bin_bytes: 20.0, node: None, node_bytes: 24.0, net_bytes: 4.0 };

    pub fn from_params(params: &Params) -> Self {
        let formats = Formats::from_params(&TARGETS, params);
        let default = formats.are_default();
        if !in_bins(params) {
            let node = (formats.of("node_color"), formats.of("node_depth"));
            let node_bytes = formats.bytes_per_pixel() + 4.0;
            return Self { node: (!default).then_some(node), node_bytes, ..Self::SINGLE };
        }
        let recipe = Recipe { revealage: formats.of("revealage"), ..Recipe::from_params(&formats, params) };
        Self {
            recipe: (!default || recipe.summation != Summation::Plain).then_some(recipe),
            bin_bytes: recipe.bytes_per_pixel(&formats, formats.bytes_of("accumulation")),
            net_bytes: formats.bytes_of("revealage"),
            ..Self::SINGLE
        }
    }

    /// Whether colours and shares are kept as they are.
    pub fn promises(&self, promises: Properties) -> Properties {
        match (self.recipe, self.node) {
            (Some(recipe), _) => recipe.properties(promises),
            (None, Some(_)) => Properties {
                exact_for_one: false,
                exact_for_one_color: false,
                exact_coverage: false,
                ..promises
            },
            (None, None) => promises,
        }
    }

    /// What can go wrong with bins and nodes.
    pub fn faults(&self) -> Faults {
        let bins = self.recipe.unwrap_or(Recipe::SINGLE).faults();
        let of = |(color, depth): (Format, Format)| {
            let colors = Faults::of_format(color).union(Faults::of_format(color.of_alpha()));
            colors.union(Faults::of_format(depth))
        };
        self.node.map_or(bins, |node| bins.union(of(node)))
    }

    /// What rounding does to nodes.
    fn diagnose_nodes(&self, list: List<'_>, found: &mut Diagnosis) {
        let Some((color, depth)) = self.node else { return };
        for fragment in list.iter() {
            let [r, g, b] = fragment.color.map(f64::from);
            let exact = [r, g, b, f64::from(fragment.alpha)];
            let mut texel = exact;
            color.round_texel(&mut texel);
            let z = f64::from(fragment.depth);
            let numbers = exact.into_iter().zip(texel).enumerate();
            let rounded = numbers.map(|(i, (x, y))| (if i < 3 { color } else { color.of_alpha() }, x, y));
            let rounded = rounded.chain([(depth, z, depth.round(z))]);
            let faults = rounded.map(|(format, exact, stored)| {
                (0..usize::from(!stored.is_finite())).for_each(|_| found.count(Fault::NonFinite));
                rounding(format, exact, stored)
            });
            let faults = faults.fold(Faults::NONE, Faults::union);
            found.count_all(faults);
        }
    }

    /// The list as its nodes hold it; none where they hold it as it is.
    #[expect(clippy::cast_possible_truncation, reason = "nodes are read as f32")]
    pub fn round<'a>(&self, list: List<'_>, nodes: &'a mut Lists) -> Option<List<'a>> {
        let (color, depth) = self.node?;
        nodes.clear();
        for mut fragment in list.iter() {
            let [r, g, b] = fragment.color.map(f64::from);
            let mut texel = [r, g, b, f64::from(fragment.alpha)];
            color.round_texel(&mut texel);
            let [r, g, b, alpha] = color.read_texel(texel).map(|x| x as f32);
            (fragment.color, fragment.alpha) = ([r, g, b], alpha);
            fragment.depth = depth.read(depth.round(fragment.depth.into())) as f32;
            nodes.push(fragment);
        }
        nodes.end_row();
        Some(nodes.as_ref().row(0))
    }
}

/// The bins of a pixel and the weights of its fragments.
#[derive(Debug, Default)]
pub(super) struct StoredBins {
    bins: Vec<StoredSums>,
    /// Which of them hold something, in any order.
    touched: Vec<usize>,
    weights: Vec<f64>,
    /// What goes wrong, where somebody wants to know.
    found: Option<Diagnosis>,
}

impl StoredBins {
    /// Blends a fragment into a bin, of which it covers `coverage` and leaves `transmittance`.
    fn add(&mut self, recipe: Recipe, k: usize, part: &Part, coverage: f64, transmittance: f64) {
        if self.bins[k] == StoredSums::CLEAR {
            self.touched.push(k);
        }
        let (bin, Part { weight, color, alpha }) = (&mut self.bins[k], *part);
        match &mut self.found {
            None => bin.add_share(recipe, weight, color, alpha, coverage, transmittance),
            Some(found) => bin.add_watched(recipe, weight, color, alpha, coverage, transmittance, found),
        }
    }

    /// FEE21 eq. 4, and whether an integer was too small.
    fn under_blend(&mut self, recipe: Recipe) -> (Core, bool) {
        let (mut layers, mut saturated) = (Core::CLEAR, false);
        self.touched.sort_unstable();
        self.touched.dedup();
        for k in self.touched.drain(..) {
            let bin = std::mem::replace(&mut self.bins[k], StoredSums::CLEAR);
            saturated |= bin.saturated;
            layers.put_sums_behind(&match &mut self.found {
                None => bin.read(recipe),
                Some(found) => bin.read_watched(recipe, found),
            });
        }
        (layers, saturated)
    }
}

impl Core {
    fn put_sums_behind(&mut self, sums: &Sums) {
        if sums.alpha > 0.0 {
            let share = self.transmittance * sums.coverage;
            self.color += share * (sums.color / sums.alpha);
            self.coverage += share;
        }
        self.transmittance *= sums.transmittance;
    }
}

/// A fragment on its way into bins.
#[derive(Clone, Copy)]
struct Part {
    weight: f64,
    color: [f32; 3],
    alpha: f32,
}

impl LayeredWboit {
    /// The pixel, if its bins are stored otherwise than by default.
    pub(super) fn resolve_stored(
        &self,
        list: List<'_>,
        background: DVec3,
        depth: &mut Vec<f32>,
        stored: &mut StoredBins,
    ) -> Option<Resolved> {
        let recipe = self.storing.recipe?;
        self.store(recipe, list, depth, stored);
        let (layers, saturated) = stored.under_blend(recipe);
        let net = self.normalize.then(|| net_shares(recipe, list));
        let resolved = match net {
            None => layers.over(background),
            Some(net) => layers.scale_to(&BlendSums::CLEAR, net.coverage, net.transmittance, background),
        };
        Some(Resolved { dropped: saturated.into(), ..resolved })
    }

    /// Blends all fragments into their bins.
    fn store(&self, recipe: Recipe, list: List<'_>, depth: &mut Vec<f32>, stored: &mut StoredBins) {
        let slicing = self.slicing(list);
        let mut weights = std::mem::take(&mut stored.weights);
        recipe.weigh(Some(&self.weighting), self.seen_depths(list, slicing, depth), list.alpha, &mut weights);
        stored.bins.resize(self.bins, StoredSums::CLEAR);
        for (part, weights) in chunks(list).zip(weights.chunks(CHUNK)) {
            self.store_chunk(recipe, stored, slicing, part, weights);
        }
        stored.weights = weights;
    }

    /// What goes wrong in the nodes, in each bin, and in the share of all fragments together.
    pub(super) fn diagnose_stored(&self, list: List<'_>, scratch: &mut Scratch) -> Diagnosis {
        let Scratch { shaped_depth, stored, nodes, .. } = scratch;
        let mut found = Diagnosis::CLEAR;
        self.storing.diagnose_nodes(list, &mut found);
        let list = self.storing.round(list, nodes).unwrap_or(list);
        let recipe = self.storing.recipe.unwrap_or(Recipe::SINGLE);
        stored.found = Some(found);
        self.store(recipe, list, shaped_depth, stored);
        stored.under_blend(recipe);
        let mut found = stored.found.take().unwrap_or_default();
        if self.normalize {
            let mut net = StoredSums::CLEAR;
            for &alpha in list.alpha {
                let coverage = f64::from(alpha);
                net.add_watched(recipe, recipe.one(), [0.0; 3], alpha, coverage, 1.0 - coverage, &mut found);
            }
        }
        found
    }

    fn store_chunk(
        &self,
        recipe: Recipe,
        stored: &mut StoredBins,
        slicing: Slicing,
        part: List<'_>,
        weights: &[f64],
    ) {
        let (mut own, mut xs) = ([0; CHUNK], [0.0; CHUNK]);
        locate_all(self.bins, slicing, part.depth, &mut own, &mut xs);
        let mut shares = [[0.0; CHUNK]; SUPPORT];
        match &self.sharing {
            Sharing::Naive => {}
            Sharing::Coverage(function) | Sharing::Absorbance(function, _) => {
                share_out(function, &xs[..part.len()], &mut shares);
            }
        }
        for (i, &weight) in weights.iter().enumerate() {
            let fragment = Part { weight, color: part.color[i], alpha: part.alpha[i] };
            match &self.sharing {
                Sharing::Naive => {
                    let coverage = f64::from(fragment.alpha);
                    stored.add(recipe, own[i], &fragment, coverage, 1.0 - coverage);
                }
                Sharing::Coverage(_) => {
                    self.fade(recipe, stored, own[i], shares_of(&shares, i), &fragment);
                }
                Sharing::Absorbance(_, s_max) => {
                    self.divide_stored(recipe, stored, own[i], shares_of(&shares, i), *s_max, &fragment);
                }
            }
        }
    }

    /// Each bin in reach gets the fragment with its alpha faded.
    fn fade(&self, recipe: Recipe, stored: &mut StoredBins, own: usize, shares: [f32; SUPPORT], part: &Part) {
        for (k, b) in self.reach(own, shares) {
            let share = f64::from(b);
            let coverage = f64::from(part.alpha) * share;
            let part = Part { weight: recipe.times(part.weight, share), ..*part };
            stored.add(recipe, k, &part, coverage, 1.0 - coverage);
        }
    }

    /// Each bin in reach gets a share of the fragment's absorbance.
    fn divide_stored(
        &self,
        recipe: Recipe,
        stored: &mut StoredBins,
        own: usize,
        shares: [f32; SUPPORT],
        s_max: f64,
        part: &Part,
    ) {
        let total: f64 = self.reach(own, shares).map(|(_, b)| f64::from(b)).sum();
        let (s, alpha) = (absorbance(part.alpha, s_max), f64::from(part.alpha));
        for (k, b) in self.reach(own, shares) {
            let beta = f64::from(b) / total;
            let absorbed = (-beta * s).exp_m1();
            let share = if alpha > 0.0 { -absorbed / alpha } else { beta };
            let part = Part { weight: recipe.times(part.weight, share), ..*part };
            stored.add(recipe, k, &part, -absorbed, 1.0 + absorbed);
        }
    }
}

/// The share of all fragments together, in its own target.
fn net_shares(recipe: Recipe, list: List<'_>) -> Sums {
    let mut net = StoredSums::CLEAR;
    list.alpha.iter().for_each(|&alpha| net.add(recipe, recipe.one(), [0.0; 3], alpha));
    net.read(recipe)
}

#[cfg(test)]
mod tests;
