//! Reprojection errors: observed minus projected, and their root mean squares (Table 4).

use serde::Serialize;

use crate::model::{BapFeature, MicroImageCenter};

/// Feature and its reprojection error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FeatureResidual {
    /// Observed feature.
    pub feature: BapFeature,
    /// Index of the lens type, from 0.
    pub lens_type: usize,
    /// Observed minus projected u, px.
    pub du_px: f64,
    /// Observed minus projected v, px.
    pub dv_px: f64,
    /// Observed minus projected ρ, px; `None` for a pinhole array.
    pub drho_px: Option<f64>,
}

impl FeatureResidual {
    /// Returns |(du, dv)| over the σ of the feature; in px if it has none.
    #[must_use]
    pub fn norm(&self) -> f64 {
        let [u, v] = self.feature.std_dev_px.unwrap_or([1.0; 2]);
        (self.du_px / u).hypot(self.dv_px / v)
    }
}

/// Micro-image centre and its reprojection error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CenterResidual {
    /// Observed centre.
    pub center: MicroImageCenter,
    /// Index of the lens type, from 0.
    pub lens_type: usize,
    /// Observed minus projected u, px.
    pub du_px: f64,
    /// Observed minus projected v, px.
    pub dv_px: f64,
}

/// All reprojection errors of a calibration.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Reprojection {
    /// Residuals of all used features.
    pub features: Vec<FeatureResidual>,
    /// Residuals of all used centres.
    pub centers: Vec<CenterResidual>,
}

/// Root mean square errors of features, as in the paper's Table 4:
/// uv² = mean(du² + dv²), rho² = mean(dρ²), all² = uv² + rho². In px; NaN without observations.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Rmse {
    /// Number of features.
    #[serde(rename = "features")]
    pub count: usize,
    /// Error of (u, v, ρ).
    #[serde(rename = "all")]
    pub all_px: f64,
    /// Error of (u, v).
    #[serde(rename = "uv")]
    pub uv_px: f64,
    /// Error of ρ; `None` for a pinhole array.
    #[serde(rename = "rho")]
    pub rho_px: Option<f64>,
}

impl Rmse {
    /// Computes the errors of some features.
    pub fn of<'a>(features: impl IntoIterator<Item = &'a FeatureResidual>) -> Self {
        let (mut count, mut uv, mut rho) = (0_usize, 0.0, None);
        for f in features {
            count += 1;
            uv += f.du_px.powi(2) + f.dv_px.powi(2);
            if let Some(drho) = f.drho_px {
                *rho.get_or_insert(0.0) += drho.powi(2);
            }
        }
        let root = |sum: f64| (sum / count as f64).sqrt();
        Self {
            count,
            all_px: root(uv + rho.unwrap_or(0.0)),
            uv_px: root(uv),
            rho_px: rho.map(root),
        }
    }
}

impl Reprojection {
    /// Computes the errors of all features.
    #[must_use]
    pub fn rmse(&self) -> Rmse {
        Rmse::of(&self.features)
    }

    /// Computes the errors of the features of one frame.
    #[must_use]
    pub fn frame_rmse(&self, frame: u32) -> Rmse {
        Rmse::of(self.features.iter().filter(|f| f.feature.frame == frame))
    }

    /// Computes the errors of the features seen through one lens type.
    #[must_use]
    pub fn lens_type_rmse(&self, lens_type: usize) -> Rmse {
        Rmse::of(self.features.iter().filter(|f| f.lens_type == lens_type))
    }

    /// Computes √mean(du² + dv²) over the centres, px; `None` without centres.
    #[must_use]
    pub fn centers_rmse_px(&self) -> Option<f64> {
        let sum: f64 = self.centers.iter().map(|c| c.du_px.powi(2) + c.dv_px.powi(2)).sum();
        (!self.centers.is_empty()).then(|| (sum / self.centers.len() as f64).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn residual(frame: u32, du_px: f64, dv_px: f64, drho_px: Option<f64>) -> FeatureResidual {
        let feature = BapFeature {
            frame,
            corner: 0,
            k: 0,
            l: 0,
            u_px: 0.0,
            v_px: 0.0,
            rho_px: None,
            std_dev_px: None,
            rho_std_dev_px: None,
            correlation: 0.0,
            sensitivities_px: None,
            blur: None,
        };
        FeatureResidual { feature, lens_type: 0, du_px, dv_px, drho_px }
    }

    #[test]
    fn rmse_is_per_feature_as_in_table_4() {
        let features = vec![residual(0, 3.0, 4.0, Some(1.0)), residual(1, 0.0, 0.0, Some(-7.0))];
        let all = Reprojection { features, centers: vec![] };
        let rmse = all.rmse();
        assert_eq!(rmse.count, 2);
        assert!((rmse.uv_px - 12.5_f64.sqrt()).abs() < 1e-15);
        assert!((rmse.rho_px.unwrap() - 5.0).abs() < 1e-15);
        assert!((rmse.all_px - 37.5_f64.sqrt()).abs() < 1e-15);
        assert!((all.frame_rmse(0).uv_px - 5.0).abs() < 1e-15);
        assert_eq!(all.centers_rmse_px(), None);
    }
}
