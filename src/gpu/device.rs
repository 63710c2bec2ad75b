//! The device: one per process, made when it is first needed, and its errors.

use crate::error::{Error, Result};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use wgpu::{
    Adapter, AdapterInfo, Backends, Device, DownlevelFlags, ErrorFilter, Features, Instance,
    InstanceDescriptor, Limits, PollType, PowerPreference, Queue, RequestAdapterOptions, SubmissionIndex,
};

/// What is used where an adapter has it.
const WANTED: Features = Features::TIMESTAMP_QUERY
    .union(Features::FLOAT32_BLENDABLE)
    .union(Features::TEXTURE_FORMAT_16BIT_NORM)
    // what the adapter does with a format beyond what every adapter has to
    .union(Features::TEXTURE_ADAPTER_SPECIFIC_FORMAT_FEATURES);

/// What is of use to somebody without a driver.
const HOW_TO_GET_A_DRIVER: &str = "a Vulkan (Linux, Windows), D3D12 or Metal driver is needed: that of the graphics card, \
     or Mesa's for the processor (Debian, Ubuntu: apt-get install mesa-vulkan-drivers libvulkan1)";

/// How long to wait for a device before asking whether to stop.
const PATIENCE: Duration = Duration::from_millis(20);

/// A device with its queue.
#[derive(Debug, Clone)]
pub struct Connection {
    pub adapter: Adapter,
    pub info: AdapterInfo,
    pub device: Device,
    pub queue: Queue,
    pub features: Features,
    pub limits: Limits,
    /// Why the device is gone, if it is.
    lost: Arc<Mutex<Option<String>>>,
    /// What went wrong where nobody looked.
    unexpected: Arc<Mutex<Vec<String>>>,
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Connection {
    /// The error that stands for pixels which shaders did not finish.
    pub fn cut_short(&self) -> Error {
        Error::Gpu(format!(
            "{} ends loops before they are done, and did so in a pixel with too many fragments for that, or in a weight's own loop; fewer \
             fragments, layers, samples or turns may do, and backend=\"cpu\" has no such bound",
            self.info.name
        ))
    }

    /// Connects to the fastest adapter, or to the one that the environment asks for (`WGPU_BACKEND`, `WGPU_ADAPTER_NAME`).
    ///
    /// # Errors
    /// [`Error::Gpu`] if there is none, or one that cannot do what every technique needs.
    pub fn new() -> Result<Self> {
        std::env::var(BACKENDS).ok().as_deref().map_or(Ok(()), check_backends)?;
        let instance = Instance::new(InstanceDescriptor::new_without_display_handle_from_env());
        let adapter = pollster::block_on(choose(&instance))?;
        let info = adapter.get_info();
        let flags = adapter.get_downlevel_capabilities().flags;
        let needed = DownlevelFlags::COMPUTE_SHADERS
            | DownlevelFlags::FRAGMENT_WRITABLE_STORAGE
            | DownlevelFlags::VERTEX_STORAGE;
        if !flags.contains(needed) {
            let missing = needed - flags;
            return Err(Error::Gpu(format!(
                "{} lacks {missing:?}; a newer driver or another adapter (WGPU_ADAPTER_NAME) may have it",
                info.name
            )));
        }
        let (features, limits) = (adapter.features() & WANTED, adapter.limits());
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("oitlab"),
            required_features: features,
            required_limits: limits.clone(),
            ..Default::default()
        };
        let limits = capped(limits)?;
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|error| Error::Gpu(format!("{} gives no device: {error}", info.name)))?;
        let (lost, unexpected) = (Arc::default(), Arc::default());
        let connection = Self { adapter, info, device, queue, features, limits, lost, unexpected };
        connection.listen();
        Ok(connection)
    }

    /// wgpu would panic on errors that nobody waits for.
    fn listen(&self) {
        let unexpected = Arc::clone(&self.unexpected);
        self.device.on_uncaptured_error(Arc::new(move |error| locked(&unexpected).push(error.to_string())));
        let lost = Arc::clone(&self.lost);
        self.device.set_device_lost_callback(move |reason, message| {
            *locked(&lost) = Some(format!("{reason:?}: {message}"));
        });
    }

    /// Whether nothing can be done with it any more.
    pub fn is_lost(&self) -> bool {
        locked(&self.lost).is_some()
    }

    /// Does some work with all errors of the device turned into ours.
    ///
    /// # Errors
    /// Those of `work`; [`Error::Memory`] and [`Error::Gpu`] for what the device says.
    pub fn guarded<T>(&self, work: impl FnOnce() -> Result<T>) -> Result<T> {
        let filters = [ErrorFilter::Internal, ErrorFilter::Validation, ErrorFilter::OutOfMemory];
        let scopes = filters.map(|filter| self.device.push_error_scope(filter));
        let result = work();
        let mut errors: Vec<_> =
            scopes.into_iter().rev().filter_map(|scope| pollster::block_on(scope.pop())).collect();
        if let Some(reason) = locked(&self.lost).as_ref() {
            return Err(Error::Gpu(format!(
                "the device was lost ({}; {reason}); the next call asks for it anew",
                self.info.name
            )));
        }
        // the first is the cause, and memory the likeliest one of those that follow
        if errors.iter().any(|error| matches!(error, wgpu::Error::OutOfMemory { .. })) {
            return Err(Error::Memory(format!(
                "the buffers and targets of this image on {}; a smaller image, or format=\"f16\", takes less",
                self.info.name
            )));
        }
        let unexpected = std::mem::take(&mut *locked(&self.unexpected));
        let messages = errors.drain(..).map(|error| error.to_string()).chain(unexpected);
        match messages.collect::<Vec<_>>().first() {
            Some(message) => Err(Error::Gpu(message.clone())),
            None => result,
        }
    }

    /// Waits until the device has done what was submitted, or until `stop` says so.
    ///
    /// # Errors
    /// [`Error::Cancelled`], or [`Error::Gpu`] if the device cannot be waited for.
    pub fn wait(&self, submission: &SubmissionIndex, stop: &(dyn Fn() -> bool + Sync)) -> Result<()> {
        loop {
            let submission_index = Some(submission.clone());
            match self.device.poll(PollType::Wait { submission_index, timeout: Some(PATIENCE) }) {
                Ok(_) => return Ok(()),
                Err(wgpu::PollError::Timeout) if stop() => return Err(Error::Cancelled),
                Err(wgpu::PollError::Timeout) if !self.is_lost() => {}
                Err(error) => return Err(Error::Gpu(format!("waiting for {}: {error}", self.info.name))),
            }
        }
    }
}

