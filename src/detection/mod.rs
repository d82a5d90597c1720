//! BAP features from raw images of a checkerboard (paper, section 4).
//!
//! In the first pass micro-images are searched for a corner, each alone: one in four, those about corners, and all where
//! these do not show the board. Observations of one corner lie on
//! a line, and the pinhole images of all lines on the lattice of the board, which labels them. In the
//! second pass every corner of the board is searched for in the micro-images that should show it.

mod aberration_fit;
mod board;
mod board_images;
mod cells;
mod corner;
mod corner_fit;
mod corner_measurement;
mod dbscan;
mod detect_frame;
mod distortion;
mod edge_width;
mod exposure;
mod features;
mod findings;
mod first_pass;
mod flat_field;
mod frame;
mod grouping;
mod line;
mod micro_images;
mod micro_optics;
mod observation;
mod patch;
mod saddle;
mod second_pass;
mod slope_field;
mod stage;
#[cfg(test)]
mod tests;

pub use board::check_board_size;
pub use board_images::{BoardImage, DetectedBoards, DetectedFrame};
pub use detect_frame::detect_frame;
pub use features::{DetectedCorner, Detection, Edges};
pub use frame::{FrameCounts, Search};
pub use line::CornerLine;
pub use micro_images::{MicroImages, check_configuration};
pub use micro_optics::MicroOptics;
pub(crate) use observation::CornerObservation;
pub use observation::DepthEstimator;
pub use stage::{AT_ONCE, detect};

pub use crate::optics::Aberration;
