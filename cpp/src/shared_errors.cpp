#include "shared_errors.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

namespace plenocal {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

// Largest fraction of the information outside of a group that alone determines a direction.
constexpr double kAlone = 1e-3;

MatrixXd sum_of_information(const std::vector<Group>& groups) {
  const auto size = groups.front().gradient.size();
  return std::accumulate(
      groups.begin(), groups.end(), MatrixXd(MatrixXd::Zero(size, size)),
      [](const MatrixXd& sum, const Group& g) -> MatrixXd { return sum + g.information; });
}

// Returns the variance of each intrinsic due to each group (a row) if the gradient of the group has
// its information as covariance.
MatrixXd claimed_variances(const std::vector<Group>& groups, const MatrixXd& inverse) {
  MatrixXd variances(groups.size(), inverse.rows());
  for (std::size_t g = 0; g < groups.size(); ++g) {
    variances.row(g) = (inverse * groups[g].information * inverse).diagonal();
  }
  return variances;
}

// Returns the inverse degrees of freedom of a variance in which the groups have the share `part`
// (Satterthwaite).
VectorXd inverse_freedom(const MatrixXd& variances, const VectorXd& part) {
  VectorXd result(part.size());
  for (Eigen::Index i = 0; i < part.size(); ++i) {
    const double sum = variances.col(i).sum(), squares = variances.col(i).squaredNorm();
    const double freedom = squares > 0.0 ? sum * sum / squares - 1.0 : 0.0;
    result[i] = part[i] > 0.0 ? part[i] * part[i] / std::max(freedom, 1e-9) : 0.0;
  }
  return result;
}

// Returns the ratio of the spread of the gradient to its information, averaged over directions.
double dispersion_of(const MatrixXd& spread, const MatrixXd& information) {
  const ScaledInverse inverse(information);
  return inverse.rank > 0 ? spread.cwiseProduct(inverse.matrix()).sum() / inverse.rank : 1.0;
}

// Least fraction of the information of each, for which a direction counts as measured by both.
constexpr double kMeasuredByBoth = 1e-3;
// Least contradiction that is not chance, in standard deviations.
constexpr double kChance = 3.0;

// Compares the common measurements of boards (with priors) and centres: along every eigenvector of
// their relative information these are two measurements of one number.
Contradiction contradiction(const MatrixXd& boards, const MatrixXd& centers, double of_boards,
                            double of_centers, const VectorXd& gradient_of_centers,
                            const VectorXd& variance) {
  const ScaledInverse sum(boards + centers);
  if (sum.rank == 0) return {};
  const MatrixXd root =
      sum.basis.rightCols(sum.rank) * sum.inverse.tail(sum.rank).cwiseSqrt().asDiagonal();
  const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(root.transpose() * boards * root);
  const MatrixXd directions = root * eigen.eigenvectors();
  const VectorXd gradient = directions.transpose() * gradient_of_centers;
  Contradiction result;
  for (int i = 0; i < sum.rank; ++i) {
    const double part = eigen.eigenvalues()[i], rest = 1.0 - part;
    if (part < kMeasuredByBoth || rest < kMeasuredByBoth) continue;
    const double spread = part * rest * (rest * of_boards + part * of_centers);
    const double apart = std::abs(gradient[i]) / std::sqrt(spread);
    if (apart < std::max(kChance, result.std_devs)) continue;
    Eigen::Index most = 0;
    directions.col(i).cwiseAbs2().cwiseQuotient(variance).maxCoeff(&most);
    result = {apart, static_cast<int>(most)};
  }
  return result;
}

// Combines a matrix over all parameters from the matrix of the intrinsics, which the poses follow,
// and the independent part of each pose.
MatrixXd joined(const MatrixXd& of_intrinsics, const MatrixXd& follow,
                const std::vector<MatrixXd>& of_poses) {
  const auto p = of_intrinsics.rows(), size = p + follow.rows();
  MatrixXd all(size, size);
  all << of_intrinsics, of_intrinsics * follow.transpose(), follow * of_intrinsics,
      follow * of_intrinsics * follow.transpose();
  auto first = p;
  for (const MatrixXd& own : of_poses) {
    all.block<Pose::kSize, Pose::kSize>(first, first) += own;
    first += Pose::kSize;
  }
  return all;
}

// Returns the changes of the intrinsics if each frame were left out, to first order: (H - H_f)^-1
// g_f.
MatrixXd left_out_changes(const std::vector<Group>& frames, const Curvature& curved,
                          const MatrixXd& hessian) {
  MatrixXd changes(frames.size(), hessian.rows());
  const int rank = ScaledInverse(hessian).rank;
  for (std::size_t f = 0; f < frames.size(); ++f) {
    const ScaledInverse without(hessian - curved.frames[f]);
    changes.row(f) = without.matrix() * frames[f].gradient;
    if (without.rank < rank) changes.row(f).setConstant(std::numeric_limits<double>::quiet_NaN());
  }
  return changes;
}

}  // namespace

