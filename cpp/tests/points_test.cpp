// The micro-lenses that see a point, worked out by hand and against a scan of the whole array.
#include "plenocal/points.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <random>
#include <utility>

#include "rejection.hpp"
#include "simple_camera.hpp"
#include "synthetic_scene.hpp"

namespace plenocal {
namespace {

using test::expect_names;
using test::rejection;
using test::simple_camera;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInfinity = std::numeric_limits<double>::infinity();

using Indices = std::vector<std::pair<int, int>>;

Indices seeing(const Camera& camera, const Vector3<double>& point, double margin = 0.0) {
  Indices indices;
  for (const auto& [k, l] : micro_lenses_seeing(camera, point, margin)) indices.push_back({k, l});
  return indices;
}

// With the simple camera, a micro-image has the radius 0.1 * 59.5/59 = 0.100847 mm. A point on the
// axis at z = 275 mm is imaged at z' = -550/9, with a = -19/9. A micro-lens at the distance c from
// the axis sees it 0.5 * (550/9) / (19/9 * 59) c = 0.245317 c from its micro-image centre.
constexpr Vector3<double> kOnAxis{0.0, 0.0, 275.0};

TEST(MicroLensesSeeing, AllWithinTwoPitchesInOrder) {
  // c <= 0.100847/0.245317 mm = 2.055 pitches.
  const Indices expected = {{2, 0}, {1, 1}, {2, 1}, {3, 1}, {0, 2}, {1, 2}, {2, 2},
                            {3, 2}, {4, 2}, {1, 3}, {2, 3}, {3, 3}, {2, 4}};
  EXPECT_EQ(seeing(simple_camera(), kOnAxis), expected);
}

TEST(MicroLensesSeeing, MarginIsTakenFromTheRadius) {
  // 1 px: c <= 0.090847/0.245317 mm = 1.85 pitches, the 3 x 3 in the middle.
  EXPECT_EQ(seeing(simple_camera(), kOnAxis, 1.0).size(), 9);
  // 5.2 px: c <= 0.996 pitches. The whole radius is 10.08 px.
  EXPECT_EQ(seeing(simple_camera(), kOnAxis, 5.2), (Indices{{2, 2}}));
  EXPECT_EQ(seeing(simple_camera(), kOnAxis, 10.09), Indices{});
}

TEST(MicroLensesSeeing, MicroImagesAreAsWideAsTheMeanPitch) {
  // The mean of 0.2 and 0.288 mm is 0.24 mm: c <= 0.493 mm. (2, 1) pitches are 0.4929 mm, (0, 2)
  // are 0.576 mm: rows of 5, without the first and the last.
  Camera camera = simple_camera();
  camera.mla.pitch_ratio = 1.44;
  const Indices indices = seeing(camera, kOnAxis);
  EXPECT_EQ(indices.size(), 15);
  EXPECT_EQ(indices.front(), std::make_pair(0, 1));
}

TEST(MicroLensesSeeing, ThoseNearTheImageOfThePoint) {
  // z = 300, off axis: p' = (-0.6, -0.3, -60) is 1 mm behind the array. The ray from O meets it at
  // (-0.59, -0.295), 2.95 pitches right and 1.475 below its middle: just beyond the last column.
  // 0.5 * 60/59 c <= 0.100847, c <= 0.992 pitches, but (4, 3) is at 1.06 and (4, 4) at 1.09.
  EXPECT_EQ(seeing(simple_camera(), {3.0, 1.5, 300.0}), Indices{});
  // Half as far off axis: 1.475 and 0.7375 pitches. (3, 2) is at 0.878, (3, 3) at 0.543, (4, 3) at
  // 0.587 and (4, 2) at 0.905.
  const Indices expected = {{3, 2}, {4, 2}, {3, 3}, {4, 3}};
  EXPECT_EQ(seeing(simple_camera(), {1.5, 0.75, 300.0}), expected);
}

TEST(MicroLensesSeeing, NothingSeesWhatIsNotImaged) {
  for (double z : {50.0, 49.0, 0.0, -300.0, kNan, kInfinity, -kInfinity}) {
    EXPECT_EQ(seeing(simple_camera(), {0.0, 0.0, z}), Indices{}) << z;
  }
  for (double x : {kNan, kInfinity, 1e300}) {
    EXPECT_EQ(seeing(simple_camera(), {x, 0.0, 275.0}), Indices{}) << x;
    EXPECT_EQ(seeing(simple_camera(), {0.0, x, 275.0}), Indices{}) << x;
  }
}

TEST(MicroLensesSeeing, NothingSeesAnImageInThePlaneOfTheArray) {
  // 2F is imaged at 2F; 100 is exact in binary.
  Camera camera = simple_camera();
  camera.mla.lens_to_mla = 100.0;
  EXPECT_EQ(seeing(camera, {0.0, 0.0, 100.0}), Indices{});
  // 1 nm further away, only rays that nearly hit the middle of a micro-lens stay in its
  // micro-image: they run on to 0.5 * x/1e-6 mm from its centre.
  EXPECT_EQ(seeing(camera, {1e-8, 0.0, 100.0 - 1e-6}), (Indices{{2, 2}}));
  EXPECT_EQ(seeing(camera, {0.018, 0.0, 100.0 - 1e-6}), Indices{});
}

TEST(MicroLensesSeeing, WithoutAnInverseTheWholeArrayIsScanned) {
  // The determinant of the steps from node to node is 1e-340, which is 0. The micro-images are
  // narrower than a rounding error, so all are in one place.
  Camera camera = simple_camera();
  camera.mla.pitch = 1e-170;
  EXPECT_EQ(seeing(camera, kOnAxis).size(), 25);
}

TEST(MicroLensesSeeing, ImageAtInfinityIsSeenByAll) {
  // The ray from O and the others are parallel: 0.5/59 c <= 0.1.
  EXPECT_EQ(seeing(simple_camera(), {0.0, 0.0, std::nextafter(50.0, 51.0)}).size(), 25);
}

TEST(MicroLensesSeeing, LargestArrayIsNotScanned) {
  // 12 nodes within 2.055 pitches of the middle of four: (1, 1)/2, (1, 3)/2, (3, 1)/2. A scan of
  // 4e9 micro-lenses takes a minute.
  Camera camera = simple_camera();
  camera.lattice.columns = camera.lattice.rows = kMaxMicroLenses;
  const auto start = std::chrono::steady_clock::now();
  const Indices indices = seeing(camera, kOnAxis);
  EXPECT_EQ(seeing(camera, {kNan, 0.0, 275.0}), Indices{});
  EXPECT_LT(std::chrono::steady_clock::now() - start, std::chrono::seconds(1));
  ASSERT_EQ(indices.size(), 12);
  EXPECT_EQ(indices.front(), std::make_pair(32767, 32766));
}

TEST(MicroLensesSeeing, InvalidInputIsRejected) {
  Camera camera = simple_camera();
  for (double margin : {-1.0, kNan, kInfinity}) {
    expect_names(rejection([&] { micro_lenses_seeing(camera, kOnAxis, margin); }), "margin");
  }
  camera.mla.pitch = 0.0;
  expect_names(rejection([&] { micro_lenses_seeing(camera, kOnAxis, 0.0); }), "dC (mm)");
}

// A camera like an R12 with a small array. The larger rotations are absurd: the array runs through
// the sensor.
struct Setup {
  Lattice lattice;
  Vector3<double> rotation;
};

class EveryArray : public testing::TestWithParam<Setup> {
 protected:
  EveryArray() {
    camera_ = test::scene_camera(3);
    camera_.lattice = GetParam().lattice;
    if (camera_.lattice.packing == Packing::kOrthogonal) camera_.micro_lens_focal_lengths = {0.55};
    camera_.mla.rotation = GetParam().rotation;
    camera_.mla.pitch_ratio = 1.03;
  }

