//! Outliers among the features, and the loss that withstands them if features state no σ.

use crate::calibration::Calibration;
use crate::finding::{Finding, Issue};
use crate::model::FeatureResidual;
use crate::numerics::median;
use crate::solver::{CostOptions, Loss, LossKind};

/// Median of the norm of two independent standard normal numbers.
const MEDIAN_NORM: f64 = 1.1774;
/// Residual of an outlier, in typical σ. Noise reaches 5; the corners of a real detector, good and bad ones together,
/// reach 8.
const OUTLYING: f64 = 10.0;
/// Scale of the automatic loss, in σ of a feature: noise alone exceeds it once in 3000 times.
pub(super) const LOSS_SCALE: f64 = 4.0;

/// Feature far from where the camera projects it.
#[derive(Debug, Clone, PartialEq)]
pub struct OutlyingFeature {
    /// Residual of the feature.
    pub residual: FeatureResidual,
    /// Distance |(du, dv)|, px.
    pub distance_px: f64,
    /// Distance in units of its σ, which follows from the residuals of all features.
    pub std_devs: f64,
}

/// Returns the typical residual of features in units of their σ; `None` without features.
fn typical(residuals: &[FeatureResidual], norm: impl Fn(&FeatureResidual) -> f64) -> Option<f64> {
    median(residuals.iter().map(norm)).map(|norm| norm / MEDIAN_NORM)
}

impl Calibration {
    /// Returns the features far from where the camera projects them, the farthest first.
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

/// Returns the loss for features that state no σ, and a finding, if some of the features are outliers. The scale of the
/// loss follows from the residuals of a cost without a loss.
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
