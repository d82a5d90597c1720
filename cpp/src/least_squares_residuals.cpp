// Residuals of a problem.
#include <ceres/normal_prior.h>

#include <algorithm>
#include <numeric>
#include <string>

#include "checks.hpp"
#include "least_squares.hpp"

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

void LeastSquares::add_residuals(const Observations& observations, const CostOptions& options,
                                 const std::vector<double*>& poses) {
  for (auto [block, size] : shared_blocks()) {
    problem_->AddParameterBlock(block, size);
    for (int place = 0; place < size; ++place) places_.push_back({block, size, place});
  }
  for (auto& pose : poses_) problem_->AddParameterBlock(pose.data(), Pose::kSize);
  const auto add = [&](auto lens_types) {
    constexpr int kTypes = decltype(lens_types)::value;
    if (in_rig_) {
      add_features<kTypes, false, true>(observations, options, poses);
    } else if (shape_is_free_) {
      add_features<kTypes, true, false>(observations, options, poses);
    } else {
      add_features<kTypes, false, false>(observations, options, poses);
    }
  };
  switch (options.rho ? frame_.lens_types() : 0) {
    case 0:
      add(std::integral_constant<int, 0>());
      break;
    case 1:
      add(std::integral_constant<int, 1>());
      break;
    default:
      add(std::integral_constant<int, 3>());
  }
  add_centers(observations, options);
  fix(options);
  add_priors(options);
}

template <int I, bool Bent, bool InRig>
void LeastSquares::add_features(const Observations& observations, const CostOptions& options,
                                const std::vector<double*>& poses) {
  // Features are sorted by frame, then corner; the order within a corner is kept.
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
    auto cost = FeatureResiduals<I, Bent, InRig>::create(std::move(weighted), frame_.pixel_size,
                                                         options.features_loss, board_);
    std::vector<double*> blocks = {lens_.data(), array_.data()};
    if (I > 0) blocks.push_back(focal_lengths_.data());
    if (Bent) blocks.push_back(shape_.data());
    if (InRig) blocks.push_back(camera_from_first_.data());
    blocks.push_back(poses[frame]);
    feature_blocks_.emplace_back(frame, add_block(std::move(cost), std::move(blocks)));
  }
}

void LeastSquares::add_centers(const Observations& observations, const CostOptions& options) {
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
    add_block(std::move(cost), {lens_.data(), exit_pupil_.data(), array_.data()});
  }
}

ceres::ResidualBlockId LeastSquares::add_block(std::unique_ptr<ceres::CostFunction> cost,
                                               std::vector<double*> parameters) {
  const int first_row = static_cast<int>(rows_.size()) - cost->num_residuals();
  blocks_.push_back({cost.get(), parameters, first_row});
  return problem_->AddResidualBlock(cost.release(), nullptr, parameters);
}

bool LeastSquares::add_intercept(const Prior& prior, double weight) {
  for (int type = 0; type < frame_.lens_types(); ++type) {
    if (prior.quantity != intercept_name(type)) continue;
    add_block(frame_.lens_types() == 1 ? InterceptResidual<1>::create(type, prior.value, weight)
                                       : InterceptResidual<3>::create(type, prior.value, weight),
              {array_.data(), focal_lengths_.data()});
    return true;
  }
  return false;
}

bool LeastSquares::add_tilt_gradient(const Prior& prior, double weight) {
  const auto name = std::find(kTiltGradientNames.begin(), kTiltGradientNames.end(), prior.quantity);
  if (name == kTiltGradientNames.end()) return false;
  const int axis = static_cast<int>(name - kTiltGradientNames.begin());
  add_block(TiltGradientResidual::create(axis, prior.value, weight),
            {exit_pupil_.data(), array_.data()});
  return true;
}

void LeastSquares::add_priors(const CostOptions& options) {
  const double root = std::sqrt(options.prior_weight);
  const auto names = shared_names(frame_.lens_types());
  for (const Prior& prior : options.priors) {
    const int index = static_cast<int>(&prior - options.priors.data());
    rows_.push_back({kPrior, index, -1, prior.std_dev});
    const double weight = root / prior.std_dev;
    if (prior.quantity == kSlopeName) {
      add_block(SlopeResidual::create(prior.value, weight),
                {lens_.data(), exit_pupil_.data(), array_.data()});
      continue;
    }
    if (add_intercept(prior, weight) || add_tilt_gradient(prior, weight)) continue;
    const auto found = std::find(names.begin(), names.end(), prior.quantity);
    const auto [block, size, place] = places_[found - names.begin()];
    ceres::Matrix row = ceres::Matrix::Zero(1, size);
    row(0, place) = weight;
    add_block(std::make_unique<ceres::NormalPrior>(row, ceres::Vector::Constant(size, prior.value)),
              {block});
  }
}

}  // namespace plenocal
