// The uncertainty of a refinement: against ceres::Covariance, and with parameters that are not
// determined.
#include <ceres/ceres.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "plenocal/refine.hpp"
#include "plenocal/residuals.hpp"
#include "synthetic_scene.hpp"

namespace plenocal {
namespace {

using test::expect_near_relative;
using test::largest_difference;
using test::paper;
using test::residuals;
using test::Scene;

// The scene with its free parameters moved by `step` times a row of `weakest`.
Scene moved(Scene scene, const Uncertainty& u, int row, double step) {
  const double* direction = &u.weakest.values[row * u.size];
  auto values = test::intrinsics(scene.camera);
  for (int index : u.free_intrinsics) values[index] += step * *direction++;
  scene.camera = test::with_intrinsics(scene.camera, values);
  for (Pose& pose : scene.poses) {
    auto block = pose_block(pose);
    for (double& value : block) value += step * *direction++;
    pose = pose_from_block(block);
  }
  return scene;
}

// |J v| of a row of `weakest` by central differences.
double sensitivity(const Scene& scene, const CostOptions& options, const Uncertainty& u, int row,
                   double step) {
  return (residuals(moved(scene, u, row, step), options) -
          residuals(moved(scene, u, row, -step), options))
             .norm() /
         (2.0 * step);
}

// A scene with noise of known size, at its minimum, with its uncertainty.
constexpr double kNoise[] = {0.1, 0.05, 0.02};  // px: u and v, rho, centres

class AtMinimum : public testing::Test {
 protected:
  static CostOptions weights(const std::array<double, 3>& std_devs) {
    CostOptions options = paper();
    options.uv_std_dev = std_devs[0];
    options.rho_std_dev = std_devs[1];
    options.centers_std_dev = std_devs[2];
    return options;
  }

  AtMinimum() : scene_(test::make_scene(3)), options_(weights({0.1, 0.05, 0.02})) {
    test::add_noise(kNoise[0], kNoise[1], kNoise[2], 21, &scene_.observations);
    const Refinement result =
        refine(scene_.camera, scene_.poses, scene_.observations, options_, {});
    EXPECT_EQ(result.termination, Termination::kConverged) << result.message;
    cost_ = result.cost;
    scene_.camera = result.camera;
    scene_.poses = result.poses;
  }

  Uncertainty at(const CostOptions& options) const {
    return uncertainty(scene_.camera, scene_.poses, scene_.observations, options);
  }

  // Weights with which the measured variances are 1: then the covariance is simply the inverse of
  // the information. The parameters do not change, so this is a fixed point in three numbers.
  CostOptions measured_weights() const {
    CostOptions options = options_;
    for (int i = 0; i < 10; ++i) {
      const auto factors = at(options).std_dev_factors;
      options.uv_std_dev *= factors[0];
      options.rho_std_dev *= factors[1];
      options.centers_std_dev *= factors[2];
    }
    return options;
  }

