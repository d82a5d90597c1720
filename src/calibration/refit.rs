//! Refinement of a calibration from its minimum, without some parameters or without some frames.
//!
//! All the rest stays: the observations, their weights, the loss, the priors and their weight. So costs can be
//! compared, and the new minimum is near.

use nalgebra::Isometry3;

use crate::calibration::checks::check_refined;
use crate::calibration::frames::{feature_residuals, solver_centers, solver_features};
use crate::calibration::priors::results;
use crate::calibration::stage::center_residuals;
use crate::calibration::{Calibration, PriorSource};
use crate::error::Result;
use crate::model::{
    BapFeature, BentBoard, Board, BoardShape, FramePose, MicroImageCenter, Parameter,
    PlenopticCamera, Reprojection,
};
use crate::solver::{
    self, CostOptions, Loss, LossKind, Prior, Problem, Refinement, SolverCenter, SolverFeature,
    SolverOptions, Termination,
};

/// Iterations without loss after a parameter is removed. The residuals are large at first, and a few steps lead back to
/// where the loss can act.
const ROUGH_ITERATIONS: usize = 4;
/// Relative tolerance of the cost for held-out frames. Their errors are compared to a per cent, and this tolerance
/// gives parameters to a twentieth of their standard deviations.
const HELD_OUT_TOLERANCE: f64 = 1e-8;

/// Minimum of the cost.
#[derive(Debug, Clone, PartialEq)]
pub struct Minimum {
    /// Camera at the minimum.
    pub camera: PlenopticCamera,
    /// Shape of the board.
    pub shape: BoardShape,
    /// Poses of the boards.
    pub poses: Vec<FramePose>,
    /// Contributions of features, centres and priors to the cost.
    pub cost_parts: [f64; 3],
    /// True if the solver reached it, by its tolerances.
    pub converged: bool,
}

/// Calibration with the data to refine it again.
#[derive(Debug)]
pub struct Refit<'a> {
    calibration: &'a Calibration,
    board: &'a Board,
    features: Vec<BapFeature>,
    centers: Vec<MicroImageCenter>,
    solver_centers: Vec<SolverCenter>,
}

impl<'a> Refit<'a> {
    /// Creates a refit of a calibration that was made with this board.
    #[must_use]
    pub fn new(calibration: &'a Calibration, board: &'a Board) -> Self {
        let reprojection = &calibration.reprojection;
        let centers: Vec<MicroImageCenter> =
            reprojection.centers.iter().map(|c| c.center).collect();
        Self {
            calibration,
            board,
            features: reprojection.features.iter().map(|f| f.feature).collect(),
            solver_centers: solver_centers(&centers),
            centers,
        }
    }

    /// Returns the minimum of the calibration.
    #[must_use]
    pub fn minimum(&self) -> Minimum {
        let Calibration { refinement, poses, converged, .. } = self.calibration;
        self.minimum_of(refinement, &self.calibration.cost, poses.clone(), *converged)
    }

    /// Finds the minimum with some parameters held at 0.
    pub fn without(&self, parameters: &[Parameter]) -> Result<Minimum> {
        let mut start = self.minimum();
        for &parameter in parameters {
            if parameter.is_of_board() {
                start.shape.set(parameter, 0.0);
            } else {
                start.camera.set(parameter, 0.0);
            }
        }
        let cost = self.cost_without(parameters);
        if cost.loss.kind != LossKind::None {
            let loss = Loss { kind: LossKind::None, ..cost.loss };
            let plain = CostOptions { loss, ..cost.clone() };
            let rough = SolverOptions { max_iterations: ROUGH_ITERATIONS, ..self.solver() };
            start = self.refined(&start, &plain, &rough)?;
        }
        self.refined(&start, &cost, &self.solver())
    }

    /// Computes the errors of held-out frames. Refines the camera from a minimum without these frames, and then their
    /// poses with this camera. Returns by frame the mean over its features of |r/σ|², with the weights and the loss of
    /// the calibration. `parameters` keep their value in the minimum.
    pub fn held_out(
        &self,
        minimum: &Minimum,
        parameters: &[Parameter],
        frames: &[u32],
    ) -> Result<Vec<(u32, f64)>> {
        let with_poses = |held_out: bool| Minimum {
            poses: minimum
                .poses
                .iter()
                .filter(|pose| frames.contains(&pose.frame) == held_out)
                .copied()
                .collect(),
            ..minimum.clone()
        };
        let cost = self.cost_without(parameters);
        let solver = SolverOptions { function_tolerance: HELD_OUT_TOLERANCE, ..self.solver() };
        let rest = self.refined(&with_poses(false), &cost, &solver)?;
        let all = Parameter::shared(minimum.camera.lens_types());
        let fixed = all.iter().map(|parameter| parameter.name().to_owned()).collect();
        let poses_only = CostOptions { fixed, priors: Vec::new(), ..cost };
        let left_out = Minimum { camera: rest.camera, shape: rest.shape, ..with_poses(true) };
        let solved = self.solve(&left_out, &poses_only, &[], &solver)?;
        let squares = |(pose, cost): (&FramePose, &f64)| {
            let count = self.features.iter().filter(|f| f.frame == pose.frame).count();
            (pose.frame, 2.0 * cost / count.max(1) as f64)
        };
        Ok(left_out.poses.iter().zip(&solved.frame_costs).map(squares).collect())
    }

