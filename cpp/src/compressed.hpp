// Residual blocks with fewer rows.
#pragma once

#include <ceres/cost_function.h>
#include <ceres/evaluation_callback.h>

#include <memory>
#include <vector>

namespace plenocal {

/// A cost function of the same cost, gradient J'r and matrix J'J as another one, with one row more
/// than that has parameters. Ceres takes most of its time for rows, of which a block of many
/// observations has far more.
///
/// The rows are a factor of the Gram matrix of (J, r). Those of another place have no meaning here:
/// without derivatives the first row has the whole cost.
class Compressed : public ceres::CostFunction {
 public:
  /// Evaluates at these values of the blocks, some of which are constant, what `Evaluate` gives
  /// until the next call.
  virtual void prepare(double const* const* parameters, const std::vector<bool>& constant,
                       bool with_jacobian) = 0;
};

/// The same of a cost function that has to live as long.
std::unique_ptr<Compressed> compressed(const ceres::CostFunction& of);

/// Evaluates blocks on several threads before Ceres asks for them on one. Threads of Ceres add up
/// sums in the order in which they end; so the result does not depend on the number of threads.
class AllAtOnce : public ceres::EvaluationCallback {
 public:
  explicit AllAtOnce(int threads) : threads_(threads) {}
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
