#include "curvature.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <stdexcept>

namespace plenocal {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

// Number of weak directions, and the length of the steps along them, in standard deviations
// according to the weights. Valleys are curved: a straight step leaves them quadratically, which
// gives a large gradient on their steep walls. It is the same on both sides, and cancels in the
// difference.
constexpr int kDirections = 4;
constexpr double kStep = 1e-4;

// Returns the state of a problem moved along a direction of the intrinsics, with the poses
// following.
VectorXd moved(const LeastSquares& calibration, const VectorXd& state, const VectorXd& change,
               const MatrixXd& poses_by_intrinsics) {
  VectorXd result = state;
  const auto& free = calibration.free_intrinsics();
  for (std::size_t i = 0; i < free.size(); ++i) result[free[i]] += change[i];
  result.tail(poses_by_intrinsics.rows()) += poses_by_intrinsics * change;
  return result;
}

// Returns H + S of each group, where S is known only along the directions:
// S `directions` = `second`. Its part between two other directions is neglected. `dual` are the
// coordinates along the directions.
MatrixXd with_second_order(const MatrixXd& information, const MatrixXd& second,
                           const MatrixXd& directions, const MatrixXd& dual) {
  const MatrixXd within = directions.transpose() * second;
  return information + second * dual.transpose() + dual * second.transpose() -
         dual * (0.5 * (within + within.transpose())) * dual.transpose();
}

// Returns true if the Hessian of the whole cost is positive along all directions, as it is at a
// minimum. Elsewhere, J'J is the better estimate. The Hessian of the observations is the identity
// along the directions.
bool is_minimum(const MatrixXd& directions, const MatrixXd& priors,
                const std::vector<MatrixXd>& of_frames, const std::vector<MatrixXd>& of_patches) {
  MatrixXd within = directions.transpose() * priors * directions;
  within.diagonal().array() += 1.0;
  within *= 1.0 - kLeastCurvature;
  for (const MatrixXd& second : of_frames) within += directions.transpose() * second;
  for (const MatrixXd& second : of_patches) within += directions.transpose() * second;
  const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(0.5 * (within + within.transpose()));
  return eigen.eigenvalues().minCoeff() > 0.0;
}

}  // namespace

Eliminated without_poses(const NormalEquations& equations) {
  const int p = equations.intrinsics;
  Eliminated result;
  result.patches = equations.patches;
  result.priors = equations.information[kPrior].topLeftCorner(p, p);
  result.poses_by_intrinsics.resize(equations.size() - p, p);
  int first = 0;
  for (const Group& frame : equations.frames) {
    const MatrixXd pose = frame.information.bottomRightCorner<Pose::kSize, Pose::kSize>();
    const MatrixXd mixed = frame.information.bottomLeftCorner(Pose::kSize, p);
    const MatrixXd follow = -ScaledInverse(pose).matrix() * mixed;
    result.frames.push_back(
        {frame.information.topLeftCorner(p, p) + follow.transpose() * mixed,
         frame.gradient.head(p) + follow.transpose() * frame.gradient.tail<Pose::kSize>()});
    result.poses_by_intrinsics.middleRows(first, Pose::kSize) = follow;
    first += Pose::kSize;
  }
  return result;
}

Curvature curvature(const Eliminated& groups, LeastSquares* calibration, int threads) {
  const int p = static_cast<int>(groups.poses_by_intrinsics.cols());
  MatrixXd information = MatrixXd::Zero(p, p);
  for (const Group& group : groups.frames) information += group.information;
  for (const Group& group : groups.patches) information += group.information;
  const ScaledInverse inverse(information);
  const int known = std::min(kDirections, inverse.rank);
  const MatrixXd directions =
      inverse.basis.middleCols(p - inverse.rank, known) *
      inverse.inverse.segment(p - inverse.rank, known).cwiseSqrt().asDiagonal();
  const MatrixXd dual = information * directions;

  std::vector<MatrixXd> of_frames(groups.frames.size(), MatrixXd(p, known));
  std::vector<MatrixXd> of_patches(groups.patches.size(), MatrixXd(p, known));
  const VectorXd state = calibration->state();
  for (int i = 0; i < known; ++i) {
    const VectorXd direction = directions.col(i);
    const auto gradients_at = [&](double step) {
      calibration->set_state(
          moved(*calibration, state, step * direction, groups.poses_by_intrinsics));
      return group_gradients(*calibration, threads);
    };
    // If the model is not defined at such a step, hardly anything determines this direction.
    GroupGradients ahead, behind;
    try {
      ahead = gradients_at(kStep);
      behind = gradients_at(-kStep);
    } catch (const std::invalid_argument&) {
      for (MatrixXd& second : of_frames) second.col(i).setZero();
      for (MatrixXd& second : of_patches) second.col(i).setZero();
      continue;
    }
    const auto second = [&](const VectorXd& change, const Group& group) -> VectorXd {
      return change / (2.0 * kStep) - group.information * direction;
    };
    for (std::size_t f = 0; f < groups.frames.size(); ++f) {
      const auto follow = groups.poses_by_intrinsics.middleRows<Pose::kSize>(Pose::kSize * f);
      const VectorXd change = ahead.frames[f] - behind.frames[f];
      of_frames[f].col(i) = second(change.head(p) + follow.transpose() * change.tail<Pose::kSize>(),
                                   groups.frames[f]);
    }
    for (std::size_t g = 0; g < groups.patches.size(); ++g) {
      of_patches[g].col(i) = second(ahead.patches[g] - behind.patches[g], groups.patches[g]);
    }
  }
  calibration->set_state(state);

  if (known > 0 && !is_minimum(directions, groups.priors, of_frames, of_patches)) {
    for (MatrixXd& second : of_frames) second.setZero();
    for (MatrixXd& second : of_patches) second.setZero();
  }

  Curvature result;
  for (std::size_t f = 0; f < groups.frames.size(); ++f) {
    result.frames.push_back(
        with_second_order(groups.frames[f].information, of_frames[f], directions, dual));
  }
  for (std::size_t g = 0; g < groups.patches.size(); ++g) {
    result.patches.push_back(
        with_second_order(groups.patches[g].information, of_patches[g], directions, dual));
  }
  return result;
}

}  // namespace plenocal
