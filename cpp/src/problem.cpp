#include "problem.hpp"

#include <ceres/normal_prior.h>

#include <algorithm>
#include <limits>
#include <numeric>
#include <string>

#include "checks.hpp"

namespace plenocal {
namespace {

// Number of observations in a residual block. Larger blocks share more work and make the Schur
// complement cheaper; smaller ones divide better between threads.
constexpr std::size_t kFeaturesPerBlock = 256;
constexpr std::size_t kCentersPerBlock = 256;

// Divides the area of the centres into equal patches.
class Patches {
 public:
  explicit Patches(const std::vector<CenterObservation>& centers) {
    for (const CenterObservation& o : centers) {
      low_ = {std::min(low_.u, o.observed.u), std::min(low_.v, o.observed.v)};
      high_ = {std::max(high_.u, o.observed.u), std::max(high_.v, o.observed.v)};
    }
  }
  int of(const Pixel<double>& pixel) const {
    const auto cell = [](double value, double low, double high, int count) {
      const double part = high > low ? (value - low) / (high - low) : 0.0;
      return std::min(static_cast<int>(part * count), count - 1);
    };
    return cell(pixel.u, low_.u, high_.u, kPatchColumns) +
           kPatchColumns * cell(pixel.v, low_.v, high_.v, kPatchRows);
  }

 private:
  Pixel<double> low_{HUGE_VAL, HUGE_VAL};
  Pixel<double> high_{-HUGE_VAL, -HUGE_VAL};
};

}  // namespace

CalibrationProblem::CalibrationProblem(const Camera& camera, const std::vector<Pose>& poses,
                                       const Observations& observations, const CostOptions& options)
    : frame_(camera),
      board_(observations.board),
      shape_is_free_(is_shape_free(options)),
      lens_(to_block(camera.main_lens)),
      exit_pupil_(to_block(camera.exit_pupil)),
      array_(to_block(camera.mla)),
      focal_lengths_(camera.micro_lens_focal_lengths),
      shape_(to_block(observations.board.shape)) {
  validate_problem(camera, poses, observations, options);
  for (const Pose& pose : poses) poses_.push_back(pose_block(pose));

  problem_ = std::make_unique<ceres::Problem>();
  for (auto [block, size] : shared_blocks()) {
    problem_->AddParameterBlock(block, size);
    for (int place = 0; place < size; ++place) places_.push_back({block, size, place});
  }
  for (auto& pose : poses_) problem_->AddParameterBlock(pose.data(), Pose::kSize);
  switch (options.rho ? camera.lens_types() : 0) {
    case 0:
      shape_is_free_ ? add_features<0, true>(observations, options)
                     : add_features<0, false>(observations, options);
      break;
    case 1:
      shape_is_free_ ? add_features<1, true>(observations, options)
                     : add_features<1, false>(observations, options);
      break;
    default:
      shape_is_free_ ? add_features<3, true>(observations, options)
                     : add_features<3, false>(observations, options);
  }
  add_centers(observations, options);
  fix(options);
  add_anchors(options);
  for (auto& pose : poses_) free_blocks_.push_back(pose.data());
}

std::vector<std::pair<double*, int>> CalibrationProblem::shared_blocks() {
  std::vector<std::pair<double*, int>> blocks = {{lens_.data(), kMainLensParameters},
                                                 {exit_pupil_.data(), kExitPupilParameters},
                                                 {array_.data(), kArrayParameters}};
  if (!focal_lengths_.empty()) {
    blocks.emplace_back(focal_lengths_.data(), static_cast<int>(focal_lengths_.size()));
  }
  if (shape_is_free_) blocks.emplace_back(shape_.data(), kBoardShapeParameters);
  return blocks;
}

template <int I, bool Bent>
void CalibrationProblem::add_features(const Observations& observations,
                                      const CostOptions& options) {
  // Sorted by frame, then corner; the order within a corner is kept.
  const auto& features = observations.features;
  const auto frame_and_corner = [&features](std::size_t i) {
    const FeatureObservation& o = features[i];
    return std::tie(o.frame, o.board_point.x, o.board_point.y, o.board_point.z);
  };
  std::vector<std::size_t> order(features.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    return frame_and_corner(a) < frame_and_corner(b);
  });
  int corner = -1;
  for (std::size_t begin = 0; begin < order.size();) {
    const int frame = features[order[begin]].frame;
    std::vector<WeightedFeature> weighted;
    for (; begin < order.size() && features[order[begin]].frame == frame &&
           weighted.size() < kFeaturesPerBlock;
         ++begin) {
      if (begin == 0 || frame_and_corner(order[begin]) != frame_and_corner(order[begin - 1])) {
        ++corner;
      }
      const FeatureObservation& o = features[order[begin]];
      const int lens_type = frame_.lattice.lens_type(o.k, o.l, frame_.lens_types());
      const Feature<double> std_dev{o.std_dev.u * options.uv_std_dev,
                                    o.std_dev.v * options.uv_std_dev,
                                    o.std_dev.rho * options.rho_std_dev};
      weighted.push_back({Bent ? o.board_point : corner_of(board_, o.board_point),
                          {frame_.lattice.node(o.k, o.l), lens_type},
                          o.observed,
                          {1.0 / std_dev.u, 1.0 / std_dev.v, 1.0 / std_dev.rho}});
      const int index = static_cast<int>(order[begin]);
      rows_.push_back({kUv, frame, corner, std_dev.u, index});
      rows_.push_back({kUv, frame, corner, std_dev.v, index});
      if (I > 0) rows_.push_back({kRho, frame, corner, std_dev.rho, index});
    }
    auto cost = FeatureResiduals<I, Bent>::create(std::move(weighted), frame_.pixel_size,
                                                  options.features_loss, board_);
    std::vector<double*> blocks = {lens_.data(), array_.data()};
    if (I > 0) blocks.push_back(focal_lengths_.data());
    if (Bent) blocks.push_back(shape_.data());
    blocks.push_back(poses_[frame].data());
    feature_blocks_.emplace_back(frame, add_block(std::move(cost), std::move(blocks)));
  }
}

