//! The settings of a simulated data set, as they appear in a simulation file.

use std::ops::RangeInclusive;

use serde::{Deserialize, Serialize};

use super::imaging::Imaging;
use super::imperfections::Imperfections;
use super::main_lens::check_camera;
use super::prescription::Prescription;
use super::real_lens::LensFigures;
use super::target::Target;
use super::tracer::{Tracer, check_rays};
use crate::error::{Error, Result};
use crate::model::{Configuration, Datasheet, EdgeSpread, Noise, PlenopticCamera, positive};

/// A simulated data set: camera, target, and the images to take.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Number of rays for every pixel through every micro-lens that reaches it.
    pub rays: u32,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Focal length engraved on the main lens, mm, which the project file states.
    pub engraved_focal_length_mm: f64,
    /// F-number that the project file states for the boards; the true one if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub engraved_f_number: Option<f64>,
    /// True camera. Its main lens has the setting of the images of boards.
    pub camera: PlenopticCamera,
    /// Surfaces of a real main lens, which is scaled to the camera's F. If left out, the main lens is the thin
    /// lens of the model. The camera's exit pupil follows from the prescription.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prescription: Option<Prescription>,
    /// Departures from the ideal model.
    #[serde(default)]
    pub imperfections: Imperfections,
    /// Settings of the sensor.
    #[serde(default)]
    pub imaging: Imaging,
    /// White images for the pre-calibration.
    pub white_images: WhiteImages,
    /// The checkerboard.
    pub target: Target,
    /// Boards at random poses.
    pub boards: Boards,
    /// Board that moves along z.
    pub translation: TranslationStage,
    /// Noise of the observations that are drawn from the truth.
    #[serde(default)]
    pub observation_noise: Noise,
}

/// White images at several f-numbers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WhiteImages {
    /// F-numbers that the project file states, √(2^AV).
    pub f_numbers: Vec<f64>,
    /// Relative excess of the true over the stated f-number, for each image; empty for no errors.
    #[serde(default)]
    pub stop_errors: Vec<f64>,
    /// Exposure of these images, see [`Imaging::exposure`]; the exposure of the boards if left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exposure: Option<f64>,
    /// Gain of these images; the gain of the boards if left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gain: Option<f64>,
}

/// Boards at random poses, each mostly in view.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Boards {
    /// Number of boards to calibrate with.
    pub calibration: usize,
    /// Number of boards to evaluate with.
    pub evaluation: usize,
    /// Nearest and furthest distance from the main lens to the middle of a board, mm; each subset
    /// covers the range evenly.
    pub depth_mm: [f64; 2],
    /// Largest tilt out of the image plane, degrees.
    pub max_tilt_deg: f64,
    /// Largest rotation in the image, in either direction, degrees.
    pub max_turn_deg: f64,
    /// Smallest fraction of the corners that lies in the image.
    pub min_in_view: f64,
    /// Motion of the board during the exposure, px in the image of the main lens, in a random direction.
    #[serde(default)]
    pub motion_px: f64,
}

/// A linear stage that moves a board along z in known steps.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TranslationStage {
    /// Number of images; 0 for none.
    pub images: usize,
    /// First distance of the board's middle, mm.
    pub start_mm: f64,
    /// Displacement between images, mm; negative towards the camera.
    pub step_mm: f64,
}

const MAX_MICRO_LENSES: u64 = 1 << 20;
const MAX_IMAGES: u64 = 1000;
const F_NUMBERS: RangeInclusive<f64> = 0.1..=1000.0;
/// Largest stop error. A stop that is off by more is a different stop.
const MAX_STOP_ERROR: f64 = 0.3;
/// Largest motion of a board. A board that moves further is blurred beyond recognition.
const MAX_MOTION_PX: f64 = 1000.0;

/// Fails if there are more images of one kind than can be simulated.
pub(super) fn check_images(count: usize) -> Result<()> {
    check_count("images of one kind", count as u64, MAX_IMAGES)
}

fn check_count(what: &str, count: u64, limit: u64) -> Result<()> {
    if count <= limit {
        return Ok(());
    }
    Err(Error::invalid(format!("{count} {what} are too many: give at most {limit}")))
}

