// Cost of a camera as blocks of parameters and of residuals in a ceres::Problem, the basis of
// `CalibrationProblem`, `refine` and `uncertainty`.
#pragma once

#include <ceres/ceres.h>

#include <Eigen/Core>
#include <array>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "compressed.hpp"
#include "plenocal/problem.hpp"
#include "plenocal/residuals.hpp"

namespace plenocal {

/// Kinds of residuals. The variance is measured for each kind of observation, and known for priors.
enum ResidualKind { kUv = 0, kRho = 1, kCenter = 2, kPrior = 3 };
constexpr int kObservedKinds = 3;
constexpr int kResidualKinds = 4;

/// Origin of a residual row, with the groups that share errors.
struct RowOrigin {
  ResidualKind kind;
  int group;       ///< frame of a feature; patch of a centre, see `kPatches`; index of a prior
  int corner;      ///< number of a feature's corner among the corners of all frames; else -1
  double std_dev;  ///< sigma in the cost: px, or the unit of the quantity with a prior
  int observation = -1;  ///< index among features or among centres; -1 for a prior
};

/// Number of patches of the image along u and along v. Centres share errors with their neighbours,
/// so that they are grouped by patches.
constexpr int kPatchColumns = 8;
constexpr int kPatchRows = 6;
constexpr int kPatches = kPatchColumns * kPatchRows;

/// Neither copied nor moved, since Ceres keeps pointers into it. Public functions are the same as
/// in `CalibrationProblem`.
class LeastSquares {
 public:
  using Blocks = CalibrationProblem::Blocks;

  LeastSquares(const Camera& camera, const std::vector<Pose>& poses,
               const Observations& observations, const CostOptions& options);
  LeastSquares(LeastSquares& first, const Pose& camera_from_first, const Camera& camera,
               const Observations& observations, const CostOptions& options);
  LeastSquares(const LeastSquares&) = delete;
  LeastSquares& operator=(const LeastSquares&) = delete;

  ceres::Problem& problem() { return *problem_; }
  Blocks blocks();
  std::shared_ptr<ceres::ParameterBlockOrdering> ordering();

  Camera camera() const;
  BoardShape<double> board_shape() const { return from_block<BoardShape>(shape_.data()); }
  std::vector<Pose> poses() const;
  Pose camera_from_first() const { return pose_from_block(camera_from_first_); }

  /// Returns an equivalent problem with few rows. `parallel` evaluates its blocks and has to
  /// outlive it; without `parallel` Ceres evaluates them.
  std::unique_ptr<ceres::Problem> compressed(ParallelEvaluation* parallel = nullptr) const;
  Evaluation evaluate() const;
  Eigen::VectorXd state() const;
  void set_state(const Eigen::VectorXd& state);
  std::vector<double> frame_costs() const;

  const std::vector<double*>& free_blocks() const { return free_blocks_; }
  /// Returns the indices of the free shared parameters.
  const std::vector<int>& free_intrinsics() const { return free_intrinsics_; }
  std::vector<std::string> names() const;
  /// Returns the indices of the fixed poses.
  const std::vector<int>& fixed_poses() const { return fixed_poses_; }
  /// Returns the origin of each residual row, block by block.
  const std::vector<RowOrigin>& rows() const { return rows_; }

  /// Residuals and Jacobian of a block. Its columns are the free intrinsics, then, for features,
  /// the six parameters of the pose of their frame, which are 0 if it is fixed.
  struct Linearised {
    int first_row = 0;  ///< index into `rows`
    Eigen::VectorXd residuals;
    Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> jacobian;
    std::vector<double> room;  ///< reusable memory for the values of Ceres
  };
  /// Returns the number of residual blocks; their rows are consecutive.
  int residual_blocks() const { return static_cast<int>(blocks_.size()); }
  /// Returns the first row of a block.
  int first_row(int block) const { return blocks_[block].first_row; }
  /// Linearises a block at the present values; several threads may do so at once. Throws
  /// std::invalid_argument if the model is not defined.
  void linearise(int block, Linearised* result) const;

 private:
  LeastSquares(const Camera& camera, const Board& board, const CostOptions& options,
               std::shared_ptr<ceres::Problem> problem);
  /// Adds all residuals. The poses are blocks of this problem or of the problem of the first
  /// camera.
  void add_residuals(const Observations& observations, const CostOptions& options,
                     const std::vector<double*>& poses);
  template <int I, bool Bent, bool InRig>
  void add_features(const Observations& observations, const CostOptions& options,
                    const std::vector<double*>& poses);
  void add_centers(const Observations& observations, const CostOptions& options);
  void add_priors(const CostOptions& options);
  /// Adds a prior on a q'_i; returns false if it is on something else.
  bool add_intercept(const Prior& prior, double weight);
  /// Adds a prior on a component of the tilt gradient; returns false if it is on something else.
  bool add_tilt_gradient(const Prior& prior, double weight);
  void fix(const CostOptions& options);
  /// Returns the blocks that all frames share. The block of the board shape is a parameter only if
  /// it is free; otherwise the problem is the same as without it.
  std::vector<std::pair<double*, int>> shared_blocks();
  struct Place {
    double* block;
    int size;   // size of the block
    int index;  // index in the block
  };
  struct Block {
    const ceres::CostFunction* cost;
    std::vector<double*> parameters;
    int first_row;
  };
  ceres::ResidualBlockId add_block(std::unique_ptr<ceres::CostFunction> cost,
                                   std::vector<double*> parameters);

  Camera frame_;  // values that are not parameters: lattice, pixel size
  Board board_;   // size of the board
  bool shape_is_free_;
  std::array<double, kMainLensParameters> lens_;
  std::array<double, kExitPupilParameters> exit_pupil_;
  std::array<double, kArrayParameters> array_;
  std::vector<double> focal_lengths_;
  std::array<double, kBoardShapeParameters> shape_;
  bool in_rig_ = false;
  std::array<double, Pose::kSize> camera_from_first_{};
  std::vector<std::array<double, Pose::kSize>> poses_;
  std::vector<int> fixed_poses_;
  std::vector<Place> places_;  // places of all shared parameters
  std::vector<double*> free_blocks_;
  std::vector<int> free_intrinsics_;
  std::vector<RowOrigin> rows_;
  std::vector<Block> blocks_;
  std::vector<std::pair<int, ceres::ResidualBlockId>> feature_blocks_;  // with their frames
  std::vector<double*> blocks_of_others_;                               // further cameras of a rig
  std::shared_ptr<ceres::Problem> problem_;
};

}  // namespace plenocal
