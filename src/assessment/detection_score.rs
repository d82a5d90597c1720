//! Comparison of detected features with the truth of a simulated data set.

use std::collections::HashMap;

use nalgebra::{Matrix2, Vector2};

use super::bias::FeatureError;
use crate::detection::{
    CornerLine, CornerObservation, DepthEstimator, Detection, MicroImages, Search, detect_frame,
};
use crate::error::Result;
use crate::model::{BapFeature, Board, MicroImageCenter};
use crate::precalibration::{PrecalibrationOptions, White, precalibrate};
use crate::simulation::{DataSet, Settings, Shot};

/// The quality of detected features over the frames of a data set.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct DetectionScore {
    /// Number of true features at least [`INSIDE_PX`] within the edge of a micro-image.
    pub sought: usize,
    /// Number of these features that were found.
    pub found: usize,
    /// Number of detected features.
    pub reported: usize,
    /// Number of detected features that are true: in the right micro-image, of the right corner, and nearer than
    /// [`TRUE_PX`].
    pub right: usize,
    small: usize,
    small_square: f64,
    square: f64,
    rho_square: f64,
    depths: usize,
    depth_square: f64,
    median_square: f64,
    /// Number of frames.
    pub frames: usize,
    /// Number of labelled frames.
    pub labelled: usize,
    /// Errors of the true features.
    pub errors: Vec<FeatureError>,
}

/// Distance from the edge of a micro-image, px, within which true features need not be found.
pub const INSIDE_PX: f64 = 3.0;
/// Largest error of a true feature, px.
pub const TRUE_PX: f64 = 1.0;
/// Largest blur radius that counts as small, px.
pub const SMALL_RHO_PX: f64 = 3.0;

/// The truth of a frame.
struct FrameTruth<'a> {
    features: &'a [BapFeature],
    centers: &'a HashMap<(i32, i32), MicroImageCenter>,
    /// Outer radius of micro-image (k, l), px.
    outer_radius_px: &'a dyn Fn(i32, i32) -> f64,
    /// Board, which may have been labelled as if turned by 180 degrees.
    board: &'a Board,
    /// Ratio λ = (D + e_z)/(D + e_z + d).
    lambda: f64,
    /// Middle of the image, px.
    middle: Vector2<f64>,
    /// Lens type of micro-image (k, l).
    lens_type: &'a dyn Fn(i32, i32) -> usize,
}

impl DetectionScore {
    /// Simulates the first boards of a data set and its white images, pre-calibrates, detects, and
    /// compares with the truth. The estimator selects the ρ to compare; 1/ν is compared for both.
    pub fn of_simulation(
        settings: &Settings,
        frames: usize,
        estimator: DepthEstimator,
    ) -> Result<Self> {
        let data_set = DataSet::plan(settings, None)?;
        let white = |shot: &Shot| {
            let name = format!("f/{:.2}", shot.stated_f_number);
            let image = shot.take(settings, &|| ())?;
            Ok(White { name, f_number: shot.stated_f_number, image })
        };
        let whites = data_set.whites.iter().map(white).collect::<Result<Vec<White>>>()?;
        let reference = white(&data_set.devignetting)?;
        let (sheet, board) = (settings.datasheet(), settings.target.board());
        let options = PrecalibrationOptions::of_datasheet(&sheet);
        let measured = precalibrate(&whites, Some(&reference), &options, &|| ())?;
        let micro_images = MicroImages::of_precalibration(&measured, &sheet)?;
        let tracer = settings.tracer(settings.board_f_number())?;
        let centers = tracer.centers().into_iter().map(|t| ((t.center.k, t.center.l), t.center));
        let centers: HashMap<(i32, i32), MicroImageCenter> = centers.collect();
        let (mla, to_pupil) = (&settings.camera.mla, settings.camera.pupil_to_mla_mm());
        let search =
            Search { micro_images: &micro_images, board: &board, sensor: &sheet.sensor, estimator };
        let mut score = Self::default();
        for (pose, shot) in data_set.subsets[0].iter().take(frames) {
            let image = shot.take(settings, &|| ())?;
            let levels = micro_images.levels.as_ref();
            let [image, white] = [&image, &reference.image].map(|raw| raw.grey_between(levels));
            let (result, _) = detect_frame(pose.frame, &image, &white, &search);
            score.frames += 1;
            let Ok(detection) = result else { continue };
            score.labelled += 1;
            let features: Vec<BapFeature> = tracer
                .features(pose.frame, &settings.target, &pose.camera_from_board)
                .into_iter()
                .map(|t| t.feature)
                .collect();
            let outer = |k, l| micro_images.optics(k, l).outer_radius_px();
            let truth = FrameTruth {
                features: &features,
                centers: &centers,
                outer_radius_px: &outer,
                board: &board,
                lambda: to_pupil / (to_pupil + mla.mla_to_sensor_mm),
                middle: sheet.sensor.center_px(),
                lens_type: &|k, l| settings.camera.lens_type(k, l),
            };
            score.add(&detection, &truth);
        }
        Ok(score)
    }

