// The Hessian of the cost on the intrinsics, beyond the approximation of Gauss and Newton.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "normal_equations.hpp"

namespace plenocal {

/// The least curvature of a minimum, as a fraction of that of J'J.
constexpr double kLeastCurvature = 0.05;

/// What frames and patches say about the intrinsics alone: gradients and information with the poses
/// eliminated.
struct Eliminated {
  std::vector<Group> frames;
  std::vector<Group> patches;
  Eigen::MatrixXd priors;               ///< their information
  Eigen::MatrixXd poses_by_intrinsics;  ///< how the poses follow: 6 rows for each frame
};

Eliminated without_poses(const NormalEquations& equations);

/// Hessians of the cost of each group on the intrinsics, with the poses following.
struct Curvature {
  std::vector<Eigen::MatrixXd> frames;
  std::vector<Eigen::MatrixXd> patches;
};

/// Gauss-Newton's J'J leaves out sum r r''. Where the model is not quite right, residuals have a
/// pattern, and in the weak directions that sum is as large as J'J. It is measured there, by
/// differences of the gradient; elsewhere it is negligible. The weak directions are those of the
/// observations; whether they are at a minimum, priors decide too. `calibration` is left as it
/// was.
Curvature curvature(const Eliminated& groups, LeastSquares* calibration, int threads = 1);

}  // namespace plenocal
