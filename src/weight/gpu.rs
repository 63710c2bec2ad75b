//! Weights as the shaders' `Weight` and `weight_of` have them.

use super::{Formula, Function, Planes, Weighting};
use crate::error::Result;
use crate::gpu::form::{Number, WeightModule};
use crate::own::{Call, Source, callable, vectors};
use crate::params::{Params, Setting};

/// A weight for shaders.
#[derive(Debug, Clone, PartialEq)]
pub struct Shading {
    /// The members of `Weight`.
    pub numbers: Vec<Number>,
    /// What computes it.
    pub module: WeightModule,
}

impl Weighting {
    /// The weight that `params`, of which this weighting was made, ask for.
    ///
    /// # Errors
    /// `Error::Param` for a callable, which no shader can call.
    pub fn shading(&self, params: &Params) -> Result<Shading> {
        if let Function::Published(formula) = self.function {
            return Ok(self.published(formula));
        }
        let Setting::Written(source) = params.setting("weight") else {
            let problem = "a callable has no form on the backend \"gpu\"";
            return Err(params.error(problem, "there weight is a published one, or written in WGSL"));
        };
        let planes = Planes::from_params(params)?;
        let numbers = self.own_numbers(planes, &params.uniforms("weight"));
        Ok(Shading { numbers, module: WeightModule::own(&own_module(source)) })
    }

    fn published(&self, formula: Formula) -> Shading {
        let (index, k, planes) = match formula {
            Formula::One => (0, 0.0, None),
            Formula::Mb7 => (1, 0.0, None),
            Formula::Mb8 => (2, 0.0, None),
            Formula::Mb9 => (3, 0.0, None),
            Formula::Mb10(planes) => (4, 0.0, Some(planes)),
            Formula::InvPow { k } => (5, k, None),
            Formula::Exp { k } => (6, k, None),
            Formula::Fig1 => (7, 0.0, None),
            Formula::Smoke6 => (8, 0.0, None),
            Formula::Fig10 { k } => (9, k, None),
            Formula::I3d16(planes) => (10, 0.0, Some(planes)),
        };
        let Planes { scale, inverse_far } = planes.unwrap_or(Planes { scale: 0.0, inverse_far: 0.0 });
        let floats = [k, self.seen.scale, self.seen.shift, scale, inverse_far].map(Number::Float);
        let unused = [Number::Whole(0); 3];
        let numbers = floats.into_iter().chain(unused).collect();
        Shading { numbers, module: WeightModule::published(index) }
    }

    fn own_numbers(&self, planes: Planes, uniforms: &[f32]) -> Vec<Number> {
        let seen = [self.seen.scale, self.seen.shift, planes.scale, planes.inverse_far];
        let padding = 4 * vectors(uniforms.len()) - uniforms.len();
        let all = seen.iter().chain(uniforms).copied().chain(std::iter::repeat_n(0.0, padding));
        all.map(Number::Float).collect()
    }
}

/// The function, and `own_value`, which calls it with its uniforms.
fn own_module(source: &Source) -> String {
    let call = Call {
        prefix: "own_",
        entry: "weight",
        parameters: "weight: Weight, z: f32, a: f32, d: f32",
        uniforms: "weight.uniforms",
    };
    callable(source, call)
}
