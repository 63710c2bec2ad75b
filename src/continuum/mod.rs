//! The building blocks that techniques share: each choice of the continuum (Wyman 2016, Table 1) once.

pub mod absorbance;
pub mod binned;
pub mod bins;
pub mod coverage;
pub mod door;
pub mod functions;
pub mod insertion;
pub mod layers;
pub mod masks;
pub mod merge;
pub mod moments;
pub mod normalize;
pub mod opacity;
pub mod oracle;
pub mod polyline;
pub mod range;
pub mod ringing;
pub mod samples;
pub mod scaled;
pub mod search;
pub mod series;
pub mod steps;
pub mod stochastic;
pub mod stored;
pub mod stored_sums;
pub mod sums;
