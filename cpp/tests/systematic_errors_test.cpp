// Errors that many features share with priors, in the covariance.
#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <utility>
#include <vector>

#include "rejection.hpp"
#include "synthetic_scene.hpp"

namespace plenocal {
namespace {

using test::expect_names;
using test::paper;
using test::rejection;
using test::Scene;

// The change that uncertainty() foresees is that of a refinement with the observations, and the
// prior, moved.
TEST(SystematicErrors, ChangeParametersAsMovedObservationsDo) {
  constexpr double kStep = 1e-5, kTolerance = 0.02;
  const Scene scene = test::make_scene(3);
  CostOptions options = paper();
  options.priors = {{"F", scene.camera.main_lens.focal_length, 0.05}};
  options.prior_weight = 4.0;
  SystematicError error;
  for (const FeatureObservation& o : scene.observations.features) {
    error.features.push_back({kStep * (o.k - 20), kStep * o.frame, kStep});
  }
  for (const CenterObservation& o : scene.observations.centers) {
    error.centers.push_back({kStep * o.k, -kStep * o.l});
  }
  error.priors = {kStep};
  const Uncertainty without = uncertainty(scene.camera, scene.poses, scene.observations, options);
  const Uncertainty u =
      uncertainty(scene.camera, scene.poses, scene.observations, options, {error});

  Scene moved = scene;
  for (std::size_t i = 0; i < error.features.size(); ++i) {
    auto& observed = moved.observations.features[i].observed;
    observed.u += error.features[i].u;
    observed.v += error.features[i].v;
    observed.rho += error.features[i].rho;
  }
  for (std::size_t i = 0; i < error.centers.size(); ++i) {
    moved.observations.centers[i].observed.u += error.centers[i].u;
    moved.observations.centers[i].observed.v += error.centers[i].v;
  }
  CostOptions moved_options = options;
  moved_options.priors[0].value += error.priors[0] * options.priors[0].std_dev;
  const Refinement r = refine(moved.camera, moved.poses, moved.observations, moved_options, {});
  const auto before = test::intrinsics(scene.camera), after = test::intrinsics(r.camera);
  for (int i = 0; i < static_cast<int>(u.free_intrinsics.size()); ++i) {
    const int index = u.free_intrinsics[i];
    const double change = after[index] - before[index];
    const double std_dev = std::sqrt(without.independent_covariance(i, i));
    EXPECT_NEAR(u.systematic_changes(0, i), change, kTolerance * std::abs(change) + 1e-3 * std_dev)
        << index;
    EXPECT_GE(u.independent_covariance(i, i), without.independent_covariance(i, i) +
                                                  0.9 * change * change - 1e-6 * std_dev * std_dev)
        << index;
    // With so few frames, the covariance has no other parts.
    const double by_error = u.systematic_changes(0, i) * u.systematic_changes(0, i);
    const double sum = u.noise_covariance(i, i) + u.prior_covariance(i, i) + by_error;
    EXPECT_NEAR(u.covariance(i, i), sum, 1e-9 * sum) << index;
  }
  error.centers.pop_back();
  expect_names(rejection([&] {
                 uncertainty(scene.camera, scene.poses, scene.observations, options, {error});
               }),
               "systematic error");
}

// A prior's own error is in the covariance already; one of something else that moves it is not.
TEST(SystematicErrors, CountOnceWherePriorsContainThem) {
  const Scene scene = test::make_scene(3);
  CostOptions options = paper();
  options.priors = {{"F", scene.camera.main_lens.focal_length, 0.05}};
  SystematicError error;
  error.features.resize(scene.observations.features.size());
  error.priors = {1.0};
  const auto variances = [&](const std::vector<SystematicError>& errors) {
    const Uncertainty u =
        uncertainty(scene.camera, scene.poses, scene.observations, options, errors);
    std::vector<double> diagonal;
    for (int i = 0; i < static_cast<int>(u.free_intrinsics.size()); ++i) {
      diagonal.push_back(u.independent_covariance(i, i));
    }
    return std::make_pair(diagonal, u.systematic_changes.values);
  };
  const auto without = variances({}).first;
  const auto contained = variances({error}).first;
  error.in_priors = false;
  const auto [added, changes] = variances({error});
  for (std::size_t i = 0; i < without.size(); ++i) {
    EXPECT_NEAR(contained[i], without[i], 1e-9 * without[i]);
    const double of_error = changes[i] * changes[i];
    EXPECT_NEAR(added[i] - without[i], of_error, 0.02 * of_error + 1e-9 * without[i]);
  }
  EXPECT_GT(added[0], 1.0001 * without[0]);
}

// Two priors whose errors are one and the same say less than two that differ: the covariance is
// that of both moved at once.
TEST(SystematicErrors, AreNotAveragedAwayByPriorsThatShareThem) {
  const Scene scene = test::make_scene(3);
  CostOptions options = paper();
  const double f = scene.camera.main_lens.focal_length;
  options.priors = {{"F", f, 1e-3}, {"F", f, 1e-3}};
  SystematicError error;
  error.features.resize(scene.observations.features.size());
  const auto std_dev = [&](const std::vector<double>& priors) {
    error.priors = priors;
    const Uncertainty u =
        uncertainty(scene.camera, scene.poses, scene.observations, options, {error});
    return std::sqrt(u.independent_covariance(0, 0));
  };
  const double apart = std_dev({1.0, 0.0}), half = std_dev({0.5, 0.5}), whole = std_dev({1.0, 1.0});
  EXPECT_NEAR(whole / apart, std::sqrt(2.0), 0.02);
  EXPECT_NEAR(half / apart, std::sqrt(1.25), 0.02);
}

}  // namespace
}  // namespace plenocal
