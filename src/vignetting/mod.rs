//! Which part of the pupil a pixel sees, through which part of a micro-lens, and how obliquely.

mod discs;
mod shade;

pub(crate) use discs::{CommonPart, Obliquity, common_part, overlap};
pub(crate) use shade::Shade;
