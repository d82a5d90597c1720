// Hessian of the cost on the intrinsics, beyond the Gauss-Newton approximation.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "normal_equations.hpp"

namespace plenocal {

/// Least curvature of a minimum, as a fraction of the curvature of J'J.
constexpr double kLeastCurvature = 0.05;

/// Gradients and information of frames and patches on the intrinsics alone, with the poses
/// eliminated.
struct Eliminated {
  std::vector<Group> frames;
  std::vector<Group> patches;
  Eigen::MatrixXd priors;               ///< information of the priors
  Eigen::MatrixXd poses_by_intrinsics;  ///< derivative of the poses: 6 rows for each frame
};

Eliminated without_poses(const NormalEquations& equations);

/// Hessians of the cost of each group on the intrinsics; the poses follow the intrinsics.
struct Curvature {
  std::vector<Eigen::MatrixXd> frames;
  std::vector<Eigen::MatrixXd> patches;
};

/// Computes the Hessians including sum r r'', which Gauss-Newton's J'J omits. If the model is not
/// exact, residuals have a pattern, and in the weak directions this sum is as large as J'J. It is
/// measured there by differences of the gradient; elsewhere it is negligible. The observations
/// determine the weak directions; priors contribute to the decision whether these are at a minimum.
/// The state of `calibration` is restored.
Curvature curvature(const Eliminated& groups, LeastSquares* calibration, int threads = 1);

}  // namespace plenocal
