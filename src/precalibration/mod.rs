//! Pre-calibration: the micro-image array as a grid.

mod grid;

pub use grid::{MicroImageArray, fit_grid};
