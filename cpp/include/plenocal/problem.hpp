// The cost function as a public ceres::Problem.
#pragma once

#include <ceres/crs_matrix.h>
#include <ceres/ordered_groups.h>
#include <ceres/problem.h>

#include <memory>
#include <string>
#include <vector>

#include "plenocal/refine.hpp"

namespace plenocal {

class LeastSquares;

/// What an evaluation of a problem gives.
struct Evaluation {
  double cost = 0.0;
  /// Standardised residuals: u, v and, if it counts, rho of the features, by frame and board point;
  /// u and v of the centres; then the priors.
  std::vector<double> residuals;
  std::vector<double> gradient;  ///< J'r, in the order of `CalibrationProblem::names`
  /// d residuals / d parameters, likewise; the columns of a fixed pose are empty. Eigen::Map takes
  /// its vectors as a SparseMatrix by rows.
  ceres::CRSMatrix jacobian;
};

/// The cost as a ceres::Problem that is yours to extend: add the residuals of other cameras,
/// priors, poses that come from elsewhere, then hand it to ceres::Solve with `ordering`. `refine`
/// and `uncertainty` do the same for problems without additions.
///
/// It owns the parameter blocks and the problem over them; neither copied nor moved, since Ceres
/// keeps pointers into it.
class PLENOCAL_API CalibrationProblem {
 public:
  /// Throws std::invalid_argument like `refine`.
  CalibrationProblem(const Camera& camera, const std::vector<Pose>& poses,
                     const Observations& observations, const CostOptions& options);
  /// A further camera of a rig, which sees the boards of `first` and takes part in its problem: the
  /// frames of the observations are indices into the poses of `first`, and some may be missing.
  /// Both have to live as long as the problem is used, and the boards have a shape that is known.
  CalibrationProblem(CalibrationProblem& first, const Pose& camera_from_first, const Camera& camera,
                     const Observations& observations, const CostOptions& options);
  CalibrationProblem(const CalibrationProblem&) = delete;
  CalibrationProblem& operator=(const CalibrationProblem&) = delete;
  ~CalibrationProblem();

  ceres::Problem& problem();

  /// The parameter blocks, each in the order of its `visit`; poses as `pose_block`.
  struct Blocks {
    double* main_lens;           ///< `kMainLensParameters`
    double* exit_pupil;          ///< `kExitPupilParameters`
    double* array;               ///< `kArrayParameters`
    double* focal_lengths;       ///< one for each lens type; null for an array of pinholes
    double* board_shape;         ///< `kBoardShapeParameters`; null unless it is free
    double* camera_from_first;   ///< `Pose::kSize`; null unless this is a further camera of a rig
    std::vector<double*> poses;  ///< none of a further camera
  };
  Blocks blocks();

  /// Poses are eliminated first by the Schur solvers; further cameras take part. Blocks that you
  /// have added have to be added to it as well: poses to group 0 if no residual joins them with
  /// another pose, others to a later one.
  std::shared_ptr<ceres::ParameterBlockOrdering> ordering();

  /// Camera, board and poses with the present values of the parameter blocks.
  Camera camera() const;
  BoardShape<double> board_shape() const;
  std::vector<Pose> poses() const;
  /// Where a further camera of a rig is.
  Pose camera_from_first() const;

  /// The same over the same parameter blocks, but with few rows: each residual block has one more
  /// than it has parameters. Cost, gradient and Gauss-Newton matrix are the same, to rounding, and
  /// a solve takes half of the time; residuals have no meaning of their own. Without what you have
  /// added, with blocks constant that are so now, and only as long as this lives. Throws
  /// std::invalid_argument for cameras of a rig.
  std::unique_ptr<ceres::Problem> compressed() const;

  /// Cost, residuals and derivatives of this camera at the present values, without what you have
  /// added (for all of it, `problem().Evaluate`). Throws std::invalid_argument where the model is
  /// not defined, and for a further camera of a rig.
  Evaluation evaluate() const;

  /// All parameters as one vector, block by block, and back. Throws std::invalid_argument if the
  /// vector is of another length or not finite.
  std::vector<double> state() const;
  void set_state(const std::vector<double>& state);

  /// The cost of every frame's features at the present values; infinite if the model is not
  /// defined.
  std::vector<double> frame_costs() const;

  /// Blocks with a free parameter: intrinsics in their order, then the poses.
  const std::vector<double*>& free_blocks() const;
  /// Names of the parameters in the order of gradients and covariances, see `Uncertainty::names`.
  std::vector<std::string> names() const;

 private:
  std::unique_ptr<LeastSquares> parts_;
};

}  // namespace plenocal
