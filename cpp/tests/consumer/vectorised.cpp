// A program that is compiled for more of the processor than the library is (-mavx2, -march=native)
// and has Eigen matrices of its own: memory of the one must never be freed by the other.
#include <Eigen/Dense>
#include <cmath>
#include <cstdio>
#include <plenocal/points.hpp>
#include <plenocal/problem.hpp>

namespace {

plenocal::Camera camera() {
  plenocal::Camera camera;
  camera.lattice = {plenocal::Packing::kHexagonalRowsEven, 20, 20};
  camera.pixel_size = 0.0055;
  camera.main_lens.focal_length = 50.0;
  camera.mla = {{250.0, 240.0}, 0.33, {}, {}, 59.0, 0.13, 1.0};
  camera.micro_lens_focal_lengths = {0.58};
  return camera;
}

plenocal::Observations observe(const plenocal::Camera& camera,
                               const std::vector<plenocal::Pose>& poses) {
  plenocal::Observations seen;
  for (std::size_t frame = 0; frame < poses.size(); ++frame) {
    for (int i = 0; i < 20; ++i) {
      const plenocal::Vector3<double> corner{2.0 * (i % 5), 2.0 * (i / 5), 0.0};
      const auto point = plenocal::transformed(poses[frame], corner);
      for (const auto& [k, l] : plenocal::micro_lenses_seeing(camera, point, 1.0)) {
        const auto feature = plenocal::project(camera, poses[frame], corner, k, l);
        if (feature) seen.features.push_back({static_cast<int>(frame), corner, k, l, *feature});
      }
    }
  }
  for (int l = 0; l < camera.lattice.rows; ++l) {
    for (int k = 0; k < camera.lattice.columns; ++k) {
      seen.centers.push_back({k, l, plenocal::project_center(camera, k, l)});
    }
  }
  return seen;
}

}  // namespace

int main() {
  const plenocal::Camera truth = camera();
  std::vector<plenocal::Pose> poses;
  for (double tilt : {-0.4, -0.2, 0.0, 0.2, 0.4, 0.5}) {
    poses.push_back({{tilt, 0.5 - tilt, 0.1}, {-4.0, -3.0, 280.0 + 100.0 * tilt}});
  }
  const plenocal::Observations seen = observe(truth, poses);
  plenocal::Camera start = truth;
  start.main_lens.focal_length *= 1.002;

  plenocal::CalibrationProblem problem(start, poses, seen, {});
  double cost = 0.0;
  for (int i = 0; i < 3; ++i) {
    const plenocal::Evaluation at = problem.evaluate();
    cost = at.cost;
    const Eigen::VectorXd own =
        Eigen::Map<const Eigen::VectorXd>(at.residuals.data(), at.residuals.size());
    if (std::abs(0.5 * own.squaredNorm() - cost) > 1e-9 * cost) return 1;
    Eigen::VectorXd state = Eigen::VectorXd::Zero(1);
    const std::vector<double> present = problem.state();
    state.resize(present.size());
    state = Eigen::Map<const Eigen::VectorXd>(present.data(), present.size());
    problem.set_state({state.begin(), state.end()});
  }
  const auto refined = plenocal::refine(start, poses, seen, {}, {});
  const auto u = plenocal::uncertainty(refined.camera, refined.poses, seen, {});
  // Products, inverses and changes of size: functions that the library has as well.
  Eigen::MatrixXd covariance = u.covariance.eigen();
  const int free = static_cast<int>(u.free_intrinsics.size());
  covariance.conservativeResize(free, free);
  const Eigen::MatrixXd scaled = covariance.diagonal().cwiseSqrt().cwiseInverse().asDiagonal() *
                                 covariance *
                                 covariance.diagonal().cwiseSqrt().cwiseInverse().asDiagonal();
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(scaled);
  std::printf("%zu features, cost %.3f then %.1e, F %.4f, largest %.1f\n", seen.features.size(),
              cost, refined.cost, refined.camera.main_lens.focal_length,
              eigen.eigenvalues().maxCoeff());
  const bool found = std::abs(refined.camera.main_lens.focal_length - 50.0) < 1e-6;
  return cost > 1.0 && found && std::isfinite(eigen.eigenvalues().sum()) ? 0 : 1;
}
