//! Commands on their way to the device, the time that they take there, and what they bring back.

use super::canvas::Canvas;
use super::device::Connection;
use super::picture::buffer;
use crate::error::{Error, Result};
use std::sync::mpsc::channel;
use std::time::Instant;
use wgpu::{
    Buffer, BufferUsages, CommandEncoder, CommandEncoderDescriptor, ComputePass, ComputePassDescriptor,
    ComputePassTimestampWrites, DeviceType, Features, LoadOp, MapMode, Operations, QuerySet,
    QuerySetDescriptor, QueryType, RenderPass, RenderPassColorAttachment, RenderPassDepthStencilAttachment,
    RenderPassDescriptor, RenderPassTimestampWrites, StoreOp, TextureView,
};

/// What a pass belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    Raster,
    Resolve,
}

/// Milliseconds of each stage.
#[derive(Debug, Clone, Copy, Default)]
pub struct Times {
    pub raster: f64,
    pub resolve: f64,
}

impl Times {
    pub fn add(&mut self, stage: Stage, ms: f64) {
        match stage {
            Stage::Raster => self.raster += ms,
            Stage::Resolve => self.resolve += ms,
        }
    }
    pub fn plus(self, other: Self) -> Self {
        Self { raster: self.raster + other.raster, resolve: self.resolve + other.resolve }
    }
}

/// Passes that are timed by one recorder, unless it is told to expect more.
pub const PASSES: u32 = 16;
/// Two stamps each fill a set (`wgpu` limits them to 4096).
const MOST_PASSES: u32 = 2048;

/// Records passes and times each; where the device has no timestamps it is waited for after each, and the clock on the wall
/// has to do.
pub struct Recorder<'a> {
    connection: &'a Connection,
    stop: &'a (dyn Fn() -> bool + Sync),
    encoder: CommandEncoder,
    stamps: Option<QuerySet>,
    stages: Vec<Stage>,
    walls: Times,
}

fn encoder(connection: &Connection) -> CommandEncoder {
    connection.device.create_command_encoder(&CommandEncoderDescriptor { label: Some("oitlab") })
}

impl<'a> Recorder<'a> {
    pub fn new(connection: &'a Connection, stop: &'a (dyn Fn() -> bool + Sync)) -> Self {
        Self::expecting(PASSES, connection, stop)
    }

    /// One of compute passes that follow each other. Between stamps, drivers for the processor lose most of their time, also where
    /// each is submitted by itself: there the clock on the wall has to do.
    pub fn of_compute(connection: &'a Connection, stop: &'a (dyn Fn() -> bool + Sync)) -> Self {
        let mut recorder = Self::new(connection, stop);
        if connection.info.device_type == DeviceType::Cpu {
            recorder.stamps = None;
        }
        recorder
    }

    /// One with room for the stamps of so many passes; beyond what a set holds they are waited for.
    pub fn expecting(passes: u32, connection: &'a Connection, stop: &'a (dyn Fn() -> bool + Sync)) -> Self {
        let has_stamps = connection.features.contains(Features::TIMESTAMP_QUERY) && passes <= MOST_PASSES;
        let descriptor = QuerySetDescriptor { label: None, ty: QueryType::Timestamp, count: 2 * passes };
        Self {
            connection,
            stop,
            encoder: encoder(connection),
            stamps: has_stamps.then(|| connection.device.create_query_set(&descriptor)),
            stages: Vec::new(),
            walls: Times::default(),
        }
    }

