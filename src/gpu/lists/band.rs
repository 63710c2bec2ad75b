//! Lists of some rows on their way through the device.

use super::super::device::Connection;
use super::super::draw::{Image, Stop, attachment, dispatch, draw_primitives, resolve};
use super::super::draws::flag;
use super::super::form::{Capacity, Form, ListReader, Sorting, list_module};
use super::super::layouts::{Entry, Layouts, Reads, plain};
use super::super::linked::Pool;
use super::super::picture::{Picture, texture};
use super::super::recorder::{Recorder, Stage, Times};
use super::super::tiles::TiledRows;
use super::ListBuffers;
use crate::error::{Error, Result};
use std::ops::Range;
use std::sync::Arc;
use wgpu::{
    BindGroup, BindGroupLayout, Color, ColorWrites, ComputePipeline, LoadOp, StoreOp, TextureFormat,
    TextureUsages, TextureViewDescriptor,
};

/// Lists of some rows on their way through the device.
pub(in crate::gpu) struct Band<'a> {
    pub connection: &'a Connection,
    pub layouts: &'a mut Layouts,
    pub recorder: Recorder<'a>,
    pub picture: &'a Picture,
    pub frame: &'a BindGroup,
    pub lists: &'a ListBuffers,
    pub rows: &'a Range<u32>,
}

/// Where the fragments of a band come from.
#[derive(Clone, Copy)]
pub(in crate::gpu) enum Origin<'a> {
    /// The device's own raster, which counts them before it stores them.
    Raster,
    /// Linked lists, into which they have been drawn.
    Linked(&'a Pool),
    /// Tiles, in the order in which they are drawn.
    Tiles(&'a TiledRows<'a>),
}

/// What becomes of fragments, with the entry point of the device's own raster.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Filling {
    Counts,
    Lists,
    /// With the places of ranks for ids.
    RankedLists,
}

impl Filling {
    fn point(self) -> &'static str {
        match self {
            Self::Counts => "count_fragment",
            Self::Lists => "store_fragment",
            Self::RankedLists => "store_ranked_fragment",
        }
    }
}

impl<'a> Band<'a> {
    /// How many fragments each pixel and each row has, and where in its row each pixel's go.
    pub(in crate::gpu) fn count(&mut self, origin: Origin<'_>) -> Result<()> {
        self.recorder.clear(&self.lists.counts);
        self.hand_over(origin, Filling::Counts)?;
        let pipeline = self.kernel("sum_rows", &[]);
        let Self { recorder, frame, lists, rows, .. } = self;
        recorder.compute(Stage::Raster, |pass| {
            pass.set_pipeline(&pipeline);
            pass.set_bind_group(0, *frame, &[]);
            pass.set_bind_group(2, &lists.group, &[]);
            pass.dispatch_workgroups(rows.end - rows.start, 1, 1);
        })
    }

    /// Stores the fragments, with the places of ranks for ids if lists are ranked. They are counted once more than their number
    /// is asked for, so that the time is that of a frame.
    ///
    /// # Errors
    /// As [`Recorder::compute`].
    pub(in crate::gpu) fn fill(&mut self, origin: Origin<'_>, is_ranked: bool) -> Result<()> {
        self.count(origin)?;
        self.step(Stage::Raster, "shift_rows", &[])?;
        self.hand_over(origin, if is_ranked { Filling::RankedLists } else { Filling::Lists })
    }

    /// Refuses rows of other numbers of fragments than the device's own raster has found, which there is room for. What has been
    /// recorded is done by then; the time that it took.
    ///
    /// # Errors
    /// [`Error::Gpu`] naming the row, and as [`Recorder::finish`].
    pub(in crate::gpu) fn check_counts(&mut self, stop: Stop<'a>) -> Result<Times> {
        let Self { connection, recorder, picture, lists, rows, .. } = self;
        let recorded = std::mem::replace(recorder, Recorder::of_compute(connection, stop));
        let (sums, times) = recorded.finish::<[u32; 2]>(&lists.row_sums, 8 * u64::from(picture.height))?;
        let both = sums.iter().zip(&picture.rows).zip(0..);
        let here = both.filter(|(_, row)| rows.contains(row));
        for (([found, deepest], [counted, _]), row) in here {
            if deepest >> 31 == 1 {
                return Err(connection.cut_short());
            }
            if found != counted {
                return Err(Error::Gpu(format!(
                    "tiles have {found} fragments in row {row}, and the raster of {} {counted}; path=\"hardware\" uses that alone",
                    connection.info.name
                )));
            }
        }
        Ok(times)
    }

