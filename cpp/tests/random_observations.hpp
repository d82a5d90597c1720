#pragma once

#include <gtest/gtest.h>

#include <random>
#include <vector>

#include "plenocal/residuals.hpp"
#include "synthetic_scene.hpp"

namespace plenocal::test {

// Random cameras, poses and observations about the synthetic scene.
class RandomObservations {
 public:
  explicit RandomObservations(unsigned seed) : generator_(seed) {}

  double uniform(double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(generator_);
  }

  // Each parameter varies by 1 %; Ridders' steps are relative, so none may be 0.
  Camera camera(int types) {
    auto values = intrinsics(scene_camera(types));
    for (double& value : values) value *= uniform(0.99, 1.01);
    return with_intrinsics(scene_camera(types), values);
  }

  // Nearer than 320 mm: there p' stays away from the MLA, where the model has its pole.
  Pose pose() {
    const auto angle = [this] { return uniform(0.1, 0.5) * (uniform(0, 1) < 0.5 ? -1 : 1); };
    return {{angle(), angle(), angle()}, {uniform(-2, -1), uniform(1, 2), uniform(250, 320)}};
  }

  // Residuals are alternately 0.2 to 0.3 sigma and 3 to 5 sigma: well on either side of the kink
  // of a Huber loss at 1, where finite differences would be wrong.
  std::vector<WeightedFeature> features(const Camera& camera, const Pose& pose, int count) {
    std::vector<WeightedFeature> features;
    for (int i = 0; i < count; ++i) {
      const int k = static_cast<int>(uniform(0, camera.lattice.columns));
      const int l = static_cast<int>(uniform(0, camera.lattice.rows));
      // Two consecutive features of every corner, as in a sorted problem.
      const auto corner = board_corner(pose, i / 2 % 6, i / 2 % 5);
      Feature<double> seen = project(camera, pose, corner, k, l).value();
      seen.u += offset(i);
      seen.v += offset(i);
      seen.rho += offset(i);
      features.push_back({corner, micro_lens_of(camera, k, l), seen, {1.0, 1.0, 1.1}});
    }
    return features;
  }

  std::vector<WeightedCenter> centers(const Camera& camera, int count) {
    std::vector<WeightedCenter> centers;
    for (int i = 0; i < count; ++i) {
      const int k = static_cast<int>(uniform(0, camera.lattice.columns));
      const int l = static_cast<int>(uniform(0, camera.lattice.rows));
      Pixel<double> seen = project_center(camera, k, l);
      seen.u += offset(i);
      seen.v += offset(i);
      centers.push_back({camera.lattice.node(k, l), seen, 1.0});
    }
    return centers;
  }

 private:
  double offset(int i) {
    return (i % 2 == 0 ? uniform(0.2, 0.3) : uniform(3, 5)) * (uniform(0, 1) < 0.5 ? -1 : 1);
  }

  std::mt19937 generator_;
};

}  // namespace plenocal::test
