//! How shaders and buffers meet: bind group layouts, pipelines (made once each), formats and blend functions.

use super::device::Connection;
use super::draws::Draws;
use super::form::{Blend, BlendTarget, Blending};
use crate::error::{Error, Result};
use crate::format::Format;
use std::collections::HashMap;
use std::sync::Arc;
use wgpu::{
    BindGroupLayout, BindGroupLayoutDescriptor, BindGroupLayoutEntry, BindingType, BlendComponent,
    BlendFactor, BlendOperation, BlendState, BufferBindingType, ColorTargetState, ColorWrites,
    ComputePipeline, DepthStencilState, Device, Features, RenderPipeline, ShaderModule, ShaderStages,
    StorageTextureAccess, TextureFormat, TextureFormatFeatureFlags, TextureFormatFeatures, TextureSampleType,
    TextureUsages, TextureViewDimension,
};

/// Everything that is made once per device.
#[derive(Debug)]
pub struct Layouts {
    /// Group 0: the image at hand, opaque surfaces and the technique's params.
    pub frame: BindGroupLayout,
    /// Group 1: primitives.
    pub geometry: BindGroupLayout,
    /// Group 2 of whoever reads render targets.
    targets: HashMap<Vec<Option<Reading>>, BindGroupLayout>,
    /// Group 2 of whoever keeps lists.
    pub lists: BindGroupLayout,
    /// Group 2 of whoever links fragments, group 3 of whoever takes the links out.
    pub pool: BindGroupLayout,
    /// Group 2 of peeling: the frontier as keys or as depths, a texture, and whether anything was peeled.
    pub peeled_keys: BindGroupLayout,
    /// See [`Layouts::peeled_keys`].
    pub peeled_depths: BindGroupLayout,
    /// Group 2 of whoever looks at samples: their depths, and the primitives that they show.
    pub samples: BindGroupLayout,
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

/// What can be written: the vertex shader must not see it.
fn written(binding: u32) -> BindGroupLayoutEntry {
    BindGroupLayoutEntry {
        visibility: ShaderStages::FRAGMENT | ShaderStages::COMPUTE,
        ..entry(binding, buffer(WRITE))
    }
}

const READ: BufferBindingType = BufferBindingType::Storage { read_only: true };
const WRITE: BufferBindingType = BufferBindingType::Storage { read_only: false };
const TEXTURE: BindingType = BindingType::Texture {
    sample_type: TextureSampleType::Float { filterable: false },
    view_dimension: TextureViewDimension::D2,
    multisampled: false,
};
const ARRAY: BindingType = BindingType::Texture {
    sample_type: TextureSampleType::Float { filterable: false },
    view_dimension: TextureViewDimension::D2Array,
    multisampled: false,
};

/// What a shader finds at a binding of group 2.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Reading {
    /// A render target.
    Texture,
    /// Layers of one.
    Array,
    /// Words that it may write, too.
    Words,
}

/// Group 2 of a shader.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reads<'a> {
    Nothing,
    Lists,
    /// What is to be found at each binding, if anything.
    Targets(&'a [Option<Reading>]),
}

/// Pipelines that are kept: several for each technique.
const KEPT_PIPELINES: usize = 256;

const WORDS: BindingType = BindingType::Texture {
    sample_type: TextureSampleType::Uint,
    view_dimension: TextureViewDimension::D2,
    multisampled: false,
};

