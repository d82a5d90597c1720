// The inverse model: by hand, against the forward model, and against a scan of the whole array.
#include "plenocal/back_projection.hpp"

#include <gtest/gtest.h>

#include "plenocal/points.hpp"
#include "rejection.hpp"
#include "simple_camera.hpp"
#include "synthetic_scene.hpp"
#include "views.hpp"

namespace plenocal {
namespace {

using test::scene_camera;
using test::simple_camera;
using test::Views;
using test::views;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInfinity = std::numeric_limits<double>::infinity();

// z = 300 mm, off axis: p' = (-0.6, -0.3, -60) lies 1 mm behind the array of the simple camera, so
// nu = 1/0.5 = 2. Micro-lens (4, 3) is at C = (-0.4, -0.2, -59): 2 columns right and 1 row down,
// which run against x and y. The ray meets the sensor half-way, at (-0.5, -0.25): u = 150, v = 105.
constexpr Vector3<double> kPoint{3.0, 1.5, 300.0};
constexpr MicroPixel kSeen{4, 3, {150.0, 105.0}};

TEST(BackProjection, APixelAtAVirtualDepthIsAPoint) {
  const BackProjection back(simple_camera());
  const auto found = back.point({kSeen, 2.0, {}});
  ASSERT_TRUE(found);
  EXPECT_NEAR(found->point.x, kPoint.x, 1e-9);
  EXPECT_NEAR(found->point.y, kPoint.y, 1e-9);
  EXPECT_NEAR(found->point.z, kPoint.z, 1e-8);
  EXPECT_NEAR(*back.virtual_depth(4, 3, kPoint), 2.0, 1e-12);
  // rho = 0.1/0.01 (0.5/1 + 1/2 - 1) = 0: with f = 1 mm, points are sharp at 2 d.
  EXPECT_NEAR(*back.virtual_depth_of_blur(4, 3, 0.0), 2.0, 1e-12);
  // rho = 10 (0.5 + 1/4 - 1) = -2.5 px.
  EXPECT_NEAR(*back.virtual_depth_of_blur(4, 3, -2.5), 4.0, 1e-12);
}

TEST(BackProjection, InATotalFocusImageTheImageIsStraightBehindThePixel) {
  // p' = (-0.6, -0.3, -60): u = 100 + 0.6/0.01, v = 80 + 0.3/0.01.
  const BackProjection back(simple_camera());
  const auto found = back.focused_point({{0, 0, {160.0, 110.0}}, 2.0, {0.1, 0.0, 0.0}});
  ASSERT_TRUE(found);
  EXPECT_NEAR(found->point.x, kPoint.x, 1e-9);
  EXPECT_NEAR(found->point.y, kPoint.y, 1e-9);
  EXPECT_NEAR(found->point.z, kPoint.z, 1e-8);
  // 0.01 mm a pixel, magnified by 5.
  EXPECT_NEAR(found->covariance[0], 0.005 * 0.005, 1e-12);
}

TEST(BackProjection, ErrorsSpreadAsByHand) {
  // The image moves by nu s per pixel, 0.02 mm, and is magnified by 1/m = -5: 0.1 mm per px. nu = 2
  // moves it by d = 0.5 mm per 1 along the line, and z = F - F/m grows with 1/m^2 = 25: at
  // p'_z = mF - F, dz = (F/m^2) dm = 25 dp'_z; per nu p'_z falls by 0.5 mm, so dz = -12.5 mm.
  const BackProjection back(simple_camera());
  const auto by_u = back.point({kSeen, 2.0, {0.1, 0.0, 0.0}});
  EXPECT_NEAR(by_u->covariance[0], 0.01 * 0.01, 1e-12);
  EXPECT_NEAR(by_u->covariance[8], 0.0, 1e-15);
  const auto by_depth = back.point({kSeen, 2.0, {0.0, 0.0, 0.02}});
  EXPECT_NEAR(by_depth->covariance[8], 0.25 * 0.25, 1e-9);
}

TEST(BackProjection, RaysBehindTheLensAreAsByHand) {
  const BackProjection back(simple_camera());
  // From (-0.5, -0.25, -59.5) through C.
  const auto chief = back.ray_behind(kSeen);
  EXPECT_EQ(chief->origin.x, -0.4);
  EXPECT_NEAR(chief->direction.x / chief->direction.z, 0.1 / 0.5, 1e-12);
  EXPECT_NEAR(chief->direction.y / chief->direction.z, 0.05 / 0.5, 1e-12);
  EXPECT_GT(chief->direction.z, 0.0);
  // With f = 1 mm the pixel, 0.5 mm off, has a virtual image 1 mm behind the array: p' of the point
  // that is sharp there. So all rays over the micro-lens come from p'.
  const auto right = back.ray_behind(kSeen, {1.0, -0.5});
  EXPECT_NEAR(right->origin.x, -0.4 + 0.1, 1e-12);
  EXPECT_NEAR(right->origin.y, -0.2 - 0.05, 1e-12);
  EXPECT_NEAR(right->direction.x / right->direction.z, -0.3 + 0.6, 1e-12);
  EXPECT_NEAR(right->direction.y / right->direction.z, -0.25 + 0.3, 1e-12);
}

TEST(BackProjection, AllPinholesSeeTheChiefRayAlone) {
  Camera camera = simple_camera();
  camera.micro_lens_focal_lengths.clear();
  const BackProjection back(camera);
  EXPECT_EQ(back.ray_behind(kSeen, {1.0, 0.0})->origin.x, back.ray_behind(kSeen)->origin.x);
  EXPECT_FALSE(back.virtual_depth_of_blur(4, 3, 0.0));
}

TEST(BackProjection, TheRayInSpaceIsThatThroughTheImagesOfItsEnds) {
  // Without distortion the ray meets the main lens where the line of images does: at
  // (-0.4 + 0.2 59, -0.2 + 0.1 59) = (11.4, 5.7), and goes through the point.
  const BackProjection back(simple_camera());
  for (double z : {120.0, 300.0, 900.0}) {
    const auto ray = back.object_ray(kSeen, z);
    ASSERT_TRUE(ray);
    EXPECT_EQ(ray->origin.z, z);
    EXPECT_NEAR(ray->direction.x / ray->direction.z, (3.0 - 11.4) / 300.0, 1e-12);
    EXPECT_NEAR(ray->direction.y / ray->direction.z, (1.5 - 5.7) / 300.0, 1e-12);
    EXPECT_NEAR(ray->origin.x, 11.4 + z * (3.0 - 11.4) / 300.0, 1e-9);
  }
}

double pixels_between(const Camera& camera, int k, int l, const Vector3<double>& a,
                      const Vector3<double>& b) {
  const Feature<double> of_a = project(camera, Pose{}, a, k, l).value();
  const Feature<double> of_b = project(camera, Pose{}, b, k, l).value();
  return std::hypot(of_a.u - of_b.u, of_a.v - of_b.v);
}

class RoundTrip : public testing::TestWithParam<int> {};
INSTANTIATE_TEST_SUITE_P(LensTypes, RoundTrip, testing::Values(0, 1, 3));

TEST_P(RoundTrip, PointsComeBackFromEveryMicroLens) {
  constexpr double kExactPx = 1e-9;
  const Camera camera = scene_camera(GetParam());
  const BackProjection back(camera);
  int seen = 0;
  for (const Views& view : views(camera)) {
    for (const Sighting& s : view.sightings) {
      const Pixel<double> pixel{s.observed.u, s.observed.v};
      const auto depth = back.virtual_depth(s.k, s.l, view.point);
      const auto point = back.point({{s.k, s.l, pixel}, depth.value(), {}});
      ASSERT_TRUE(point);
      EXPECT_LT(pixels_between(camera, s.k, s.l, point->point, view.point), kExactPx);
      EXPECT_NEAR(point->point.z, view.point.z, 1e-8 * view.point.z);
      const auto ray = back.object_ray({s.k, s.l, pixel}, view.point.z);
      ASSERT_TRUE(ray);
      EXPECT_LT(pixels_between(camera, s.k, s.l, ray->origin, view.point), kExactPx);
      // Along the ray the pixel hardly changes: it touches the line that is imaged there.
      const auto along = [&](double t) {
        return Vector3<double>{ray->origin.x + t * ray->direction.x,
                               ray->origin.y + t * ray->direction.y,
                               ray->origin.z + t * ray->direction.z};
      };
      const double of_1 = pixels_between(camera, s.k, s.l, along(0.1), view.point);
      const double of_2 = pixels_between(camera, s.k, s.l, along(0.2), view.point);
      EXPECT_LT(of_1, 1e-4);
      if (of_1 > 1e-7) {
        EXPECT_NEAR(of_2 / of_1, 4.0, 0.3);
      }
      if (GetParam() > 0) {
        EXPECT_NEAR(back.virtual_depth_of_blur(s.k, s.l, s.observed.rho).value() / *depth, 1.0,
                    1e-9);
      }
      const auto micro_image = back.micro_image_at(pixel);
      ASSERT_TRUE(micro_image);
      EXPECT_EQ(micro_image->k, s.k);
      EXPECT_EQ(micro_image->l, s.l);
      ++seen;
    }
    if (view.sightings.size() < 2) continue;
    const auto point = back.triangulate(view.sightings);
    ASSERT_TRUE(point);
    for (const Sighting& s : view.sightings) {
      EXPECT_LT(pixels_between(camera, s.k, s.l, point->point, view.point), kExactPx);
    }
  }
  EXPECT_GT(seen, 60);
}

TEST(BackProjection, MicroImagesAreThoseWithTheNearestCentre) {
  for (Packing packing :
       {Packing::kOrthogonal, Packing::kHexagonalRowsEven, Packing::kHexagonalRowsOdd,
        Packing::kHexagonalColumnsEven, Packing::kHexagonalColumnsOdd}) {
    Camera camera = scene_camera(1);
    camera.lattice = {packing, 9, 8};
    camera.mla.rotation.z = 0.05;
    const BackProjection back(camera);
    std::mt19937 generator(3);
    std::uniform_real_distribution<double> u(100.0, 360.0), v(60.0, 300.0);
    int inside = 0;
    for (int i = 0; i < 3000; ++i) {
      const Pixel<double> pixel{u(generator), v(generator)};
      double least = HUGE_VAL;
      int nearest_k = -1, nearest_l = -1;
      // With neighbours beyond the array, which cannot be the answer.
      for (int l = -1; l <= camera.lattice.rows; ++l) {
        for (int k = -1; k <= camera.lattice.columns; ++k) {
          const Pixel<double> center = project_center(camera, k, l);
          const double distance = std::hypot(pixel.u - center.u, pixel.v - center.v);
          if (distance < least) {
            least = distance;
            nearest_k = k;
            nearest_l = l;
          }
        }
      }
      if (least > back.micro_image_radius()) continue;
      const auto found = back.micro_image_at(pixel);
      if (!camera.lattice.contains(nearest_k, nearest_l)) {
        EXPECT_FALSE(found);
        continue;
      }
      ASSERT_TRUE(found) << pixel.u << " " << pixel.v;
      EXPECT_EQ(found->k, nearest_k);
      EXPECT_EQ(found->l, nearest_l);
      EXPECT_NEAR(found->distance, least, 1e-9);
      ++inside;
    }
    EXPECT_GT(inside, 1000);
  }
}

TEST(BackProjection, WhatIsNotSeenHasNoResult) {
  const BackProjection back(simple_camera());
  for (const Pixel<double>& pixel : {Pixel<double>{1e4, 80.0}, Pixel<double>{100.0, -1e300},
                                     Pixel<double>{kNan, 80.0}, Pixel<double>{kInfinity, 80.0}}) {
    EXPECT_FALSE(back.micro_image_at(pixel));
  }
  // Off the sensor, if its size is known.
  Camera camera = simple_camera();
  ASSERT_TRUE(BackProjection(camera).micro_image_at({150.0, 105.0}));
  camera.width = 150;
  camera.height = 200;
  EXPECT_FALSE(BackProjection(camera).micro_image_at({150.0, 105.0}));
  EXPECT_TRUE(BackProjection(camera).micro_image_at({149.4, 105.0}));
  for (const auto& [k, l] : {std::pair{-1, 0}, {5, 0}, {0, 5}, {0, -1}}) {
    EXPECT_FALSE(back.ray_behind({k, l, {150.0, 105.0}}));
    EXPECT_FALSE(back.object_ray({k, l, {150.0, 105.0}}, 300.0));
    EXPECT_FALSE(back.point({{k, l, {150.0, 105.0}}, 2.0, {}}));
    EXPECT_FALSE(back.virtual_depth(k, l, kPoint));
  }
  for (double z : {50.0, 0.0, -300.0, kNan, kInfinity}) EXPECT_FALSE(back.object_ray(kSeen, z));
  // Virtual depths of images on the scene's side of the focal plane, p'_z > -50.
  for (double depth : {-18.0, -100.0, kNan, kInfinity}) {
    EXPECT_FALSE(back.point({kSeen, depth, {}})) << depth;
  }
  const Sighting one{4, 3, {150.0, 105.0, 0.0}};
  EXPECT_FALSE(back.triangulate({one}));
  EXPECT_FALSE(back.triangulate({one, one}));
  // Parallel lines: an image infinitely far away.
  EXPECT_FALSE(back.triangulate({{2, 2, {100.0, 80.0, 0.0}}, {3, 2, {120.0, 80.0, 0.0}}}));
}

TEST(BackProjection, ImpossibleInputIsRejected) {
  const BackProjection back(simple_camera());
  const auto message = test::rejection([&] { back.point({kSeen, 2.0, {-1.0, 0.0, 0.0}}); });
  EXPECT_NE(message.find("standard deviation"), std::string::npos) << message;
  const Sighting one{4, 3, {150.0, 105.0, 0.0}, {0.0, 1.0, 1.0}};
  EXPECT_NE(test::rejection([&] { back.triangulate({one, one}); }).find("u"), std::string::npos);
  for (double std_dev : {-1.0, std::nan(""), HUGE_VAL}) {
    test::expect_names(test::rejection([&] { back.triangulate({one, one}, {}, std_dev); }), "rho");
  }
  Camera camera = simple_camera();
  camera.mla.pitch = 0.0;
  EXPECT_NE(test::rejection([&] { BackProjection{camera}; }).find("dC"), std::string::npos);
}

// Rounding must not keep it from settling, whatever the distance.
TEST(BackProjection, EveryDistanceHasARay) {
  const Camera camera = scene_camera(3);
  const BackProjection back(camera);
  const Pixel<double> center = project_center(camera, 9, 8);
  for (int i = 0; i < 20000; ++i) {
    const double z = 60.0 + 0.0371 * i;
    ASSERT_TRUE(back.object_ray({9, 8, {center.u + 4.0, center.v - 5.0}}, z)) << z;
  }
}

TEST(BackProjection, ManyAtOnceAreAsOneByOne) {
  const Camera camera = scene_camera(3);
  const BackProjection back(camera);
  std::vector<Pixel<double>> pixels;
  std::vector<VirtualPoint> seen;
  for (int i = 0; i < 200; ++i) {
    pixels.push_back({2.0 * i, 1.7 * i - 10.0});
    const auto at = back.micro_image_at(pixels.back());
    seen.push_back({{at ? at->k : -1, at ? at->l : 0, pixels.back()}, 2.0 + 0.01 * i, {}});
  }
  std::vector<Ray<double>> rays(pixels.size());
  std::vector<MetricPoint> points(pixels.size());
  const std::size_t ray_count = back.object_rays(pixels.data(), pixels.size(), 300.0, rays.data());
  const std::size_t point_count = back.points(seen.data(), seen.size(), points.data());
  std::size_t expected_rays = 0, expected_points = 0;
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    const auto ray = back.object_ray(seen[i].at, 300.0);
    const auto point = back.point(seen[i]);
    expected_rays += ray.has_value();
    expected_points += point.has_value();
    EXPECT_EQ(std::isnan(rays[i].origin.x), !ray);
    EXPECT_EQ(std::isnan(points[i].point.x), !point);
    if (ray) {
      EXPECT_EQ(ray->direction.x, rays[i].direction.x);
    }
    if (point) {
      EXPECT_EQ(point->point.z, points[i].point.z);
    }
  }
  EXPECT_EQ(ray_count, expected_rays);
  EXPECT_EQ(point_count, expected_points);
  EXPECT_GT(ray_count, 100);
  EXPECT_LT(ray_count, 200);
}

}  // namespace
}  // namespace plenocal
