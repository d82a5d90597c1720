// The sensitivity of a reconstructed point, worked out by hand and against reconstructions with
// other cameras and with noise.
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <functional>
#include <limits>
#include <random>

#include "plenocal/points.hpp"
#include "rejection.hpp"
#include "simple_camera.hpp"
#include "synthetic_scene.hpp"

namespace plenocal {
namespace {

using test::expect_names;
using test::largest_difference;
using test::rejection;
using test::simple_camera;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInfinity = std::numeric_limits<double>::infinity();

// The model is differentiated numerically and a point found by Gauss-Newton, as a calibrated camera
// would.
using Function = std::function<Eigen::VectorXd(const Eigen::VectorXd&)>;

// Central differences, with steps that change the function by about `change`.
Eigen::MatrixXd derivatives(const Function& f, const Eigen::VectorXd& at, double change) {
  std::vector<Eigen::VectorXd> columns;
  for (int i = 0; i < at.size(); ++i) {
    const auto along = [&](double step) {
      const Eigen::VectorXd shift = step * Eigen::VectorXd::Unit(at.size(), i);
      return Eigen::VectorXd((f(at + shift) - f(at - shift)) / (2.0 * step));
    };
    const double probe = 1e-6 * (std::abs(at[i]) + 1e-3);
    const double slope = along(probe).norm();
    columns.push_back(along(slope > 0.0 ? change / slope : probe));
  }
  Eigen::MatrixXd matrix(columns.front().size(), at.size());
  for (int i = 0; i < at.size(); ++i) matrix.col(i) = columns[i];
  return matrix;
}

constexpr Feature<double> kNoise{0.1, 0.2, 0.3};
constexpr double kMargin = 1.0;

class Reconstruction {
 public:
  Reconstruction(const Camera& camera, const Vector3<double>& point)
      : camera_(camera),
        point_(Eigen::Vector3d(point.x, point.y, point.z)),
        micro_lenses_(micro_lenses_seeing(camera, point, kMargin)) {}

  // The features in units of their noise.
  Eigen::VectorXd features(const Camera& camera, const Eigen::VectorXd& point) const {
    std::vector<double> values;
    for (const auto& [k, l] : micro_lenses_) {
      const Feature<double> f =
          project(camera, Pose{}, {point[0], point[1], point[2]}, k, l).value();
      values.push_back(f.u / kNoise.u);
      values.push_back(f.v / kNoise.v);
      if (camera.lens_types() > 0) {
        values.push_back(f.rho / (kNoise.rho * std::sqrt(micro_lenses_.size())));
      }
    }
    return Eigen::Map<Eigen::VectorXd>(values.data(), values.size());
  }

  Eigen::MatrixXd by_point(const Camera& camera, const Eigen::VectorXd& point) const {
    return derivatives([&](const Eigen::VectorXd& x) { return features(camera, x); }, point, 0.1);
  }

  // The point that another camera finds from the features of this one, plus noise.
  Eigen::VectorXd found_by(const Camera& camera, const Eigen::VectorXd& noise) const {
    const Eigen::VectorXd observed = features(camera_, point_) + noise;
    Eigen::VectorXd x = point_;
    for (int i = 0; i < 6; ++i) {
      x += by_point(camera, x).colPivHouseholderQr().solve(observed - features(camera, x));
    }
    return x;
  }

  Eigen::MatrixXd by_intrinsics() const {
    const auto values = test::intrinsics(camera_);
    const auto found = [&](const Eigen::VectorXd& theta) {
      return found_by(test::with_intrinsics(camera_, {theta.begin(), theta.end()}),
                      Eigen::VectorXd::Zero(features(camera_, point_).size()));
    };
    return derivatives(found, Eigen::Map<const Eigen::VectorXd>(values.data(), values.size()),
                       1e-5);
  }

  Eigen::MatrixXd covariance() const {
    const Eigen::MatrixXd jacobian = by_point(camera_, point_);
    return (jacobian.transpose() * jacobian).inverse();
  }

