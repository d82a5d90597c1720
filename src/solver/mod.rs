//! Interface to the C++ core: projection, refinement, uncertainty, and use of a calibrated camera.
//!
//! The equations are in the C++ core, in `cpp/include/plenocal`. A pixel seen through a micro-lens determines a ray in space.
//! With a virtual depth, or seen through several micro-lenses, it determines a point. Back-projection processes many pixels at
//! once, on all cores.

mod back_projection;
mod bridge;
mod conversions;
mod corners;
mod forward;
mod options;
mod problem;
mod refinement;
mod synthetic;
#[cfg(test)]
mod tests;
mod uncertainty;

pub use back_projection::{
    focused_points, metric_points, micro_images_at, object_rays, pixel_rays, triangulate,
    virtual_depths,
};
pub use bridge::ffi::{
    CostOptions, Iteration, Loss, LossKind, Matrix, MetricPoint, MicroPixel, Prior, Ray, SeenPoint,
    Sighting, SolverOptions, SystematicChange, SystematicError, Termination, Uncertainty,
    VirtualPoint,
};
pub(crate) use bridge::ffi::{PointSensitivity, Projected, SolverCenter, SolverFeature};
pub use bridge::silence_log;
pub use corners::{Corners, corners};
pub use forward::distortion_mm;
pub(crate) use forward::{point_sensitivities, project, project_centers, visible_features};
pub(crate) use options::names;
pub(crate) use problem::Problem;
pub use refinement::Refinement;
pub(crate) use refinement::refine;
pub use synthetic::{synthesize, synthesize_bent};
pub use uncertainty::{Component, WeakDirection};
pub(crate) use uncertainty::{frame_information, uncertainty};