  Indices scan(const Vector3<double>& point, double margin) const {
    const auto& mla = camera_.mla;
    const double to_pupil = mla.lens_to_mla + camera_.exit_pupil.z;
    const double diameter = mla.pitch * std::sqrt(mla.pitch_ratio) / camera_.pixel_size *
                            (to_pupil + mla.mla_to_sensor) / to_pupil;
    Indices indices;
    for (int l = 0; l < camera_.lattice.rows; ++l) {
      for (int k = 0; k < camera_.lattice.columns; ++k) {
        const Pixel<double> center = project_center(camera_, k, l);
        const auto feature = project(camera_, Pose{}, point, k, l);
        if (feature &&
            std::hypot(feature->u - center.u, feature->v - center.v) <= diameter / 2.0 - margin) {
          indices.push_back({k, l});
        }
      }
    }
    return indices;
  }

  Camera camera_;
};

TEST_P(EveryArray, GivesWhatAScanGives) {
  // Images up to half the array's width beyond its edge. They lie behind the array (z < 425), in
  // front of it, and near it.
  std::mt19937 generator(7);
  std::uniform_real_distribution<double> across(-1.5, 1.5), uniform(0.0, 1.0);
  const double largest = std::max(camera_.lattice.columns, camera_.lattice.rows);
  const double half_width = largest / 2.0 * camera_.mla.pitch / camera_.mla.lens_to_mla;
  std::vector<double> distances = {50.0 + 1e-9, 50.01, 55.0, 100.0, 1e4, 1e6, 1e12};
  for (int i = 0; i < 150; ++i) distances.push_back(150.0 + 700.0 * uniform(generator));
  for (int i = 0; i < 50; ++i) distances.push_back(425.6 + uniform(generator) - 0.5);
  std::size_t seen = 0;
  for (double z : distances) {
    for (double margin : {0.0, 1.5}) {
      const Vector3<double> point{z * half_width * across(generator),
                                  z * half_width * across(generator), z};
      const Indices expected = scan(point, margin);
      ASSERT_EQ(seeing(camera_, point, margin), expected) << point.x << ' ' << point.y << ' ' << z;
      seen += expected.size();
    }
  }
  EXPECT_GT(seen, distances.size());
}

std::vector<Setup> setups() {
  const std::vector<Lattice> lattices = {
      {Packing::kOrthogonal, 24, 17},          {Packing::kHexagonalRowsEven, 23, 18},
      {Packing::kHexagonalRowsOdd, 18, 23},    {Packing::kHexagonalColumnsEven, 23, 18},
      {Packing::kHexagonalColumnsOdd, 18, 23}, {Packing::kHexagonalRowsEven, 30, 1},
      {Packing::kHexagonalColumnsEven, 1, 30}};
  std::vector<Setup> all;
  for (const Lattice& lattice : lattices) {
    for (const Vector3<double>& rotation : {Vector3<double>{0.0, 0.0, 0.0},
                                            {0.004, -0.003, 0.002},
                                            {0.08, -0.05, 0.7},
                                            {0.4, 0.5, -1.0},
                                            {0.0, M_PI / 2, 0.0}}) {
      all.push_back({lattice, rotation});
    }
  }
  return all;
}
INSTANTIATE_TEST_SUITE_P(Arrays, EveryArray, testing::ValuesIn(setups()));

}  // namespace
}  // namespace plenocal
