// Residual blocks with fewer rows.
#pragma once

#include <ceres/cost_function.h>

#include <memory>

namespace plenocal {

/// A cost function of the same cost, gradient J'r and matrix J'J as `of`, which has to live as
/// long, with one row more than that has parameters. Ceres takes most of its time for rows, of
/// which a block of many observations has far more.
///
/// The rows are a factor of the Gram matrix of (J, r). Those of another place have no meaning here:
/// without derivatives the first row has the whole cost.
std::unique_ptr<ceres::CostFunction> compressed(const ceres::CostFunction& of);

}  // namespace plenocal
