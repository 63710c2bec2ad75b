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
pub struct Own {
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
    Own(Own),
}

impl fmt::Debug for Own {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Own").field("id", &self.id).field("identity", &self.identity).finish_non_exhaustive()
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
    Own(Own),
}

impl Request {
    /// Finds the technique and checks the params.
    pub(super) fn check(&self) -> Result<Asked> {
        Ok(match self {
            Self::Registered(id, params) => {
                let info = find(id)?;
                Asked::Registered(info, check(info.id, &info.param_table(), params)?)
            }
            Self::Own(own) => Asked::Own(own.clone()),
        })
    }
}

impl Asked {
    /// The technique with the params that follow from `view`.
    pub(super) fn bind(&self, view: &View) -> Result<Variant> {
        let variant = match self {
            Self::Registered(info, checked) => registered(info, checked, view)?,
            Self::Own(own) => brought(own, view)?,
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
    Ok(Variant { id: info.id, own: None, params, technique, order })
}

fn brought(own: &Own, view: &View) -> Result<Variant> {
    let params = check(own.id, &[], &[])?.resolve(&[], view);
    let technique = (own.make)(view)?;
    Ok(Variant { id: own.id, own: Some(own.identity.clone()), params, technique, order: own.order })
}