    fn add(&mut self, detection: &Detection, truth: &FrameTruth) {
        let by_place: HashMap<(i32, i32, i32), &BapFeature> =
            truth.features.iter().map(|f| ((f.corner, f.k, f.l), f)).collect();
        let turned = |corner: i32| truth.board.corners() - 1 - corner;
        let matches = |of: &dyn Fn(i32) -> i32| {
            let there = |f: &&BapFeature| by_place.contains_key(&(of(f.corner), f.k, f.l));
            detection.features.iter().filter(there).count()
        };
        let is_turned = matches(&turned) > matches(&|corner| corner);
        let own = |corner: i32| if is_turned { turned(corner) } else { corner };

        let mut found: HashMap<(i32, i32, i32), f64> = HashMap::new();
        for f in &detection.features {
            self.reported += 1;
            let place = (own(f.corner), f.k, f.l);
            let Some(t) = by_place.get(&place) else { continue };
            let error = Vector2::new(f.u_px - t.u_px, f.v_px - t.v_px);
            if error.norm() > TRUE_PX {
                continue;
            }
            found.insert(place, error.norm());
            self.right += 1;
            self.square += error.norm_squared() / 2.0;
            let radius = t.rho_px.unwrap_or(f64::NAN);
            let rho_error_px = f.rho_px.unwrap_or(f64::NAN) - radius;
            self.rho_square += rho_error_px.powi(2);
            if let Some(c) = truth.centers.get(&(t.k, t.l)) {
                let center = Vector2::new(c.u_px, c.v_px);
                self.errors.push(FeatureError {
                    frame: f.frame,
                    from_middle_px: center - truth.middle,
                    from_center_px: Vector2::new(t.u_px, t.v_px) - center,
                    lens_type: (truth.lens_type)(t.k, t.l),
                    error_px: error,
                    rho_error_px,
                });
            }
            if radius.abs() <= SMALL_RHO_PX {
                self.small += 1;
                self.small_square += error.norm_squared() / 2.0;
            }
        }
        for (place, t) in &by_place {
            let Some(c) = truth.centers.get(&(t.k, t.l)) else { continue };
            let from_center = (t.u_px - c.u_px).hypot(t.v_px - c.v_px);
            if from_center + INSIDE_PX <= (truth.outer_radius_px)(t.k, t.l) {
                self.sought += 1;
                self.found += usize::from(found.contains_key(place));
            }
        }
        for corner in &detection.corners {
            let observations: Vec<CornerObservation> = truth
                .features
                .iter()
                .filter(|t| t.corner == own(corner.corner))
                .filter_map(|t| {
                    let c = truth.centers.get(&(t.k, t.l))?;
                    Some(CornerObservation {
                        k: t.k,
                        l: t.l,
                        center: Vector2::new(c.u_px, c.v_px),
                        position: Vector2::new(t.u_px, t.v_px),
                        covariance: Matrix2::identity(),
                        squares: Matrix2::zeros(),
                    })
                })
                .collect();
            if let Some(line) = CornerLine::fit(observations.iter().copied()) {
                // Both use the true λ, so that they can be compared.
                let of = |slope: f64| 1.0 - slope / truth.lambda;
                let off = |slope: f64| (of(slope) / of(line.slope) - 1.0).powi(2);
                self.depths += 1;
                self.depth_square += off(corner.line.slope);
                self.median_square += off(1.0 - corner.median_inverse_virtual_depth);
            }
        }
    }

    /// Returns the fraction of the sought features that were found.
    #[must_use]
    pub fn recall(&self) -> f64 {
        self.found as f64 / self.sought as f64
    }

    /// Returns the fraction of the detected features that are true.
    #[must_use]
    pub fn precision(&self) -> f64 {
        self.right as f64 / self.reported as f64
    }

    /// Returns the root mean square error of a position per axis, px.
    #[must_use]
    pub fn rms_px(&self) -> f64 {
        (self.square / self.right as f64).sqrt()
    }

    /// Returns the root mean square error of the position of features with a small blur, per axis, px.
    #[must_use]
    pub fn small_rms_px(&self) -> f64 {
        (self.small_square / self.small as f64).sqrt()
    }

    /// Returns the root mean square error of ρ, px, for the estimator used in the detection.
    #[must_use]
    pub fn rho_rms_px(&self) -> f64 {
        (self.rho_square / self.right as f64).sqrt()
    }

    /// Returns the relative root mean square error of 1/ν of a corner, by the line.
    #[must_use]
    pub fn depth_rms(&self) -> f64 {
        (self.depth_square / self.depths as f64).sqrt()
    }

    /// Returns the relative root mean square error of 1/ν of a corner, by the paper's median over pairs.
    #[must_use]
    pub fn median_depth_rms(&self) -> f64 {
        (self.median_square / self.depths as f64).sqrt()
    }
}
