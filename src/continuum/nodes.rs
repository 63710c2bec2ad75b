//! The formats of list nodes and samples: colour, share and depth, and what they leave of a technique's promises
//! (sheet 1.3, "Storage").
//!
//! The layouts in use are choices of two formats: `node_color=unorm8` is RGBA8 beside a depth in f32 (8 bytes),
//! `f16` four halves beside it (12 bytes), and `rgb9e5` with `node_depth=d24` the shared exponent in one word and
//! D24A8 in another (8 bytes).

use super::stored_layers::StoredAlpha;
use super::stored_sums::Recipe;
use crate::diagnosis::{Fault, Faults, rounding};
use crate::format::{Format, FormatSet, Formats, Summation, Target};
use crate::params::{Params, View};
use crate::technique::Properties;
use glam::DVec3;

impl Target {
    /// A list node's colour and what shows through it.
    pub const NODE_COLOR: Self = Self {
        name: "node_color",
        param: "node_color_format",
        doc: "format of a node's premultiplied colour and transmittance (unorm8 is RGBA8); r11g11b10f and rgb9e5 keep the \
              transmittance in an f16 beside, or in the 8 bits that a depth in d24 leaves; f32 keeps it in f64",
        formats: FormatSet::COLORS,
        channels: 4,
        double: false,
        active: |_| true,
    };
    /// What shows through a list node that has no colour.
    pub const NODE_SHARE: Self = Self {
        name: "node_share",
        param: "node_share_format",
        doc: "format of a node's transmittance, where it keeps no colour; format=\"f32\" keeps it in f64, \"f32\" here stands \
              for a number in f32",
        formats: FormatSet::SHARES,
        channels: 1,
        double: true,
        active: |_| true,
    };
    /// A list node's depth.
    pub const NODE_DEPTH: Self = Self {
        name: "node_depth",
        param: "node_depth_format",
        doc: "format of a node's depth: a distance in floats, window depth between the view's planes in unorm16 and d24; \
              fragments are sorted by the rounded depth, then by primitive",
        formats: FormatSet::DEPTHS,
        channels: 1,
        double: false,
        active: |_| true,
    };
    /// The colour of a sample, or of a layer that is a set of samples.
    pub const SAMPLE_COLOR: Self = Self {
        name: "node_color",
        param: "node_color_format",
        doc: "format of the unmultiplied colour of a sample, or of a node of samples",
        formats: FormatSet::COLORS,
        channels: 3,
        double: false,
        active: |_| true,
    };

    /// Layers that are composited as they are peeled.
    pub const PEELED_COLOR: Self = Self {
        name: "color",
        param: "color_format",
        doc: "format of the layers composited so far, colour and alpha, rounded after every pass; f32 keeps alpha in f64",
        ..Self::NODE_COLOR
    };
    /// The depth up to which layers are peeled.
    pub const PEELED_DEPTH: Self = Self {
        name: "depth",
        param: "depth_format",
        doc: "format of depths: a distance in floats, window depth between the view's planes in unorm16 and d24; layers are \
              peeled by the rounded depth, then by primitive",
        ..Self::NODE_DEPTH
    };
}

/// How a depth is stored.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Depths {
    format: Format,
    near: f64,
    far: f64,
}

impl Depths {
    /// In that format; window depth is that of the view's planes.
    pub fn new(format: Format, view: &View) -> Self {
        Self { format, near: view.near, far: view.far }
    }

    /// Whether every depth stays what it is.
    pub fn are_exact(self) -> bool {
        matches!(self.format, Format::F64 | Format::F32)
    }

    /// The stored depth; it ascends with the depth.
    #[expect(clippy::cast_possible_truncation, reason = "nodes are read as f32")]
    pub fn place(self, depth: f32) -> f32 {
        match self.format {
            Format::F64 | Format::F32 => depth,
            Format::D24 | Format::Unorm16 => {
                self.distance(self.format.round(self.window(depth.into()))) as f32
            }
            format => format.read(format.round(depth.into())) as f32,
        }
    }

    /// MB13 eq. 11: 0 at the near plane, 1 at the far one, and the planes' own beyond them.
    fn window(self, z: f64) -> f64 {
        let z = z.clamp(self.near, self.far);
        self.far * (z - self.near) / (z * (self.far - self.near))
    }

    /// The distance of a window depth.
    fn distance(self, window: f64) -> f64 {
        self.far * self.near / (self.far - window * (self.far - self.near))
    }
}

