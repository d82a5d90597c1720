//! Using a calibrated camera: from pixels back into space.
//!
//! A pixel seen through a micro-lens is a ray in space. With the virtual depth of what it shows, or seen through several
//! micro-lenses, it is a point. The model is that of the C++ core (`cpp/include/plenocal/inverse.hpp`); here many pixels
//! go at once, on all cores.

mod stage;
#[cfg(test)]
mod tests;

pub use stage::{
    Corners, corners, focused_points, metric_points, micro_images_at, object_rays, pixel_rays,
    triangulate, virtual_depths,
};
