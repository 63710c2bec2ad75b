//! How shaders and buffers meet: bind group layouts, pipelines (made once each), formats and blend functions.

use super::device::Connection;
use super::form::{Blend, BlendTarget, Blending};
use crate::error::{Error, Result};
use crate::format::Format;
use std::collections::HashMap;
use std::sync::Arc;
use wgpu::{
    BindGroupLayout, BindGroupLayoutDescriptor, BindGroupLayoutEntry, BindingType, BlendComponent,
    BlendFactor, BlendOperation, BlendState, BufferBindingType, ColorTargetState, ColorWrites,
    ComputePipeline, DepthStencilState, Device, Features, RenderPipeline, ShaderModule, ShaderStages,
    StorageTextureAccess, TextureFormat, TextureFormatFeatureFlags, TextureSampleType, TextureUsages,
    TextureViewDimension,
};

/// Most render targets that a technique has.
const TARGETS: u32 = 2;

/// Everything that is made once per device.
#[derive(Debug)]
pub struct Layouts {
    /// Group 0: the image at hand, opaque surfaces and the technique's params.
    pub frame: BindGroupLayout,
    /// Group 1: primitives.
    pub geometry: BindGroupLayout,
    /// Group 2 of a resolve: render targets.
    pub targets: BindGroupLayout,
    /// Group 2 of whoever keeps lists.
    pub lists: BindGroupLayout,
    /// Group 2 of peeling: the frontier as keys or as depths, a texture, and whether anything was peeled.
    pub peeled_keys: BindGroupLayout,
    /// See [`Layouts::peeled_keys`].
    pub peeled_depths: BindGroupLayout,
    /// Group 2 of the raster in compute that writes no textures.
    pub tiles: BindGroupLayout,
    /// Group 3: the image.
    pub output: BindGroupLayout,
    modules: HashMap<String, ShaderModule>,
    renders: HashMap<String, Arc<RenderPipeline>>,
    computes: HashMap<String, Arc<ComputePipeline>>,
}

fn entry(binding: u32, ty: BindingType) -> BindGroupLayoutEntry {
    BindGroupLayoutEntry {
        binding,
        visibility: ShaderStages::VERTEX_FRAGMENT | ShaderStages::COMPUTE,
        ty,
        count: None,
    }
}

fn buffer(ty: BufferBindingType) -> BindingType {
    BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None }
}

const READ: BufferBindingType = BufferBindingType::Storage { read_only: true };
const WRITE: BufferBindingType = BufferBindingType::Storage { read_only: false };
const TEXTURE: BindingType = BindingType::Texture {
    sample_type: TextureSampleType::Float { filterable: false },
    view_dimension: TextureViewDimension::D2,
    multisampled: false,
};

const WORDS: BindingType = BindingType::Texture {
    sample_type: TextureSampleType::Uint,
    view_dimension: TextureViewDimension::D2,
    multisampled: false,
};

/// Group 2 of the raster in compute: what it bins, and the textures that it writes.
pub fn tile_entries(textures: &[TextureFormat]) -> Vec<BindGroupLayoutEntry> {
    let in_compute =
        |binding, ty| BindGroupLayoutEntry { visibility: ShaderStages::COMPUTE, ..entry(binding, ty) };
    let uniform = in_compute(0, buffer(BufferBindingType::Uniform));
    let buffers = (1..7).map(|binding| in_compute(binding, buffer(WRITE)));
    let written = (7..).zip(textures).map(|(binding, format)| {
        let (access, view_dimension) = (StorageTextureAccess::WriteOnly, TextureViewDimension::D2);
        in_compute(binding, BindingType::StorageTexture { access, format: *format, view_dimension })
    });
    std::iter::once(uniform).chain(buffers).chain(written).collect()
}

/// What a render pipeline is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Draws {
    /// Primitives.
    Primitives { perspective: bool, zero_fragments: bool },
    /// The whole image.
    Background,
}

/// The shader of a pipeline.
#[derive(Debug, Clone, Copy)]
pub struct Entry<'a> {
    pub module: &'a str,
    pub point: &'a str,
}

impl Layouts {
    pub fn new(device: &Device) -> Self {
        let layout = |label, entries: &[BindGroupLayoutEntry]| {
            device.create_bind_group_layout(&BindGroupLayoutDescriptor { label: Some(label), entries })
        };
        // the vertex shader must not see what can be written
        let written = |binding| BindGroupLayoutEntry {
            visibility: ShaderStages::FRAGMENT | ShaderStages::COMPUTE,
            ..entry(binding, buffer(WRITE))
        };
        let in_fragments =
            |binding| BindGroupLayoutEntry { visibility: ShaderStages::FRAGMENT, ..written(binding) };
        let uniform = buffer(BufferBindingType::Uniform);
        Self {
            frame: layout(
                "frame",
                &[entry(0, uniform), entry(1, TEXTURE), entry(2, TEXTURE), entry(3, uniform)],
            ),
            geometry: layout("geometry", &[0, 1, 2].map(|binding| entry(binding, buffer(READ)))),
            tiles: layout("tiles", &tile_entries(&[])),
            targets: layout("targets", &[0, 1].map(|binding| entry(binding, TEXTURE))),
            lists: layout("lists", &[0, 1, 2, 3, 4, 5].map(written)),
            peeled_keys: layout("peeled keys", &[entry(0, WORDS), entry(1, TEXTURE), in_fragments(2)]),
            peeled_depths: layout("peeled depths", &[entry(0, TEXTURE), entry(1, TEXTURE), in_fragments(2)]),
            output: layout("output", &[written(0)]),
            modules: HashMap::new(),
            renders: HashMap::new(),
            computes: HashMap::new(),
        }
    }

