//! Checks: functions from measured values to findings, each with its limit and the reason for the limit.
//!
//! The stages measure; what judges images, white images, arrays, boards and results stands here. Limits by which an estimator
//! chooses, as of outliers or between explanations, stand with the estimator.

pub(crate) mod boards;
pub(crate) mod calibration;
pub(crate) mod camera;
pub(crate) mod steps;
pub(crate) mod whites;
