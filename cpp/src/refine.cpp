#include "plenocal/refine.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <chrono>
#include <limits>
#include <memory>
#include <stdexcept>

#include "least_squares.hpp"

// Levenberg-Marquardt by Ceres, with extrapolation.
//
// With residuals that do not vanish, Gauss-Newton converges only linearly: every step multiplies
// the error by -(J'J)^-1 S, where S is the part of the Hessian that Gauss-Newton omits. In the
// valleys of this problem the factor is 0.5 and more in the weakest directions, for any trust
// region. The limit of such a sequence can be extrapolated from a few of its members. A slow solve
// is therefore interrupted, moved to the extrapolated limit if the cost is lower there, and
// continued. Ceres makes the steps and decides which to accept and when to stop.

namespace plenocal {
namespace {

// Number of steps for the extrapolation.
constexpr std::size_t kSteps = 4;
// A solve is slow if the change of the cost is still this fraction of the previous change.
constexpr double kSlow = 0.05;

// Follows the solve: reports progress, records the accepted states, detects slow convergence.
class Watch : public ceres::IterationCallback {
 public:
  Watch(const LeastSquares& calibration, const Progress& progress, bool interrupt,
        std::vector<Iteration>* iterations)
      : calibration_(calibration),
        progress_(progress),
        interrupt_(interrupt),
        iterations_(iterations) {}

  ceres::CallbackReturnType operator()(const ceres::IterationSummary& s) override {
    if (s.iteration == 0) {  // a new solve from the present state
      first_ = iterations_->empty() ? Iteration{} : iterations_->back();
      states_.clear();
      changes_.clear();
    }
    const bool accepted = s.iteration == 0 || s.step_is_successful;
    double step_norm = 0.0;
    if (accepted) {
      states_.push_back(calibration_.state());
      cost_ = s.cost;
      if (s.iteration > 0) {
        changes_.push_back(s.cost_change);
        // Ceres 2.2 reports 0 up to and including the first accepted step of a solve.
        step_norm = (states_.back() - states_[states_.size() - 2]).norm();
      }
    }
    radius_ = s.trust_region_radius;
    if (s.iteration > 0 || iterations_->empty()) {
      iterations_->push_back({first_.number + s.iteration, cost_, s.gradient_max_norm, step_norm,
                              radius_, first_.time_s + s.cumulative_time_in_seconds});
      if (progress_ && !progress_(iterations_->back())) return ceres::SOLVER_ABORT;
    }
    return interrupt_ && is_slow() ? ceres::SOLVER_TERMINATE_SUCCESSFULLY : ceres::SOLVER_CONTINUE;
  }

  bool is_slow() const {
    const std::size_t n = changes_.size();
    return n >= kSteps && changes_[n - 1] > kSlow * changes_[n - 2];
  }
  const std::vector<Eigen::VectorXd>& states() const { return states_; }
  double cost() const { return cost_; }
  double radius() const { return radius_; }

 private:
  const LeastSquares& calibration_;
  const Progress& progress_;
  bool interrupt_;
  std::vector<Iteration>* iterations_;
  Iteration first_{};
  std::vector<Eigen::VectorXd> states_;
  std::vector<double> changes_;
  double cost_ = 0.0;
  double radius_ = 0.0;
};

// Returns the limit of a linearly converging sequence by reduced rank extrapolation: the affine
// combination of its members with the shortest step. Every parameter is scaled by its own largest
// step.
Eigen::VectorXd limit(const std::vector<Eigen::VectorXd>& states) {
  const std::size_t count = std::min(kSteps, states.size() - 1);
  Eigen::MatrixXd steps(states.back().size(), count);
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t to = states.size() - count + i;
    steps.col(i) = states[to] - states[to - 1];
  }
  const Eigen::VectorXd scale = steps.cwiseAbs().rowwise().maxCoeff().unaryExpr(
      [](double largest) { return largest > 0.0 ? 1.0 / largest : 0.0; });
  const Eigen::MatrixXd scaled = scale.asDiagonal() * steps;
  Eigen::VectorXd weights = (scaled.transpose() * scaled)
                                .completeOrthogonalDecomposition()
                                .solve(Eigen::VectorXd::Ones(count));
  weights /= weights.sum();
  // The result is expressed by steps back from the last member, so that rounding does not move
  // fixed parameters.
  Eigen::VectorXd result = states.back();
  double before = 0.0;
  for (std::size_t i = 0; i + 1 < count; ++i) {
    before += weights[i];
    result -= before * steps.col(i + 1);
  }
  return result;
}

// Moves to the limit of the accepted states if the cost is lower there. Returns the decrease.
double extrapolate(LeastSquares* calibration, const Watch& watch, double cost) {
  if (watch.states().size() < 3) return 0.0;
  const Eigen::VectorXd there = limit(watch.states());
  double lower = std::numeric_limits<double>::infinity();
  if (there.allFinite()) {
    calibration->set_state(there);
    // The evaluation fails outside the model's domain.
    if (!calibration->problem().Evaluate({}, &lower, nullptr, nullptr, nullptr)) {
      lower = std::numeric_limits<double>::infinity();
    }
  }
  if (lower < cost) return cost - lower;
  calibration->set_state(watch.states().back());
  return 0.0;
}

Termination termination(ceres::TerminationType type) {
  switch (type) {
    case ceres::CONVERGENCE:
      return Termination::kConverged;
    case ceres::NO_CONVERGENCE:
      return Termination::kIterationLimit;
    case ceres::USER_FAILURE:
      return Termination::kStopped;
    default:
      return Termination::kFailed;
  }
}

}  // namespace

