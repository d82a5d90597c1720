//! Whether a calibration is to be trusted, where in space, and what would improve it.

mod next_board;
mod object_space;
mod outliers;
mod patterns;
mod stage;
mod verdict;

pub use next_board::NextBoard;
pub use object_space::{Distance, ObjectSpace, PointTrust};
pub use outliers::{Influence, Outliers, OutlyingFrame};
pub use patterns::{Patterns, image_pattern};
pub use stage::{Assessment, assess};
pub use verdict::Verdict;
