//! Techniques that the caller brings: beside the registry's, with errors, in batches as large as a tile.

#![allow(clippy::cast_possible_truncation, reason = "small numbers, chosen here")]

mod common;

use common::{capture_with, frames_with, perspective, request, scene, soup};
use oitlab::diagnosis::{Diagnosis, Faults};
use oitlab::error::{Error, Result};
use oitlab::frame::Frame;
use oitlab::order::SubmissionOrder;
use oitlab::params::View;
use oitlab::render::{Custom, Options, Request, Source, order_sensitivity, render, transmittance};
use oitlab::scene::Scene;
use oitlab::technique::{AnyTechnique, Batch, Cost, DepthComplexity, Pixel, Properties, Resolved, Streamed};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// What a technique was called with.
#[derive(Default)]
struct Calls {
    batches: AtomicUsize,
    most_pixels: AtomicUsize,
}

#[derive(Debug, PartialEq, thiserror::Error)]
#[error("pixel ({x}, {y}) is too deep")]
struct TooDeep {
    x: u32,
    y: u32,
}

/// `over` of sorted fragments, or of fragments as they come, that gives up on pixels deeper than `limit`.
struct Over {
    sorted: bool,
    limit: usize,
    calls: Arc<Calls>,
}

impl Over {
    fn pixel(&self, pixel: &Pixel<'_>) -> Result<Resolved> {
        let list = if self.sorted { pixel.sorted } else { pixel.list };
        if list.len() > self.limit {
            return Err(Error::raised(TooDeep { x: pixel.x, y: pixel.y }));
        }
        let (mut color, mut share) = (glam::DVec3::ZERO, 1.0);
        for fragment in list.iter() {
            color += share * glam::Vec3::from(fragment.color).as_dvec3();
            share *= 1.0 - f64::from(fragment.alpha);
        }
        Ok(Resolved::new(color + share * pixel.background, share))
    }
}

impl AnyTechnique for Over {
    fn needs_sorted(&self) -> bool {
        self.sorted
    }
    fn needs_arrival(&self) -> bool {
        !self.sorted
    }
    fn streamed(&self) -> Option<Streamed<'_>> {
        None
    }
    fn sees_zero_fragments(&self) -> bool {
        false
    }
    fn colored_transmittance(&self) -> bool {
        false
    }
    fn wants_large_batches(&self) -> bool {
        true
    }
    fn transmittance(&self, pixel: &Pixel<'_>, depths: &[f32]) -> Option<Vec<f64>> {
        self.try_transmittance(pixel, depths).ok().flatten()
    }
    fn try_transmittance(&self, pixel: &Pixel<'_>, depths: &[f32]) -> Result<Option<Vec<f64>>> {
        let Resolved { transmittance, .. } = self.pixel(pixel)?;
        Ok(Some(vec![transmittance.x; depths.len()]))
    }
    fn faults(&self) -> Faults {
        Faults::NONE
    }
    fn diagnose(&self, _: &Pixel<'_>) -> Diagnosis {
        Diagnosis::CLEAR
    }
    fn cost(&self, _: &DepthComplexity) -> Cost {
        Cost { geometry_passes: 1.0, bytes_per_pixel: 16.0 }
    }
    fn properties(&self) -> Properties {
        Properties::NONE
    }
    fn resolve_batch(
        &self,
        batch: &Batch<'_>,
        pixels: &[u32],
        out: &mut [Resolved],
        _: &dyn Fn() -> bool,
    ) -> Result<()> {
        self.calls.batches.fetch_add(1, Ordering::Relaxed);
        self.calls.most_pixels.fetch_max(pixels.len(), Ordering::Relaxed);
        for &i in pixels {
            out[i as usize] = self.pixel(&batch.pixel(i as usize))?;
        }
        Ok(())
    }
}

fn own(identity: &str, sorted: bool, limit: usize, calls: &Arc<Calls>) -> Request {
    let calls = Arc::clone(calls);
    let make = move |_: &View| -> Result<Box<dyn AnyTechnique>> {
        Ok(Box::new(Over { sorted, limit, calls: Arc::clone(&calls) }))
    };
    Request::Custom(Custom {
        id: "mine",
        identity: identity.to_owned(),
        order: SubmissionOrder::AsIs,
        make: Arc::new(make),
    })
}

fn deep_scene() -> Scene {
    scene(vec![soup(1500, |i| i)], perspective(70.0, 0.5, 12.0), 61, 47)
}