void CalibrationProblem::add_centers(const Observations& observations, const CostOptions& options) {
  const auto& centers = observations.centers;
  const Patches patches(centers);
  for (std::size_t begin = 0; begin < centers.size(); begin += kCentersPerBlock) {
    const std::size_t end = std::min(begin + kCentersPerBlock, centers.size());
    std::vector<WeightedCenter> weighted;
    for (std::size_t i = begin; i < end; ++i) {
      const CenterObservation& o = centers[i];
      const double std_dev = o.std_dev * options.centers_std_dev;
      weighted.push_back({frame_.lattice.node(o.k, o.l), o.observed, 1.0 / std_dev});
      rows_.insert(rows_.end(), 2,
                   {kCenter, patches.of(o.observed), -1, std_dev, static_cast<int>(i)});
    }
    auto cost =
        CenterResiduals::create(std::move(weighted), frame_.pixel_size, options.centers_loss);
    add_block(std::move(cost), {exit_pupil_.data(), array_.data()});
  }
}

ceres::ResidualBlockId CalibrationProblem::add_block(std::unique_ptr<ceres::CostFunction> cost,
                                                     std::vector<double*> parameters) {
  blocks_.push_back({cost.get(), parameters});
  return problem_->AddResidualBlock(cost.release(), nullptr, parameters);
}

CalibrationProblem::Linearised CalibrationProblem::linearised(const Block& block,
                                                              int first_row) const {
  using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  const int n = block.cost->num_residuals();
  const auto& sizes = block.cost->parameter_block_sizes();
  std::vector<RowMajor> parts;
  for (int size : sizes) parts.emplace_back(n, size);
  std::vector<double*> pointers;
  for (RowMajor& part : parts) pointers.push_back(part.data());
  const int free = static_cast<int>(free_intrinsics_.size());
  const bool has_pose = rows_[first_row].corner >= 0;
  Linearised result{first_row, Eigen::VectorXd(n),
                    Eigen::MatrixXd::Zero(n, free + (has_pose ? Pose::kSize : 0))};
  if (!block.cost->Evaluate(block.parameters.data(), result.residuals.data(), pointers.data())) {
    throw std::invalid_argument(
        "the model is not defined at this camera and these poses: a board point lies within the "
        "focal length of the main lens");
  }
  if (has_pose) result.jacobian.rightCols<Pose::kSize>() = parts.back();
  int column = 0;
  for (int index : free_intrinsics_) {
    const auto [values, size, place] = places_[index];
    for (std::size_t i = 0; i < parts.size(); ++i) {
      if (block.parameters[i] == values) result.jacobian.col(column) = parts[i].col(place);
    }
    ++column;
  }
  return result;
}

