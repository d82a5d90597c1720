// The library leaves the settings of its host program alone.
#include <glog/logging.h>
#include <gtest/gtest.h>

#include <set>

#include "synthetic_scene.hpp"

namespace plenocal {
namespace {

// The log level is the program's choice, and a setting of the whole process.
TEST(Logging, LeavesTheLevelUnchanged) {
  const test::Scene scene = test::make_scene(1);
  for (int level : {google::GLOG_INFO, google::GLOG_FATAL}) {
    FLAGS_minloglevel = level;
    std::set<int> during;
    refine(scene.camera, scene.poses, scene.observations, test::paper(), {},
           [&during](const Iteration&) {
             during.insert(FLAGS_minloglevel);
             return true;
           });
    EXPECT_EQ(during, std::set<int>{level});
    EXPECT_EQ(FLAGS_minloglevel, level);
    uncertainty(scene.camera, scene.poses, scene.observations, test::paper());
    EXPECT_EQ(FLAGS_minloglevel, level);
  }
}

}  // namespace
}  // namespace plenocal
