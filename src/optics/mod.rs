//! Light of a micro-image: the rays that reach a pixel, and where they come from.
//!
//! Lengths are in pixels. Positions are relative to the centre of the micro-image.
//!
//! A ray to the position p of a pixel passes the opening of the micro-lens at −w, in units of the radius of the opening. It
//! comes from the point
//!
//! ```text
//! y = p − q w        of the pupil, seen through the middle of the micro-lens, and from
//! o = p − ρ w + E/A  of the sharp image,
//! ```
//!
//! where q and ρ are the blur radii of the pupil and of the image (paper, Eq. radiusfinal), and E/A is the transverse
//! aberration of the main lens at y ([`Aberration`]). The ray counts if |y| < a, the radius of the pupil, with the angular
//! response of the pixel as weight ([`Obliquity`]). A pixel collects the rays of its square, blurred by the point spread. White
//! light is the sum of these rays. The light of a checkerboard corner, relative to white light, is the mean of the checkerboard
//! pattern over them ([`Bundle`]).

pub(crate) mod aberration;
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
