//! Points of boards, each reconstructed from its own features, and the distances between them.
//!
//! The pose of a board may be right although the space that a camera measures is too long: its squares have the size that is
//! stated. A point that is reconstructed alone knows nothing of the board. So the points p of a frame, against the places q of
//! its posed board, show by how much distances come out too long: p = q + c + s (q − q̄), with the shift c and the part s by
//! least squares. Each point counts with its information: along the axis it is far less certain than across.

use nalgebra::{Isometry3, Matrix3, Matrix3x4, Matrix4, Point3, Vector3, Vector4};

use super::Posed;
use crate::error::Result;
use crate::model::{BapFeature, BentBoard, FeatureResidual, PlenopticCamera};
use crate::numerics::weighted_mean;
use crate::solver::{self, Problem, Projected, SolverFeature};

/// Steps of the least squares; a point that still moves after them is left out.
const STEPS: usize = 12;
/// Points that move by less have settled, as a fraction of their distance.
const SETTLED: f64 = 1e-8;
/// Step of the numerical derivatives, as a fraction of the distance.
const DERIVATIVE: f64 = 1e-6;
/// Features further off count less (Huber), in their σ.
const LOSS: f64 = 4.0;

/// How well points of boards are reconstructed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reconstruction {
    /// Number of frames.
    pub frames: usize,
    /// Number of points.
    pub points: usize,
    /// Corners whose features do not determine a point.
    pub left_out: usize,
    /// By which part distances between points of a board are too long.
    pub too_long: f64,
    /// Its standard deviation, by the scatter of the frames.
    pub too_long_std_dev: f64,
    /// Root mean square distance of the points from the posed board across the axis, mm.
    pub across_mm: f64,
    /// The same along the axis, mm.
    pub along_mm: f64,
}

/// A point that is being reconstructed.
struct Reconstructed<'a> {
    features: &'a [FeatureResidual],
    /// Where its corner is on the posed board, mm.
    on_board: Point3<f64>,
    /// Where it is, mm.
    place: Point3<f64>,
    information: Matrix3<f64>,
    state: State,
}

#[derive(Clone, Copy, PartialEq)]
enum State {
    Moving,
    Settled,
    Undetermined,
}

impl Reconstruction {
    /// Reconstructs the corners of posed boards; `None` if there is no frame with two of them.
    ///
    /// An error if the camera is not valid.
    pub fn of(camera: &PlenopticCamera, bent: &BentBoard, posed: &Posed) -> Result<Option<Self>> {
        let mut features = posed.reprojection.features.clone();
        features.sort_by_key(|r| (r.feature.frame, r.feature.corner));
        let of_corner = |a: &FeatureResidual, b: &FeatureResidual| {
            (a.feature.frame, a.feature.corner) == (b.feature.frame, b.feature.corner)
        };
        let start = |features| Reconstructed::new(features, bent, posed);
        let mut points: Vec<Reconstructed> =
            features.chunk_by(of_corner).filter_map(start).collect();
        for _ in 0..STEPS {
            let mut moving: Vec<_> =
                points.iter_mut().filter(|p| p.state == State::Moving).collect();
            if moving.is_empty() {
                break;
            }
            step(camera, bent, &mut moving)?;
        }
        let all = points.len();
        points.retain(|point| point.state == State::Settled);
        let same_frame = |a: &Reconstructed, b: &Reconstructed| a.frame() == b.frame();
        let of_frames: Vec<[f64; 2]> = points.chunk_by(same_frame).filter_map(too_long).collect();
        let Some([too_long, too_long_std_dev]) = weighted_mean(of_frames.iter().copied()) else {
            return Ok(None);
        };
        let mean = |of: fn(&Vector3<f64>) -> f64| {
            points.iter().map(|p| of(&(p.place - p.on_board))).sum::<f64>() / points.len() as f64
        };
        Ok(Some(Self {
            frames: of_frames.len(),
            points: points.len(),
            left_out: all - points.len(),
            too_long,
            too_long_std_dev,
            across_mm: mean(|off| off.xy().norm_squared()).sqrt(),
            along_mm: mean(|off| off.z.powi(2)).sqrt(),
        }))
    }
}

