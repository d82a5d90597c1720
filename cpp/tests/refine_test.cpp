// The solve on a synthetic scene of known truth.
#include "plenocal/refine.hpp"

#include <ceres/loss_function.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "synthetic_scene.hpp"

namespace plenocal {
namespace {

using test::expect_near_relative;
using test::kBeyondThePaper;
using test::paper;
using test::residuals;
using test::Scene;

// Noise-free recovery, relative to each parameter: double precision at pixels near 1e3 and the
// conditioning of the scene limit it to about 1e-11; a larger error means no convergence.
constexpr double kRecovery = 1e-8;

// A start some per cent from the truth, with residuals of several px; parameters in `fixed`
// start at the truth.
Scene disturbed(const Scene& truth, const std::set<std::string>& fixed) {
  const std::vector<double> factors = {1.01, 0.9, 0.9, 0.9,   0.9,    0.9,   0.9,   0.9,  0.8, 0.7,
                                       1.3,  0.8, 1.2, 0.95,  0.8,    1.005, 0.995, 1.03, 1.3, 0.7,
                                       0.7,  1.5, 0.6, 1.002, 1.0005, 0.999, 0.98,  1.02, 0.99};
  Scene start = truth;
  auto values = test::intrinsics(truth.camera);
  const auto names = intrinsic_names(truth.camera.lens_types());
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (fixed.count(names[i]) == 0) values[i] *= factors[i];
  }
  start.camera = test::with_intrinsics(truth.camera, values);
  for (std::size_t i = 0; i < start.poses.size(); ++i) {
    auto& [rotation, translation] = start.poses[i];
    (i % 3 == 0 ? rotation.x : i % 3 == 1 ? rotation.y : rotation.z) += 0.02;
    translation.x += 0.2;
    translation.y -= 0.2;
    translation.z += 3.0;
  }
  return start;
}

void expect_recovered(const Refinement& result, const Scene& truth) {
  const auto names = intrinsic_names(truth.camera.lens_types());
  const auto expected = test::intrinsics(truth.camera);
  const auto actual = test::intrinsics(result.camera);
  for (std::size_t i = 0; i < names.size(); ++i) {
    expect_near_relative(actual[i], expected[i], kRecovery, names[i]);
  }
  ASSERT_EQ(result.poses.size(), truth.poses.size());
  for (std::size_t i = 0; i < truth.poses.size(); ++i) {
    const auto pose = pose_block(result.poses[i]), true_pose = pose_block(truth.poses[i]);
    for (std::size_t j = 0; j < pose.size(); ++j) {
      expect_near_relative(pose[j], true_pose[j], kRecovery, "pose " + std::to_string(i));
    }
  }
}

class Recovery : public testing::TestWithParam<int> {};

TEST_P(Recovery, OfAllParametersWithoutNoise) {
  const Scene truth = test::make_scene(GetParam());
  const Scene start = disturbed(truth, kBeyondThePaper);
  const Refinement result = refine(start.camera, start.poses, start.observations, paper(), {});
  EXPECT_EQ(result.termination, Termination::kConverged) << result.message;
  // The start really is several px off on average.
  EXPECT_GT(result.initial_cost, 1.0 * truth.observations.features.size());
  expect_recovered(result, truth);
}

INSTANTIATE_TEST_SUITE_P(LensTypes, Recovery, testing::Values(0, 1, 3));

TEST(Refine, CostIsHalfTheSumOfSquares) {
  const Scene start = disturbed(test::make_scene(3), {});
  CostOptions options;
  options.uv_std_dev = 0.5;
  options.rho_std_dev = 0.25;
  options.centers_std_dev = 2.0;
  SolverOptions solver;
  solver.max_iterations = 20;
  const Refinement result = refine(start.camera, start.poses, start.observations, options, solver);
  EXPECT_EQ(result.termination, Termination::kIterationLimit);
  // The order of summation differs.
  constexpr double kSummation = 1e-9;
  expect_near_relative(result.initial_cost, 0.5 * residuals(start, options).squaredNorm(),
                       kSummation, "start");
  const Scene end{result.camera, result.poses, start.observations};
  expect_near_relative(result.cost, 0.5 * residuals(end, options).squaredNorm(), kSummation, "end");
  EXPECT_LT(result.cost, result.initial_cost);
}

// 1/2 sum rho over the features of one frame, the loss by Ceres.
double frame_cost(const Refinement& result, const Observations& observations, int frame,
                  const ceres::LossFunction& loss) {
  Scene scene{result.camera, result.poses, {}};
  for (const FeatureObservation& o : observations.features) {
    if (o.frame == frame) scene.observations.features.push_back(o);
  }
  const Eigen::VectorXd r = residuals(scene, paper());
  double cost = 0.0;
  for (int i = 0; i < r.size(); i += 3) {
    double rho[3];
    loss.Evaluate(r.segment<3>(i).squaredNorm(), rho);
    cost += 0.5 * rho[0];
  }
  return cost;
}

TEST(Refine, FrameCostsAreThoseOfTheFeaturesAfterTheLoss) {
  constexpr double kSummation = 1e-9;
  constexpr double kScale = 1.5;
  Scene scene = test::make_scene(3);
  test::add_noise(1.0, 0.5, 0.2, 13, &scene.observations);
  const ceres::TrivialLoss none;
  const ceres::CauchyLoss cauchy(kScale);
  for (LossKind kind : {LossKind::kNone, LossKind::kCauchy}) {
    CostOptions options = paper();
    options.features_loss = {kind, kScale};
    SolverOptions solver;
    solver.max_iterations = 3;
    const Refinement result =
        refine(scene.camera, scene.poses, scene.observations, options, solver);
    ASSERT_EQ(result.frame_costs.size(), scene.poses.size());
    double sum = 0.0;
    for (int frame = 0; frame < static_cast<int>(scene.poses.size()); ++frame) {
      const auto& loss =
          kind == LossKind::kNone ? static_cast<const ceres::LossFunction&>(none) : cauchy;
      expect_near_relative(result.frame_costs[frame],
                           frame_cost(result, scene.observations, frame, loss), kSummation,
                           "frame " + std::to_string(frame));
      sum += result.frame_costs[frame];
    }
    // The rest is that of the centres, without a loss.
    const Scene centers{result.camera, result.poses, {{}, scene.observations.centers}};
    expect_near_relative(sum + 0.5 * residuals(centers, options).squaredNorm(), result.cost,
                         kSummation, "cost");
  }
}

TEST(Refine, DoublingOwnStdDevsEqualsDoublingTheOption) {
  Scene scene = test::make_scene(3);
  test::add_noise(0.1, 0.05, 0.02, 19, &scene.observations);
  CostOptions doubled = paper();
  doubled.uv_std_dev = doubled.rho_std_dev = doubled.centers_std_dev = 2.0;
  doubled.features_loss = doubled.centers_loss = {LossKind::kHuber, 0.1};
  CostOptions own = doubled;
  own.uv_std_dev = own.rho_std_dev = own.centers_std_dev = 1.0;
  SolverOptions solver;
  solver.max_iterations = 3;
  const Refinement expected =
      refine(scene.camera, scene.poses, scene.observations, doubled, solver);
  for (FeatureObservation& o : scene.observations.features) o.std_dev = {2.0, 2.0, 2.0};
  for (CenterObservation& o : scene.observations.centers) o.std_dev = 2.0;
  const Refinement actual = refine(scene.camera, scene.poses, scene.observations, own, solver);
  // The arithmetic is exactly the same.
  EXPECT_EQ(actual.cost, expected.cost);
  EXPECT_EQ(test::intrinsics(actual.camera), test::intrinsics(expected.camera));
}

// Each of the three, and that of the centres, has its effect.
TEST(Refine, OwnStdDevsWeighTheirOwnResidual) {
  constexpr double kSummation = 1e-9;
  Scene scene = test::make_scene(3);
  test::add_noise(0.1, 0.05, 0.02, 23, &scene.observations);
  scene.observations.features[5].std_dev = {0.5, 3.0, 0.1};
  scene.observations.features[6].std_dev = {2.0, 0.2, 7.0};
  scene.observations.centers[7].std_dev = 0.05;
  const Refinement result = refine(scene.camera, scene.poses, scene.observations, paper(), {});
  expect_near_relative(result.initial_cost, 0.5 * residuals(scene, paper()).squaredNorm(),
                       kSummation, "cost");
}

TEST(Refine, ExitPupilAndFieldCurvatureAreRecovered) {
  const Scene truth = test::make_scene(3);
  CostOptions options;
  options.fixed = test::with_shape({"dC_ratio"});
  const Scene start = disturbed(truth, options.fixed);
  const Refinement free = refine(start.camera, start.poses, start.observations, options, {});
  EXPECT_EQ(free.termination, Termination::kConverged) << free.message;
  expect_recovered(free, truth);
  // A pupil in the lens cannot fit this, nor can a flat field.
  for (const std::string at_zero : {"e_z", "e_r", "kappa", "kappa_m", "Q1_m", "omega_x"}) {
    Scene other = truth;
    for_each_parameter(other.camera, [&](const std::string& name, double& parameter) {
      if (name == at_zero) parameter = 0.0;
    });
    const Refinement paper =
        refine(other.camera, other.poses, other.observations, test::paper(), {});
    EXPECT_GT(paper.cost, 1e-4) << at_zero;
  }
}

TEST(Refine, TwoPitchesAreRecovered) {
  Scene truth = test::make_scene(3);
  truth.camera.mla.pitch_ratio = 1.002;
  truth.observations = test::observe(truth.camera, truth.poses);
  const Scene start = disturbed(truth, {});
  CostOptions two_pitches;
  two_pitches.fixed = test::with_shape({});
  const Refinement free = refine(start.camera, start.poses, start.observations, two_pitches, {});
  EXPECT_EQ(free.termination, Termination::kConverged) << free.message;
  expect_recovered(free, truth);
  // One pitch cannot fit this: the outer centres alone are off by 0.2 px.
  Scene one = start;
  one.camera.mla.pitch_ratio = 1.0;
  const Refinement fixed = refine(one.camera, one.poses, one.observations, paper(), {});
  EXPECT_EQ(fixed.camera.mla.pitch_ratio, 1.0);
  EXPECT_GT(fixed.cost, 1.0);
}

TEST(Refine, FixedParametersKeepTheirValue) {
  CostOptions options;
  options.fixed = test::with_shape({"F", "Q2", "P1", "v0", "theta_z", "dC", "dC_ratio", "f_2"});
  const Scene start = disturbed(test::make_scene(3), {});
  const Refinement result = refine(start.camera, start.poses, start.observations, options, {});
  const auto names = intrinsic_names(3);
  const auto before = test::intrinsics(start.camera), after = test::intrinsics(result.camera);
  for (std::size_t i = 0; i < names.size(); ++i) {
    const bool fixed = options.fixed.count(names[i]) > 0;
    EXPECT_EQ(before[i] == after[i], fixed) << names[i];
  }
  const Uncertainty u = uncertainty(start.camera, start.poses, start.observations, options);
  EXPECT_EQ(u.free_intrinsics, (std::vector<int>{1,  3,  4,  6,  7,  8,  9,  10, 11, 12, 13,
                                                 14, 15, 17, 18, 19, 21, 22, 23, 26, 28}));
  EXPECT_EQ(u.size, 21 + 6 * 7);
}

TEST(Refine, EverythingFixedLeavesThePoses) {
  const Scene truth = test::make_scene(3);
  CostOptions options;
  options.fix(shared_names(3));
  const Scene start = disturbed(truth, options.fixed);
  const Refinement result = refine(start.camera, start.poses, start.observations, options, {});
  EXPECT_EQ(result.termination, Termination::kConverged) << result.message;
  EXPECT_EQ(test::intrinsics(result.camera), test::intrinsics(truth.camera));
  expect_recovered(result, truth);
  const Uncertainty u = uncertainty(truth.camera, truth.poses, truth.observations, options);
  EXPECT_TRUE(u.free_intrinsics.empty());
  EXPECT_EQ(u.size, 6 * 7);
  EXPECT_EQ(u.rank, u.size);
}

TEST(Refine, ThreadsDoNotChangeTheResult) {
  Scene scene = test::make_scene(3);
  test::add_noise(0.1, 0.05, 0.02, 5, &scene.observations);
  SolverOptions solver;
  const Refinement one = refine(scene.camera, scene.poses, scene.observations, paper(), solver);
  solver.threads = 2;
  const Refinement two = refine(scene.camera, scene.poses, scene.observations, paper(), solver);
  EXPECT_EQ(two.cost, one.cost);
  EXPECT_EQ(test::intrinsics(two.camera), test::intrinsics(one.camera));
  ASSERT_EQ(two.iterations.size(), one.iterations.size());
  for (std::size_t i = 0; i < one.iterations.size(); ++i) {
    EXPECT_EQ(two.iterations[i].cost, one.iterations[i].cost) << i;
  }
}

// Large residuals make Gauss-Newton slow. The extrapolation leads to the same minimum as Ceres
// alone, in fewer iterations.
TEST(Refine, ExtrapolationReachesTheSameMinimumSooner) {
  Scene scene = test::make_scene(3);
  test::add_noise(5.0, 0.1, 0.5, 17, &scene.observations);
  SolverOptions solver;
  solver.max_iterations = 1000;
  const Refinement fast = refine(scene.camera, scene.poses, scene.observations, paper(), solver);
  solver.extrapolate = false;
  const Refinement plain = refine(scene.camera, scene.poses, scene.observations, paper(), solver);
  ASSERT_EQ(fast.termination, Termination::kConverged) << fast.message;
  ASSERT_EQ(plain.termination, Termination::kConverged) << plain.message;
  // Both stop when the cost changes by a fraction of 1e-13; Ceres alone then is still further off.
  constexpr double kSameMinimum = 1e-10;
  expect_near_relative(fast.cost, plain.cost, kSameMinimum, "cost");
  EXPECT_LT(fast.iterations.back().number, plain.iterations.back().number);
}

// The largest error of an intrinsic in units of its standard deviation without outliers.
double worst_error(const Camera& camera, const Scene& truth, const Uncertainty& clean) {
  const auto actual = test::intrinsics(camera), expected = test::intrinsics(truth.camera);
  double worst = 0.0;
  for (int i = 0; i < static_cast<int>(clean.free_intrinsics.size()); ++i) {
    const int index = clean.free_intrinsics[i];
    worst = std::max(worst,
                     std::abs(actual[index] - expected[index]) / std::sqrt(clean.covariance(i, i)));
  }
  return worst;
}

TEST(Refine, RobustLossResistsOutliers) {
  const Scene truth = test::make_scene(3);
  CostOptions options = paper();
  options.uv_std_dev = options.rho_std_dev = options.centers_std_dev = 0.1;
  Scene scene = truth;
  test::add_noise(0.1, 0.1, 0.1, 11, &scene.observations);
  const Uncertainty clean = uncertainty(truth.camera, truth.poses, scene.observations, options);
  // Every 20th feature is a wrong corner: up to 20 px off, more often to one side.
  std::mt19937 generator(12);
  std::uniform_real_distribution<double> gross(-10.0, 20.0);
  for (std::size_t i = 0; i < scene.observations.features.size(); i += 20) {
    scene.observations.features[i].observed.u += gross(generator);
    scene.observations.features[i].observed.v += gross(generator);
  }
  const auto worst = [&](LossKind kind) {
    options.features_loss = options.centers_loss = {kind, 2.0};
    const Refinement result = refine(truth.camera, truth.poses, scene.observations, options, {});
    EXPECT_EQ(result.termination, Termination::kConverged) << result.message;
    return worst_error(result.camera, truth, clean);
  };
  // Once outliers no longer count, none of 19 parameters is off by more than 4 standard deviations.
  constexpr double kShrugged = 4.0;
  EXPECT_GT(worst(LossKind::kNone), 3.0 * kShrugged);
  EXPECT_LT(worst(LossKind::kHuber), kShrugged);
  EXPECT_LT(worst(LossKind::kCauchy), kShrugged);
}

TEST(Progress, SeesEveryIteration) {
  const Scene start = disturbed(test::make_scene(1), kBeyondThePaper);
  std::vector<Iteration> seen;
  const Refinement result = refine(start.camera, start.poses, start.observations, paper(), {},
                                   [&](const Iteration& iteration) {
                                     seen.push_back(iteration);
                                     return true;
                                   });
  ASSERT_EQ(seen.size(), result.iterations.size());
  ASSERT_GT(seen.size(), 2u);
  for (std::size_t i = 0; i < seen.size(); ++i) {
    EXPECT_EQ(seen[i].number, static_cast<int>(i));
    EXPECT_EQ(seen[i].cost, result.iterations[i].cost);
    if (i > 0) {
      EXPECT_GE(seen[i].time_s, seen[i - 1].time_s);
    }
  }
  EXPECT_EQ(seen.front().cost, result.initial_cost);
  EXPECT_GT(seen.front().gradient_max_norm, 0.0);
  EXPECT_GE(result.time_s, seen.back().time_s);
}

TEST(Progress, StepNormIsTheDistanceMoved) {
  const Scene start = disturbed(test::make_scene(1), kBeyondThePaper);
  const auto step_after = [&](double trust_region_radius) {
    SolverOptions solver;
    solver.max_iterations = 1;
    solver.initial_trust_region_radius = trust_region_radius;
    const Refinement end = refine(start.camera, start.poses, start.observations, paper(), solver);
    EXPECT_EQ(end.iterations.size(), 2u);
    EXPECT_EQ(end.iterations.front().step_norm, 0.0);
    double moved = 0.0;
    const auto add = [&moved](const auto& before, const auto& after) {
      for (std::size_t i = 0; i < before.size(); ++i) moved += std::pow(after[i] - before[i], 2);
    };
    add(test::intrinsics(start.camera), test::intrinsics(end.camera));
    for (std::size_t i = 0; i < start.poses.size(); ++i) {
      add(pose_block(start.poses[i]), pose_block(end.poses[i]));
    }
    constexpr double kSummation = 1e-12;
    expect_near_relative(end.iterations.back().step_norm, std::sqrt(moved), kSummation, "step");
    return end.iterations.back().step_norm;
  };
  EXPECT_EQ(step_after(1e10), 0.0);  // raises the cost, so it is rejected
  EXPECT_GT(step_after(10.0), 0.0);
}

TEST(Progress, StopsTheSolve) {
  const Scene start = disturbed(test::make_scene(1), kBeyondThePaper);
  constexpr int kLast = 3;
  const Refinement result =
      refine(start.camera, start.poses, start.observations, paper(), {},
             [](const Iteration& iteration) { return iteration.number < kLast; });
  EXPECT_EQ(result.termination, Termination::kStopped);
  EXPECT_EQ(result.iterations.size(), kLast + 1u);
}

// Ceres leaves the parameters at the start if a callback aborts, while its final cost is the lowest
// so far: the library has to put the two together.
TEST(Progress, StoppedSolveReturnsTheParametersOfItsCost) {
  const Scene start = disturbed(test::make_scene(1), kBeyondThePaper);
  double first = 0.0;
  const Refinement result = refine(start.camera, start.poses, start.observations, paper(), {},
                                   [&](const Iteration& iteration) {
                                     if (iteration.number == 0) first = iteration.cost;
                                     return iteration.cost > 0.5 * first;
                                   });
  EXPECT_EQ(result.termination, Termination::kStopped);
  EXPECT_LT(result.cost, 0.5 * result.initial_cost);
  const Scene end{result.camera, result.poses, start.observations};
  constexpr double kSummation = 1e-9;
  expect_near_relative(result.cost, 0.5 * residuals(end, paper()).squaredNorm(), kSummation,
                       "cost");
}

}  // namespace
}  // namespace plenocal
