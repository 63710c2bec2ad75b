//! Density clustering (Mertens et al. 2004): k-means along the ray; each cluster absorbs evenly over its depths.

use crate::continuum::absorbance::{S_MAX, absorbances, transmittance, transmittances};
use crate::continuum::oracle::{CHUNK, Composite, Oracle, see_one};
use crate::continuum::search::count_leading;
use crate::continuum::stored_oracle::{StoredOracle, coefficients, technique};
use crate::error::Result;
use crate::format::{Format, Formats, SUMMATION, Target};
use crate::fragments::{Fragment, List};
use crate::gpu::form::{Form, Listing, Number, Path, Sorting, at_most, only, only_single_formats, saturated};
use crate::params::{Kind, ParamSpec, Params, Value, View};
use crate::technique::{AnyTechnique, Axes, Cost, DepthComplexity, Info, Pixel, Properties};
use crate::techniques::ANY_ORDER;
use multiversion::multiversion;
use std::hint::select_unpredictable;

/// The registry entry.
pub static INFO: Info = Info {
    id: "density_clustering",
    aliases: &[],
    name: "Density Clustering",
    citation: &["Mertens2004"],
    doc: "Gathers a pixel's fragments in clusters of depth by a few iterations of k-means, one pass each; a \
          cluster's absorbance is spread evenly over a depth interval of the same mean and variance.",
    axes: Axes {
        memory: "k bins",
        insertion: "always",
        merge: "k-means clustering",
        normalize: "no",
        opacity: "alpha",
    },
    params: &[
        ParamSpec::new("bins", Kind::at_least(1), Value::Int(4), "clusters"),
        ParamSpec::new("iterations", Kind::at_least(1), Value::Int(3), "iterations of k-means"),
        S_MAX,
        Composite::param("none"),
        SUMMATION,
    ],
    targets: &[CLUSTERS, Target::ACCUMULATION, Target::REVEALAGE],
    submission_orders: ANY_ORDER,
    random: false,
    geometry_passes: "2 + iterations",
    bytes_per_pixel: "3 sums per cluster, two depths, 4 sums and R: 12 bins + 8 + 20 in f32, 6 bins + 8 + 10 in f16",
    build,
    gpu: Some(gpu),
};

/// Sums of a cluster. Their variance cancels: in f32 one fragment alone may seem 3e-4 of the pixel's depths wide, in f16
/// 0.03, which is more than [`SLACK`], and then hides itself by half.
const CLUSTERS: Target = coefficients(
    "clusters",
    "clusters_format",
    "format of the clusters' sums, rounded in each iteration anew; format=\"f32\" keeps them in f64, \"f32\" here stands \
     for R32F targets",
);

fn build(params: &Params, _view: &View) -> Result<Box<dyn AnyTechnique>> {
    let oracle = DensityClustering {
        clusters: params.size("bins"),
        iterations: params.size("iterations"),
        s_max: params.float("s_max"),
    };
    Ok(technique(oracle, INFO.targets, params))
}

/// Its form on a GPU: over sorted lists.
fn gpu(params: &Params, _view: &View) -> Result<Form> {
    only_single_formats(params, INFO.targets)?;
    only(params, "summation", "plain")?;
    let sizes = vec![("CLUSTERS", at_most(params, "bins", MOST_CLUSTERS)?)];
    Ok(Form {
        weight: None,
        shader: include_str!("../../shaders/density_clustering.wgsl"),
        numbers: vec![
            saturated(params.size("iterations")),
            Number::float(params.float("s_max")),
            Composite::from_params(params).number(),
        ],
        path: Path::Listed(Listing { resolve: "resolve", sorted: Sorting::Depth, layers: None, sizes }),
        shows_zero_fragments: false,
        colored_transmittance: false,
    })
}

/// A shader keeps four numbers for each.
const MOST_CLUSTERS: u32 = 256;

/// A cluster narrower than this part of the pixel's depths is a step; as far behind it lies what it hides.
const SLACK: f64 = 1e-4;

/// Absorbance-weighted k-means along the ray.
struct DensityClustering {
    clusters: usize,
    iterations: usize,
    s_max: f64,
}

/// Moments of a cluster's absorbance about the pixel's nearest depth.
#[derive(Debug, Clone, Copy, Default)]
struct Cluster {
    center: f64,
    s: f64,
    sd: f64,
    sdd: f64,
}

