//! Linked lists: one pass over the geometry, into a pool of nodes that grows where it was too small.

use super::draw::{Gpu, Stop, dispatch, group};
use super::draws::flag;
use super::form::{link_module, unlink_module};
use super::layouts::Entry;
use super::lists::{Band, raster_into};
use super::picture::{Picture, buffer};
use super::recorder::{Recorder, Stage, Times};
use crate::error::Result;
use std::ops::Range;
use wgpu::{BindGroup, Buffer, BufferUsages};

/// Bytes of a node, and of the largest of its parts.
const NODE: u64 = 28;
const COLOR: u64 = 16;
/// Nodes per pixel of a pool, at least.
const NODES_PER_PIXEL: u64 = 2;

/// The pixels' first nodes, and all nodes.
#[derive(Debug)]
pub(super) struct Pool {
    group: BindGroup,
    heads: Buffer,
    count: Buffer,
    pixels: u64,
    nodes: u64,
}

impl Pool {
    fn new(gpu: &Gpu, pixels: u64, nodes: u64) -> Self {
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC;
        let storage = |label, bytes| buffer(&gpu.connection, label, bytes, usage);
        let (heads, count) = (storage("heads", 4 * pixels), storage("node count", 4));
        let parts = [("next nodes", 4), ("node keys", 8), ("node colors", COLOR)];
        let parts = parts.map(|(label, bytes)| storage(label, bytes * nodes));
        let all = [&heads, &count, &parts[0], &parts[1], &parts[2]];
        let group = group(&gpu.connection, &gpu.layouts.pool, &all.map(Buffer::as_entire_binding));
        Self { group, heads, count, pixels, nodes }
    }

    pub fn bytes(&self) -> u64 {
        4 * self.pixels + NODE * self.nodes
    }
}

impl Gpu {
    /// Puts the fragments of some rows into the linked lists of their pixels. Those that find no room are counted, and then there is
    /// a pool with room for all of them, into which they are drawn once more.
    ///
    /// # Errors
    /// As [`Gpu::image`].
    pub(super) fn link(
        &mut self,
        picture: &Picture,
        frame: &BindGroup,
        rows: &Range<u32>,
        stop: Stop<'_>,
    ) -> Result<(Pool, Times)> {
        let pixels = u64::from(picture.width) * u64::from(rows.end - rows.start);
        let most = self.most_bytes() / COLOR;
        let kept = self.kept.pool.take();
        let least = (NODES_PER_PIXEL * pixels).min(most);
        let mut pool = match kept {
            Some(pool) if pool.pixels >= pixels && (least..=most).contains(&pool.nodes) => pool,
            _ => Pool::new(self, pixels, least),
        };
        let mut all_times = Times::default();
        loop {
            let Self { connection, layouts, .. } = &mut *self;
            let layout = layouts.pool.clone();
            let mut recorder = Recorder::new(connection, stop);
            recorder.clear(&pool.heads);
            recorder.clear(&pool.count);
            let entry = Entry { module: &link_module(), point: "link_fragment" };
            let target = (&layout, &pool.group);
            raster_into((connection, layouts), &mut recorder, picture, (frame, rows), entry, target)?;
            let (found, times): (Vec<u32>, _) = recorder.finish(&pool.count, 4)?;
            all_times = all_times.plus(times);
            let found = u64::from(found[0]);
            if found <= pool.nodes {
                return Ok((pool, all_times));
            }
            let pixels = pool.pixels;
            drop(pool); // there may not be room for both
            pool = Pool::new(self, pixels, found);
        }
    }
}

impl Band<'_> {
    /// Counts the nodes of each pixel or, once there are places for them, takes the links out of the lists; with the places of
    /// ranks for ids if they are ranked.
    pub(super) fn unlink(&mut self, pool: &Pool, point: &str, is_ranked: bool) -> Result<()> {
        let Self { connection, layouts, recorder, picture, frame, lists, rows } = self;
        let entry = Entry { module: &unlink_module(), point };
        let constants = [("is_ranked", flag(is_ranked))];
        let (third, fourth) = (layouts.lists.clone(), layouts.pool.clone());
        let pipeline =
            layouts.compute_with(&connection.device, entry, false, Some(&third), Some(&fourth), &constants);
        let groups = [*frame, &lists.group, &pool.group];
        dispatch(recorder, Stage::Raster, &pipeline, &groups, picture, rows)
    }
}
