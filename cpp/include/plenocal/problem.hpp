// Cost function as a public ceres::Problem.
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

/// Result of an evaluation of a problem.
struct Evaluation {
  double cost = 0.0;
  /// Standardised residuals: u, v and, if used, rho of the features, by frame and board point; u
  /// and v of the centres; then the priors.
  std::vector<double> residuals;
  std::vector<double> gradient;  ///< J'r, in the order of `CalibrationProblem::names`
  /// d residuals / d parameters, in the same orders; the columns of a fixed pose are empty.
  /// Eigen::Map reads its vectors as a SparseMatrix by rows.
  ceres::CRSMatrix jacobian;
};

/// Cost as a ceres::Problem that you may extend: add the residuals of other cameras, priors, or
/// poses from other sources, then pass it to ceres::Solve with `ordering`. `refine` and
/// `uncertainty` do the same for problems without additions.
///
/// It owns the parameter blocks and the problem over them. It can be neither copied nor moved,
/// since Ceres keeps pointers into it.
class PLENOCAL_API CalibrationProblem {
 public:
  /// Throws std::invalid_argument like `refine`.
  CalibrationProblem(const Camera& camera, const std::vector<Pose>& poses,
                     const Observations& observations, const CostOptions& options);
  /// Adds a further camera of a rig, which sees the boards of `first` and uses its problem. The
  /// frames of the observations are indices into the poses of `first`, and some may be missing.
  /// Both have to live as long as the problem is used, and the shape of the boards has to be known.
  CalibrationProblem(CalibrationProblem& first, const Pose& camera_from_first, const Camera& camera,
                     const Observations& observations, const CostOptions& options);
  CalibrationProblem(const CalibrationProblem&) = delete;
  CalibrationProblem& operator=(const CalibrationProblem&) = delete;
  ~CalibrationProblem();

  ceres::Problem& problem();

  /// Parameter blocks, each in the order of its `visit`; poses as `pose_block`.
  struct Blocks {
    double* main_lens;           ///< `kMainLensParameters`
    double* exit_pupil;          ///< `kExitPupilParameters`
    double* array;               ///< `kArrayParameters`
    double* focal_lengths;       ///< one for each lens type; null for an array of pinholes
    double* board_shape;         ///< `kBoardShapeParameters`; null unless it is free
    double* camera_from_first;   ///< `Pose::kSize`; null unless this is a further camera of a rig
    std::vector<double*> poses;  ///< none for a further camera
  };
  Blocks blocks();

  /// Returns an ordering in which Schur solvers eliminate poses first; it includes further cameras.
  /// Add your own blocks to it: poses to group 0 if no residual connects them with another pose,
  /// others to a later one.
  std::shared_ptr<ceres::ParameterBlockOrdering> ordering();

  /// Returns the camera at the present values of the parameter blocks; the next two return the
  /// shape of the board and the poses.
  Camera camera() const;
  BoardShape<double> board_shape() const;
  std::vector<Pose> poses() const;
  /// Returns the pose of a further camera of a rig.
  Pose camera_from_first() const;

  /// Returns an equivalent problem over the same parameter blocks with few rows: each residual
  /// block has one more row than parameters. Cost, gradient and Gauss-Newton matrix are equal up to
  /// rounding, and a solve takes half of the time; its residuals have no individual meaning. It
  /// excludes your own additions, keeps blocks constant that are constant now, and may be used only
  /// as long as this object lives. Throws std::invalid_argument for cameras of a rig.
  std::unique_ptr<ceres::Problem> compressed() const;

  /// Evaluates cost, residuals and derivatives of this camera at the present values, without your
  /// own additions (for all of them, `problem().Evaluate`). Throws std::invalid_argument if the
  /// model is not defined, and for a further camera of a rig.
  Evaluation evaluate() const;

  /// Gets and sets all parameters as one vector, block by block. Throws std::invalid_argument if
  /// the vector has another length or is not finite.
  std::vector<double> state() const;
  void set_state(const std::vector<double>& state);

  /// Returns the cost of every frame's features at the present values; infinite if the model is not
  /// defined.
  std::vector<double> frame_costs() const;

  /// Returns the blocks with a free parameter: intrinsics in their order, then the poses.
  const std::vector<double*>& free_blocks() const;
  /// Returns the names of the parameters in the order of gradients and covariances, see
  /// `Uncertainty::names`.
  std::vector<std::string> names() const;

 private:
  std::unique_ptr<LeastSquares> parts_;
};

}  // namespace plenocal