const SAMPLE_DEPTHS: BindingType = BindingType::Texture {
    sample_type: TextureSampleType::Depth,
    view_dimension: TextureViewDimension::D2,
    multisampled: true,
};
const SAMPLE_WORDS: BindingType = BindingType::Texture {
    sample_type: TextureSampleType::Uint,
    view_dimension: TextureViewDimension::D2,
    multisampled: true,
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

impl Reading {
    fn entry(self, binding: u32) -> BindGroupLayoutEntry {
        match self {
            Self::Texture => entry(binding, TEXTURE),
            Self::Array => entry(binding, ARRAY),
            Self::Words => written(binding),
        }
    }
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
        let in_fragments =
            |binding| BindGroupLayoutEntry { visibility: ShaderStages::FRAGMENT, ..written(binding) };
        let uniform = buffer(BufferBindingType::Uniform);
        Self {
            frame: layout(
                "frame",
                &[entry(0, uniform), entry(1, TEXTURE), entry(2, TEXTURE), entry(3, uniform), written(4)],
            ),
            geometry: layout("geometry", &[0, 1, 2].map(|binding| entry(binding, buffer(READ)))),
            targets: HashMap::new(),
            tiles: layout("tiles", &tile_entries(&[])),
            pool: layout("pool", &[0, 1, 2, 3, 4].map(written)),
            lists: layout("lists", &[0, 1, 2, 3, 4, 5, 6].map(written)),
            peeled_keys: layout("peeled keys", &[entry(0, WORDS), entry(1, TEXTURE), in_fragments(2)]),
            peeled_depths: layout("peeled depths", &[entry(0, TEXTURE), entry(1, TEXTURE), in_fragments(2)]),
            samples: layout("samples", &[entry(0, SAMPLE_DEPTHS), entry(1, SAMPLE_WORDS)]),
            output: layout("output", &[written(0)]),
            modules: HashMap::new(),
            renders: HashMap::new(),
            computes: HashMap::new(),
        }
    }

    /// Forgets all pipelines once they are many: a session may ask for any number of them, and drivers keep code for each.
    fn make_room(&mut self) {
        if self.renders.len() + self.computes.len() >= KEPT_PIPELINES {
            self.renders.clear();
            self.computes.clear();
            self.modules.clear();
        }
    }

    fn module(&mut self, device: &Device, source: &str) -> ShaderModule {
        let module = self.modules.entry(source.to_owned()).or_insert_with(|| {
            let source = wgpu::ShaderSource::Wgsl(source.into());
            device.create_shader_module(wgpu::ShaderModuleDescriptor { label: Some("oitlab"), source })
        });
        module.clone()
    }

    /// The layout of group 2; none where there is no such group.
    pub fn second(&mut self, device: &Device, reads: Reads<'_>) -> Option<BindGroupLayout> {
        let readings = match reads {
            Reads::Nothing => return None,
            Reads::Lists => return Some(self.lists.clone()),
            Reads::Targets(readings) => readings,
        };
        let layout = self.targets.entry(readings.to_vec()).or_insert_with(|| {
            let there =
                readings.iter().zip(0..).filter_map(|(reading, binding)| Some((binding, (*reading)?)));
            let entries: Vec<_> = there.map(|(binding, reading)| reading.entry(binding)).collect();
            let label = Some("targets");
            device.create_bind_group_layout(&BindGroupLayoutDescriptor { label, entries: &entries })
        });
        Some(layout.clone())
    }

    /// The pipeline that draws into some targets.
    pub fn render(
        &mut self,
        device: &Device,
        shader: Entry<'_>,
        draws: Draws,
        reads: Reads<'_>,
        targets: &[ColorTargetState],
    ) -> Arc<RenderPipeline> {
        let third = self.second(device, reads);
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
        self.make_room();
        let module = self.module(device, shader.module);
        let groups = match draws {
            Draws::Background | Draws::Image { .. } => [Some(&self.frame), None, third],
            Draws::Primitives(_) | Draws::Samples { .. } => [Some(&self.frame), Some(&self.geometry), third],
        };
        let used = groups.iter().rposition(Option::is_some).map_or(0, |last| last + 1);
        let groups = &groups[..used];
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: None,
            bind_group_layouts: groups,
            immediate_size: 0,
        });
        let (vertex, constants) = draws.vertex();
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
            multisample: wgpu::MultisampleState { count: draws.samples(), ..Default::default() },
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

    /// The pipeline of a compute shader.
    pub fn compute(
        &mut self,
        device: &Device,
        shader: Entry<'_>,
        reads: Reads<'_>,
        writes_image: bool,
        constants: &[(&str, f64)],
    ) -> Arc<ComputePipeline> {
        let third = self.second(device, reads);
        let image = writes_image.then(|| self.output.clone());
        self.compute_with(device, shader, false, third.as_ref(), image.as_ref(), constants)
    }

    /// The same with other groups 2 and 3, and with primitives.
    pub fn compute_with(
        &mut self,
        device: &Device,
        shader: Entry<'_>,
        reads_primitives: bool,
        third: Option<&BindGroupLayout>,
        fourth: Option<&BindGroupLayout>,
        constants: &[(&str, f64)],
    ) -> Arc<ComputePipeline> {
        let key = format!("{} {constants:?}\n{}", shader.point, shader.module);
        if let Some(pipeline) = self.computes.get(&key) {
            return Arc::clone(pipeline);
        }
        self.make_room();
        let module = self.module(device, shader.module);
        let primitives = reads_primitives.then_some(&self.geometry);
        let groups = [Some(&self.frame), primitives, third, fourth];
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: None,
            bind_group_layouts: &groups[..3 + usize::from(fourth.is_some())],
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

/// What attachments of these formats take per sample (WebGPU, "Calculating color attachment bytes per sample").
pub fn attachment_bytes(formats: impl Iterator<Item = TextureFormat>) -> u32 {
    formats.fold(0, |bytes: u32, format| {
        let alignment = format.target_component_alignment().unwrap_or(1);
        bytes.next_multiple_of(alignment) + format.target_pixel_byte_cost().unwrap_or(0)
    })
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

/// The feature without which a target is not blended, and what does without it.
fn missing(target: &BlendTarget, features: Features) -> &'static str {
    match target.format {
        Format::F32 if !features.contains(Features::FLOAT32_BLENDABLE) => {
            if target.color == Blend::Max {
                // depths are no use in less
                " (FLOAT32_BLENDABLE is missing); \"scene\" or a pair of depths does without"
            } else {
                " (FLOAT32_BLENDABLE is missing); format=\"f16\" does without"
            }
        }
        Format::Unorm16 if !features.contains(Features::TEXTURE_FORMAT_16BIT_NORM) => {
            " (TEXTURE_FORMAT_16BIT_NORM is missing); \"unorm8\" and \"f16\" do without"
        }
        _ => "",
    }
}

impl Connection {
    /// What the device does with a format.
    pub fn format_features(&self, format: TextureFormat) -> TextureFormatFeatures {
        if self.features.contains(Features::TEXTURE_ADAPTER_SPECIFIC_FORMAT_FEATURES) {
            self.adapter.get_texture_format_features(format)
        } else {
            format.guaranteed_format_features(self.features)
        }
    }

    /// The format of a target on this device.
    ///
    /// # Errors
    /// [`Error::Argument`] naming the param, if the device does not blend it.
    pub fn target_format(&self, target: &BlendTarget) -> Result<TextureFormat> {
        let format = texture_format(target.format, target.channels);
        let fits = |format: &TextureFormat| {
            let of = self.format_features(*format);
            self.features.contains(format.required_features())
                && of
                    .allowed_usages
                    .contains(TextureUsages::RENDER_ATTACHMENT | TextureUsages::TEXTURE_BINDING)
                && of.flags.contains(TextureFormatFeatureFlags::BLENDABLE)
                && (target.format != Format::F32 || self.features.contains(Features::FLOAT32_BLENDABLE))
        };
        format.filter(fits).ok_or_else(|| {
            let (name, adapter) = (target.format.name(), &self.info.name);
            let why = missing(target, self.features);
            Error::argument(target.param, format!("{adapter} cannot blend {name:?}{why}"))
        })
    }

    /// The formats of all targets; of those that nobody draws into none.
    ///
    /// # Errors
    /// As [`Connection::target_format`], and for more layers, targets or bytes than the device takes at a time.
    pub fn target_formats(&self, blending: &Blending) -> Result<Vec<Option<TextureFormat>>> {
        let is_drawn = |i| blending.draws.iter().any(|draw| draw.targets.contains(&i));
        let format =
            |(i, target): (usize, &BlendTarget)| is_drawn(i).then(|| self.target_format(target)).transpose();
        let formats = blending.targets.iter().enumerate().map(format).collect::<Result<Vec<_>>>()?;
        blending.targets.iter().try_for_each(|target| self.check_layers(target))?;
        for draw in blending.draws.iter().filter(|draw| !draw.in_parts) {
            let drawn = formats[draw.targets.clone()].iter().flatten();
            let bytes = attachment_bytes(drawn.copied());
            let most = self.limits.max_color_attachment_bytes_per_sample;
            if bytes > most || draw.targets.len() > self.limits.max_color_attachments as usize {
                let problem = format!("targets of {bytes} bytes per pixel; {} takes {most}", self.info.name);
                return Err(Error::argument("format", problem));
            }
        }
        Ok(formats)
    }

    fn check_layers(&self, target: &BlendTarget) -> Result<()> {
        let most = self.limits.max_texture_array_layers;
        match target.layers {
            Some((param, layers)) if layers > most => {
                let problem = format!("{layers} layers of a target; {} has {most}", self.info.name);
                Err(Error::argument(param, problem))
            }
            _ => Ok(()),
        }
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
