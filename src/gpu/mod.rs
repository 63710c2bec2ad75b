//! The GPU backend: devices, passes, buffers, timestamps and readback. It knows no technique by name.

pub mod form;
