//! `cargo bench`: the time of each hot kernel by itself, on one thread, and per triangle or fragment.
//!
//! Small images: a kernel's working memory is one tile's, whatever the size of the image. Before and after a
//! change: `cargo bench -- --save-baseline before`, then `cargo bench -- --baseline before`; a word at the end
//! picks kernels by name.

#[path = "../tests/common/mod.rs"]
mod common;

use common::{capture_with, frames_with, perspective, random, request, scene};
use criterion::measurement::WallTime;
use criterion::{BenchmarkGroup, Criterion, SamplingMode, Throughput};
use oitlab::fragments::Fragments;
use oitlab::params::{Input, Kind};
use oitlab::random::{hash32, unit};
use oitlab::raster::Raster;
use oitlab::render::{Options, Request, Source, depth_images};
use oitlab::scene::{Colors, Material, Mesh, Scene};
use oitlab::techniques::REGISTRY;
use oitlab::weight::WEIGHT;
use std::sync::Arc;
use std::time::Duration;

/// Of the image; next to nothing where `cargo test --benches` only shows that all kernels run.
const SIZE: [u32; 2] = if cfg!(debug_assertions) { [32, 18] } else { [320, 180] };
/// Triangles of a pixel or two each.
const DUST: u32 = 20_000;
/// Triangles of some two thousand pixels each ...
const BLADES: u32 = 300;
/// ... and squares of as many.
const BILLBOARDS: u32 = 300;

fn main() {
    // one thread for everything, and none started anew in every iteration
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build_global();
    pool.expect("nobody has started it yet");
    let brief = Criterion::default()
        .sample_size(10)
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_millis(1200));
    let mut criterion = brief.configure_from_args();
    set_up(&mut criterion);
    coverage(&mut criterion);
    streams(&mut criterion);
    let captured = capture_with(&blades(), &Options::default());
    resolves(&mut criterion, &captured);
    weights(&mut criterion, &captured);
    criterion.final_summary();
}

/// A group of kernels. Samples are of equal size: a slow kernel's would grow beyond the time they have.
fn start<'c>(criterion: &'c mut Criterion, name: &str) -> BenchmarkGroup<'c, WallTime> {
    let mut group = criterion.benchmark_group(name);
    group.sampling_mode(SamplingMode::Flat);
    group
}

/// Projection, set-up and binning.
fn set_up(criterion: &mut Criterion) {
    let mut group = start(criterion, "set up and bin");
    group.throughput(Throughput::Elements(DUST.into()));
    let scene = dust();
    let tile_size = Options::default().tile_size;
    group.bench_function("tiny triangles", |bencher| {
        bencher.iter(|| Raster::new(&scene, tile_size, &|| false).columns());
    });
    group.finish();
}

/// Set-up, coverage and depth, and nothing else.
fn coverage(criterion: &mut Criterion) {
    let mut group = start(criterion, "coverage and depth");
    for (name, scene) in [("tiny triangles", dust()), ("large triangles", blades())] {
        let images = || depth_images(Source::Scene(&scene), &Options::default(), &|| false).unwrap();
        let fragments = images().fragment_count.into_iter().map(u64::from).sum();
        group.throughput(Throughput::Elements(fragments));
        group.bench_function(name, |bencher| bencher.iter(images));
    }
    group.finish();
}

/// What becomes of a tile's fragments: running sums, `over` fed front to back, sorted lists.
fn streams(criterion: &mut Criterion) {
    let mut group = start(criterion, "raster and resolve");
    let (layered, crossing) = (billboards(), blades());
    for (name, scene, id) in [
        ("sums on billboards (wboit)", &layered, "wboit"),
        ("over on billboards (a_buffer)", &layered, "a_buffer"),
        ("sums on crossing triangles (wboit)", &crossing, "wboit"),
        ("lists on crossing triangles (a_buffer)", &crossing, "a_buffer"),
    ] {
        bench_render(&mut group, name, Source::Scene(scene), &request(id, &[]));
    }
    group.finish();
}

/// Every technique from fragments that are there already.
fn resolves(criterion: &mut Criterion, captured: &Fragments) {
    let mut group = start(criterion, "resolve");
    for info in REGISTRY {
        bench_render(&mut group, info.id, Source::Fragments(captured), &request(info.id, &[]));
    }
    group.finish();
}

/// Every published weight, as wboit sums it.
fn weights(criterion: &mut Criterion, captured: &Fragments) {
    let mut group = start(criterion, "weight");
    let Kind::Choice(names) = WEIGHT.kind else { unreachable!("weights are chosen by name") };
    for name in names {
        let request = request("wboit", &[("weight", Input::Text((*name).to_owned()))]);
        bench_render(&mut group, name, Source::Fragments(captured), &request);
    }
    group.finish();
}

/// Times one render, and counts its fragments.
fn bench_render(group: &mut BenchmarkGroup<'_, WallTime>, name: &str, source: Source<'_>, request: &Request) {
    let render = || frames_with(source, std::slice::from_ref(request), &Options::default());
    group.throughput(Throughput::Elements(render()[0].stats.fragments));
    group.bench_function(name, |bencher| bencher.iter(render));
}

/// Tiny triangles all over the image.
fn dust() -> Scene {
    triangles(DUST, [3.0, 1.6, 2.0], 0.1)
}

/// Large triangles that cut through each other.
fn blades() -> Scene {
    triangles(BLADES, [2.0, 1.2, 2.0], 3.0)
}

/// Triangles with centres and corners spread evenly, the centres in a box around the origin.
fn triangles(count: u32, spread: [f64; 3], size: f64) -> Scene {
    let meshes = (0..count).map(|i| {
        let around = |k: u32| random(i, k) - 0.5;
        let center = [0, 1, 2].map(|k| spread[k as usize] * around(k));
        let corner = |n: u32| [0, 1, 2].map(|k| center[k as usize] + size * around(3 + 3 * n + k));
        ([0, 1, 2].map(corner).to_vec(), vec![[0, 1, 2]])
    });
    one_mesh(meshes)
}

/// Squares of constant depth.
fn billboards() -> Scene {
    let squares = (0..BILLBOARDS).map(|i| {
        let [x, y, z] = [0, 1, 2].map(|k| [3.0, 1.6, 2.0][k as usize] * (random(i, k) - 0.5));
        let half = 0.2 + 0.4 * random(i, 3);
        let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
        let vertices = corners.map(|[right, up]| [x + half * right, y + half * up, z]).to_vec();
        (vertices, vec![[0, 1, 2], [0, 2, 3]])
    });
    one_mesh(squares)
}

/// A scene of shapes (vertices and faces), each of its own colour, before a camera at distance 5.
fn one_mesh(shapes: impl Iterator<Item = (Vec<[f64; 3]>, Vec<[u32; 3]>)>) -> Scene {
    let (mut vertices, mut faces, mut colors) = (Vec::new(), Vec::<[u32; 3]>::new(), Vec::new());
    for (i, (corners, sides)) in (0..).zip(shapes) {
        let first = u32::try_from(vertices.len()).expect("a few thousand");
        let color = [0, 1, 2, 3].map(|channel| unit(hash32(i, channel, 0, 0, 0)));
        faces.extend(sides.iter().map(|side| side.map(|corner| first + corner)));
        colors.extend(sides.iter().map(|_| color));
        vertices.extend(corners);
    }
    let mesh = Mesh::new(vertices, faces, Colors::Face(colors), Material::default()).unwrap();
    scene(vec![Arc::new(mesh)], perspective(40.0, 2.0, 8.0), SIZE[0], SIZE[1])
}
