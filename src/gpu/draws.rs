//! What a pipeline draws, and what is known of that when it is made: the constants of its shaders.

use super::geometry::Traits;

/// A pipeline's constant.
pub fn flag(on: bool) -> f64 {
    f64::from(u8::from(on))
}

/// What a render pipeline is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Draws {
    /// Primitives, of which this is known.
    Primitives(Known),
    /// The same with so many samples at a time: into them, or of what is shown by them.
    Samples { count: u32, covers: bool, known: Known },
    /// The whole image.
    Background,
    /// The same, from render targets.
    Image { opaque: bool, targets_are_whole: bool },
}

/// What is known of primitives.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Known {
    pub perspective: bool,
    pub zero_fragments: bool,
    /// Whether depths may be a unit or two in the last place off, where no opaque surface is compared with them.
    pub near_depths: bool,
    pub opaque: bool,
    pub traits: Traits,
}

impl Known {
    fn constants(self) -> Vec<(&'static str, f64)> {
        let Self { perspective, zero_fragments, near_depths, opaque, traits } = self;
        vec![
            ("perspective", flag(perspective)),
            ("shows_zero_fragments", flag(zero_fragments)),
            ("exact_depths", flag(opaque || !near_depths)),
            ("has_opaque", flag(opaque)),
            ("has_outlines", flag(traits.outlines)),
            ("has_slopes", flag(traits.slopes)),
            ("has_varying_colors", flag(traits.varying_colors)),
            ("has_zero_fragments", flag(traits.zero_fragments)),
        ]
    }
}

impl Draws {
    /// The vertex shader, and constants of both shaders.
    pub fn vertex(self) -> (&'static str, Vec<(&'static str, f64)>) {
        match self {
            Self::Background => ("cover_all", vec![]),
            Self::Image { opaque, targets_are_whole } => {
                let constants =
                    vec![("has_opaque", flag(opaque)), ("targets_are_whole", flag(targets_are_whole))];
                ("cover_all", constants)
            }
            Self::Primitives(known) => ("place", known.constants()),
            Self::Samples { count, covers, known } => {
                let mut constants = known.constants();
                constants.push(("samples_at_a_time", count.into()));
                (if covers { "place_around" } else { "place" }, constants)
            }
        }
    }

    /// Samples per pixel of what is drawn into.
    pub fn samples(self) -> u32 {
        match self {
            Self::Samples { count, covers: true, .. } => count,
            _ => 1,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depths_that_opaque_surfaces_are_compared_with_are_exact() {
        let exact = |near_depths, opaque| {
            let traits = Traits::default();
            let known = Known { perspective: true, zero_fragments: false, near_depths, opaque, traits };
            known.constants().into_iter().find(|(name, _)| *name == "exact_depths").map(|(_, on)| on == 1.0)
        };
        assert_eq!([exact(true, false), exact(true, true)], [Some(false), Some(true)]);
        assert_eq!([exact(false, false), exact(false, true)], [Some(true); 2]);
    }
}
