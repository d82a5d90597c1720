//! Raw images of a simulated camera with complete ground truth.
//!
//! Rays run from points of the pixels through points of the micro-lenses and the main lens into the
//! scene, and are refracted or blocked on the way. Lenses are thin, the main lens has the paper's
//! lateral distortion, the array has all six degrees of freedom; see [`Tracer`]. Nothing here calls the
//! projection model of the C++ core, so each can be tested against the other.
//!
//! [`simulate`] makes a whole data set from [`Settings`].

mod array;
mod data_set;
mod imaging;
mod imperfections;
mod main_lens;
mod presets;
mod rendering;
mod sampling;
mod scene;
mod settings;
mod stage;
#[cfg(test)]
mod tests;
mod tracer;
mod truth;

pub use data_set::{DataSet, Shot};
pub use imaging::Imaging;
pub use imperfections::{FallOff, Imperfections, SecondStop};
pub use presets::{PRESETS, Preset};
pub use scene::{Scene, Target};
pub use settings::{Boards, Settings, TranslationStage, WhiteImages};
pub use stage::{Content, Progress, Simulated, Truth, simulate};
pub use tracer::Tracer;
pub use truth::{Spot, TrueCenter, TrueFeature};
