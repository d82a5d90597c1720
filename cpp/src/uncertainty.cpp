#include <Eigen/Dense>
#include <algorithm>
#include <limits>

#include "plenocal/refine.hpp"
#include "problem.hpp"

namespace plenocal {
namespace {

using RowMajorMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// Singular values of the column-scaled Jacobian below this fraction of the largest count as zero.
// They come as square roots of eigenvalues of J'J, which carry an error near
// size * epsilon ~ 1e-14 of the largest: values below 1e-7 cannot be distinguished from zero.
constexpr double kRankTolerance = 1e-7;

// A parameter is not determined if a direction that is not determined moves it by more than this
// fraction of the direction's length; rounding errors of the directions are far smaller.
constexpr double kDeterminedTolerance = 1e-3;

// The information of each kind of residual, and the gradient.
struct NormalEquations {
  std::array<Eigen::MatrixXd, kResidualKinds> information;
  std::array<double, kResidualKinds> squares{};
  std::array<int, kResidualKinds> count{};
  Eigen::VectorXd gradient;
};

NormalEquations accumulate(const ceres::CRSMatrix& jacobian, const std::vector<double>& residuals,
                           const std::vector<ResidualKind>& kinds) {
  NormalEquations equations;
  for (auto& information : equations.information) {
    information.setZero(jacobian.num_cols, jacobian.num_cols);
  }
  equations.gradient.setZero(jacobian.num_cols);
  for (int row = 0; row < jacobian.num_rows; ++row) {
    auto& information = equations.information[kinds[row]];
    for (int i = jacobian.rows[row]; i < jacobian.rows[row + 1]; ++i) {
      const int column = jacobian.cols[i];
      const double value = jacobian.values[i];
      double* target = information.col(column).data();  // columns of a row ascend: lower triangle
      for (int j = i; j < jacobian.rows[row + 1]; ++j) {
        target[jacobian.cols[j]] += value * jacobian.values[j];
      }
      equations.gradient[column] += value * residuals[row];
    }
    equations.squares[kinds[row]] += residuals[row] * residuals[row];
    ++equations.count[kinds[row]];
  }
  for (auto& information : equations.information) {
    information.triangularView<Eigen::StrictlyUpper>() = information.transpose();
  }
  return equations;
}

// The standard deviation of each kind of residual in the cost: root mean square over the
// observations; not a number if there are none.
std::array<double, kResidualKinds> typical_std_devs(const Observations& observations,
                                                    const CostOptions& options) {
  std::array<double, kResidualKinds> squares{};
  for (const FeatureObservation& o : observations.features) {
    squares[kUv] += (o.std_dev.u * o.std_dev.u + o.std_dev.v * o.std_dev.v) / 2.0;
    squares[kRho] += o.std_dev.rho * o.std_dev.rho;
  }
  for (const CenterObservation& o : observations.centers) squares[kCenter] += o.std_dev * o.std_dev;
  const auto features = static_cast<double>(observations.features.size());
  const auto centers = static_cast<double>(observations.centers.size());
  return {options.uv_std_dev * std::sqrt(squares[kUv] / features),
          options.rho_std_dev * std::sqrt(squares[kRho] / features),
          options.centers_std_dev * std::sqrt(squares[kCenter] / centers)};
}

}  // namespace

Uncertainty uncertainty(const Camera& camera, const std::vector<Pose>& poses,
                        const Observations& observations, const CostOptions& cost_options) {
  CalibrationProblem calibration(camera, poses, observations, cost_options);
  ceres::Problem::EvaluateOptions options;
  options.parameter_blocks = calibration.free_blocks();
  std::vector<double> residuals;
  ceres::CRSMatrix jacobian;
  if (!calibration.problem().Evaluate(options, nullptr, &residuals, nullptr, &jacobian)) {
    throw std::invalid_argument(
        "the model is not defined at this camera and these poses: a board point lies within the "
        "focal length of the main lens");
  }
  const NormalEquations equations = accumulate(jacobian, residuals, calibration.row_kinds());

  Uncertainty result;
  result.free_intrinsics = calibration.free_intrinsics();
  result.size = jacobian.num_cols;
  Eigen::MatrixXd total = equations.information[kUv];
  for (int kind = kRho; kind < kResidualKinds; ++kind) total += equations.information[kind];
  const Eigen::VectorXd diagonal = total.diagonal();
  result.information.assign(diagonal.data(), diagonal.data() + diagonal.size());

  // Pseudo-inverse of the information scaled to a unit diagonal, so that units do not matter.
  const Eigen::VectorXd scale =
      diagonal.unaryExpr([](double v) { return v > 0.0 ? 1.0 / std::sqrt(v) : 1.0; });
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(scale.asDiagonal() * total *
                                                             scale.asDiagonal());
  const double threshold =
      kRankTolerance * kRankTolerance * eigen.eigenvalues().cwiseAbs().maxCoeff();
  const Eigen::VectorXd inverse =
      eigen.eigenvalues().unaryExpr([&](double v) { return v > threshold ? 1.0 / v : 0.0; });
  result.rank = static_cast<int>((inverse.array() > 0.0).count());
  const auto null_space = eigen.eigenvectors().leftCols(result.size - result.rank);
  for (int i = 0; i < result.size; ++i) {
    result.determined.push_back(null_space.row(i).norm() < kDeterminedTolerance);
  }
  const Eigen::MatrixXd basis = scale.asDiagonal() * eigen.eigenvectors();
  const Eigen::MatrixXd inverse_information = basis * inverse.asDiagonal() * basis.transpose();

  const std::array<double, kResidualKinds> std_devs = typical_std_devs(observations, cost_options);
  Eigen::MatrixXd spread = Eigen::MatrixXd::Zero(result.size, result.size);
  for (int kind = 0; kind < kResidualKinds; ++kind) {
    const double redundancy =
        equations.count[kind] - equations.information[kind].cwiseProduct(inverse_information).sum();
    // Without redundancy the noise cannot be measured; the stated noise is used.
    const double variance = redundancy > 0.5 ? equations.squares[kind] / redundancy : 1.0;
    spread += variance * equations.information[kind];
    result.residual_std_dev[kind] = equations.count[kind] > 0
                                        ? std::sqrt(variance) * std_devs[kind]
                                        : std::numeric_limits<double>::quiet_NaN();
  }
  // Eigenvalues come in ascending order.
  for (int i = 0; i < std::min(Uncertainty::kWeakest, result.size); ++i) {
    const Eigen::VectorXd direction = basis.col(i);
    const double std_dev = inverse[i] * std::sqrt(direction.dot(spread * direction));
    for (double part : direction) {
      result.weakest.push_back(part * (inverse[i] > 0.0 ? std_dev : 1.0));
    }
  }

  RowMajorMatrix covariance = inverse_information * spread * inverse_information;
  covariance = 0.5 * (covariance + covariance.transpose()).eval();  // symmetric to the last bit
  result.covariance.assign(covariance.data(), covariance.data() + covariance.size());
  result.expected_decrease = 0.5 * equations.gradient.dot(inverse_information * equations.gradient);
  return result;
}

}  // namespace plenocal