impl Cluster {
    fn add(&mut self, s: f64, d: f64, sum: impl Fn(f64, f64) -> f64) {
        self.s = sum(self.s, s);
        self.sd = sum(self.sd, s * d);
        self.sdd = sum(self.sdd, s * d * d);
    }

    /// As it is read from sums in a format.
    fn read(&mut self, format: Format) {
        [self.s, self.sd, self.sdd] = [self.s, self.sd, self.sdd].map(|sum| format.read(sum));
    }

    /// A uniform density of the same mean and variance.
    fn slice(&self) -> Slice {
        let deviation =
            if self.s > 0.0 { (self.sdd / self.s - self.center * self.center).max(0.0).sqrt() } else { 0.0 };
        let width = (deviation >= SLACK).then_some(2.0 * 3.0_f64.sqrt() * deviation);
        Slice { center: self.center, s: self.s, width }
    }
}

/// Absorbance spread evenly, or in one place.
#[derive(Debug, Clone, Copy)]
struct Slice {
    center: f64,
    s: f64,
    width: Option<f64>,
}

/// Adds what of a slice hides each point.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn add_in_front(slice: Slice, positions: &[f64], taus: &mut [f64]) {
    let Slice { center, s, width } = slice;
    let points = taus.iter_mut().zip(positions);
    match width {
        Some(width) => points.for_each(|(tau, d)| *tau += s * ((d - center) / width + 0.5).clamp(0.0, 1.0)),
        None => points.for_each(|(tau, d)| *tau += if d - center > SLACK { s } else { 0.0 }),
    }
}

/// Depths behind `near` in units of `extent`. Behind a single depth all is far.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn positions(near: f64, extent: f64, depth: &[f32], positions: &mut [f64]) {
    for (position, &depth) in positions.iter_mut().zip(depth) {
        let behind = f64::from(depth) - near;
        *position = if behind == 0.0 { 0.0 } else { behind / extent };
    }
}

/// One pixel's clusters, by depth.
#[derive(Debug, Default)]
struct Map {
    near: f64,
    extent: f64,
    clusters: Vec<Cluster>,
    /// Where each fragment is, and what it absorbs.
    positions: Vec<f64>,
    absorbances: Vec<f64>,
    /// What hides what is behind.
    slices: Vec<Slice>,
}

impl Map {
    /// The cluster with the nearest centre, the nearer to the camera of two. Centres stay in order: each moves
    /// within the interval that is nearest to it.
    fn nearest(&self, d: f64) -> usize {
        let behind = count_leading(&self.clusters, |c| c.center < d);
        let distance = |i: usize| (self.clusters[i].center - d).abs();
        let [before, after] = [behind.saturating_sub(1), behind.min(self.clusters.len() - 1)];
        select_unpredictable(distance(before) <= distance(after), before, after)
    }

    fn slice(&mut self) {
        self.slices.clear();
        self.slices.extend(self.clusters.iter().filter(|c| c.s > 0.0).map(Cluster::slice));
    }

    /// τ at each depth, of which there are at most [`CHUNK`].
    fn taus(&self, depth: &[f32], taus: &mut [f64]) {
        let mut d = [0.0; CHUNK];
        positions(self.near, self.extent, depth, &mut d);
        taus.fill(0.0);
        self.slices.iter().for_each(|slice| add_in_front(*slice, &d, taus));
    }
}

impl DensityClustering {
    /// One pass: every fragment to the nearest centre, by `sum` of what is there and of what is added.
    fn gather(map: &mut Map, sum: impl Fn(f64, f64) -> f64) {
        for cluster in &mut map.clusters {
            *cluster = Cluster { center: cluster.center, ..Cluster::default() };
        }
        for i in 0..map.positions.len() {
            let (s, d) = (map.absorbances[i], map.positions[i]);
            let own = map.nearest(d);
            map.clusters[own].add(s, d, &sum);
        }
    }

    /// Every centre to the mean of what it got. Says whether one moved.
    fn move_centers(map: &mut Map) -> bool {
        let mut moved = false;
        for cluster in map.clusters.iter_mut().filter(|c| c.s > 0.0) {
            let mean = cluster.sd / cluster.s;
            moved |= cluster.center != mean;
            cluster.center = mean;
        }
        moved
    }

