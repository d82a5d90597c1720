// Points in space with all that a camera sees of them.
#pragma once

#include <gtest/gtest.h>

#include <utility>
#include <vector>

#include "plenocal/back_projection.hpp"
#include "plenocal/points.hpp"
#include "synthetic_scene.hpp"

namespace plenocal::test {

struct Views {
  std::vector<Sighting> sightings;
  Vector3<double> point;
};

// What a camera sees of points all over its view, without noise.
inline std::vector<Views> views(const Camera& camera) {
  std::vector<Views> all;
  for (double z : {240.0, 300.0, 420.0}) {
    for (double x : {-0.006, 0.0, 0.0055}) {
      for (double y : {-0.005, 0.001, 0.006}) {
        Views seen{{}, {x * z, y * z, z}};
        for (const auto& [k, l] : micro_lenses_seeing(camera, seen.point, 0.5)) {
          seen.sightings.push_back({k, l, project(camera, Pose{}, seen.point, k, l).value()});
        }
        all.push_back(std::move(seen));
      }
    }
  }
  return all;
}

}  // namespace plenocal::test
