//! Reconstruction of points of boards, each from its own features, and the distances between them.
//!
//! The pose of a board may be right although the space that a camera measures is too long, since the size of its squares is
//! stated. A point that is reconstructed alone is independent of the board. Near its position q on the posed board the
//! projection is linear. If its features have the residuals r, and the derivatives J by the position, both in σ, it is at
//! q + (JᵀJ)⁻¹ Jᵀr. The relative error s of the distances between the points of a frame minimises
//!
//! ```text
//! Σ |r − J (c + ω × (q − q̄) + s (q − q̄))|² = min,
//! ```
//!
//! where c and ω move the board as a whole. So each point counts with the information of its features: far less along the
//! axis than across it. Only u and v are used, not ρ.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Matrix3, Point3, SMatrix, SVector, Vector3};

use super::Posed;
use crate::error::Result;
use crate::model::{BapFeature, BentBoard, FeatureResidual, PlenopticCamera};
use crate::numerics::weighted_mean;
use crate::quantity::Estimate;
use crate::solver::{self, Problem, SolverFeature};

/// Step of the numerical derivatives, as a fraction of the distance. The error of a central difference is its square.
const STEP: f64 = 1e-4;
/// Scale of the Huber loss, in σ, if all features state their σ: the same as for the refinement of cameras and poses.
const LOSS: f64 = 4.0;
/// Number of free parameters: shift, rotation and length.
const FREE: usize = 7;

/// The quality of reconstructed points of boards.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reconstruction {
    /// Number of frames.
    pub frames: usize,
    /// Number of points.
    pub points: usize,
    /// Number of corners without a point: only one micro-lens sees them, or their frame does not determine distances.
    pub left_out: usize,
    /// Relative error of distances between points of a board; positive if they are too long.
    /// σ follows from the noise of the features or the scatter of the frames, whichever is larger.
    pub too_long: Estimate,
    /// Root mean square distance of the points from the posed board across the axis, mm.
    pub across_mm: f64,
    /// Root mean square distance of the points from the posed board along the axis, mm.
    pub along_mm: f64,
}

/// A corner, with the information of its features on its position.
struct Seen {
    frame: u32,
    /// Position q on the posed board, mm.
    on_board: Point3<f64>,
    /// Information matrix JᵀJ.
    information: Matrix3<f64>,
    /// Right-hand side Jᵀr.
    right: Vector3<f64>,
    /// Squared norm |r|², and the number of components of r.
    square: f64,
    residuals: usize,
    /// Shift of the reconstructed point from the board, mm; `None` if its features do not determine it.
    off_mm: Option<Vector3<f64>>,
}

impl Reconstruction {
    /// Reconstructs the corners of posed boards; `None` if no frame determines distances.
    ///
    /// Fails if the camera is not valid.
    pub fn of(camera: &PlenopticCamera, bent: &BentBoard, posed: &Posed) -> Result<Option<Self>> {
        let stated = posed.reprojection.features.iter().all(|r| r.feature.std_dev_px.is_some());
        let seen = seen(camera, bent, posed, stated)?;
        let (mut of_frames, mut points) = (Vec::new(), Vec::new());
        for frame in seen.chunk_by(|a, b| a.frame == b.frame) {
            let of_frame: Vec<&Seen> = frame.iter().filter(|s| s.off_mm.is_some()).collect();
            if let Some(found) = too_long(&of_frame, stated) {
                of_frames.push(found);
                points.extend(of_frame.iter().filter_map(|seen| seen.off_mm));
            }
        }
        let Some(too_long) = weighted_mean(of_frames.iter().copied()) else {
            return Ok(None);
        };
        let mean =
            |of: fn(&Vector3<f64>) -> f64| points.iter().map(of).sum::<f64>() / points.len() as f64;
        Ok(Some(Self {
            frames: of_frames.len(),
            points: points.len(),
            left_out: seen.len() - points.len(),
            too_long,
            across_mm: mean(|off| off.xy().norm_squared()).sqrt(),
            along_mm: mean(|off| off.z.powi(2)).sqrt(),
        }))
    }
}

