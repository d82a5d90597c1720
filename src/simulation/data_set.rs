//! The images of a simulated data set, and how each is taken.

use std::collections::HashSet;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Instant;

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector2, Vector3};
use rand::rngs::StdRng;
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use tracing::debug;

use super::imaging::Imaging;
use super::sampling::hash;
use super::scene::Scene;
use super::settings::{Settings, check_images};
use crate::error::{Error, Result};
use crate::image::{Image, RawImage};
use crate::model::{FramePose, Subset};

/// The content of an image of a data set.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Content {
    /// White image for the pre-calibration, by index.
    White(usize),
    /// White image with the illumination and the f-number of the boards.
    Devignetting,
    /// Board of a frame.
    Board(Subset, u32),
}

/// One image to take.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shot {
    /// Scene in view.
    pub scene: Scene,
    /// True f-number of the main lens.
    pub f_number: f64,
    /// F-number that the project file states.
    pub stated_f_number: f64,
    /// Motion of the board across the axis during the exposure, mm. Its pose holds in the middle of the exposure.
    pub motion_mm: Vector2<f64>,
    /// Settings of the sensor.
    pub imaging: Imaging,
    /// Number that seeds the randomness of this image.
    pub number: u64,
}

impl Shot {
    /// Takes the image. `progress` is called after every finished row.
    pub fn take(&self, settings: &Settings, progress: &(dyn Fn() + Sync)) -> Result<RawImage> {
        let begun = Instant::now();
        let seed = hash([settings.seed, self.number, 0, 0]);
        let irradiance = self.irradiance(settings, seed, progress)?;
        let image = self.imaging.read_out(&irradiance, settings.seed, seed);
        let time_s = begun.elapsed().as_secs_f64();
        debug!("image {} at f/{:.2} taken in {time_s:.3} s", self.number, self.f_number);
        image
    }

    /// Returns the mean irradiance during the exposure.
    pub(super) fn irradiance(
        &self,
        settings: &Settings,
        seed: u64,
        progress: &(dyn Fn() + Sync),
    ) -> Result<Image> {
        let tracer = settings.tracer(self.f_number)?;
        let (target, pose) = match self.scene {
            Scene::Board(target, pose) if self.motion_mm != Vector2::zeros() => (target, pose),
            _ => return tracer.render(&self.scene, settings.rays, seed, progress),
        };
        let rows = AtomicU32::new(0);
        let row = || {
            // Every row is traced once per moment.
            if (rows.fetch_add(1, Ordering::Relaxed) + 1).is_multiple_of(MOMENTS) {
                progress();
            }
        };
        let moment = |moment: u32| {
            let part = (f64::from(moment) + 0.5) / f64::from(MOMENTS) - 0.5;
            let moved = Translation3::from((self.motion_mm * part).push(0.0)) * pose;
            let seed = hash([seed, u64::from(moment), 0, 3]);
            tracer.render(&Scene::Board(target, moved), settings.rays, seed, &row)
        };
        let mut mean = moment(0)?;
        for number in 1..MOMENTS {
            let other = moment(number)?;
            mean.pixels.iter_mut().zip(&other.pixels).for_each(|(sum, pixel)| *sum += pixel);
        }
        #[allow(clippy::cast_precision_loss)] // a small number
        mean.pixels.iter_mut().for_each(|pixel| *pixel /= MOMENTS as f32);
        Ok(mean)
    }
}

/// Moments of an exposure at which a moving board is rendered.
const MOMENTS: u32 = 8;

/// All images of a data set.
#[derive(Debug, Clone, PartialEq)]
pub struct DataSet {
    /// White images for the pre-calibration.
    pub whites: Vec<Shot>,
    /// White image with the illumination and the f-number of the boards.
    pub devignetting: Shot,
    /// Boards by subset, in the order of [`Subset::ALL`]; frames count from 0 in each subset.
    pub subsets: [Vec<(FramePose, Shot)>; 3],
}

/// Number of random poses that are tried for a frame.
const DRAWS: usize = 10_000;

