// Ceres auto-diff cost functors of the paper's cost function (section 5.3). A residual block
// contains many observations, so that the pose, the array's axes and the image of a board corner
// are computed once. GCC is forced to inline the Jet arithmetic (`flatten`).
#pragma once

#include <ceres/ceres.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <stdexcept>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "plenocal/board.hpp"
#include "plenocal/loss.hpp"
#include "plenocal/projection.hpp"

// With sanitizers, `flatten` takes the compiler many minutes; the presets define this macro.
#if defined(__GNUC__) && !defined(PLENOCAL_NO_FLATTEN)
#define PLENOCAL_FLATTEN __attribute__((flatten))
#else
#define PLENOCAL_FLATTEN
#endif

namespace plenocal {

/// Returns true if a value is possible as a weight or a length.
inline bool is_scale(double value) { return value > 0.0 && value < HUGE_VAL; }

/// Throws std::invalid_argument unless there are terms and they can be evaluated.
inline void require_terms(std::size_t count, double pixel_size, const Loss& loss) {
  if (count == 0) throw std::invalid_argument("a residual block needs an observation");
  if (!is_scale(pixel_size)) {
    throw std::invalid_argument("the pixel size (mm) has to be positive and finite");
  }
  if (!is_scale(loss.scale)) {
    throw std::invalid_argument("the scale of the robust loss has to be positive and finite");
  }
}

/// Observed feature in the form that the functor needs.
struct WeightedFeature {
  Vector3<double> board_point;  ///< mm; if the shape of the board is a parameter, of the flat grid
  MicroLens micro_lens;
  Feature<double> observed;  ///< px
  Feature<double> weight;    ///< 1 / sigma of u, v and rho, 1/px
};

/// Residuals (u, v, rho) / sigma of features of one frame: 3 each, or 2 for a pinhole array
/// (I = 0). Parameter blocks: main lens, array, focal lengths (if I > 0), shape of the board (if
/// Bent), camera_from_rig (if InRig), pose of the board: camera_from_board, or rig_from_board in a
/// rig of several cameras. If the shape is known, its derivatives are omitted.
template <int I, bool Bent = false, bool InRig = false>
class FeatureResiduals {
 public:
  static constexpr int kResiduals = I == 0 ? 2 : 3;

  /// Uses only the size of the board. Throws std::invalid_argument without features, for a lens
  /// type that does not exist, and for a weight, pixel size or scale of the loss that is not
  /// positive and finite.
  FeatureResiduals(std::vector<WeightedFeature> features, double pixel_size, Loss loss,
                   const Board& board = {})
      : features_(std::move(features)), pixel_size_(pixel_size), loss_(loss), board_(board) {
    require_terms(features_.size(), pixel_size_, loss_);
    if (Bent && !(is_scale(board_.half_width) && is_scale(board_.half_height))) {
      throw std::invalid_argument("a board whose shape is a parameter needs a size");
    }
    for (const WeightedFeature& f : features_) {
      if (!is_scale(f.weight.u) || !is_scale(f.weight.v) || (I > 0 && !is_scale(f.weight.rho))) {
        throw std::invalid_argument("the weight of a feature has to be positive and finite");
      }
      if (I > 0 && (f.micro_lens.lens_type < 0 || f.micro_lens.lens_type >= I)) {
        throw std::invalid_argument("a feature has a lens type that the camera does not have");
      }
    }
  }

