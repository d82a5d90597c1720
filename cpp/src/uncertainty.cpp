#include <Eigen/Dense>
#include <algorithm>
#include <limits>

#include "checks.hpp"
#include "curvature.hpp"
#include "normal_equations.hpp"
#include "plenocal/refine.hpp"
#include "shared_errors.hpp"

namespace plenocal {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

// Largest component of a parameter in an undetermined direction, as a fraction of its length, for
// which the parameter counts as determined; rounding errors of the directions are far smaller.
constexpr double kDeterminedTolerance = 1e-3;

// Dispersion assumed if too few frames show their shared errors. On real observations the variance
// is some tens of times the variance of independent errors, on simulated ones a few times.
constexpr double kAssumedDispersion = 10.0;

// Returns the covariance of the gradient for independent errors of observations, and measures their
// noise.
MatrixXd independent_spread(const NormalEquations& equations, const MatrixXd& inverse,
                            Uncertainty* result) {
  MatrixXd spread = MatrixXd::Zero(equations.size(), equations.size());
  for (int kind = 0; kind < kObservedKinds; ++kind) {
    const MatrixXd& information = equations.information[kind];
    const double used = information.cwiseProduct(inverse).sum();
    // Without redundancy the noise cannot be measured; the stated noise is used.
    const double redundancy = equations.terms[kind] - used;
    const double variance = redundancy > 0.5 ? equations.squares[kind] / redundancy : 1.0;
    spread += variance * information;
    result->std_dev_factors[kind] = std::sqrt(variance);
    const double spare = equations.count[kind] - used;
    result->residual_std_dev[kind] = spare > 0.5 ? std::sqrt(equations.pixel_squares[kind] / spare)
                                                 : std::numeric_limits<double>::quiet_NaN();
  }
  return spread;
}

// Along a determined direction, the changes of parameters follow from their covariance with the
// coordinate.
void add_weakest(const ScaledInverse& inverse, const MatrixXd& covariance, Uncertainty* result) {
  const int count = std::min(Uncertainty::kWeakest, result->size);
  MatrixXd weakest(count, result->size);
  for (int i = 0; i < count; ++i) {
    VectorXd change = inverse.basis.col(i);
    if (inverse.inverse[i] > 0.0) {
      const VectorXd coordinate = inverse.coordinates.col(i);
      const double variance = coordinate.dot(covariance * coordinate);
      change = covariance * coordinate / (variance > 0.0 ? std::sqrt(variance) : 1.0);
    }
    weakest.row(i) = change.transpose();
  }
  result->weakest = to_matrix(weakest);
}

void require_systematic(const std::vector<SystematicError>& systematic,
                        const Observations& observations, std::size_t priors) {
  for (const SystematicError& error : systematic) {
    if (error.features.size() != observations.features.size() ||
        (!error.centers.empty() && error.centers.size() != observations.centers.size()) ||
        (!error.priors.empty() && error.priors.size() != priors)) {
      throw std::invalid_argument(
          "a systematic error does not belong to these observations and priors");
    }
    const bool features_finite =
        std::all_of(error.features.begin(), error.features.end(), [](const Feature<double>& by) {
          return std::isfinite(by.u) && std::isfinite(by.v) && std::isfinite(by.rho);
        });
    const bool centers_finite = std::all_of(
        error.centers.begin(), error.centers.end(),
        [](const Pixel<double>& by) { return std::isfinite(by.u) && std::isfinite(by.v); });
    const bool priors_finite = std::all_of(error.priors.begin(), error.priors.end(),
                                           [](double by) { return std::isfinite(by); });
    if (!features_finite || !centers_finite || !priors_finite) {
      throw std::invalid_argument("a systematic error is not finite");
    }
  }
}

}  // namespace

