//! The problem that a calibration has solved, for other programs to solve it too.

use nalgebra::Point3;

use crate::calibration::Calibration;
use crate::calibration::frames::{ALIKE_RAD, solver_features};
use crate::model::{BapFeature, BentBoard, Board, FramePose, MicroImageCenter, PlenopticCamera};
use crate::solver::CostOptions;

/// A least-squares problem, complete: what [`calibrate`](crate::calibration::calibrate) has minimised.
#[derive(Debug, Clone, PartialEq)]
pub struct SolvedProblem {
    /// Where the camera starts.
    pub camera: PlenopticCamera,
    /// Where the poses of the boards start. A board that turned out to be tilted the other way starts where it ended:
    /// from its first pose no solver finds back.
    pub poses: Vec<FramePose>,
    /// The board, with the shape that it starts from or keeps.
    pub board: BentBoard,
    /// What the boards show.
    pub features: Vec<ProblemFeature>,
    /// The micro-image centres, with the σ that they count with.
    pub centers: Vec<MicroImageCenter>,
    /// The cost, with all priors and their weight. Its factors on σ are 1.
    pub cost: CostOptions,
    /// The cost where the calibration ended.
    pub minimum: f64,
}

/// A feature of a problem.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProblemFeature {
    /// What was observed.
    pub feature: BapFeature,
    /// Its corner on the flat board, mm.
    pub board_point_mm: Point3<f64>,
    /// σ of u, v and ρ as they count: with the factors of the options, and that of ρ times √n for the n features of a
    /// corner, which have one blur in common.
    pub std_dev_px: [f64; 3],
}

impl SolvedProblem {
    /// Of a calibration that was made with this board.
    #[must_use]
    pub fn of(calibration: &Calibration, board: &Board) -> Self {
        let Calibration { cost, options, refinement, reprojection, .. } = calibration;
        let observed: Vec<BapFeature> = reprojection.features.iter().map(|f| f.feature).collect();
        let factors = [cost.uv_std_dev_px, cost.uv_std_dev_px, cost.rho_std_dev_px];
        let rows = solver_features(&observed, &calibration.poses, board);
        let features = observed.iter().zip(&rows).map(|(&feature, row)| ProblemFeature {
            feature,
            board_point_mm: row.board_point_mm.into(),
            std_dev_px: std::array::from_fn(|i| factors[i] * row.std_dev_px[i]),
        });
        let of_center = |center: &MicroImageCenter| MicroImageCenter {
            std_dev_px: Some(cost.centers_std_dev_px * center.std_dev_px.unwrap_or(1.0)),
            ..*center
        };
        let start = |(&first, &last): (&FramePose, &FramePose)| {
            let turned =
                first.camera_from_board.rotation.angle_to(&last.camera_from_board.rotation);
            if turned > ALIKE_RAD { last } else { first }
        };
        Self {
            camera: calibration.initial.clone(),
            poses: calibration.initial_poses.iter().zip(&calibration.poses).map(start).collect(),
            board: BentBoard { board: *board, shape: options.known_shape() },
            features: features.collect(),
            centers: reprojection.centers.iter().map(|c| of_center(&c.center)).collect(),
            cost: CostOptions {
                uv_std_dev_px: 1.0,
                rho_std_dev_px: 1.0,
                centers_std_dev_px: 1.0,
                ..cost.clone()
            },
            minimum: refinement.cost,
        }
    }
}
