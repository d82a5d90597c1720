//! Initial poses of the frames.

use std::collections::BTreeMap;

use nalgebra::Isometry3;
use tracing::debug;

use crate::calibration::initial_poses;
use crate::error::{Error, Result};
use crate::finding::{Finding, Issue};
use crate::model::{
    BapFeature, BentBoard, Board, FeatureResidual, FramePose, MicroImageCenter, Observations,
    Parameter, PlenopticCamera,
};
use crate::solver::{
    self, CostOptions, Problem, Projected, SolverCenter, SolverFeature, SolverOptions,
};

/// Iterations for the choice between two poses: a pose alone converges in a few steps.
const CHOICE_ITERATIONS: usize = 5;

/// Difference of rotation below which poses lead to the same refined pose, rad.
pub(super) const ALIKE_RAD: f64 = 0.1;
/// Relative difference of the costs above which two refinements did not reach the same pose.
const CLEARLY_LOWER: f64 = 1e-3;

/// Standard deviation of an observation without its own, px. The factor in the options of the cost is then the standard
/// deviation itself.
const NO_OWN_STD_DEV: f64 = 1.0;

/// A frame that was not used.
#[derive(Debug, Clone, PartialEq)]
pub struct LeftOut {
    /// Number of the frame.
    pub frame: u32,
    /// Number of its features.
    pub features: usize,
    /// Reason why it was not used.
    pub reason: Issue,
}

impl LeftOut {
    /// Returns a finding about the frame.
    #[must_use]
    pub fn finding(&self) -> Finding {
        Finding::left_out(self.frame, None, self.reason.clone())
    }
}

/// Frames with a pose, their features, and the frames left out.
pub(super) struct Frames {
    pub poses: Vec<FramePose>,
    pub features: Vec<BapFeature>,
    pub left_out: Vec<LeftOut>,
}

/// Returns initial poses of all frames: the given ones, and for the other frames those that PnP finds.
///
/// PnP on the barycentres gives up to two poses, mirrored in tilt. Parallax and blur show which way a board is tilted.
/// So each candidate is refined with the camera fixed, and the one that leads to the lower cost is returned, as PnP
/// gave it. (The refined pose would fit the initial camera so well that the solver would need half as many steps again
/// to leave it.)
pub(super) fn initial_frames(
    camera: &PlenopticCamera,
    board: &BentBoard,
    observations: &Observations,
    (cost, solver): (&CostOptions, &SolverOptions),
    given: &[FramePose],
) -> Result<Frames> {
    let mut by_frame: BTreeMap<u32, Vec<BapFeature>> = BTreeMap::new();
    for &feature in &observations.features {
        by_frame.entry(feature.frame).or_default().push(feature);
    }
    let mut left_out = Vec::new();
    let mut candidates = Vec::new();
    for (&frame, features) in &by_frame {
        if let Some(pose) = given.iter().find(|pose| pose.frame == frame) {
            candidates.push((frame, vec![pose.camera_from_board]));
            continue;
        }
        match initial_poses(camera, &board.board, features) {
            Ok(poses) => candidates.push((frame, poses)),
            Err(reason) => left_out.push(LeftOut { frame, features: features.len(), reason }),
        }
    }
    let features: Vec<BapFeature> = observations
        .features
        .iter()
        .filter(|f| candidates.iter().any(|(frame, _)| *frame == f.frame))
        .copied()
        .collect();
    let chosen = choose(camera, board, &candidates, &features, cost, solver)?;
    let poses = candidates
        .iter()
        .zip(chosen)
        .map(|((frame, poses), i)| FramePose { frame: *frame, camera_from_board: poses[i] })
        .collect();
    Ok(Frames { poses, features, left_out })
}

/// Returns the frames with a given pose, at these poses.
pub(super) fn given_frames(observations: &Observations, given: &[FramePose]) -> Frames {
    let mut by_frame: BTreeMap<u32, usize> = BTreeMap::new();
    for feature in &observations.features {
        *by_frame.entry(feature.frame).or_default() += 1;
    }
    let pose_of = |frame: u32| given.iter().find(|pose| pose.frame == frame).copied();
    let poses: Vec<FramePose> = by_frame.keys().filter_map(|&frame| pose_of(frame)).collect();
    let missing = by_frame.iter().filter(|&(&frame, _)| pose_of(frame).is_none());
    let left_out = missing
        .map(|(&frame, &features)| LeftOut { frame, features, reason: Issue::PoseNotGiven })
        .collect();
    let of_these = observations.features.iter().filter(|f| pose_of(f.frame).is_some());
    Frames { poses, features: of_these.copied().collect(), left_out }
}