  /// Takes the parameter blocks in their order, then the residuals.
  template <typename T, typename... Rest>
  bool operator()(const T* lens, const T* array, Rest... rest) const {
    static_assert(sizeof...(Rest) == kPoseAt + 2,
                  "the parameter blocks do not match I, Bent and InRig");
    const std::tuple<Rest...> blocks(rest...);
    const T *focal_lengths = nullptr, *shape = nullptr;
    if constexpr (I > 0) focal_lengths = std::get<0>(blocks);
    if constexpr (Bent) shape = std::get<kShapeAt>(blocks);
    Motion<T> camera_from_board(std::get<kPoseAt>(blocks));
    if constexpr (InRig) {
      camera_from_board = Motion<T>(std::get<kRigAt>(blocks)).after(camera_from_board);
    }
    const MainLens<T> main_lens = from_block<MainLens>(lens);
    const Optics<T> optics(main_lens, from_block<MicroLensArray>(array), focal_lengths, I,
                           pixel_size_);
    T* next = std::get<kPoseAt + 1>(blocks);
    return evaluate(
        main_lens, optics, shape, camera_from_board, [](const Vector3<T>& image) { return image; },
        [&next](const T* residual) { next = std::copy(residual, residual + kResiduals, next); });
  }

  /// Creates a cost function over these features.
  static std::unique_ptr<ceres::CostFunction> create(std::vector<WeightedFeature> features,
                                                     double pixel_size, Loss loss,
                                                     const Board& board = {}) {
    return std::make_unique<Cost>(FeatureResiduals(std::move(features), pixel_size, loss, board));
  }

 private:
  // Positions of the blocks after the array.
  static constexpr std::size_t kShapeAt = I > 0 ? 1 : 0, kRigAt = kShapeAt + (Bent ? 1 : 0),
                               kPoseAt = kRigAt + (InRig ? 1 : 0);

  // The steps before and after p' may use different types of derivatives: `cross` converts an image
  // from the first type to the second, `take` receives the residuals of a feature.
  template <typename Outer, typename Inner, typename Cross, typename Take>
  PLENOCAL_FLATTEN bool evaluate(const MainLens<Outer>& lens, const Optics<Inner>& optics,
                                 const Outer* shape, const Motion<Outer>& camera_from_board,
                                 Cross&& cross, Take&& take) const {
    Vector3<Inner> image;
    const Vector3<double>* imaged = nullptr;
    for (const WeightedFeature& f : features_) {
      // Features of a corner are consecutive, so its image is computed once.
      if (imaged == nullptr || !same(*imaged, f.board_point)) {
        Vector3<Outer> point;
        if constexpr (Bent) {
          point =
              camera_from_board(corner_of(board_, from_block<BoardShape>(shape), f.board_point));
        } else {
          point = camera_from_board(f.board_point);
        }
        const std::optional<Vector3<Outer>> formed = main_lens_image(lens, point);
        if (!formed) return false;
        image = cross(*formed);
        imaged = &f.board_point;
      }
      const std::optional<Feature<Inner>> projected = project_image(optics, image, f.micro_lens);
      if (!projected) return false;
      Inner residual[kResiduals];
      residual[0] = (projected->u - f.observed.u) * f.weight.u;
      residual[1] = (projected->v - f.observed.v) * f.weight.v;
      if constexpr (I > 0) residual[2] = (projected->rho - f.observed.rho) * f.weight.rho;
      apply_loss(loss_, kResiduals, residual);
      take(residual);
    }
    return true;
  }

  // Derivatives in two parts, by the chain rule: derivatives of p' by the parameters before it,
  // once for each corner, and derivatives of a feature by p' and the parameters after it. Jets of
  // both parts are small.
  class Cost : public ceres::CostFunction {
   public:
    explicit Cost(FeatureResiduals residuals) : residuals_(std::move(residuals)) {
      set_num_residuals(kResiduals * static_cast<int>(residuals_.features_.size()));
      auto& sizes = *mutable_parameter_block_sizes();
      sizes = {kLens, kArray};
      for (int size : {I, kShape, kRig, Pose::kSize}) {
        if (size > 0) sizes.push_back(size);
      }
    }

