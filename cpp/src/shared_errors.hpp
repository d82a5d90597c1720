// The covariance of the parameters if residuals of a frame, of neighbouring centres or of a corner
// have errors in common.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "curvature.hpp"
#include "normal_equations.hpp"

namespace plenocal {

/// Covariance of the gradient if errors are independent between groups, but not within them.
///
/// It is sum_g g g', each gradient taken at the groups' own minimum, where their sum vanishes, and
/// corrected for what the fit has taken from it: with the leverage K = H_g H^+ of the group, the
/// gradient of independent errors has the covariance (1 - K) H_g there, and (1 - K)^(-1/2) g has
/// H_g. So the result is unbiased if errors are independent after all (the "CR2" of Bell and
/// McCaffrey, 2002). Directions that one group determines alone get the mean variance of the
/// others.
Eigen::MatrixXd gradient_spread(const std::vector<Group>& groups);

/// Changes of the parameters by each systematic error: a column for each.
Eigen::MatrixXd systematic_changes(const NormalEquations& equations, const Eigen::MatrixXd& inverse,
                                   double prior_weight);

/// The part of the covariance that is not due to single observations: of priors, and of systematic
/// errors.
Eigen::MatrixXd systematic_covariance(const NormalEquations& equations,
                                      const Eigen::MatrixXd& inverse, double prior_weight);

/// Two measurements of one thing that differ.
struct Contradiction {
  double std_devs = 0.0;
  int parameter = -1;  ///< row of the free intrinsic that the difference moves most; -1 for none
};

/// What is known of shared errors and of single frames; see `Uncertainty`.
struct SharedErrors {
  Eigen::MatrixXd covariance;
  Eigen::VectorXd freedom;
  double dispersion;
  Contradiction contradiction;
  Eigen::MatrixXd poses_by_intrinsics;
  Eigen::MatrixXd frame_shares;
  Eigen::MatrixXd left_out_changes;
  Eigen::MatrixXd systematic_changes;
};

/// `inverse` is H^+, `independent` the covariance of the gradient if all errors are independent:
/// variances of the intrinsics are at least what that makes them. Evaluates `calibration` at other
/// values nearby, and leaves it as it was.
SharedErrors shared_errors(const NormalEquations& equations, const Eigen::MatrixXd& inverse,
                           const Eigen::MatrixXd& independent, double prior_weight,
                           LeastSquares* calibration, int threads);

/// How many times larger than the weights claim the variance of the quantities with a prior is if
/// the gradient has the covariance `spread` instead of `information` (of all parameters, or of the
/// intrinsics with the poses eliminated); the mean over the priors, and 1 without any.
/// Where the observations have no minimum of their own along the way of a prior, their J'J counts
/// instead of their Hessian `information`.
double mean_dispersion(const NormalEquations& equations, const Eigen::MatrixXd& inverse,
                       const Eigen::MatrixXd& spread, const Eigen::MatrixXd& information,
                       const Eigen::MatrixXd& gauss_newton);

/// A matrix as callers get it.
Matrix to_matrix(const Eigen::MatrixXd& matrix);

/// A matrix that is symmetric up to rounding, made so to the last bit.
Eigen::MatrixXd symmetric(const Eigen::MatrixXd& matrix);

}  // namespace plenocal