    /// Sorts every list.
    ///
    /// # Errors
    /// As [`Recorder::compute`].
    pub(in crate::gpu) fn sort(&mut self, sorting: Sorting) -> Result<()> {
        let sorting = match sorting {
            Sorting::Depth => 0.0,
            Sorting::Submission => 1.0,
            Sorting::Rank => 2.0,
        };
        self.step(Stage::Resolve, "sort_lists", &[("sorting", sorting)])
    }

    /// Leaves as many fragments of each list as there may be, the first ones.
    ///
    /// # Errors
    /// As [`Recorder::compute`].
    pub(in crate::gpu) fn keep_first(&mut self, capacity: Option<Capacity>) -> Result<()> {
        let Some(capacity) = capacity else { return Ok(()) };
        self.sort(capacity.sorted)?;
        let constants =
            [("list_capacity", capacity.fragments.into()), ("drops_backwards", flag(capacity.backwards))];
        self.step(Stage::Resolve, "drop_fragments", &constants)
    }

    /// Something that is done to every list.
    pub(in crate::gpu) fn step(
        &mut self,
        stage: Stage,
        point: &str,
        constants: &[(&str, f64)],
    ) -> Result<()> {
        let pipeline = self.kernel(point, constants);
        let groups = [self.frame, &self.lists.group];
        dispatch(&mut self.recorder, stage, &pipeline, &groups, self.picture, self.rows)
    }

    fn kernel(&mut self, point: &str, constants: &[(&str, f64)]) -> Arc<ComputePipeline> {
        let entry = Entry { module: &list_module(), point };
        self.layouts.compute(&self.connection.device, entry, Reads::Lists, false, constants)
    }

    /// Counts the fragments, or stores them.
    fn hand_over(&mut self, origin: Origin<'_>, filling: Filling) -> Result<()> {
        let counts = filling == Filling::Counts;
        match origin {
            Origin::Linked(pool) => {
                let point = if counts { "count_nodes" } else { "unlink" };
                self.unlink(pool, point, filling == Filling::RankedLists)
            }
            Origin::Tiles(tiles) => {
                let Self { connection, layouts, recorder, picture, frame, lists, rows } = self;
                let extent = (picture.width, rows.end - rows.start);
                tiles.raster((connection, layouts), recorder, frame, &lists.group, (extent, !counts))
            }
            Origin::Raster => {
                let Self { connection, layouts, recorder, picture, frame, lists, rows } = self;
                let entry = Entry { module: &list_module(), point: filling.point() };
                let (layout, at) = (layouts.lists.clone(), (*frame, *rows));
                raster_into((connection, layouts), recorder, picture, at, entry, (&layout, &lists.group))
            }
        }
    }

    /// Makes the image of the lists.
    ///
    /// # Errors
    /// As [`Gpu::image`].
    pub(in crate::gpu) fn resolve(
        self,
        form: &Form,
        module: &str,
        reader: &ListReader,
        image: &mut Image,
    ) -> Result<()> {
        let Self { connection, layouts, recorder, picture, frame, lists, rows } = self;
        let constants: Vec<_> = picture.knowledge().iter().chain(&reader.constants).copied().collect();
        let entry = Entry { module, point: reader.point };
        let pipeline = layouts.compute(&connection.device, entry, Reads::Lists, true, &constants);
        let groups = [frame, &lists.group];
        resolve(connection, layouts, recorder, picture, form, rows, &pipeline, groups, image)
    }
}

/// Draws all fragments of some rows into buffers, which are group 2. A pass wants a target, which nothing is drawn into.
pub(in crate::gpu) fn raster_into(
    (connection, layouts): (&Connection, &mut Layouts),
    recorder: &mut Recorder<'_>,
    picture: &Picture,
    (frame, rows): (&BindGroup, &Range<u32>),
    entry: Entry<'_>,
    (layout, buffers): (&BindGroupLayout, &BindGroup),
) -> Result<()> {
    let format = TextureFormat::R8Unorm;
    let size = (picture.width, rows.end - rows.start);
    let unused = texture(connection, "none", size, format, TextureUsages::RENDER_ATTACHMENT);
    let unused = unused.create_view(&TextureViewDescriptor::default());
    let states = [plain(format, ColorWrites::empty())];
    let draws = picture.draws(true);
    let pipeline = layouts.render_with(&connection.device, entry, draws, &states, Some(layout), None);
    let target = attachment(&unused, LoadOp::Clear(Color::TRANSPARENT), StoreOp::Discard);
    recorder.render(Stage::Raster, &[target], |pass| {
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, frame, &[]);
        pass.set_bind_group(2, buffers, &[]);
        draw_primitives(pass, picture, rows, 0);
    })
}
