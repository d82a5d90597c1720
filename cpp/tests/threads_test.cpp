// Several refinements at once in one process: free of data races under ThreadSanitizer, with the
// same results as each alone.
#include <gtest/gtest.h>

#include <thread>

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

}  // namespace
}  // namespace plenocal
