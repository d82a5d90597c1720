// Normal equations of a calibration at its present values, in total and by groups that share
// errors.
#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "least_squares.hpp"

namespace plenocal {

/// Information (J'J) and gradient (J'r) of a group of standardised residuals.
struct Group {
  Eigen::MatrixXd information;
  Eigen::VectorXd gradient;
};

/// Normal equations over the free intrinsics, then 6 parameters per pose.
struct NormalEquations {
  int intrinsics = 0;                                       ///< number of free intrinsics
  std::array<Eigen::MatrixXd, kResidualKinds> information;  ///< by kind of residual
  Eigen::VectorXd gradient;
  /// Sum of squared residuals. For rho, whose errors the features of a corner share, the sum over
  /// corners of (sum of residuals)^2 / number of them, which is correct in either case.
  std::array<double, kResidualKinds> squares{};
  std::array<int, kResidualKinds> terms{};             ///< number of terms in these sums
  std::array<double, kResidualKinds> pixel_squares{};  ///< sum of squared residuals in px
  std::array<int, kResidualKinds> count{};             ///< number of residuals
  std::vector<Group> frames;                ///< on the free intrinsics and the pose of the frame
  std::vector<Group> patches;               ///< patches of the centres, on the free intrinsics
  std::vector<std::vector<Group>> corners;  ///< corners of every frame, on its pose
  /// Negative change of the gradient by systematic errors, a column for each: by their effect on
  /// observations, and on priors.
  Eigen::MatrixXd by_systematic_observations, by_systematic_priors;
  /// Part of the error of each prior due to these errors, as a change of the gradient; a column for
  /// each prior.
  Eigen::MatrixXd in_priors;

  /// Derivatives of the quantities with a prior, in arbitrary units: a row for each prior, a column
  /// for each free intrinsic.
  Eigen::MatrixXd priors;

  int size() const { return static_cast<int>(gradient.size()); }
  /// Returns the first parameter of the pose of a frame.
  int pose(int frame) const { return intrinsics + Pose::kSize * frame; }
};

/// Computes the normal equations, the same for any number of threads. Throws std::invalid_argument
/// if the model is not defined.
NormalEquations normal_equations(const LeastSquares& calibration,
                                 const std::vector<SystematicError>& systematic = {},
                                 int threads = 1);

/// Gradients of frames (on the free intrinsics and the pose of the frame) and of patches (on the
/// free intrinsics), as in `NormalEquations`.
struct GroupGradients {
  std::vector<Eigen::VectorXd> frames;
  std::vector<Eigen::VectorXd> patches;
};

/// Computes only the gradients, which is much faster; throws like `normal_equations`.
GroupGradients group_gradients(const LeastSquares& calibration, int threads);

/// Pseudo-inverse of an information matrix scaled to a unit diagonal, so that units do not matter.
struct ScaledInverse {
  Eigen::VectorXd inverse;  ///< inverse eigenvalues of the scaled matrix, descending; 0 for none
  Eigen::MatrixXd vectors;  ///< eigenvectors of the scaled matrix
  Eigen::MatrixXd basis;    ///< eigenvectors as changes of the parameters
  Eigen::MatrixXd coordinates;  ///< weights of the parameters in the coordinate along each
  int rank = 0;

  explicit ScaledInverse(const Eigen::MatrixXd& information);
  Eigen::MatrixXd matrix() const { return basis * inverse.asDiagonal() * basis.transpose(); }
};

}  // namespace plenocal
