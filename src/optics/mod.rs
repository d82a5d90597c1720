//! The light of a micro-image: which rays reach a pixel, and what they show.
//!
//! All lengths are in pixels, all places from the centre of the micro-image.
//!
//! A ray to the place p of a pixel passes the opening of the micro-lens at w, in units of its radius and half a turn from where
//! it lies. It comes from the place
//!
//! ```text
//! y = p − q w        of the pupil, seen through the middle of the micro-lens, and from
//! o = p − ρ w + E/A  of the sharp image,
//! ```
//!
//! with q and ρ the blur radii of the pupil and of the image (paper, Eq. radiusfinal) and E/A the transverse aberration of the
//! main lens at y ([`Aberration`]). It counts if |y| < a, the radius of the pupil, by the angular response of the pixel
//! ([`Obliquity`]). A pixel collects the rays of its square, blurred by the point spread. White light is the sum of these rays,
//! and a corner of a checkerboard the mean of what they show of it ([`Bundle`]).

mod aberration;
mod bundle;
#[cfg(test)]
mod oracle;
mod quadrature;
mod response;
mod rim;
mod white;

pub use aberration::Aberration;
pub(crate) use bundle::{Bundle, Column, CornerEdges, CornerLight};
pub(crate) use response::Obliquity;
pub(crate) use white::{RadialPixels, Seen, WhiteDiscs};
