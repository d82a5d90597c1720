//! How good a calibration is: reprojection errors, the uncertainty of the parameters, and detected
//! features against the truth.

mod detection;
mod reprojection;
mod uncertainty;

pub use detection::{DetectionScore, INSIDE_PX, SMALL_RHO_PX, TRUE_PX};
pub use reprojection::{CenterResidual, FeatureResidual, Reprojection, Rmse};
pub use uncertainty::{Component, Uncertainty, WeakDirection};
