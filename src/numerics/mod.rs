//! Robust estimates and small least-squares problems.

mod levenberg_marquardt;
mod linear;
mod robust;
pub(crate) mod simd;
mod statistics;

pub(crate) use levenberg_marquardt::{Descent, LeastSquares};
pub(crate) use linear::NormalEquations;
pub(crate) use robust::{Outliers, Reweighted, Scale, Weight, fit};
pub(crate) use statistics::{mean_and_std_dev, median, normal_deviate, weighted_mean};