    /// The pixel's fragments, and clusters evenly among them.
    #[expect(clippy::cast_precision_loss, reason = "clusters are held in memory")]
    fn begin(&self, pixel: &Pixel<'_>, map: &mut Map) {
        let (near, far) = pixel.list.depth_bounds().unwrap_or_default();
        (map.near, map.extent) = (near.into(), f64::from(far) - f64::from(near));
        map.positions.resize(pixel.list.len(), 0.0);
        positions(map.near, map.extent, pixel.list.depth, &mut map.positions);
        map.absorbances.resize(pixel.list.len(), 0.0);
        absorbances(pixel.list.alpha, self.s_max, &mut map.absorbances);
        let center = |j: usize| (j as f64 + 0.5) / self.clusters as f64;
        map.clusters.clear();
        map.clusters.extend((0..self.clusters).map(|j| Cluster { center: center(j), ..Cluster::default() }));
    }
}

impl Oracle for DensityClustering {
    type Map = Map;

    fn build(&self, pixel: &Pixel<'_>, map: &mut Map) {
        self.begin(pixel, map);
        for _ in 0..self.iterations {
            Self::gather(map, |sum, x| sum + x);
            if !Self::move_centers(map) {
                break;
            }
        }
        map.slice();
    }

    fn in_front_of(&self, map: &Map, fragment: &Fragment) -> f64 {
        see_one(self, map, fragment)
    }

    fn see(&self, map: &Map, list: List<'_>, seen: &mut [f64]) {
        map.taus(list.depth, seen);
        transmittances(seen);
    }

    fn at(&self, map: &Map, depth: f32) -> f64 {
        let mut tau = [0.0];
        map.taus(&[depth], &mut tau);
        transmittance(tau[0])
    }

    fn total(&self, map: &Map) -> f64 {
        transmittance(map.slices.iter().map(|c| c.s).sum())
    }

    #[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
    fn cost(&self, _complexity: &DepthComplexity) -> Cost {
        Cost {
            geometry_passes: 2.0 + self.iterations as f64,
            bytes_per_pixel: 12.0 * self.clusters as f64 + 28.0,
        }
    }

    fn properties(&self, composite: Composite) -> Properties {
        composite.promises(true)
    }
}

impl StoredOracle for DensityClustering {
    fn build_stored(&self, pixel: &Pixel<'_>, formats: &Formats, map: &mut Map) {
        let format = formats.of(CLUSTERS.name);
        self.begin(pixel, map);
        for _ in 0..self.iterations {
            Self::gather(map, |sum, x| format.accumulate(sum, x));
            map.clusters.iter_mut().for_each(|cluster| cluster.read(format));
            let moved = Self::move_centers(map);
            // rounded means may pass each other
            map.clusters.sort_by(|a, b| a.center.total_cmp(&b.center));
            if !moved {
                break;
            }
        }
        map.slice();
    }

    #[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
    fn texels(&self, _complexity: &DepthComplexity) -> Vec<(&'static str, f64)> {
        vec![(CLUSTERS.name, 3.0 * self.clusters as f64)]
    }
}

#[cfg(test)]
mod tests {
    use super::{DensityClustering, Map};
    use crate::continuum::oracle::Oracle;
    use crate::fragments::Fragment;
    use crate::params::Input;
    use crate::techniques::testing::{
        F32_STATE, as_pixel, assert_close, build, clear_pixels, exact_transmittance, fragment, mean_error,
        over, resolve,
    };

    fn oracle(clusters: usize, iterations: usize) -> DensityClustering {
        DensityClustering { clusters, iterations, s_max: 10.0 }
    }

    fn map(clusters: usize, iterations: usize, fragments: &[Fragment]) -> Map {
        let mut map = Map::default();
        as_pixel(fragments, |pixel| oracle(clusters, iterations).build(pixel, &mut map));
        map
    }

    fn layer(depth: f32, alpha: f32) -> Fragment {
        fragment(depth, [0.3, 0.6, 0.9], alpha, 0)
    }

