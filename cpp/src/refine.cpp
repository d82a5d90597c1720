#include "plenocal/refine.hpp"

#include <chrono>

#include "problem.hpp"

namespace plenocal {
namespace {

class ProgressCallback : public ceres::IterationCallback {
 public:
  ProgressCallback(const Progress& progress, std::vector<Iteration>* iterations)
      : progress_(progress), iterations_(iterations) {}

  ceres::CallbackReturnType operator()(const ceres::IterationSummary& s) override {
    iterations_->push_back({s.iteration, s.cost, s.gradient_max_norm, s.step_norm,
                            s.trust_region_radius, s.cumulative_time_in_seconds});
    const bool go_on = !progress_ || progress_(iterations_->back());
    return go_on ? ceres::SOLVER_CONTINUE : ceres::SOLVER_ABORT;
  }

 private:
  const Progress& progress_;
  std::vector<Iteration>* iterations_;
};

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
  CalibrationProblem calibration(camera, poses, observations, cost_options);
  Refinement result;

  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.linear_solver_ordering = calibration.ordering();
  options.max_num_iterations = solver_options.max_iterations;
  options.function_tolerance = solver_options.function_tolerance;
  options.gradient_tolerance = solver_options.gradient_tolerance;
  options.parameter_tolerance = solver_options.parameter_tolerance;
  options.initial_trust_region_radius = solver_options.initial_trust_region_radius;
  options.num_threads = solver_options.threads;
  options.logging_type = ceres::SILENT;
  ProgressCallback callback(progress, &result.iterations);
  options.callbacks.push_back(&callback);
  std::string error;
  if (!options.IsValid(&error)) throw std::invalid_argument(error);

  ceres::Solver::Summary summary;
  ceres::Solve(options, &calibration.problem(), &summary);

  result.camera = calibration.camera();
  result.poses = calibration.poses();
  result.initial_cost = summary.initial_cost;
  result.cost = summary.final_cost;
  result.termination = termination(summary.termination_type);
  result.message = summary.message;
  result.report = summary.FullReport();
  result.time_s =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return result;
}

}  // namespace plenocal
