//! Features far from where the camera projects them, and the loss that withstands them where features state no σ.

use crate::calibration::Calibration;
use crate::finding::{Finding, Issue};
use crate::model::FeatureResidual;
use crate::numerics::median;
use crate::solver::{CostOptions, Loss, LossKind};

/// The norm of two independent standard normal numbers has this median.
const MEDIAN_NORM: f64 = 1.1774;
/// Features outlie if their residual is so many times the typical σ: noise gets to 5, and the corners
/// of a real detector, good and bad ones together, to 8.
const OUTLYING: f64 = 10.0;
/// Where the automatic loss sets in, in σ of a feature: noise alone gets there once in 3000 times.
pub(super) const LOSS_SCALE: f64 = 4.0;

/// A feature far from where the camera projects it.
#[derive(Debug, Clone, PartialEq)]
pub struct OutlyingFeature {
    /// Its residual.
    pub residual: FeatureResidual,
    /// |(du, dv)|, px.
    pub distance_px: f64,
    /// The same in units of its σ, as the residuals of all features measure it.
    pub std_devs: f64,
}

/// What the residuals of features are in units of their σ; `None` without features.
fn typical(residuals: &[FeatureResidual], norm: impl Fn(&FeatureResidual) -> f64) -> Option<f64> {
    median(residuals.iter().map(norm)).map(|norm| norm / MEDIAN_NORM)
}

impl Calibration {
    /// Features far from where the camera projects them, the farthest first.
    #[must_use]
    pub fn outlying_features(&self) -> Vec<OutlyingFeature> {
        outlying(&self.reprojection.features)
    }
}

fn outlying(residuals: &[FeatureResidual]) -> Vec<OutlyingFeature> {
    let Some(typical) = typical(residuals, FeatureResidual::norm) else { return Vec::new() };
    let of = |r: &FeatureResidual| {
        let std_devs = r.norm() / typical;
        let distance_px = r.du_px.hypot(r.dv_px);
        (std_devs > OUTLYING).then_some(OutlyingFeature { residual: *r, distance_px, std_devs })
    };
    let mut found: Vec<OutlyingFeature> = residuals.iter().filter_map(of).collect();
    found.sort_by(|a, b| b.std_devs.total_cmp(&a.std_devs));
    found
}

/// The loss for features that state no σ, if some of them outlie: its scale is that of the residuals of a cost
/// without one. With a finding.
pub(super) fn loss_by_residuals(
    residuals: &[FeatureResidual],
    cost: &CostOptions,
) -> Option<(Loss, Finding)> {
    let features = outlying(residuals).len();
    let norm = |r: &FeatureResidual| {
        let rho = r.drho_px.filter(|_| cost.rho).unwrap_or(0.0) / cost.rho_std_dev_px;
        (r.norm() / cost.uv_std_dev_px).hypot(rho)
    };
    let typical = typical(residuals, norm).filter(|typical| features > 0 && *typical > 0.0)?;
    let scale = LOSS_SCALE * typical;
    let finding =
        Finding::note(Issue::OutlyingUnweighted { features, all: residuals.len(), scale });
    Some((Loss { kind: LossKind::Huber, scale }, finding))
}
