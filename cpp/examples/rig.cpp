// Refines a rig of two plenoptic cameras: both cameras, the boards, and where the second camera is
// in the frame of the first. Each camera comes from a folder that `plenocal calibrate
// --export-problem` has written; frames of the same number show the same board at the same moment.
//
//   rig FIRST SECOND OUT
#include <ceres/ceres.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <optional>
#include <plenocal/io.hpp>
#include <plenocal/problem.hpp>
#include <string>
#include <utility>
#include <vector>

namespace {

using plenocal::Pose;

int run(const char* first_folder, const char* second_folder, const std::string& out) {
  const plenocal::ProblemFiles first = plenocal::read_problem(first_folder);
  const plenocal::ProblemFiles second = plenocal::read_problem(second_folder);

  // Where the second camera is, from a board that both see.
  std::optional<Pose> start;
  for (std::size_t i = 0; i < second.frames.size() && !start; ++i) {
    const auto& frames = first.frames;
    const auto same = std::find(frames.begin(), frames.end(), second.frames[i]);
    if (same == frames.end()) continue;
    start = composed(second.poses[i], inverse(first.poses[same - frames.begin()]));
  }
  if (!start) {
    std::fprintf(stderr, "rig: the cameras have no frame in common\n");
    return 1;
  }

  plenocal::CalibrationProblem rig(first.start.camera, first.poses, first.observations,
                                   first.options);
  plenocal::CalibrationProblem other(rig, *start, second.start.camera,
                                     second.with_frames(first.frames), second.options);
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.linear_solver_ordering = rig.ordering();
  options.max_num_iterations = 200;
  options.function_tolerance = 1e-12;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &rig.problem(), &summary);
  std::printf("%s\n", summary.BriefReport().c_str());

  const Pose pose = other.camera_from_first();
  std::printf("second from first: rotation %.9f %.9f %.9f rad, translation %.6f %.6f %.6f mm\n",
              pose.rotation.x, pose.rotation.y, pose.rotation.z, pose.translation.x,
              pose.translation.y, pose.translation.z);
  // As far as the sigma of the observations are right and independent of each other.
  double* block = other.blocks().camera_from_first;
  ceres::Covariance covariance(ceres::Covariance::Options{});
  const std::vector<std::pair<const double*, const double*>> wanted{{block, block}};
  if (covariance.Compute(wanted, &rig.problem())) {
    std::array<double, Pose::kSize * Pose::kSize> c{};
    covariance.GetCovarianceBlock(block, block, c.data());
    std::printf("sigma: rotation");
    for (int i = 0; i < Pose::kSize; ++i) {
      std::printf(i == 3 ? " rad, translation %.6f" : " %.9f", std::sqrt(c[(Pose::kSize + 1) * i]));
    }
    std::printf(" mm\n");
  }
  plenocal::CameraFile file = first.start;
  file.camera = rig.camera();
  plenocal::write_camera(out + "/first.json", file);
  file = second.start;
  file.camera = other.camera();
  plenocal::write_camera(out + "/second.json", file);
  return summary.IsSolutionUsable() ? 0 : 1;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 4) {
    std::fprintf(stderr, "usage: rig FIRST SECOND OUT\n");
    return 2;
  }
  try {
    return run(argv[1], argv[2], argv[3]);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "rig: %s\n", error.what());
    return 1;
  }
}
