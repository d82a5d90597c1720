//! Pre-calibration: the micro-image array and the internal parameters, from white images (paper,
//! section 3 and "Features extraction").

mod array;
mod array_doubts;
mod black;
mod centers;
mod centroid;
mod centroid_shift;
mod checks;
mod correction;
mod disc_fit;
mod discs;
mod f_numbers;
mod fall_off;
mod grid;
mod indexing;
mod internal;
mod lean;
mod levers;
mod linearity;
mod nodes;
mod pattern;
mod profile;
mod radii;
mod rings;
mod roundness;
mod samples;
mod seen;
mod stack;
mod stage;
mod types;
mod verdicts;

pub use array::{
    ArrayMeasurement, LeftOutCenters, lattice_centers, lattice_orientation, measure_array,
};
pub use checks::check_stated_pitch;
pub use grid::{MicroImageArray, fit_grid};
pub use internal::{InternalFit, RadiusMeasurement};
pub use radii::RadiusEstimator;
pub use stage::{Precalibration, PrecalibrationOptions, White, precalibrate};
pub use types::LensTypes;
