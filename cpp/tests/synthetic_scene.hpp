// A small synthetic calibration made with plenocal::project, shared by the tests of the residuals
// and of the solver. Values are those of a Raytrix R12 with the array reduced to 20 x 18.
#pragma once

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <cmath>
#include <random>
#include <set>
#include <string>
#include <vector>

#include "plenocal/refine.hpp"

namespace plenocal::test {

constexpr int kBoardColumns = 6;
constexpr int kBoardRows = 5;

struct Scene {
  Camera camera;
  std::vector<Pose> poses;
  Observations observations;
};

/// All parameters differ from zero, so that the error of each can be relative. The distortion is
/// exaggerated because the image is only 2.5 mm wide.
inline Camera scene_camera(int types) {
  Camera camera;
  camera.lattice = {Packing::kHexagonalRowsEven, 20, 18};
  camera.pixel_size = 0.0055;
  camera.main_lens = {50.0, {0.02, -0.005, 0.002}, 0.01, {0.001, -0.002}, 0.004,
                      0.01, {0.006, -0.004}};
  camera.exit_pupil = {0.3, -0.2, -5.0, 0.1};
  camera.mla = {{231.5, 182.25}, 0.3186, {0.004, -0.003, 0.002}, {0.011, -0.007}, 56.6576,
                0.127505,        1.0};
  const std::vector<double> focal_lengths = {0.578154, 0.504456, 0.551667};
  camera.micro_lens_focal_lengths.assign(focal_lengths.begin(), focal_lengths.begin() + types);
  return camera;
}

/// Boards of about 10 mm that fill the image, tilted by up to 0.6 rad about different axes: depth
/// within a board separates the focal lengths from the distances.
inline std::vector<Pose> scene_poses() {
  return {{{0.5, 0.1, 0.05}, {-0.3, 0.2, 250.0}},  {{-0.4, 0.3, -0.1}, {0.4, -0.2, 275.0}},
          {{0.1, -0.6, 0.2}, {0.1, 0.4, 300.0}},   {{0.3, 0.5, 0.4}, {-0.5, -0.3, 325.0}},
          {{-0.5, -0.3, -0.3}, {0.3, 0.1, 350.0}}, {{0.2, 0.4, 0.1}, {-0.2, 0.5, 375.0}},
          {{-0.3, 0.2, 0.7}, {0.2, -0.4, 400.0}}};
}

/// Corner of a board centred on its pose; its squares fill the image at the board's distance.
inline Vector3<double> board_corner(const Pose& pose, int column, int row) {
  const double square = 0.0065 * pose.translation.z;
  return {square * (column - (kBoardColumns - 1) / 2.0), square * (row - (kBoardRows - 1) / 2.0),
          0.0};
}

/// Every corner in every micro-image that shows it, and every centre.
inline Observations observe(const Camera& camera, const std::vector<Pose>& poses) {
  Observations observations;
  const double micro_image_radius = 0.45 * camera.mla.pitch / camera.pixel_size;
  for (int l = 0; l < camera.lattice.rows; ++l) {
    for (int k = 0; k < camera.lattice.columns; ++k) {
      const Pixel<double> center = project_center(camera, k, l);
      observations.centers.push_back({k, l, center, 1.0});
      for (std::size_t frame = 0; frame < poses.size(); ++frame) {
        for (int i = 0; i < kBoardColumns * kBoardRows; ++i) {
          const auto corner = board_corner(poses[frame], i % kBoardColumns, i / kBoardColumns);
          const auto feature = project(camera, poses[frame], corner, k, l);
          if (feature &&
              std::hypot(feature->u - center.u, feature->v - center.v) < micro_image_radius) {
            observations.features.push_back(
                {static_cast<int>(frame), corner, k, l, *feature, {1.0, 1.0, 1.0}});
          }
        }
      }
    }
  }
  return observations;
}

inline Scene make_scene(int types) {
  Scene scene{scene_camera(types), scene_poses(), {}};
  scene.observations = observe(scene.camera, scene.poses);
  return scene;
}

/// Gaussian noise on all observations, px.
inline void add_noise(double uv, double rho, double centers, unsigned seed,
                      Observations* observations) {
  std::mt19937 generator(seed);
  std::normal_distribution<double> normal;
  for (FeatureObservation& o : observations->features) {
    o.observed.u += uv * normal(generator);
    o.observed.v += uv * normal(generator);
    o.observed.rho += rho * normal(generator);
  }
  for (CenterObservation& o : observations->centers) {
    o.observed.u += centers * normal(generator);
    o.observed.v += centers * normal(generator);
  }
}

/// Intrinsics in the order of `intrinsic_names`, and back.
inline std::vector<double> intrinsics(const Camera& camera) {
  std::vector<double> values;
  for_each_parameter(camera, [&](const std::string&, double value) { values.push_back(value); });
  return values;
}
inline Camera with_intrinsics(Camera camera, const std::vector<double>& values) {
  const double* next = values.data();
  for_each_parameter(camera, [&](const std::string&, double& value) { value = *next++; });
  return camera;
}

/// Parameters of the board's shape.
inline const std::vector<std::string> kShape = {"sag_x", "sag_y", "twist", "aspect"};

/// These parameters, and those of the board.
inline std::set<std::string> with_shape(std::set<std::string> names) {
  names.insert(kShape.begin(), kShape.end());
  return names;
}

/// Parameters that the paper's model does not have.
inline const std::set<std::string> kBeyondThePaper = with_shape(
    {"Q1_m", "kappa", "kappa_m", "omega_x", "omega_y", "e_x", "e_y", "e_z", "e_r", "dC_ratio"});

/// Only what is free in the paper's model is.
inline CostOptions paper() {
  CostOptions options;
  options.fixed = kBeyondThePaper;
  return options;
}

/// Standardised residuals, without a loss, straight from the public projection.
inline Eigen::VectorXd residuals(const Scene& scene, const CostOptions& options) {
  const bool blur = scene.camera.lens_types() > 0;
  std::vector<double> values;
  for (const FeatureObservation& o : scene.observations.features) {
    const Feature<double> f =
        project(scene.camera, scene.poses[o.frame], o.board_point, o.k, o.l).value();
    values.push_back((f.u - o.observed.u) / (o.std_dev.u * options.uv_std_dev));
    values.push_back((f.v - o.observed.v) / (o.std_dev.v * options.uv_std_dev));
    if (blur) {
      values.push_back((f.rho - o.observed.rho) / (o.std_dev.rho * options.rho_std_dev));
    }
  }
  for (const CenterObservation& o : scene.observations.centers) {
    const Pixel<double> p = project_center(scene.camera, o.k, o.l);
    values.push_back((p.u - o.observed.u) / (o.std_dev * options.centers_std_dev));
    values.push_back((p.v - o.observed.v) / (o.std_dev * options.centers_std_dev));
  }
  return Eigen::Map<Eigen::VectorXd>(values.data(), values.size());
}

inline void expect_near_relative(double actual, double expected, double tolerance,
                                 const std::string& name) {
  EXPECT_NEAR(actual, expected, tolerance * std::abs(expected)) << name;
}

/// The largest difference of two covariances in units of the standard deviations involved.
inline double largest_difference(const Eigen::MatrixXd& a, const Eigen::MatrixXd& expected) {
  const Eigen::VectorXd scale = expected.diagonal().cwiseSqrt().cwiseInverse();
  return (scale.asDiagonal() * (a - expected) * scale.asDiagonal()).cwiseAbs().maxCoeff();
}

}  // namespace plenocal::test
