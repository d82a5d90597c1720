//! Checks: functions from measured values to findings, each with its limit and the reason for the limit.
//!
//! The stages measure; everything that judges images, white images, arrays, boards and results stands here.

pub(crate) mod calibration;
