//! How good a calibration is: reprojection errors and the uncertainty of the parameters.

mod reprojection;
mod uncertainty;

pub use reprojection::{CenterResidual, FeatureResidual, Reprojection, Rmse};
pub use uncertainty::{Component, Uncertainty, WeakDirection};
