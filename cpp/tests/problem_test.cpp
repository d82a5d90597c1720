// The public problem: its blocks and derivatives against Ceres' own, additions to it, fixed poses,
// names.
#include "plenocal/problem.hpp"

#include <ceres/ceres.h>
#include <ceres/normal_prior.h>
#include <ceres/rotation.h>
#include <gtest/gtest.h>

#include <Eigen/SparseCore>
#include <algorithm>

#include "plenocal/residuals.hpp"
#include "rejection.hpp"
#include "synthetic_scene.hpp"

namespace plenocal {
namespace {

using test::Scene;

Scene noisy(int lens_types) {
  Scene scene = test::make_scene(lens_types);
  test::add_noise(0.1, 0.05, 0.02, 8, &scene.observations);
  return scene;
}

Eigen::MatrixXd dense_of(const ceres::CRSMatrix& crs) {
  return Eigen::MappedSparseMatrix<double, Eigen::RowMajor>(
      crs.num_rows, crs.num_cols, static_cast<Eigen::Index>(crs.values.size()),
      const_cast<int*>(crs.rows.data()), const_cast<int*>(crs.cols.data()),
      const_cast<double*>(crs.values.data()));
}

// Ceres evaluates the same problem by itself, with constant parameters taken out.
TEST(CalibrationProblem, EvaluatesAsCeresDoes) {
  for (int lens_types : {0, 3}) {
    const Scene scene = noisy(lens_types);
    CostOptions options;
    options.fix({"F", "Q2"});
    options.free({"e_z", "sag_x"});
    options.fixed_poses = {1};
    options.priors = {{"D", 60.0, 2.0}};
    Observations observations = scene.observations;
    observations.board.half_width = observations.board.half_height = 20.0;
    CalibrationProblem calibration(scene.camera, scene.poses, observations, options);
    const Evaluation ours = calibration.evaluate();

    ceres::Problem::EvaluateOptions in_order;
    for (double* block : calibration.free_blocks()) in_order.parameter_blocks.push_back(block);
    double cost = 0.0;
    std::vector<double> residuals, gradient;
    ceres::CRSMatrix jacobian;
    ASSERT_TRUE(calibration.problem().Evaluate(in_order, &cost, &residuals, &gradient, &jacobian));
    EXPECT_NEAR(ours.cost, cost, 1e-12 * cost);
    ASSERT_EQ(ours.residuals.size(), residuals.size());
    const auto names = calibration.names();
    ASSERT_EQ(ours.gradient.size(), names.size());
    // Of a fixed pose Ceres has no columns, and here they are empty.
    std::vector<int> column_of_ceres;
    int next = 0;
    for (const std::string& name : names) {
      column_of_ceres.push_back(name.rfind("pose 1 ", 0) == 0 ? -1 : next++);
    }
    ASSERT_EQ(next, jacobian.num_cols);
    const Eigen::MatrixXd dense = dense_of(ours.jacobian);
    for (std::size_t i = 0; i < names.size(); ++i) {
      const int at = column_of_ceres[i];
      const double expected = at < 0 ? 0.0 : gradient[at];
      EXPECT_NEAR(ours.gradient[i], expected, 1e-9 * std::abs(expected) + 1e-9) << names[i];
      if (at < 0) {
        EXPECT_EQ(dense.col(i).norm(), 0.0) << names[i];
      }
    }
    const Eigen::MatrixXd theirs = dense_of(jacobian);
    EXPECT_EQ(ours.residuals, residuals);
    for (std::size_t i = 0; i < names.size(); ++i) {
      if (column_of_ceres[i] < 0) continue;
      EXPECT_EQ((dense.col(i) - theirs.col(column_of_ceres[i])).norm(), 0.0) << names[i];
    }
  }
}

// Few rows in the place of many: cost, gradient and Gauss-Newton matrix stay, for constant blocks
// and losses too, and at a place where no residuals are left.
TEST(CalibrationProblem, CompressedHasTheSameMinimum) {
  for (const double noise : {1.0, 0.0}) {
    Scene scene = test::make_scene(3);
    test::add_noise(0.1 * noise, 0.05 * noise, 0.02 * noise, 8, &scene.observations);
    CostOptions options;
    options.fix({"F", "Q2"});
    options.fixed_poses = {1};
    options.priors = {{"D", 60.0, 2.0}};
    options.features_loss = {LossKind::kCauchy, 2.0};
    options.free({"sag_x"});
    scene.observations.board.half_width = scene.observations.board.half_height = 20.0;
    CalibrationProblem calibration(scene.camera, scene.poses, scene.observations, options);
    const auto compressed = calibration.compressed();
    ceres::Problem::EvaluateOptions in_order;
    for (double* block : calibration.free_blocks()) in_order.parameter_blocks.push_back(block);
    const auto evaluate = [&](ceres::Problem& problem, double* cost, Eigen::VectorXd* gradient,
                              Eigen::MatrixXd* normal) {
      std::vector<double> entries;
      ceres::CRSMatrix crs;
      ASSERT_TRUE(problem.Evaluate(in_order, cost, nullptr, &entries, &crs));
      *gradient = Eigen::Map<Eigen::VectorXd>(entries.data(), entries.size());
      const Eigen::MatrixXd jacobian = dense_of(crs);
      *normal = jacobian.transpose() * jacobian;
    };
    double cost = 0.0, cost_alone = 0.0, expected_cost = 0.0;
    Eigen::VectorXd gradient, expected_gradient;
    Eigen::MatrixXd normal, expected_normal;
    evaluate(calibration.problem(), &expected_cost, &expected_gradient, &expected_normal);
    evaluate(*compressed, &cost, &gradient, &normal);
    ASSERT_TRUE(compressed->Evaluate(in_order, &cost_alone, nullptr, nullptr, nullptr));
    EXPECT_LT(compressed->NumResiduals(), calibration.problem().NumResiduals() / 2);
    EXPECT_NEAR(cost, expected_cost, 1e-13 * expected_cost);
    EXPECT_NEAR(cost_alone, expected_cost, 1e-13 * expected_cost);
    const Eigen::VectorXd scale = expected_normal.diagonal().cwiseSqrt();
    for (Eigen::Index i = 0; i < scale.size(); ++i) {
      EXPECT_NEAR(gradient[i], expected_gradient[i], 1e-13 * scale[i] * std::sqrt(2.0 * cost));
      for (Eigen::Index j = 0; j < scale.size(); ++j) {
        EXPECT_NEAR(normal(i, j), expected_normal(i, j), 1e-13 * scale[i] * scale[j]);
      }
    }
  }
}

TEST(CalibrationProblem, CompressedIsUndefinedWhereTheModelIs) {
  const Scene scene = noisy(3);
  CalibrationProblem calibration(scene.camera, scene.poses, scene.observations, {});
  const auto compressed = calibration.compressed();
  std::vector<double> gradient;
  ASSERT_TRUE(compressed->Evaluate({}, nullptr, nullptr, &gradient, nullptr));
  calibration.blocks().main_lens[0] = 1e6;  // every board point lies within F
  EXPECT_FALSE(compressed->Evaluate({}, nullptr, nullptr, &gradient, nullptr));
  calibration.blocks().main_lens[0] = NAN;
  EXPECT_FALSE(compressed->Evaluate({}, nullptr, nullptr, &gradient, nullptr));
}

TEST(CostOptions, ParametersAreFixedAndFreed) {
  CostOptions options;
  const std::size_t by_default = options.fixed.size();
  options.fix({"F"});
  EXPECT_EQ(options.fixed.size(), by_default + 1);
  options.free({"e_z", "kappa"});
  EXPECT_EQ(options.fixed.count("e_z"), 0U);
  EXPECT_EQ(options.fixed.count("dC_ratio"), 1U);
  // A name that is misspelt frees nothing.
  test::expect_names(test::rejection([&] { options.free({"kapa"}); }), "kapa is not fixed");
}

TEST(CostOptions, NamesAreChecked) {
  const Scene scene = noisy(3);
  const auto says = [&](const CostOptions& options, const char* what) {
    test::expect_names(test::rejection([&] {
                         refine(scene.camera, scene.poses, scene.observations, options, {});
                       }),
                       what);
  };
  CostOptions options;
  options.fix({"kapa"});
  says(options, "no parameter kapa to fix");
  options = {};
  options.fixed_poses = {7};
  says(options, "no pose 7 to fix");
}

TEST(FixedPoses, StayAndHaveNoVariance) {
  const Scene scene = noisy(3);
  CostOptions options;
  options.fixed_poses = {0, 3};
  const Refinement r = refine(scene.camera, scene.poses, scene.observations, options, {});
  for (int i : {0, 3}) EXPECT_EQ(pose_block(r.poses[i]), pose_block(scene.poses[i]));
  EXPECT_NE(pose_block(r.poses[1]), pose_block(scene.poses[1]));
  const Uncertainty u = uncertainty(r.camera, r.poses, scene.observations, options);
  EXPECT_EQ(u.rank, u.size);
  EXPECT_EQ(u.std_dev_of("pose 3 t_z"), 0.0);
  EXPECT_EQ(u.covariance_of("F", "pose 0 r_x"), 0.0);
  EXPECT_GT(u.std_dev_of("pose 1 t_z"), 0.0);
  EXPECT_NE(u.covariance_of("F", "pose 1 t_z"), 0.0);
  EXPECT_EQ(u.covariance_of("F", "pose 1 t_z"), u.covariance_of("pose 1 t_z", "F"));
  // What is known of two poses makes the camera better known.
  const Uncertainty all = uncertainty(r.camera, r.poses, scene.observations, {});
  EXPECT_LT(std::sqrt(u.independent_covariance(0, 0)), std::sqrt(all.independent_covariance(0, 0)));
  EXPECT_THROW(u.covariance_of("F", "pose 9 t_z"), std::invalid_argument);
}

// Without noise a Gauss-Newton step leads back to the truth, and gains what it costs to be off it.
TEST(Uncertainty, SaysWhereOneMoreStepWouldLead) {
  const Scene truth = test::make_scene(3);
  Camera off = truth.camera;
  off.main_lens.focal_length += 1e-4;
  const Uncertainty at = uncertainty(off, truth.poses, truth.observations, {});
  ASSERT_EQ(at.names.front(), "F");
  EXPECT_NEAR(at.next_step.front(), -1e-4, 1e-6);
  const double cost = CalibrationProblem(off, truth.poses, truth.observations, {}).evaluate().cost;
  EXPECT_GT(cost, 0.0);
  EXPECT_NEAR(at.expected_decrease, cost, 0.01 * cost);
}

// A residual block that a user adds does the same as a prior among the options.
TEST(CalibrationProblem, TakesAdditions) {
  const Scene scene = noisy(3);
  CostOptions with_prior;
  with_prior.priors = {{"F", 50.2, 0.001}};
  const Refinement expected = refine(scene.camera, scene.poses, scene.observations, with_prior, {});

  CalibrationProblem calibration(scene.camera, scene.poses, scene.observations, {});
  ceres::Matrix row = ceres::Matrix::Zero(1, kMainLensParameters);
  row(0, 0) = 1.0 / 0.001;
  const ceres::Vector value = ceres::Vector::Constant(kMainLensParameters, 50.2);
  calibration.problem().AddResidualBlock(new ceres::NormalPrior(row, value), nullptr,
                                         calibration.blocks().main_lens);
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.linear_solver_ordering = calibration.ordering();
  options.max_num_iterations = 100;
  options.function_tolerance = 1e-15;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &calibration.problem(), &summary);
  EXPECT_NEAR(calibration.camera().main_lens.focal_length, expected.camera.main_lens.focal_length,
              1e-7);
  EXPECT_NEAR(summary.final_cost, expected.cost, 1e-9 * expected.cost);
}

TEST(FeatureResiduals, InARigIsTheBoardMovedByBothPoses) {
  const Scene scene = noisy(3);
  const Pose &board = scene.poses[0], rig{{0.02, -0.3, 0.1}, {12.0, -3.0, 4.0}};
  const Motion<double> outer(pose_block(rig).data()), inner(pose_block(board).data());
  const Vector3<double> point{3.0, -2.0, 1.0};
  const auto both = outer.after(inner)(point), one = outer(inner(point));
  EXPECT_NEAR(both.x, one.x, 1e-12);
  EXPECT_NEAR(both.y, one.y, 1e-12);
  EXPECT_NEAR(both.z, one.z, 1e-12);

  // rig_from_board such that the camera, turned and moved in the rig, sees the board where it did.
  Eigen::Matrix3d r_rig, r_board;
  ceres::AngleAxisToRotationMatrix(pose_block(rig).data(), r_rig.data());
  ceres::AngleAxisToRotationMatrix(pose_block(board).data(), r_board.data());
  const Eigen::Vector3d t_rig(rig.translation.x, rig.translation.y, rig.translation.z);
  const Eigen::Vector3d t_board(board.translation.x, board.translation.y, board.translation.z);
  const Eigen::Matrix3d r = r_rig.transpose() * r_board;
  const Eigen::Vector3d t = r_rig.transpose() * (t_board - t_rig);
  std::array<double, Pose::kSize> rig_from_board{};
  ceres::RotationMatrixToAngleAxis(r.data(), rig_from_board.data());
  for (int i = 0; i < 3; ++i) rig_from_board[3 + i] = t[i];

  std::vector<WeightedFeature> features;
  for (const FeatureObservation& o : scene.observations.features) {
    if (o.frame != 0) continue;
    features.push_back(
        {o.board_point, micro_lens_of(scene.camera, o.k, o.l), o.observed, {1.0, 1.0, 1.0}});
  }
  auto lens = to_block(scene.camera.main_lens);
  auto array = to_block(scene.camera.mla);
  auto focal_lengths = scene.camera.micro_lens_focal_lengths;
  auto in_camera = pose_block(board), camera_from_rig = pose_block(rig);
  const double s = scene.camera.pixel_size;
  const auto alone = FeatureResiduals<3>::create(features, s, {});
  const auto in_rig = FeatureResiduals<3, false, true>::create(features, s, {});
  const double* blocks[] = {lens.data(), array.data(), focal_lengths.data(), in_camera.data()};
  const double* rig_blocks[] = {lens.data(), array.data(), focal_lengths.data(),
                                camera_from_rig.data(), rig_from_board.data()};
  std::vector<double> expected(alone->num_residuals()), found(in_rig->num_residuals());
  ASSERT_TRUE(alone->Evaluate(blocks, expected.data(), nullptr));
  ASSERT_TRUE(in_rig->Evaluate(rig_blocks, found.data(), nullptr));
  for (std::size_t i = 0; i < expected.size(); ++i) EXPECT_NEAR(found[i], expected[i], 1e-8);
}

// Two cameras see the same boards; the second is turned and moved against the first.
TEST(Rig, IsFoundWithBothCameras) {
  const Scene first = noisy(3);
  const Pose second_from_first{{0.005, -0.01, 0.02}, {-2.0, 1.0, 0.5}};
  // The poses of the boards in the second camera, for its observations.
  std::vector<Pose> in_second;
  for (const Pose& pose : first.poses) {
    Eigen::Matrix3d r, board;
    ceres::AngleAxisToRotationMatrix(pose_block(second_from_first).data(), r.data());
    ceres::AngleAxisToRotationMatrix(pose_block(pose).data(), board.data());
    const auto& t = second_from_first.translation;
    const Eigen::Vector3d moved =
        r * Eigen::Vector3d(pose.translation.x, pose.translation.y, pose.translation.z) +
        Eigen::Vector3d(t.x, t.y, t.z);
    const Eigen::Matrix3d both = r * board;
    std::array<double, Pose::kSize> block{};
    ceres::RotationMatrixToAngleAxis(both.data(), block.data());
    for (int i = 0; i < 3; ++i) block[3 + i] = moved[i];
    in_second.push_back(pose_from_block(block));
  }
  Observations seen = test::observe(first.camera, in_second);
  test::add_noise(0.1, 0.05, 0.02, 9, &seen);

  CalibrationProblem rig(first.camera, first.poses, first.observations, {});
  Pose start = second_from_first;
  start.translation.x += 1.0;
  start.rotation.y += 0.01;
  CalibrationProblem second(rig, start, first.camera, seen, {});
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.linear_solver_ordering = rig.ordering();
  options.max_num_iterations = 100;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &rig.problem(), &summary);
  ASSERT_EQ(summary.termination_type, ceres::CONVERGENCE);
  // All residuals together have the noise that was put in, in standard deviations of 1 px.
  const auto found = pose_block(second.camera_from_first());
  ceres::Covariance covariance({});
  using Blocks = std::vector<std::pair<const double*, const double*>>;
  const double* block = second.blocks().camera_from_first;
  const Blocks pairs = {{block, block}};
  ASSERT_TRUE(covariance.Compute(pairs, &rig.problem()));
  Eigen::Matrix<double, 6, 6, Eigen::RowMajor> of_rig;
  covariance.GetCovarianceBlock(block, block, of_rig.data());
  // The noise of u and v, 0.1 px of the 1 px that the cost says.
  const auto expected = pose_block(second_from_first);
  for (int i = 0; i < 6; ++i) {
    EXPECT_LT(std::abs(found[i] - expected[i]), 4.0 * 0.1 * std::sqrt(of_rig(i, i))) << i;
  }
  EXPECT_GT(std::abs(found[3] - pose_block(start)[3]), 0.9);
  EXPECT_THROW(second.evaluate(), std::invalid_argument);
}