impl<'a> Reconstructed<'a> {
    /// At its place on the posed board; `None` if the frame has no pose.
    fn new(features: &'a [FeatureResidual], bent: &BentBoard, posed: &Posed) -> Option<Self> {
        let BapFeature { frame, corner, .. } = features[0].feature;
        let pose = posed.poses.iter().find(|pose| pose.frame == frame)?;
        let on_board = pose.camera_from_board * bent.point_mm(corner);
        // One micro-lens tells a direction.
        let node = |r: &FeatureResidual| (r.feature.k, r.feature.l);
        let seen_twice = features.iter().any(|r| node(r) != node(&features[0]));
        let state = if seen_twice { State::Moving } else { State::Undetermined };
        let information = Matrix3::zeros();
        Some(Self { features, on_board, place: on_board, information, state })
    }

    fn frame(&self) -> u32 {
        self.features[0].feature.frame
    }

    /// One step of Gauss and Newton, by what is projected from its place and from places a step along each axis.
    fn step(&mut self, projected: &[Option<Projected>], axis_step_mm: f64) {
        let (mut information, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for (residual, projected) in self.features.iter().zip(projected.chunks_exact(4)) {
            let &[Some(at), Some(x), Some(y), Some(z)] = projected else {
                self.state = State::Undetermined;
                return;
            };
            let feature = &residual.feature;
            let std_dev = feature.std_dev_px.unwrap_or([1.0; 2]);
            let of_axis = [
                (feature.u_px - at.u_px, [x, y, z].map(|p| p.u_px - at.u_px), std_dev[0]),
                (feature.v_px - at.v_px, [x, y, z].map(|p| p.v_px - at.v_px), std_dev[1]),
            ];
            for (off, moved, std_dev) in of_axis {
                let scale = std_dev.recip();
                let weight = (LOSS / (off * scale).abs()).min(1.0);
                let by_place = Vector3::from(moved) * (scale / axis_step_mm);
                information += weight * by_place * by_place.transpose();
                right += by_place * (weight * scale * off);
            }
        }
        let moved = information.cholesky().map(|root| root.solve(&right));
        let Some(moved) = moved.filter(|moved| moved.iter().all(|x| x.is_finite())) else {
            self.state = State::Undetermined;
            return;
        };
        self.place += moved;
        self.information = information;
        if moved.norm() < SETTLED * self.place.coords.norm() {
            self.state = State::Settled;
        }
    }
}

/// One step of all points.
fn step(
    camera: &PlenopticCamera,
    bent: &BentBoard,
    points: &mut [&mut Reconstructed],
) -> Result<()> {
    let axis_step_mm = |p: &Reconstructed| DERIVATIVE * p.place.coords.norm();
    let mut poses = Vec::new();
    let mut features = Vec::new();
    for point in &*points {
        let first = poses.len();
        let axes = [Vector3::zeros(), Vector3::x(), Vector3::y(), Vector3::z()];
        poses.extend(axes.map(|axis| {
            let place = point.place + axis * axis_step_mm(point);
            Isometry3::translation(place.x, place.y, place.z)
        }));
        for FeatureResidual { feature, .. } in point.features {
            features.extend((first..first + 4).map(|pose| SolverFeature {
                pose,
                board_point_mm: Point3::origin(),
                k: feature.k,
                l: feature.l,
                u_px: feature.u_px,
                v_px: feature.v_px,
                rho_px: feature.rho_px,
                std_dev_px: [1.0; 3],
            }));
        }
    }
    // Each point is the origin of a board of its own.
    let (board, centers) = (BentBoard::from(bent.board), &[]);
    let problem = Problem { camera, board, poses: &poses, features: &features, centers };
    let projected = solver::project(&problem)?;
    let mut rest = projected.as_slice();
    for point in points {
        let (own, others) = rest.split_at(4 * point.features.len());
        rest = others;
        let step_mm = axis_step_mm(point);
        point.step(own, step_mm);
    }
    Ok(())
}

/// By which part distances between the points of a frame are too long, and its standard deviation as the σ of features make
/// it; `None` if they do not tell.
fn too_long(points: &[Reconstructed]) -> Option<[f64; 2]> {
    let on_board = points.iter().map(|p| p.on_board.coords);
    let middle = on_board.sum::<Vector3<f64>>() / points.len() as f64;
    let (mut normal, mut right) = (Matrix4::zeros(), Vector4::zeros());
    for point in points {
        let from_middle = point.on_board.coords - middle;
        let mut by_all = Matrix3x4::identity();
        by_all.set_column(3, &from_middle);
        normal += by_all.tr_mul(&point.information) * by_all;
        right += by_all.tr_mul(&point.information) * (point.place - point.on_board);
    }
    let covariance = normal.cholesky()?.inverse();
    let (part, variance) = ((covariance * right).w, covariance[(3, 3)]);
    (part.is_finite() && variance > 0.0).then(|| [part, variance.sqrt()])
}

#[cfg(test)]
mod tests {
    use nalgebra::{Translation3, UnitQuaternion};

