// Robust losses.
#pragma once

#include <cmath>

namespace plenocal {

/// Robust loss rho(s) of a squared, standardised residual norm s = |r|^2.
enum class LossKind { kNone, kHuber, kCauchy };

/// Loss and its scale in standard deviations.
struct Loss {
  LossKind kind = LossKind::kNone;
  double scale = 1.0;
};

/// Scales n residuals of one observation by sqrt(rho(s)/s), so that half their squared norm is
/// rho(s)/2, as by Ceres' convention. Ceres' own LossFunction acts on a whole block, which has
/// several observations here.
template <typename T>
void apply_loss(const Loss& loss, int n, T* r) {
  if (loss.kind == LossKind::kNone) return;
  using std::log;
  using std::sqrt;
  T x = r[0] * r[0];
  for (int i = 1; i < n; ++i) x += r[i] * r[i];
  x = x * (1.0 / (loss.scale * loss.scale));
  T factor(1.0);
  if (loss.kind == LossKind::kHuber) {
    if (x > 1.0) factor = sqrt((2.0 * sqrt(x) - 1.0) / x);
  } else if (x > 1e-6) {
    factor = sqrt(log(1.0 + x) / x);
  } else {
    factor = 1.0 - 0.25 * x;  // series of the line above, exact to 1e-12 here
  }
  for (int i = 0; i < n; ++i) r[i] *= factor;
}

/// Returns the weight rho'(s) of an observation in a step of iteratively re-weighted least squares,
/// for s = |r|^2.
inline double loss_weight(const Loss& loss, double s) {
  const double x = s / (loss.scale * loss.scale);
  if (loss.kind == LossKind::kHuber) return x > 1.0 ? 1.0 / std::sqrt(x) : 1.0;
  return loss.kind == LossKind::kCauchy ? 1.0 / (1.0 + x) : 1.0;
}

}  // namespace plenocal
