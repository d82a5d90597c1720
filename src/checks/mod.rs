//! Checks: functions from measured values to findings, each with its limit and the reason for the limit.
//!
//! The stages measure; everything that judges images, white images, arrays, boards and results stands here.

pub(crate) mod boards;
pub(crate) mod calibration;
pub(crate) mod steps;
pub(crate) mod whites;
