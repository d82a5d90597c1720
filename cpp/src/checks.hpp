// Checks of callers' input: std::invalid_argument with the reason, or no value.
#pragma once

#include <cmath>
#include <stdexcept>
#include <string>
#include <vector>

#include "plenocal/refine.hpp"

namespace plenocal {

[[noreturn]] inline void reject(const std::string& what) { throw std::invalid_argument(what); }

inline bool is_positive(double value) { return std::isfinite(value) && value > 0.0; }

inline void require_std_dev(double value, const std::string& name) {
  if (!is_positive(value)) {
    reject("the standard deviation of " + name + " has to be positive and finite");
  }
}

/// Returns true if a parameter of the board shape is free.
bool is_shape_free(const CostOptions& options);

/// Requires a size of the board, without which a shape has no meaning.
void require_size(const Board& board);

/// Checks all parts of a problem. Ceres checks its input with CHECK, which aborts the process, so
/// everything is checked before it is passed on.
void validate_problem(const Camera& camera, const std::vector<Pose>& poses,
                      const Observations& observations, const CostOptions& options);

/// Returns p' like `main_lens_image`; no value for a point that distortion folds back into the
/// image, where another point has its image.
std::optional<Vector3<double>> unfolded_image(const MainLens<double>& lens,
                                              const Vector3<double>& point);

/// Checks a further camera of a rig, whose first camera has `poses` poses.
void validate_camera_of_rig(const Camera& camera, const Pose& camera_from_first, std::size_t poses,
                            const Observations& observations, const CostOptions& options);

}  // namespace plenocal