fn assert_same(a: &Frame, b: &Frame) {
    assert!(a.color == b.color, "{} and {}", a.technique, b.technique);
    assert!(a.transmittance == b.transmittance, "{} and {}", a.technique, b.technique);
}

#[test]
fn it_gives_the_same_bits_from_a_scene_a_capture_and_without_skips() {
    let (scene, calls) = (deep_scene(), Arc::new(Calls::default()));
    let fragments = capture_with(&scene, &Options::default());
    for sorted in [true, false] {
        let requests = [own("", sorted, usize::MAX, &calls)];
        let plain = frames_with(Source::Scene(&scene), &requests, &Options::default()).remove(0);
        let captured = frames_with(Source::Fragments(&fragments), &requests, &Options::default()).remove(0);
        let full = Options { skip: false, threads: Some(3), tile_size: 16, max_fragments: 500 };
        let parts = frames_with(Source::Scene(&scene), &requests, &full).remove(0);
        assert_same(&plain, &captured);
        assert_same(&plain, &parts);
        assert_eq!(plain.technique, "mine");
        assert_eq!(plain.stats.bytes_per_pixel, 16.0);
    }
}

#[test]
fn beside_others_nothing_changes() {
    let (scene, calls) = (deep_scene(), Arc::new(Calls::default()));
    let mine = [own("a", true, usize::MAX, &calls), own("b", false, usize::MAX, &calls)];
    let others = ["a_buffer", "mlab", "wboit", "alpha_compositing"].map(|id| request(id, &[]));
    let all = frames_with(Source::Scene(&scene), &[&mine[..], &others[..]].concat(), &Options::default());
    for (request, together) in mine.iter().chain(&others).zip(&all) {
        let alone = frames_with(Source::Scene(&scene), std::slice::from_ref(request), &Options::default());
        assert_same(&alone[0], together);
    }
    assert!(all[0].color != all[1].color, "submission order is not depth order");
}

#[test]
fn it_is_called_once_for_a_tile_and_once_for_equal_requests() {
    let scene = deep_scene();
    for (first, second, batches) in [("a", "a", 1), ("a", "b", 2)] {
        let calls = Arc::new(Calls::default());
        let requests = [own(first, true, usize::MAX, &calls), own(second, true, usize::MAX, &calls)];
        let frames = frames_with(Source::Scene(&scene), &requests, &Options::default());
        assert!(frames[0].stats.fragments > 8192, "no more than some batches that fit the cache");
        assert_eq!(calls.batches.load(Ordering::Relaxed), batches);
        assert_same(&frames[0], &frames[1]);
    }
}

#[test]
fn its_errors_come_back_as_they_are() {
    let (scene, calls) = (deep_scene(), Arc::new(Calls::default()));
    let fragments = capture_with(&scene, &Options::default());
    let requests = [request("a_buffer", &[]), own("", true, 3, &calls)];
    let sensitivity =
        order_sensitivity(&fragments, &requests[1], 2, 0, &Options::default(), &|| false).map(|_| ());
    let lists = fragments.lists.as_ref();
    let deep = (0..lists.len()).find(|&i| lists.count(i) > 3).expect("a deep pixel") as u32;
    let curve = transmittance(&fragments, &requests[1], (deep % 61, deep / 61), &[1.0]).map(|_| ());
    let mut results = vec![sensitivity, curve];
    for source in [Source::Scene(&scene), Source::Fragments(&fragments)] {
        results.push(render::<f32>(source, &requests, &Options::default(), &|| false).map(|_| ()));
    }
    for result in results {
        let Err(Error::Raised(raised)) = result else { panic!("{result:?} is no error of the technique") };
        let TooDeep { x, y } = *raised.0.downcast_ref().expect("the error that it raised");
        assert!(lists.count((y * 61 + x) as usize) > 3, "({x}, {y})");
        assert!(raised.to_string().ends_with("is too deep"));
    }
}

#[test]
fn order_sensitivity_shuffles_what_comes_as_submitted() {
    let (scene, calls) = (deep_scene(), Arc::new(Calls::default()));
    let fragments = capture_with(&scene, &Options::default());
    let variance = |sorted| {
        let request = own("", sorted, usize::MAX, &calls);
        order_sensitivity(&fragments, &request, 4, 0, &Options::default(), &|| false).unwrap()
    };
    assert!(variance(true).iter().all(|v| *v == 0.0));
    assert!(variance(false).iter().any(|v| *v > 1e-3));
    assert_eq!(calls.most_pixels.load(Ordering::Relaxed).min(1000), 1000, "batches are large");
}