    bool Evaluate(double const* const* blocks, double* values, double** jacobians) const override {
      if (jacobians == nullptr) {
        return evaluate_values(blocks, values, std::make_index_sequence<3 + kPoseAt>());
      }
      const auto lens = seeded<Before, kLens>(blocks[0], 0);
      const auto array = seeded<Behind, kArray>(blocks[1], 3);
      const auto focal_lengths = seeded<Behind, I>(blocks[I > 0 ? 2 : 1], 3 + kArray);
      const auto shape = seeded<Before, kShape>(blocks[2 + kShapeAt], kLens);
      const auto pose = seeded<Before, Pose::kSize>(blocks[2 + kPoseAt], kLens + kShape + kRig);
      Motion<Before> camera_from_board(pose.data());
      if constexpr (InRig) {
        const auto rig = seeded<Before, kRig>(blocks[2 + kRigAt], kLens + kShape);
        camera_from_board = Motion<Before>(rig.data()).after(camera_from_board);
      }
      const MainLens<double> main_lens = from_block<MainLens>(blocks[0]);
      const Optics<Behind> optics(cast<Behind>(main_lens), from_block<MicroLensArray>(array.data()),
                                  focal_lengths.data(), I, residuals_.pixel_size_);
      Eigen::Matrix<double, 3, kBefore, Eigen::RowMajor> of_image;
      const auto cross = [&of_image](const Vector3<Before>& image) {
        of_image.row(0) = image.x.v;
        of_image.row(1) = image.y.v;
        of_image.row(2) = image.z.v;
        return Vector3<Behind>{{image.x.a, 0}, {image.y.a, 1}, {image.z.a, 2}};
      };
      int row = 0;
      const auto take = [&](const Behind* residual) {
        for (int i = 0; i < kResiduals; ++i, ++row) {
          const Eigen::Matrix<double, 1, kBefore> before =
              residual[i].v.template head<3>().transpose() * of_image;
          const double* behind = residual[i].v.data() + 3;
          values[row] = residual[i].a;
          put<kLens>(before.data(), jacobians[0], row);
          put<kArray>(behind, jacobians[1], row);
          if constexpr (I > 0) put<I>(behind + kArray, jacobians[2], row);
          if constexpr (Bent) put<kShape>(before.data() + kLens, jacobians[2 + kShapeAt], row);
          if constexpr (InRig)
            put<kRig>(before.data() + kLens + kShape, jacobians[2 + kRigAt], row);
          put<Pose::kSize>(before.data() + kBefore - Pose::kSize, jacobians[2 + kPoseAt], row);
        }
      };
      return residuals_.evaluate(from_block<MainLens>(lens.data()), optics, shape.data(),
                                 camera_from_board, cross, take);
    }

   private:
    static constexpr int kLens = kMainLensParameters, kArray = kArrayParameters;
    static constexpr int kShape = Bent ? kBoardShapeParameters : 0, kRig = InRig ? Pose::kSize : 0;
    static constexpr int kBefore = kLens + kShape + kRig + Pose::kSize;
    using Before = ceres::Jet<double, kBefore>;
    using Behind = ceres::Jet<double, 3 + kArray + I>;

    // Returns the parameters of a block as variables number `at` and following.
    template <typename Jet, int Size>
    static std::array<Jet, Size> seeded(const double* block, int at) {
      std::array<Jet, Size> jets;
      for (int i = 0; i < Size; ++i) jets[i] = Jet(block[i], at + i);
      return jets;
    }

    template <int Size>
    static void put(const double* derivatives, double* jacobian, int row) {
      if (jacobian != nullptr) std::copy(derivatives, derivatives + Size, jacobian + row * Size);
    }

    template <std::size_t... K>
    bool evaluate_values(double const* const* blocks, double* values,
                         std::index_sequence<K...>) const {
      return residuals_(blocks[K]..., values);
    }

    FeatureResiduals residuals_;
  };

  static bool same(const Vector3<double>& a, const Vector3<double>& b) {
    return a.x == b.x && a.y == b.y && a.z == b.z;
  }

  std::vector<WeightedFeature> features_;
  double pixel_size_;
  Loss loss_;
  Board board_;
};

/// Observed micro-image centre in the form that the functor needs.
struct WeightedCenter {
  Node node;
  Pixel<double> observed;  ///< px
  double weight;           ///< 1 / sigma, 1/px
};

/// Residuals (u, v) / sigma of micro-image centres, 2 each. Parameter blocks: main lens (only its
/// rotation), exit pupil, array.
class CenterResiduals {
 public:
  static constexpr int kResiduals = 2;