/// Returns poses for another refinement if some board turns out to be tilted the other way; `None` if no board is
/// mirrored.
///
/// The initial camera may be too inaccurate to decide, and a mirrored board then keeps the refinement in a wrong
/// minimum. The refined camera can decide.
pub(super) fn reconsidered_poses(
    refined: &Problem,
    frames: &Frames,
    cost: &CostOptions,
    solver: &SolverOptions,
) -> Result<Option<Vec<FramePose>>> {
    let Problem { camera, board, .. } = refined;
    let candidates: Vec<(u32, Vec<Isometry3<f64>>)> = frames
        .poses
        .iter()
        .zip(refined.poses)
        .map(|(pose, &refined)| {
            let seen: Vec<BapFeature> =
                frames.features.iter().filter(|f| f.frame == pose.frame).copied().collect();
            let mut poses = vec![refined];
            let others = initial_poses(camera, &board.board, &seen).unwrap_or_default();
            poses.extend(
                others.into_iter().filter(|p| p.rotation.angle_to(&refined.rotation) > ALIKE_RAD),
            );
            (pose.frame, poses)
        })
        .collect();
    let chosen = choose(camera, board, &candidates, &frames.features, cost, solver)?;
    if chosen.iter().all(|&i| i == 0) {
        return Ok(None);
    }
    for ((frame, _), _) in candidates.iter().zip(&chosen).filter(|&(_, &i)| i > 0) {
        debug!("frame {frame} fits better with another pose");
    }
    let pose = |((frame, poses), i): (&(u32, Vec<Isometry3<f64>>), usize)| FramePose {
        frame: *frame,
        camera_from_board: poses[i],
    };
    Ok(Some(candidates.iter().zip(chosen).map(pose).collect()))
}

/// Returns for every frame the index of the candidate that leads to the lowest cost with the camera fixed. A later
/// candidate has to be better by more than [`CLEARLY_LOWER`].
fn choose(
    camera: &PlenopticCamera,
    board: &BentBoard,
    candidates: &[(u32, Vec<Isometry3<f64>>)],
    features: &[BapFeature],
    cost: &CostOptions,
    solver: &SolverOptions,
) -> Result<Vec<usize>> {
    let mut best = vec![(f64::INFINITY, 0); candidates.len()];
    let rounds = candidates.iter().map(|(_, poses)| poses.len()).max().unwrap_or(0);
    let parameters = Parameter::shared(camera.lens_types());
    let fixed = parameters.iter().map(|parameter| parameter.name().to_owned()).collect();
    let cost = CostOptions { fixed, priors: Vec::new(), ..cost.clone() };
    let solver = SolverOptions { max_iterations: CHOICE_ITERATIONS, ..*solver };
    for round in 0..rounds {
        let start: Vec<FramePose> = candidates
            .iter()
            .filter_map(|(frame, poses)| {
                Some(FramePose { frame: *frame, camera_from_board: *poses.get(round)? })
            })
            .collect();
        let seen: Vec<BapFeature> =
            features.iter().filter(|f| start.iter().any(|p| p.frame == f.frame)).copied().collect();
        let start_poses: Vec<Isometry3<f64>> = start.iter().map(|p| p.camera_from_board).collect();
        let solver_features = solver_features(&seen, &start, &board.board);
        let problem = Problem {
            camera,
            board: *board,
            poses: &start_poses,
            features: &solver_features,
            centers: &[],
        };
        let refined = solver::refine(&problem, &cost, &solver, &mut |_| true)?;
        let costs: BTreeMap<u32, f64> =
            start.iter().map(|pose| pose.frame).zip(refined.frame_costs).collect();
        for ((frame, poses), best) in candidates.iter().zip(&mut best) {
            let frame_cost = costs.get(frame).copied().unwrap_or(f64::INFINITY);
            if round < poses.len() && frame_cost < best.0 * (1.0 - CLEARLY_LOWER) {
                *best = (frame_cost, round);
            }
        }
    }
    Ok(best.into_iter().map(|(_, round)| round).collect())
}

/// Converts features for the solver. The frame of every feature has a pose.
pub(super) fn solver_features(
    features: &[BapFeature],
    poses: &[FramePose],
    board: &Board,
) -> Vec<SolverFeature> {
    let index: BTreeMap<u32, usize> = poses.iter().enumerate().map(|(i, p)| (p.frame, i)).collect();
    let mut of_corner: BTreeMap<(u32, i32), f64> = BTreeMap::new();
    for f in features {
        *of_corner.entry((f.frame, f.corner)).or_default() += 1.0;
    }
    // ρ of a corner follows from its virtual depth, one measurement that all its features in a frame share. With √n
    // times its σ, the n features together weigh as much as this measurement.
    let rho_std_dev =
        |f: &BapFeature| f.rho_std_dev_px.map(|own| own * of_corner[&(f.frame, f.corner)].sqrt());
    let to_solver = |f: &BapFeature| SolverFeature {
        pose: index[&f.frame],
        board_point_mm: board.point_mm(f.corner).coords.into(),
        k: f.k,
        l: f.l,
        u_px: f.u_px,
        v_px: f.v_px,
        rho_px: f.rho_px.unwrap_or(f64::NAN),
        std_dev_px: {
            let [u, v] = f.std_dev_px.unwrap_or([NO_OWN_STD_DEV; 2]);
            [u, v, rho_std_dev(f).unwrap_or(NO_OWN_STD_DEV)]
        },
    };
    features.iter().map(to_solver).collect()
}

