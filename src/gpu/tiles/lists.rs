//! Lists that tiles fill: for what looks at all fragments of a pixel at once, or keeps some by depth.

use super::plan::{Plan, pixel_rows};
use super::{BIN, Bins, Drawing, TILE, check_bin};
use crate::error::Result;
use crate::gpu::device::Connection;
use crate::gpu::draw::{Gpu, Image, Stop};
use crate::gpu::draws::flag;
use crate::gpu::form::{Form, Sorting};
use crate::gpu::layouts::Layouts;
use crate::gpu::lists::Origin;
use crate::gpu::picture::Picture;
use crate::gpu::recorder::{Recorder, Stage};
use std::ops::Range;
use wgpu::BindGroup;

/// Rows of bins whose tiles are filled, out of which lists are.
pub struct TiledRows<'a> {
    bins: &'a Bins,
    drawing: &'a Drawing<'a>,
    rows: &'a Range<u32>,
}

impl TiledRows<'_> {
    /// Counts the fragments of some rows of pixels or, if it `stores`, puts them into their lists, in the order in which they are
    /// drawn.
    ///
    /// # Errors
    /// As [`Recorder::compute`].
    pub fn raster(
        &self,
        (connection, layouts): (&Connection, &mut Layouts),
        recorder: &mut Recorder<'_>,
        frame: &BindGroup,
        lists: &BindGroup,
        (extent, stores): ((u32, u32), bool),
    ) -> Result<()> {
        let mut constants = self.drawing.constants.clone();
        constants.push(("stores", flag(stores)));
        let (layout, lists_layout) = (self.drawing.layout.clone(), layouts.lists.clone());
        let written = Some((lists_layout, lists.clone()));
        let drawing = Drawing { constants, layout, written, ..*self.drawing };
        let kernel = self.bins.kernel((connection, layouts), &drawing, self.rows, extent);
        recorder.compute(Stage::Raster, |pass| {
            pass.set_bind_group(0, frame, &[]);
            pass.set_bind_group(1, &self.bins.geometry, &[]);
            kernel.record(pass);
        })
    }
}

impl Gpu {
    /// Fills lists and has the form make the image of them, in as many parts as their number asks for.
    pub(super) fn tiled_lists(
        &mut self,
        picture: &Picture,
        form: &Form,
        plan: &Plan,
        drawing: &Drawing<'_>,
        stop: Stop<'_>,
    ) -> Result<Image> {
        let Some(reader) = form.list_reader() else { unreachable!("it is made of lists") };
        let rows_per_band = self.rows_per_band(picture, form);
        let bands = plan.parts.iter().map(|part| {
            let rows = pixel_rows(picture.height, plan.side, &part.rows);
            self.bands_of_fragments(picture, &rows, TILE, rows_per_band)
        });
        let bands = bands.collect::<Result<Vec<_>>>()?;
        let lists = self.lists_for(picture, &bands.concat(), None);
        let bins = Bins::of_plan(self, picture, plan);
        let params: Vec<_> = form.numbers.iter().map(|number| number.bits()).collect();
        let module = form.module();
        let mut image = Image::default();
        for (part, bands) in plan.parts.iter().zip(&bands) {
            let frame = self.frame(picture, &pixel_rows(picture.height, plan.side, &part.rows), &[]);
            let Self { connection, layouts, .. } = &mut *self;
            let binning = bins.binning((connection, layouts), &part.rows, true);
            let mut recorder = Recorder::of_compute(connection, stop);
            recorder.clear(&bins.cells);
            recorder.compute(Stage::Raster, |pass| bins.record(pass, &frame, &binning))?;
            let (first_bin, times): (Vec<u32>, _) = recorder.finish(&bins.cells, 4 * BIN as u64)?;
            check_bin(connection, &first_bin)?;
            image.times = image.times.plus(times);
            let tiles = TiledRows { bins: &bins, drawing, rows: &part.rows };
            for rows in bands {
                let frame = self.frame(picture, rows, &params);
                let mut band = self.band(picture, &frame, &lists, rows, |on| Recorder::of_compute(on, stop));
                band.fill(Origin::Tiles(&tiles), false)?;
                image.times = image.times.plus(band.check_counts(stop)?);
                band.keep_first(form.capacity())?;
                // any other order is the one in which they are drawn
                if reader.sorted == Sorting::Depth {
                    band.sort(Sorting::Depth)?;
                }
                band.resolve(form, &module, &reader, &mut image)?;
            }
        }
        Ok(image)
    }
}
