// The cost function as a ceres::Problem, with its parameters and the kinds of its residual rows.
#pragma once

#include <ceres/ceres.h>

#include <Eigen/Core>
#include <memory>
#include <utility>
#include <vector>

#include "plenocal/refine.hpp"

namespace plenocal {

/// Kinds of residuals, each with its own variance.
enum ResidualKind { kUv = 0, kRho = 1, kCenter = 2, kResidualKinds = 3 };

/// Owns the parameter blocks and the problem over them; neither copied nor moved, since Ceres
/// keeps pointers into it.
class CalibrationProblem {
 public:
  CalibrationProblem(const Camera& camera, const std::vector<Pose>& poses,
                     const Observations& observations, const CostOptions& options);
  CalibrationProblem(const CalibrationProblem&) = delete;
  CalibrationProblem& operator=(const CalibrationProblem&) = delete;

  ceres::Problem& problem() { return *problem_; }

  /// Poses are eliminated first by the Schur solvers.
  std::shared_ptr<ceres::ParameterBlockOrdering> ordering();

  /// Camera and poses with the present values of the parameter blocks.
  Camera camera() const;
  std::vector<Pose> poses() const;

  /// All parameters as one vector, and back.
  Eigen::VectorXd state() const;
  void set_state(const Eigen::VectorXd& state);

  /// The cost of every frame's features at the present values; infinite if the model is not
  /// defined.
  std::vector<double> frame_costs() const;

  /// Blocks with a free parameter: intrinsics in their order, then the poses.
  const std::vector<double*>& free_blocks() const { return free_blocks_; }
  /// Indices of the intrinsics that are free.
  const std::vector<int>& free_intrinsics() const { return free_intrinsics_; }
  /// Kind of each residual row, in the order of the residual blocks of `problem`.
  const std::vector<ResidualKind>& row_kinds() const { return row_kinds_; }

 private:
  template <int I>
  void add_features(const Observations& observations, const CostOptions& options);
  void add_centers(const Observations& observations, const CostOptions& options);
  void fix(const CostOptions& options);
  std::vector<std::pair<double*, int>> intrinsic_blocks();

  Camera frame_;  // what is not a parameter: lattice, pixel size
  std::array<double, kMainLensParameters> lens_;
  std::array<double, kArrayParameters> array_;
  std::vector<double> focal_lengths_;
  std::vector<std::array<double, Pose::kSize>> poses_;
  std::vector<double*> free_blocks_;
  std::vector<int> free_intrinsics_;
  std::vector<ResidualKind> row_kinds_;
  std::vector<std::pair<int, ceres::ResidualBlockId>> feature_blocks_;  // with their frames
  std::unique_ptr<ceres::Problem> problem_;
};

}  // namespace plenocal