impl Settings {
    /// Returns an error that names the impossible setting.
    pub fn validate(&self) -> Result<()> {
        check_rays(self.rays)?;
        self.camera.validate()?;
        let lens = &self.camera.main_lens;
        if lens.field_curvature_growth_per_mm != 0.0 || lens.q1_growth_per_mm2 != 0.0 {
            return Err(Error::invalid(
                "a thin lens has the same field curvature and distortion at all distances, and a real lens \
                 has the ones of its prescription: give field_curvature_growth_per_mm = 0 and \
                 q1_growth_per_mm2 = 0",
            ));
        }
        if lens.pupil_aberration_per_mm != 0.0 {
            return Err(Error::invalid(
                "the exit pupil of a lens without a prescription has no aberration, and that of a \
                 lens with one follows from its surfaces: give pupil_aberration_per_mm = 0",
            ));
        }
        if let Some(prescription) = &self.prescription {
            prescription.validate()?;
            check_camera(&self.camera, prescription)?;
        }
        if self.camera.edge_spread != EdgeSpread::default() {
            return Err(Error::invalid(
                "aperture ratio and point spread of a simulated camera are settings of \
                 [imperfections]: give aperture_ratio and point_spread_px there",
            ));
        }
        self.imperfections.validate(&self.camera)?;
        self.check_size()?;
        positive(self.engraved_focal_length_mm, "the engraved focal length (mm)")?;
        if let Some(n) = self.engraved_f_number {
            check_f_number(n, "that is engraved for the boards")?;
        }
        self.target.validate()?;
        self.imaging.validate()?;
        self.white_imaging().validate()?;
        if self.camera.main_lens.setting.is_none() {
            return Err(Error::invalid(
                "the camera's main lens has no f_number; the images of boards need it",
            ));
        }
        self.boards.validate(self.camera.main_lens.focal_length_mm)?;
        self.observation_noise.validate()?;
        self.translation.validate()
    }

    /// Fails if the data set would not fit into memory, or an f-number is impossible.
    fn check_size(&self) -> Result<()> {
        let images = self.boards.calibration.max(self.boards.evaluation);
        let images = images.max(self.translation.images).max(self.white_images.f_numbers.len());
        check_count("micro-lenses", self.camera.lattice.nodes() as u64, MAX_MICRO_LENSES)?;
        check_images(images)?;
        let sensor = &self.camera.sensor;
        let pixels = u64::from(sensor.width_px) * u64::from(sensor.height_px);
        if self.imaging.hot_pixels as u64 > pixels {
            return Err(Error::invalid(format!(
                "{} hot pixels are more than the {pixels} pixels of the sensor",
                self.imaging.hot_pixels
            )));
        }
        self.white_images.validate()
    }

    /// Returns the true f-number of the images of boards.
    #[must_use]
    pub fn board_f_number(&self) -> f64 {
        self.camera.main_lens.setting.map_or(f64::NAN, |setting| setting.f_number)
    }

    /// Returns the datasheet that the maker of the camera would give.
    #[must_use]
    pub fn datasheet(&self) -> Datasheet {
        let camera = &self.camera;
        let setting = camera.main_lens.setting;
        Datasheet {
            sensor: camera.sensor,
            focal_length_mm: self.engraved_focal_length_mm,
            focus_distance_mm: setting.map_or(f64::INFINITY, |s| s.focus_distance_mm),
            f_number: self.engraved_f_number.unwrap_or(self.board_f_number()),
            configuration: camera.configuration().unwrap_or(Configuration::Unfocused),
            lattice_kind: camera.lattice.kind(),
            array_size: Some((camera.lattice.columns, camera.lattice.rows)),
            lens_types: camera.lens_types(),
            micro_image_pitch_px: None,
            opening: None,
        }
    }

    /// Returns the settings of the sensor for white images for the pre-calibration.
    #[must_use]
    pub fn white_imaging(&self) -> Imaging {
        let whites = &self.white_images;
        Imaging {
            exposure: whites.exposure.unwrap_or(self.imaging.exposure),
            gain: whites.gain.unwrap_or(self.imaging.gain),
            ..self.imaging
        }
    }

    /// Creates the tracer of the camera at a true f-number.
    pub fn tracer(&self, f_number: f64) -> Result<Tracer> {
        let lens = self.prescription.as_ref();
        Tracer::with_lens(&self.camera, lens, f_number, &self.imperfections, self.seed)
    }

