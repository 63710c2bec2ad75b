//! What a technique stores, in which formats, and the params that choose among them.

use super::Format;
use crate::params::{Kind, ParamSpec, Params, Value, View};
use std::fmt;

/// A set of formats.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FormatSet(u16);

impl FormatSet {
    /// All there are.
    pub const ALL: Self = Self((1 << Format::ALL.len()) - 1);
    /// Floats of one channel and more.
    pub const FLOATS: Self = Self::of(&[Format::F64, Format::F32, Format::F16, Format::Bf16]);
    /// What sums of colours can be kept in: floats, and the packed ones beside an f16 for alpha.
    pub const SUMS: Self = Self::FLOATS.and(&[Format::R11g11b10f, Format::Rgb9e5]);
    /// What sums that seldom exceed 1 can be kept in.
    pub const SMALL_SUMS: Self = Self::SUMS.and(&[Format::Unorm8, Format::Unorm16]);
    /// What a colour to look at can be kept in.
    pub const COLORS: Self = Self::SMALL_SUMS.and(&[Format::Srgb8]);
    /// What a number in [0, 1] can be kept in.
    pub const SHARES: Self = Self::FLOATS.and(&[Format::Unorm8, Format::Unorm16]);
    /// What a depth can be kept in.
    pub const DEPTHS: Self = Self::FLOATS.and(&[Format::Unorm16, Format::D24]);

    /// The set of these.
    pub const fn of(formats: &[Format]) -> Self {
        Self(0).and(formats)
    }
    /// The set with these besides.
    pub const fn and(self, formats: &[Format]) -> Self {
        let (mut bits, mut i) = (self.0, 0);
        while i < formats.len() {
            bits |= 1 << formats[i] as u16;
            i += 1;
        }
        Self(bits)
    }
    /// What both sets have.
    pub const fn intersection(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }
    /// Whether the set has that format.
    pub const fn has(self, format: Format) -> bool {
        self.0 >> format as u16 & 1 == 1
    }
    /// Its formats, the widest first.
    pub fn iter(self) -> impl Iterator<Item = Format> {
        Format::ALL.into_iter().filter(move |format| self.has(*format))
    }
    /// The format of that name, if the set has it.
    pub fn find(self, name: &str) -> Option<Format> {
        self.iter().find(|format| format.name() == name)
    }
}

impl fmt::Display for FormatSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, format) in self.iter().enumerate() {
            write!(f, "{}{:?}", if i == 0 { "" } else { ", " }, format.name())?;
        }
        Ok(())
    }
}

/// A render target, buffer or part of a node in which a technique stores something.
#[derive(Debug, Clone, Copy)]
pub struct Target {
    /// What it holds, in a word.
    pub name: &'static str,
    /// The param that overrides its format: the name and `_format`.
    pub param: &'static str,
    /// What the param means.
    pub doc: &'static str,
    /// The formats that make sense.
    pub formats: FormatSet,
    /// Numbers per texel.
    pub channels: u32,
    /// Whether it keeps double precision where `format` is the default.
    pub double: bool,
    /// Whether there is such a target under the technique's own params.
    pub active: fn(&Params) -> bool,
}

impl Target {
    /// Σ w (C, a).
    pub const ACCUMULATION: Self = Self {
        name: "accumulation",
        param: "accumulation_format",
        doc: "format of the sums of weighted colours and alphas; r11g11b10f and rgb9e5 keep alpha in an f16 beside",
        formats: FormatSet::SUMS,
        channels: 4,
        double: false,
        active: |_| true,
    };
    /// R = Π (1 − a).
    pub const REVEALAGE: Self = Self {
        name: "revealage",
        param: "revealage_format",
        doc: "format of the background's share, the product of 1 - alpha; format=\"f32\" keeps it in f64, \"f32\" here \
              stands for an R32F target",
        formats: FormatSet::SHARES,
        channels: 1,
        double: true,
        active: |_| true,
    };
    /// A number of fragments.
    pub const COUNT: Self = Self {
        name: "count",
        param: "count_format",
        doc: "format of the number of fragments; f16 counts to 2048",
        formats: FormatSet::FLOATS,
        channels: 1,
        double: true,
        active: |_| true,
    };
    /// A framebuffer.
    pub const COLOR: Self = Self {
        name: "color",
        param: "color_format",
        doc: "format of the framebuffer; srgb8 blends in linear light",
        formats: FormatSet::COLORS,
        channels: 3,
        double: false,
        active: |_| true,
    };

