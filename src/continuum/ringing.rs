//! Where a transmittance function that is written as a series is none.

use super::oracle::{CHUNK, chunks};
use crate::diagnosis::{Diagnosis, Fault, Faults};
use crate::fragments::List;

/// What can go wrong with a series.
pub const RINGS: Faults = Faults::of(&[Fault::ClampedRinging]);

/// Changes of transmittance up to here are rounding.
const ROUNDING: f64 = 1e-9;

/// Counts the fragments that see an `unclamped` transmittance outside of [0, 1], or at whose depth the function, `at`,
/// exceeds what it is at the next nearer one.
pub fn ringing(
    list: List<'_>,
    unclamped: impl Fn(List<'_>, &mut [f64]),
    at: impl Fn(f32) -> f64,
) -> Diagnosis {
    let mut rings = Vec::with_capacity(list.len());
    let mut seen = [0.0; CHUNK];
    for part in chunks(list) {
        let seen = &mut seen[..part.len()];
        unclamped(part, seen);
        rings.extend(seen.iter().map(|t| !(-ROUNDING..=1.0 + ROUNDING).contains(t)));
    }
    let mut by_depth: Vec<_> = (0..list.len()).collect();
    by_depth.sort_unstable_by(|&i, &j| list.depth[i].total_cmp(&list.depth[j]));
    let mut before = 1.0;
    for same in by_depth.chunk_by(|&i, &j| list.depth[i] == list.depth[j]) {
        let transmittance = at(list.depth[same[0]]);
        if transmittance > before + ROUNDING {
            same.iter().for_each(|&i| rings[i] = true);
        }
        before = transmittance;
    }
    let mut found = Diagnosis::CLEAR;
    rings.into_iter().filter(|rings| *rings).for_each(|_| found.count(Fault::ClampedRinging));
    found
}

/// e^−τ of what `taus` fills in.
pub fn exp_minus(seen: &mut [f64], taus: impl FnOnce(&mut [f64])) {
    taus(seen);
    seen.iter_mut().for_each(|tau| *tau = (-*tau).exp());
}

#[cfg(test)]
mod tests {
    use crate::diagnosis::Fault;
    use crate::params::Input;
    use crate::techniques::testing::{as_pixel, build, fragment};

    fn rings(id: &str, inputs: &[(&str, Input)], depths: &[f32]) -> f32 {
        let layer = |(i, &depth): (usize, &f32)| fragment(depth, [1.0; 3], 0.5, u32::try_from(i).unwrap());
        let pixel: Vec<_> = depths.iter().enumerate().map(layer).collect();
        let technique = build(id, inputs).unwrap();
        assert!(technique.faults().has(Fault::ClampedRinging));
        as_pixel(&pixel, |pixel| technique.diagnose(pixel)).amount(Fault::ClampedRinging)
    }

    #[test]
    fn one_frequency_by_hand() {
        let inputs = [
            ("frequencies", Input::Int(1)),
            ("margin", Input::Float(0.0)),
            ("range", Input::Floats(vec![1.0, 9.0])),
        ];
        // depths 3 and 7 are a quarter and three quarters of the period: sines 1 and −1, cosines 0, a mere ramp; but the
        // first one's own 1/4 + 1/π are more than the quarters of both
        assert_eq!(rings("fourier_opacity_maps", &inputs, &[3.0, 7.0]), 1.0);
        let charged = [&inputs[..], &[("self_correct", Input::Bool(false))]].concat();
        assert_eq!(rings("fourier_opacity_maps", &charged, &[3.0, 7.0]), 0.0);
        // a lone layer at d = 3/4: τ(1/4) = s (1/4 − 1/π (1 − 0)) < 0 where a faint one looks through it
        let technique = build("fourier_opacity_maps", &inputs).unwrap();
        let pixel = [fragment(7.0, [1.0; 3], 0.5, 0), fragment(3.0, [1.0; 3], 1e-6, 1)];
        let found = as_pixel(&pixel, |pixel| technique.diagnose(pixel));
        assert_eq!(found.amount(Fault::ClampedRinging), 1.0);
    }

    /// In front of a dense layer, where nothing is, faint ones see ripples above and below 1.
    #[test]
    fn a_dense_layer_makes_series_ring_and_the_haar_basis_not() {
        let faint = |i: u8| fragment(1.0 + 0.2 * f32::from(i), [1.0; 3], 0.01, i.into());
        let pixel: Vec<_> = (0..40).map(faint).chain([fragment(7.1, [1.0; 3], 0.99, 99)]).collect();
        let found = |id, inputs: &[(&str, Input)]| {
            let technique = build(id, inputs).unwrap();
            as_pixel(&pixel, |pixel| technique.diagnose(pixel)).amount(Fault::ClampedRinging)
        };
        let curve = [("project", Input::Text("transmittance".into()))];
        for rings in [found("fourier_opacity_maps", &[]), found("tfm", &[]), found("tfm", &curve)] {
            assert!(rings >= 5.0, "{rings}");
        }
        assert_eq!(found("wavelet", &[]), 0.0);
    }
}