/// What a list of layers stores.
pub static LAYERS: [Target; 2] = [Target::NODE_COLOR, Target::NODE_DEPTH];

/// What peeling stores.
pub static PEELED: [Target; 2] = [Target::PEELED_COLOR, Target::PEELED_DEPTH];

/// What samples store.
pub static SAMPLES: [Target; 2] = [Target::SAMPLE_COLOR, Target::NODE_DEPTH];

/// How nodes are stored.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Nodes {
    /// Whether they are, and everything else is, as if nobody had said anything.
    pub are_default: bool,
    color: Format,
    /// The format of t, or of a.
    share: Format,
    /// Where they lie.
    pub depths: Depths,
    /// A node's bytes.
    pub bytes: f64,
    /// Those of its colour and share.
    pub color_bytes: f64,
}

impl Nodes {
    /// As the formats of the targets "`node_color`", "`node_share`" and "`node_depth`" have it, as far as there
    /// are any; nothing rounds what has none.
    pub fn new(formats: &Formats, view: &View) -> Self {
        let color = formats.find("node_color");
        let depth = formats.find("node_depth").unwrap_or(Format::F64);
        let share = formats.find("node_share").or(color.map(share_beside));
        let color_bytes = formats.bytes_of("node_color") + formats.bytes_of("node_share");
        let nodes = Self {
            are_default: formats.are_default(),
            color: color.unwrap_or(Format::F64),
            share: share.unwrap_or(Format::F64),
            depths: Depths::new(depth, view),
            bytes: color_bytes + formats.bytes_of("node_depth"),
            color_bytes,
        };
        // the share that is an f16 beside a packed colour moves into the depth's word; samples have none
        let is_beside = color.is_some_and(|color| color_bytes > color.bytes(3));
        if is_beside && depth == Format::D24 {
            let (bytes, color_bytes) = (nodes.bytes - 1.0, nodes.color_bytes - 1.0);
            return Self { share: Format::Unorm8, bytes, color_bytes, ..nodes };
        }
        nodes
    }

    /// Those of peeling, whose targets are "color" and "depth".
    pub fn peeled(formats: &Formats, view: &View) -> Self {
        let (color, depth) = (formats.of("color"), formats.of("depth"));
        Self {
            are_default: formats.are_default(),
            color,
            share: share_beside(color),
            depths: Depths::new(depth, view),
            bytes: formats.bytes_per_pixel(),
            color_bytes: formats.bytes_of("color"),
        }
    }

    /// Those of a technique's params.
    pub fn from_params(targets: &'static [Target], params: &Params, view: &View) -> Self {
        Self::new(&Formats::from_params(targets, params), view)
    }

    /// The same nodes without a share beside the colour, or with one that is stored elsewhere and that nothing rounds.
    pub fn without_shares(self) -> Self {
        let color_bytes = if self.color_bytes > 0.0 { self.color.bytes(3) } else { 0.0 };
        let bytes = self.bytes - self.color_bytes + color_bytes;
        Self { share: Format::F64, bytes, color_bytes, ..self }
    }

    /// Layers of continuous alpha that keep their transmittance.
    pub fn alpha(self) -> StoredAlpha {
        StoredAlpha { nodes: self, keeps_alpha: false }
    }

    /// Layers that keep their alpha: nodes of fragments that never merge.
    pub fn fragments(self) -> StoredAlpha {
        StoredAlpha { nodes: self, keeps_alpha: true }
    }

    /// Whether shares are kept in double precision, as they are by default.
    pub fn has_exact_shares(self) -> bool {
        self.share == Format::F64
    }

    /// A colour as a node keeps it; what overflows is the largest number.
    pub fn keep(self, color: DVec3) -> DVec3 {
        let mut texel = color.to_array();
        self.color.round_texel(&mut texel);
        DVec3::from(self.color.read_texel(texel))
    }

    /// What can befall a colour that is written.
    pub fn faults(self) -> Faults {
        match self.color {
            Format::F64 => Faults::NONE,
            format if format.has_infinity() => Faults::of(&[Fault::Overflow, Fault::Underflow]),
            _ => Faults::of(&[Fault::Saturation, Fault::Underflow]),
        }
    }

    /// What befalls a colour when it is written.
    pub fn written(self, color: DVec3) -> Faults {
        let (exact, mut stored) = (color.to_array(), color.to_array());
        self.color.round_texel(&mut stored);
        let of_channels =
            exact.into_iter().zip(stored).map(|(exact, stored)| rounding(self.color, exact, stored));
        of_channels.fold(Faults::NONE, Faults::union)
    }

