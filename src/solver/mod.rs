//! The interface to the C++ core: projection, refinement, uncertainty.

mod bridge;
mod options;
mod problem;
mod refinement;
mod synthetic;
mod uncertainty;

pub use bridge::{distortion_mm, silence_log};
pub(crate) use bridge::{
    frame_information, metric_points, micro_images_at, object_rays, pixel_rays,
    point_sensitivities, project, project_centers, refine, triangulate, uncertainty,
    virtual_depths, visible_features,
};
pub(crate) use options::shape_names;
pub use options::{Anchor, BEYOND_THE_PAPER, CostOptions, Loss, LossKind, SolverOptions};
pub(crate) use problem::{PointSensitivity, Problem, Projected, SolverCenter, SolverFeature};
pub use refinement::{Iteration, Refinement, Termination};
pub use synthetic::{synthesize, synthesize_bent};
pub use uncertainty::{CommonError, Component, Uncertainty, WeakDirection};
