//! Techniques written down again from the sheet, as plainly as possible, with numbers rounded by definition.

use super::text;
use crate::format::Format;
use crate::fragments::Fragment;
use crate::params::Input;
use crate::techniques::testing::{BACKGROUND, VIEW};
use glam::DVec3;
use half::f16;

/// A format by its definition.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Rounding {
    F64,
    F32,
    F16,
    Unorm8,
}

impl Rounding {
    pub const ALL: [Self; 4] = [Self::F64, Self::F32, Self::F16, Self::Unorm8];

    pub fn input(self, name: &'static str) -> (&'static str, Input) {
        text(name, ["f64", "f32", "f16", "unorm8"][self as usize])
    }
    #[expect(clippy::cast_possible_truncation, reason = "that is what it is for")]
    pub fn round(self, x: f64) -> f64 {
        match self {
            Self::F64 => x,
            Self::F32 => f64::from(x as f32),
            Self::F16 => f16::from_f64(x).to_f64(),
            Self::Unorm8 => (x.clamp(0.0, 1.0) * 255.0).round_ties_even() / 255.0,
        }
    }
    /// Shares beside a colour in f32 are kept in f64.
    pub fn round_share(self, x: f64) -> f64 {
        if self == Self::F32 { x } else { self.round(x) }
    }
    /// The models round through f64.
    pub fn tolerance(self) -> f64 {
        if self == Self::F32 { 1e-6 } else { 1e-12 }
    }
    fn round_color(self, color: DVec3) -> DVec3 {
        DVec3::from(color.to_array().map(|x| self.round(x)))
    }
    /// The fragment with its unmultiplied colour rounded.
    #[expect(clippy::cast_possible_truncation, reason = "fragments are f32")]
    pub fn unmultiplied(self, f: &Fragment) -> Fragment {
        let keep = |c: f32| self.round(f64::from(c) / f64::from(f.alpha)) * f64::from(f.alpha);
        let color = if f.alpha > 0.0 { f.color.map(|c| keep(c) as f32) } else { f.color };
        Fragment { color, ..*f }
    }
    /// Rounded premultiplied colour and alpha, depth and primitive.
    pub fn premultiplied(self, f: &Fragment) -> Layer {
        let coverage = self.round_share(f.alpha.into());
        Layer { key: (f.depth, f.primitive), color: self.round_color(color(f)), shown: 1.0 - coverage }
    }
    /// A node: rounded colour and transmittance.
    fn node(self, f: &Fragment) -> Layer {
        let shown = self.round_share(1.0 - f64::from(f.alpha));
        Layer { key: (f.depth, f.primitive), color: self.round_color(color(f)), shown }
    }
    fn merged(self, front: Layer, behind: Layer) -> Layer {
        Layer {
            key: front.key,
            color: self.round_color(front.color + front.shown * behind.color),
            shown: self.round_share(front.shown * behind.shown),
        }
    }
}

fn color(f: &Fragment) -> DVec3 {
    DVec3::from(f.color.map(f64::from))
}

#[derive(Debug, Clone, Copy)]
pub struct Layer {
    key: (f32, u32),
    color: DVec3,
    shown: f64,
}

/// What a technique of k layers makes of a pixel: colour and transmittance.
pub type Model = fn(&[Fragment], usize, Rounding) -> (DVec3, f64);

/// Layers over the background, nearest first.
fn composite(layers: &[Layer]) -> (DVec3, f64) {
    let (mut all, mut shown) = (DVec3::ZERO, 1.0);
    for layer in layers {
        all += shown * layer.color;
        shown *= layer.shown;
    }
    (all + shown * DVec3::from(BACKGROUND.map(f64::from)), shown)
}

/// Layers in any order over the background.
pub fn over(layers: &[Layer]) -> (DVec3, f64) {
    composite(&sorted(layers.to_vec()))
}

fn sorted(mut layers: Vec<Layer>) -> Vec<Layer> {
    layers.sort_by(|a, b| a.key.0.total_cmp(&b.key.0).then(a.key.1.cmp(&b.key.1)));
    layers
}

/// A list that makes room when it holds more than `size` nodes.
fn list(
    pixel: &[Fragment],
    start: Vec<Layer>,
    size: usize,
    rounding: Rounding,
    make_room: impl Fn(&mut Vec<Layer>),
) -> (DVec3, f64) {
    let mut nodes = start;
    for f in pixel.iter().filter(|f| !f.is_zero()) {
        nodes.push(rounding.node(f));
        nodes = sorted(nodes);
        if nodes.len() > size {
            make_room(&mut nodes);
        }
    }
    composite(&nodes)
}

fn merge(nodes: &mut Vec<Layer>, j: usize, rounding: Rounding) {
    let behind = nodes.remove(j + 1);
    nodes[j] = rounding.merged(nodes[j], behind);
}

pub fn mlab(pixel: &[Fragment], k: usize, rounding: Rounding) -> (DVec3, f64) {
    list(pixel, vec![], k, rounding, |nodes| merge(nodes, nodes.len() - 2, rounding))
}

