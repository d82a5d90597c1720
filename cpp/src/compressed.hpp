// Residual blocks with fewer rows.
#pragma once

#include <ceres/cost_function.h>
#include <ceres/evaluation_callback.h>

#include <memory>
#include <vector>

namespace plenocal {

/// Cost function with the cost, the gradient J'r and the matrix J'J of another one, but only one
/// row more than it has parameters. Ceres spends most of its time on rows, and a block of many
/// observations has far more.
///
/// The rows are a factor of the Gram matrix of (J, r) and have no meaning at another point. Without
/// derivatives the first row contains the whole cost.
class Compressed : public ceres::CostFunction {
 public:
  /// Evaluates the function in advance, at these values of its parameter blocks, some of which are
  /// constant. `Evaluate` returns this result until the next call.
  virtual void prepare(double const* const* parameters, const std::vector<bool>& constant,
                       bool with_jacobian) = 0;
};

/// Compresses a cost function, which has to outlive the result.
std::unique_ptr<Compressed> compressed(const ceres::CostFunction& of);

/// Evaluates all blocks on several threads before Ceres requests them on a single one. The result
/// does not depend on the number of threads. With its own threads, Ceres would add sums in the
/// order in which the threads finish.
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
