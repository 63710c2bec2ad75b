//! The lab bench for order-independent transparency.

pub mod error;
pub mod fragments;
pub mod order;
pub mod params;
pub mod random;
pub mod technique;
pub mod techniques;

pub use error::{Error, Result};
