//! Occupancy maps (Sintorn & Assarsson 2009): one bit per depth slice, and the absorbance of few slabs.

use crate::continuum::absorbance::{S_MAX, absorbance, absorbances, transmittance, transmittances};
use crate::continuum::binned::BinnedAbsorbance;
use crate::continuum::oracle::{CHUNK, Composite, Oracle, chunks, see_one};
use crate::continuum::range::{DepthRange, Interval, cell};
use crate::continuum::stored_oracle::{StoredOracle, coefficients, technique};
use crate::continuum::two_pass_form::{Own, two_pass_form};
use crate::error::Result;
use crate::format::{Formats, SUMMATION, Target};
use crate::fragments::{Fragment, List};
use crate::gpu::form::blocks::{self, FUNCTIONS, INTERVAL, OUTPUTS, TWO_PASS};
use crate::gpu::form::{Form, Number};
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::technique::{AnyTechnique, Axes, Cost, DepthComplexity, Info, Pixel, Properties};
use crate::techniques::ANY_ORDER;

/// The registry entry.
pub static INFO: Info = Info {
    id: "occupancy_maps",
    aliases: &[],
    name: "Occupancy Maps",
    citation: &["Sintorn2009"],
    doc: "Marks in a bit mask which depth slices hold something and sums the absorbance of slabs of slices; a \
          fragment is hidden by the share of its slab that the bits in front of it are of all its bits, as if \
          every slice absorbed alike.",
    axes: Axes {
        memory: "k bins",
        insertion: "always",
        merge: "discard if bin occupied",
        normalize: "renormalize alpha",
        opacity: "alpha",
    },
    params: &[
        ParamSpec::new("bits", Kind::at_least(1), Value::Int(128), "depth slices, a bit each"),
        ParamSpec::new(
            "slabs",
            Kind::at_least(1),
            Value::Int(1),
            "slabs whose absorbance is summed; divides the number of bits",
        ),
        DepthRange::param("pixel"),
        S_MAX,
        Composite::param("none"),
        SUMMATION,
    ],
    targets: &[SLABS, Target::ACCUMULATION, Target::REVEALAGE],
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "2, 1 more for range=\"pixel\"",
    bytes_per_pixel: "bits, slabs, 4 sums and R: bits / 8 + 4 slabs + 20 in f32, bits / 8 + 2 slabs + 10 in f16, 8 more for \
                      range=\"pixel\"",
    build,
    gpu: Some(gpu),
};

/// Absorbance of the slabs.
const SLABS: Target = coefficients(
    "slabs",
    "slabs_format",
    "format of the slabs' absorbance; format=\"f32\" keeps it in f64, \"f32\" here stands for R32F targets",
);

fn build(params: &Params, view: &View) -> Result<Box<dyn AnyTechnique>> {
    let (bits, slabs) = (params.size("bits"), params.size("slabs"));
    if !bits.is_multiple_of(slabs) {
        let problem = format!("{bits} bits do not divide into {slabs} slabs");
        return Err(params.error(problem, "allowed are slabs that divide the number of bits"));
    }
    let oracle = OccupancyMaps {
        bits,
        slabs,
        range: DepthRange::from_params(params, view),
        s_max: params.float("s_max"),
    };
    Ok(technique(oracle, INFO.targets, params))
}

/// Bits that are counted one after the other in a shader, at most.
const MOST_BITS: usize = 1 << 16;

/// Its form on a GPU: the bits are set in a buffer, since no blend unit sets bits.
fn gpu(params: &Params, view: &View) -> Result<Form> {
    let (bits, slabs) = (params.size("bits"), params.size("slabs"));
    let words = match u32::try_from(bits.div_ceil(32)) {
        Ok(words) if bits <= MOST_BITS => words,
        _ => {
            let problem = format!("bits={bits} has no form on the backend \"gpu\"");
            return Err(params.error(problem, format!("there bits is at most {MOST_BITS}")));
        }
    };
    two_pass_form(
        params,
        view,
        &Own {
            shader: include_str!("../../shaders/occupancy_maps.wgsl"),
            blocks: &[FUNCTIONS, INTERVAL, OUTPUTS, TWO_PASS, blocks::BINS],
            targets: INFO.targets,
            map: (SLABS.name, "slabs"),
            count: slabs,
            words,
            numbers: &[bits, slabs].map(Number::size),
            ..Own::BARE
        },
    )
}

/// Bits and slabs of a depth range.
struct OccupancyMaps {
    bits: usize,
    slabs: usize,
    range: DepthRange,
    s_max: f64,
}

