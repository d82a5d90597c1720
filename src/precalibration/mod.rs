//! Pre-calibration: the micro-image array and the internal parameters, from white images (paper,
//! section 3 and "Features extraction").

mod array;
mod centers;
mod grid;
mod pattern;

pub use array::{ArrayMeasurement, LeftOutCenters, measure_array};
pub use grid::{MicroImageArray, fit_grid};