/// Returns the corners of posed boards by frame, with the information of their features. `stated` is true if all features
/// state their σ.
fn seen(
    camera: &PlenopticCamera,
    bent: &BentBoard,
    posed: &Posed,
    stated: bool,
) -> Result<Vec<Seen>> {
    let mut residuals = posed.reprojection.features.clone();
    residuals.sort_by_key(|r| (r.feature.frame, r.feature.corner));
    let derivatives = by_place(camera, bent, posed, &residuals)?;
    let together: Vec<_> = residuals.iter().zip(derivatives).collect();
    let of_corner = |a: &FeatureResidual| (a.feature.frame, a.feature.corner);
    let corners = together.chunk_by(|(a, _), (b, _)| of_corner(a) == of_corner(b));
    let corner = |features: &[(&FeatureResidual, Option<[Vector3<f64>; 2]>)]| {
        let BapFeature { frame, corner, k, l, .. } = features[0].0.feature;
        let pose = posed.poses.iter().find(|pose| pose.frame == frame)?;
        let (mut information, mut right) = (Matrix3::zeros(), Vector3::zeros());
        let (mut square, mut residuals) = (0.0, 0);
        for (residual, by_place) in features {
            let Some([by_u, by_v]) = *by_place else { continue };
            let std_dev = residual.feature.std_dev_px.unwrap_or([1.0; 2]);
            let off = [residual.du_px / std_dev[0], residual.dv_px / std_dev[1]];
            let far = off[0].hypot(off[1]) / LOSS;
            let weight = if stated && far > 1.0 { far.recip() } else { 1.0 };
            for (off, by, std_dev) in [(off[0], by_u, std_dev[0]), (off[1], by_v, std_dev[1])] {
                let by = by / std_dev;
                information += weight * by * by.transpose();
                right += by * (weight * off);
                square += weight * off * off;
                residuals += 1;
            }
        }
        // One micro-lens determines only a direction, but with rounding errors the matrix may be invertible.
        let node = |r: &FeatureResidual| (r.feature.k, r.feature.l);
        let seen_twice = features.iter().any(|(r, _)| node(r) != (k, l));
        let solved = information.cholesky().map(|root| root.solve(&right));
        let off_mm = solved.filter(|off| seen_twice && off.iter().all(|x| x.is_finite()));
        let on_board = pose.camera_from_board * bent.point_mm(corner);
        Some(Seen { frame, on_board, information, right, square, residuals, off_mm })
    };
    Ok(corners.filter_map(corner).collect())
}

/// Returns the derivatives of u and v of features by the position of their corner, px/mm; `None` if the frame has no pose, or
/// the camera does not image positions next to it.
fn by_place(
    camera: &PlenopticCamera,
    bent: &BentBoard,
    posed: &Posed,
    residuals: &[FeatureResidual],
) -> Result<Vec<Option<[Vector3<f64>; 2]>>> {
    let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
    let sides = axes.map(|axis| [axis, -axis]).concat();
    // Boards that are one step nearer or further along each axis.
    let mut poses = Vec::new();
    let mut first_of_frame = BTreeMap::new();
    for pose in &posed.poses {
        let step_mm = STEP * pose.camera_from_board.translation.vector.norm();
        first_of_frame.insert(pose.frame, (poses.len(), step_mm));
        let moved = |side: &Vector3<f64>| {
            let by = side * step_mm;
            Isometry3::translation(by.x, by.y, by.z) * pose.camera_from_board
        };
        poses.extend(sides.iter().map(moved));
    }
    let mut features = Vec::new();
    for FeatureResidual { feature, .. } in residuals {
        let Some((first, _)) = first_of_frame.get(&feature.frame) else { continue };
        features.extend((*first..first + sides.len()).map(|pose| SolverFeature {
            pose,
            board_point_mm: bent.board.point_mm(feature.corner).coords.into(),
            k: feature.k,
            l: feature.l,
            u_px: feature.u_px,
            v_px: feature.v_px,
            rho_px: feature.rho_px.unwrap_or(f64::NAN),
            std_dev_px: [1.0; 3],
        }));
    }
    let problem =
        Problem { camera, board: *bent, poses: &poses, features: &features, centers: &[] };
    let projected = solver::project(&problem)?;
    let mut of_features = projected.chunks_exact(sides.len());
    let by_place = |residual: &FeatureResidual| {
        let (_, step_mm) = first_of_frame.get(&residual.feature.frame)?;
        let projected: Option<Vec<_>> = of_features.next()?.iter().copied().collect();
        let projected = projected?;
        let mut by = [Vector3::zeros(); 2];
        for (axis, sides) in projected.chunks_exact(2).enumerate() {
            by[0][axis] = (sides[0].u_px - sides[1].u_px) / (2.0 * step_mm);
            by[1][axis] = (sides[0].v_px - sides[1].v_px) / (2.0 * step_mm);
        }
        Some(by)
    };
    Ok(residuals.iter().map(by_place).collect())
}

/// Fits the relative error of the distances between the points of a frame, with σ from the noise of the features; `None` if
/// the points do not determine it. If features do not state their σ, the noise follows from the residuals.
fn too_long(points: &[&Seen], stated: bool) -> Option<Estimate> {
    let on_board = points.iter().map(|p| p.on_board.coords);
    let middle = on_board.sum::<Vector3<f64>>() / points.len() as f64;
    let mut normal = SMatrix::<f64, FREE, FREE>::zeros();
    let mut right = SVector::<f64, FREE>::zeros();
    let (mut square, mut residuals) = (0.0, 0);
    for point in points {
        let from_middle = point.on_board.coords - middle;
        let mut by_all = SMatrix::<f64, 3, FREE>::zeros();
        by_all.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
        by_all.fixed_view_mut::<3, 3>(0, 3).copy_from(&-from_middle.cross_matrix());
        by_all.set_column(6, &from_middle);
        normal += by_all.tr_mul(&point.information) * by_all;
        right += by_all.tr_mul(&point.right);
        square += point.square;
        residuals += point.residuals;
    }
    let covariance = normal.cholesky()?.inverse();
    let found = covariance * right;
    let freedom = residuals.checked_sub(FREE).filter(|freedom| *freedom > 0)? as f64;
    let noise = if stated { 1.0 } else { (square - right.dot(&found)) / freedom };
    let (part, variance) = (found[6], noise * covariance[(6, 6)]);
    (part.is_finite() && variance > 0.0).then(|| Estimate::new(part, variance.sqrt()))
}

