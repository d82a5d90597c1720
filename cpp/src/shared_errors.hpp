// Covariance of the parameters if residuals of a frame, of neighbouring centres or of a corner
// share errors.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "curvature.hpp"
#include "normal_equations.hpp"

namespace plenocal {

/// Returns the covariance of the gradient if errors are independent between groups, but not within
/// them.
///
/// It is sum_g g g'. Each gradient is evaluated at the groups' own minimum, where their sum
/// vanishes, and corrected for its reduction by the fit. With the leverage K = H_g H^+ of the
/// group, the gradient of independent errors has the covariance (1 - K) H_g there, and (1 -
/// K)^(-1/2) g has H_g. The result is therefore unbiased also for independent errors (the "CR2" of
/// Bell and McCaffrey, 2002). Directions that one group determines alone get the mean variance of
/// the others.
Eigen::MatrixXd gradient_spread(const std::vector<Group>& groups);

/// Returns the changes of the parameters by each systematic error: a column for each.
Eigen::MatrixXd systematic_changes(const NormalEquations& equations, const Eigen::MatrixXd& inverse,
                                   double prior_weight);

/// Returns the part of the covariance due to priors, without the systematic errors that their sigma
/// contains.
Eigen::MatrixXd prior_covariance(const NormalEquations& equations, const Eigen::MatrixXd& inverse,
                                 double prior_weight);

/// Returns the part of the covariance due to priors and systematic errors, not to single
/// observations.
Eigen::MatrixXd systematic_covariance(const NormalEquations& equations,
                                      const Eigen::MatrixXd& inverse, double prior_weight);

/// Contradiction between two measurements of one quantity.
struct Contradiction {
  double std_devs = 0.0;
  int parameter = -1;  ///< row of the free intrinsic that it affects most; -1 for none
};

/// Results for shared errors and for single frames; see `Uncertainty`.
struct SharedErrors {
  Eigen::MatrixXd covariance;
  Eigen::MatrixXd noise_covariance;
  Eigen::MatrixXd prior_covariance;
  Eigen::VectorXd freedom;
  double dispersion;
  Contradiction contradiction;
  Eigen::MatrixXd poses_by_intrinsics;
  Eigen::MatrixXd frame_shares;
  Eigen::MatrixXd left_out_changes;
  Eigen::MatrixXd systematic_changes;
};

/// Computes the shared errors. `inverse` is H^+; `independent` is the covariance of the gradient
/// for independent errors, which gives lower limits for the variances of the intrinsics. Evaluates
/// `calibration` at other values nearby, and restores its state.
SharedErrors shared_errors(const NormalEquations& equations, const Eigen::MatrixXd& inverse,
                           const Eigen::MatrixXd& independent, double prior_weight,
                           LeastSquares* calibration, int threads);

/// Returns the ratio of the variance of the quantities with a prior to the variance according to
/// the weights, if the gradient has the covariance `spread` instead of `information` (of all
/// parameters, or of the intrinsics with the poses eliminated); the mean over the priors, and 1
/// without any. If the observations have no minimum of their own in the direction of a prior, their
/// J'J replaces their Hessian `information`.
double mean_dispersion(const NormalEquations& equations, const Eigen::MatrixXd& inverse,
                       const Eigen::MatrixXd& spread, const Eigen::MatrixXd& information,
                       const Eigen::MatrixXd& gauss_newton);

/// Converts a matrix to the type of the interface.
Matrix to_matrix(const Eigen::MatrixXd& matrix);

/// Makes a matrix that is symmetric up to rounding exactly symmetric.
Eigen::MatrixXd symmetric(const Eigen::MatrixXd& matrix);

}  // namespace plenocal