    /// A share in [0, 1] as a node keeps it.
    pub fn keep_share(self, share: f64) -> f64 {
        if self.has_exact_shares() { share } else { self.share.round(share) }
    }

    /// `front + shown behind` of colours, rounded once.
    pub fn put_over(self, front: DVec3, shown: f64, behind: DVec3) -> DVec3 {
        let blend = |front, behind| self.color.blend(behind, shown, front);
        self.keep(DVec3::new(blend(front.x, behind.x), blend(front.y, behind.y), blend(front.z, behind.z)))
    }

    /// `front + shown behind` where `behind` comes from a shader, rounded once.
    pub fn put_under(self, front: DVec3, shown: f64, behind: DVec3) -> DVec3 {
        let under = |front, behind| self.color.under(front, shown, behind);
        self.keep(DVec3::new(under(front.x, behind.x), under(front.y, behind.y), under(front.z, behind.z)))
    }

    /// The product of what shows through two layers, rounded once.
    pub fn multiply(self, stored: f64, factor: f64) -> f64 {
        if self.has_exact_shares() {
            stored * factor
        } else {
            self.share.round(self.share.blend(stored, factor, 0.0))
        }
    }

    /// What still shows through `shown` behind a fragment that covers `coverage`, where coverages are stored, not what
    /// they leave.
    pub fn cover(self, shown: f64, coverage: f64) -> f64 {
        if self.has_exact_shares() {
            shown * (1.0 - coverage)
        } else {
            1.0 - self.share.round(self.share.under(1.0 - shown, shown, coverage))
        }
    }

    /// What a technique with these promises still promises: to be exact where colours and shares are, and to tend to
    /// the exact image where the order of depths stays, too.
    pub fn promises(self, promises: Properties) -> Properties {
        let colors = matches!(self.color, Format::F64 | Format::F32);
        let shares = self.has_exact_shares();
        let all = colors && shares && self.depths.are_exact();
        Properties {
            unbiased: promises.unbiased && all,
            consistent: promises.consistent && all,
            exact_for_one: promises.exact_for_one && colors && shares,
            exact_for_one_color: promises.exact_for_one_color && colors && shares,
            exact_coverage: promises.exact_coverage && shares,
            ..promises
        }
    }
}

/// What becomes of the colours of samples.
pub trait Keep: Send + Sync + 'static {
    /// A colour as it is kept.
    fn keep(&self, color: DVec3) -> DVec3;

    /// What can befall a colour that is written.
    fn faults(&self) -> Faults {
        Faults::NONE
    }

    /// What befalls a colour when it is written.
    fn written(&self, _color: DVec3) -> Faults {
        Faults::NONE
    }
}

/// They are kept as they are.
#[derive(Debug, Clone, Copy)]
pub struct AsTheyAre;

impl Keep for AsTheyAre {
    fn keep(&self, color: DVec3) -> DVec3 {
        color
    }
}

impl Keep for Nodes {
    fn keep(&self, color: DVec3) -> DVec3 {
        Self::keep(*self, color)
    }
    fn faults(&self) -> Faults {
        Self::faults(*self)
    }
    fn written(&self, color: DVec3) -> Faults {
        Self::written(*self, color)
    }
}

/// The format of the share that goes with a colour. By default shares are kept in double precision.
fn share_beside(color: Format) -> Format {
    match color {
        Format::F32 => Format::F64,
        Format::Srgb8 => Format::Unorm8,
        _ => color.of_alpha(),
    }
}

/// Sums of fragments in the formats of the targets "accumulation", "revealage" and "count", as far as there are any.
pub fn sums(formats: &Formats) -> Recipe {
    let accumulation = formats.find("accumulation").unwrap_or(Format::F64);
    Recipe {
        rgb: accumulation,
        alpha: accumulation,
        revealage: formats.find("revealage").unwrap_or(Format::F64),
        count: formats.find("count").unwrap_or(Format::F64),
        summation: Summation::Plain,
        monochrome: false,
    }
}

/// The bytes of those.
pub fn bytes_of_sums(formats: &Formats) -> f64 {
    ["accumulation", "revealage", "count"].map(|name| formats.bytes_of(name)).iter().sum()
}

#[cfg(test)]
mod tests;
