//! Values shared by all modules: the camera, the board and its poses, the observations in images, and the scalar relations
//! between them. Nothing here reads files, solves or prints.

mod array_part;
mod board;
mod camera;
mod camera_checks;
mod camera_fields;
mod checks;
mod datasheet;
mod edge_spread;
mod fall_off;
mod lattice;
mod levels;
mod noise;
mod observations;
mod opening;
pub mod optics;
mod parameters;
mod reprojection;
mod sensor;
mod tilt_gradient;

pub use board::{BentBoard, Board, BoardShape, FramePose, Subset};
#[cfg(test)]
pub(crate) use camera::small_camera;
pub use camera::{LensSetting, MainLens, MicroLensArray, PlenopticCamera};
pub(crate) use checks::positive;
pub use datasheet::{Datasheet, InternalParameters};
pub(crate) use edge_spread::{APERTURE_RATIO_MODEL, check_aperture_ratio};
pub use edge_spread::{EdgeSpread, at_most_full};
pub use fall_off::FallOff;
pub use lattice::{
    Configuration, Lattice, LatticeKind, MAX_MICRO_LENSES, Packing, Parity, ROW_DISTANCE,
};
pub(crate) use lattice::{check_array_size, check_lens_types};
pub use levels::SampleLevels;
pub(crate) use levels::full_scale;
pub use noise::{Noise, NoiseSource};
pub(crate) use observations::check_centers;
pub use observations::{
    BapFeature, MIN_CORNERS, MeasuredBlur, MicroImageCenter, Observations, TAKEN, TAKEN_QUANTITIES,
    taken,
};
pub use opening::Opening;
pub use parameters::{MAX_LENS_TYPES, Parameter, SHAPE};
pub use reprojection::{CenterResidual, FeatureResidual, Reprojection, Rmse};
pub(crate) use sensor::MOST_PIXELS;
pub use sensor::Sensor;
pub use tilt_gradient::TiltGradient;
pub(crate) use tilt_gradient::{growth_per_px, lens_over_pupil};
