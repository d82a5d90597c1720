// The cost functors: zero at the truth, computed by hand elsewhere; derivatives against finite
// differences, the loss against that of Ceres, and grouping without effect on the values.
#include "plenocal/residuals.hpp"

#include <ceres/gradient_checker.h>
#include <gtest/gtest.h>

#include "random_observations.hpp"
#include "synthetic_scene.hpp"

namespace plenocal {
namespace {

// Rounding of pixels near 1e3, in px or standard deviations.
constexpr double kRounding = 1e-10;
// Relative. Ridders' finite differences are good to 1e-8 px per unit; the smallest derivatives here
// are near 4e-4, and the worst agreement measured is 1.2e-5.
constexpr double kGradientTolerance = 1e-4;
// Also the smallest absolute step. Ceres' default of 1e-2 would take F and D through the pole of
// the model at a = 0, and residuals across the kink of a Huber loss.
constexpr double kRiddersStep = 1e-5;

// A handful of roundings and the truncated series of apply_loss, relative to rho(s) ...
constexpr double kLossTolerance = 1e-11;
// ... and in units of scale^2 what log(1 + x) loses when it rounds 1 + x.
constexpr double kLossRounding = 4e-16;

constexpr LossKind kLosses[] = {LossKind::kNone, LossKind::kHuber, LossKind::kCauchy};

std::vector<double> evaluate(const ceres::CostFunction& cost,
                             const std::vector<const double*>& blocks) {
  std::vector<double> residuals(cost.num_residuals(), NAN);
  EXPECT_TRUE(cost.Evaluate(blocks.data(), residuals.data(), nullptr));
  return residuals;
}

// Camera and pose as parameter blocks.
struct Blocks {
  std::array<double, kMainLensParameters> lens;
  std::array<double, kArrayParameters> array;
  std::vector<double> focal_lengths;
  std::array<double, 6> pose;

  Blocks(const Camera& camera, const Pose& camera_from_board)
      : lens(to_block(camera.main_lens)),
        array(to_block(camera.mla)),
        focal_lengths(camera.micro_lens_focal_lengths),
        pose(pose_block(camera_from_board)) {}