Uncertainty uncertainty(const Camera& camera, const std::vector<Pose>& poses,
                        const Observations& observations, const CostOptions& cost_options,
                        const std::vector<SystematicError>& systematic, int threads) {
  if (threads < 1) reject("threads has to be at least 1");
  require_systematic(systematic, observations, cost_options.priors.size());
  LeastSquares calibration(camera, poses, observations, cost_options);
  const NormalEquations equations = normal_equations(calibration, systematic, threads);

  Uncertainty result;
  result.free_intrinsics = calibration.free_intrinsics();
  result.size = equations.size();
  MatrixXd total = equations.information[kUv];
  for (int kind = kRho; kind < kResidualKinds; ++kind) total += equations.information[kind];
  result.names = calibration.names();
  const VectorXd diagonal = total.diagonal();
  result.information.assign(diagonal.begin(), diagonal.end());
  // A fixed pose has no error, and nothing else depends on it.
  for (int pose : calibration.fixed_poses()) {
    total.diagonal().segment<Pose::kSize>(equations.pose(pose)).setOnes();
  }

  const ScaledInverse scaled(total);
  result.rank = scaled.rank;
  const auto null_space = scaled.vectors.leftCols(result.size - result.rank);
  for (int i = 0; i < result.size; ++i) {
    result.determined.push_back(null_space.row(i).norm() < kDeterminedTolerance);
  }
  const MatrixXd inverse = scaled.matrix();
  const MatrixXd independent = independent_spread(equations, inverse, &result);
  const double weight = cost_options.prior_weight;
  const MatrixXd covariance = symmetric(inverse * independent * inverse +
                                        systematic_covariance(equations, inverse, weight));
  result.independent_covariance = to_matrix(covariance);
  const MatrixXd observed = total - equations.information[kPrior];
  const SharedErrors shared =
      shared_errors(equations, inverse, independent, weight, &calibration, threads);
  result.poses_by_intrinsics = to_matrix(shared.poses_by_intrinsics);
  result.frame_shares = to_matrix(shared.frame_shares);
  result.left_out_changes = to_matrix(shared.left_out_changes);
  result.shared = equations.intrinsics == 0 || poses.size() >= Uncertainty::kEnoughFrames;
  if (result.shared) {
    result.dispersion = shared.dispersion;
    result.contradiction = shared.contradiction.std_devs;
    result.contradicted = shared.contradiction.parameter;
    result.freedom.assign(shared.freedom.begin(), shared.freedom.end());
  } else {
    result.dispersion =
        kAssumedDispersion * mean_dispersion(equations, inverse, independent, observed, observed);
  }
  const MatrixXd changes =
      result.shared ? shared.systematic_changes : systematic_changes(equations, inverse, weight);
  result.systematic_changes = to_matrix(changes.topRows(equations.intrinsics).transpose());
  result.covariance = to_matrix(result.shared ? shared.covariance : covariance);
  const auto of_intrinsics = [&](const MatrixXd& all) -> MatrixXd {
    return symmetric(all).topLeftCorner(equations.intrinsics, equations.intrinsics);
  };
  result.noise_covariance = to_matrix(
      result.shared ? shared.noise_covariance : of_intrinsics(inverse * independent * inverse));
  result.prior_covariance =
      to_matrix(result.shared ? shared.prior_covariance
                              : of_intrinsics(prior_covariance(equations, inverse, weight)));
  add_weakest(scaled, result.shared ? shared.covariance : covariance, &result);
  const VectorXd step = -inverse * equations.gradient;
  result.next_step.assign(step.begin(), step.end());
  result.gradient.assign(equations.gradient.begin(), equations.gradient.end());
  result.expected_decrease = -0.5 * equations.gradient.dot(step);
  return result;
}

double Uncertainty::covariance_of(const std::string& a, const std::string& b) const {
  const auto index = [this](const std::string& name) {
    const auto found = std::find(names.begin(), names.end(), name);
    if (found == names.end()) reject("there is no free parameter " + name);
    return static_cast<int>(found - names.begin());
  };
  return covariance(index(a), index(b));
}

double Uncertainty::std_dev_of(const std::string& name) const {
  return std::sqrt(covariance_of(name, name));
}

std::vector<Matrix> frame_information(const Camera& camera, const std::vector<Pose>& poses,
                                      const Observations& observations,
                                      const CostOptions& cost_options, int threads) {
  if (threads < 1) reject("threads has to be at least 1");
  const LeastSquares calibration(camera, poses, observations, cost_options);
  const Eliminated groups = without_poses(normal_equations(calibration, {}, threads));
  std::vector<Matrix> all;
  for (const Group& frame : groups.frames) all.push_back(to_matrix(frame.information));
  return all;
}

}  // namespace plenocal
