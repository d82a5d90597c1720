// A Ceres program of your own on an exported problem: the (u, v) of features through the camera
// model, one residual block for each, with the camera held. It finds the poses of the boards and
// writes them for `plenocal calibrate --evaluate-only`.
//
//   own_ceres PROBLEM OUT
#include <ceres/ceres.h>

#include <cstdio>
#include <plenocal/io.hpp>

struct Reprojection {
  const plenocal::Camera& camera;
  const plenocal::FeatureObservation& seen;

  template <typename T>
  bool operator()(const T* pose, T* residual) const {
    const auto lens = plenocal::cast<T>(camera.main_lens);
    const auto array = plenocal::cast<T>(camera.mla);
    const plenocal::Optics<T> optics(lens, array, nullptr, 0, camera.pixel_size);
    const auto point = plenocal::Motion<T>(pose)(seen.board_point);
    const auto micro_lens = plenocal::micro_lens_of(camera, seen.k, seen.l);
    const auto feature = plenocal::project(optics, point, micro_lens);
    if (!feature) return false;
    residual[0] = (feature->u - seen.observed.u) / seen.std_dev.u;
    residual[1] = (feature->v - seen.observed.v) / seen.std_dev.v;
    return true;
  }
};

void run(const std::string& folder, const std::string& out) {
  const plenocal::ProblemFiles files = plenocal::read_problem(folder);
  std::vector<std::array<double, 6>> poses;
  for (const plenocal::Pose& pose : files.poses) poses.push_back(plenocal::pose_block(pose));

  ceres::Problem problem;
  using Cost = ceres::AutoDiffCostFunction<Reprojection, 2, 6>;
  for (const auto& seen : files.observations.features) {
    problem.AddResidualBlock(new Cost(new Reprojection{files.start.camera, seen}), nullptr,
                             poses[seen.frame].data());
  }
  ceres::Solver::Summary summary;
  ceres::Solve({}, &problem, &summary);
  std::printf("%s\n", summary.BriefReport().c_str());

  std::map<int, plenocal::Pose> found;
  for (std::size_t i = 0; i < poses.size(); ++i) {
    found[files.frames[i]] = plenocal::pose_from_block(poses[i]);
  }
  plenocal::write_poses(out + "/poses.json", found);
  plenocal::write_camera(out + "/camera.json", files.start);
}

int main(int argc, char** argv) {
  if (argc != 3) return std::fprintf(stderr, "usage: own_ceres PROBLEM OUT\n"), 2;
  try {
    run(argv[1], argv[2]);
  } catch (const std::exception& error) {
    return std::fprintf(stderr, "own_ceres: %s\n", error.what()), 1;
  }
  return 0;
}
