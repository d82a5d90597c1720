#include "compressed.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

// The same in the widest registers that the processor has.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && \
    !defined(__SANITIZE_THREAD__) && !defined(__SANITIZE_ADDRESS__)
#define PLENOCAL_WIDE __attribute__((target_clones("arch=x86-64-v3", "default")))
#else
#define PLENOCAL_WIDE
#endif

namespace plenocal {
namespace {

// Rows that are added up at once, so that sums are loaded and stored less often.
constexpr int kAtOnce = 4;

// Adds A'A of `rows` rows, a multiple of kAtOnce, of `width` numbers to the lower triangle of a
// matrix of that width, row by row.
PLENOCAL_WIDE void add_gram(const double* a, int rows, int width, double* gram) {
  for (int row = 0; row < rows; row += kAtOnce, a += kAtOnce * width) {
    const double *a0 = a, *a1 = a + width, *a2 = a + 2 * width, *a3 = a + 3 * width;
    for (int i = 0; i < width; ++i) {
      double* sum = gram + i * width;
      const double x0 = a0[i], x1 = a1[i], x2 = a2[i], x3 = a3[i];
      for (int j = 0; j <= i; ++j) sum[j] += x0 * a0[j] + x1 * a1[j] + x2 * a2[j] + x3 * a3[j];
    }
  }
}

class Compressed : public ceres::CostFunction {
 public:
  explicit Compressed(const ceres::CostFunction& of) : of_(of) {
    *mutable_parameter_block_sizes() = of.parameter_block_sizes();
    for (int size : of.parameter_block_sizes()) parameters_ += size;
    set_num_residuals(parameters_ + 1);
  }

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    const int n = of_.num_residuals(), rows = num_residuals();
    thread_local std::vector<double> values, packed;
    values.resize(static_cast<std::size_t>(n) * (parameters_ + 1));
    if (jacobians == nullptr) {
      if (!of_.Evaluate(parameters, values.data(), nullptr)) return false;
      std::fill(residuals, residuals + rows, 0.0);
      residuals[0] = Eigen::Map<const Eigen::VectorXd>(values.data(), n).norm();
      return true;
    }
    // Only of blocks that are not constant.
    const auto& sizes = of_.parameter_block_sizes();
    std::vector<double*> parts(sizes.size(), nullptr);
    double* next = values.data() + n;
    int width = 0;
    for (std::size_t k = 0; k < sizes.size(); ++k) {
      if (jacobians[k] == nullptr) continue;
      parts[k] = next;
      next += static_cast<std::size_t>(n) * sizes[k];
      width += sizes[k];
    }
    if (!of_.Evaluate(parameters, values.data(), parts.data())) return false;
    const Eigen::MatrixXd factor = this->factor(values.data(), parts, width, &packed);
    if (!factor.allFinite()) return false;
    std::fill(residuals, residuals + rows, 0.0);
    Eigen::Map<Eigen::VectorXd>(residuals, width + 1) = factor.col(width);
    int column = 0;
    for (std::size_t k = 0; k < sizes.size(); ++k) {
      if (jacobians[k] == nullptr) continue;
      using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
      Eigen::Map<RowMajor> part(jacobians[k], rows, sizes[k]);
      part.setZero();
      part.topRows(width + 1) = factor.middleCols(column, sizes[k]);
      column += sizes[k];
    }
    return true;
  }

 private:
  // B with B'B = (J, r)'(J, r), from residuals and the parts of J; not finite if these are not.
  Eigen::MatrixXd factor(const double* residuals, const std::vector<double*>& parts, int width,
                         std::vector<double>* packed) const {
    const int n = of_.num_residuals(), all = width + 1;
    const int padded = (n + kAtOnce - 1) / kAtOnce * kAtOnce;
    const auto& sizes = of_.parameter_block_sizes();
    packed->assign(static_cast<std::size_t>(padded) * all, 0.0);
    double* to = packed->data();
    for (int row = 0; row < n; ++row) {
      for (std::size_t k = 0; k < sizes.size(); ++k) {
        if (parts[k] == nullptr) continue;
        const double* from = parts[k] + static_cast<std::ptrdiff_t>(row) * sizes[k];
        to = std::copy(from, from + sizes[k], to);
      }
      *to++ = residuals[row];
    }
    using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
    RowMajor gram = RowMajor::Zero(all, all);
    add_gram(packed->data(), padded, all, gram.data());
    // Cholesky, without the units of the parameters; with pivots, since a few observations do not
    // determine all parameters.
    const Eigen::VectorXd scale =
        gram.diagonal().unaryExpr([](double x) { return x > 0.0 ? std::sqrt(x) : 1.0; });
    gram.triangularView<Eigen::StrictlyUpper>() = gram.transpose();
    if (!gram.allFinite()) return gram;
    gram = scale.cwiseInverse().asDiagonal() * gram * scale.cwiseInverse().asDiagonal();
    Eigen::MatrixXd factor = Eigen::MatrixXd::Zero(all, all);
    for (int i = 0; i < all; ++i) {
      Eigen::Index at = 0;
      const double pivot = gram.diagonal().maxCoeff(&at);
      if (pivot <= all * std::numeric_limits<double>::epsilon()) break;
      factor.row(i) = gram.row(at) / std::sqrt(pivot);
      gram.noalias() -= factor.row(i).transpose() * factor.row(i);
    }
    return factor * scale.asDiagonal();
  }

  const ceres::CostFunction& of_;
  int parameters_ = 0;
};

}  // namespace

std::unique_ptr<ceres::CostFunction> compressed(const ceres::CostFunction& of) {
  return std::make_unique<Compressed>(of);
}

}  // namespace plenocal
