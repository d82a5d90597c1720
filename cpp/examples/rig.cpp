// Refines a rig of two plenoptic cameras: both cameras, the boards, and where the second camera is
// in the frame of the first. Each camera comes from a folder that `plenocal calibrate
// --export-problem` has written; frames of the same number show the same board at the same moment.
//
//   rig FIRST SECOND OUT
#include <ceres/ceres.h>

#include <cstdio>
#include <map>
#include <plenocal/io.hpp>
#include <plenocal/problem.hpp>
#include <string>
#include <vector>

namespace {

using plenocal::Pose;

int run(const char* first_folder, const char* second_folder, const std::string& out) {
  const plenocal::ProblemFiles first = plenocal::read_problem(first_folder);
  plenocal::ProblemFiles second = plenocal::read_problem(second_folder);

  // The frames of the second camera as indices into the poses of the first.
  std::map<int, int> index;
  for (std::size_t i = 0; i < first.frames.size(); ++i)
    index[first.frames[i]] = static_cast<int>(i);
  Pose start{};
  bool has_start = false;
  std::vector<plenocal::FeatureObservation> shared;
  for (plenocal::FeatureObservation f : second.observations.features) {
    const auto found = index.find(second.frames[f.frame]);
    if (found == index.end()) continue;
    if (!has_start) {  // where the second camera is, from a board that both see
      start = composed(second.poses[f.frame], inverse(first.poses[found->second]));
      has_start = true;
    }
    f.frame = found->second;
    shared.push_back(f);
  }
  if (!has_start) {
    std::fprintf(stderr, "rig: the cameras have no frame in common\n");
    return 1;
  }
  second.observations.features = shared;

  plenocal::CalibrationProblem rig(first.start.camera, first.poses, first.observations,
                                   first.options);
  plenocal::CalibrationProblem other(rig, start, second.start.camera, second.observations,
                                     second.options);
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
