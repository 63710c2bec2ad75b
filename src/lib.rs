//! The lab bench for order-independent transparency.

pub mod continuum;
pub mod diagnosis;
pub mod error;
pub mod format;
pub mod fragments;
pub mod frame;
pub mod gpu;
pub mod order;
pub mod own;
pub mod params;
#[cfg(feature = "python")]
mod py;
pub mod random;
pub mod raster;
pub mod render;
pub mod resolve;
pub mod scene;
pub mod spare;
pub mod stream;
pub mod technique;
pub mod techniques;
pub mod threads;
pub mod weight;

pub use error::{Error, Result};
