#include "checks.hpp"

#include <algorithm>

namespace plenocal {
namespace {

bool contains(const std::vector<std::string>& names, const std::string& name) {
  return std::find(names.begin(), names.end(), name) != names.end();
}

std::string micro_lens_text(int k, int l) {
  return "micro-lens (" + std::to_string(k) + ", " + std::to_string(l) + ")";
}

void require_inside(const Lattice& lattice, int k, int l) {
  if (!lattice.contains(k, l)) {
    reject(micro_lens_text(k, l) + " is outside the array of " + std::to_string(lattice.columns) +
           " x " + std::to_string(lattice.rows));
  }
}

void require_loss(const Loss& loss) {
  if (!is_positive(loss.scale)) {
    reject("the scale of the robust loss has to be positive and finite");
  }
}

std::string feature_text(const FeatureObservation& o) {
  return "the feature of " + micro_lens_text(o.k, o.l) + " in frame " + std::to_string(o.frame);
}

void require_feature(const FeatureObservation& o, const Lattice& lattice, bool has_rho,
                     std::size_t poses) {
  require_inside(lattice, o.k, o.l);
  if (o.frame < 0 || o.frame >= static_cast<int>(poses)) {
    reject("a feature belongs to frame " + std::to_string(o.frame) + ", which has no pose");
  }
  const auto& [x, y, z] = o.board_point;
  if (!std::isfinite(x) || !std::isfinite(y) || !std::isfinite(z)) {
    reject("a board point is not finite");
  }
  const auto& [u, v, rho] = o.observed;
  if (!std::isfinite(u) || !std::isfinite(v) || (has_rho && !std::isfinite(rho))) {
    reject(feature_text(o) + " is not finite");
  }
  if (!is_positive(o.std_dev.u) || !is_positive(o.std_dev.v) ||
      (has_rho && !is_positive(o.std_dev.rho))) {
    require_std_dev(0.0, feature_text(o));
  }
}

void require_center(const CenterObservation& o, const Lattice& lattice) {
  require_inside(lattice, o.k, o.l);
  const std::string text = "the centre of " + micro_lens_text(o.k, o.l);
  if (!std::isfinite(o.observed.u) || !std::isfinite(o.observed.v)) {
    reject(text + " is not finite");
  }
  require_std_dev(o.std_dev, text);
}

void require_prior(const Prior& prior, int lens_types, const std::set<std::string>& fixed) {
  const auto names = shared_names(lens_types);
  const std::string text = "the prior of " + prior.quantity;
  if (!std::isfinite(prior.value)) reject(text + " is not finite");
  require_std_dev(prior.std_dev, text);
  const auto is_fixed = [&fixed](const std::string& name) { return fixed.count(name) > 0; };
  if (prior.quantity == kSlopeName) {
    if (is_fixed("F") && is_fixed("d") && is_fixed("D") && is_fixed("e_z")) {
      reject(text + " has no effect: F, d, D and e_z are fixed");
    }
    return;
  }
  for (int type = 0; type < lens_types; ++type) {
    if (prior.quantity != intercept_name(type)) continue;
    if (is_fixed("f_" + std::to_string(type + 1)) && is_fixed("d") && is_fixed("dC")) {
      reject(text + " has no effect: the focal length, d and dC are fixed");
    }
    return;
  }
  if (std::find(kTiltGradientNames.begin(), kTiltGradientNames.end(), prior.quantity) !=
      kTiltGradientNames.end()) {
    if (is_fixed("theta_x") && is_fixed("theta_y") && is_fixed("d")) {
      reject(text + " has no effect: theta_x, theta_y and d are fixed");
    }
    return;
  }
  if (!contains(names, prior.quantity)) {
    reject("there is no parameter " + prior.quantity + " for a prior");
  }
  if (is_fixed(prior.quantity)) reject(text + " has no effect: the parameter is fixed");
}

}  // namespace

void CostOptions::fix(const std::vector<std::string>& names) {
  fixed.insert(names.begin(), names.end());
}

void CostOptions::free(const std::vector<std::string>& names) {
  for (const std::string& name : names) {
    if (fixed.erase(name) == 0) reject("the parameter " + name + " is not fixed");
  }
}

bool is_shape_free(const CostOptions& options) {
  return std::any_of(
      kBoardShapeTable, std::end(kParameters),
      [&options](const Parameter& parameter) { return options.fixed.count(parameter.name) == 0; });
}

namespace {

void require_pose(const Pose& pose, const std::string& name) {
  for (double value : pose_block(pose)) {
    if (!std::isfinite(value)) reject(name + " is not finite");
  }
}

// Checks everything except the poses.
void require_camera_and_observations(const Camera& camera, std::size_t poses,
                                     const Observations& observations, const CostOptions& options) {
  validate(camera);
  validate(observations.board);
  const auto names = shared_names(camera.lens_types());
  for (const std::string& name : options.fixed) {
    if (!contains(names, name)) reject("there is no parameter " + name + " to fix");
  }
  if (is_shape_free(options)) require_size(observations.board);
  require_std_dev(options.uv_std_dev, "(u, v)");
  require_std_dev(options.rho_std_dev, "rho");
  require_std_dev(options.centers_std_dev, "the centres");
  require_loss(options.features_loss);
  require_loss(options.centers_loss);
  if (!is_positive(options.prior_weight)) reject("the weight of the priors has to be positive");
  for (const Prior& prior : options.priors) {
    require_prior(prior, camera.lens_types(), options.fixed);
  }
  for (int pose : options.fixed_poses) {
    if (pose < 0 || pose >= static_cast<int>(poses)) {
      reject("there is no pose " + std::to_string(pose) + " to fix");
    }
  }
  for (const FeatureObservation& o : observations.features) {
    require_feature(o, camera.lattice, options.rho && camera.lens_types() > 0, poses);
  }
  for (const CenterObservation& o : observations.centers) require_center(o, camera.lattice);
}

}  // namespace

void validate_problem(const Camera& camera, const std::vector<Pose>& poses,
                      const Observations& observations, const CostOptions& options) {
  if (poses.empty()) reject("there are no frames");
  for (std::size_t i = 0; i < poses.size(); ++i) {
    require_pose(poses[i], "pose " + std::to_string(i));
  }
  require_camera_and_observations(camera, poses.size(), observations, options);
  std::vector<char> seen(poses.size(), 0);
  for (const FeatureObservation& o : observations.features) seen[o.frame] = 1;
  const auto unseen = std::find(seen.begin(), seen.end(), 0);
  if (unseen != seen.end()) {
    reject("pose " + std::to_string(unseen - seen.begin()) + " has no feature");
  }
}

void validate_camera_of_rig(const Camera& camera, const Pose& camera_from_first, std::size_t poses,
                            const Observations& observations, const CostOptions& options) {
  require_pose(camera_from_first, "camera_from_first");
  require_camera_and_observations(camera, poses, observations, options);
  if (observations.features.empty()) reject("a camera of a rig has no feature");
  if (!options.fixed_poses.empty()) reject("in a rig, poses are fixed in the first camera");
}

}  // namespace plenocal
