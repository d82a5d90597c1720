//! Calibration from observations (paper, section 5): initial intrinsics, initial poses, refinement.

mod aperture_ratio;
mod board;
mod checks;
mod focus;
mod frames;
mod initial;
mod numbering;
mod options;
mod outlying;
mod poses;
mod prepare;
mod priors;
mod problem;
mod refine;
mod refit;
mod result;
mod stage;
mod start;
mod systematic_errors;
mod words;

pub use aperture_ratio::{BlurMeasurement, TypeBlur};
pub use board::{BoardResult, Effort, Trial};
pub use frames::LeftOut;
pub use initial::initial_camera;
pub use options::{
    Blur, BoardModel, CalibrationOptions, Distortion, ExitPupil, FieldCurvature, LensTilt, Method,
    Mode, NoPrior, Pitches, Priors, StatedPrior, Weights, frame_list,
};
pub use outlying::OutlyingFeature;
pub use poses::initial_poses;
pub use prepare::{Solution, initial_from};
pub use priors::{PriorResult, PriorSource, SLOPE, intercept_name};
pub use problem::{ProblemFeature, SolvedProblem};
pub use refit::{Minimum, Refit};
pub use result::Calibration;
pub use stage::{calibrate, cost_at, cost_of_problem_at};
pub use start::Start;
pub use systematic_errors::{APERTURE_RATIO, MODEL_ERRORS};
pub use words::{termination_text, weakest_directions_text};