    /// Computes the residuals at a minimum.
    pub fn reprojection(&self, minimum: &Minimum) -> Result<Reprojection> {
        let rows = solver_features(&self.features, &minimum.poses, self.board);
        let poses = transforms(&minimum.poses);
        let problem = self.problem(minimum, &poses, &rows, &[]);
        Ok(Reprojection {
            features: feature_residuals(&problem, &self.features)?,
            centers: center_residuals(&minimum.camera, &self.centers)?,
        })
    }

    fn problem<'b>(
        &self,
        at: &'b Minimum,
        poses: &'b [Isometry3<f64>],
        features: &'b [SolverFeature],
        centers: &'b [SolverCenter],
    ) -> Problem<'b> {
        let board = BentBoard { board: *self.board, shape: at.shape };
        Problem { camera: &at.camera, board, poses, features, centers }
    }

    /// Returns solver options with one thread, since several refits run at a time.
    fn solver(&self) -> SolverOptions {
        SolverOptions { threads: 1, ..self.calibration.options.solver() }
    }

    fn cost_without(&self, parameters: &[Parameter]) -> CostOptions {
        let mut cost = self.calibration.cost.clone();
        cost.fixed.extend(parameters.iter().map(ToString::to_string));
        // A prior on a parameter that is taken away has no meaning.
        let is_held = |quantity: &str| parameters.iter().any(|p| p.name() == quantity);
        cost.priors.retain(|prior| !is_held(&prior.quantity));
        cost
    }

    fn refined(
        &self,
        start: &Minimum,
        cost: &CostOptions,
        solver: &SolverOptions,
    ) -> Result<Minimum> {
        let solved = self.solve(start, cost, &self.solver_centers, solver)?;
        let of = |(pose, &camera_from_board): (&FramePose, &Isometry3<f64>)| FramePose {
            frame: pose.frame,
            camera_from_board,
        };
        let poses = start.poses.iter().zip(&solved.poses).map(of).collect();
        let converged = solved.termination == Termination::Converged;
        Ok(self.minimum_of(&solved, cost, poses, converged))
    }

    fn solve(
        &self,
        start: &Minimum,
        cost: &CostOptions,
        centers: &[SolverCenter],
        solver: &SolverOptions,
    ) -> Result<Refinement> {
        let seen: Vec<BapFeature> = self
            .features
            .iter()
            .filter(|f| start.poses.iter().any(|pose| pose.frame == f.frame))
            .copied()
            .collect();
        let features = solver_features(&seen, &start.poses, self.board);
        let poses = transforms(&start.poses);
        let problem = self.problem(start, &poses, &features, centers);
        let refinement = solver::refine(&problem, cost, solver, &mut |_| true)?;
        check_refined(&refinement)?;
        Ok(refinement)
    }

    fn minimum_of(
        &self,
        refinement: &Refinement,
        cost: &CostOptions,
        poses: Vec<FramePose>,
        converged: bool,
    ) -> Minimum {
        let (camera, shape) = (refinement.camera.clone(), refinement.shape);
        let known: Vec<(Prior, PriorSource)> = self
            .calibration
            .priors
            .iter()
            .filter(|known| cost.priors.contains(&known.prior))
            .map(|known| (known.prior.clone(), known.source))
            .collect();
        let squares: f64 = results(known, &camera, &shape)
            .iter()
            .map(|known| known.normalised_residual().powi(2))
            .sum();
        let priors = cost.prior_weight / 2.0 * squares;
        let features: f64 = refinement.frame_costs.iter().sum();
        let cost_parts = [features, refinement.cost - features - priors, priors];
        Minimum { camera, shape, poses, cost_parts, converged }
    }
}

fn transforms(poses: &[FramePose]) -> Vec<Isometry3<f64>> {
    poses.iter().map(|pose| pose.camera_from_board).collect()
}
