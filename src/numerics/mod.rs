//! Estimates that a few bad values do not spoil, and small least-squares problems.

mod statistics;

pub(crate) use statistics::median;
