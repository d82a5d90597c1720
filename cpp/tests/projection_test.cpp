// The forward model against numbers worked out by hand. The arithmetic is next to each expectation;
// none of it comes from the functions under test.
//
// With the camera of most tests, a plane at z = 300 mm is imaged at z' = -50*300/250 = -60 mm,
// magnified by -1/5: 1 mm behind the MLA, so a = -1.
#include <ceres/jet.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <tuple>

#include "plenocal/projection.hpp"
#include "simple_camera.hpp"

namespace plenocal {
namespace {

using test::simple_camera;

// Literals have about 12 digits, and the model makes about ten rounding errors in numbers near 1e2:
// both stay well below this tolerance in px (and pitches).
constexpr double kRounding = 1e-9;

Pose at_distance(double z) { return {{0.0, 0.0, 0.0}, {0.0, 0.0, z}}; }

Feature<double> seen(const Camera& camera, const Pose& pose, const Vector3<double>& point, int k,
                     int l) {
  const auto feature = project(camera, pose, point, k, l);
  EXPECT_TRUE(feature);
  return feature.value_or(Feature<double>{NAN, NAN, NAN});
}

void expect_pixel(const Pixel<double>& actual, double u, double v) {
  EXPECT_NEAR(actual.u, u, kRounding);
  EXPECT_NEAR(actual.v, v, kRounding);
}

void expect_feature(const Feature<double>& actual, double u, double v, double rho) {
  expect_pixel({actual.u, actual.v}, u, v);
  EXPECT_NEAR(actual.rho, rho, kRounding);
}

TEST(Projection, OnAxisThroughTheMiddleOfTheArray) {
  const Camera camera = simple_camera();
  // 1/f - 1/a - 1/delta = 1 + 1 - 2 = 0: in focus.
  expect_feature(seen(camera, at_distance(300), {0, 0, 0}, 2, 2), 100, 80, 0);
  expect_pixel(project_center(camera, 2, 2), 100, 80);
}

TEST(Projection, OffAxisThroughTheMiddleOfTheArray) {
  // p' = -(3, 1.5, 300)/5 = (-0.6, -0.3, -60). Half-way from C = (0, 0, -59) to p' the ray meets
  // the sensor, at (-0.3, -0.15): 30 and 15 px from the axis. Right is right and down is down.
  expect_feature(seen(simple_camera(), at_distance(300), {3, 1.5, 0}, 2, 2), 130, 95, 0);
}

TEST(Projection, ThroughANeighbour) {
  // C = (-0.2, 0, -59), as k runs with u and u against x: half-way to p' lies (-0.4, -0.15).
  expect_feature(seen(simple_camera(), at_distance(300), {3, 1.5, 0}, 3, 2), 140, 95, 0);
  // C = (0, -0.2, -59): half-way lies (-0.3, -0.25).
  expect_feature(seen(simple_camera(), at_distance(300), {3, 1.5, 0}, 2, 3), 130, 105, 0);
}

TEST(Projection, BlurBySignOfDefocusOfTheMicroLens) {
  // rho = 0.2/0.02 * 0.5 * (1/f - 1/a - 2) = 5 (1/f - 1).
  Camera camera = simple_camera();
  camera.micro_lens_focal_lengths = {0.8};
  EXPECT_NEAR(seen(camera, at_distance(300), {0, 0, 0}, 2, 2).rho, 1.25, kRounding);
  camera.micro_lens_focal_lengths = {1.25};
  EXPECT_NEAR(seen(camera, at_distance(300), {0, 0, 0}, 2, 2).rho, -1.0, kRounding);
}

TEST(Projection, BlurBySideOfTheFocusOfAPoint) {
  // f = 1 is in focus at 300 mm. Beyond, z' = -50*305/255 = -3050/51, a = 59 - 3050/51 = -41/51,
  // rho = 5 (1 + 51/41 - 2) = 5 * 10/41. Before, z' = -50*275/225 = -550/9, a = -19/9,
  // rho = 5 (9/19 - 1) = -50/19.
  const Camera camera = simple_camera();
  EXPECT_NEAR(seen(camera, at_distance(305), {0, 0, 0}, 2, 2).rho, 1.219512195122, kRounding);
  EXPECT_NEAR(seen(camera, at_distance(275), {0, 0, 0}, 2, 2).rho, -2.631578947368, kRounding);
}

TEST(Projection, KeplerianSideOfTheArray) {
  // z = 350: z' = -50*350/300 = -175/3, in front of the MLA, a = 59 - 175/3 = 2/3; p'_x = -3/6.
  // The ray C -> p' runs on backwards to the sensor: -delta/a = -3/4, x = +0.375, u = 62.5;
  // rho = 5 (1 - 3/2 - 2) = -12.5.
  expect_feature(seen(simple_camera(), at_distance(350), {3, 0, 0}, 2, 2), 62.5, 80, -12.5);
}

TEST(Projection, EachTypeHasItsFocalLength) {
  // Rows hexagonal 3 x 1: types 0, 1, 2 along the row, rho = 5 (1/f - 1) for each.
  Camera camera = simple_camera();
  camera.lattice = {Packing::kHexagonalRowsEven, 3, 1};
  camera.micro_lens_focal_lengths = {1.0, 0.5, 2.0};
  const double expected[] = {0.0, 5.0, -2.5};
  for (int k = 0; k < 3; ++k) {
    EXPECT_NEAR(seen(camera, at_distance(300), {0, 0, 0}, k, 0).rho, expected[k], kRounding);
  }
}

TEST(Projection, PinholeArrayHasNoBlur) {
  Camera camera = simple_camera();
  camera.micro_lens_focal_lengths.clear();
  const Feature<double> feature = seen(camera, at_distance(275), {0, 0, 0}, 2, 2);
  expect_pixel({feature.u, feature.v}, 100, 80);
  EXPECT_TRUE(std::isnan(feature.rho));
}

TEST(Projection, GivesDerivativesToItsUsers) {
  // Through the middle of the array, off axis (see above): u = u0 + 30 px, which grow as the
  // magnification by F/(z - F) = 1/5 does, du/dx = 0.2 * 0.5 / 0.01 = 10 px/mm; du/du0 = 1.
  using Jet = ceres::Jet<double, 2>;
  const Camera camera = simple_camera();
  const auto as_jets = [](auto block) {
    std::array<Jet, std::tuple_size<decltype(block)>::value> jets;
    for (std::size_t i = 0; i < block.size(); ++i) jets[i] = Jet(block[i]);
    return jets;
  };
  const auto lens = as_jets(to_block(camera.main_lens));
  auto array = as_jets(to_block(camera.mla));
  array[0] = Jet(array[0].a, 0);
  const Jet focal_length(1.0);
  const Optics<Jet> optics(from_block<MainLens>(lens.data()),
                           from_block<MicroLensArray>(array.data()), &focal_length, 1,
                           camera.pixel_size);
  const Vector3<Jet> point{Jet(3.0, 1), Jet(1.5), Jet(300.0)};
  const auto feature = project(optics, point, micro_lens_of(camera, 2, 2));
  ASSERT_TRUE(feature);
  EXPECT_NEAR(feature->u.a, 130.0, kRounding);
  EXPECT_NEAR(feature->u.v[0], 1.0, kRounding);
  EXPECT_NEAR(feature->u.v[1], 10.0, kRounding);
  EXPECT_NEAR(feature->v.v[1], 0.0, kRounding);
}

TEST(Projection, PoseTurnsThenMovesTheBoard) {
  // A quarter turn about z takes (1.5, -2, 0) to (2, 1.5, 0), the translation to (3, 1.5, 300).
  const Pose pose{{0.0, 0.0, M_PI / 2}, {1.0, 0.0, 300.0}};
  expect_feature(seen(simple_camera(), pose, {1.5, -2, 0}, 2, 2), 130, 95, 0);
  // About x, y goes to z: (0, 0, 290) + (0, 0, 10); about y, z = -x: again 300 mm on axis.
  const Pose about_x{{M_PI / 2, 0.0, 0.0}, {0.0, 0.0, 290.0}};
  expect_feature(seen(simple_camera(), about_x, {3, 10, 0}, 2, 2), 130, 80, 0);
  const Pose about_y{{0.0, M_PI / 2, 0.0}, {0.0, 1.5, 310.0}};
  expect_feature(seen(simple_camera(), about_y, {10, 0, 0}, 2, 2), 100, 95, 0);
}

TEST(Projection, DistortionMovesTheImageOfTheMainLens) {
  // p' = (-0.6, -0.3), r^2 = 0.45, radial part 0.01*0.45 + 0.002*0.2025 + 0.001*0.091125
  // = 0.004996125.
  // x: -0.6*1.004996125 + P1 (0.45 + 0.72) + P2 * 2*0.18
  //    = -0.602997675 + 0.00351 - 0.00072 = -0.600207675
  // y: -0.3*1.004996125 + P2 (0.45 + 0.18) + P1 * 2*0.18
  //    = -0.3014988375 - 0.00126 + 0.00108 = -0.3016788375
  // The micro-lens in the middle halves them.
  Camera camera = simple_camera();
  camera.main_lens = {50.0, {0.01, 0.002, 0.001}, 0.0, {0.003, -0.002}, 0.0, 0.0, {0.0, 0.0}};
  expect_feature(seen(camera, at_distance(300), {3, 1.5, 0}, 2, 2), 130.01038375, 95.083941875, 0);
}

TEST(Projection, DistortionGrowsWithTheMagnification) {
  // |m| = 0.2, so that the first order is 0.05 * 0.2 and the radial part 0.01 * 0.45 = 0.0045:
  // p' = (-0.6, -0.3) moves to (-0.6027, -0.30135). The micro-lens in the middle halves them.
  Camera camera = simple_camera();
  camera.main_lens.radial_growth = 0.05;
  expect_feature(seen(camera, at_distance(300), {3, 1.5, 0}, 2, 2), 130.135, 95.0675, 0);
}

TEST(Projection, BlurUsesTheGeometricMeanOfTwoPitches) {
  // sqrt(1.21) = 1.1 times the 1.25 px of one pitch; (2, 3) moves by 1.21 pitches, C_y = -0.242,
  // and half-way to p'_y = -0.3 lies -0.271.
  Camera camera = simple_camera();
  camera.micro_lens_focal_lengths = {0.8};
  camera.mla.pitch_ratio = 1.21;
  expect_feature(seen(camera, at_distance(300), {3, 1.5, 0}, 2, 3), 130, 107.1, 1.375);
}

TEST(Projection, TiltChangesDepthOfEachMicroLens) {
  // theta_y with sine 3/5: the array's x axis is (0.8, 0, -0.6), so (3, 2) sits at
  // -0.2 * that = (-0.16, 0, 0.12) from (0, 0, -59). a = -60 + 58.88 = -1.12, delta = 0.62.
  // x = -0.16 + 0.62/1.12 * (-0.6 + 0.16) = -0.403571428571, y = 0.62/1.12 * -0.3
  // = -0.166071428571; rho = 10 (0.62/1 + 0.62/1.12 - 1) = 1.735714285714.
  Camera camera = simple_camera();
  camera.mla.rotation.y = std::asin(0.6);
  expect_feature(seen(camera, at_distance(300), {3, 1.5, 0}, 3, 2), 140.3571428571, 96.6071428571,
                 1.735714285714);
}

TEST(Projection, ArrayTurnsByRzRyRx) {
  // Sines 3/5, 5/13, 8/17 about x, y, z. First column of Rz Ry Rx:
  //   (15/17 * 12/13, 8/17 * 12/13, -5/13) = (180/221, 96/221, -5/13).
  // Second: Ry Rx e_y = Ry (0, 4/5, 3/5) = (3/13, 4/5, 36/65), turned by Rz:
  //   (15/17 * 3/13 - 8/17 * 4/5, 8/17 * 3/13 + 15/17 * 4/5, 36/65)
  //   = (-191/1105, 180/221, 36/65).
  // Steps of -0.2 mm along the first and -0.2 * 1.5 mm along the second.
  Camera camera = simple_camera();
  camera.mla.rotation.x = std::asin(3.0 / 5.0);
  camera.mla.rotation.y = std::asin(5.0 / 13.0);
  camera.mla.rotation.z = std::asin(8.0 / 17.0);
  camera.mla.pitch_ratio = 1.5;
  camera.mla.offset[0] = 0.3;
  camera.mla.offset[1] = -0.1;
  const ArrayOptics<double> optics(camera.mla, camera.pixel_size);
  const Vector3<double> along_x = optics.micro_lens_center({1, 0});
  EXPECT_NEAR(along_x.x, 0.3 - 36.0 / 221.0, kRounding);
  EXPECT_NEAR(along_x.y, -0.1 - 19.2 / 221.0, kRounding);
  EXPECT_NEAR(along_x.z, -59.0 + 1.0 / 13.0, kRounding);
  const Vector3<double> along_y = optics.micro_lens_center({0, 1});
  EXPECT_NEAR(along_y.x, 0.3 + 57.3 / 1105.0, kRounding);
  EXPECT_NEAR(along_y.y, -0.1 - 54.0 / 221.0, kRounding);
  EXPECT_NEAR(along_y.z, -59.0 - 10.8 / 65.0, kRounding);
}

TEST(Projection, MicroImageCentreLiesOnTheRayFromTheMainLens) {
  // (3, 2) at x = -0.2 mm is projected to -0.2 * 59.5/59 = -0.201694915254.
  Camera camera = simple_camera();
  expect_pixel(project_center(camera, 3, 2), 120.1694915254, 80);
  // The array is moved by (0.05, -0.1) mm: the centre of (2, 2) moves by -(5, -10) * 59.5/59 px.
  camera.mla.offset[0] = 0.05;
  camera.mla.offset[1] = -0.1;
  expect_pixel(project_center(camera, 2, 2), 94.9576271186, 90.0847457627);
}

TEST(Projection, MicroImageCentreLiesOnTheRayFromTheExitPupil) {
  // P = (1, -2, -9): (3, 2) at C = (-0.2, 0, -59), the sensor at z = -59.5. From P to C and on:
  // x = 1 - 1.2 * 50.5/50 = -0.212, y = -2 + 2 * 50.5/50 = 0.02.
  Camera camera = simple_camera();
  camera.exit_pupil = {1.0, -2.0, -9.0, 0.0};
  expect_pixel(project_center(camera, 3, 2), 121.2, 78.0);
  // Neighbours are 0.2 * 50.5/50 mm apart; p = 1 - 9/50 and m = 0.5 * 0.82 * 50/(2 * 50).
  const ArrayOptics<double> optics(camera.mla, camera.pixel_size);
  EXPECT_NEAR(optics.micro_image_pitch(camera.exit_pupil), 20.2, kRounding);
  EXPECT_NEAR(pupil_magnification(camera.main_lens, camera.exit_pupil), 0.82, kRounding);
  EXPECT_NEAR(micro_image_slope(camera.main_lens, camera.exit_pupil, camera.mla), 0.205, kRounding);
  // Seen from this micro-lens, at r^2 = 1.2^2 + 2^2, an aberrated pupil is at z = -34: x = 1 - 1.2
  // * 25.5/25 = -0.224, y = -2 + 2 * 25.5/25 = 0.04.
  camera.exit_pupil.aberration = -25.0 / 5.44;
  expect_pixel(project_center(camera, 3, 2), 122.4, 76.0);
  // Features do not depend on it.
  const auto at_lens = seen(simple_camera(), at_distance(300), {3, 1.5, 0}, 2, 2);
  expect_feature(seen(camera, at_distance(300), {3, 1.5, 0}, 2, 2), at_lens.u, at_lens.v,
                 at_lens.rho);
}

TEST(Projection, CurvedFieldMovesImagesTowardsTheLens) {
  // (3, 1.5, 300) is imaged at (-0.6, -0.3, -60); 0.4 mm^-1 * 0.45 mm^2 nearer, at -59.82.
  MainLens<double> lens{};
  lens.focal_length = 50.0;
  lens.field_curvature = 0.4;
  auto image = main_lens_image(lens, {3.0, 1.5, 300.0});
  ASSERT_TRUE(image);
  EXPECT_NEAR(image->x, -0.6, kRounding);
  EXPECT_NEAR(image->y, -0.3, kRounding);
  EXPECT_NEAR(image->z, -59.82, kRounding);
  // |m| is 0.2: 0.4 + 0.5 * 0.2 = 0.5.
  lens.field_curvature_growth = 0.5;
  image = main_lens_image(lens, {3.0, 1.5, 300.0});
  ASSERT_TRUE(image);
  EXPECT_NEAR(image->z, -59.775, kRounding);
}

TEST(Projection, TiltedLensImagesAlongItsAxis) {
  // The axis is turned by Ry(0.5): it points along (sin 0.5, 0, cos 0.5). A point on it at 300 mm
  // is imaged on it at -60 mm.
  MainLens<double> lens{};
  lens.focal_length = 50.0;
  lens.rotation[1] = 0.5;
  const double sine = std::sin(0.5), cosine = std::cos(0.5);
  auto image = main_lens_image(lens, {300.0 * sine, 0.0, 300.0 * cosine});
  ASSERT_TRUE(image);
  EXPECT_NEAR(image->x, -60.0 * sine, kRounding);
  EXPECT_NEAR(image->y, 0.0, kRounding);
  EXPECT_NEAR(image->z, -60.0 * cosine, kRounding);
  // By Scheimpflug's rule, the plane z = 300 and its image meet in the plane of the lens: at
  // x = 300 cot 0.5. The image of (0, 0, 300) is at -50/(300 cos 0.5 - 50) times 300.
  image = main_lens_image(lens, {0.0, 0.0, 300.0});
  ASSERT_TRUE(image);
  const auto other = main_lens_image(lens, {-10.0, 0.0, 300.0});
  ASSERT_TRUE(other);
  EXPECT_NEAR(image->z, -15000.0 / (300.0 * cosine - 50.0), kRounding);
  const double slope = (other->z - image->z) / (other->x - image->x);
  const double x = 300.0 * cosine / sine;
  EXPECT_NEAR(image->z + slope * (-x - image->x), 300.0, 1e-9);
  // For both angles, the axis Ry Rx (0, 0, 1)' is (sin y cos x, -sin x, cos y cos x).
  lens.rotation[0] = 0.2;
  const Vector3<double> axis = LensFrame<double>(lens).to_camera({0.0, 0.0, 1.0});
  EXPECT_NEAR(axis.x, sine * std::cos(0.2), kRounding);
  EXPECT_NEAR(axis.y, -std::sin(0.2), kRounding);
  EXPECT_NEAR(axis.z, cosine * std::cos(0.2), kRounding);
}

TEST(Projection, PupilLiesOnTheAxisOfATiltedLens) {
  // 10 mm behind O on the axis, it is at (-6, 0, -8): (3, 2) at C = (-0.2, 0, -59), the sensor at
  // z = -59.5. x = -6 + 5.8 * 51.5/51.
  Camera camera = simple_camera();
  camera.exit_pupil = {0.0, 0.0, -10.0, 0.0};
  camera.main_lens.rotation[1] = std::asin(0.6);
  expect_pixel(project_center(camera, 3, 2), 100.0 + 100.0 * (6.0 - 5.8 * 51.5 / 51.0), 80.0);
}

TEST(Projection, IndicesGrowWithThePixels) {
  for (Packing packing :
       {Packing::kOrthogonal, Packing::kHexagonalRowsEven, Packing::kHexagonalRowsOdd,
        Packing::kHexagonalColumnsEven, Packing::kHexagonalColumnsOdd}) {
    Camera camera = simple_camera();
    camera.lattice.packing = packing;
    for (int i = 0; i + 1 < 5; ++i) {
      EXPECT_GT(project_center(camera, i + 1, 2).u, project_center(camera, i, 2).u);
      EXPECT_GT(project_center(camera, 2, i + 1).v, project_center(camera, 2, i).v);
    }
  }
}

TEST(Projection, UndefinedPointsHaveNoFeature) {
  const Camera camera = simple_camera();
  const double nan = std::numeric_limits<double>::quiet_NaN();
  for (double z : {50.0, 49.0, 0.0, -300.0, nan}) {
    EXPECT_FALSE(project(camera, at_distance(z), {0, 0, 0}, 2, 2)) << z;
  }
  // 2F is imaged at 2F, onto the micro-lens when D = 2F; 100 and 1 are exact in binary.
  Camera at_array = simple_camera();
  at_array.mla.lens_to_mla = 100.0;
  EXPECT_FALSE(project(at_array, at_distance(100), {0, 0, 0}, 2, 2));
}

TEST(Lattice, NodesByHand) {
  const double height = 0.866025403784;  // sqrt(3)/2
  // 3 x 2, even rows shifted: x in 0.5..2.5 and 0..2, so 1.25 is the middle; y in 0..0.866.
  const Lattice rows{Packing::kHexagonalRowsEven, 3, 2};
  EXPECT_NEAR(rows.node(0, 0).x, -0.75, kRounding);
  EXPECT_NEAR(rows.node(0, 1).x, -1.25, kRounding);
  EXPECT_NEAR(rows.node(2, 1).x, 0.75, kRounding);
  EXPECT_NEAR(rows.node(2, 1).y, height / 2, kRounding);
  const Lattice columns{Packing::kHexagonalColumnsOdd, 2, 3};
  EXPECT_NEAR(columns.node(0, 0).y, -1.25, kRounding);
  EXPECT_NEAR(columns.node(1, 0).y, -0.75, kRounding);
  EXPECT_NEAR(columns.node(0, 2).x, -height / 2, kRounding);
  const Lattice square{Packing::kOrthogonal, 4, 3};
  EXPECT_NEAR(square.node(3, 0).x, 1.5, kRounding);
  EXPECT_NEAR(square.node(3, 0).y, -1.0, kRounding);
}

// Without another row beside it, a shifted row is centred like any other.
TEST(Lattice, SingleShiftedRowIsCentred) {
  const Lattice row{Packing::kHexagonalRowsEven, 4, 1};
  EXPECT_NEAR(row.node(0, 0).x, -1.5, kRounding);
  EXPECT_NEAR(row.node(3, 0).x, 1.5, kRounding);
  const Lattice column{Packing::kHexagonalColumnsEven, 1, 4};
  EXPECT_NEAR(column.node(0, 0).y, -1.5, kRounding);
  EXPECT_NEAR(column.node(0, 3).y, 1.5, kRounding);
}

TEST(Lattice, ContainsItsIndicesOnly) {
  const Lattice lattice{Packing::kOrthogonal, 4, 3};
  EXPECT_TRUE(lattice.contains(0, 0));
  EXPECT_TRUE(lattice.contains(3, 2));
  EXPECT_FALSE(lattice.contains(4, 2));
  EXPECT_FALSE(lattice.contains(3, 3));
  EXPECT_FALSE(lattice.contains(-1, 0));
  EXPECT_FALSE(lattice.contains(0, -1));
}

TEST(Lattice, TypesFollowTheR12Rule) {
  // (l mod 2 + k) mod 3 if the even rows are shifted.
  const Lattice lattice{Packing::kHexagonalRowsEven, 6, 4};
  const int expected[4][6] = {
      {0, 1, 2, 0, 1, 2}, {1, 2, 0, 1, 2, 0}, {0, 1, 2, 0, 1, 2}, {1, 2, 0, 1, 2, 0}};
  for (int l = 0; l < 4; ++l) {
    for (int k = 0; k < 6; ++k) {
      EXPECT_EQ(lattice.lens_type(k, l, 3), expected[l][k]);
      EXPECT_EQ(lattice.lens_type(k, l, 1), 0);
    }
  }
}

class EveryLattice : public testing::TestWithParam<Lattice> {
 protected:
  static double distance(const Node& a, const Node& b) { return std::hypot(a.x - b.x, a.y - b.y); }
};

TEST_P(EveryLattice, IsCentred) {
  const Lattice& lattice = GetParam();
  double left = 1e9, right = -1e9, top = 1e9, bottom = -1e9;
  for (int l = 0; l < lattice.rows; ++l) {
    for (int k = 0; k < lattice.columns; ++k) {
      const Node node = lattice.node(k, l);
      left = std::min(left, node.x);
      right = std::max(right, node.x);
      top = std::min(top, node.y);
      bottom = std::max(bottom, node.y);
    }
  }
  EXPECT_NEAR(left + right, 0.0, kRounding);
  EXPECT_NEAR(top + bottom, 0.0, kRounding);
}

TEST_P(EveryLattice, NearestNeighboursAreAtDistanceOneAndOfOtherTypes) {
  const Lattice& lattice = GetParam();
  const bool hexagonal = lattice.packing != Packing::kOrthogonal;
  for (int l = 0; l < lattice.rows; ++l) {
    for (int k = 0; k < lattice.columns; ++k) {
      int neighbours = 0;
      for (int m = 0; m < lattice.rows; ++m) {
        for (int n = 0; n < lattice.columns; ++n) {
          if (m == l && n == k) continue;
          const double apart = distance(lattice.node(k, l), lattice.node(n, m));
          ASSERT_GT(apart, 1.0 - kRounding) << k << ' ' << l << ' ' << n << ' ' << m;
          if (apart > 1.0 + kRounding) continue;
          ++neighbours;
          if (hexagonal) {
            EXPECT_NE(lattice.lens_type(k, l, 3), lattice.lens_type(n, m, 3));
          }
        }
      }
      const bool inside = k > 0 && l > 0 && k + 1 < lattice.columns && l + 1 < lattice.rows;
      if (inside) {
        EXPECT_EQ(neighbours, hexagonal ? 6 : 4) << k << ' ' << l;
      }
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Lattices, EveryLattice,
                         testing::Values(Lattice{Packing::kOrthogonal, 5, 4},
                                         Lattice{Packing::kHexagonalRowsEven, 7, 6},
                                         Lattice{Packing::kHexagonalRowsOdd, 6, 7},
                                         Lattice{Packing::kHexagonalColumnsEven, 7, 6},
                                         Lattice{Packing::kHexagonalColumnsOdd, 6, 7},
                                         Lattice{Packing::kHexagonalRowsOdd, 4, 1},
                                         Lattice{Packing::kHexagonalColumnsOdd, 1, 4}));

}  // namespace
}  // namespace plenocal