    #[test]
    fn one_cluster_of_two_layers_by_hand() {
        // two equal layers at 0 and 1: mean 1/2, deviation 1/2, spread over 1/2 ± √3/2
        let layers = [layer(2.0, 0.5), layer(4.0, 0.5)];
        let map = map(1, 1, &layers);
        let share = |d: f64| ((d - 0.5) / 3.0_f64.sqrt() + 0.5).clamp(0.0, 1.0);
        for (z, d) in [(2.0, 0.0), (2.5, 0.25), (4.0, 1.0), (9.0, 3.5), (0.5, -0.75)] {
            let got = oracle(1, 1).at(&map, z);
            assert!((got - 0.25_f64.powf(share(d))).abs() < 1e-14, "{z}: {got}");
        }
    }

    #[test]
    fn iterations_move_the_centres_to_the_clusters() {
        // .51 begins nearer to .75 than to .25; then the opaque layer at 1 pulls that centre away
        let layers =
            [(0.0, 0.5), (0.2, 0.5), (0.51, 0.5), (1.0, 0.999)].map(|(z, alpha)| layer(2.0 + z, alpha));
        let first = |iterations| map(2, iterations, &layers).clusters[0].center;
        assert!((first(1) - 0.1).abs() < 1e-6, "{}", first(1));
        assert!((first(2) - 0.71 / 3.0).abs() < 1e-6, "{}", first(2));
        assert_eq!(first(3), first(2));
    }

    #[test]
    fn one_fragment_in_each_first_cell_is_exact() {
        for bins in [1_u8, 2, 5, 16] {
            let alpha = |i: u8| 0.05 + 0.9 * f32::from(i * 7 % bins) / f32::from(bins);
            let layers: Vec<_> = (0..bins).map(|i| layer(1.0 + f32::from(i), alpha(i))).collect();
            let map = map(bins.into(), 3, &layers);
            for (f, exact) in layers.iter().zip(exact_transmittance(&layers)) {
                assert!((oracle(bins.into(), 3).in_front_of(&map, f) - exact).abs() < 1e-14, "{bins}: {f:?}");
            }
            let (color, transmittance) = over(&layers);
            let got = resolve("density_clustering", &[("bins", Input::Int(bins.into()))], &layers);
            assert_close(got, color, transmittance, F32_STATE);
        }
    }

    #[test]
    fn a_lone_fragment_does_not_hide_itself() {
        for depth in [0.0, 0.1, 7.3, 1e-30, 1e30] {
            let lone = [layer(depth, 0.7)];
            let map = map(1, 1, &lone);
            assert_eq!(oracle(1, 1).in_front_of(&map, &lone[0]), 1.0);
            assert!((oracle(1, 1).at(&map, depth * 1.01 + 1e-30) - f64::from(1.0 - 0.7_f32)).abs() < 1e-7);
        }
    }

    #[test]
    fn emission_alone_forms_no_cluster() {
        let glow = Fragment { alpha: 0.0, ..layer(3.0, 1.0) };
        assert!(map(4, 3, &[glow, Fragment { depth: 5.0, ..glow }]).slices.is_empty());
    }

    /// Sheet 4: the variance cancels. A cluster of one fragment is a step in f64; where rounding makes it wide, the
    /// fragment hides itself by up to half its absorbance.
    #[test]
    fn rounded_variances_make_lone_fragments_hide_themselves() {
        let seen = |format: &str, alpha: f32| {
            let inputs = [("clusters_format", Input::Text(format.into())), ("bins", Input::Int(3))];
            let pixel = [layer(2.0, 0.5), layer(5.0 + alpha, alpha), layer(9.0, 0.5)];
            let technique = build("density_clustering", &inputs).unwrap();
            as_pixel(&pixel, |p| technique.transmittance(p, &[pixel[1].depth]).unwrap()[0])
        };
        let worst = |format| {
            let far = (1..60_u8).map(|i| (seen(format, f32::from(i) / 64.0) - 0.5).abs());
            far.fold(0.0, f64::max)
        };
        assert!(worst("f64") < 1e-9, "{}", worst("f64"));
        assert!(worst("f32") > 0.1 && worst("f16") > 0.1, "{} {}", worst("f32"), worst("f16"));
    }

    #[test]
    fn more_clusters_are_closer() {
        let pixels = clear_pixels(200);
        let errors = [1, 2, 4, 8, 64].map(|clusters| mean_error(&oracle(clusters, 3), &pixels));
        assert!(errors.is_sorted_by(|a, b| a > b) && errors[4] < 0.01, "{errors:?}");
    }
}
