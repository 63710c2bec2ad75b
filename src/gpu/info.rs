//! What there is to say about the device.

use super::device::Connection;
use super::form::{Form, Path};
use super::shared::with_gpu;
use crate::error::{Error, Result};
use crate::params::{View, check};
use crate::technique;
use crate::techniques::REGISTRY;
use wgpu::Features;

/// A device, and what it can do.
#[derive(Debug, Clone, PartialEq)]
pub struct Info {
    /// Name of the adapter, driver and the like.
    pub texts: Vec<(&'static str, String)>,
    /// Features that techniques make use of, and whether they are there.
    pub features: Vec<(&'static str, bool)>,
    /// Limits that images and scenes may meet.
    pub limits: Vec<(&'static str, u64)>,
    /// The techniques that it runs with their default params.
    pub techniques: Vec<&'static str>,
    /// The others, and why not.
    pub refused: Vec<(&'static str, String)>,
}

/// What there is to say about the device of this process.
///
/// # Errors
/// [`crate::Error::Gpu`] if there is none.
pub fn info() -> Result<Info> {
    with_gpu(|shared| {
        let connection = shared.connection();
        let mut info = describe(connection);
        for technique in REGISTRY {
            match why_not(connection, technique) {
                None => info.techniques.push(technique.id),
                Some(why) => info.refused.push((technique.id, why)),
            }
        }
        Ok(info)
    })
}

fn describe(connection: &Connection) -> Info {
    let Connection { info, features, limits, .. } = connection;
    let texts = vec![
        ("adapter", info.name.clone()),
        ("kind", format!("{:?}", info.device_type)),
        ("driver", info.driver.clone()),
        ("driver_info", info.driver_info.clone()),
        ("interface", info.backend.to_string()),
    ];
    let has = |feature| features.contains(feature);
    let features = vec![
        ("timestamps", has(Features::TIMESTAMP_QUERY)),
        ("float32_blending", has(Features::FLOAT32_BLENDABLE)),
        ("unorm16", has(Features::TEXTURE_FORMAT_16BIT_NORM)),
    ];
    let limits = vec![
        ("image_side", u64::from(limits.max_texture_dimension_2d)),
        ("buffer_bytes", limits.max_buffer_size),
        ("binding_bytes", limits.max_storage_buffer_binding_size),
        ("target_layers", u64::from(limits.max_texture_array_layers)),
        ("target_bytes_per_pixel", u64::from(limits.max_color_attachment_bytes_per_sample)),
    ];
    Info { texts, features, limits, techniques: Vec::new(), refused: Vec::new() }
}

/// Storage buffers of a shader that draws into lists, one that takes links out of them, one that draws tiles, and one that
/// fills lists of tiles.
const OF_LISTS: u32 = 11;
const OF_LINKED_LISTS: u32 = 13;
const OF_TILES: u32 = 11;
const OF_LISTS_OF_TILES: u32 = 17;

impl Connection {
    /// Refuses any picture where shaders do not see the buffers that fragments are counted in.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] that says how many they are.
    pub fn counts_fragments(&self) -> Result<()> {
        self.has_storage_buffers(OF_LISTS)
    }

    fn has_storage_buffers(&self, needed: u32) -> Result<()> {
        let most = self.limits.max_storage_buffers_per_shader_stage;
        if needed <= most {
            return Ok(());
        }
        let device = &self.info.name;
        let problem = format!("shaders see {needed} storage buffers here, and those of {device} only {most}");
        Err(Error::argument("backend", problem))
    }

    /// Refuses linked lists where shaders see fewer buffers.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] that says how many they are.
    pub fn fits_linked_lists(&self) -> Result<()> {
        self.has_storage_buffers(OF_LINKED_LISTS)
    }

    /// Refuses a form whose tiles see more buffers than the device's shaders do.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] that says how many they are.
    pub fn fits_in_tiles(&self, form: &Form) -> Result<()> {
        self.has_storage_buffers(if form.is_listed_in_tiles() { OF_LISTS_OF_TILES } else { OF_TILES })
    }

    /// Refuses a form that the device has no targets for.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] for formats, layers and the like that it lacks.
    pub fn fits(&self, form: &Form) -> Result<()> {
        match &form.path {
            Path::Blended(blending) => self.target_formats(blending).map(drop),
            Path::Listed(_) | Path::Streamed(_) => Ok(()),
            Path::Sampled(sampling) => {
                sampling.sums.iter().try_for_each(|sum| self.target_format(sum).map(drop))
            }
            Path::Peeled(peeling) => self.peeling_formats(peeling).map(drop),
        }
    }
}

/// Why the device does not run a technique with its default params; none if it does.
fn why_not(connection: &Connection, technique: &technique::Info) -> Option<String> {
    let Some(make) = technique.gpu else { return Some("has no GPU form yet".to_owned()) };
    let table = technique.param_table();
    let form: Result<Form> = check(technique.id, &table, &[])
        .and_then(|checked| make(&checked.resolve(&table, &View::ORDINARY), &View::ORDINARY));
    let fits = form.and_then(|form| connection.counts_fragments().and_then(|()| connection.fits(&form)));
    fits.err().map(|error| error.to_string())
}