pub fn k_buffer(pixel: &[Fragment], k: usize, rounding: Rounding) -> (DVec3, f64) {
    let front = Layer { key: (-1.0, 0), color: DVec3::ZERO, shown: 1.0 };
    list(pixel, vec![front], k + 1, rounding, |nodes| merge(nodes, 0, rounding))
}

pub fn z3(pixel: &[Fragment], k: usize, rounding: Rounding) -> (DVec3, f64) {
    list(pixel, vec![], k, rounding, |nodes| {
        let gap = |j: usize| f64::from(nodes[j + 1].key.0) - f64::from(nodes[j].key.0);
        let closest = (0..nodes.len() - 1).min_by(|&i, &j| gap(i).total_cmp(&gap(j)));
        merge(nodes, closest.unwrap(), rounding);
    })
}

pub fn nearest(pixel: &[Fragment], k: usize, rounding: Rounding) -> (DVec3, f64) {
    list(pixel, vec![], k, rounding, |nodes| nodes.truncate(k))
}

fn front_to_back(pixel: &[Fragment]) -> Vec<Fragment> {
    let mut sorted: Vec<_> = pixel.iter().filter(|f| !f.is_zero()).copied().collect();
    sorted.sort_by(|a, b| a.depth.total_cmp(&b.depth).then(a.primitive.cmp(&b.primitive)));
    sorted
}

pub fn depth_peeling(pixel: &[Fragment], rounding: Rounding) -> (DVec3, f64) {
    let (mut all, mut shown) = (DVec3::ZERO, 1.0);
    for f in front_to_back(pixel) {
        all = rounding.round_color(all + shown * color(&f));
        shown = rounding.round_share(shown * (1.0 - f64::from(f.alpha)));
    }
    (all + shown * DVec3::from(BACKGROUND.map(f64::from)), shown)
}

pub fn dual_depth_peeling(pixel: &[Fragment], rounding: Rounding) -> (DVec3, f64) {
    let sorted = front_to_back(pixel);
    let (near, far) = sorted.split_at(sorted.len().div_ceil(2));
    let (mut front, mut covered) = (DVec3::ZERO, 0.0);
    for f in near {
        front = rounding.round_color(front + (1.0 - covered) * color(f));
        covered = rounding.round_share(covered + (1.0 - covered) * f64::from(f.alpha));
    }
    let (mut back, mut shown) = (DVec3::ZERO, 1.0);
    for f in far.iter().rev() {
        let t = 1.0 - f64::from(f.alpha);
        back = rounding.round_color(color(f) + t * back);
        shown = rounding.round_share(t * shown);
    }
    let behind = back + shown * DVec3::from(BACKGROUND.map(f64::from));
    (front + (1.0 - covered) * behind, (1.0 - covered) * shown)
}

/// Steps (place, transmittance behind it), and every fragment through them.
pub fn adaptive(pixel: &[Fragment], k: usize, rounding: Rounding) -> (DVec3, f64) {
    // a transmittance in f32 stands for itself where nothing else is kept
    let round = |t| rounding.round(t);
    let mut steps: Vec<((f32, u32), f64)> = Vec::new();
    for f in pixel.iter().filter(|f| !f.is_zero()) {
        let (key, t) = ((f.depth, f.primitive), 1.0 - f64::from(f.alpha));
        let at = steps.iter().filter(|step| step.0 < key).count();
        let before = if at == 0 { 1.0 } else { steps[at - 1].1 };
        steps[at..].iter_mut().for_each(|step| step.1 = round(step.1 * t));
        steps.insert(at, (key, round(before * t)));
        if steps.len() > k {
            let area = |j: usize| f64::from(steps[j].0.0 - steps[j - 1].0.0) * (steps[j - 1].1 - steps[j].1);
            let least = (1..steps.len()).min_by(|&i, &j| area(i).total_cmp(&area(j))).unwrap();
            steps[least - 1].1 = steps[least].1;
            steps.remove(least);
        }
    }
    let in_front = |key| steps.iter().rev().find(|step| step.0 < key).map_or(1.0, |step| step.1);
    let seen = |f: &Fragment| in_front((f.depth, f.primitive)) * color(f);
    let sum: DVec3 = pixel.iter().map(seen).sum();
    let total = steps.last().map_or(1.0, |step| step.1);
    (sum + total * DVec3::from(BACKGROUND.map(f64::from)), total)
}

/// Where a depth is stored.
#[expect(clippy::cast_possible_truncation, reason = "depths are f32")]
pub fn place(format: Format, depth: f32) -> f32 {
    let steps = match format {
        Format::D24 => 16_777_215.0,
        Format::Unorm16 => 65_535.0,
        Format::F16 => return f16::from_f32(depth).to_f32(),
        Format::Bf16 => return half::bf16::from_f32(depth).to_f32(),
        _ => return depth,
    };
    let (near, far) = (VIEW.near, VIEW.far);
    let z = f64::from(depth).max(near).min(far);
    let window = (far * (z - near) / (z * (far - near)) * steps).round() / steps;
    (far * near / (far - window * (far - near))) as f32
}
