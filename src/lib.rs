//! Calibration of multi-focus plenoptic (light-field) cameras.
//!
//! plenocal implements *Blur Aware Calibration of Multi-Focus Plenoptic Camera* (Labussière,
//! Teulière, Bernardin, Ait-Aider, CVPR 2020), "the paper" below. A calibration takes what was seen,
//! micro-image centres and BAP features, and gives the camera, the poses of the boards, and how
//! certain they are:
//!
//! ```no_run
//! use std::path::Path;
//! use plenocal::calibration::{CalibrationOptions, Start, calibrate};
//! use plenocal::io::{Project, read_centers, read_features};
//!
//! # fn main() -> plenocal::Result<()> {
//! let project = Project::read(Path::new("data/synthetic/project.toml"))?;
//! let start = Start::Datasheet(
//!     project.datasheet()?.expect("a camera"),
//!     project.internal().expect("internal parameters"),
//! );
//! let mut observations = read_features(Path::new("data/synthetic/features.csv"), true)?;
//! observations.centers = read_centers(Path::new("data/synthetic/centers.csv"))?;
//! let board = project.board.expect("a board");
//! let options = CalibrationOptions::default();
//! let calibration = calibrate(&start, &board, &observations, &options, &mut |_| true)?;
//! println!("F = {} mm", calibration.camera.main_lens.focal_length_mm);
//! # Ok(())
//! # }
//! ```
//!
//! [`simulation`] makes raw images of a known camera by ray tracing, with their truth.
//!
//! # Frames and units
//!
//! Lengths are in mm, angles in rad, image quantities in px; names carry the unit.
//!
//! - *Image*: pixel (0, 0) is the centre of the top-left pixel; u to the right, v down.
//! - *Camera*: origin at the centre O of the main lens, z towards the scene, x right, y down.
//! - *Sensor*: the plane z = −(D + d). The image is stored upright, so pixels run against the
//!   optical image: u = u₀ − x/s, v = v₀ − y/s.
//! - *Array*: origin at the middle of the micro-lenses, axes those of the camera turned by
//!   R = Rz·Ry·Rx. Micro-lens and micro-image (k, l) are the same one; k grows with u and l with v,
//!   hence node(k, l) lies at −ΔC times its lattice position.
//! - *Board*: corners at z = 0, x along its columns, y along its rows. `camera_from_board` takes its
//!   points into the camera frame.
//! - *Lens types*: by the colouring of the lattice, see [`model::Lattice::lens_type`].
//!
//! COMPOTE's files follow other conventions; only [`io::compote`] knows them.
//!
//! # Symbols
//!
//! | paper | code | unit | meaning, equation |
//! |---|---|---|---|
//! | F | `focal_length_mm` | mm | focal length of the main lens |
//! | Q₁ Q₂ Q₃, P₁ P₂ | `radial`, `tangential` | mm⁻², mm⁻⁴, mm⁻⁶; mm⁻¹ | Brown-Conrady distortion of the image point |
//! | (u₀, v₀) | `principal_point_px` | px | where the optical axis meets the sensor |
//! | d | `mla_to_sensor_mm` | mm | array to sensor, at the middle of the array |
//! | D | `lens_to_mla_mm` | mm | main lens to array, at the middle of the array |
//! | θx θy θz | `rotation_rad` | rad | misalignment of the array |
//! | t_x t_y | `offset_mm` | mm | middle of the array in the camera frame |
//! | ΔC | `pitch_mm`, `pitch_ratio` | mm, 1 | distance of neighbouring micro-lenses, Eq. (mlinterdist) |
//! | f⁽ⁱ⁾ | `focal_lengths_mm` | mm | focal lengths of the micro-lenses by type |
//! | s | `pixel_size_mm` | mm | edge of a pixel |
//! | Δc, δc | `micro_image_pitch_mm`, `pitch_px` | mm, px | distance of neighbouring micro-image centres |
//! | h, H | `focus_distance_mm` | mm | focus distance and its image distance ([`model::optics`]) |
//! | N | `f_number` | 1 | f-number |
//! | m, q'ᵢ | `m_mm`, `q_prime_mm` | mm | internal parameters, Eq. (miradiusfnumber) |
//! | ρ | `rho_px` | px | signed blur radius, Eq. (blurradius) |
//! | (u, v, ρ) | [`model::BapFeature`] | px | BAP feature, Eq. (completemodel) |
//!
//! # Where the equations are
//!
//! The projection, Eq. (completemodel), and the blur radius, Eq. (blurradius), are in the C++
//! header `cpp/include/plenocal/projection.hpp`, and nowhere else; the cost of section 5.3 is in
//! `residuals.hpp` beside it. The scalar relations of section 5.1 are in [`model::optics`].

#![allow(clippy::doc_markdown)] // names such as COMPOTE and plenocal are no code

pub mod calibration;
pub mod detection;
pub mod error;
pub mod evaluation;
pub mod image;
pub mod io;
pub mod model;
pub mod precalibration;
pub mod report;
pub mod simulation;
pub mod solver;

mod numerics;
mod vignetting;

pub use error::{Error, Result};
