// A camera of round numbers, for arithmetic by hand.
#pragma once

#include "plenocal/camera.hpp"

namespace plenocal::test {

/// F = 50 mm, MLA at D = 59 mm, sensor d = 0.5 mm behind it, s = 0.01 mm, 5 x 5 micro-lenses of
/// 0.2 mm on a square lattice, (u0, v0) = (100, 80) px.
inline Camera simple_camera() {
  Camera camera;
  camera.lattice = {Packing::kOrthogonal, 5, 5};
  camera.pixel_size = 0.01;
  camera.main_lens.focal_length = 50.0;
  camera.mla.principal_point[0] = 100.0;
  camera.mla.principal_point[1] = 80.0;
  camera.mla.lens_to_mla = 59.0;
  camera.mla.mla_to_sensor = 0.5;
  camera.mla.pitch = 0.2;
  camera.mla.pitch_ratio = 1.0;
  camera.micro_lens_focal_lengths = {1.0};
  return camera;
}

}  // namespace plenocal::test