  Scene scene_;
  CostOptions options_;
  double cost_ = 0.0;
};

// Covariance of the same cost by Ceres, from a problem with one block per observation.
Eigen::MatrixXd ceres_covariance(const Scene& scene, const CostOptions& options) {
  auto lens = to_block(scene.camera.main_lens);
  auto pupil = to_block(scene.camera.exit_pupil);
  auto array = to_block(scene.camera.mla);
  auto focal_lengths = scene.camera.micro_lens_focal_lengths;
  std::vector<std::array<double, 6>> poses;
  for (const Pose& pose : scene.poses) poses.push_back(pose_block(pose));

  const Lattice& lattice = scene.camera.lattice;
  const double s = scene.camera.pixel_size;
  ceres::Problem problem;
  for (const FeatureObservation& o : scene.observations.features) {
    auto cost = FeatureResiduals<3>::create(
        {{o.board_point,
          micro_lens_of(scene.camera, o.k, o.l),
          o.observed,
          {1.0 / options.uv_std_dev, 1.0 / options.uv_std_dev, 1.0 / options.rho_std_dev}}},
        s, {});
    problem.AddResidualBlock(cost.release(), nullptr, lens.data(), array.data(),
                             focal_lengths.data(), poses[o.frame].data());
  }
  for (const CenterObservation& o : scene.observations.centers) {
    auto cost = CenterResiduals::create(
        {{lattice.node(o.k, o.l), o.observed, 1.0 / options.centers_std_dev}}, s, {});
    problem.AddResidualBlock(cost.release(), nullptr, lens.data(), pupil.data(), array.data());
  }
  problem.SetManifold(lens.data(),
                      new ceres::SubsetManifold(11, {4, 7, 8, 9, 10}));    // as in the paper
  problem.SetManifold(array.data(), new ceres::SubsetManifold(11, {10}));  // dC_ratio fixed
  problem.SetParameterBlockConstant(pupil.data());

  std::vector<const double*> blocks = {lens.data(), array.data(), focal_lengths.data()};
  for (const auto& pose : poses) blocks.push_back(pose.data());
  ceres::Covariance covariance{ceres::Covariance::Options()};
  EXPECT_TRUE(covariance.Compute(blocks, &problem));
  const int size = 6 + 10 + 3 + 6 * static_cast<int>(poses.size());
  Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> matrix(size, size);
  EXPECT_TRUE(covariance.GetCovarianceMatrixInTangentSpace(blocks, matrix.data()));
  return matrix;
}

Eigen::MatrixXd covariance_of(const Uncertainty& u) { return u.independent_covariance.eigen(); }

TEST_F(AtMinimum, ResidualStdDevIsTheInjectedNoise) {
  constexpr double kOfTheNoise = 0.1;  // at least 720 numbers: a scatter of 2.6 %
  const Uncertainty u = at(options_);
  for (int kind = 0; kind < 3; ++kind) {
    expect_near_relative(u.residual_std_dev[kind], kNoise[kind], kOfTheNoise, std::to_string(kind));
  }
  // ... and is measured in px, whatever the weights say; this is only nearly their minimum.
  const Uncertainty other = at(weights({1.0, 1.0, 1.0}));
  for (int kind = 0; kind < 3; ++kind) {
    expect_near_relative(other.residual_std_dev[kind], kNoise[kind], kOfTheNoise,
                         std::to_string(kind));
  }
}

TEST_F(AtMinimum, OwnStdDevsOfAKindAreAFactorOfTheKind) {
  // Powers of two: everything agrees to the last bit.
  const Uncertainty expected = at(weights({0.2, 0.2, 0.01}));
  for (FeatureObservation& o : scene_.observations.features) o.std_dev = {2.0, 2.0, 4.0};
  for (CenterObservation& o : scene_.observations.centers) o.std_dev = 0.5;
  const Uncertainty u = at(weights({0.1, 0.05, 0.02}));
  EXPECT_EQ(u.independent_covariance.values, expected.independent_covariance.values);
  for (int kind = 0; kind < 3; ++kind) {
    expect_near_relative(u.residual_std_dev[kind], expected.residual_std_dev[kind], 1e-12,
                         std::to_string(kind));
  }
}

TEST_F(AtMinimum, ResidualStdDevIsInPixelsWhateverTheOwnStdDevs) {
  // u and v have the same noise, but the stated noise of v is 7 times larger.
  constexpr double kOfTheNoise = 0.1;
  for (FeatureObservation& o : scene_.observations.features) o.std_dev.v = 7.0;
  expect_near_relative(at(options_).residual_std_dev[0], kNoise[0], kOfTheNoise, "u and v");
}

TEST_F(AtMinimum, CovarianceIsThatOfCeres) {
  // J'J is inverted by eigenvalues here, J by QR in Ceres: the error is the condition of J'J times
  // epsilon. Measured: 3e-6.
  constexpr double kConditioning = 1e-5;
  const CostOptions options = measured_weights();
  const Uncertainty u = at(options);
  ASSERT_EQ(u.rank, u.size);
  const Eigen::MatrixXd expected = ceres_covariance(scene_, options);
  EXPECT_LT(largest_difference(covariance_of(u), expected), kConditioning);
  const Eigen::VectorXd information = expected.inverse().diagonal();
  for (int i = 0; i < u.size; ++i) {
    expect_near_relative(u.information[i], information[i], kConditioning, std::to_string(i));
  }
}

TEST_F(AtMinimum, CovarianceWithTheKnownNoiseIsThatOfCeres) {
  // The variances are measured: twice the scatter with 720 centres, the worst of the three kinds.
  constexpr double kMeasuredVariance = 0.15;
  const Eigen::MatrixXd expected = ceres_covariance(scene_, options_);
  EXPECT_LT(largest_difference(covariance_of(at(options_)), expected), kMeasuredVariance);
  // Stated deviations that are a hundred times too large change nothing: the noise is measured.
  const CostOptions heavier = weights({10.0, 5.0, 2.0});
  EXPECT_LT(largest_difference(covariance_of(at(heavier)), expected), kMeasuredVariance);
}

TEST_F(AtMinimum, WeakestDirectionsSpanOneStandardDeviation) {
  // With variances of 1, one standard deviation along an eigenvector changes the residuals by 1.
  constexpr double kDifferences = 1e-4;
  // Few frames, so that errors are taken as independent.
  const auto in_few = [](const FeatureObservation& o) { return o.frame < 5; };
  auto& features = scene_.observations.features;
  features.erase(std::stable_partition(features.begin(), features.end(), in_few), features.end());
  scene_.poses.resize(5);
  const CostOptions options = measured_weights();
  const Uncertainty u = at(options);
  ASSERT_FALSE(u.shared);
  ASSERT_EQ(u.weakest.rows, Uncertainty::kWeakest);
  ASSERT_EQ(u.weakest.columns, u.size);
  for (int row = 0; row < Uncertainty::kWeakest; ++row) {
    EXPECT_NEAR(sensitivity(scene_, options, u, row, 0.01), 1.0, kDifferences) << row;
  }
}

TEST_F(AtMinimum, ExpectedDecreaseIsZeroHereAndTheExcessElsewhere) {
  // Relative to the cost: the limit of double precision, with a margin for the conditioning.
  constexpr double kFloor = 1e-12;
  EXPECT_LT(at(options_).expected_decrease, kFloor * cost_);
  // Off the minimum along the best determined direction, where the cost is quadratic.
  constexpr double kQuadratic = 0.01;
  Scene off = scene_;
  off.camera.mla.pitch *= 1.001;
  const double excess = 0.5 * residuals(off, options_).squaredNorm() - cost_;
  ASSERT_GT(excess, 100.0);
  const Uncertainty u = uncertainty(off.camera, off.poses, off.observations, options_);
  expect_near_relative(u.expected_decrease, excess, kQuadratic, "decrease");
}

void expect_finite(const Uncertainty& u) {
  const auto finite = [](double value) { return std::isfinite(value); };
  EXPECT_TRUE(u.covariance.eigen().allFinite());
  EXPECT_TRUE(std::all_of(u.information.begin(), u.information.end(), finite));
  EXPECT_TRUE(u.weakest.eigen().allFinite());
  EXPECT_TRUE(std::isfinite(u.residual_std_dev[0]));
  EXPECT_TRUE(std::isfinite(u.residual_std_dev[1]));
  EXPECT_TRUE(std::isfinite(u.expected_decrease));
  EXPECT_EQ(u.covariance.rows, u.size);
  EXPECT_EQ(u.covariance.columns, u.size);
  EXPECT_EQ(static_cast<int>(u.information.size()), u.size);
}

// |J v| of a unit of the scaled space, which would be near 1 if the direction were determined.
constexpr double kUnseen = 1e-5;

// One board parallel to an untilted array: all its images lie in one plane.
Scene fronto_parallel() {
  Scene scene{test::scene_camera(3), {{{0.0, 0.0, 0.0}, {0.1, -0.2, 300.0}}}, {}};
  scene.camera.mla.rotation = {0.0, 0.0, 0.0};
  scene.camera.main_lens.field_curvature = 0.0;
  scene.camera.main_lens.field_curvature_growth = 0.0;
  scene.camera.main_lens.rotation[0] = scene.camera.main_lens.rotation[1] = 0.0;
  scene.observations = test::observe(scene.camera, scene.poses);
  test::add_noise(0.1, 0.05, 0.02, 31, &scene.observations);
  return scene;
}

TEST(RankDeficiency, FrontoParallelBoardDoesNotSeparateFocalLengthFromDistance) {
  // Only the magnification m = F/(z - F) = 1/5 and a = D - m z are observable. m is constant if
  // dF/F = dz/z, and a if dD = m dz: the direction is (dF, dD, dz) = (1/6, 1/5, 1).
  constexpr double kParallel = 1e-6;
  const Scene scene = fronto_parallel();
  CostOptions options;
  for (const std::string& name : intrinsic_names(3)) {
    if (name != "F" && name != "D") options.fix({name});
  }
  Observations features_only{scene.observations.features, {}};
  const Uncertainty u = uncertainty(scene.camera, scene.poses, features_only, options);
  ASSERT_EQ(u.size, 2 + 6);
  EXPECT_EQ(u.rank, 7);
  expect_finite(u);
  ASSERT_NE(u.weakest(0, 7), 0.0);
  const double expected[] = {1.0 / 6.0, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0};
  for (int i = 0; i < 8; ++i) {
    EXPECT_NEAR(u.weakest(0, i) / u.weakest(0, 7), expected[i], kParallel) << i;
  }
}

TEST(RankDeficiency, OneBoardAndNoCentresLeaveFiveDirectionsUndetermined) {
  // At least five directions: the one above; a common scale of d, a and f_i; of the image against
  // the magnification; and a common shift of array and principal point along x and along y.
  constexpr int kOpen = 5;
  Scene scene = fronto_parallel();
  scene.observations.centers.clear();
  const CostOptions options = paper();
  const Uncertainty u = uncertainty(scene.camera, scene.poses, scene.observations, options);
  EXPECT_LE(u.rank, u.size - kOpen);
  EXPECT_GT(u.rank, 6);
  expect_finite(u);
  for (int row = 0; row < Uncertainty::kWeakest; ++row) {
    const Eigen::VectorXd v = u.weakest.eigen().row(row);
    const Eigen::Map<const Eigen::VectorXd> information(u.information.data(), u.size);
    EXPECT_NEAR(v.cwiseAbs2().dot(information), 1.0, kUnseen) << row;  // a unit, not zero
    EXPECT_LT(sensitivity(scene, options, u, row, 0.1), kUnseen) << row;
  }
}

TEST(RankDeficiency, RefineStaysFinite) {
  Scene scene = fronto_parallel();
  scene.observations.centers.clear();
  const Refinement result = refine(scene.camera, scene.poses, scene.observations, paper(), {});
  EXPECT_TRUE(std::isfinite(result.cost));
  EXPECT_LE(result.cost, result.initial_cost);
  for (double value : test::intrinsics(result.camera)) EXPECT_TRUE(std::isfinite(value));
}

constexpr int kF3 = 18;  // f_3 among the free intrinsics: after 6 + 10, f_1 and f_2

Scene without_third_type() {
  Scene scene = test::make_scene(3);
  auto& features = scene.observations.features;
  features.erase(std::remove_if(features.begin(), features.end(),
                                [&](const FeatureObservation& o) {
                                  return scene.camera.lattice.lens_type(o.k, o.l, 3) == 2;
                                }),
                 features.end());
  return scene;
}

TEST(RankDeficiency, UnobservedLensTypeIsFound) {
  const Scene scene = without_third_type();
  const Uncertainty u = uncertainty(scene.camera, scene.poses, scene.observations, paper());
  EXPECT_EQ(u.rank, u.size - 1);
  expect_finite(u);
  EXPECT_EQ(u.information[kF3], 0.0);
}

// Its direction is that of the parameter alone, not zero.
TEST(RankDeficiency, UnobservedLensTypeIsTheWeakestDirection) {
  const Scene scene = without_third_type();
  const Uncertainty u = uncertainty(scene.camera, scene.poses, scene.observations, paper());
  EXPECT_NE(u.weakest(0, kF3), 0.0);
  EXPECT_LT(sensitivity(scene, paper(), u, 0, 0.001), kUnseen);
}

}  // namespace
}  // namespace plenocal
