#include "compressed.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "gram.hpp"
#include "parallel.hpp"

namespace plenocal {
namespace {

// Copies rows of `size` numbers into rows of `width`.
void pack(const double* from, int rows, int size, int width, double* to) {
  for (int row = 0; row < rows; ++row, from += size, to += width) {
    for (int i = 0; i < size; ++i) to[i] = from[i];
  }
}

class CompressedCost : public Compressed {
 public:
  explicit CompressedCost(const ceres::CostFunction& of) : of_(of) {
    *mutable_parameter_block_sizes() = of.parameter_block_sizes();
    for (int size : of.parameter_block_sizes()) parameters_ += size;
    set_num_residuals(parameters_ + 1);
  }

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    if (!is_prepared_) return evaluate(parameters, residuals, jacobians);
    if (!is_defined_) return false;
    std::copy(residuals_.begin(), residuals_.end(), residuals);
    if (jacobians == nullptr) return true;
    const double* from = jacobian_.data();
    for (std::size_t k = 0; k < parameter_block_sizes().size(); ++k) {
      const std::size_t size =
          static_cast<std::size_t>(num_residuals()) * parameter_block_sizes()[k];
      if (jacobians[k] != nullptr) std::copy_n(from, size, jacobians[k]);
      from += size;
    }
    return true;
  }

  void prepare(double const* const* parameters, const std::vector<bool>& constant,
               bool with_jacobian) override {
    const auto& sizes = parameter_block_sizes();
    residuals_.resize(num_residuals());
    jacobian_.resize(static_cast<std::size_t>(num_residuals()) * parameters_);
    std::vector<double*> parts;
    double* next = jacobian_.data();
    for (std::size_t k = 0; k < sizes.size(); ++k) {
      parts.push_back(constant[k] ? nullptr : next);
      next += static_cast<std::size_t>(num_residuals()) * sizes[k];
    }
    is_defined_ = evaluate(parameters, residuals_.data(), with_jacobian ? parts.data() : nullptr);
    is_prepared_ = true;
  }

 private:
  bool evaluate(double const* const* parameters, double* residuals, double** jacobians) const {
    const int n = of_.num_residuals(), rows = num_residuals();
    thread_local std::vector<double> values, packed;
    values.resize(static_cast<std::size_t>(n) * (parameters_ + 1));
    if (jacobians == nullptr) {
      if (!of_.Evaluate(parameters, values.data(), nullptr)) return false;
      std::fill(residuals, residuals + rows, 0.0);
      residuals[0] = Eigen::Map<const Eigen::VectorXd>(values.data(), n).norm();
      return true;
    }
    // Derivatives are requested only for blocks that are not constant.
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

  // Returns B with B'B = (J, r)'(J, r), from residuals and the parts of J; not finite if these are
  // not.
  Eigen::MatrixXd factor(const double* residuals, const std::vector<double*>& parts, int width,
                         std::vector<double>* packed) const {
    const int n = of_.num_residuals(), all = width + 1;
    const int padded = gram_width(all);
    const auto& sizes = of_.parameter_block_sizes();
    packed->resize(static_cast<std::size_t>(n) * padded);
    double* to = packed->data();
    for (std::size_t k = 0; k < sizes.size(); ++k) {
      if (parts[k] == nullptr) continue;
      pack(parts[k], n, sizes[k], padded, to);
      to += sizes[k];
    }
    pack(residuals, n, 1, padded, to);
    for (int column = all; column < padded; ++column) {
      for (int row = 0; row < n; ++row) (*packed)[row * padded + column] = 0.0;
    }
    using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
    RowMajor sums = RowMajor::Zero(padded, padded);
    gram_of(packed->data(), n, padded, sums.data());
    RowMajor gram = sums.topLeftCorner(all, all);
    // Cholesky decomposition, scaled to remove the units of the parameters, and with pivots, since
    // a few observations do not determine all parameters.
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
  // Result of `prepare`.
  bool is_prepared_ = false, is_defined_ = false;
  std::vector<double> residuals_, jacobian_;
};

}  // namespace

std::unique_ptr<Compressed> compressed(const ceres::CostFunction& of) {
  return std::make_unique<CompressedCost>(of);
}

void ParallelEvaluation::add(Compressed* cost, const std::vector<double*>& parameters,
                             const std::vector<bool>& constant) {
  blocks_.push_back({cost, parameters, constant});
}

void ParallelEvaluation::PrepareForEvaluation(bool with_jacobians, bool) {
  in_parallel(static_cast<int>(blocks_.size()), threads_, [&](int i) {
    const Block& block = blocks_[i];
    block.cost->prepare(block.parameters.data(), block.constant, with_jacobians);
  });
}

}  // namespace plenocal