/// One pixel's mask and sums.
#[derive(Debug, Default)]
struct Map {
    interval: Interval,
    mask: Mask,
    slabs: BinnedAbsorbance,
}

/// A set of bits.
#[derive(Debug, Default)]
struct Mask {
    /// Words of bits, each with the number of those set in the words before it, where they are few.
    words: Vec<(u64, usize)>,
    /// Where there are more, those that are set, in order: neither time nor memory depends on their number.
    list: Vec<usize>,
}

impl Mask {
    /// The most bits that are kept in words.
    const IN_WORDS: usize = 4096;

    /// None of so many bits.
    fn clear(&mut self, bits: usize) {
        self.list.clear();
        self.words.clear();
        if bits <= Self::IN_WORDS {
            self.words.resize(bits / 64 + 1, (0, 0));
        }
    }

    fn insert(&mut self, bit: usize) {
        match self.words.get_mut(bit / 64) {
            Some((word, _)) => *word |= 1 << (bit % 64),
            None => self.list.push(bit),
        }
    }

    /// Nothing is inserted any more.
    fn end(&mut self) {
        self.list.sort_unstable();
        self.list.dedup();
        let mut count = 0;
        for (word, before) in &mut self.words {
            *before = count;
            count += word.count_ones() as usize;
        }
    }

    /// How many bits in front of this one are set.
    fn count_before(&self, bit: usize) -> usize {
        match self.words.get(bit / 64) {
            Some((word, before)) => before + (word & ((1 << (bit % 64)) - 1)).count_ones() as usize,
            None => self.list.partition_point(|b| *b < bit),
        }
    }
}

impl OccupancyMaps {
    fn bit(&self, position: f64) -> usize {
        cell(position, self.bits).0
    }

    fn slab_size(&self) -> usize {
        self.bits / self.slabs
    }

    /// A: the slabs in front of the bit's, and of its own slab the share of the bits in front of it.
    #[expect(clippy::cast_precision_loss, reason = "a count of fragments")]
    fn tau(&self, map: &Map, bit: usize) -> f64 {
        let slab = bit / self.slab_size();
        let first = slab * self.slab_size();
        let [start, own, end] = [first, bit, first + self.slab_size()].map(|bit| map.mask.count_before(bit));
        let share = if end > start { (own - start) as f64 / (end - start) as f64 } else { 0.0 };
        map.slabs.lerp((slab, share))
    }
}

impl Oracle for OccupancyMaps {
    type Map = Map;

    fn build(&self, pixel: &Pixel<'_>, Map { interval, mask, slabs }: &mut Map) {
        *interval = self.range.interval(pixel.list);
        mask.clear(self.bits);
        slabs.clear(self.slabs);
        let (mut positions, mut s) = ([0.0; CHUNK], [0.0; CHUNK]);
        for part in chunks(pixel.list) {
            interval.positions(part.depth, &mut positions);
            absorbances(part.alpha, self.s_max, &mut s);
            for (&position, &s) in positions.iter().zip(&s).take(part.len()) {
                let bit = self.bit(position);
                mask.insert(bit);
                slabs.add(bit / self.slab_size(), s);
            }
        }
        mask.end();
        slabs.end();
    }

    fn in_front_of(&self, map: &Map, fragment: &Fragment) -> f64 {
        see_one(self, map, fragment)
    }

    fn see(&self, map: &Map, list: List<'_>, seen: &mut [f64]) {
        map.interval.positions(list.depth, seen);
        for seen in &mut *seen {
            *seen = self.tau(map, self.bit(*seen));
        }
        transmittances(seen);
    }

    fn at(&self, map: &Map, depth: f32) -> f64 {
        transmittance(self.tau(map, self.bit(map.interval.position(depth))))
    }

    fn total(&self, map: &Map) -> f64 {
        transmittance(map.slabs.total())
    }

    #[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
    fn cost(&self, _complexity: &DepthComplexity) -> Cost {
        let range = f64::from(u8::from(self.range == DepthRange::Pixel));
        Cost {
            geometry_passes: 2.0 + range,
            bytes_per_pixel: self.bits as f64 / 8.0 + 4.0 * self.slabs as f64 + 8.0 * range + 20.0,
        }
    }

    fn properties(&self, composite: Composite) -> Properties {
        composite.promises(true)
    }
}

impl StoredOracle for OccupancyMaps {
    fn build_stored(&self, pixel: &Pixel<'_>, formats: &Formats, Map { interval, mask, slabs }: &mut Map) {
        *interval = self.range.interval(pixel.list);
        mask.clear(self.bits);
        let deposits = pixel.list.iter().map(|f| {
            let bit = self.bit(interval.position(f.depth));
            mask.insert(bit);
            (bit / self.slab_size(), absorbance(f.alpha, self.s_max))
        });
        slabs.fill_stored(self.slabs, formats.of(SLABS.name), deposits);
        mask.end();
    }