impl DataSet {
    /// Plans a data set. The same settings give the same data set. The calibration boards are at `poses` if given, else at
    /// random poses.
    pub fn plan(settings: &Settings, poses: Option<Vec<FramePose>>) -> Result<Self> {
        settings.validate()?;
        let boards = &settings.boards;
        check_images(poses.as_ref().map_or(0, Vec::len))?;
        let calibration = match poses {
            Some(poses) => distinct(poses)?,
            None => random_poses(settings, boards.calibration, Subset::Calibration)?,
        };
        let evaluation = random_poses(settings, boards.evaluation, Subset::Evaluation)?;
        let white = |(stated_f_number, f_number), imaging, number| Shot {
            scene: Scene::White,
            f_number,
            stated_f_number,
            motion_mm: Vector2::zeros(),
            imaging,
            number,
        };
        let whites = settings.white_images.stated_and_true().zip(0..);
        let whites: Vec<Shot> =
            whites.map(|(numbers, i)| white(numbers, settings.white_imaging(), i)).collect();
        let mut number = whites.len() as u64;
        let numbers = (settings.datasheet().f_number, settings.board_f_number());
        let devignetting = white(numbers, settings.imaging, number);
        let mut shots = |subset: Subset, poses: Vec<FramePose>| {
            let shots = poses.into_iter().map(|pose| {
                number += 1;
                let scene = Scene::Board(settings.target, pose.camera_from_board);
                let motion_mm = motion_mm(settings, subset, &pose);
                (pose, Shot { scene, motion_mm, number, ..devignetting })
            });
            shots.collect()
        };
        let subsets = [
            shots(Subset::Calibration, calibration),
            shots(Subset::Evaluation, evaluation),
            shots(Subset::Translation, translation_poses(settings)),
        ];
        let data_set = Self { whites, devignetting, subsets };
        data_set.check(settings)?;
        Ok(data_set)
    }

    /// Returns all shots, in order.
    pub fn shots(&self) -> impl Iterator<Item = &Shot> {
        let boards = self.subsets.iter().flatten().map(|(_, shot)| shot);
        self.whites.iter().chain([&self.devignetting]).chain(boards)
    }

    /// Returns all shots with their content, in order.
    pub fn contents(&self) -> impl Iterator<Item = (Content, &Shot)> {
        let whites = self.whites.iter().enumerate().map(|(i, shot)| (Content::White(i), shot));
        let boards = Subset::ALL.into_iter().zip(&self.subsets).flat_map(|(subset, boards)| {
            boards.iter().map(move |(pose, shot)| (Content::Board(subset, pose.frame), shot))
        });
        whites.chain([(Content::Devignetting, &self.devignetting)]).chain(boards)
    }

    /// Checks all images before the first one is taken.
    fn check(&self, settings: &Settings) -> Result<()> {
        for shot in self.whites.iter().chain([&self.devignetting]) {
            settings.tracer(shot.f_number)?;
        }
        let tracer = settings.tracer(settings.board_f_number())?;
        for (subset, boards) in Subset::ALL.into_iter().zip(&self.subsets) {
            for (pose, shot) in boards {
                tracer.check_scene(&shot.scene).map_err(|e| {
                    Error::invalid(format!("{} frame {}: {e}", subset.name(), pose.frame))
                })?;
            }
        }
        Ok(())
    }
}

/// Draws the poses of a subset. Every frame has a distance from its own slice of the range, a random direction of tilt, and
/// a position at which enough of the board is in view.
fn random_poses(settings: &Settings, count: usize, subset: Subset) -> Result<Vec<FramePose>> {
    let mut random = StdRng::seed_from_u64(hash([settings.seed, subset as u64, 0, 2]));
    let boards = &settings.boards;
    let [near, far] = boards.depth_mm;
    let tracer = settings.tracer(settings.board_f_number())?;
    let mut slices: Vec<usize> = (0..count).collect();
    slices.shuffle(&mut random);
    let sensor = &settings.camera.sensor;
    let principal = settings.camera.mla.principal_point_px;
    slices
        .into_iter()
        .zip(0..)
        .map(|(slice, frame)| {
            for _ in 0..DRAWS {
                let part = (slice as f64 + random.random_range(0.0..1.0)) / count as f64;
                let depth = near + part * (far - near);
                let direction = random.random_range(0.0..std::f64::consts::TAU);
                let axis = Vector3::new(direction.cos(), direction.sin(), 0.0);
                // Uniform over the cap of directions rather than over the angle.
                let highest = boards.max_tilt_deg.to_radians().cos();
                let tilt = (1.0 - random.random_range(0.0..=1.0) * (1.0 - highest)).acos();
                let turn = random.random_range(-1.0..=1.0) * boards.max_turn_deg.to_radians();
                let rotation = UnitQuaternion::from_scaled_axis(axis * tilt)
                    * UnitQuaternion::from_scaled_axis(Vector3::z() * turn);
                let u = random.random_range(0.0..f64::from(sensor.width_px));
                let v = random.random_range(0.0..f64::from(sensor.height_px));
                let scale = depth / focal_length_px(settings);
                let middle =
                    Vector3::new((u - principal.x) * scale, (v - principal.y) * scale, depth);
                let camera_from_board = centred(settings, middle, rotation);
                let whole = tracer.check_scene(&Scene::Board(settings.target, camera_from_board));
                if whole.is_ok() && in_view(settings, &camera_from_board) >= boards.min_in_view {
                    return Ok(FramePose { frame, camera_from_board });
                }
            }
            Err(Error::invalid(format!(
                "no pose between {near} and {far} mm shows {:.0} % of the corners with the whole \
                 board beyond the focal length: use a smaller board, larger distances, less tilt, \
                 or a smaller min_in_view",
                boards.min_in_view * 100.0
            )))
        })
        .collect()
}