MatrixXd systematic_changes(const NormalEquations& equations, const MatrixXd& inverse,
                            double prior_weight) {
  return inverse * (equations.by_systematic_observations +
                    std::sqrt(prior_weight) * equations.by_systematic_priors);
}

MatrixXd prior_covariance(const NormalEquations& equations, const MatrixXd& inverse,
                          double prior_weight) {
  const MatrixXd contained = std::sqrt(prior_weight) * inverse * equations.in_priors;
  return prior_weight * (inverse * equations.information[kPrior] * inverse) -
         contained * contained.transpose();
}

MatrixXd systematic_covariance(const NormalEquations& equations, const MatrixXd& inverse,
                               double prior_weight) {
  const MatrixXd changes = systematic_changes(equations, inverse, prior_weight);
  return prior_covariance(equations, inverse, prior_weight) + changes * changes.transpose();
}

MatrixXd symmetric(const MatrixXd& matrix) { return 0.5 * (matrix + matrix.transpose()); }

Matrix to_matrix(const MatrixXd& matrix) {
  Matrix result{static_cast<int>(matrix.rows()), static_cast<int>(matrix.cols()),
                std::vector<double>(matrix.size())};
  result.eigen() = matrix;
  return result;
}

MatrixXd gradient_spread(const std::vector<Group>& groups) {
  const MatrixXd information = sum_of_information(groups);
  const ScaledInverse sum(information);
  // Coordinates y in which the information of all groups together is the identity, with g = `back`
  // y.
  const int rank = sum.rank;
  if (rank == 0) return MatrixXd::Zero(information.rows(), information.cols());
  const MatrixXd root = sum.basis.rightCols(rank) * sum.inverse.tail(rank).cwiseSqrt().asDiagonal();
  const MatrixXd back = information * root;
  VectorXd total = VectorXd::Zero(rank);
  for (const Group& group : groups) total += root.transpose() * group.gradient;

  MatrixXd spread = MatrixXd::Zero(rank, rank), alone = MatrixXd::Zero(rank, rank);
  for (const Group& group : groups) {
    const MatrixXd leverage = root.transpose() * group.information * root;
    const VectorXd own = root.transpose() * group.gradient - leverage * total;
    const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(leverage);
    const VectorXd factors = eigen.eigenvalues().unaryExpr(
        [](double k) { return k < 1.0 - kAlone ? 1.0 / std::sqrt(1.0 - k) : 0.0; });
    const VectorXd corrected =
        eigen.eigenvectors() * factors.cwiseProduct(eigen.eigenvectors().transpose() * own);
    spread += corrected * corrected.transpose();
    const VectorXd unknown =
        eigen.eigenvalues().unaryExpr([](double k) { return k < 1.0 - kAlone ? 0.0 : k; });
    alone += eigen.eigenvectors() * unknown.asDiagonal() * eigen.eigenvectors().transpose();
  }
  const double compared = rank - alone.trace();
  spread += (compared > 0.5 ? spread.trace() / compared : 1.0) * alone;
  return back * spread * back.transpose();
}

// Least share of observations in the information on a quantity with a prior, for which the quantity
// counts here.
constexpr double kLeastShare = 1e-6;

double mean_dispersion(const NormalEquations& equations, const MatrixXd& inverse,
                       const MatrixXd& spread, const MatrixXd& information,
                       const MatrixXd& gauss_newton) {
  double sum = 0.0;
  int count = 0;
  for (const auto& prior : equations.priors.rowwise()) {
    const VectorXd to =
        inverse.topLeftCorner(spread.rows(), equations.intrinsics) * prior.transpose();
    const double claimed = to.dot(information * to), least = to.dot(gauss_newton * to);
    // A quantity that only its prior determines, such as q'_i without rho, does not count.
    if (!(least > kLeastShare * std::abs(prior.dot(to)))) continue;
    sum += to.dot(spread * to) / (claimed > kLeastCurvature * least ? claimed : least);
    ++count;
  }
  return count > 0 ? sum / count : 1.0;
}

