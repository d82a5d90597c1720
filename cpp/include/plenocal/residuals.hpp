// Ceres auto-diff cost functors of the paper's cost function (section 5.3), many observations to a
// residual block: the pose, the array's axes and the image of a board corner are then worked out
// once, and GCC is made to inline the Jet arithmetic (`flatten`), which together cost a third of
// one block per observation.
#pragma once

#include <ceres/ceres.h>

#include <memory>
#include <utility>
#include <vector>

#include "plenocal/projection.hpp"

#if defined(__GNUC__)
#define PLENOCAL_FLATTEN __attribute__((flatten))
#else
#define PLENOCAL_FLATTEN
#endif

namespace plenocal {

/// Robust loss rho(s) of a squared, standardised residual norm s = |r|^2.
enum class LossKind { kNone, kHuber, kCauchy };

/// A loss and its scale in standard deviations.
struct Loss {
  LossKind kind = LossKind::kNone;
  double scale = 1.0;
};

/// Scales n residuals of one observation by sqrt(rho(s)/s), so that half their squared norm is
/// rho(s)/2, Ceres' convention. Ceres' own LossFunction acts on a whole block, here several
/// observations.
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

/// One observed feature of a board corner, ready for the functor.
struct CornerSighting {
  std::array<double, 3> board_point;  ///< mm
  Node node;
  int lens_type;
  Feature<double> observed;
};

/// Residuals (u, v, rho) / sigma of features of one frame: 3 each, or 2 for a pinhole array
/// (I = 0). Parameter blocks: main lens, array, focal lengths (if I > 0), pose.
template <int I>
class FeatureResiduals {
 public:
  static constexpr int kResiduals = I == 0 ? 2 : 3;

  FeatureResiduals(std::vector<CornerSighting> sightings, double pixel_size, double uv_std_dev,
                   double rho_std_dev, Loss loss)
      : sightings_(std::move(sightings)),
        pixel_size_(pixel_size),
        uv_weight_(1.0 / uv_std_dev),
        rho_weight_(1.0 / rho_std_dev),
        loss_(loss) {}

  template <typename T>
  PLENOCAL_FLATTEN bool operator()(const T* lens, const T* array, const T* focal_lengths,
                                   const T* pose, T* residuals) const {
    const Optics<T> optics(MainLens<T>::from_block(lens), MicroLensArray<T>::from_block(array),
                           pixel_size_);
    const Motion<T> camera_from_board(pose);
    T inverse_focal_lengths[I == 0 ? 1 : I];
    for (int i = 0; i < I; ++i) inverse_focal_lengths[i] = 1.0 / focal_lengths[i];

    Point<T> image;
    const std::array<double, 3>* imaged = nullptr;
    for (const CornerSighting& s : sightings_) {
      // Sightings of a corner follow each other, so its image is worked out once.
      if (imaged == nullptr || *imaged != s.board_point) {
        if (!optics.main_lens_image(camera_from_board(s.board_point), &image)) return false;
        imaged = &s.board_point;
      }
      const Point<T> center = optics.micro_lens_center(s.node);
      Pixel<T> pixel;
      T scale;
      if (!optics.through_micro_lens(image, center, &pixel, &scale)) return false;
      residuals[0] = (pixel.u - s.observed.u) * uv_weight_;
      residuals[1] = (pixel.v - s.observed.v) * uv_weight_;
      if constexpr (I > 0) {
        residuals[2] = (optics.blur_radius(center, scale, inverse_focal_lengths[s.lens_type]) -
                        s.observed.rho) *
                       rho_weight_;
      }
      apply_loss(loss_, kResiduals, residuals);
      residuals += kResiduals;
    }
    return true;
  }

  /// The same for a pinhole array, which has no focal lengths.
  template <typename T>
  PLENOCAL_FLATTEN bool operator()(const T* lens, const T* array, const T* pose,
                                   T* residuals) const {
    static_assert(I == 0, "lens types need a block of focal lengths");
    return (*this)(lens, array, static_cast<const T*>(nullptr), pose, residuals);
  }

  /// A cost function over these sightings.
  static std::unique_ptr<ceres::CostFunction> create(std::vector<CornerSighting> sightings,
                                                     double pixel_size, double uv_std_dev,
                                                     double rho_std_dev, Loss loss) {
    const int n = kResiduals * static_cast<int>(sightings.size());
    auto* functor =
        new FeatureResiduals(std::move(sightings), pixel_size, uv_std_dev, rho_std_dev, loss);
    if constexpr (I == 0) {
      return std::make_unique<
          ceres::AutoDiffCostFunction<FeatureResiduals, ceres::DYNAMIC, MainLens<double>::kSize,
                                      MicroLensArray<double>::kSize, Pose::kSize>>(functor, n);
    } else {
      return std::make_unique<
          ceres::AutoDiffCostFunction<FeatureResiduals, ceres::DYNAMIC, MainLens<double>::kSize,
                                      MicroLensArray<double>::kSize, I, Pose::kSize>>(functor, n);
    }
  }

 private:
  std::vector<CornerSighting> sightings_;
  double pixel_size_;
  double uv_weight_;
  double rho_weight_;
  Loss loss_;
};

/// One observed micro-image centre, ready for the functor.
struct CenterSighting {
  Node node;
  Pixel<double> observed;
};

/// Residuals (u, v) / sigma of micro-image centres, 2 each. Parameter block: array.
class CenterResiduals {
 public:
  static constexpr int kResiduals = 2;

  CenterResiduals(std::vector<CenterSighting> sightings, double pixel_size, double std_dev,
                  Loss loss)
      : sightings_(std::move(sightings)),
        pixel_size_(pixel_size),
        weight_(1.0 / std_dev),
        loss_(loss) {}

  template <typename T>
  PLENOCAL_FLATTEN bool operator()(const T* array, T* residuals) const {
    const Optics<T> optics(MainLens<T>{}, MicroLensArray<T>::from_block(array), pixel_size_);
    for (const CenterSighting& s : sightings_) {
      const Pixel<T> pixel = optics.micro_image_center(optics.micro_lens_center(s.node));
      residuals[0] = (pixel.u - s.observed.u) * weight_;
      residuals[1] = (pixel.v - s.observed.v) * weight_;
      apply_loss(loss_, kResiduals, residuals);
      residuals += kResiduals;
    }
    return true;
  }

  /// A cost function over these sightings.
  static std::unique_ptr<ceres::CostFunction> create(std::vector<CenterSighting> sightings,
                                                     double pixel_size, double std_dev, Loss loss) {
    const int n = kResiduals * static_cast<int>(sightings.size());
    return std::make_unique<ceres::AutoDiffCostFunction<CenterResiduals, ceres::DYNAMIC,
                                                        MicroLensArray<double>::kSize>>(
        new CenterResiduals(std::move(sightings), pixel_size, std_dev, loss), n);
  }

 private:
  std::vector<CenterSighting> sightings_;
  double pixel_size_;
  double weight_;
  Loss loss_;
};

}  // namespace plenocal