/// Returns the given poses. Fails if there are none, or two for one frame.
fn distinct(poses: Vec<FramePose>) -> Result<Vec<FramePose>> {
    if poses.is_empty() {
        return Err(Error::invalid("there are no poses for the boards"));
    }
    let mut frames = HashSet::new();
    match poses.iter().find(|pose| !frames.insert(pose.frame)) {
        Some(pose) => {
            Err(Error::invalid(format!("frame {} has two poses: remove one", pose.frame)))
        }
        None => Ok(poses),
    }
}

fn translation_poses(settings: &Settings) -> Vec<FramePose> {
    let stage = &settings.translation;
    let sensor = &settings.camera.sensor;
    // The linear stage moves along z; the board starts in the middle of the image.
    let offset = (sensor.center_px() - settings.camera.mla.principal_point_px)
        * (stage.start_mm / focal_length_px(settings));
    (0..stage.images)
        .zip(0..)
        .map(|(i, frame)| {
            let z = stage.start_mm + i as f64 * stage.step_mm;
            let middle = Vector3::new(offset.x, offset.y, z);
            FramePose {
                frame,
                camera_from_board: centred(settings, middle, UnitQuaternion::identity()),
            }
        })
        .collect()
}

/// Draws the motion of a board during the exposure, in a random direction; 0 for the board on the linear stage.
fn motion_mm(settings: &Settings, subset: Subset, pose: &FramePose) -> Vector2<f64> {
    if subset == Subset::Translation {
        return Vector2::zeros();
    }
    let seed = hash([settings.seed, subset as u64, u64::from(pose.frame), 4]);
    let angle = StdRng::seed_from_u64(seed).random_range(0.0..std::f64::consts::TAU);
    let depth = (pose.camera_from_board * settings.target.board().middle_mm()).z;
    let way = settings.boards.motion_px * depth / focal_length_px(settings);
    Vector2::new(angle.cos(), angle.sin()) * way
}

/// Returns the pose of a board whose middle is at a point.
fn centred(
    settings: &Settings,
    middle: Vector3<f64>,
    rotation: UnitQuaternion<f64>,
) -> Isometry3<f64> {
    let board = settings.target.board();
    let half = (board.point_mm(board.corners() - 1) - Point3::origin()) / 2.0;
    Isometry3::from_parts(Translation3::from(middle), rotation) * Translation3::from(-half)
}

/// Returns the distance of the sensor from the main lens, px: the scale of central projections.
fn focal_length_px(settings: &Settings) -> f64 {
    let mla = &settings.camera.mla;
    (mla.lens_to_mla_mm + mla.mla_to_sensor_mm) / settings.camera.sensor.pixel_size_mm
}

/// Returns the fraction of the corners whose rays through the middle of the main lens meet the sensor.
fn in_view(settings: &Settings, camera_from_board: &Isometry3<f64>) -> f64 {
    let board = settings.target.board();
    let sensor = &settings.camera.sensor;
    let principal = settings.camera.mla.principal_point_px;
    let seen = |&corner: &i32| {
        let p = camera_from_board * board.point_mm(corner);
        let place = principal + p.coords.xy() * (focal_length_px(settings) / p.z);
        p.z > 0.0
            && (0.0..f64::from(sensor.width_px)).contains(&place.x)
            && (0.0..f64::from(sensor.height_px)).contains(&place.y)
    };
    (0..board.corners()).filter(seen).count() as f64 / f64::from(board.corners())
}