    use super::*;
    use crate::model::{Board, BoardShape, FramePose, Noise, Reprojection};
    use crate::solver::{small_camera, synthesize_bent};

    fn bent() -> BentBoard {
        BentBoard {
            board: Board { columns: 9, rows: 5, square_mm: 3.0 },
            shape: BoardShape { sag_x_mm: 0.2, sag_y_mm: -0.1, twist_mm: 0.1, aspect: 0.002 },
        }
    }

    /// Boards with their true poses, and features of a camera with noise, px.
    fn posed(noise_px: f64) -> Posed {
        let pose = |frame: u32, z: f64| {
            let tilt = UnitQuaternion::from_scaled_axis(Vector3::new(0.3, -0.2, 0.05));
            let place = Translation3::new(-12.0, -6.0 + f64::from(frame), z);
            FramePose { frame, camera_from_board: Isometry3::from_parts(place, tilt) }
        };
        let poses: Vec<FramePose> =
            [(0, 85.0), (1, 95.0), (2, 105.0)].map(|(f, z)| pose(f, z)).to_vec();
        let noise = Noise { uv_px: noise_px, rho_px: 0.0, centers_px: 0.0 };
        let seen = synthesize_bent(&small_camera(), &bent(), &poses, &noise, 3).unwrap();
        let residual = |feature: &BapFeature| FeatureResidual {
            feature: *feature,
            lens_type: 0,
            du_px: 0.0,
            dv_px: 0.0,
            drho_px: None,
        };
        let features: Vec<FeatureResidual> = seen.features.iter().map(residual).collect();
        assert!(features.len() > 300);
        let reprojection = Reprojection { features, ..Reprojection::default() };
        Posed { poses, reprojection, left_out: Vec::new(), converged: true }
    }

    fn reconstructed(camera: &PlenopticCamera, posed: &Posed) -> Reconstruction {
        Reconstruction::of(camera, &bent(), posed).unwrap().unwrap()
    }

    #[test]
    fn points_seen_without_noise_are_where_they_are() {
        let found = reconstructed(&small_camera(), &posed(0.0));
        assert_eq!(found.frames, 3);
        assert!(found.points > 60, "{found:?}");
        assert!(found.too_long.abs() < 1e-9, "{found:?}");
        assert!(found.across_mm < 1e-7 && found.along_mm < 1e-6, "{found:?}");
    }

    /// With all its lengths larger a camera sees the same, and takes the world to be larger.
    #[test]
    fn a_camera_that_is_too_large_measures_distances_that_are_too_long() {
        let mut camera = small_camera();
        let factor = 1.002;
        camera.sensor.pixel_size_mm *= factor;
        camera.main_lens.focal_length_mm *= factor;
        camera.mla.lens_to_mla_mm *= factor;
        camera.mla.mla_to_sensor_mm *= factor;
        camera.mla.pitch_mm *= factor;
        camera.mla.focal_lengths_mm.iter_mut().for_each(|f| *f *= factor);
        let found = reconstructed(&camera, &posed(0.0));
        assert!((found.too_long - 0.002).abs() < 1e-9, "{found:?}");
        assert!((found.along_mm / 0.002 / 95.0 - 1.0).abs() < 0.1, "{found:?}");
    }

    #[test]
    fn noise_moves_points_along_the_axis_but_does_not_make_distances_longer() {
        let found = reconstructed(&small_camera(), &posed(0.05));
        assert!(found.too_long.abs() < 3.0 * found.too_long_std_dev, "{found:?}");
        assert!(found.too_long_std_dev < 3e-3, "{found:?}");
        assert!(found.along_mm > 5.0 * found.across_mm, "{found:?}");
    }

    #[test]
    fn a_corner_in_one_micro_image_is_left_out() {
        let mut posed = posed(0.0);
        let before = reconstructed(&small_camera(), &posed);
        let first = posed.reprojection.features[0].feature;
        let mut seen = false;
        posed.reprojection.features.retain(|r| {
            let own = (r.feature.frame, r.feature.corner) == (first.frame, first.corner);
            !own || !std::mem::replace(&mut seen, true)
        });
        let found = reconstructed(&small_camera(), &posed);
        assert_eq!(found.points, before.points - 1);
        assert_eq!(found.left_out, before.left_out + 1);
    }
}
