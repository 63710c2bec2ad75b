//! The axis *opacity*, fixed thresholds: a layer covers the samples whose threshold its alpha exceeds, so that
//! masks are nested (alpha to coverage).

use super::layers::Node;
use super::normalize::Core;
use super::opacity::Opacity;
use super::samples::unmultiplied;
use super::stored_layers::Unmultiplied;
use crate::fragments::Fragment;
use crate::technique::Pixel;
use glam::DVec3;

/// As many thresholds `θ_s` = (s + ½) / S as there are samples.
#[derive(Debug, Clone, Copy)]
pub struct Thresholds {
    /// S.
    pub samples: usize,
}

impl Thresholds {
    /// How many of them an alpha exceeds. Which samples these are does not matter, as long as it is the same
    /// ones every time.
    #[expect(
        clippy::cast_precision_loss,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "0 <= a S <= S"
    )]
    pub fn coverage(self, alpha: f32) -> usize {
        (f64::from(alpha) * self.samples as f64 - 0.5).ceil().max(0.0) as usize
    }
}

/// A layer that shows in the samples `from..to`: it covers the first `to`, nearer layers the first `from`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Door {
    from: usize,
    to: usize,
    color: DVec3,
}

impl Door {
    #[expect(clippy::cast_precision_loss, reason = "far fewer than 2^53 samples")]
    fn share(&self) -> f64 {
        self.to.saturating_sub(self.from) as f64
    }
}

impl Unmultiplied for Door {
    fn color_mut(&mut self) -> &mut DVec3 {
        &mut self.color
    }
}

impl Opacity for Thresholds {
    type Paint = Door;

    #[expect(clippy::cast_precision_loss, reason = "far fewer than 2^53 samples")]
    fn clear(&self) -> f64 {
        self.samples as f64
    }
    fn empty(&self) -> Door {
        Door { from: 0, to: 0, color: DVec3::ZERO }
    }
    fn paint(&self, _pixel: &Pixel<'_>, fragment: &Fragment) -> Option<Door> {
        let to = self.coverage(fragment.alpha);
        (fragment.alpha > 0.0).then(|| Door { from: 0, to, color: unmultiplied(fragment) })
    }
    fn occlude(&self, nodes: &mut [Node<Door>], at: usize) {
        let (in_front, rest) = nodes.split_at_mut(at);
        let [newcomer, behind @ ..] = rest else { return };
        for node in in_front {
            newcomer.paint.from = newcomer.paint.from.max(node.paint.to);
        }
        for node in behind {
            node.paint.from = node.paint.from.max(newcomer.paint.to);
        }
    }
    /// Of neighbours the one behind shows in the samples that follow the front one's, if in any.
    fn merge(&self, front: &mut Door, behind: &Door) {
        let (n, m) = (front.share(), behind.share());
        if n + m > 0.0 {
            let from = if n > 0.0 { front.from } else { behind.from };
            let color = (n * front.color + m * behind.color) / (n + m);
            *front = Door { from, to: front.to.max(behind.to), color };
        }
    }
    fn behind(&self, shown: f64, paint: &Door) -> f64 {
        shown - paint.share()
    }
    fn put_behind(&self, core: &mut Core, paint: &Door) {
        let n = paint.share();
        core.color += n * paint.color;
        core.coverage += n;
        core.transmittance -= n;
    }
}
