//! The GPU backend: devices, passes, buffers, timestamps and readback. It knows no technique by name.
//!
//! The CPU clips, projects and snaps, and draws the opaque surfaces; the device gets the outlines that are left, in
//! submission order, so that both cover the same pixels. What a technique does there is a [`form::Form`].

#[cfg(feature = "gpu")]
mod bandwidth;
#[cfg(feature = "gpu")]
mod blend;
#[cfg(feature = "gpu")]
mod canvas;
#[cfg(feature = "gpu")]
mod device;
#[cfg(feature = "gpu")]
mod draw;
#[cfg(feature = "gpu")]
mod draws;
pub mod form;
#[cfg(feature = "gpu")]
mod geometry;
#[cfg(feature = "gpu")]
mod info;
#[cfg(feature = "gpu")]
mod layouts;
#[cfg(feature = "gpu")]
mod linked;
#[cfg(feature = "gpu")]
mod lists;
#[cfg(feature = "gpu")]
mod peel;
#[cfg(feature = "gpu")]
mod picture;
#[cfg(feature = "gpu")]
mod recorder;
#[cfg(feature = "gpu")]
mod samples;
#[cfg(feature = "gpu")]
mod shared;
#[cfg(feature = "gpu")]
mod tiles;

#[cfg(feature = "gpu")]
pub use bandwidth::copy_bandwidth;
#[cfg(feature = "gpu")]
pub(crate) use draw::Stop;
#[cfg(feature = "gpu")]
pub use info::{Info, info};
#[cfg(feature = "gpu")]
pub(crate) use picture::{Given, Opaque, Primitives, ToDraw, View, check_size};
#[cfg(feature = "gpu")]
pub(crate) use shared::{Key, Shared, with_gpu};