  // From reconstructions of noisy features.
  Eigen::MatrixXd scatter(int trials) const {
    std::mt19937 generator(11);
    std::normal_distribution<double> normal;
    Eigen::MatrixXd sum = Eigen::MatrixXd::Zero(3, 3);
    Eigen::VectorXd noise(features(camera_, point_).size());
    for (int i = 0; i < trials; ++i) {
      for (double& value : noise) value = normal(generator);
      const Eigen::VectorXd error = found_by(camera_, noise) - point_;
      sum += error * error.transpose();
    }
    return sum / trials;
  }

 private:
  Camera camera_;
  Eigen::VectorXd point_;
  std::vector<MicroLensIndex> micro_lenses_;
};

Eigen::MatrixXd covariance_of(const PointSensitivity& s) {
  return Eigen::Map<const Matrix::RowMajor>(s.covariance.data(), 3, 3);
}
Eigen::MatrixXd by_intrinsics_of(const PointSensitivity& s) { return s.by_intrinsics.eigen(); }

// Points behind the array, near it and in front of it, for cameras of 0, 1 and 3 lens types.
const Vector3<double> kPoints[] = {{-2.0, 1.5, 300.0}, {1.0, -0.7, 385.0}, {0.5, 2.0, 700.0}};

class EveryCamera : public testing::TestWithParam<int> {};

TEST_P(EveryCamera, PointMovesWithTheIntrinsics) {
  const Camera camera = test::scene_camera(GetParam());
  const auto names = intrinsic_names(GetParam());
  for (const Vector3<double>& point : kPoints) {
    const auto s = point_sensitivity(camera, point, kNoise, kMargin);
    EXPECT_EQ(s.micro_lenses, static_cast<int>(micro_lenses_seeing(camera, point, kMargin).size()));
    ASSERT_GE(s.micro_lenses, 3);
    ASSERT_EQ(s.by_intrinsics.rows, 3);
    ASSERT_EQ(s.by_intrinsics.columns, static_cast<int>(names.size()));
    const Eigen::MatrixXd actual = by_intrinsics_of(s);
    const Eigen::MatrixXd expected = Reconstruction(camera, point).by_intrinsics();
    for (std::size_t i = 0; i < names.size(); ++i) {
      // Features do not depend on the exit pupil.
      const bool is_pupil = names[i].rfind("e_", 0) == 0;
      EXPECT_EQ(expected.col(i).norm() > 0.0, !is_pupil) << names[i];
      EXPECT_LE((actual - expected).col(i).norm(), 1e-5 * expected.col(i).norm())
          << names[i] << " at " << point.z << " mm";
    }
  }
}

TEST_P(EveryCamera, CovarianceIsTheInverseOfTheInformation) {
  const Camera camera = test::scene_camera(GetParam());
  for (const Vector3<double>& point : kPoints) {
    const auto s = point_sensitivity(camera, point, kNoise, kMargin);
    EXPECT_LT(largest_difference(covariance_of(s), Reconstruction(camera, point).covariance()),
              1e-5);
  }
}

TEST_P(EveryCamera, CovarianceIsThatOfNoisyReconstructions) {
  // 2000 trials: a scatter of 3 % of each variance.
  const Camera camera = test::scene_camera(GetParam());
  const auto s = point_sensitivity(camera, kPoints[1], kNoise, kMargin);
  EXPECT_LT(largest_difference(covariance_of(s), Reconstruction(camera, kPoints[1]).scatter(2000)),
            0.12);
}

INSTANTIATE_TEST_SUITE_P(LensTypes, EveryCamera, testing::Values(0, 1, 3));

// On the axis of the simple camera at z = 275, seen by 13 micro-lenses. With m = F/(z - F) = 2/9
// and -delta/a = 9/38, du/dx = 2/38 / 0.01 = 100/19 px/mm for all. dz'/dz = m^2, so -delta/a grows
// by 0.5/a^2 m^2 = 2/361 per mm: u changes by 2/361 / 0.01 = 200/361 px/mm per mm of C_x, and so
// does v. The squares of C_x and C_y sum up to (4 + 8 + 16) 0.04 = 1.12 mm^2. In each, rho changes
// by 10 * 2/361 px/mm.
constexpr Vector3<double> kOnAxis{0.0, 0.0, 275.0};
const double kDuDx = 100.0 / 19.0;
const double kParallax = 200.0 / 361.0;
const double kBlur = 20.0 / 361.0;

TEST(PointSensitivity, CovarianceByHand) {
  const Feature<double> noise{0.1, 0.1, 0.05};
  const auto s = point_sensitivity(simple_camera(), kOnAxis, noise, 0.0);
  EXPECT_EQ(s.micro_lenses, 13);
  const double xx = 0.01 / (13.0 * kDuDx * kDuDx);
  const double zz = 1.0 / (1.12 * kParallax * kParallax / 0.01 + kBlur * kBlur / 0.0025);
  const double expected[] = {xx, 0.0, 0.0, 0.0, xx, 0.0, 0.0, 0.0, zz};
  for (int i = 0; i < 9; ++i) EXPECT_NEAR(s.covariance[i], expected[i], 1e-12) << i;
}

TEST(PointSensitivity, PrincipalPointMovesThePointSideways) {
  const auto s = point_sensitivity(simple_camera(), kOnAxis, kNoise, 0.0);
  const Eigen::MatrixXd by_intrinsics = by_intrinsics_of(s);
  constexpr int kU0 = kMainLensParameters + kExitPupilParameters;
  const Eigen::Vector3d by_u0(-1.0 / kDuDx, 0.0, 0.0), by_v0(0.0, -1.0 / kDuDx, 0.0);
  EXPECT_LT((by_intrinsics.col(kU0) - by_u0).norm(), 1e-12);
  EXPECT_LT((by_intrinsics.col(kU0 + 1) - by_v0).norm(), 1e-12);
}

TEST(PointSensitivity, RhoOfPinholesNeedsNoStdDev) {
  Camera camera = simple_camera();
  camera.micro_lens_focal_lengths.clear();
  const auto s = point_sensitivity(camera, kOnAxis, {0.1, 0.1, kNan}, 0.0);
  EXPECT_NEAR(s.covariance[8], 0.01 / (1.12 * kParallax * kParallax), 1e-12);
}

void expect_undetermined(const PointSensitivity& s, int micro_lenses) {
  const auto is_nan = [](double value) { return std::isnan(value); };
  EXPECT_EQ(s.micro_lenses, micro_lenses);
  EXPECT_EQ(s.by_intrinsics.values.size(), 3U * 27U);
  EXPECT_TRUE(s.by_intrinsics.eigen().array().isNaN().all());
  EXPECT_TRUE(std::all_of(s.covariance.begin(), s.covariance.end(), is_nan));
}

TEST(PointSensitivity, IsNotANumberUnlessThePointIsDetermined) {
  const Camera camera = simple_camera();
  expect_undetermined(point_sensitivity(camera, {0.0, 0.0, 40.0}, kNoise, 0.0), 0);
  expect_undetermined(point_sensitivity(camera, kOnAxis, kNoise, 5.2), 1);
  // So far away that neither depth nor position change the features: by 1e-150 mm at most.
  expect_undetermined(point_sensitivity(camera, {0.0, 0.0, 1e200}, kNoise, 0.0), 25);
  // Off axis, the features of a far point change in the same way with depth and position.
  expect_undetermined(point_sensitivity(camera, {1e14, 0.0, 1e18}, kNoise, 0.0), 25);
}

TEST(PointSensitivity, InvalidInputIsRejected) {
  const auto message = [](const Camera& camera, const Feature<double>& std_dev, double margin) {
    return rejection([&] { point_sensitivity(camera, kOnAxis, std_dev, margin); });
  };
  Camera camera = simple_camera();
  for (double bad : {0.0, -1.0, kNan, kInfinity}) {
    expect_names(message(camera, {bad, 1.0, 1.0}, 0.0), "deviation of u ");
    expect_names(message(camera, {1.0, bad, 1.0}, 0.0), "deviation of v ");
    // An infinite one says that rho is not used.
    const double bad_rho = std::isinf(bad) ? -kInfinity : bad;
    expect_names(message(camera, {1.0, 1.0, bad_rho}, 0.0), "deviation of rho ");
  }
  expect_names(message(camera, kNoise, -1.0), "margin");
  camera.mla.pitch = 0.0;
  expect_names(message(camera, kNoise, 0.0), "dC (mm)");
}

}  // namespace
}  // namespace plenocal
