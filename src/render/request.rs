//! What is asked for: a technique of the registry with its params, or one that the caller brings.

use super::LARGEST_STATE;
use crate::error::{Error, Result};
use crate::order::SubmissionOrder;
use crate::params::{Checked, Input, View, check};
use crate::resolve::Variant;
use crate::technique::{AnyTechnique, DepthComplexity, Info};
use crate::techniques::find;
use std::fmt;
use std::sync::Arc;

/// Makes a technique for a view.
pub type Make = dyn Fn(&View) -> Result<Box<dyn AnyTechnique>> + Send + Sync;

/// A technique that the registry does not have, its params bound.
#[derive(Clone)]
pub struct Custom {
    /// Its id.
    pub id: &'static str,
    /// What tells it from others of the same id: two that have the same are rendered once.
    pub identity: String,
    /// The order in which it gets the fragments.
    pub order: SubmissionOrder,
    /// Makes it.
    pub make: Arc<Make>,
}

/// What is to be rendered.
#[derive(Debug, Clone)]
pub enum Request {
    /// A technique's id with its params, as the user writes them.
    Registered(String, Vec<(String, Input)>),
    /// A technique that the caller brings.
    Custom(Custom),
}

impl fmt::Debug for Custom {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Custom")
            .field("id", &self.id)
            .field("identity", &self.identity)
            .finish_non_exhaustive()
    }
}

impl From<(String, Vec<(String, Input)>)> for Request {
    fn from((id, params): (String, Vec<(String, Input)>)) -> Self {
        Self::Registered(id, params)
    }
}

/// A request that is known to be in order.
pub(super) enum Asked {
    Registered(&'static Info, Checked),
    Custom(Custom),
}

impl Request {
    /// Finds the technique and checks the params.
    pub(super) fn check(&self) -> Result<Asked> {
        Ok(match self {
            Self::Registered(id, params) => {
                let info = find(id)?;
                Asked::Registered(info, check(info.id, &info.param_table(), params)?)
            }
            Self::Custom(custom) => Asked::Custom(custom.clone()),
        })
    }
}

impl Asked {
    /// The technique with the params that follow from `view`.
    pub(super) fn bind(&self, view: &View) -> Result<Variant> {
        let variant = match self {
            Self::Registered(info, checked) => registered(info, checked, view)?,
            Self::Custom(custom) => brought(custom, view)?,
        };
        let state = variant.technique.cost(&DepthComplexity { mean: 1.0, max: 1 }).bytes_per_pixel;
        if state > LARGEST_STATE {
            let problem = format!("{} under these params: it keeps {state:e} bytes per pixel", variant.id);
            return Err(Error::Memory(problem));
        }
        Ok(variant)
    }
}

fn registered(info: &'static Info, checked: &Checked, view: &View) -> Result<Variant> {
    let params = checked.resolve(&info.param_table(), view);
    let technique = (info.build)(&params, view)?;
    let seed = u64::try_from(params.int("seed")).unwrap_or(0);
    let order = SubmissionOrder::from_name(params.text("submission_order"), seed);
    let calls_out = params.call_out();
    Ok(Variant { id: info.id, custom: None, params, technique, order, calls_out })
}

fn brought(custom: &Custom, view: &View) -> Result<Variant> {
    let params = check(custom.id, &[], &[])?.resolve(&[], view);
    let technique = (custom.make)(view)?;
    Ok(Variant {
        id: custom.id,
        custom: Some(custom.identity.clone()),
        params,
        technique,
        order: custom.order,
        calls_out: false,
    })
}