bool CalibrationProblem::add_intercept(const Anchor& anchor, double weight) {
  for (int type = 0; type < frame_.lens_types(); ++type) {
    if (anchor.quantity != intercept_name(type)) continue;
    add_block(frame_.lens_types() == 1 ? InterceptResidual<1>::create(type, anchor.value, weight)
                                       : InterceptResidual<3>::create(type, anchor.value, weight),
              {array_.data(), focal_lengths_.data()});
    return true;
  }
  return false;
}

bool CalibrationProblem::add_lean(const Anchor& anchor, double weight) {
  const auto name = std::find(kLeanNames.begin(), kLeanNames.end(), anchor.quantity);
  if (name == kLeanNames.end()) return false;
  const int axis = static_cast<int>(name - kLeanNames.begin());
  add_block(LeanResidual::create(axis, anchor.value, weight), {exit_pupil_.data(), array_.data()});
  return true;
}

void CalibrationProblem::add_anchors(const CostOptions& options) {
  const double root = std::sqrt(options.anchor_weight);
  const auto names = shared_names(frame_.lens_types());
  for (const Anchor& anchor : options.anchors) {
    const int index = static_cast<int>(&anchor - options.anchors.data());
    rows_.push_back({kAnchor, index, -1, anchor.std_dev});
    const double weight = root / anchor.std_dev;
    if (anchor.quantity == kSlopeName) {
      add_block(SlopeResidual::create(anchor.value, weight),
                {lens_.data(), exit_pupil_.data(), array_.data()});
      continue;
    }
    if (add_intercept(anchor, weight) || add_lean(anchor, weight)) continue;
    const auto found = std::find(names.begin(), names.end(), anchor.quantity);
    const auto [block, size, place] = places_[found - names.begin()];
    ceres::Matrix row = ceres::Matrix::Zero(1, size);
    row(0, place) = weight;
    add_block(
        std::make_unique<ceres::NormalPrior>(row, ceres::Vector::Constant(size, anchor.value)),
        {block});
  }
}

void CalibrationProblem::fix(const CostOptions& options) {
  const auto names = shared_names(frame_.lens_types());
  std::vector<char> fixed(names.size(), 0);
  for (const std::string& name : options.fixed) {
    const auto found = std::find(names.begin(), names.end(), name);
    if (found == names.end()) reject("there is no parameter " + name + " to fix");
    fixed[found - names.begin()] = 1;
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
}

std::vector<double> CalibrationProblem::frame_costs() const {
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

std::shared_ptr<ceres::ParameterBlockOrdering> CalibrationProblem::ordering() {
  auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  for (auto& pose : poses_) ordering->AddElementToGroup(pose.data(), 0);
  // Within a group Ceres orders blocks by their addresses, which change from run to run.
  int group = 1;
  for (auto [block, size] : shared_blocks()) ordering->AddElementToGroup(block, group++);
  return ordering;
}

Eigen::VectorXd CalibrationProblem::state() const {
  Eigen::VectorXd state(problem_->NumParameters());
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

void CalibrationProblem::set_state(const Eigen::VectorXd& state) {
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

Camera CalibrationProblem::camera() const {
  Camera camera = frame_;
  camera.main_lens = from_block<MainLens>(lens_.data());
  camera.exit_pupil = from_block<ExitPupil>(exit_pupil_.data());
  camera.mla = from_block<MicroLensArray>(array_.data());
  camera.micro_lens_focal_lengths = focal_lengths_;
  return camera;
}

std::vector<Pose> CalibrationProblem::poses() const {
  std::vector<Pose> poses;
  for (const auto& block : poses_) poses.push_back(pose_from_block(block));
  return poses;
}

}  // namespace plenocal
