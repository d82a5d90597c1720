// The cost function as a ceres::Problem, with its parameters and the kinds of its residual rows.
#pragma once

#include <ceres/ceres.h>

#include <Eigen/Core>
#include <memory>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "plenocal/refine.hpp"

namespace plenocal {

/// Kinds of residuals. Those of observations each have a variance that is measured, anchors one
/// that is known.
enum ResidualKind { kUv = 0, kRho = 1, kCenter = 2, kAnchor = 3 };
constexpr int kObservedKinds = 3;
constexpr int kResidualKinds = 4;

/// Where a residual row comes from: what it shares its errors with.
struct RowOrigin {
  ResidualKind kind;
  int group;       ///< frame of a feature; patch of a centre, see `kPatches`; index of an anchor
  int corner;      ///< of a feature: counts all corners of all frames; else -1
  int lens_type;   ///< of a feature; else -1
  double std_dev;  ///< of the cost: px, or the unit of the anchored quantity
};

/// Centres share errors with their neighbours: groups of them are patches of the image, so many
/// along u and along v.
constexpr int kPatchColumns = 8;
constexpr int kPatchRows = 6;
constexpr int kPatches = kPatchColumns * kPatchRows;

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
  /// Origin of each residual row, in the order of the residual blocks of `problem`.
  const std::vector<RowOrigin>& rows() const { return rows_; }

 private:
  template <int I>
  void add_features(const Observations& observations, const CostOptions& options);
  void add_centers(const Observations& observations, const CostOptions& options);
  void add_anchors(const CostOptions& options);
  void fix(const CostOptions& options);
  std::vector<std::pair<double*, int>> intrinsic_blocks();
  // Block of a parameter, its size, and the parameter's place in it.
  std::tuple<double*, int, int> intrinsic(const std::string& name);

  Camera frame_;  // what is not a parameter: lattice, pixel size
  std::array<double, kMainLensParameters> lens_;
  std::array<double, kArrayParameters> array_;
  std::vector<double> focal_lengths_;
  std::vector<std::array<double, Pose::kSize>> poses_;
  std::vector<double*> free_blocks_;
  std::vector<int> free_intrinsics_;
  std::vector<RowOrigin> rows_;
  std::vector<std::pair<int, ceres::ResidualBlockId>> feature_blocks_;  // with their frames
  std::unique_ptr<ceres::Problem> problem_;
};

}  // namespace plenocal
