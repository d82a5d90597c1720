// Ceres auto-diff cost functors of the paper's cost function (section 5.3), many observations to a
// residual block: the pose, the array's axes and the image of a board corner are then computed
// once. With GCC forced to inline the Jet arithmetic (`flatten`), this takes a third of the time of
// one block per observation.
#pragma once

#include <ceres/ceres.h>

#include <memory>
#include <stdexcept>
#include <tuple>
#include <utility>
#include <vector>

#include "plenocal/board.hpp"
#include "plenocal/loss.hpp"
#include "plenocal/projection.hpp"

// Sanitizers and `flatten` together take the compiler many minutes; the presets define this.
#if defined(__GNUC__) && !defined(PLENOCAL_NO_FLATTEN)
#define PLENOCAL_FLATTEN __attribute__((flatten))
#else
#define PLENOCAL_FLATTEN
#endif

namespace plenocal {

/// An observed feature, ready for the functor.
struct WeightedFeature {
  Vector3<double> board_point;  ///< mm; if the shape of the board is a parameter, of the flat grid
  MicroLens micro_lens;
  Feature<double> observed;  ///< px
  Feature<double> weight;    ///< 1 / sigma of each, 1/px
};

/// Residuals (u, v, rho) / sigma of features of one frame: 3 each, or 2 for a pinhole array
/// (I = 0). Parameter blocks: main lens, array, focal lengths (if I > 0), shape of the board (if
/// Bent), camera_from_rig (if InRig), pose of the board: camera_from_board, or rig_from_board in a
/// rig of several cameras. The derivatives by the shape take a quarter more time, and are left out
/// where it is known.
template <int I, bool Bent = false, bool InRig = false>
class FeatureResiduals {
 public:
  static constexpr int kResiduals = I == 0 ? 2 : 3;

  /// Of the board, only its size is used. Throws std::invalid_argument for a lens type that there
  /// is not.
  FeatureResiduals(std::vector<WeightedFeature> features, double pixel_size, Loss loss,
                   const Board& board = {})
      : features_(std::move(features)), pixel_size_(pixel_size), loss_(loss), board_(board) {
    for (const WeightedFeature& f : features_) {
      if (I > 0 && (f.micro_lens.lens_type < 0 || f.micro_lens.lens_type >= I)) {
        throw std::invalid_argument("a feature has a lens type that the camera does not have");
      }
    }
  }

  /// The parameter blocks in their order, then the residuals.
  template <typename T, typename... Rest>
  bool operator()(const T* lens, const T* array, Rest... rest) const {
    constexpr std::size_t kShapeAt = I > 0 ? 1 : 0, kRigAt = kShapeAt + (Bent ? 1 : 0);
    constexpr std::size_t kPoseAt = kRigAt + (InRig ? 1 : 0);
    static_assert(sizeof...(Rest) == kPoseAt + 2, "the blocks do not fit I, Bent and InRig");
    const std::tuple<Rest...> blocks(rest...);
    const T *focal_lengths = nullptr, *shape = nullptr;
    if constexpr (I > 0) focal_lengths = std::get<0>(blocks);
    if constexpr (Bent) shape = std::get<kShapeAt>(blocks);
    Motion<T> camera_from_board(std::get<kPoseAt>(blocks));
    if constexpr (InRig) {
      camera_from_board = Motion<T>(std::get<kRigAt>(blocks)).after(camera_from_board);
    }
    return evaluate(lens, array, focal_lengths, shape, camera_from_board,
                    std::get<kPoseAt + 1>(blocks));
  }

  /// A cost function over these features.
  static std::unique_ptr<ceres::CostFunction> create(std::vector<WeightedFeature> features,
                                                     double pixel_size, Loss loss,
                                                     const Board& board = {}) {
    const int n = kResiduals * static_cast<int>(features.size());
    auto functor = std::make_unique<FeatureResiduals>(std::move(features), pixel_size, loss, board);
    constexpr int kLens = kMainLensParameters, kArray = kArrayParameters;
    constexpr int kShape = kBoardShapeParameters;
    if constexpr (I > 0 && Bent) {
      return function<kLens, kArray, I, kShape>(std::move(functor), n);
    } else if constexpr (I > 0) {
      return function<kLens, kArray, I>(std::move(functor), n);
    } else if constexpr (Bent) {
      return function<kLens, kArray, kShape>(std::move(functor), n);
    } else {
      return function<kLens, kArray>(std::move(functor), n);
    }
  }