  /// Throws std::invalid_argument like `FeatureResiduals`.
  CenterResiduals(std::vector<WeightedCenter> centers, double pixel_size, Loss loss)
      : centers_(std::move(centers)), pixel_size_(pixel_size), loss_(loss) {
    require_terms(centers_.size(), pixel_size_, loss_);
    for (const WeightedCenter& c : centers_) {
      if (!is_scale(c.weight)) {
        throw std::invalid_argument("the weight of a centre has to be positive and finite");
      }
    }
  }

  template <typename T>
  PLENOCAL_FLATTEN bool operator()(const T* lens, const T* exit_pupil, const T* array,
                                   T* residuals) const {
    const LensFrame<T> frame(from_block<MainLens>(lens));
    const auto pupil = from_block<ExitPupil>(exit_pupil);
    const auto mla = from_block<MicroLensArray>(array);
    if (!(pupil.z + mla.lens_to_mla > 0.0)) return false;
    const ArrayOptics<T> optics(mla, pixel_size_);
    for (const WeightedCenter& c : centers_) {
      const Pixel<T> pixel = optics.micro_image_center(frame, pupil, c.node);
      residuals[0] = (pixel.u - c.observed.u) * c.weight;
      residuals[1] = (pixel.v - c.observed.v) * c.weight;
      apply_loss(loss_, kResiduals, residuals);
      residuals += kResiduals;
    }
    return true;
  }

  /// Creates a cost function over these centres.
  static std::unique_ptr<ceres::CostFunction> create(std::vector<WeightedCenter> centers,
                                                     double pixel_size, Loss loss) {
    return std::make_unique<Cost>(
        std::make_unique<CenterResiduals>(std::move(centers), pixel_size, loss));
  }

 private:
  // Jets contain only the rotation of the main lens.
  class Cost : public ceres::CostFunction {
   public:
    explicit Cost(std::unique_ptr<CenterResiduals> residuals) : residuals_(std::move(residuals)) {
      set_num_residuals(kResiduals * static_cast<int>(residuals_->centers_.size()));
      *mutable_parameter_block_sizes() = {kMainLensParameters, kPupil, kArray};
    }

    bool Evaluate(double const* const* blocks, double* values, double** jacobians) const override {
      if (jacobians == nullptr) return (*residuals_)(blocks[0], blocks[1], blocks[2], values);
      auto lens = cast<Jet>(from_block<MainLens>(blocks[0]));
      for (int i = 0; i < kRotation; ++i) lens.rotation[i].v[i] = 1.0;
      std::array<Jet, kPupil> pupil;
      for (int i = 0; i < kPupil; ++i) pupil[i] = Jet(blocks[1][i], kRotation + i);
      std::array<Jet, kArray> array;
      for (int i = 0; i < kArray; ++i) array[i] = Jet(blocks[2][i], kRotation + kPupil + i);
      std::vector<Jet> residuals(num_residuals());
      if (!(*residuals_)(to_block(lens).data(), pupil.data(), array.data(), residuals.data())) {
        return false;
      }
      for (int row = 0; row < num_residuals(); ++row) {
        values[row] = residuals[row].a;
        const double* derivatives = residuals[row].v.data();
        if (jacobians[0] != nullptr) {
          MainLens<double> by_lens{};
          std::copy_n(derivatives, kRotation, by_lens.rotation);
          const auto block = to_block(by_lens);
          std::copy(block.begin(), block.end(), jacobians[0] + row * kMainLensParameters);
        }
        if (jacobians[1] != nullptr) {
          std::copy_n(derivatives + kRotation, kPupil, jacobians[1] + row * kPupil);
        }
        if (jacobians[2] != nullptr) {
          std::copy_n(derivatives + kRotation + kPupil, kArray, jacobians[2] + row * kArray);
        }
      }
      return true;
    }