TEST(Pose, ComposesAndInverts) {
  const Pose a{{0.4, -0.3, 1.1}, {12.0, -3.0, 4.0}}, b{{-2.0, 1.0, 0.5}, {1.0, 2.0, 300.0}};
  const Vector3<double> point{3.0, -2.0, 1.0};
  const Motion<double> of_a(pose_block(a).data()), of_b(pose_block(b).data());
  const Motion<double> both(pose_block(composed(a, b)).data());
  const Motion<double> back(pose_block(inverse(a)).data());
  const auto near = [](const Vector3<double>& p, const Vector3<double>& q) {
    EXPECT_NEAR(p.x, q.x, 1e-12);
    EXPECT_NEAR(p.y, q.y, 1e-12);
    EXPECT_NEAR(p.z, q.z, 1e-12);
  };
  near(both(point), of_a(of_b(point)));
  near(of_a.after(of_b)(point), of_a(of_b(point)));
  near(back(of_a(point)), point);
  near(Motion<double>(pose_block(inverse(Pose{})).data())(point), point);
}

TEST(Rig, RefusesWhatIsNotOne) {
  const Scene scene = noisy(3);
  CostOptions bent;
  bent.free({"sag_x"});
  Observations observations = scene.observations;
  observations.board.half_width = observations.board.half_height = 20.0;
  CalibrationProblem first(scene.camera, scene.poses, observations, {});
  const auto says = [&](const Observations& seen, const CostOptions& options, const char* what) {
    test::expect_names(
        test::rejection([&] { CalibrationProblem(first, {}, scene.camera, seen, options); }), what);
  };
  says(observations, bent, "shape of the board has to be known");
  says({}, {}, "no feature");
  CostOptions fixed;
  fixed.fixed_poses = {0};
  says(observations, fixed, "fixed in the first camera");
  CalibrationProblem second(first, {}, scene.camera, observations, {});
  for (const CalibrationProblem* camera : {&first, &second}) {
    test::expect_names(test::rejection([&] { (void)camera->compressed(); }),
                       "not available for a rig");
  }
}

TEST(FeatureResiduals, RefusesALensTypeThatThereIsNot) {
  const std::vector<WeightedFeature> features = {{{}, {{}, 1}, {}, {1.0, 1.0, 1.0}}};
  EXPECT_THROW(FeatureResiduals<1>::create(features, 0.005, {}), std::invalid_argument);
  EXPECT_THROW((FeatureResiduals<1, true>::create(features, 0.005, {})), std::invalid_argument);
}

}  // namespace
}  // namespace plenocal
