//! Raw images of a simulated camera with complete ground truth.
//!
//! Rays run from points of the pixels through points of the micro-lenses and the main lens into the
//! scene, and are refracted or blocked on the way. Micro-lenses are thin. The main lens is thin, with the
//! paper's lateral distortion and a curved field, or real, given by its surfaces. The array has all
//! six degrees of freedom. See [`Tracer`]. The simulation does not call the
//! projection model of the C++ core, so each can be tested against the other.
//!
//! [`simulate`] simulates a whole data set from [`Settings`].

mod array;
mod board_texture;
mod data_set;
mod imaging;
mod imperfections;
#[cfg(test)]
mod lenses_tests;
mod main_lens;
mod prescription;
mod presets;
mod ray;
mod rays;
mod real_lens;
#[cfg(test)]
mod real_lens_tests;
#[cfg(test)]
mod realism_tests;
mod rendering;
mod sampling;
mod scene;
mod sensor;
mod settings;
mod spread;
mod stage;
mod target;
#[cfg(test)]
mod tests;
mod thin_lens;
mod tracer;
mod truth;
mod window;

pub use data_set::{Content, DataSet, Shot};
pub use imaging::Imaging;
pub use imperfections::{FallOffLaw, Imperfections, SecondStop};
pub use prescription::{Prescription, Surface};
pub use presets::{PRESETS, Preset};
pub use real_lens::{AllLight, LensFigures};
pub use scene::Scene;
pub use settings::{Boards, Settings, TranslationStage, WhiteImages};
pub use stage::{Progress, Simulated, Truth, simulate};
pub use target::Target;
pub use tracer::Tracer;
pub use truth::{Spot, TrueCenter, TrueFeature};
