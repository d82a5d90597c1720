//! Calibration of multi-focus plenoptic (light-field) cameras.
//!
//! plenocal implements *Blur Aware Calibration of Multi-Focus Plenoptic Camera* (Labussière,
//! Teulière, Bernardin, Ait-Aider, CVPR 2020), "the paper" below.
//!
//! # Stages
//!
//! Every stage is a function that takes values and returns a value: [`simulation::simulate`],
//! [`precalibration::precalibrate`], [`detection::detect`], [`calibration::calibrate`],
//! [`assessment::evaluate`]. Findings are part of the result; only [`io`] reads and
//! writes files. The whole pipeline in memory, on a simulated camera:
//!
//! ```
//! use plenocal::calibration::{CalibrationOptions, Start, calibrate};
//! use plenocal::detection::{BoardImage, DepthEstimator, MicroImages, Search, detect};
//! use plenocal::assessment::{Candidate, EvaluationInput, evaluate};
//! use plenocal::image::RawImage;
//! use plenocal::model::{BoardShape, Observations, Subset};
//! use plenocal::precalibration::{PrecalibrationOptions, White, precalibrate};
//! use plenocal::simulation::{Content, Settings, simulate};
//!
//! # fn main() -> plenocal::Result<()> {
//! // Few rays and boards, to save time.
//! let few = ["rays=16", "boards.calibration=4", "boards.evaluation=2", "translation.images=0"];
//! let settings = Settings::preset("mini", &few.map(str::to_owned))?;
//! let (mut whites, mut boards, mut others) = (Vec::new(), Vec::new(), Vec::new());
//! let simulated = simulate(&settings, None, &(), &mut |content, shot, image| {
//!     let white = |image| White { name: format!("{content:?}"), f_number: shot.stated_f_number, image };
//!     match content {
//!         Content::White(_) | Content::Devignetting => whites.push(white(image)),
//!         Content::Board(Subset::Calibration, frame) => boards.push((frame, image)),
//!         Content::Board(_, frame) => others.push((frame, image)),
//!     }
//!     Ok(())
//! })?;
//! let reference = whites.pop().expect("the devignetting image is the last white image");
//!
//! // What a user would state about this camera.
//! let (sheet, board) = (settings.datasheet(), settings.target.board());
//! let options = PrecalibrationOptions::of_datasheet(&sheet);
//! let measured = precalibrate(&whites, Some(&reference), &options, &|| ())?;
//!
//! let micro_images = MicroImages::of_precalibration(&measured, &sheet)?;
//! let (micro_images, sensor, estimator) = (&micro_images, &sheet.sensor, DepthEstimator::Line);
//! let search = Search { micro_images, board: &board, sensor, estimator };
//! let find = |images: &[(u32, RawImage)], subset| {
//!     let images: Vec<BoardImage> = images
//!         .iter()
//!         .map(|(frame, image)| BoardImage::new(*frame, format!("frame {frame}"), image))
//!         .collect();
//!     detect(&images, &reference.image, &search, subset, &|_, _| Ok(()))
//! };
//! let found = find(&boards, Subset::Calibration)?;
//!
//! let start = Start::Datasheet(sheet, measured.internal.parameters.clone());
//! let observations = found.observations(measured.array.centers.clone());
//! let options = CalibrationOptions::default();
//! let calibration = calibrate(&start, &board, &observations, &options, &mut |_| true)?;
//! assert!(calibration.converged);
//!
//! let candidate = Candidate {
//!     name: "simulated".to_owned(),
//!     std_devs: calibration.uncertainty.intrinsic_std_devs(calibration.camera.lens_types()),
//!     board_shape: calibration.board.bent.shape,
//!     shape_std_devs: calibration.board.std_devs,
//!     camera: calibration.camera,
//! };
//! let mut input = EvaluationInput::new(board);
//! input.evaluation = find(&others, Subset::Evaluation)?.features();
//! input.truth = Some(simulated.truth.camera);
//! input.true_board = Some(BoardShape::default());
//! let evaluation = evaluate(&[candidate], &input, &|| ());
//! assert!(evaluation.findings.is_empty());
//! let errors = evaluation.candidates[0].truth.as_ref().expect("the truth is known");
//! println!("F is off by {:.3} mm", errors[0].error());
//! # assert!((errors[0].error() / errors[0].truth).abs() < 0.02);
//! # Ok(())
//! # }
//! ```
//!
//! # Frames and units
//!
//! Lengths are in mm, angles in rad, image quantities in px; names end in the unit.
//!
//! - *Image*: pixel (0, 0) is the centre of the top-left pixel; u to the right, v down.
//! - *Camera*: origin at the centre O of the main lens, z towards the scene, x right, y down.
//! - *Sensor*: the plane z = −(D + d). The image is stored upright, so pixels run against the
//!   optical image: u = u₀ − x/s, v = v₀ − y/s.
//! - *Array*: origin at the middle of the micro-lenses; the axes are the camera's, rotated by R = Rz·Ry·Rx. Micro-lens (k, l)
//!   forms micro-image (k, l); k increases with u and l with v, so node(k, l) lies at −ΔC times its lattice position.
//! - *Board*: corners at z = 0, x along a row, y along a column. `camera_from_board` maps its points to the camera frame.
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
//! | Q₁ₘ | `q1_growth_per_mm2` | mm⁻² | growth of the distortion with the magnification (not in the paper) |
//! | κ | `field_curvature_per_mm` | mm⁻¹ | curvature of the field (not in the paper) |
//! | κ_m | `field_curvature_growth_per_mm` | mm⁻¹ | derivative of the curvature by the magnification (not in the paper) |
//! | ω = (ωx, ωy) | `rotation_rad` of the main lens | rad | tilt of the optical axis against the normal of the sensor (not in the paper) |
//! | P = (e_x, e_y, e_z) | `exit_pupil_mm` | mm | centre of the exit pupil (at 0 in the paper) |
//! | e_r | `pupil_aberration_per_mm` | mm⁻¹ | spherical aberration of the exit pupil (not in the paper) |
//! | (u₀, v₀) | `principal_point_px` | px | O projected onto the sensor |
//! | d | `mla_to_sensor_mm` | mm | array to sensor, at the middle of the array |
//! | D | `lens_to_mla_mm` | mm | main lens to array, at the middle of the array |
//! | θx θy θz | `rotation_rad` | rad | misalignment of the array |
//! | t_x t_y | `offset_mm` | mm | middle of the array in the camera frame |
//! | ΔC | `pitch_mm`, `pitch_ratio` | mm, 1 | distance between neighbouring micro-lenses, Eq. (mlinterdist) |
//! | f⁽ⁱ⁾ | `focal_lengths_mm` | mm | focal lengths of the micro-lenses by type |
//! | s | `pixel_size_mm` | mm | side of a pixel |
//! | Δc, δc | `micro_image_pitch_mm`, `pitch_px` | mm, px | distance between neighbouring micro-image centres |
//! | h, H | `focus_distance_mm` | mm | focus distance and its image distance ([`model::optics`]) |
//! | N | `f_number` | 1 | f-number |
//! | m, q'ᵢ | `m_mm`, `q_prime_mm` | mm | internal parameters, Eq. (miradiusfnumber) |
//! | ρ | `rho_px` | px | signed blur radius, Eq. (blurradius) |
//! | (u, v, ρ) | [`model::BapFeature`] | px | BAP feature, Eq. (completemodel) |
//!
//! # Where the equations are
//!
//! The C++ header `cpp/include/plenocal/projection.hpp` has the projection, Eq. (completemodel), and the blur radius of a
//! camera, Eq. (blurradius). `src/detection/micro_optics.rs` has the blur radius in images, Eq. (radiusfinal), `residuals.hpp`
//! the cost of section 5.3, and [`model::optics`] the scalar relations of section 5.1.

#![allow(clippy::doc_markdown)] // names such as COMPOTE and plenocal are not code

pub mod assessment;
pub mod calibration;
pub mod detection;
pub mod error;
pub mod finding;
pub mod image;
pub mod io;
pub mod model;
pub mod precalibration;
pub mod quantity;
pub mod report;
pub mod simulation;
pub mod solver;

mod checks;
mod numerics;
mod optics;
mod table;

pub use error::{Error, Result};
pub use finding::{Finding, Issue, Severity, Subject};
pub use quantity::Estimate;
