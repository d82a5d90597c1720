//! BAP features from raw images of a checkerboard (paper, section 4).
//!
//! The first pass searches single micro-images for a corner: one in four, those near corners, and all if these do not show the
//! board. Observations of one corner lie on a line, and the pinhole images of all lines lie on the lattice of the board, which
//! labels them. The second pass searches for every corner of the board in the micro-images that should show it.

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
