//! Pre-calibration: the micro-image array and the internal parameters, from white images (paper,
//! section 3 and "Features extraction").

mod array;
mod centers;
mod grid;
mod internal;
mod nodes;
mod pattern;
mod profile;
mod radii;
mod shading;
mod stage;
mod types;

pub use array::{
    ArrayMeasurement, LeftOutCenters, lattice_centers, lattice_orientation, measure_array,
};
pub use grid::{MicroImageArray, fit_grid};
pub use internal::{InternalFit, RadiusMeasurement};
pub use radii::RadiusEstimator;
pub use stage::{Precalibration, PrecalibrationOptions, White, precalibrate};
pub use types::LensTypes;