    fn module(&mut self, device: &Device, source: &str) -> ShaderModule {
        let module = self.modules.entry(source.to_owned()).or_insert_with(|| {
            let source = wgpu::ShaderSource::Wgsl(source.into());
            device.create_shader_module(wgpu::ShaderModuleDescriptor { label: Some("oitlab"), source })
        });
        module.clone()
    }

    /// The pipeline that draws into some targets.
    pub fn render(
        &mut self,
        device: &Device,
        shader: Entry<'_>,
        draws: Draws,
        targets: &[ColorTargetState],
    ) -> Arc<RenderPipeline> {
        let writes_lists = targets.iter().all(|target| target.write_mask.is_empty());
        let third = writes_lists.then(|| self.lists.clone());
        self.render_with(device, shader, draws, targets, third.as_ref(), None)
    }

    /// The same with another group 2, and with a depth buffer.
    pub fn render_with(
        &mut self,
        device: &Device,
        shader: Entry<'_>,
        draws: Draws,
        targets: &[ColorTargetState],
        third: Option<&BindGroupLayout>,
        depth: Option<DepthStencilState>,
    ) -> Arc<RenderPipeline> {
        let key = format!("{} {draws:?} {targets:?} {depth:?}\n{}", shader.point, shader.module);
        if let Some(pipeline) = self.renders.get(&key) {
            return Arc::clone(pipeline);
        }
        let module = self.module(device, shader.module);
        let groups = match draws {
            Draws::Background => [Some(&self.frame), None, third],
            Draws::Primitives { .. } => [Some(&self.frame), Some(&self.geometry), third],
        };
        let used = groups.iter().rposition(Option::is_some).map_or(0, |last| last + 1);
        let groups = &groups[..used];
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: None,
            bind_group_layouts: groups,
            immediate_size: 0,
        });
        let flag = |on: bool| f64::from(u8::from(on));
        let (vertex, constants) = match draws {
            Draws::Background => ("cover_all", vec![]),
            Draws::Primitives { perspective, zero_fragments } => {
                let flags =
                    [("perspective", flag(perspective)), ("shows_zero_fragments", flag(zero_fragments))];
                ("place", flags.to_vec())
            }
        };
        let options = wgpu::PipelineCompilationOptions {
            constants: &constants,
            zero_initialize_workgroup_memory: false,
        };
        let targets: Vec<_> = targets.iter().cloned().map(Some).collect();
        let pipeline = device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some(shader.point),
            layout: Some(&layout),
            vertex: wgpu::VertexState {
                module: &module,
                entry_point: Some(vertex),
                compilation_options: options.clone(),
                buffers: &[],
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: depth,
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module: &module,
                entry_point: Some(shader.point),
                compilation_options: options,
                targets: &targets,
            }),
            multiview_mask: None,
            cache: None,
        });
        Arc::clone(self.renders.entry(key).or_insert(Arc::new(pipeline)))
    }

    /// The pipeline of a compute shader, which reads lists or, if it does not, render targets.
    pub fn compute(
        &mut self,
        device: &Device,
        shader: Entry<'_>,
        of_lists: bool,
        writes_image: bool,
        constants: &[(&str, f64)],
    ) -> Arc<ComputePipeline> {
        let third = if of_lists { &self.lists } else { &self.targets }.clone();
        self.compute_with(device, shader, false, &third, writes_image, constants)
    }

    /// The same with another group 2, and with primitives.
    pub fn compute_with(
        &mut self,
        device: &Device,
        shader: Entry<'_>,
        reads_primitives: bool,
        third: &BindGroupLayout,
        writes_image: bool,
        constants: &[(&str, f64)],
    ) -> Arc<ComputePipeline> {
        let key = format!("{} {constants:?}\n{}", shader.point, shader.module);
        if let Some(pipeline) = self.computes.get(&key) {
            return Arc::clone(pipeline);
        }
        let module = self.module(device, shader.module);
        let primitives = reads_primitives.then_some(&self.geometry);
        let groups = [Some(&self.frame), primitives, Some(third), Some(&self.output)];
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: None,
            bind_group_layouts: &groups[..3 + usize::from(writes_image)],
            immediate_size: 0,
        });
        let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(shader.point),
            layout: Some(&layout),
            module: &module,
            entry_point: Some(shader.point),
            compilation_options: wgpu::PipelineCompilationOptions { constants, ..Default::default() },
            cache: None,
        });
        Arc::clone(self.computes.entry(key).or_insert(Arc::new(pipeline)))
    }
}