/// Bytes of a buffer that are used at a time, at most: for devices that promise more than they have, and for tests.
const BUFFER_BYTES: &str = "OITLAB_GPU_BUFFER_BYTES";

/// The least cap that leaves room for anything.
const LEAST_CAP: u64 = 16_384;

fn capped(mut limits: Limits) -> Result<Limits> {
    if let Ok(text) = std::env::var(BUFFER_BYTES) {
        let cap = text.parse().ok().filter(|cap| *cap >= LEAST_CAP).ok_or_else(|| {
            Error::Gpu(format!("{BUFFER_BYTES}={text:?} is not a number of bytes >= {LEAST_CAP}"))
        })?;
        limits.max_storage_buffer_binding_size = limits.max_storage_buffer_binding_size.min(cap);
    }
    Ok(limits)
}

/// Which interfaces to drivers wgpu may use; it ignores names that it does not know.
const BACKENDS: &str = "WGPU_BACKEND";

/// Refuses a `WGPU_BACKEND` that names what is no interface, or none that this build has.
fn check_backends(names: &str) -> Result<()> {
    let built = Instance::enabled_backend_features();
    let is_known = |name: &str| !Backends::from_comma_list(name).is_empty();
    if names.split(',').all(is_known) && Backends::from_comma_list(names).intersects(built) {
        return Ok(());
    }
    let all = [("vulkan", Backends::VULKAN), ("dx12", Backends::DX12), ("metal", Backends::METAL)];
    let there: Vec<_> = all.iter().filter(|(_, one)| built.contains(*one)).map(|(name, _)| *name).collect();
    Err(Error::Gpu(format!(
        "the environment has {BACKENDS}={names:?}; allowed are, between commas, {}, all of which are tried without it",
        there.join(", ")
    )))
}

async fn choose(instance: &Instance) -> Result<Adapter> {
    if let Ok(name) = std::env::var("WGPU_ADAPTER_NAME") {
        let adapters = instance.enumerate_adapters(Backends::all()).await;
        let names = adapters.iter().map(|adapter| adapter.get_info().name).collect::<Vec<_>>().join(", ");
        let wanted =
            |adapter: &Adapter| adapter.get_info().name.to_lowercase().contains(&name.to_lowercase());
        return adapters.into_iter().find(wanted).ok_or_else(|| {
            let there =
                if names.is_empty() { HOW_TO_GET_A_DRIVER.to_owned() } else { format!("there is {names}") };
            Error::Gpu(format!("no adapter's name contains WGPU_ADAPTER_NAME={name:?}; {there}"))
        });
    }
    let options =
        RequestAdapterOptions { power_preference: PowerPreference::HighPerformance, ..Default::default() };
    instance.request_adapter(&options).await.map_err(|error| {
        let limited = std::env::var(BACKENDS).map(|names| format!("; {BACKENDS}={names:?} allows no others"));
        Error::Gpu(format!("no adapter: {error}{}; {HOW_TO_GET_A_DRIVER}", limited.unwrap_or_default()))
    })
}
