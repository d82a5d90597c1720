//! Pre-calibration: the micro-image array and the internal parameters, from white images (paper,
//! section 3 and "Features extraction").

mod array;
mod array_checks;
mod array_search;
mod black;
mod centers;
mod centroid;
mod centroid_shift;
mod checks;
mod disc_geometry;
mod discs;
mod f_numbers;
mod fall_off;
mod grid;
mod indexing;
mod internal;
mod lens_types;
mod linearity;
mod measurement;
mod micro_image_status;
mod nodes;
mod opening;
mod options;
mod pattern;
mod profile;
mod radii;
mod result;
mod rings;
mod roundness;
mod samples;
mod stage;
mod tilt_gradient;

pub use array::{ArrayMeasurement, LeftOutCenters, LensTypes};
pub use array_checks::array_findings;
pub use array_search::{lattice_centers, lattice_orientation, measure_array};
pub use checks::check_stated_pitch;
pub use grid::{MicroImageArray, fit_grid};
pub use internal::{InternalFit, RadiusMeasurement};
pub use options::{PrecalibrationOptions, White};
pub use radii::RadiusEstimator;
pub use result::Precalibration;
pub use stage::precalibrate;