Refinement refine(const Camera& camera, const std::vector<Pose>& poses,
                  const Observations& observations, const CostOptions& cost_options,
                  const SolverOptions& solver_options, const Progress& progress) {
  const auto start = std::chrono::steady_clock::now();
  if (solver_options.threads < 1)
    throw std::invalid_argument("threads is " + std::to_string(solver_options.threads) +
                                ", but has to be at least 1");
  LeastSquares calibration(camera, poses, observations, cost_options);
  ParallelEvaluation parallel(solver_options.threads);
  const std::unique_ptr<ceres::Problem> problem =
      calibration.compressed(solver_options.threads > 1 ? &parallel : nullptr);
  Refinement result;

  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.function_tolerance = solver_options.function_tolerance;
  options.gradient_tolerance = solver_options.gradient_tolerance;
  options.parameter_tolerance = solver_options.parameter_tolerance;
  options.initial_trust_region_radius = solver_options.initial_trust_region_radius;
  options.max_num_iterations = solver_options.max_iterations;
  options.num_threads = 1;  // The other threads belong to `parallel`.
  options.logging_type = ceres::SILENT;
  options.update_state_every_iteration = true;
  Watch watch(calibration, progress, solver_options.extrapolate, &result.iterations);
  options.callbacks.push_back(&watch);
  std::string error;
  if (!options.IsValid(&error)) throw std::invalid_argument(error);

  ceres::Solver::Summary summary;
  bool go_on = true;
  while (go_on) {
    options.linear_solver_ordering = calibration.ordering();
    ceres::Solve(options, problem.get(), &summary);
    result.report += summary.FullReport();
    if (watch.states().empty()) {
      throw std::invalid_argument(
          "the model is not defined at the start: a board point lies within the focal length of "
          "the main lens, or is imaged onto a micro-lens");
    }
    // This also covers a stop by the caller, after which Ceres returns the start.
    calibration.set_state(watch.states().back());
    result.cost = watch.cost();
    go_on = summary.termination_type == ceres::USER_SUCCESS;
    const bool converged = summary.termination_type == ceres::CONVERGENCE;
    if (solver_options.extrapolate && (go_on || converged)) {
      // Steps that have become too small for Ceres may still add up.
      const double gain = extrapolate(&calibration, watch, result.cost);
      go_on = go_on || gain > solver_options.function_tolerance * result.cost;
      result.cost -= gain;
    }
    options.max_num_iterations = solver_options.max_iterations - result.iterations.back().number;
    options.initial_trust_region_radius = watch.radius();
    if (go_on && options.max_num_iterations <= 0) {
      summary.termination_type = ceres::NO_CONVERGENCE;
      go_on = false;
    }
  }

  result.initial_cost = result.iterations.front().cost;
  result.camera = calibration.camera();
  result.board_shape = calibration.board_shape();
  result.poses = calibration.poses();
  result.frame_costs = calibration.frame_costs();
  result.termination = termination(summary.termination_type);
  result.message = summary.message;
  result.time_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return result;
}

}  // namespace plenocal