    /// Records a render pass.
    ///
    /// # Errors
    /// [`Error::Cancelled`], or [`Error::Gpu`] if it had to be waited for in vain.
    pub fn render(
        &mut self,
        stage: Stage,
        attachments: &[Option<RenderPassColorAttachment<'_>>],
        record: impl FnOnce(&mut RenderPass<'_>),
    ) -> Result<()> {
        self.render_with_depth(stage, attachments, None, record)
    }

    /// The same with a depth buffer that is empty at first.
    ///
    /// # Errors
    /// As [`Recorder::render`].
    pub fn render_with_depth(
        &mut self,
        stage: Stage,
        attachments: &[Option<RenderPassColorAttachment<'_>>],
        depth: Option<(&TextureView, StoreOp)>,
        record: impl FnOnce(&mut RenderPass<'_>),
    ) -> Result<()> {
        let depth = depth.map(|(view, store)| RenderPassDepthStencilAttachment {
            view,
            depth_ops: Some(Operations { load: LoadOp::Clear(1.0), store }),
            stencil_ops: None,
        });
        let first = self.next(stage);
        let stamps = self.stamps.as_ref().map(|query_set| RenderPassTimestampWrites {
            query_set,
            beginning_of_pass_write_index: Some(first),
            end_of_pass_write_index: Some(first + 1),
        });
        let mut pass = self.encoder.begin_render_pass(&RenderPassDescriptor {
            label: None,
            color_attachments: attachments,
            depth_stencil_attachment: depth,
            timestamp_writes: stamps,
            occlusion_query_set: None,
            multiview_mask: None,
        });
        record(&mut pass);
        drop(pass);
        self.end_of_pass(stage)
    }

    /// Records a compute pass.
    ///
    /// # Errors
    /// As [`Recorder::render`].
    pub fn compute(&mut self, stage: Stage, record: impl FnOnce(&mut ComputePass<'_>)) -> Result<()> {
        let first = self.next(stage);
        let stamps = self.stamps.as_ref().map(|query_set| ComputePassTimestampWrites {
            query_set,
            beginning_of_pass_write_index: Some(first),
            end_of_pass_write_index: Some(first + 1),
        });
        let mut pass =
            self.encoder.begin_compute_pass(&ComputePassDescriptor { label: None, timestamp_writes: stamps });
        record(&mut pass);
        drop(pass);
        self.end_of_pass(stage)
    }

    /// Sets a buffer to zero.
    pub fn clear(&mut self, buffer: &Buffer) {
        self.encoder.clear_buffer(buffer, 0, None);
    }

    /// The first of the pass's two stamps.
    #[expect(clippy::cast_possible_truncation, reason = "few passes")]
    fn next(&mut self, stage: Stage) -> u32 {
        self.stages.push(stage);
        2 * (self.stages.len() as u32 - 1)
    }

    fn end_of_pass(&mut self, stage: Stage) -> Result<()> {
        if self.stamps.is_some() {
            return Ok(());
        }
        let recorded = std::mem::replace(&mut self.encoder, encoder(self.connection));
        let start = Instant::now();
        let submission = self.connection.queue.submit([recorded.finish()]);
        self.connection.wait(&submission, self.stop)?;
        self.walls.add(stage, start.elapsed().as_secs_f64() * 1e3);
        Ok(())
    }

    /// Submits everything and waits for it; the first bytes of a buffer, and how long the stages took.
    ///
    /// # Errors
    /// [`Error::Cancelled`], [`Error::Memory`] or [`Error::Gpu`].
    pub fn finish<T: bytemuck::Pod>(self, source: &Buffer, bytes: u64) -> Result<(Vec<T>, Times)> {
        let (landed, times) = self.finish_all(&[(source, bytes)])?;
        Ok((read(&landed[0], bytes)?, times))
    }

    /// The same for several buffers, as others that can be [`read`].
    ///
    /// # Errors
    /// As [`Recorder::finish`].
    pub fn finish_all(mut self, sources: &[(&Buffer, u64)]) -> Result<(Vec<Buffer>, Times)> {
        let mut landed = Vec::new();
        for (source, bytes) in sources {
            let landing = buffer(self.connection, "readback", *bytes, BufferUsages::MAP_READ);
            self.encoder.copy_buffer_to_buffer(source, 0, &landing, 0, *bytes);
            landed.push(landing);
        }
        let times = self.land(&landed.iter().collect::<Vec<_>>())?;
        Ok((landed, times))
    }

    /// The same for some rows of an image.
    ///
    /// # Errors
    /// As [`Recorder::finish`].
    pub fn finish_canvas(mut self, canvas: &Canvas, rows: u32) -> Result<Times> {
        canvas.land(&mut self.encoder, rows);
        self.land(&[canvas.landing()])
    }

    /// Submits everything, and waits until it is done and these buffers can be read.
    fn land(mut self, landings: &[&Buffer]) -> Result<Times> {
        let connection = self.connection;
        let stamps = self.land_stamps();
        let submission = connection.queue.submit([self.encoder.finish()]);
        let (sender, receiver) = channel();
        for landing in landings.iter().copied().chain(&stamps) {
            let sender = sender.clone();
            landing.slice(..).map_async(MapMode::Read, move |mapped| _ = sender.send(mapped.is_ok()));
        }
        drop(sender);
        connection.wait(&submission, self.stop)?;
        if !receiver.iter().all(|mapped| mapped) {
            return Err(Error::Gpu("what was made could not be read back".to_owned()));
        }
        let mut times = self.walls;
        if let Some(landing) = &stamps {
            let ticks: Vec<u64> = read(landing, 16 * self.stages.len() as u64)?;
            let period = f64::from(connection.queue.get_timestamp_period()) * 1e-6;
            for (stage, stamps) in self.stages.iter().zip(ticks.chunks(2)) {
                #[expect(clippy::cast_precision_loss, reason = "a duration in milliseconds")]
                times.add(*stage, stamps[1].saturating_sub(stamps[0]) as f64 * period);
            }
        }
        Ok(times)
    }

    /// Has the stamps copied to where they can be read.
    #[expect(clippy::cast_possible_truncation, reason = "few passes")]
    fn land_stamps(&mut self) -> Option<Buffer> {
        let stamps = self.stamps.take()?;
        let count = 2 * self.stages.len() as u64;
        let usage = BufferUsages::QUERY_RESOLVE | BufferUsages::COPY_SRC;
        let resolved = buffer(self.connection, "stamps", 8 * count, usage);
        let landing = buffer(self.connection, "stamps", 8 * count, BufferUsages::MAP_READ);
        self.encoder.resolve_query_set(&stamps, 0..count as u32, &resolved, 0);
        self.encoder.copy_buffer_to_buffer(&resolved, 0, &landing, 0, 8 * count);
        Some(landing)
    }
}

/// The first bytes of a buffer that has landed.
///
/// # Errors
/// [`Error::Gpu`] if it has not.
pub fn read<T: bytemuck::Pod>(buffer: &Buffer, bytes: u64) -> Result<Vec<T>> {
    let view = buffer.slice(..bytes).get_mapped_range();
    let view = view.map_err(|error| Error::Gpu(format!("what was made could not be read back: {error}")))?;
    Ok(bytemuck::pod_collect_to_vec(&view))
}
