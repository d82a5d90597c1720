// Writes a small problem, as `plenocal calibrate --export-problem` does, for the tests of the
// examples: a noisy scene with every kind of prior, from a start beside the minimum.
//
//   write_problem DIR
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <limits>

#include "plenocal/io.hpp"
#include "synthetic_scene.hpp"

namespace plenocal::test {
namespace {

constexpr auto kProblem = R"({"format": "plenocal-problem", "version": 1,
  "board": {"half_width_mm": 12.0, "half_height_mm": 6.0, "sag_x_mm": 0.0, "sag_y_mm": 0.0,
            "twist_mm": 0.0, "aspect": 0.0},
  "rho": true, "loss": {"kind": "huber", "scale": 4.0}, "prior_weight": 2.0,
  "fixed": ["Q3", "Q1_m", "omega_x", "omega_y", "e_x", "e_y", "e_z", "e_r", "kappa_m", "dC_ratio", "sag_x", "sag_y", "twist", "aspect"],
  "priors": [{"quantity": "F", "value": 50.0, "std_dev": 0.5},
             {"quantity": "u0", "value": 231.0, "std_dev": 5.0},
             {"quantity": "m", "value": 0.127, "std_dev": 0.01},
             {"quantity": "q'_2", "value": 0.0402, "std_dev": 0.001},
             {"quantity": "tilt_u", "value": -0.009, "std_dev": 0.01}]})";

void write(const std::string& folder) {
  Scene scene = make_scene(3);
  add_noise(0.05, 0.1, 0.02, 7, &scene.observations);
  std::filesystem::create_directories(folder);
  CameraFile start;
  start.camera = scene.camera;
  start.camera.main_lens.focal_length *= 1.001;
  start.camera.width = 464;
  start.camera.height = 365;
  start.f_number = 4.0;
  write_camera(folder + "/camera.json", start);
  std::map<int, Pose> poses;
  for (std::size_t i = 0; i < scene.poses.size(); ++i) poses[static_cast<int>(i)] = scene.poses[i];
  write_poses(folder + "/poses.json", poses);
  std::ofstream(folder + "/problem.json") << kProblem << "\n";
  std::ofstream features(folder + "/features.csv"), centers(folder + "/centers.csv");
  features.precision(std::numeric_limits<double>::max_digits10);
  centers.precision(std::numeric_limits<double>::max_digits10);
  features << "frame,x,y,z,k,l,u,v,rho,std_u,std_v,std_rho\n";
  for (const FeatureObservation& o : scene.observations.features) {
    const auto& [x, y, z] = o.board_point;
    const auto& [u, v, rho] = o.observed;
    features << o.frame << ',' << x << ',' << y << ',' << z << ',' << o.k << ',' << o.l << ',' << u
             << ',' << v << ',' << rho << ",0.05,0.05,0.1\n";
  }
  centers << "k,l,u,v,std_dev\n";
  for (const CenterObservation& o : scene.observations.centers) {
    centers << o.k << ',' << o.l << ',' << o.observed.u << ',' << o.observed.v << ",0.02\n";
  }
}

}  // namespace
}  // namespace plenocal::test

int main(int argc, char** argv) {
  if (argc != 2) return 2;
  try {
    plenocal::test::write(argv[1]);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "write_problem: %s\n", error.what());
    return 1;
  }
  return 0;
}