#[cfg(test)]
mod tests {
    use nalgebra::{Translation3, UnitQuaternion};

    use super::super::pose_boards;
    use super::*;
    use crate::model::small_camera;
    use crate::model::{Board, BoardShape, FramePose, Noise};
    use crate::solver::synthesize_bent;

    fn bent() -> BentBoard {
        BentBoard {
            board: Board { columns: 9, rows: 5, square_mm: 2.0 },
            shape: BoardShape { sag_x_mm: 0.2, sag_y_mm: -0.1, twist_mm: 0.1, aspect: 0.002 },
        }
    }

    /// Returns features of tilted boards in a camera, with noise, px.
    fn features(noise_px: f64, seed: u64) -> Vec<BapFeature> {
        let pose = |(frame, z): (u32, f64)| {
            let turn = Vector3::new(0.4, -0.3 + 0.2 * f64::from(frame), 0.05);
            let place = Translation3::new(-8.0, -4.0 + f64::from(frame), z);
            let turn = UnitQuaternion::from_scaled_axis(turn);
            FramePose { frame, camera_from_board: Isometry3::from_parts(place, turn) }
        };
        let poses: Vec<FramePose> = [(0, 85.0), (1, 95.0), (2, 105.0)].map(pose).to_vec();
        let noise = Noise { uv_px: noise_px, rho_px: 0.0, centers_px: 0.0 };
        let seen = synthesize_bent(&small_camera(), &bent(), &poses, &noise, seed).unwrap();
        assert!(seen.features.len() > 300);
        seen.features
    }

    fn stated(mut features: Vec<BapFeature>, std_dev_px: Option<[f64; 2]>) -> Vec<BapFeature> {
        for feature in &mut features {
            feature.std_dev_px = std_dev_px;
        }
        features
    }

    fn reconstructed(camera: &PlenopticCamera, features: &[BapFeature]) -> Reconstruction {
        let posed = pose_boards(camera, &bent(), features).unwrap();
        Reconstruction::of(camera, &bent(), &posed).unwrap().unwrap()
    }

    #[test]
    fn points_seen_without_noise_are_where_they_are() {
        let found = reconstructed(&small_camera(), &features(0.0, 1));
        assert_eq!(found.frames, 3);
        assert!(found.points > 60, "{found:?}");
        assert!(found.too_long.value.abs() < 1e-7, "{found:?}");
        assert!(found.across_mm < 1e-5 && found.along_mm < 1e-4, "{found:?}");
    }

    /// A camera whose lengths are all larger has the same projections, but measures a larger world. Boards of the stated size
    /// are then nearer, and turned.
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
        let found = reconstructed(&camera, &features(0.0, 1));
        assert!((found.too_long.value - 0.002).abs() < 2e-5, "{found:?}");
    }

    /// Over many seeds, the mean is 0, and the scatter agrees with the stated σ.
    #[test]
    fn noise_does_not_make_distances_longer() {
        const SEEDS: u64 = 40;
        for std_dev in [Some([0.05; 2]), None] {
            let (mut sum, mut square) = (0.0, 0.0);
            for seed in 0..SEEDS {
                let found = reconstructed(&small_camera(), &stated(features(0.05, seed), std_dev));
                let deviate = found.too_long.value / found.too_long.std_dev;
                sum += deviate;
                square += deviate * deviate;
                assert!(found.too_long.std_dev < 2e-3, "{found:?}");
                assert!(found.along_mm > 5.0 * found.across_mm, "{found:?}");
            }
            let (mean, scatter) = (sum / SEEDS as f64, (square / SEEDS as f64).sqrt());
            assert!(mean.abs() < 3.0 / (SEEDS as f64).sqrt(), "{mean}");
            assert!((0.7..1.2).contains(&scatter), "{scatter}");
        }
    }

    #[test]
    fn a_false_feature_hardly_counts() {
        let mut features = stated(features(0.0, 1), Some([0.05; 2]));
        features[20].u_px += 3.0;
        let found = reconstructed(&small_camera(), &features);
        assert!(found.too_long.value.abs() < 1e-4, "{found:?}");
    }

    #[test]
    fn a_corner_in_one_micro_image_is_left_out() {
        let mut features = features(0.0, 1);
        let before = reconstructed(&small_camera(), &features);
        let first = features[0];
        let mut seen = false;
        features.retain(|f| {
            let own = (f.frame, f.corner) == (first.frame, first.corner);
            !own || !std::mem::replace(&mut seen, true)
        });
        let found = reconstructed(&small_camera(), &features);
        assert_eq!(found.points, before.points - 1);
        assert_eq!(found.left_out, before.left_out + 1);
    }
}
