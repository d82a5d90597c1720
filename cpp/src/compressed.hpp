// Residual blocks with fewer rows.
#pragma once

#include <ceres/cost_function.h>
#include <ceres/evaluation_callback.h>

#include <memory>
#include <vector>

namespace plenocal {

/// A cost function with the cost, the gradient J'r and the matrix J'J of another one, but only one
/// row more than it has parameters. Ceres spends most of its time on rows, of which a block of many
/// observations has far more.
///
/// The rows are a factor of the Gram matrix of (J, r) and have no meaning at another point. Without
/// derivatives the first row holds the whole cost.
class Compressed : public ceres::CostFunction {
 public:
  /// Evaluates the function in advance, at these values of its parameter blocks, of which some are
  /// constant. `Evaluate` returns this result until the next call.
  virtual void prepare(double const* const* parameters, const std::vector<bool>& constant,
                       bool with_jacobian) = 0;
};

/// Compresses a cost function, which has to outlive the result.
std::unique_ptr<Compressed> compressed(const ceres::CostFunction& of);

/// Evaluates all blocks on several threads before Ceres, on a single one, asks for them. The result
/// does not depend on the number of threads, as it would with the threads of Ceres, which add up
/// their sums in the order in which they finish.
class ParallelEvaluation : public ceres::EvaluationCallback {
 public:
  explicit ParallelEvaluation(int threads) : threads_(threads) {}
  void add(Compressed* cost, const std::vector<double*>& parameters,
           const std::vector<bool>& constant);
  void PrepareForEvaluation(bool with_jacobians, bool is_new_point) override;

 private:
  struct Block {
    Compressed* cost;
    std::vector<double*> parameters;
    std::vector<bool> constant;
  };
  int threads_;
  std::vector<Block> blocks_;
};

}  // namespace plenocal