 private:
  // Of blocks of these sizes, and the poses.
  template <int... Sizes>
  static std::unique_ptr<ceres::CostFunction> function(std::unique_ptr<FeatureResiduals> functor,
                                                       int n) {
    using ceres::AutoDiffCostFunction;
    using ceres::DYNAMIC;
    if constexpr (InRig) {
      return std::make_unique<
          AutoDiffCostFunction<FeatureResiduals, DYNAMIC, Sizes..., Pose::kSize, Pose::kSize>>(
          functor.release(), n);
    } else {
      return std::make_unique<
          AutoDiffCostFunction<FeatureResiduals, DYNAMIC, Sizes..., Pose::kSize>>(functor.release(),
                                                                                  n);
    }
  }

  template <typename T>
  PLENOCAL_FLATTEN bool evaluate(const T* lens, const T* array, const T* focal_lengths,
                                 const T* shape, const Motion<T>& camera_from_board,
                                 T* residuals) const {
    const Optics<T> optics(from_block<MainLens>(lens), from_block<MicroLensArray>(array),
                           focal_lengths, I, pixel_size_);
    Vector3<T> image;
    const Vector3<double>* imaged = nullptr;
    for (const WeightedFeature& f : features_) {
      // Features of a corner are consecutive, so its image is computed once.
      if (imaged == nullptr || !same(*imaged, f.board_point)) {
        Vector3<T> point;
        if constexpr (Bent) {
          point =
              camera_from_board(corner_of(board_, from_block<BoardShape>(shape), f.board_point));
        } else {
          point = camera_from_board(f.board_point);
        }
        if (!main_lens_image(optics.main_lens, point, &image)) return false;
        imaged = &f.board_point;
      }
      Feature<T> projected;
      if (!project_image(optics, image, f.micro_lens, &projected)) return false;
      residuals[0] = (projected.u - f.observed.u) * f.weight.u;
      residuals[1] = (projected.v - f.observed.v) * f.weight.v;
      if constexpr (I > 0) residuals[2] = (projected.rho - f.observed.rho) * f.weight.rho;
      apply_loss(loss_, kResiduals, residuals);
      residuals += kResiduals;
    }
    return true;
  }

  static bool same(const Vector3<double>& a, const Vector3<double>& b) {
    return a.x == b.x && a.y == b.y && a.z == b.z;
  }

  std::vector<WeightedFeature> features_;
  double pixel_size_;
  Loss loss_;
  Board board_;
};

/// An observed micro-image centre, ready for the functor.
struct WeightedCenter {
  Node node;
  Pixel<double> observed;  ///< px
  double weight;           ///< 1 / sigma, 1/px
};

/// Residuals (u, v) / sigma of micro-image centres, 2 each. Parameter blocks: exit pupil, array.
class CenterResiduals {
 public:
  static constexpr int kResiduals = 2;

  CenterResiduals(std::vector<WeightedCenter> centers, double pixel_size, Loss loss)
      : centers_(std::move(centers)), pixel_size_(pixel_size), loss_(loss) {}

  template <typename T>
  PLENOCAL_FLATTEN bool operator()(const T* exit_pupil, const T* array, T* residuals) const {
    const auto pupil = from_block<ExitPupil>(exit_pupil);
    const auto mla = from_block<MicroLensArray>(array);
    if (!(pupil.z + mla.lens_to_mla > 0.0)) return false;
    const ArrayOptics<T> optics(mla, pixel_size_);
    for (const WeightedCenter& c : centers_) {
      const Pixel<T> pixel = optics.micro_image_center(pupil, c.node);
      residuals[0] = (pixel.u - c.observed.u) * c.weight;
      residuals[1] = (pixel.v - c.observed.v) * c.weight;
      apply_loss(loss_, kResiduals, residuals);
      residuals += kResiduals;
    }
    return true;
  }

