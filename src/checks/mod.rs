//! Checks: functions from measured values to findings, each with its limit and the reason for the limit.
//!
//! The stages measure; the checks judge images, white images, arrays, boards and results. Limits by which an estimator chooses,
//! such as limits of outliers, stand with the estimator.

pub(crate) mod boards;
pub(crate) mod calibration;
pub(crate) mod camera;
pub(crate) mod steps;
pub(crate) mod whites;
