//! Vignetting: which part of the pupil a pixel sees, through which part of a micro-lens, and how
//! obliquely.

mod obliquity;
mod overlap;
mod pixel;
mod points;
mod visible_part;

pub(crate) use obliquity::{Field, Obliquity};
pub(crate) use overlap::{Overlap, overlap, overlap_area};
pub(crate) use pixel::Pixel;
pub(crate) use points::{DISC, POINTS, ROOM, cells_of_disc};
pub(crate) use visible_part::{PartPoints, Vignetting, VisiblePart};