/// Converts centres for the solver.
pub(super) fn solver_centers(centers: &[MicroImageCenter]) -> Vec<SolverCenter> {
    let to_solver = |c: &MicroImageCenter| SolverCenter {
        k: c.k,
        l: c.l,
        u_px: c.u_px,
        v_px: c.v_px,
        std_dev_px: c.std_dev_px.unwrap_or(NO_OWN_STD_DEV),
    };
    centers.iter().map(to_solver).collect()
}

/// Computes observed minus projected for every feature of a problem.
pub(super) fn feature_residuals(
    problem: &Problem,
    features: &[BapFeature],
) -> Result<Vec<FeatureResidual>> {
    let residual = |(&feature, projected): (&BapFeature, Option<Projected>)| {
        let projected = projected.ok_or_else(|| {
            Error::invalid(format!(
                "the refined camera does not image corner {} of frame {}",
                feature.corner, feature.frame
            ))
        })?;
        Ok(FeatureResidual {
            feature,
            lens_type: problem.camera.lens_type(feature.k, feature.l),
            du_px: feature.u_px - projected.u_px,
            dv_px: feature.v_px - projected.v_px,
            drho_px: projected.rho().zip(feature.rho_px).map(|(rho, measured)| measured - rho),
        })
    };
    features.iter().zip(solver::project(problem)?).map(residual).collect()
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};

    use super::*;
    use crate::model::Noise;
    use crate::model::small_camera as camera;
    use crate::solver::{Loss, LossKind, synthesize};

    const BOARD: Board = Board { columns: 9, rows: 5, square_mm: 3.0 };

    /// Returns the pose of the board in front of the camera, tilted about x through its middle.
    fn tilted(angle_rad: f64) -> Isometry3<f64> {
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), angle_rad);
        let middle = Point3::new(12.0, 6.0, 0.0);
        let place = Vector3::new(0.0, 0.0, 110.0) - (rotation * middle).coords;
        Isometry3::from_parts(Translation3::from(place), rotation)
    }

    /// Applies `solve` to one frame at this pose.
    fn of_frame<T>(
        pose: &Isometry3<f64>,
        features: &[BapFeature],
        solve: impl Fn(&Problem) -> T,
    ) -> T {
        let start = [FramePose { frame: 0, camera_from_board: *pose }];
        let rows = solver_features(features, &start, &BOARD);
        let (camera, board, poses) = (&camera(), BOARD.into(), &[*pose]);
        solve(&Problem { camera, board, poses, features: &rows, centers: &[] })
    }

    fn projections(pose: &Isometry3<f64>, features: &[BapFeature]) -> Vec<FeatureResidual> {
        of_frame(pose, features, |problem| feature_residuals(problem, features).unwrap())
    }

    fn refined(
        pose: &Isometry3<f64>,
        features: &[BapFeature],
        cost: &CostOptions,
    ) -> Isometry3<f64> {
        let solver =
            SolverOptions { max_iterations: CHOICE_ITERATIONS, ..SolverOptions::default() };
        of_frame(pose, features, |problem| {
            solver::refine(problem, cost, &solver, &mut |_| true).unwrap().poses[0]
        })
    }

    fn sum_of_squares(residuals: &[FeatureResidual]) -> f64 {
        let square =
            |r: &FeatureResidual| r.du_px.powi(2) + r.dv_px.powi(2) + r.drho_px.unwrap().powi(2);
        residuals.iter().map(square).sum()
    }

    /// Gross outliers lie towards the mirrored pose. It has the lower sum of squares, but not the lower cost with the
    /// loss used to refine the poses.
    #[test]
    fn the_robust_cost_chooses_the_pose() {
        let (right, mirrored) = (tilted(0.5), tilted(-0.5));
        let poses = [FramePose { frame: 0, camera_from_board: right }];
        let exact = Noise { uv_px: 0.0, rho_px: 0.0, centers_px: 0.0 };
        let mut features = synthesize(&camera(), &BOARD, &poses, &exact, 1).unwrap().features;
        let towards_mirrored = projections(&mirrored, &features);
        for (feature, r) in features.iter_mut().zip(&towards_mirrored).step_by(10) {
            feature.u_px -= 100.0 * r.du_px;
            feature.v_px -= 100.0 * r.dv_px;
            feature.rho_px = feature.rho_px.map(|rho| rho - 100.0 * r.drho_px.unwrap());
        }
        let fixed =
            Parameter::shared(3).iter().map(|parameter| parameter.name().to_owned()).collect();
        let cost = CostOptions {
            loss: Loss { kind: LossKind::Cauchy, scale: 0.1 },
            fixed,
            ..CostOptions::default()
        };
        let squares =
            |pose| sum_of_squares(&projections(&refined(pose, &features, &cost), &features));
        assert!(
            squares(&mirrored) < 0.99 * squares(&right),
            "{} {}",
            squares(&mirrored),
            squares(&right)
        );

        let solver = SolverOptions::default();
        let chosen = choose(
            &camera(),
            &BOARD.into(),
            &[(0, vec![mirrored, right])],
            &features,
            &cost,
            &solver,
        )
        .unwrap();
        assert_eq!(chosen, [1]);
    }
}
