// Errors that groups of residuals share, curvature, and priors: by hand, and by their
// distribution.
#include "shared_errors.hpp"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <array>
#include <random>

#include "rejection.hpp"
#include "simple_camera.hpp"
#include "synthetic_scene.hpp"

namespace plenocal {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;
using test::expect_names;
using test::expect_near_relative;
using test::paper;
using test::rejection;
using test::residuals;
using test::Scene;

constexpr double kRounding = 1e-12;

Group scalar(double information, double gradient) {
  return {MatrixXd::Constant(1, 1, information), VectorXd::Constant(1, gradient)};
}

TEST(GradientSpread, OfTwoNumbersIsWhatIsWorkedOutByHand) {
  // H = 1 + 3. The minimum of both lies where the gradients sum to zero: 3 - 1/4 4 = 2 and
  // 1 - 3/4 4 = -2. Corrected, 2 / sqrt(3/4) and -2 / sqrt(1/4): the squares are 16/3 and 16.
  const MatrixXd spread = gradient_spread({scalar(1.0, 3.0), scalar(3.0, 1.0)});
  EXPECT_NEAR(spread(0, 0), 16.0 / 3.0 + 16.0, kRounding);
}

TEST(GradientSpread, OfIndependentErrorsIsTheInformation) {
  constexpr int kGroups = 7, kParameters = 3, kDraws = 4000;
  constexpr double kScatter =
      0.05;  // of a variance from 6 groups and 4000 draws: 1 %, the worst of 9
  std::mt19937 generator(3);
  std::normal_distribution<double> normal;
  const auto random = [&](int rows, int columns) -> MatrixXd {
    return MatrixXd::NullaryExpr(rows, columns, [&] { return normal(generator); });
  };
  std::vector<MatrixXd> designs;
  MatrixXd information = MatrixXd::Zero(kParameters, kParameters);
  for (int g = 0; g < kGroups; ++g) {
    designs.push_back((g + 1.0) * random(4 + g, kParameters));  // of very different leverage
    information += designs.back().transpose() * designs.back();
  }
  MatrixXd mean = MatrixXd::Zero(kParameters, kParameters);
  for (int draw = 0; draw < kDraws; ++draw) {
    std::vector<Group> groups;
    for (const MatrixXd& design : designs) {
      const VectorXd errors = random(static_cast<int>(design.rows()), 1);
      groups.push_back({design.transpose() * design, design.transpose() * errors});
    }
    mean += gradient_spread(groups) / kDraws;
  }
  const VectorXd scale = information.diagonal().cwiseSqrt().cwiseInverse();
  EXPECT_LT((scale.asDiagonal() * (mean - information) * scale.asDiagonal()).cwiseAbs().maxCoeff(),
            kScatter);
}

TEST(GradientSpread, OfADirectionThatOneGroupDeterminesIsThatOfTheOthers) {
  // Only the first group knows of the second parameter; the other direction has a variance of 4.
  std::vector<Group> groups;
  for (double sign : {1.0, -1.0, 1.0, -1.0}) {
    MatrixXd information = MatrixXd::Zero(2, 2);
    information(0, 0) = 1.0;
    groups.push_back({information, VectorXd::Zero(2)});
    groups.back().gradient[0] = sign * 2.0 * std::sqrt(0.75);
  }
  groups.front().information(1, 1) = 9.0;
  const MatrixXd spread = gradient_spread(groups);
  EXPECT_NEAR(spread(0, 0), 16.0, kRounding * 100);
  EXPECT_NEAR(spread(1, 1), 4.0 * 9.0, kRounding * 100);
}

TEST(GradientSpread, OfNothingIsZero) {
  EXPECT_EQ(gradient_spread({scalar(0.0, 0.0), scalar(0.0, 0.0)})(0, 0), 0.0);
}

Scene noisy_scene() {
  Scene scene = test::make_scene(3);
  test::add_noise(0.1, 0.05, 0.02, 5, &scene.observations);
  return scene;
}

int index_of(const std::string& name) {
  const auto names = intrinsic_names(3);
  return static_cast<int>(std::find(names.begin(), names.end(), name) - names.begin());
}

// Its row among the free intrinsics.
int row_of(const std::string& name, const Uncertainty& u) {
  const auto& free = u.free_intrinsics;
  return static_cast<int>(std::find(free.begin(), free.end(), index_of(name)) - free.begin());
}

TEST(TiltGradient, IsHowTheDistanceGrowsOverTheImage) {
  // Lenses about the middle, by their centres and where their micro-images are.
  Camera camera = test::simple_camera();
  camera.exit_pupil = {0.0, 0.0, -9.0, 0.0};
  camera.mla.rotation = {2e-3, -1e-3, 0.3};
  const ArrayOptics<double> optics(camera.mla, camera.pixel_size);
  const double sensor_z = -(camera.mla.lens_to_mla + camera.mla.mla_to_sensor);
  const auto place = [&](int k, int l) {
    const Pixel<double> c = project_center(camera, k, l);
    const double z = optics.micro_lens_center(camera.lattice.node(k, l)).z;
    return std::array<double, 3>{c.u * camera.pixel_size, c.v * camera.pixel_size,
                                 std::log(z - sensor_z)};
  };
  // Central differences along both axes of the array.
  const auto [lu, lv, ln] = place(1, 2);
  const auto [ru, rv, rn] = place(3, 2);
  const auto [au, av, an] = place(2, 1);
  const auto [bu, bv, bn] = place(2, 3);
  const Vector2<double> found = tilt_gradient(camera.exit_pupil, camera.mla);
  EXPECT_NEAR(found.x * (ru - lu) + found.y * (rv - lv), rn - ln, 1e-6);
  EXPECT_NEAR(found.x * (bu - au) + found.y * (bv - av), bn - an, 1e-6);
  EXPECT_GT(std::abs(rn - ln) + std::abs(bn - an), 1e-3);
}

TEST(Priors, HoldAQuantity) {
  const Scene scene = noisy_scene();
  CostOptions options = paper();
  options.priors = {{"F", 50.5, 1e-8}, {kSlopeName, 0.141, 1e-9}};
  const Refinement r = refine(scene.camera, scene.poses, scene.observations, options, {});
  EXPECT_NEAR(r.camera.main_lens.focal_length, 50.5, 1e-6);
  EXPECT_NEAR(micro_image_slope(r.camera.main_lens, r.camera.exit_pupil, r.camera.mla), 0.141,
              1e-7);
}

// Without rho, the q'_i determine the focal lengths, and whatever rho is does not matter.
TEST(Priors, OnTheInterceptsTakeThePlaceOfRho) {
  for (int types : {1, 3}) {
    Scene scene = test::make_scene(types);
    const Camera& truth = scene.camera;
    CostOptions options = paper();
    options.rho = false;
    for (auto& feature : scene.observations.features) feature.observed.rho = 1e3;
    for (int i = 0; i < types; ++i) {
      const double q = blur_intercept(truth.mla, truth.micro_lens_focal_lengths[i]);
      options.priors.push_back({intercept_name(i), q, 1e-5});
    }
    Camera start = truth;
    start.mla.mla_to_sensor *= 1.02;
    for (double& f : start.micro_lens_focal_lengths) f *= 1.05;
    const Refinement r = refine(start, scene.poses, scene.observations, options, {});
    for (int i = 0; i < types; ++i) {
      expect_near_relative(r.camera.micro_lens_focal_lengths[i], truth.micro_lens_focal_lengths[i],
                           1e-8, "f_" + std::to_string(i + 1));
    }
    const Uncertainty u = uncertainty(r.camera, r.poses, scene.observations, options);
    EXPECT_EQ(u.rank, u.size);
    EXPECT_TRUE(std::isnan(u.residual_std_dev[1]));
  }
  // By hand: 0.126 * 0.33 / (2 * 0.578).
  MicroLensArray<double> mla{};
  mla.pitch = 0.126;
  mla.pitch_ratio = 1.0;
  mla.mla_to_sensor = 0.33;
  EXPECT_NEAR(blur_intercept(mla, 0.578), 0.035968858, 1e-9);
}

// The weight of priors comes from quantities that observations tell of, not from the q'_i.
TEST(Priors, OnTheInterceptsDoNotChangeTheDispersion) {
  const Scene scene = noisy_scene();
  CostOptions without = paper();
  without.rho = false;
  without.priors = {{"F", 50.0, 0.5}};
  CostOptions with = without;
  for (int i = 0; i < 3; ++i) {
    without.fix({"f_" + std::to_string(i + 1)});
    const double f = scene.camera.micro_lens_focal_lengths[i];
    with.priors.push_back({intercept_name(i), blur_intercept(scene.camera.mla, f), 1e-5});
  }
  const auto dispersion = [&](const CostOptions& options) {
    const Refinement r = refine(scene.camera, scene.poses, scene.observations, options, {});
    return uncertainty(r.camera, r.poses, scene.observations, options).dispersion;
  };
  expect_near_relative(dispersion(with), dispersion(without), 1e-6, "dispersion");
}

TEST(Priors, GiveTheirOwnUncertaintyWhereObservationsHaveNone) {
  // Observations so bad that the prior decides: its sigma is that of the result, whatever its
  // weight.
  const Scene scene = test::make_scene(3);
  for (double weight : {1.0, 16.0}) {
    CostOptions options = paper();
    options.uv_std_dev = options.rho_std_dev = options.centers_std_dev = 1e4;
    options.priors = {{"F", 50.0, 1e-3}};
    options.prior_weight = weight;
    const Uncertainty u = uncertainty(scene.camera, scene.poses, scene.observations, options);
    const int place = row_of("F", u);
    expect_near_relative(std::sqrt(u.independent_covariance(place, place)), 1e-3, 1e-3, "F");
  }
}

TEST(Priors, LeaveTheMinimumAloneThatTheyAgreeWith) {
  const Scene scene = noisy_scene();
  const Refinement without = refine(scene.camera, scene.poses, scene.observations, paper(), {});
  CostOptions options = paper();
  options.priors = {{"D", without.camera.mla.lens_to_mla, 0.01}};
  const Refinement with = refine(scene.camera, scene.poses, scene.observations, options, {});
  expect_near_relative(with.cost, without.cost, 1e-10, "cost");
  expect_near_relative(with.camera.mla.lens_to_mla, without.camera.mla.lens_to_mla, 1e-8, "D");
}

TEST(Priors, ThatAreImpossibleAreNamed) {
  const Scene scene = test::make_scene(3);
  const auto message = [&](const Prior& prior) {
    CostOptions options = paper();
    options.priors = {prior};
    return rejection([&] { refine(scene.camera, scene.poses, scene.observations, options, {}); });
  };
  expect_names(message({"Q9", 1.0, 1.0}), "Q9");
  expect_names(message({"F", 50.0, 0.0}), "F");
  expect_names(message({"F", 50.0, -1.0}), "positive");
  expect_names(message({"F", NAN, 1.0}), "finite");
  expect_names(message({"d", 0.3, INFINITY}), "d");
  expect_names(message({"dC_ratio", 1.0, 1.0}), "fixed");
  CostOptions options = paper();
  options.prior_weight = 0.0;
  expect_names(
      rejection([&] { uncertainty(scene.camera, scene.poses, scene.observations, options); }),
      "weight");
}

MatrixXd sum_of(const std::vector<MatrixXd>& matrices) {
  MatrixXd sum = MatrixXd::Zero(matrices.front().rows(), matrices.front().cols());
  for (const MatrixXd& matrix : matrices) sum += matrix;
  return sum;
}

// The curvature of the observations' part of the cost along a direction of the intrinsics.
double curvature_along(const VectorXd& direction, const Scene& scene, const CostOptions& options) {
  LeastSquares problem(scene.camera, scene.poses, scene.observations, options);
  const Curvature curved = curvature(without_poses(normal_equations(problem)), &problem);
  return direction.dot((sum_of(curved.frames) + sum_of(curved.patches)) * direction);
}

// Residuals at some distance along a direction of the intrinsics, with the poses following.
VectorXd residuals_at(const VectorXd& change, const Scene& scene) {
  LeastSquares problem(scene.camera, scene.poses, scene.observations, paper());
  const MatrixXd follow = without_poses(normal_equations(problem)).poses_by_intrinsics;
  VectorXd state = problem.state();
  for (Eigen::Index i = 0; i < change.size(); ++i) {
    state[problem.free_intrinsics()[i]] += change[i];
  }
  state.tail(follow.rows()) += follow * change;
  problem.set_state(state);
  return residuals({problem.camera(), problem.poses(), scene.observations}, paper());
}

// Residuals -x r'' along the direction in which a prior of u0 moves the camera: J'J is 1 there,
// and the curvature 1 - x |r''|^2.
TEST(Curvature, IsTheTrueOneWhereOnlyAPriorMakesItAMinimum) {
  constexpr double kCurvature = -0.5, kStep = 0.1, kTolerance = 0.02;
  Scene scene = test::make_scene(3);
  // Off the axis of a curved field, or with distortion that grows, the pattern bends other weak
  // directions too.
  scene.camera.main_lens.radial_growth = 0.0;
  scene.camera.main_lens.field_curvature = 0.0;
  scene.camera.main_lens.field_curvature_growth = 0.0;
  scene.camera.exit_pupil = {};
  scene.observations = test::observe(scene.camera, scene.poses);
  const Uncertainty u = uncertainty(scene.camera, scene.poses, scene.observations, paper());
  LeastSquares problem(scene.camera, scene.poses, scene.observations, paper());
  const Eliminated groups = without_poses(normal_equations(problem));
  MatrixXd information = groups.priors;  // none
  for (const Group& group : groups.frames) information += group.information;
  for (const Group& group : groups.patches) information += group.information;
  const VectorXd towards = ScaledInverse(information).matrix().col(row_of("u0", u));
  const double std_dev = std::sqrt(towards[row_of("u0", u)]);
  const VectorXd direction = towards / std_dev;

  const VectorXd second =
      (residuals_at(kStep * direction, scene) + residuals_at(-kStep * direction, scene)) /
      (kStep * kStep);
  const VectorXd pattern = (1.0 - kCurvature) / second.squaredNorm() * second;
  const double* next = pattern.data();
  for (FeatureObservation& o : scene.observations.features) {
    for (double* value : {&o.observed.u, &o.observed.v, &o.observed.rho}) *value += *next++;
  }
  for (CenterObservation& o : scene.observations.centers) {
    for (double* value : {&o.observed.u, &o.observed.v}) *value += *next++;
  }
  // No minimum: J'J instead.
  EXPECT_NEAR(curvature_along(direction, scene, paper()), 1.0, kTolerance);
  CostOptions options = paper();
  options.priors = {{"u0", scene.camera.mla.principal_point[0], std_dev / std::sqrt(2.0)}};
  EXPECT_NEAR(curvature_along(direction, scene, options), kCurvature, kTolerance);
  // What weighs the prior does not come from a negative curvature: residuals are far below 1 px.
  const double dispersion =
      uncertainty(scene.camera, scene.poses, scene.observations, options).dispersion;
  EXPECT_GT(dispersion, 0.0);
  EXPECT_LT(dispersion, 0.1);
}

// A bend of the board in each frame, the same for all its corners.
TEST(SharedErrors, AreSeenInWhatFramesContradictEachOther) {
  Scene scene = noisy_scene();
  std::mt19937 generator(7);
  std::normal_distribution<double> normal;
  std::vector<double> bends;
  for (std::size_t i = 0; i < scene.poses.size(); ++i) bends.push_back(normal(generator));
  for (FeatureObservation& o : scene.observations.features) {
    const double part = o.board_point.x / (0.0065 * scene.poses[o.frame].translation.z * 2.5);
    o.observed.u += bends[o.frame] * part * part;
  }
  const Refinement r = refine(scene.camera, scene.poses, scene.observations, paper(), {});
  const Uncertainty u = uncertainty(r.camera, r.poses, scene.observations, paper());
  ASSERT_TRUE(u.shared);
  for (const char* name : {"F", "D", "d", "P1"}) {
    const int at = row_of(name, u);
    EXPECT_GT(std::sqrt(u.covariance(at, at) / u.independent_covariance(at, at)), 1.5) << name;
  }
  for (double freedom : u.freedom) EXPECT_GT(freedom, 0.0);
}

// What boards and centres contradict each other in, and by how many standard deviations, if the
// grid of the centres is larger by a fraction and turned by an angle.
Contradiction contradiction_of(double larger, double turned) {
  Scene scene = noisy_scene();
  const double* middle = scene.camera.mla.principal_point;
  for (CenterObservation& o : scene.observations.centers) {
    const double u = o.observed.u - middle[0], v = o.observed.v - middle[1];
    o.observed.u += larger * u - turned * v;
    o.observed.v += larger * v + turned * u;
  }
  const Refinement r = refine(scene.camera, scene.poses, scene.observations, paper(), {});
  const Uncertainty u = uncertainty(r.camera, r.poses, scene.observations, paper());
  EXPECT_TRUE(u.shared);
  return {u.contradiction, u.contradicted < 0 ? -1 : u.free_intrinsics[u.contradicted]};
}

// Nine frames of independent errors agree by chance better than that in some direction or other; A
// is nearly H here.
TEST(SharedErrors, DoNotMakeVariancesSmallerThanIndependentOnes) {
  const Scene scene = noisy_scene();
  const Refinement r = refine(scene.camera, scene.poses, scene.observations, paper(), {});
  const Uncertainty u = uncertainty(r.camera, r.poses, scene.observations, paper());
  ASSERT_TRUE(u.shared);
  for (int i = 0; i < static_cast<int>(u.free_intrinsics.size()); ++i) {
    EXPECT_GT(u.covariance(i, i), 0.85 * u.independent_covariance(i, i)) << u.free_intrinsics[i];
  }
}

TEST(Contradiction, IsNoneWhereBoardsAndCentresAgree) {
  const Contradiction none = contradiction_of(0.0, 0.0);
  EXPECT_EQ(none.parameter, -1);
  EXPECT_EQ(none.std_devs, 0.0);
}

TEST(Contradiction, IsFoundAndNamed) {
  // Boards of this scene know the pitch to some 0.1 %, and how the array is turned far better.
  const Contradiction larger = contradiction_of(0.01, 0.0);
  EXPECT_GT(larger.std_devs, 3.0);
  EXPECT_EQ(larger.parameter, index_of("dC"));
  const Contradiction turned = contradiction_of(0.0, 1e-3);
  EXPECT_GT(turned.std_devs, 30.0);
  EXPECT_EQ(turned.parameter, index_of("theta_z"));
}

}  // namespace
}  // namespace plenocal