    /// Returns the camera that a calibration finds: `camera`, with F, D and e_z of a real lens for the light of its whole
    /// aperture. Fails if rays of the lens do not determine these.
    pub fn true_camera(&self) -> Result<PlenopticCamera> {
        let mut camera = self.camera.clone();
        let figures = self.lens_figures()?;
        if self.prescription.is_some() && figures.is_none() {
            return Err(Error::invalid(
                "rays through the rim of the stop miss a surface of the lens, so that its F is \
                 not known: stop it down, or correct its surfaces",
            ));
        }
        if let Some(LensFigures { all_light, .. }) = figures {
            camera.main_lens.focal_length_mm = all_light.focal_length_mm;
            camera.main_lens.exit_pupil_mm.z = all_light.exit_pupil_mm;
            camera.mla.lens_to_mla_mm = all_light.lens_to_mla_mm;
        }
        Ok(camera)
    }

    /// Returns the figures of a real lens for boards at their mean distance; `None` for a thin lens.
    pub fn lens_figures(&self) -> Result<Option<LensFigures>> {
        let [near, far] = self.boards.depth_mm;
        let tracer = self.tracer(self.board_f_number())?;
        Ok(tracer.lens.figures(f64::midpoint(near, far), self.camera.mla.lens_to_mla_mm))
    }
}

impl WhiteImages {
    /// Returns the stated and the true f-number of every image.
    pub(super) fn stated_and_true(&self) -> impl Iterator<Item = (f64, f64)> {
        let errors = self.stop_errors.iter().copied().chain(std::iter::repeat(0.0));
        self.f_numbers.iter().zip(errors).map(|(&stated, error)| (stated, stated * (1.0 + error)))
    }

    fn validate(&self) -> Result<()> {
        for &n in &self.f_numbers {
            check_f_number(n, "of a white image")?;
        }
        let [images, errors] = [&self.f_numbers, &self.stop_errors].map(Vec::len);
        if errors != 0 && errors != images {
            return Err(Error::invalid(format!(
                "there are {errors} stop errors for {images} white images: give one for each, or none"
            )));
        }
        if let Some(error) =
            self.stop_errors.iter().find(|e| e.is_nan() || e.abs() > MAX_STOP_ERROR)
        {
            return Err(Error::invalid(format!(
                "a stop error of {error} is not possible: give -{MAX_STOP_ERROR} to \
                 {MAX_STOP_ERROR}, relative to the f-number"
            )));
        }
        Ok(())
    }
}

impl Boards {
    fn validate(&self, focal_length: f64) -> Result<()> {
        let [near, far] = self.depth_mm;
        if !(near > 0.0 && far >= near && far.is_finite()) {
            return Err(Error::invalid(format!(
                "boards from {near} to {far} mm are not possible: give positive depths along +z, \
                 the nearest first"
            )));
        }
        if near <= focal_length {
            return Err(Error::invalid(format!(
                "boards at {near} mm lie within the focal length of {focal_length} mm, where the \
                 main lens forms no real image: move them away"
            )));
        }
        for (name, angle, limit) in
            [("tilt", self.max_tilt_deg, 89.0), ("turn", self.max_turn_deg, 180.0)]
        {
            if !(0.0..=limit).contains(&angle) {
                return Err(Error::invalid(format!(
                    "boards with a {name} of up to {angle} degrees are not possible: give 0 to \
                     {limit}"
                )));
            }
        }
        if !(0.0..=1.0).contains(&self.min_in_view) {
            return Err(Error::invalid(format!(
                "min_in_view is {}, but has to be a fraction of the corners, from 0 to 1",
                self.min_in_view
            )));
        }
        if !(0.0..=MAX_MOTION_PX).contains(&self.motion_px) {
            return Err(Error::invalid(format!(
                "boards that move by {} px during the exposure are not possible: give 0 to \
                 {MAX_MOTION_PX}",
                self.motion_px
            )));
        }
        Ok(())
    }
}

impl TranslationStage {
    fn validate(&self) -> Result<()> {
        if !(self.start_mm.is_finite() && self.step_mm.is_finite()) {
            return Err(Error::invalid("the translation's start_mm and step_mm have to be finite"));
        }
        if self.images > 1 && self.step_mm == 0.0 {
            return Err(Error::invalid("the translation has a step of 0 mm: give another step_mm"));
        }
        Ok(())
    }
}

fn check_f_number(n: f64, which: &str) -> Result<()> {
    if F_NUMBERS.contains(&n) {
        return Ok(());
    }
    Err(Error::invalid(format!(
        "the f-number {n} {which} is not possible: give {} to {}",
        F_NUMBERS.start(),
        F_NUMBERS.end()
    )))
}