    /// The same target with other formats.
    pub const fn of(mut self, formats: FormatSet) -> Self {
        self.formats = formats;
        self
    }

    /// The same target, there only where `active` says so.
    pub const fn when(mut self, active: fn(&Params) -> bool) -> Self {
        self.active = active;
        self
    }

    fn spec(&self) -> ParamSpec {
        let spec = ParamSpec::new(self.param, Kind::Format(self.formats), Value::None, self.doc);
        let spec = if self.double {
            spec.derived("as format; f64 where that is f32", |params, _| double_by_default(params))
        } else {
            spec.derived("as format", |params, _: &View| params.value("format"))
        };
        spec.when(self.active)
    }
}

fn double_by_default(params: &Params) -> Value {
    let format = params.text("format");
    Value::Text(if format == Format::F32.name() { Format::F64.name() } else { format })
}

/// The params that a technique with these targets takes: one for all of them, and one for each.
pub fn param_specs(targets: &'static [Target]) -> impl Iterator<Item = ParamSpec> {
    let common = targets.iter().fold(FormatSet::ALL, |set, target| set.intersection(target.formats));
    let format = ParamSpec::new(
        "format",
        Kind::Format(common),
        Value::Text(Format::F32.name()),
        "format of everything the technique stores; each result of a blend is rounded to it",
    );
    let all = (!targets.is_empty()).then_some(format);
    all.into_iter().chain(targets.iter().map(Target::spec))
}

/// The formats that params ask for.
#[derive(Debug, Clone, PartialEq)]
pub struct Formats {
    /// Name, format and bytes of each target that there is, and the format that it has on a device.
    targets: Vec<(&'static str, Format, f64, Format)>,
    /// Whether they are those that the technique has if nobody says anything.
    default: bool,
}

impl Formats {
    /// Reads the params of a technique with these targets.
    pub fn from_params(targets: &'static [Target], params: &Params) -> Self {
        let common = params.text("format");
        let mut formats = Self { targets: Vec::new(), default: common == Format::F32.name() };
        for target in targets.iter().filter(|target| (target.active)(params)) {
            let chosen = params.text(target.param);
            let usual = if target.double { double_by_default(params) } else { Value::Text(common) };
            formats.default &= Value::Text(chosen) == usual;
            let format = Format::from_name(chosen).unwrap_or_else(|| unreachable!("{chosen:?} was checked"));
            // what is double by default stands for the f32 target that a device would have
            let stands_for_f32 = target.double && common == Format::F32.name() && format == Format::F64;
            let on_device = if stands_for_f32 { Format::F32 } else { format };
            formats.targets.push((target.name, format, on_device.bytes(target.channels), on_device));
        }
        formats
    }

    /// Whether they are those that the technique has if nobody says anything.
    pub fn are_default(&self) -> bool {
        self.default
    }

    /// The format of a target.
    ///
    /// # Panics
    /// If there is no such target under these params.
    pub fn of(&self, name: &str) -> Format {
        self.find(name).unwrap_or_else(|| panic!("there is no target {name:?}"))
    }

    /// The format of a target that may not be there.
    pub fn find(&self, name: &str) -> Option<Format> {
        self.targets.iter().find(|target| target.0 == name).map(|target| target.1)
    }

    /// The format that a target has on a device: f32 where double precision by default stands for it.
    ///
    /// # Panics
    /// If there is no such target under these params.
    pub fn on_device(&self, name: &str) -> Format {
        let target = self.targets.iter().find(|target| target.0 == name);
        target.unwrap_or_else(|| panic!("there is no target {name:?}")).3
    }

    /// Bytes per pixel of all targets, each once. What is kept in double precision by default counts as the f32 target
    /// it stands for: no device blends doubles.
    pub fn bytes_per_pixel(&self) -> f64 {
        self.targets.iter().map(|target| target.2).sum()
    }