  std::vector<const double*> pointers() const {
    std::vector<const double*> blocks = {lens.data(), array.data()};
    if (!focal_lengths.empty()) blocks.push_back(focal_lengths.data());
    blocks.push_back(pose.data());
    return blocks;
  }
};

// The simple camera of projection_test.cpp with two hexagonal rows of two micro-lenses: (0,
// 1) and (1, 1) lie at x = +0.15 and -0.05 mm, (0, 0) and (1, 0) at +0.05 and -0.15 mm.
Camera simple_camera(int types) {
  Camera camera;
  camera.lattice = {Packing::kHexagonalRowsEven, 2, 2};
  camera.pixel_size = 0.01;
  camera.main_lens.focal_length = 50.0;
  camera.mla = {{100.0, 80.0}, 0.5, {0.0, 0.0, 0.0}, {0.0, 0.0}, 59.0, 0.2, 1.0};
  const std::vector<double> focal_lengths = {1.0, 0.8, 1.25};
  camera.micro_lens_focal_lengths.assign(focal_lengths.begin(), focal_lengths.begin() + types);
  return camera;
}

const Pose kSimplePose{{0.0, 0.0, 0.0}, {0.0, 0.0, 300.0}};

// The feature of (3, 1.5, 0) through micro-lens (1, 0), of type 1. p' = (-0.6, -0.3, -60),
// C = (-0.15, +0.0866025403784, -59), half-way: (-0.375, -0.1066987298108), so u = 137.5 and
// v = 90.66987298108; rho = 10 (0.5/f + 0.5 - 1): 0 for f = 1, 1.25 for f = 0.8.
const Vector3<double> kSimplePoint = {3.0, 1.5, 0.0};
constexpr double kSimpleU = 137.5;
constexpr double kSimpleV = 90.66987298108;
constexpr double kSimpleRho[] = {0.0, 0.0, 0.0, 1.25};  // by number of types

WeightedFeature simple_feature(const Camera& camera, double du, double dv, double drho,
                               const Feature<double>& weight = {1.0, 1.0, 1.0}) {
  const int types = camera.lens_types();
  return {kSimplePoint,
          micro_lens_of(camera, 1, 0),
          {kSimpleU + du, kSimpleV + dv, kSimpleRho[types] + drho},
          weight};
}

template <int I>
void expect_features_by_hand() {
  const Camera camera = simple_camera(I);
  const Blocks blocks(camera, kSimplePose);
  // Residuals are projected minus observed, each times its own weight. No loss.
  const auto cost =
      FeatureResiduals<I>::create({simple_feature(camera, 0, 0, 0, {2.0, 2.0, 8.0}),
                                   simple_feature(camera, 1.0, -3.0, 0.25, {2.0, 2.0, 8.0}),
                                   simple_feature(camera, 1.0, -3.0, 0.25, {4.0, 0.5, 2.0})},
                                  0.01, {});
  const std::vector<double> residuals = evaluate(*cost, blocks.pointers());
  const std::vector<double> expected = I == 0
                                           ? std::vector<double>{0, 0, -2, 6, -4, 1.5}
                                           : std::vector<double>{0, 0, 0, -2, 6, -2, -4, 1.5, -0.5};
  ASSERT_EQ(residuals.size(), expected.size());
  for (std::size_t i = 0; i < expected.size(); ++i) {
    EXPECT_NEAR(residuals[i], expected[i], kRounding) << i;
  }
}

TEST(FeatureResiduals, PinholesByHand) { expect_features_by_hand<0>(); }
TEST(FeatureResiduals, OneTypeByHand) { expect_features_by_hand<1>(); }
TEST(FeatureResiduals, ThreeTypesByHand) { expect_features_by_hand<3>(); }

TEST(FeatureResiduals, LossScalesTheWholeFeature) {
  // |(-2, 6, -3)| = 7, Huber at 1: the norm becomes sqrt(2*7 - 1), the direction stays.
  const Camera camera = simple_camera(3);
  const auto cost = FeatureResiduals<3>::create(
      {simple_feature(camera, 1.0, -3.0, 0.375, {2.0, 2.0, 8.0})}, 0.01, {LossKind::kHuber, 1.0});
  const auto residuals = evaluate(*cost, Blocks(camera, kSimplePose).pointers());
  const double factor = 0.515078753637713;  // sqrt(13)/7
  EXPECT_NEAR(residuals[0], -2 * factor, kRounding);
  EXPECT_NEAR(residuals[1], 6 * factor, kRounding);
  EXPECT_NEAR(residuals[2], -3 * factor, kRounding);
}

TEST(FeatureResiduals, UndefinedPointFailsTheBlock) {
  const Camera camera = simple_camera(3);
  const auto cost = FeatureResiduals<3>::create({simple_feature(camera, 0, 0, 0)}, 0.01, {});
  double residuals[3];
  const Blocks blocks(camera, {{0.0, 0.0, 0.0}, {0.0, 0.0, 49.0}});
  EXPECT_FALSE(cost->Evaluate(blocks.pointers().data(), residuals, nullptr));
}

TEST(CenterResiduals, ByHand) {
  // (0, 1) lies at (+0.15, -0.0866025403784) mm, projected to 59.5/59 times that:
  // u = 100 - 15.1271186441, v = 80 + 8.7336460212.
  const Camera camera = simple_camera(0);
  const Node node = camera.lattice.node(0, 1);
  const auto cost = CenterResiduals::create({{node, {84.8728813559322, 88.7336460211998}, 4.0},
                                             {node, {85.8728813559322, 88.2336460211998}, 4.0},
                                             {node, {85.8728813559322, 88.2336460211998}, 0.5}},
                                            0.01, {});
  const auto lens = to_block(camera.main_lens);
  const auto pupil = to_block(camera.exit_pupil);
  const auto array = to_block(camera.mla);
  const auto residuals = evaluate(*cost, {lens.data(), pupil.data(), array.data()});
  const double expected[] = {0, 0, -4, 2, -0.5, 0.25};
  for (int i = 0; i < 6; ++i) EXPECT_NEAR(residuals[i], expected[i], kRounding) << i;
}

TEST(ApplyLoss, AgreesWithCeres) {
  for (double scale : {0.3, 1.0, 2.5}) {
    const ceres::HuberLoss huber(scale);
    const ceres::CauchyLoss cauchy(scale);
    // s / scale^2 on both sides of the kinks at 1 (Huber) and 1e-6 (series of Cauchy).
    for (double x : {1e-12, 0.9e-6, 1.1e-6, 1e-3, 0.5, 0.999, 1.001, 4.0, 1e3, 1e8}) {
      for (int n = 1; n <= 3; ++n) {
        const double s = x * scale * scale;
        const auto squared_norm = [&](LossKind kind) {
          std::array<double, 3> r;
          r.fill(-std::sqrt(s / n));
          apply_loss({kind, scale}, n, r.data());
          double sum = 0.0;
          for (int i = 0; i < n; ++i) sum += r[i] * r[i];
          return sum;
        };
        const double rounding = kLossRounding * scale * scale;
        double rho[3];
        huber.Evaluate(s, rho);
        EXPECT_NEAR(squared_norm(LossKind::kHuber), rho[0], kLossTolerance * rho[0]) << x;
        cauchy.Evaluate(s, rho);
        EXPECT_NEAR(squared_norm(LossKind::kCauchy), rho[0], kLossTolerance * rho[0] + rounding)
            << x;
        EXPECT_NEAR(squared_norm(LossKind::kNone), s, kLossTolerance * s) << x;
      }
    }
  }
}

TEST(ApplyLoss, ZeroHasAFiniteDerivative) {
  // Both losses are s near 0, so a residual of 0 keeps its derivative.
  using Jet = ceres::Jet<double, 2>;
  for (LossKind kind : kLosses) {
    Jet r[2] = {Jet(0.0, 0), Jet(0.0, 1)};
    apply_loss<Jet>({kind, 1.0}, 2, r);
    for (int i = 0; i < 2; ++i) {
      EXPECT_EQ(r[i].a, 0.0);
      EXPECT_EQ(r[i].v[i], 1.0);
      EXPECT_EQ(r[i].v[1 - i], 0.0);
    }
  }
}

void expect_gradients(const ceres::CostFunction& cost, const std::vector<const double*>& blocks) {
  const std::vector<const ceres::Manifold*>* euclidean = nullptr;
  ceres::NumericDiffOptions options;
  options.ridders_relative_initial_step_size = kRiddersStep;
  const ceres::GradientChecker checker(&cost, euclidean, options);
  ceres::GradientChecker::ProbeResults results;
  EXPECT_TRUE(checker.Probe(blocks.data(), kGradientTolerance, &results)) << results.error_log;
}

template <int I>
void expect_feature_gradients() {
  for (unsigned seed = 1; seed <= 5; ++seed) {
    test::RandomObservations random(seed);
    const Camera camera = random.camera(I);
    const Pose pose = random.pose();
    const auto features = random.features(camera, pose, 6);
    const Blocks blocks(camera, pose);
    for (LossKind loss : kLosses) {
      SCOPED_TRACE(testing::Message() << "seed " << seed << " loss " << static_cast<int>(loss));
      const auto cost = FeatureResiduals<I>::create(features, camera.pixel_size, {loss, 1.0});
      expect_gradients(*cost, blocks.pointers());
    }
  }
}

TEST(Gradients, Pinholes) { expect_feature_gradients<0>(); }
TEST(Gradients, OneType) { expect_feature_gradients<1>(); }
TEST(Gradients, ThreeTypes) { expect_feature_gradients<3>(); }

// In a rig the chain rule has two poses before the image: against Jets of all parameters at once.
template <int I>
void expect_derivatives_in_rig() {
  using Functor = FeatureResiduals<I, false, true>;
  constexpr int kLens = kMainLensParameters, kArray = kArrayParameters, kPose = Pose::kSize;
  test::RandomObservations random(11);
  const Camera camera = random.camera(I);
  const Pose pose = random.pose();
  const auto features = random.features(camera, pose, 6);
  const Loss loss{LossKind::kCauchy, 1.0};
  const auto ours = Functor::create(features, camera.pixel_size, loss);
  auto* functor = new Functor(features, camera.pixel_size, loss);
  const int n = ours->num_residuals();
  std::unique_ptr<ceres::CostFunction> whole;
  if constexpr (I > 0) {
    whole = std::make_unique<
        ceres::AutoDiffCostFunction<Functor, ceres::DYNAMIC, kLens, kArray, I, kPose, kPose>>(
        functor, n);
  } else {
    whole = std::make_unique<
        ceres::AutoDiffCostFunction<Functor, ceres::DYNAMIC, kLens, kArray, kPose, kPose>>(functor,
                                                                                           n);
  }
  ASSERT_EQ(ours->parameter_block_sizes(), whole->parameter_block_sizes());
  const Blocks blocks(camera, pose);
  const auto rig = pose_block({{0.02, -0.1, 0.05}, {1.0, -2.0, 3.0}});
  auto pointers = blocks.pointers();
  pointers.insert(pointers.end() - 1, rig.data());
  const auto derivatives = [&](const ceres::CostFunction& cost) {
    std::vector<double> all(n);
    std::vector<std::vector<double>> parts;
    for (int size : cost.parameter_block_sizes()) parts.emplace_back(n * size, NAN);
    std::vector<double*> to;
    for (auto& part : parts) to.push_back(part.data());
    EXPECT_TRUE(cost.Evaluate(pointers.data(), all.data(), to.data()));
    for (const auto& part : parts) all.insert(all.end(), part.begin(), part.end());
    return all;
  };
  const auto found = derivatives(*ours), expected = derivatives(*whole);
  for (std::size_t i = 0; i < expected.size(); ++i) {
    EXPECT_NEAR(found[i], expected[i], 1e-10 * (1.0 + std::abs(expected[i]))) << i;
  }
}

TEST(Gradients, InARig) {
  expect_derivatives_in_rig<0>();
  expect_derivatives_in_rig<1>();
  expect_derivatives_in_rig<3>();
}

TEST(Gradients, Centers) {
  for (unsigned seed = 1; seed <= 5; ++seed) {
    test::RandomObservations random(seed);
    const Camera camera = random.camera(3);
    const auto centers = random.centers(camera, 6);
    const auto lens = to_block(camera.main_lens);
    const auto pupil = to_block(camera.exit_pupil);
    const auto array = to_block(camera.mla);
    for (LossKind loss : kLosses) {
      SCOPED_TRACE(testing::Message() << "seed " << seed << " loss " << static_cast<int>(loss));
      const auto cost = CenterResiduals::create(centers, camera.pixel_size, {loss, 1.0});
      expect_gradients(*cost, {lens.data(), pupil.data(), array.data()});
    }
  }
}

TEST(Gradients, AreFiniteWithoutRotationOrDistortion) {
  // Angle-axis and distortion at exactly 0, where a careless sqrt would give NaN.
  const Camera camera = simple_camera(3);
  const auto cost = FeatureResiduals<3>::create({simple_feature(camera, 0, 0, 0)}, 0.01,
                                                {LossKind::kCauchy, 1.0});
  const Blocks blocks(camera, kSimplePose);
  std::array<double, 3 * kMainLensParameters> lens;
  std::array<double, 3 * Pose::kSize> pose;
  std::array<double, 3 * kArrayParameters> array;
  std::array<double, 3 * 3> focal_lengths;
  double* jacobians[] = {lens.data(), array.data(), focal_lengths.data(), pose.data()};
  double residuals[3];
  ASSERT_TRUE(cost->Evaluate(blocks.pointers().data(), residuals, jacobians));
  for (double value : lens) EXPECT_TRUE(std::isfinite(value));
  for (double value : array) EXPECT_TRUE(std::isfinite(value));
  for (double value : focal_lengths) EXPECT_TRUE(std::isfinite(value));
  for (double value : pose) EXPECT_TRUE(std::isfinite(value));
  // Turning by w about z moves (3, 1.5) by w (-1.5, 3). This shrinks tenfold on the sensor,
  // inverted, and is upright again in the image: -15 and +30 px per rad.
  EXPECT_NEAR(pose[2], -15.0, kRounding);
  EXPECT_NEAR(pose[6 + 2], 30.0, kRounding);
}

// Each observation has the same residual alone as in a group, whatever precedes it.
TEST(Grouping, DoesNotChangeFeatures) {
  test::RandomObservations random(7);
  const Camera camera = random.camera(3);
  const Pose pose = random.pose();
  auto features = random.features(camera, pose, 8);
  std::swap(features[1],
            features[6]);  // a corner's features need not be consecutive
  const Blocks blocks(camera, pose);
  for (LossKind kind : kLosses) {
    const Loss loss{kind, 1.0};
    const auto group = evaluate(*FeatureResiduals<3>::create(features, camera.pixel_size, loss),
                                blocks.pointers());
    for (std::size_t i = 0; i < features.size(); ++i) {
      const auto alone = evaluate(
          *FeatureResiduals<3>::create({features[i]}, camera.pixel_size, loss), blocks.pointers());
      for (int j = 0; j < 3; ++j) EXPECT_DOUBLE_EQ(group[3 * i + j], alone[j]);
    }
  }
}

TEST(Grouping, DoesNotChangeCenters) {
  test::RandomObservations random(8);
  const Camera camera = random.camera(3);
  const auto centers = random.centers(camera, 8);
  const auto lens = to_block(camera.main_lens);
  const auto pupil = to_block(camera.exit_pupil);
  const auto array = to_block(camera.mla);
  for (LossKind kind : kLosses) {
    const Loss loss{kind, 1.0};
    const auto group = evaluate(*CenterResiduals::create(centers, camera.pixel_size, loss),
                                {lens.data(), pupil.data(), array.data()});
    for (std::size_t i = 0; i < centers.size(); ++i) {
      const auto alone = evaluate(*CenterResiduals::create({centers[i]}, camera.pixel_size, loss),
                                  {lens.data(), pupil.data(), array.data()});
      for (int j = 0; j < 2; ++j) EXPECT_DOUBLE_EQ(group[2 * i + j], alone[j]);
    }
  }
}

}  // namespace
}  // namespace plenocal
