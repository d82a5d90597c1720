// Several threads in one process refine, and use one camera: free of data races under
// ThreadSanitizer, with the same results as each alone.
#include <gtest/gtest.h>

#include <thread>

#include "plenocal/back_projection.hpp"
#include "synthetic_scene.hpp"

namespace plenocal {
namespace {

TEST(Threads, RefinementsDoNotDisturbEachOther) {
  constexpr int kThreads = 4;
  test::Scene scene = test::make_scene(3);
  scene.poses.resize(2);
  scene.observations = test::observe(scene.camera, scene.poses);
  test::add_noise(0.1, 0.05, 0.02, 3, &scene.observations);
  SolverOptions solver;
  solver.max_iterations = 5;
  const auto solve = [&] {
    return refine(scene.camera, scene.poses, scene.observations, test::paper(), solver).cost;
  };
  const double alone = solve();
  std::vector<double> costs(kThreads, 0.0);
  std::vector<std::thread> threads;
  for (double& cost : costs) {
    threads.emplace_back([&] {
      cost = solve();
      uncertainty(scene.camera, scene.poses, scene.observations, test::paper());
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(costs, std::vector<double>(kThreads, alone));
}

TEST(Threads, UncertaintyIsTheSameWithAnyNumberOfThem) {
  test::Scene scene = test::make_scene(3);
  scene.poses.resize(3);
  scene.observations = test::observe(scene.camera, scene.poses);
  test::add_noise(0.1, 0.05, 0.02, 5, &scene.observations);
  const auto with = [&](int threads) {
    return uncertainty(scene.camera, scene.poses, scene.observations, test::paper(), {}, threads);
  };
  const auto information = [&](int threads) {
    std::vector<std::vector<double>> values;
    for (const Matrix& of_frame :
         frame_information(scene.camera, scene.poses, scene.observations, test::paper(), threads)) {
      values.push_back(of_frame.values);
    }
    return values;
  };
  const Uncertainty alone = with(1);
  EXPECT_GT(alone.rank, 0);
  for (int threads : {2, 5}) {
    const Uncertainty together = with(threads);
    EXPECT_EQ(together.covariance.values, alone.covariance.values);
    EXPECT_EQ(together.gradient, alone.gradient);
    EXPECT_EQ(information(threads), information(1));
  }
  // What fails in another thread fails here.
  scene.poses[2].translation.z = 1.0;
  EXPECT_THROW(with(5), std::invalid_argument);
  EXPECT_THROW(with(0), std::invalid_argument);
}

TEST(Threads, ACameraIsUsedByAllAtOnce) {
  constexpr int kThreads = 4;
  const Camera camera = test::make_scene(3).camera;
  const BackProjection back(camera);
  const auto use = [&] {
    double sum = 0.0;
    for (double u = 100.0; u < 900.0; u += 20.0) {
      const Pixel<double> pixel{u, 300.0};
      const auto at = back.micro_image_at(pixel);
      if (!at) continue;
      const MicroPixel here{at->k, at->l, pixel};
      if (const auto ray = back.object_ray(here, 450.0)) sum += ray->origin.x;
      if (const auto point = back.point({here, 3.0, {0.1, 0.1, 0.02}})) sum += point->point.z;
    }
    return sum;
  };
  const double alone = use();
  EXPECT_NE(alone, 0.0);
  std::vector<double> sums(kThreads, 0.0);
  std::vector<std::thread> threads;
  for (double& sum : sums) threads.emplace_back([&] { sum = use(); });
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(sums, std::vector<double>(kThreads, alone));
}

}  // namespace
}  // namespace plenocal
