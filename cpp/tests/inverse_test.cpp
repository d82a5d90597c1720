// The templates of the inverse model: the limits of undistortion, and derivatives.
#include "plenocal/inverse.hpp"

#include <ceres/jet.h>
#include <gtest/gtest.h>

#include "synthetic_scene.hpp"

namespace plenocal {
namespace {

using test::scene_camera;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInfinity = std::numeric_limits<double>::infinity();

TEST(Undistort, InvertsDistortionUpToItsFold) {
  // x (1 - 0.01 x^2) turns back at x = 1/sqrt(0.03) = 5.774, where it is 3.849.
  MainLens<double> lens{};
  lens.focal_length = 50.0;
  lens.radial[0] = -0.01;
  for (double x : {0.0, 1e-3, 1.0, 5.0, 5.7}) {
    const Vector2<double> shift = distortion(lens, -0.1, x, 0.0);
    const auto ideal = undistort(lens, Magnification(-0.1), {x + shift.x, 0.0});
    ASSERT_TRUE(ideal) << x;
    EXPECT_NEAR(ideal->x, x, 1e-9);
  }
  for (double x : {3.85, 3.9, 10.0, 1e6, kNan, kInfinity}) {
    EXPECT_FALSE(undistort(lens, Magnification(-0.1), {x, 0.0})) << x;
  }
}

// Derivatives of the ray by pixel, distance and all parameters of lens and array, against central
// differences.
TEST(ObjectRay, HasDerivatives) {
  constexpr int kParameters = kMainLensParameters + kArrayParameters + 3;
  using Jet = ceres::Jet<double, kParameters>;
  const Camera camera = scene_camera(3);
  std::array<double, kParameters> values;
  {
    const auto lens = to_block(camera.main_lens);
    const auto array = to_block(camera.mla);
    auto next = std::copy(lens.begin(), lens.end(), values.begin());
    next = std::copy(array.begin(), array.end(), next);
    const Pixel<double> center = project_center(camera, 4, 11);
    *next++ = center.u + 3.0;
    *next++ = center.v - 4.0;
    *next = 310.0;
  }
  const auto ray_of = [&](const auto& v) {
    using T = std::decay_t<decltype(v[0])>;
    const T* rest = v.data() + kMainLensParameters + kArrayParameters;
    const T focal_lengths[3] = {T(0.578), T(0.504), T(0.552)};
    const Optics<T> optics(from_block<MainLens>(v.data()),
                           from_block<MicroLensArray>(v.data() + kMainLensParameters),
                           focal_lengths, 3, camera.pixel_size);
    const Ray<T> ray =
        object_ray(optics, micro_lens_of(camera, 4, 11), {rest[0], rest[1]}, rest[2]).value();
    return std::array<T, 6>{ray.origin.x,    ray.origin.y,    ray.origin.z,
                            ray.direction.x, ray.direction.y, ray.direction.z};
  };
  std::array<Jet, kParameters> jets;
  for (int i = 0; i < kParameters; ++i) jets[i] = Jet(values[i], i);
  const auto exact = ray_of(jets);
  for (int i = 0; i < kParameters; ++i) {
    const double step = 1e-5 * std::max(std::abs(values[i]), 1e-3);
    auto above = values, below = values;
    above[i] += step;
    below[i] -= step;
    const auto a = ray_of(above), b = ray_of(below);
    for (int j = 0; j < 6; ++j) {
      const double slope = (a[j] - b[j]) / (2.0 * step);
      EXPECT_NEAR(exact[j].v[i], slope, 1e-5 * std::abs(slope) + 1e-6) << i << " " << j;
    }
  }
}

}  // namespace
}  // namespace plenocal
