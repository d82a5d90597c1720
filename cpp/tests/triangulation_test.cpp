// Points that several micro-lenses see: their covariance against errors and by hand.
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <random>

#include "synthetic_scene.hpp"
#include "views.hpp"

namespace plenocal {
namespace {

using test::scene_camera;
using test::Views;
using test::views;

TEST(Triangulation, ErrorsOfTriangulationAreAsItsCovarianceSays) {
  const Camera camera = scene_camera(3);
  const BackProjection back(camera);
  std::mt19937 generator(7);
  std::normal_distribution<double> normal;
  constexpr Feature<double> kNoise{0.02, 0.03, 0.05};
  constexpr double kCorrelation = 0.8;
  double square = 0.0, chi_square = 0.0;
  int count = 0, freedom = 0;
  for (const Views& view : views(camera)) {
    if (view.sightings.size() < 3) continue;
    for (int draw = 0; draw < 40; ++draw) {
      auto noisy = view.sightings;
      for (Sighting& s : noisy) {
        const double first = normal(generator), second = normal(generator);
        s.observed.u += kNoise.u * first;
        s.observed.v +=
            kNoise.v * (kCorrelation * first + std::sqrt(1.0 - std::pow(kCorrelation, 2)) * second);
        s.observed.rho += kNoise.rho * normal(generator);
        s.std_dev = kNoise;
        s.correlation = kCorrelation;
      }
      const auto found = back.triangulate(noisy);
      ASSERT_TRUE(found);
      const Eigen::Vector3d off(found->point.x - view.point.x, found->point.y - view.point.y,
                                found->point.z - view.point.z);
      const Eigen::Map<const Eigen::Matrix3d> covariance(found->covariance.data());
      square += off.dot(covariance.ldlt().solve(off)) / 3.0;
      ++count;
      EXPECT_EQ(found->freedom, static_cast<int>(3 * noisy.size()) - 3);
      chi_square += found->chi_square;
      freedom += found->freedom;
    }
  }
  ASSERT_GT(count, 500);
  EXPECT_NEAR(square / count, 1.0, 4.0 * std::sqrt(2.0 / (3.0 * count)));
  EXPECT_NEAR(chi_square / freedom, 1.0, 4.0 * std::sqrt(2.0 / freedom));
}

// What sightings share widens the covariance along the depth: rho = q' - dC/2s/nu of the point has
// the stated sigma, and the direction in which the point is seen stays as well known.
TEST(Triangulation, SigmaOfRhoIsAtLeastWhatIsStated) {
  constexpr double kRhoStdDev = 0.4, kStep = 1e-3;
  const Camera camera = scene_camera(3);
  const BackProjection back(camera);
  const double half_pitch = 0.5 * camera.mla.pitch / camera.pixel_size;
  int compared = 0;
  for (const Views& view : views(camera)) {
    if (view.sightings.size() < 4) continue;
    auto sightings = view.sightings;
    for (Sighting& s : sightings) s.std_dev = {0.05, 0.05, HUGE_VAL};
    const auto alone = back.triangulate(sightings),
               wide = back.triangulate(sightings, {}, kRhoStdDev);
    ASSERT_TRUE(alone && wide);
    EXPECT_EQ(alone->point.z, wide->point.z);
    const auto inverse_depth = [&](double dx, double dy, double dz) {
      const Vector3<double>& p = wide->point;
      return 1.0 /
             back.virtual_depth(sightings[0].k, sightings[0].l, {p.x + dx, p.y + dy, p.z + dz})
                 .value();
    };
    Eigen::Vector3d slope;
    for (int i = 0; i < 3; ++i) {
      const Eigen::Vector3d step = kStep * Eigen::Vector3d::Unit(i);
      slope[i] =
          half_pitch *
          (inverse_depth(step[0], step[1], step[2]) - inverse_depth(-step[0], -step[1], -step[2])) /
          (2.0 * kStep);
    }
    const Eigen::Matrix3d before = Eigen::Map<const Eigen::Matrix3d>(alone->covariance.data());
    const Eigen::Matrix3d after = Eigen::Map<const Eigen::Matrix3d>(wide->covariance.data());
    ASSERT_LT(slope.dot(before * slope), kRhoStdDev * kRhoStdDev);
    EXPECT_NEAR(std::sqrt(slope.dot(after * slope)), kRhoStdDev, 1e-3 * kRhoStdDev);
    // Everything that is known beside the depth is known as before.
    const Eigen::Matrix3d more = before.inverse() - after.inverse();
    EXPECT_NEAR(more.trace(), more.operatorNorm(), 1e-3 * more.operatorNorm());
    const auto least = back.triangulate(sightings, {}, 1e-9);
    EXPECT_EQ(least->covariance, alone->covariance);
    ++compared;
  }
  EXPECT_GT(compared, 5);
}

TEST(Triangulation, AFalseSightingIsWithstood) {
  const BackProjection back(scene_camera(3));
  int compared = 0;
  for (const Views& view : views(scene_camera(3))) {
    if (view.sightings.size() < 6) continue;
    auto sightings = view.sightings;
    for (Sighting& s : sightings) s.std_dev = {0.02, 0.02, 0.05};
    sightings[2].observed.u += 2.0;
    const auto off = [&](const Loss& loss) {
      const auto found = back.triangulate(sightings, loss);
      EXPECT_TRUE(found);
      return std::hypot(found->point.x - view.point.x, found->point.y - view.point.y,
                        found->point.z - view.point.z);
    };
    EXPECT_LT(off({LossKind::kCauchy, 2.0}), 0.05 * off({}));
    EXPECT_LT(off({LossKind::kHuber, 3.0}), 0.5 * off({}));
    ++compared;
  }
  EXPECT_GT(compared, 2);
}

}  // namespace
}  // namespace plenocal