    #[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
    fn texels(&self, _complexity: &DepthComplexity) -> Vec<(&'static str, f64)> {
        vec![(SLABS.name, self.slabs as f64)]
    }
}

#[cfg(test)]
mod tests {
    use super::{Map, OccupancyMaps};
    use crate::continuum::oracle::Oracle;
    use crate::continuum::range::DepthRange;
    use crate::fragments::Fragment;
    use crate::params::Input;
    use crate::techniques::testing::{
        F32_STATE, as_pixel, assert_close, build, clear_pixels, exact_transmittance, fragment, over, resolve,
    };

    fn map(bits: usize, slabs: usize, fragments: &[Fragment]) -> (OccupancyMaps, Map) {
        let oracle = OccupancyMaps { bits, slabs, range: DepthRange::Fixed(0.0, 8.0), s_max: 10.0 };
        let mut map = Map::default();
        as_pixel(fragments, |pixel| oracle.build(pixel, &mut map));
        (oracle, map)
    }

    fn seen(bits: usize, slabs: usize, fragments: &[Fragment]) -> Vec<f64> {
        let (oracle, map) = map(bits, slabs, fragments);
        fragments.iter().map(|f| oracle.in_front_of(&map, f)).collect()
    }

    fn layer(depth: f32, alpha: f32) -> Fragment {
        fragment(depth, [0.3, 0.6, 0.9], alpha, depth.to_bits())
    }

    #[track_caller]
    fn assert_near(got: &[f64], expected: &[f64]) {
        assert!(got.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-14), "{got:?} for {expected:?}");
    }

    #[test]
    fn three_layers_by_hand() {
        // three quarters, a half and a half: an eighth and a half get through, in equal steps over three bits
        let layers = [layer(1.5, 0.75), layer(3.5, 0.5), layer(6.5, 0.5)];
        let step = 0.062_5_f64.cbrt();
        assert_near(&seen(8, 1, &layers), &[1.0, step, step * step]);
        // two slabs: the third alone in its own
        assert_near(&seen(8, 2, &layers), &[1.0, 0.125_f64.sqrt(), 0.125]);
        // a slab per bit is a bin per bit
        assert_near(&seen(8, 8, &layers), &[1.0, 0.25, 0.125]);
    }

    #[test]
    fn equal_alphas_in_bits_of_their_own_are_exact() {
        let layers: Vec<_> = [7.5, 0.5, 3.5, 2.5, 5.5].map(|z| layer(z, 0.4)).into();
        for slabs in [1, 2, 4, 8] {
            assert_near(&seen(8, slabs, &layers), &exact_transmittance(&layers));
        }
        let (color, transmittance) = over(&layers);
        let bits = [("bits", Input::Int(8)), ("range", Input::Floats(vec![0.0, 8.0]))];
        assert_close(resolve("occupancy_maps", &bits, &layers), color, transmittance, F32_STATE);
    }

    #[test]
    fn unequal_alphas_keep_the_total_alone() {
        let layers = [layer(0.5, 0.9), layer(2.5, 0.1), layer(4.5, 0.5)];
        let (oracle, map) = map(64, 1, &layers);
        assert!((oracle.total(&map) - over(&layers).1).abs() < 1e-14);
        let (got, exact) = (seen(64, 1, &layers), exact_transmittance(&layers));
        assert!((got[1] - exact[1]).abs() > 0.1, "{got:?}");
    }

    #[test]
    fn a_collision_loses_a_bit_but_no_absorbance() {
        for pixel in clear_pixels(20) {
            let (oracle, map) = map(2, 1, &pixel);
            assert!(map.mask.count_before(2) <= 2);
            assert!((oracle.total(&map) - over(&pixel).1).abs() < 1e-14);
        }
        // both in the first bit: neither hides the other, together they hide half of what is there
        let layers = [layer(1.0, 0.5), layer(2.0, 0.75), layer(6.0, 0.5)];
        assert_near(&seen(2, 1, &layers), &[1.0, 1.0, 0.25]);
    }

    #[test]
    fn slabs_divide_the_bits() {
        let inputs = [("bits", Input::Int(6)), ("slabs", Input::Int(4))];
        let message = build("occupancy_maps", &inputs).err().unwrap().to_string();
        assert!(message.contains("6 bits do not divide into 4 slabs"), "{message}");
    }
}
