//! How fast the device's memory is, which bounds what blends fragments into targets.

use super::draw::Gpu;
use super::form::copy_module;
use super::picture::buffer;
use super::recorder::{Recorder, Stage};
use super::shared::with_gpu;
use crate::error::{Error, Result};
use wgpu::{
    BindGroupDescriptor, BindGroupEntry, BufferUsages, ComputePipelineDescriptor, PipelineCompilationOptions,
    ShaderModuleDescriptor, ShaderSource,
};

/// Bytes that are copied at a time, at most: more than caches hold.
const MOST_BYTES: u64 = 256 << 20;
/// Bytes that a workgroup copies.
const BYTES_OF_A_GROUP: u64 = 16 * 256;
/// Copies, of which the fastest counts; the first one makes the memory.
const COPIES: usize = 6;

/// Bytes per second that a compute shader reads and writes together when it copies a large buffer, at best.
///
/// # Errors
/// [`Error::Gpu`] without a device, [`Error::Memory`], [`Error::Cancelled`].
pub fn copy_bandwidth(stop: &(dyn Fn() -> bool + Sync)) -> Result<f64> {
    with_gpu(|shared| shared.gpu().copy_bandwidth(stop))
}

impl Gpu {
    fn copy_bandwidth(&self, stop: &(dyn Fn() -> bool + Sync)) -> Result<f64> {
        let device = &self.connection.device;
        let bytes = self.most_bytes().min(MOST_BYTES) / BYTES_OF_A_GROUP * BYTES_OF_A_GROUP;
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC;
        let buffers = ["source", "copied"].map(|label| buffer(&self.connection, label, bytes, usage));
        let source = ShaderSource::Wgsl(copy_module().into());
        let module = device.create_shader_module(ShaderModuleDescriptor { label: Some("copy"), source });
        let pipeline = device.create_compute_pipeline(&ComputePipelineDescriptor {
            label: Some("copy"),
            layout: None,
            module: &module,
            entry_point: Some("copy"),
            compilation_options: PipelineCompilationOptions::default(),
            cache: None,
        });
        let entries = buffers
            .iter()
            .zip(0..)
            .map(|(buffer, binding)| BindGroupEntry { binding, resource: buffer.as_entire_binding() });
        let group = device.create_bind_group(&BindGroupDescriptor {
            label: Some("copy"),
            layout: &pipeline.get_bind_group_layout(0),
            entries: &entries.collect::<Vec<_>>(),
        });
        let most = self.connection.limits.max_compute_workgroups_per_dimension;
        let groups = u32::try_from(bytes / BYTES_OF_A_GROUP).unwrap_or(u32::MAX);
        let mut fastest = f64::INFINITY;
        for _ in 0..COPIES {
            let mut recorder = Recorder::of_compute(&self.connection, stop);
            recorder.compute(Stage::Resolve, |pass| {
                pass.set_pipeline(&pipeline);
                pass.set_bind_group(0, &group, &[]);
                pass.dispatch_workgroups(groups.min(most), groups.div_ceil(most), 1);
            })?;
            let (_, times) = recorder.finish::<u32>(&buffers[1], 4)?;
            fastest = fastest.min(times.resolve);
        }
        if fastest <= 0.0 {
            let device = &self.connection.info.name;
            return Err(Error::Gpu(format!("{device} copies {bytes} bytes in no time that it tells")));
        }
        #[expect(clippy::cast_precision_loss, reason = "a whole number of less than 2^53")]
        let copied = 2.0 * bytes as f64;
        Ok(copied / (1e-3 * fastest))
    }
}