   private:
    static constexpr int kRotation = 2, kPupil = kExitPupilParameters, kArray = kArrayParameters;
    using Jet = ceres::Jet<double, kRotation + kPupil + kArray>;

    std::unique_ptr<CenterResiduals> residuals_;
  };

  std::vector<WeightedCenter> centers_;
  double pixel_size_;
  Loss loss_;
};

/// Residual of a prior on |m|. Parameter blocks: main lens, exit pupil, array.
class SlopeResidual {
 public:
  /// Creates the residual. `value` in mm; `weight` is 1 / sigma, 1/mm.
  SlopeResidual(double value, double weight) : value_(value), weight_(weight) {}

  template <typename T>
  bool operator()(const T* lens, const T* exit_pupil, const T* array, T* residual) const {
    const T slope = micro_image_slope(from_block<MainLens>(lens), from_block<ExitPupil>(exit_pupil),
                                      from_block<MicroLensArray>(array));
    residual[0] = (slope - value_) * weight_;
    return true;
  }

  /// Creates a cost function of this residual.
  static std::unique_ptr<ceres::CostFunction> create(double value, double weight) {
    return std::make_unique<ceres::AutoDiffCostFunction<SlopeResidual, 1, kMainLensParameters,
                                                        kExitPupilParameters, kArrayParameters>>(
        new SlopeResidual(value, weight));
  }

 private:
  double value_;
  double weight_;
};

/// Residual of a prior on q'_i of one of I lens types. Parameter blocks: array, focal lengths.
template <int I>
class InterceptResidual {
 public:
  /// Creates the residual. `value` in mm; `weight` is 1 / sigma, 1/mm. Throws std::invalid_argument
  /// for a lens type that does not exist.
  InterceptResidual(int lens_type, double value, double weight)
      : lens_type_(lens_type), value_(value), weight_(weight) {
    if (lens_type < 0 || lens_type >= I) {
      throw std::invalid_argument("there is no lens type " + std::to_string(lens_type));
    }
  }

  template <typename T>
  bool operator()(const T* array, const T* focal_lengths, T* residual) const {
    const T q = blur_intercept(from_block<MicroLensArray>(array), focal_lengths[lens_type_]);
    residual[0] = (q - value_) * weight_;
    return true;
  }

  /// Creates a cost function of this residual.
  static std::unique_ptr<ceres::CostFunction> create(int lens_type, double value, double weight) {
    return std::make_unique<ceres::AutoDiffCostFunction<InterceptResidual, 1, kArrayParameters, I>>(
        new InterceptResidual(lens_type, value, weight));
  }

 private:
  int lens_type_;
  double value_;
  double weight_;
};

/// Residual of a prior on the tilt gradient along one axis of the image. Parameter blocks: exit
/// pupil, array.
class TiltGradientResidual {
 public:
  /// Creates the residual. `axis` is 0 for u and 1 for v; `value` in 1/mm; `weight` is 1 / sigma,
  /// mm. Throws std::invalid_argument for another axis.
  TiltGradientResidual(int axis, double value, double weight)
      : axis_(axis), value_(value), weight_(weight) {
    if (axis != 0 && axis != 1) {
      throw std::invalid_argument("there is no axis " + std::to_string(axis));
    }
  }

  template <typename T>
  bool operator()(const T* exit_pupil, const T* array, T* residual) const {
    const Vector2<T> found =
        tilt_gradient(from_block<ExitPupil>(exit_pupil), from_block<MicroLensArray>(array));
    residual[0] = ((axis_ == 0 ? found.x : found.y) - value_) * weight_;
    return true;
  }

  /// Creates a cost function of this residual.
  static std::unique_ptr<ceres::CostFunction> create(int axis, double value, double weight) {
    return std::make_unique<ceres::AutoDiffCostFunction<TiltGradientResidual, 1,
                                                        kExitPupilParameters, kArrayParameters>>(
        new TiltGradientResidual(axis, value, weight));
  }

 private:
  int axis_;
  double value_;
  double weight_;
};

}  // namespace plenocal