    /// Bytes per pixel of one target; none where it is not there.
    pub fn bytes_of(&self, name: &str) -> f64 {
        self.targets.iter().filter(|target| target.0 == name).map(|target| target.2).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::{Input, check};

    static TARGETS: [Target; 2] = [Target::ACCUMULATION, Target::REVEALAGE];

    fn formats(given: &[(&str, &str)]) -> Result<Formats, String> {
        let table: Vec<_> = param_specs(&TARGETS).collect();
        let inputs: Vec<_> = given
            .iter()
            .map(|(name, value)| ((*name).to_owned(), Input::Text((*value).to_owned())))
            .collect();
        let checked = check("demo", &table, &inputs).map_err(|error| error.to_string())?;
        Ok(Formats::from_params(&TARGETS, &checked.resolve(&table, &View::ORDINARY)))
    }

    #[test]
    fn targets_follow_the_common_format_unless_told_otherwise() {
        let plain = formats(&[]).unwrap();
        assert!(plain.are_default());
        assert_eq!((plain.of("accumulation"), plain.of("revealage")), (Format::F32, Format::F64));
        assert_eq!(plain.bytes_per_pixel(), 20.0);
        let half = formats(&[("format", "f16")]).unwrap();
        assert_eq!((half.of("accumulation"), half.of("revealage")), (Format::F16, Format::F16));
        assert!(!half.are_default());
        assert_eq!(half.bytes_per_pixel(), 10.0);
        let mixed = formats(&[("format", "f16"), ("revealage_format", "unorm8")]).unwrap();
        assert_eq!((mixed.of("revealage"), mixed.bytes_per_pixel()), (Format::Unorm8, 9.0));
        let packed = formats(&[("accumulation_format", "r11g11b10f")]).unwrap();
        assert_eq!((packed.of("revealage"), packed.bytes_of("accumulation")), (Format::F64, 6.0));
        assert_eq!(packed.bytes_per_pixel(), 10.0);
        let single = formats(&[("revealage_format", "f32")]).unwrap();
        assert!(!single.are_default());
        assert_eq!(single.bytes_per_pixel(), 20.0);
    }

    #[test]
    fn overrides_that_change_nothing_are_the_default() {
        let table: Vec<_> = param_specs(&TARGETS).collect();
        let identity = |given: &[(&str, &str)]| {
            let owned = |(name, value): &(&str, &str)| ((*name).to_owned(), Input::Text((*value).to_owned()));
            let checked = check("demo", &table, &given.iter().map(owned).collect::<Vec<_>>()).unwrap();
            checked.resolve(&table, &View::ORDINARY).identity()
        };
        for given in [("accumulation_format", "f32"), ("revealage_format", "f64"), ("format", "f32")] {
            assert_eq!(formats(&[given]), formats(&[]));
            assert_eq!(identity(&[given]), identity(&[]));
        }
        let half = ("format", "f16");
        assert_eq!(identity(&[half, ("revealage_format", "f16")]), identity(&[half]));
        assert_ne!(identity(&[half]), identity(&[]));
        assert_ne!(identity(&[("revealage_format", "f32")]), identity(&[]));
    }

    #[test]
    fn what_makes_no_sense_is_refused_by_name() {
        let message = formats(&[("accumulation_format", "d24")]).unwrap_err();
        assert!(
            message.contains("demo") && message.contains("\"accumulation_format\" is \"d24\""),
            "{message}"
        );
        assert!(message.contains("one of \"f64\", \"f32\", \"f16\", \"bf16\", \"r11g11b10f\""), "{message}");
        // what not all targets can have is no common format
        let message = formats(&[("format", "unorm8")]).unwrap_err();
        assert!(message.contains("one of \"f64\", \"f32\", \"f16\", \"bf16\";"), "{message}");
    }

    #[test]
    fn overrides_are_named_after_their_targets() {
        for target in [Target::ACCUMULATION, Target::REVEALAGE, Target::COUNT, Target::COLOR] {
            assert_eq!(target.param, format!("{}_format", target.name));
        }
    }
}
