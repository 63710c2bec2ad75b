//! What outlives a call: the device, its pipelines, and the scenes that were drawn last.

use super::device::Connection;
use super::draw::{Gpu, Image, Kept as KeptTargets, Stop};
use super::form::Form;
use super::form::tiled::RasterPath;
use super::picture::{Given, Picture, ToDraw, Totals, View};
use crate::error::{Error, Result};
use crate::order::SubmissionOrder;
use crate::params;
use crate::raster::Drawn;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, PoisonError};

/// What tells drawn scenes apart.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Key {
    /// The scene's content.
    pub scene: blake3::Hash,
    /// The order of its primitives.
    pub order: SubmissionOrder,
    /// Whether it is fragments that are kept as lists, not drawn.
    pub listed: bool,
}

/// Bytes of scenes that stay on the device between calls, and how many of them.
const KEPT: (u64, usize) = (256 << 20, 8);

/// A scene that stays on the device.
#[derive(Debug)]
struct Kept {
    key: Key,
    picture: Picture,
    /// Near, far and the depth range.
    range: params::View,
}

/// The device and what it holds.
#[derive(Debug)]
pub struct Shared {
    gpu: Gpu,
    /// The one that was drawn last comes last.
    kept: Vec<Kept>,
}

static SHARED: Mutex<Option<Shared>> = Mutex::new(None);

/// The process that has the device; 0 before there is one.
static OWNER: AtomicU32 = AtomicU32::new(0);

/// Does some work with the process's device, which is made if there is none, and turns its errors into ours. One at a
/// time.
///
/// # Errors
/// Those of `work`, [`crate::Error::Gpu`] and [`crate::Error::Memory`].
pub fn with_gpu<T>(work: impl FnOnce(&mut Shared) -> Result<T>) -> Result<T> {
    let this = std::process::id();
    // a fork has the device's memory and none of its threads, and waiting for those would never end
    if ![0, this].contains(&OWNER.load(Ordering::Relaxed)) {
        let problem = "a fork of a process that has used the GPU cannot use it; start workers by \"spawn\"";
        return Err(Error::Gpu(problem.to_owned()));
    }
    let mut shared = SHARED.lock().unwrap_or_else(PoisonError::into_inner);
    if shared.as_ref().is_some_and(|shared| shared.gpu.connection.is_lost()) {
        *shared = None;
    }
    if shared.is_none() {
        OWNER.store(this, Ordering::Relaxed);
        let connection = Connection::new()?;
        *shared = Some(Shared { gpu: Gpu::new(connection), kept: Vec::new() });
    }
    let Some(shared) = shared.as_mut() else { unreachable!("just made") };
    let connection = shared.gpu.connection.clone();
    let result = connection.guarded(|| work(shared));
    if result.is_err() {
        // what was being made may be half there
        shared.kept.clear();
        shared.gpu.kept = KeptTargets::default();
    }
    result
}

/// The image, unless there is a pixel that a shader did not finish.
fn finished(image: Image, connection: &Connection) -> Result<Image> {
    if image.is_unfinished() { Err(connection.cut_short()) } else { Ok(image) }
}

impl Shared {
    /// The device.
    pub fn connection(&self) -> &Connection {
        &self.gpu.connection
    }

    /// The device with what has been made for it.
    pub(super) fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// Whether the scene is on the device.
    pub fn has(&self, key: Key) -> bool {
        self.kept.iter().any(|kept| kept.key == key)
    }

    /// Near, far and the depth range of a scene that is on the device.
    pub fn range(&self, scene: blake3::Hash) -> Option<params::View> {
        self.kept.iter().find(|kept| kept.key.scene == scene).map(|kept| kept.range)
    }

    /// Takes a scene to the device and counts its fragments. Lists can be sorted by the order of its primitives if they are
    /// `ranked`.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] for what is beyond the device's limits, and the device's own.
    pub fn load<'a>(
        &mut self,
        key: Key,
        range: params::View,
        view: &View,
        primitives: impl Iterator<Item = Drawn<'a>>,
        ranked: bool,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Result<()> {
        let Gpu { connection, layouts, .. } = &mut self.gpu;
        let mut picture = Picture::new(connection, layouts, view, primitives, ranked)?;
        self.gpu.count(&mut picture, stop)?;
        self.keep(key, picture, range);
        Ok(())
    }

    /// Takes fragments to the device.
    ///
    /// # Errors
    /// As [`Shared::load`].
    pub fn load_fragments(&mut self, key: Key, range: params::View, view: &View, given: Given) -> Result<()> {
        let Gpu { connection, layouts, .. } = &self.gpu;
        let picture = Picture::of_fragments(connection, layouts, view, given)?;
        self.keep(key, picture, range);
        Ok(())
    }

    fn keep(&mut self, key: Key, picture: Picture, range: params::View) {
        self.kept.push(Kept { key, picture, range });
        let bytes = |kept: &[Kept]| kept.iter().map(|kept| kept.picture.bytes).sum::<u64>();
        while self.kept.len() > 1 && (self.kept.len() > KEPT.1 || bytes(&self.kept) > KEPT.0) {
            self.kept.remove(0);
        }
    }

    /// What there is of a scene that is on the device.
    pub fn totals(&self, key: Key) -> Option<Totals> {
        self.kept.iter().find(|kept| kept.key == key).map(|kept| kept.picture.totals())
    }

    /// Draws a scene that is on the device.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] for what the device cannot do, and the device's own.
    pub fn draw(&mut self, key: Key, form: &Form, raster: RasterPath, stop: Stop<'_>) -> Result<Image> {
        let Some(place) = self.kept.iter().position(|kept| kept.key == key) else {
            unreachable!("it was loaded")
        };
        let kept = self.kept.remove(place);
        self.kept.push(kept);
        let Some(Kept { picture, .. }) = self.kept.last() else { unreachable!("just pushed") };
        finished(self.gpu.image(picture, form, raster, stop)?, &self.gpu.connection)
    }

    /// Draws in compute, some rows of the image after the other, what has more primitives than one buffer holds.
    ///
    /// # Errors
    /// As [`Shared::draw`], and [`Error::Memory`] where a few rows have more of them.
    pub fn draw_in_bands(
        &mut self,
        key: Key,
        drawn: &ToDraw<'_>,
        form: &Form,
        stop: Stop<'_>,
    ) -> Result<Image> {
        let Some(counted) = self.kept.iter().find(|kept| kept.key == key) else {
            unreachable!("it was loaded")
        };
        let counts = counted.picture.rows.clone();
        let mut image = Image::default();
        for rows in self.gpu.bands_of_primitives(drawn)? {
            if stop() {
                return Err(Error::Cancelled);
            }
            let mut picture = Picture::of_rows(&self.gpu.connection, &self.gpu.layouts, drawn, rows)?;
            picture.rows.clone_from(&counts);
            let band = self.gpu.image(&picture, form, RasterPath::Compute, stop)?;
            image.append(finished(band, &self.gpu.connection)?);
        }
        Ok(image)
    }

    /// Every fragment of a scene that is on the device.
    ///
    /// # Errors
    /// The device's own, and [`crate::Error::Memory`] for a row of more fragments than fit into one of its buffers.
    pub fn capture(&mut self, key: Key, stop: &(dyn Fn() -> bool + Sync)) -> Result<Option<Given>> {
        let Some(kept) = self.kept.iter().find(|kept| kept.key == key) else { return Ok(None) };
        self.gpu.capture(&kept.picture, stop).map(Some)
    }
}