fn texture_format(format: Format, channels: u32) -> Option<TextureFormat> {
    Some(match (format, channels) {
        (Format::F32, 1) => TextureFormat::R32Float,
        (Format::F32, 2) => TextureFormat::Rg32Float,
        (Format::F32, _) => TextureFormat::Rgba32Float,
        (Format::F16, 1) => TextureFormat::R16Float,
        (Format::F16, _) => TextureFormat::Rgba16Float,
        (Format::Unorm8, 1) => TextureFormat::R8Unorm,
        (Format::Unorm8, _) => TextureFormat::Rgba8Unorm,
        (Format::Unorm16, 1) => TextureFormat::R16Unorm,
        (Format::Unorm16, _) => TextureFormat::Rgba16Unorm,
        (Format::Srgb8, _) => TextureFormat::Rgba8UnormSrgb,
        _ => return None,
    })
}

/// The feature without which a format is not blended, and what does without it.
fn missing(format: Format, features: Features) -> &'static str {
    match format {
        Format::F32 if !features.contains(Features::FLOAT32_BLENDABLE) => {
            " (FLOAT32_BLENDABLE is missing); format=\"f16\" does without"
        }
        Format::Unorm16 if !features.contains(Features::TEXTURE_FORMAT_16BIT_NORM) => {
            " (TEXTURE_FORMAT_16BIT_NORM is missing); \"unorm8\" and \"f16\" do without"
        }
        _ => "",
    }
}

impl Connection {
    /// The format of a target on this device.
    ///
    /// # Errors
    /// [`Error::Argument`] naming the param, if the device does not blend it.
    pub fn target_format(&self, target: &BlendTarget) -> Result<TextureFormat> {
        let format = texture_format(target.format, target.channels);
        let fits = |format: &TextureFormat| {
            let all = self.features.contains(Features::TEXTURE_ADAPTER_SPECIFIC_FORMAT_FEATURES);
            let of = if all {
                self.adapter.get_texture_format_features(*format)
            } else {
                format.guaranteed_format_features(self.features)
            };
            self.features.contains(format.required_features())
                && of
                    .allowed_usages
                    .contains(TextureUsages::RENDER_ATTACHMENT | TextureUsages::TEXTURE_BINDING)
                && of.flags.contains(TextureFormatFeatureFlags::BLENDABLE)
                && (target.format != Format::F32 || self.features.contains(Features::FLOAT32_BLENDABLE))
        };
        format.filter(fits).ok_or_else(|| {
            let (name, adapter) = (target.format.name(), &self.info.name);
            let why = missing(target.format, self.features);
            Error::argument(target.param, format!("{adapter} cannot blend {name:?}{why}"))
        })
    }

    /// The formats of all targets.
    ///
    /// # Errors
    /// As [`Connection::target_format`], and for more targets or bytes than the device takes at a time.
    pub fn target_formats(&self, blending: &Blending) -> Result<Vec<TextureFormat>> {
        let formats =
            blending.targets.iter().map(|target| self.target_format(target)).collect::<Result<Vec<_>>>()?;
        let bytes: u32 = formats.iter().filter_map(TextureFormat::target_pixel_byte_cost).sum();
        let most = self.limits.max_color_attachment_bytes_per_sample;
        if bytes > most || formats.len() > TARGETS as usize {
            let problem = format!("targets of {bytes} bytes per pixel; {} takes {most}", self.info.name);
            return Err(Error::argument("format", problem));
        }
        Ok(formats)
    }
}

fn component(blend: Blend) -> BlendComponent {
    let (src_factor, dst_factor) = match blend {
        // of the larger one factors are not looked at
        Blend::Add | Blend::Max => (BlendFactor::One, BlendFactor::One),
        Blend::Over => (BlendFactor::One, BlendFactor::OneMinusSrcAlpha),
        Blend::Attenuate => (BlendFactor::Zero, BlendFactor::OneMinusSrc),
        Blend::Multiply => (BlendFactor::Zero, BlendFactor::Src),
        Blend::Under => (BlendFactor::DstAlpha, BlendFactor::One),
        Blend::Cover => (BlendFactor::One, BlendFactor::SrcAlpha),
    };
    let operation = if blend == Blend::Max { BlendOperation::Max } else { BlendOperation::Add };
    BlendComponent { src_factor, dst_factor, operation }
}

/// A target that blends.
pub fn blended(target: &BlendTarget, format: TextureFormat) -> ColorTargetState {
    let blend = Some(BlendState { color: component(target.color), alpha: component(target.alpha) });
    ColorTargetState { format, blend, write_mask: ColorWrites::ALL }
}

/// A target that takes what it is given, or nothing.
pub fn plain(format: TextureFormat, write_mask: ColorWrites) -> ColorTargetState {
    ColorTargetState { format, blend: None, write_mask }
}