// Returns a covariance with variances of at least `least` and the same correlations.
MatrixXd at_least(const MatrixXd& covariance, const VectorXd& least) {
  const VectorXd larger =
      covariance.diagonal().binaryExpr(least, [](double variance, double least) {
        return variance > 0.0 ? std::sqrt(std::max(1.0, least / variance)) : 1.0;
      });
  return larger.asDiagonal() * covariance * larger.asDiagonal();
}

SharedErrors shared_errors(const NormalEquations& equations, const MatrixXd& inverse,
                           const MatrixXd& independent, double prior_weight,
                           LeastSquares* calibration, int threads) {
  const int p = equations.intrinsics;
  const Eliminated groups = without_poses(equations);
  const MatrixXd& follow = groups.poses_by_intrinsics;
  const Curvature curved = curvature(groups, calibration, threads);
  MatrixXd observed = MatrixXd::Zero(p, p);
  for (const MatrixXd& hessian : curved.frames) observed += hessian;
  for (const MatrixXd& hessian : curved.patches) observed += hessian;
  const MatrixXd hessian = observed + groups.priors;
  const MatrixXd of_intrinsics = ScaledInverse(hessian).matrix();

  SharedErrors result;
  result.poses_by_intrinsics = follow;
  const MatrixXd claimed = claimed_variances(groups.frames, of_intrinsics);
  result.frame_shares = claimed_variances(groups.frames, inverse.topLeftCorner(p, p)) *
                        inverse.diagonal().head(p).cwiseInverse().asDiagonal();
  result.left_out_changes = left_out_changes(groups.frames, curved, hessian);

  const MatrixXd by_frames = gradient_spread(groups.frames);
  const MatrixXd by_patches = gradient_spread(groups.patches);
  const MatrixXd boards = sum_of_information(groups.frames);
  const MatrixXd centers = sum_of_information(groups.patches);
  result.dispersion =
      mean_dispersion(equations, of_intrinsics, by_frames + by_patches, observed, boards + centers);
  MatrixXd eliminate(p, equations.size());
  eliminate << MatrixXd::Identity(p, p), follow.transpose();
  const MatrixXd of_all = of_intrinsics * eliminate;
  // A few frames can agree by chance better than noise allows.
  result.noise_covariance = symmetric(of_all * independent * of_all.transpose());
  const MatrixXd camera = at_least(of_intrinsics * (by_frames + by_patches) * of_intrinsics,
                                   result.noise_covariance.diagonal());
  if (p > 0 && equations.count[kCenter] > 0) {
    VectorXd gradient = VectorXd::Zero(p);
    for (const Group& patch : groups.patches) gradient += patch.gradient;
    result.contradiction =
        contradiction(boards + groups.priors, centers, dispersion_of(by_frames, boards),
                      dispersion_of(by_patches, centers), gradient, camera.diagonal());
  }
  std::vector<MatrixXd> of_poses, spread_of_poses;
  for (const std::vector<Group>& corners : equations.corners) {
    const MatrixXd pose = ScaledInverse(sum_of_information(corners)).matrix();
    of_poses.push_back(pose);
    spread_of_poses.push_back(pose * gradient_spread(corners) * pose);
  }
  const MatrixXd hessian_inverse = joined(of_intrinsics, follow, of_poses);
  result.covariance = symmetric(joined(camera, follow, spread_of_poses) +
                                systematic_covariance(equations, hessian_inverse, prior_weight));
  result.prior_covariance =
      symmetric(prior_covariance(equations, hessian_inverse, prior_weight)).topLeftCorner(p, p);
  result.systematic_changes = systematic_changes(equations, hessian_inverse, prior_weight);

  const VectorXd variance = result.covariance.diagonal().head(p);
  const auto part = [&](const MatrixXd& spread) -> VectorXd {
    return (of_intrinsics * spread * of_intrinsics).diagonal().cwiseQuotient(variance);
  };
  result.freedom =
      (inverse_freedom(claimed, part(by_frames)) +
       inverse_freedom(claimed_variances(groups.patches, of_intrinsics), part(by_patches)))
          .cwiseInverse();
  return result;
}

}  // namespace plenocal
