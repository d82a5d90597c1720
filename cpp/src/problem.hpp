// The cost function as a ceres::Problem, with its parameters and the kinds of its residual rows.
#pragma once

#include <ceres/ceres.h>

#include <Eigen/Core>
#include <memory>
#include <utility>
#include <vector>

#include "plenocal/refine.hpp"
#include "plenocal/residuals.hpp"

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
  double std_dev;  ///< of the cost: px, or the unit of the anchored quantity
  int observation = -1;  ///< index among features or among centres; -1 of an anchor
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

  /// Camera, board and poses with the present values of the parameter blocks.
  Camera camera() const;
  BoardShape<double> board_shape() const { return from_block<BoardShape>(shape_.data()); }
  std::vector<Pose> poses() const;

  /// All parameters as one vector, and back.
  Eigen::VectorXd state() const;
  void set_state(const Eigen::VectorXd& state);

  /// The cost of every frame's features at the present values; infinite if the model is not
  /// defined.
  std::vector<double> frame_costs() const;

  /// Blocks with a free parameter: intrinsics in their order, then the poses.
  const std::vector<double*>& free_blocks() const { return free_blocks_; }
  /// Indices of the shared parameters that are free.
  const std::vector<int>& free_intrinsics() const { return free_intrinsics_; }
  /// Origin of each residual row, block by block.
  const std::vector<RowOrigin>& rows() const { return rows_; }

  /// Residuals and Jacobian of a block: columns are the free intrinsics, then, for features, the
  /// six of their frame's pose.
  struct Linearised {
    int first_row;  ///< in `rows`
    Eigen::VectorXd residuals;
    Eigen::MatrixXd jacobian;
  };
  /// Calls f(const Linearised&) for every block, at the present values. Throws
  /// std::invalid_argument where the model is not defined.
  template <typename F>
  void linearise(F&& f) const {
    int first_row = 0;
    for (const Block& block : blocks_) {
      f(linearised(block, first_row));
      first_row += block.cost->num_residuals();
    }
  }

 private:
  template <int I, bool Bent>
  void add_features(const Observations& observations, const CostOptions& options);
  void add_centers(const Observations& observations, const CostOptions& options);
  void add_anchors(const CostOptions& options);
  /// Adds an anchor on a q'_i; false if it is on something else.
  bool add_intercept(const Anchor& anchor, double weight);
  /// The same of the lean of the array.
  bool add_lean(const Anchor& anchor, double weight);
  void fix(const CostOptions& options);
  /// Blocks that all frames share. That of the board's shape is no parameter unless it is free, and
  /// then the problem is the same as without one.
  std::vector<std::pair<double*, int>> shared_blocks();
  struct Place {
    double* block;
    int size;   // of the block
    int index;  // in the block
  };
  struct Block {
    const ceres::CostFunction* cost;
    std::vector<double*> parameters;
  };
  ceres::ResidualBlockId add_block(std::unique_ptr<ceres::CostFunction> cost,
                                   std::vector<double*> parameters);
  Linearised linearised(const Block& block, int first_row) const;

  Camera frame_;  // what is not a parameter: lattice, pixel size
  Board board_;   // its size
  bool shape_is_free_;
  std::array<double, kMainLensParameters> lens_;
  std::array<double, kExitPupilParameters> exit_pupil_;
  std::array<double, kArrayParameters> array_;
  std::vector<double> focal_lengths_;
  std::array<double, kBoardShapeParameters> shape_;
  std::vector<std::array<double, Pose::kSize>> poses_;
  std::vector<Place> places_;  // of all shared parameters
  std::vector<double*> free_blocks_;
  std::vector<int> free_intrinsics_;
  std::vector<RowOrigin> rows_;
  std::vector<Block> blocks_;
  std::vector<std::pair<int, ceres::ResidualBlockId>> feature_blocks_;  // with their frames
  std::unique_ptr<ceres::Problem> problem_;
};

}  // namespace plenocal
