#include "least_squares.hpp"

#include <algorithm>
#include <limits>
#include <numeric>
#include <string>
#include <utility>

#include "checks.hpp"

namespace plenocal {

LeastSquares::LeastSquares(const Camera& camera, const Board& board, const CostOptions& options,
                           std::shared_ptr<ceres::Problem> problem)
    : frame_(camera),
      board_(board),
      shape_is_free_(is_shape_free(options)),
      lens_(to_block(camera.main_lens)),
      exit_pupil_(to_block(camera.exit_pupil)),
      array_(to_block(camera.mla)),
      focal_lengths_(camera.micro_lens_focal_lengths),
      shape_(to_block(board.shape)),
      problem_(std::move(problem)) {}

LeastSquares::LeastSquares(const Camera& camera, const std::vector<Pose>& poses,
                           const Observations& observations, const CostOptions& options)
    : LeastSquares(camera, observations.board, options, std::make_shared<ceres::Problem>()) {
  validate_problem(camera, poses, observations, options);
  for (const Pose& pose : poses) poses_.push_back(pose_block(pose));
  add_residuals(observations, options, blocks().poses);
}

LeastSquares::LeastSquares(LeastSquares& first, const Pose& camera_from_first, const Camera& camera,
                           const Observations& observations, const CostOptions& options)
    : LeastSquares(camera, observations.board, options, first.problem_) {
  validate_camera_of_rig(camera, camera_from_first, first.poses_.size(), observations, options);
  if (shape_is_free_ || first.shape_is_free_) {
    reject("the shape of the board has to be known in a rig of cameras");
  }
  if (first.in_rig_) {
    reject("the first camera of a rig must not be a further camera of another rig");
  }
  in_rig_ = true;
  camera_from_first_ = pose_block(camera_from_first);
  problem_->AddParameterBlock(camera_from_first_.data(), Pose::kSize);
  add_residuals(observations, options, first.blocks().poses);
  for (auto [block, size] : shared_blocks()) first.blocks_of_others_.push_back(block);
  first.blocks_of_others_.push_back(camera_from_first_.data());
}

std::vector<std::pair<double*, int>> LeastSquares::shared_blocks() {
  std::vector<std::pair<double*, int>> blocks = {{lens_.data(), kMainLensParameters},
                                                 {exit_pupil_.data(), kExitPupilParameters},
                                                 {array_.data(), kArrayParameters}};
  if (!focal_lengths_.empty()) {
    blocks.emplace_back(focal_lengths_.data(), static_cast<int>(focal_lengths_.size()));
  }
  if (shape_is_free_) blocks.emplace_back(shape_.data(), kBoardShapeParameters);
  return blocks;
}

std::unique_ptr<ceres::Problem> LeastSquares::compressed(ParallelEvaluation* parallel) const {
  if (in_rig_ || !blocks_of_others_.empty()) {
    reject("a problem with few rows is not available for a rig");
  }
  ceres::Problem::Options options;
  options.manifold_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  options.evaluation_callback = parallel;
  auto result = std::make_unique<ceres::Problem>(options);
  for (const Block& block : blocks_) {
    Compressed* cost = plenocal::compressed(*block.cost).release();
    result->AddResidualBlock(cost, nullptr, block.parameters);
    if (parallel == nullptr) continue;
    std::vector<bool> constant;
    for (double* parameters : block.parameters) {
      constant.push_back(problem_->IsParameterBlockConstant(parameters));
    }
    parallel->add(cost, block.parameters, constant);
  }
  std::vector<double*> parameters;
  problem_->GetParameterBlocks(&parameters);
  for (double* block : parameters) {
    result->AddParameterBlock(block, problem_->ParameterBlockSize(block));
    if (problem_->IsParameterBlockConstant(block)) {
      result->SetParameterBlockConstant(block);
    } else if (problem_->HasManifold(block)) {
      result->SetManifold(block, const_cast<ceres::Manifold*>(problem_->GetManifold(block)));
    }
  }
  return result;
}

void LeastSquares::linearise(int index, Linearised* result) const {
  using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  const Block& block = blocks_[index];
  const int n = block.cost->num_residuals();
  const auto& sizes = block.cost->parameter_block_sizes();
  result->room.resize(static_cast<std::size_t>(n) * std::accumulate(sizes.begin(), sizes.end(), 0));
  std::vector<double*> parts;
  double* next = result->room.data();
  for (int size : sizes) {
    parts.push_back(next);
    next += static_cast<std::size_t>(n) * size;
  }
  result->first_row = block.first_row;
  result->residuals.resize(n);
  if (!block.cost->Evaluate(block.parameters.data(), result->residuals.data(), parts.data())) {
    throw std::invalid_argument(
        "the model is not defined at this camera and these poses: a board point lies within the "
        "focal length of the main lens");
  }
  const int free = static_cast<int>(free_intrinsics_.size());
  const bool has_pose = rows_[block.first_row].corner >= 0;
  result->jacobian.setZero(n, free + (has_pose ? Pose::kSize : 0));
  const bool is_fixed = has_pose && problem_->IsParameterBlockConstant(block.parameters.back());
  if (has_pose && !is_fixed) {
    result->jacobian.rightCols<Pose::kSize>() =
        Eigen::Map<const RowMajor>(parts.back(), n, Pose::kSize);
  }
  for (std::size_t i = 0; i < parts.size(); ++i) {
    std::vector<std::pair<int, int>> columns;  // columns of J, and of the part
    for (int column = 0; column < free; ++column) {
      const Place& place = places_[free_intrinsics_[column]];
      if (block.parameters[i] == place.block) columns.emplace_back(column, place.index);
    }
    for (int row = 0; row < n; ++row) {
      double* to = result->jacobian.row(row).data();
      const double* from = parts[i] + static_cast<std::size_t>(row) * sizes[i];
      for (const auto& [column, index] : columns) to[column] = from[index];
    }
  }
}

void LeastSquares::fix(const CostOptions& options) {
  const auto names = shared_names(frame_.lens_types());
  std::vector<char> fixed;
  for (const std::string& name : names) {
    fixed.push_back(options.fixed.count(name) > 0);
  }
  int first = 0;
  for (auto [block, size] : shared_blocks()) {
    std::vector<int> constant;
    for (int i = 0; i < size; ++i) {
      if (fixed[first + i]) {
        constant.push_back(i);
      } else {
        free_intrinsics_.push_back(first + i);
      }
    }
    if (static_cast<int>(constant.size()) == size) {
      problem_->SetParameterBlockConstant(block);
    } else {
      if (!constant.empty()) {
        problem_->SetManifold(block, new ceres::SubsetManifold(size, constant));
      }
      free_blocks_.push_back(block);
    }
    first += size;
  }
  for (std::size_t i = 0; i < poses_.size(); ++i) {
    const auto& list = options.fixed_poses;
    if (std::find(list.begin(), list.end(), static_cast<int>(i)) == list.end()) {
      free_blocks_.push_back(poses_[i].data());
    } else {
      problem_->SetParameterBlockConstant(poses_[i].data());
      fixed_poses_.push_back(static_cast<int>(i));
    }
  }
}

std::vector<double> LeastSquares::frame_costs() const {
  std::vector<double> costs(poses_.size(), 0.0);
  for (const auto& [frame, block] : feature_blocks_) {
    double cost = 0.0;
    if (!problem_->EvaluateResidualBlock(block, true, &cost, nullptr, nullptr)) {
      cost = std::numeric_limits<double>::infinity();
    }
    costs[frame] += cost;
  }
  return costs;
}

std::shared_ptr<ceres::ParameterBlockOrdering> LeastSquares::ordering() {
  auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  for (auto& pose : poses_) ordering->AddElementToGroup(pose.data(), 0);
  // Within a group Ceres orders blocks by their addresses, which change from run to run.
  int group = 1;
  for (auto [block, size] : shared_blocks()) ordering->AddElementToGroup(block, group++);
  for (double* block : blocks_of_others_) ordering->AddElementToGroup(block, group++);
  return ordering;
}

LeastSquares::Blocks LeastSquares::blocks() {
  Blocks blocks{lens_.data(),
                exit_pupil_.data(),
                array_.data(),
                focal_lengths_.empty() ? nullptr : focal_lengths_.data(),
                shape_is_free_ ? shape_.data() : nullptr,
                in_rig_ ? camera_from_first_.data() : nullptr,
                {}};
  for (auto& pose : poses_) blocks.poses.push_back(pose.data());
  return blocks;
}

std::vector<std::string> LeastSquares::names() const {
  const auto shared = shared_names(frame_.lens_types());
  std::vector<std::string> names;
  for (int index : free_intrinsics_) names.push_back(shared[index]);
  for (std::size_t i = 0; i < poses_.size(); ++i) {
    for (const char* part : {"r_x", "r_y", "r_z", "t_x", "t_y", "t_z"}) {
      names.push_back("pose " + std::to_string(i) + " " + part);
    }
  }
  return names;
}

Evaluation LeastSquares::evaluate() const {
  if (in_rig_) reject("a further camera of a rig cannot be evaluated separately");
  const int free = static_cast<int>(free_intrinsics_.size());
  Evaluation result;
  result.jacobian.num_rows = static_cast<int>(rows_.size());
  result.jacobian.num_cols = free + Pose::kSize * static_cast<int>(poses_.size());
  result.jacobian.rows = {0};
  result.gradient.assign(result.jacobian.num_cols, 0.0);
  Linearised block;
  for (int index = 0; index < residual_blocks(); ++index) {
    linearise(index, &block);
    const int pose = free + Pose::kSize * rows_[block.first_row].group;
    const auto& jacobian = block.jacobian;
    for (Eigen::Index row = 0; row < jacobian.rows(); ++row) {
      const double residual = block.residuals[row];
      result.residuals.push_back(residual);
      result.cost += 0.5 * residual * residual;
      for (int column = 0; column < jacobian.cols(); ++column) {
        const double entry = jacobian(row, column);
        if (entry == 0.0) continue;
        const int to = column < free ? column : pose + column - free;
        result.gradient[to] += entry * residual;
        result.jacobian.cols.push_back(to);
        result.jacobian.values.push_back(entry);
      }
      result.jacobian.rows.push_back(static_cast<int>(result.jacobian.values.size()));
    }
  }
  return result;
}

Eigen::VectorXd LeastSquares::state() const {
  std::size_t size = lens_.size() + exit_pupil_.size() + array_.size() + focal_lengths_.size() +
                     (shape_is_free_ ? shape_.size() : 0) + Pose::kSize * poses_.size();
  Eigen::VectorXd state(static_cast<Eigen::Index>(size));
  double* next = state.data();
  const auto append = [&next](const auto& block) {
    next = std::copy(block.begin(), block.end(), next);
  };
  append(lens_);
  append(exit_pupil_);
  append(array_);
  append(focal_lengths_);
  if (shape_is_free_) append(shape_);
  for (const auto& pose : poses_) append(pose);
  return state;
}

void LeastSquares::set_state(const Eigen::VectorXd& state) {
  const double* next = state.data();
  const auto take = [&next](auto& block) {
    std::copy_n(next, block.size(), block.begin());
    next += block.size();
  };
  take(lens_);
  take(exit_pupil_);
  take(array_);
  take(focal_lengths_);
  if (shape_is_free_) take(shape_);
  for (auto& pose : poses_) take(pose);
}

Camera LeastSquares::camera() const {
  Camera camera = frame_;
  camera.main_lens = from_block<MainLens>(lens_.data());
  camera.exit_pupil = from_block<ExitPupil>(exit_pupil_.data());
  camera.mla = from_block<MicroLensArray>(array_.data());
  camera.micro_lens_focal_lengths = focal_lengths_;
  return camera;
}

std::vector<Pose> LeastSquares::poses() const {
  std::vector<Pose> poses;
  for (const auto& block : poses_) poses.push_back(pose_from_block(block));
  return poses;
}

}  // namespace plenocal