  /// A cost function over these centres.
  static std::unique_ptr<ceres::CostFunction> create(std::vector<WeightedCenter> centers,
                                                     double pixel_size, Loss loss) {
    const int n = kResiduals * static_cast<int>(centers.size());
    return std::make_unique<ceres::AutoDiffCostFunction<CenterResiduals, ceres::DYNAMIC,
                                                        kExitPupilParameters, kArrayParameters>>(
        new CenterResiduals(std::move(centers), pixel_size, loss), n);
  }

 private:
  std::vector<WeightedCenter> centers_;
  double pixel_size_;
  Loss loss_;
};

/// Residual of an anchor on |m|. Parameter blocks: main lens, exit pupil, array.
class SlopeResidual {
 public:
  /// `value` in mm; `weight` is 1 / sigma, 1/mm.
  SlopeResidual(double value, double weight) : value_(value), weight_(weight) {}

  template <typename T>
  bool operator()(const T* lens, const T* exit_pupil, const T* array, T* residual) const {
    const T slope = micro_image_slope(from_block<MainLens>(lens), from_block<ExitPupil>(exit_pupil),
                                      from_block<MicroLensArray>(array));
    residual[0] = (slope - value_) * weight_;
    return true;
  }

  /// A cost function of it.
  static std::unique_ptr<ceres::CostFunction> create(double value, double weight) {
    return std::make_unique<ceres::AutoDiffCostFunction<SlopeResidual, 1, kMainLensParameters,
                                                        kExitPupilParameters, kArrayParameters>>(
        new SlopeResidual(value, weight));
  }

 private:
  double value_;
  double weight_;
};

/// Residual of an anchor on q'_i of one of I lens types. Parameter blocks: array, focal lengths.
template <int I>
class InterceptResidual {
 public:
  /// `value` in mm; `weight` is 1 / sigma, 1/mm.
  InterceptResidual(int lens_type, double value, double weight)
      : lens_type_(lens_type), value_(value), weight_(weight) {}

  template <typename T>
  bool operator()(const T* array, const T* focal_lengths, T* residual) const {
    const T q = blur_intercept(from_block<MicroLensArray>(array), focal_lengths[lens_type_]);
    residual[0] = (q - value_) * weight_;
    return true;
  }

  /// A cost function of it.
  static std::unique_ptr<ceres::CostFunction> create(int lens_type, double value, double weight) {
    return std::make_unique<ceres::AutoDiffCostFunction<InterceptResidual, 1, kArrayParameters, I>>(
        new InterceptResidual(lens_type, value, weight));
  }

 private:
  int lens_type_;
  double value_;
  double weight_;
};

/// Residual of an anchor on the lean along one axis of the image. Parameter blocks: exit pupil,
/// array.
class LeanResidual {
 public:
  /// `axis` is 0 for u and 1 for v; `value` in 1/mm; `weight` is 1 / sigma, mm.
  LeanResidual(int axis, double value, double weight)
      : axis_(axis), value_(value), weight_(weight) {}

  template <typename T>
  bool operator()(const T* exit_pupil, const T* array, T* residual) const {
    const Vector2<T> found =
        lean(from_block<ExitPupil>(exit_pupil), from_block<MicroLensArray>(array));
    residual[0] = ((axis_ == 0 ? found.x : found.y) - value_) * weight_;
    return true;
  }

  /// A cost function of it.
  static std::unique_ptr<ceres::CostFunction> create(int axis, double value, double weight) {
    return std::make_unique<
        ceres::AutoDiffCostFunction<LeanResidual, 1, kExitPupilParameters, kArrayParameters>>(
        new LeanResidual(axis, value, weight));
  }

 private:
  int axis_;
  double value_;
  double weight_;
};

}  // namespace plenocal
