// A board that is bent and stretched: by hand, its derivatives, its recovery, and that it costs
// nothing where it is known.
#include "plenocal/board.hpp"

#include <ceres/gradient_checker.h>
#include <gtest/gtest.h>

#include "plenocal/residuals.hpp"
#include "rejection.hpp"
#include "synthetic_scene.hpp"

namespace plenocal {
namespace {

using test::expect_names;
using test::expect_near_relative;
using test::kShape;
using test::rejection;
using test::Scene;

constexpr int kColumns = 7, kRows = 6;
constexpr double kSquare = 1.4;
// In mm, the last without unit: some tenths of a per cent of the board, far more than a real one.
constexpr BoardShape<double> kBent = {0.05, -0.03, 0.04, 0.004};

Board board(const BoardShape<double>& shape = {}) {
  return {kSquare * (kColumns - 1) / 2.0, kSquare * (kRows - 1) / 2.0, shape};
}

Vector3<double> flat_corner(int i) {
  return {kSquare * (i % kColumns), kSquare * (i / kColumns), 0.0};
}

// One board in all frames, seen in the micro-images that show it.
Scene bent_scene(int types, const BoardShape<double>& shape) {
  Scene scene{test::scene_camera(types), test::scene_poses(), {}};
  for (Pose& pose : scene.poses) {
    const Motion<double> turn(pose_block(pose).data());
    const Vector3<double> middle = turn({board().half_width, board().half_height, 0.0});
    pose.translation.x += pose.translation.x - middle.x;
    pose.translation.y += pose.translation.y - middle.y;
    pose.translation.z += pose.translation.z - middle.z;
  }
  scene.observations.board = board(shape);
  const double radius = 0.45 * scene.camera.mla.pitch / scene.camera.pixel_size;
  for (int l = 0; l < scene.camera.lattice.rows; ++l) {
    for (int k = 0; k < scene.camera.lattice.columns; ++k) {
      const Pixel<double> center = project_center(scene.camera, k, l);
      scene.observations.centers.push_back({k, l, center, 1.0});
      for (std::size_t frame = 0; frame < scene.poses.size(); ++frame) {
        for (int i = 0; i < kColumns * kRows; ++i) {
          const auto corner = corner_of(scene.observations.board, flat_corner(i));
          const auto feature = project(scene.camera, scene.poses[frame], corner, k, l);
          if (feature && std::hypot(feature->u - center.u, feature->v - center.v) < radius) {
            scene.observations.features.push_back(
                {static_cast<int>(frame), flat_corner(i), k, l, *feature, {1.0, 1.0, 1.0}});
          }
        }
      }
    }
  }
  return scene;
}

CostOptions free_shape() {
  CostOptions options;
  options.free(test::kShape);
  return options;
}

std::vector<double> values(const BoardShape<double>& shape) {
  const auto block = to_block(shape);
  return {block.begin(), block.end()};
}

TEST(BoardShape, CornersByHand) {
  // 5 x 3 corners of 10 mm: half 20 and 10 mm.
  const Board bent{20.0, 10.0, {0.4, 0.3, 0.2, 0.02}};
  const auto expect = [&bent](Vector3<double> flat, Vector3<double> there) {
    const Vector3<double> corner = corner_of(bent, flat);
    EXPECT_DOUBLE_EQ(corner.x, there.x);
    EXPECT_DOUBLE_EQ(corner.y, there.y);
    EXPECT_DOUBLE_EQ(corner.z, there.z);
  };
  expect({0.0, 0.0, 0.0}, {0.0, 0.0, 0.4 + 0.3 + 0.2});
  expect({40.0, 0.0, 0.0}, {40.4, 0.0, 0.4 + 0.3 - 0.2});
  expect({40.0, 20.0, 1.0}, {40.4, 19.8, 1.0 + 0.4 + 0.3 + 0.2});
  expect({20.0, 10.0, 0.0}, {20.2, 9.9, 0.0});
  expect({10.0, 10.0, 0.0}, {10.1, 9.9, 0.1});
  // A flat board needs no size.
  const Vector3<double> flat = corner_of(Board{}, {3.0, 4.0, 0.0});
  EXPECT_EQ(flat.x, 3.0);
  EXPECT_EQ(flat.y, 4.0);
  EXPECT_EQ(flat.z, 0.0);
}

TEST(BoardShape, ItsParametersComeAfterThoseOfTheCamera) {
  for (int types : {0, 1, 3}) {
    auto names = intrinsic_names(types);
    names.insert(names.end(), kShape.begin(), kShape.end());
    EXPECT_EQ(shared_names(types), names);
  }
}

template <int I>
void expect_gradients() {
  // Ridders' finite differences, as in residuals_test.cpp.
  constexpr double kTolerance = 1e-4, kStep = 1e-5;
  const Scene scene = bent_scene(I, kBent);
  const Pose& pose = scene.poses[1];
  std::vector<WeightedFeature> features;
  for (std::size_t i = 7; features.size() < 12; i += 29) {
    FeatureObservation o = scene.observations.features[i];
    if (o.frame != 1) continue;
    // All residuals differ from zero, and so do their derivatives.
    o.observed.u += 0.3;
    o.observed.v -= 0.25;
    o.observed.rho -= 0.2;
    features.push_back(
        {o.board_point, micro_lens_of(scene.camera, o.k, o.l), o.observed, {1.0, 1.5, 2.0}});
  }
  const auto cost = FeatureResiduals<I, true>::create(features, scene.camera.pixel_size,
                                                      {LossKind::kCauchy, 1.0}, board());
  const auto lens = to_block(scene.camera.main_lens);
  const auto array = to_block(scene.camera.mla);
  const auto shape = to_block(kBent);
  const auto block = pose_block(pose);
  std::vector<const double*> blocks = {lens.data(), array.data()};
  if (I > 0) blocks.push_back(scene.camera.micro_lens_focal_lengths.data());
  blocks.push_back(shape.data());
  blocks.push_back(block.data());
  const std::vector<const ceres::Manifold*>* euclidean = nullptr;
  ceres::NumericDiffOptions options;
  options.ridders_relative_initial_step_size = kStep;
  const ceres::GradientChecker checker(cost.get(), euclidean, options);
  ceres::GradientChecker::ProbeResults results;
  EXPECT_TRUE(checker.Probe(blocks.data(), kTolerance, &results)) << results.error_log;
}

TEST(BoardShape, GradientsOfPinholes) { expect_gradients<0>(); }
TEST(BoardShape, GradientsOfOneType) { expect_gradients<1>(); }
TEST(BoardShape, GradientsOfThreeTypes) { expect_gradients<3>(); }

class BoardRecovery : public testing::TestWithParam<int> {};

TEST_P(BoardRecovery, OfShapeAndCameraWithoutNoise) {
  constexpr double kRecovery = 1e-7;
  const Scene truth = bent_scene(GetParam(), kBent);
  Scene start = truth;
  start.observations.board.shape = {};
  auto camera = test::intrinsics(start.camera);
  camera[0] *= 1.005;
  start.camera = test::with_intrinsics(start.camera, camera);
  const Refinement result = refine(start.camera, start.poses, start.observations, free_shape(), {});
  EXPECT_EQ(result.termination, Termination::kConverged) << result.message;
  for (std::size_t i = 0; i < kShape.size(); ++i) {
    expect_near_relative(values(result.board_shape)[i], values(kBent)[i], kRecovery, kShape[i]);
  }
  expect_near_relative(result.camera.main_lens.focal_length, truth.camera.main_lens.focal_length,
                       kRecovery, "F");
  // A flat board cannot fit this.
  const Refinement flat = refine(start.camera, start.poses, start.observations, test::paper(), {});
  EXPECT_GT(flat.cost, 1.0);
  EXPECT_EQ(values(flat.board_shape), values({}));
}

INSTANTIATE_TEST_SUITE_P(LensTypes, BoardRecovery, testing::Values(0, 1, 3));

TEST(BoardShape, AKnownOneIsThatOfCornersWhereTheyAre) {
  Scene scene = bent_scene(3, kBent);
  test::add_noise(0.1, 0.05, 0.02, 3, &scene.observations);
  Scene placed = scene;
  placed.observations.board = {};
  for (FeatureObservation& o : placed.observations.features) {
    o.board_point = corner_of(board(kBent), o.board_point);
  }
  const CostOptions options = test::paper();
  const Refinement known = refine(scene.camera, scene.poses, scene.observations, options, {});
  const Refinement expected = refine(placed.camera, placed.poses, placed.observations, options, {});
  EXPECT_EQ(known.termination, Termination::kConverged);
  expect_near_relative(known.cost, expected.cost, 1e-10, "cost");
  EXPECT_EQ(values(known.board_shape), values(kBent));
  const Uncertainty u = uncertainty(known.camera, known.poses, scene.observations, options);
  EXPECT_EQ(u.size, 19 + 6 * 7);
}

TEST(BoardShape, FreeParametersAreCountedAfterTheIntrinsics) {
  Scene scene = bent_scene(3, kBent);
  test::add_noise(0.1, 0.05, 0.02, 3, &scene.observations);
  CostOptions options;
  options.free({"sag_x", "sag_y", "aspect"});
  const Refinement result = refine(scene.camera, scene.poses, scene.observations, options, {});
  EXPECT_EQ(result.board_shape.twist, kBent.twist);
  EXPECT_NE(result.board_shape.sag_x, kBent.sag_x);
  scene.observations.board.shape = result.board_shape;
  const Uncertainty u = uncertainty(result.camera, result.poses, scene.observations, options);
  EXPECT_EQ(u.size, 19 + 3 + 6 * 7);
  EXPECT_EQ(u.rank, u.size);
  ASSERT_EQ(u.free_intrinsics.size(), 22U);
  EXPECT_EQ(std::vector<int>(u.free_intrinsics.end() - 3, u.free_intrinsics.end()),
            (std::vector<int>{29, 30, 32}));
  const auto information =
      frame_information(result.camera, result.poses, scene.observations, options);
  EXPECT_EQ(information.size(), 7U);
  for (const Matrix& of_frame : information) {
    EXPECT_EQ(of_frame.rows, 22);
    EXPECT_EQ(of_frame.columns, 22);
  }
}

TEST(BoardShape, ErrorsAreWithinTheUncertainty) {
  constexpr double kFourSigma = 4.0;
  CostOptions options = free_shape();
  options.uv_std_dev = options.rho_std_dev = options.centers_std_dev = 0.1;
  for (unsigned seed = 1; seed <= 5; ++seed) {
    Scene scene = bent_scene(3, kBent);
    test::add_noise(0.1, 0.1, 0.1, seed, &scene.observations);
    const Refinement result = refine(scene.camera, scene.poses, scene.observations, options, {});
    scene.observations.board.shape = result.board_shape;
    const Uncertainty u = uncertainty(result.camera, result.poses, scene.observations, options);
    for (std::size_t i = 0; i < kShape.size(); ++i) {
      const int row = 19 + static_cast<int>(i);
      const double std_dev = std::sqrt(u.independent_covariance(row, row));
      const double error = values(result.board_shape)[i] - values(kBent)[i];
      EXPECT_LT(std::abs(error), kFourSigma * std_dev) << kShape[i];
      // And the uncertainty is worth something.
      EXPECT_LT(std_dev, std::abs(values(kBent)[i])) << kShape[i];
    }
  }
}

TEST(BoardShape, APriorHoldsIt) {
  Scene scene = bent_scene(3, kBent);
  test::add_noise(0.1, 0.05, 0.02, 3, &scene.observations);
  CostOptions options = free_shape();
  options.priors = {{"sag_y", 0.02, 1e-9}};
  const Refinement result = refine(scene.camera, scene.poses, scene.observations, options, {});
  EXPECT_NEAR(result.board_shape.sag_y, 0.02, 1e-9);
  options.fix({"sag_y"});
  expect_names(
      rejection([&] { refine(scene.camera, scene.poses, scene.observations, options, {}); }),
      "sag_y has no effect");
}

TEST(BoardShape, ImpossibleOnesAreNamed) {
  const auto refused = [](const Board& board, const CostOptions& options = {}) {
    Scene scene = bent_scene(3, {});
    scene.observations.board = board;
    SolverOptions solver;
    solver.max_iterations = 1;
    return rejection(
        [&] { refine(scene.camera, scene.poses, scene.observations, options, solver); });
  };
  // Half the diagonal of 4.2 x 3.5 mm is 5.467 mm.
  expect_names(refused(board({5.5, 0.0, 0.0, 0.0})), "sag_x is 5.5 mm");
  expect_names(refused(board({0.0, -6.0, 0.0, 0.0})), "sag_y is -6 mm");
  expect_names(refused(board({0.0, 0.0, 5.5, 0.0})), "twist is 5.5 mm");
  expect_names(refused(board({0.0, 0.0, 0.0, -0.1})), "aspect is -0.1");
  expect_names(refused(board({NAN, 0.0, 0.0, 0.0})), "sag_x is not a finite number");
  expect_names(refused(board({0.0, 0.0, 0.0, INFINITY})), "aspect is not a finite number");
  expect_names(refused({0.0, 3.0, {0.1, 0.0, 0.0, 0.0}}), "half its width is 0 mm");
  expect_names(refused({3.0, -1.0, {}}, free_shape()), "half its height is -1 mm");
  EXPECT_EQ("(accepted)", refused(board({5.4, 0.0, 0.0, 0.09})));
  EXPECT_EQ("(accepted)", refused({}));
}

}  // namespace
}  // namespace plenocal
