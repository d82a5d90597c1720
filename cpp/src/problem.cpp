#include "plenocal/problem.hpp"

#include <algorithm>
#include <cmath>

#include "checks.hpp"
#include "least_squares.hpp"

namespace plenocal {

CalibrationProblem::CalibrationProblem(const Camera& camera, const std::vector<Pose>& poses,
                                       const Observations& observations, const CostOptions& options)
    : parts_(std::make_unique<LeastSquares>(camera, poses, observations, options)) {}

CalibrationProblem::CalibrationProblem(CalibrationProblem& first, const Pose& camera_from_first,
                                       const Camera& camera, const Observations& observations,
                                       const CostOptions& options)
    : parts_(std::make_unique<LeastSquares>(*first.parts_, camera_from_first, camera, observations,
                                            options)) {}

CalibrationProblem::~CalibrationProblem() = default;

ceres::Problem& CalibrationProblem::problem() { return parts_->problem(); }

CalibrationProblem::Blocks CalibrationProblem::blocks() { return parts_->blocks(); }

std::shared_ptr<ceres::ParameterBlockOrdering> CalibrationProblem::ordering() {
  return parts_->ordering();
}

Camera CalibrationProblem::camera() const { return parts_->camera(); }

BoardShape<double> CalibrationProblem::board_shape() const { return parts_->board_shape(); }

std::vector<Pose> CalibrationProblem::poses() const { return parts_->poses(); }

Pose CalibrationProblem::camera_from_first() const { return parts_->camera_from_first(); }

std::unique_ptr<ceres::Problem> CalibrationProblem::compressed() const {
  return parts_->compressed();
}

Evaluation CalibrationProblem::evaluate() const { return parts_->evaluate(); }

std::vector<double> CalibrationProblem::state() const {
  const Eigen::VectorXd state = parts_->state();
  return {state.begin(), state.end()};
}

void CalibrationProblem::set_state(const std::vector<double>& state) {
  const auto size = static_cast<Eigen::Index>(state.size());
  if (size != parts_->state().size()) reject("the state belongs to another problem");
  if (!std::all_of(state.begin(), state.end(), [](double x) { return std::isfinite(x); })) {
    reject("the state is not finite");
  }
  parts_->set_state(Eigen::Map<const Eigen::VectorXd>(state.data(), size));
}

std::vector<double> CalibrationProblem::frame_costs() const { return parts_->frame_costs(); }

const std::vector<double*>& CalibrationProblem::free_blocks() const {
  return parts_->free_blocks();
}

std::vector<std::string> CalibrationProblem::names() const { return parts_->names(); }

}  // namespace plenocal
