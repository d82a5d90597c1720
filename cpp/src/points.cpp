#include "plenocal/points.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <limits>

#include "checks.hpp"
#include "plenocal/residuals.hpp"

namespace plenocal {
namespace {

struct Interval {
  double low, high;

  double middle() const { return 0.5 * (low + high); }
  double half() const { return 0.5 * (high - low); }
};

// Returns the part of an interval within limits. A limit that is NaN, as after a vanishing
// determinant, has no effect.
Interval common(const Interval& a, const Interval& limits) {
  return {std::max(a.low, limits.low), std::min(a.high, limits.high)};
}

// Part of the plane of the array, in pitches from its centre like `Node`; empty if low > high.
struct Box {
  Interval x, y;
};

// Part of the array from which an image point p' can be seen.
//
// All coordinates are relative to the centre P of the exit pupil. s_z is the z of the sensor and R
// the point where the ray from P through p' meets the plane z = C_z of micro-lens C. p' is seen at
//   (s_z - C_z) p'_z / ((p'_z - C_z) C_z) (R - C),   R = p' C_z / p'_z,
// from the centre of the micro-image. It is thus seen within a radius r if, in x and y,
//   |p' C_z - C p'_z| <= r |p'_z - C_z| |C_z| / |s_z - C_z|.
// The left-hand side is the length of an affine function of the node, b + M node. The right-hand
// side has an upper limit from the range of C_z over a box of nodes. The nodes therefore lie in an
// ellipse. This is exact for an array without tilt; otherwise the box of the ellipse has a smaller
// range.
class Sight {
 public:
  Sight(const Camera& camera, const ArrayOptics<double>& array, const Vector3<double>& image,
        double radius_px)
      : image_(difference(image, pupil(camera))),
        sensor_z_(array.sensor_z() - pupil(camera).z),
        radius_mm_(radius_px * camera.pixel_size),
        origin_(difference(array.micro_lens_center({0.0, 0.0}), pupil(camera))),
        step_x_(
            difference(array.micro_lens_center({1.0, 0.0}), array.micro_lens_center({0.0, 0.0}))),
        step_y_(
            difference(array.micro_lens_center({0.0, 1.0}), array.micro_lens_center({0.0, 0.0}))) {}

  // Returns the part of a box from which p' can be seen.
  Box within(const Box& box) const {
    const Interval z = depths(box);
    if (!(z.low > sensor_z_ || z.high < sensor_z_)) return box;
    const double bound = radius_mm_ * farthest(z, image_.z) * farthest(z, 0.0) /
                         std::min(std::abs(z.low - sensor_z_), std::abs(z.high - sensor_z_));
    const Vector2<double> b = in_plane(origin_);
    const Vector2<double> m_x = in_plane(step_x_);
    const Vector2<double> m_y = in_plane(step_y_);
    const double determinant = m_x.x * m_y.y - m_x.y * m_y.x;
    const double x = (m_y.x * b.y - m_y.y * b.x) / determinant;
    const double y = (m_x.y * b.x - m_x.x * b.y) / determinant;
    const double half_x = bound * std::hypot(m_y.x, m_y.y) / std::abs(determinant);
    const double half_y = bound * std::hypot(m_x.x, m_x.y) / std::abs(determinant);
    return {common(box.x, {x - half_x, x + half_x}), common(box.y, {y - half_y, y + half_y})};
  }

 private:
  static Vector3<double> difference(const Vector3<double>& a, const Vector3<double>& b) {
    return {a.x - b.x, a.y - b.y, a.z - b.z};
  }

  static Vector3<double> pupil(const Camera& camera) {
    const ExitPupil<double>& pupil = camera.exit_pupil;
    return LensFrame<double>(camera.main_lens).to_camera({pupil.x, pupil.y, pupil.z});
  }

  static double farthest(const Interval& z, double from) {
    return std::max(std::abs(z.low - from), std::abs(z.high - from));
  }

  // Computes the linear map C -> p' C_z - C p'_z, in x and y.
  Vector2<double> in_plane(const Vector3<double>& c) const {
    return {image_.x * c.z - c.x * image_.z, image_.y * c.z - c.y * image_.z};
  }

  // Returns the range of C_z.
  Interval depths(const Box& box) const {
    const double middle = origin_.z + step_x_.z * box.x.middle() + step_y_.z * box.y.middle();
    const double half = std::abs(step_x_.z) * box.x.half() + std::abs(step_y_.z) * box.y.half();
    return {middle - half, middle + half};
  }

  Vector3<double> image_;
  double sensor_z_;
  double radius_mm_;
  Vector3<double> origin_;  // C of the middle of the array, and its changes by one pitch
  Vector3<double> step_x_;
  Vector3<double> step_y_;
};

// Largest distance of nodes from a regular grid through node (0, 0) with the steps between every
// other row and column, in pitches: the shift of hexagonal rows, and rounding.
constexpr double kShift = 0.51;

// Returns the largest shift of micro-image centres by the aberration of the pupil, px: at a corner
// of the array, since it grows with the distance from the axis.
double largest_center_shift(const Camera& camera, const ArrayOptics<double>& array) {
  const LensFrame<double> frame(camera.main_lens);
  ExitPupil<double> paraxial = camera.exit_pupil;
  paraxial.aberration = 0.0;
  double largest = 0.0;
  for (int k : {0, camera.lattice.columns - 1}) {
    for (int l : {0, camera.lattice.rows - 1}) {
      const Node node = camera.lattice.node(k, l);
      const Pixel<double> center = array.micro_image_center(frame, camera.exit_pupil, node);
      const Pixel<double> without = array.micro_image_center(frame, paraxial, node);
      largest = std::max(largest, std::hypot(center.u - without.u, center.v - without.v));
    }
  }
  return largest;
}

Box whole_array(const Lattice& lattice) {
  const Node corner = lattice.node(0, 0);
  const double x = std::abs(corner.x) + kShift;
  const double y = std::abs(corner.y) + kShift;
  return {{-x, x}, {-y, y}};
}

struct IndexRange {
  int first, last;
};

// Returns the indices 0 .. count - 1 of nodes in an interval, where index i is near first + i step.
IndexRange indices(const Interval& nodes, double first, double step, int count) {
  const auto bounded = [count](double index) { return std::clamp<double>(index, -1.0, count); };
  const double low = bounded(std::ceil((nodes.low - kShift - first) / step));
  const double high = bounded(std::floor((nodes.high + kShift - first) / step));
  return {std::max(0, static_cast<int>(low)), std::min(count - 1, static_cast<int>(high))};
}

bool is_finite(const Vector3<double>& v) {
  return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z);
}

constexpr int kPoint = 3;
constexpr int kMaxIntrinsics =
    kMainLensParameters + kExitPupilParameters + kArrayParameters + kMaxLensTypes;
constexpr int kVariables = kPoint + kMaxIntrinsics;  // x, y, z, then the intrinsics in their order
using Jet = ceres::Jet<double, kVariables>;
using Jacobian = Eigen::Matrix<double, Eigen::Dynamic, kVariables, Eigen::RowMajor>;

// Returns values as variables number `first` and following.
template <std::size_t N>
std::array<Jet, N> variables(const std::array<double, N>& values, int first) {
  std::array<Jet, N> jets;
  for (std::size_t i = 0; i < N; ++i) jets[i] = Jet(values[i], first + static_cast<int>(i));
  return jets;
}

Optics<Jet> variable_optics(const Camera& camera) {
  // Features do not depend on the exit pupil.
  constexpr int kFirstOfArray = kPoint + kMainLensParameters + kExitPupilParameters;
  const auto lens = variables(to_block(camera.main_lens), kPoint);
  const auto array = variables(to_block(camera.mla), kFirstOfArray);
  std::array<double, kMaxLensTypes> values{};
  std::copy(camera.micro_lens_focal_lengths.begin(), camera.micro_lens_focal_lengths.end(),
            values.begin());
  const auto focal_lengths = variables(values, kFirstOfArray + kArrayParameters);
  return {from_block<MainLens>(lens.data()), from_block<MicroLensArray>(array.data()),
          focal_lengths.data(), camera.lens_types(), camera.pixel_size};
}

// Returns the derivatives of the standardised features of a point in these micro-lenses; empty if
// one does not see it.
PLENOCAL_FLATTEN Jacobian feature_jacobian(const Camera& camera, const Vector3<double>& point,
                                           const std::vector<MicroLensIndex>& micro_lenses,
                                           const Feature<double>& std_dev) {
  const Optics<Jet> optics = variable_optics(camera);
  const auto [x, y, z] = variables<kPoint>({point.x, point.y, point.z}, 0);
  const double rho_std_dev = std_dev.rho * std::sqrt(static_cast<double>(micro_lenses.size()));
  Jacobian jacobian(micro_lenses.size() * (optics.has_blur ? 3 : 2), kVariables);
  const auto image = main_lens_image(optics.main_lens, {x, y, z});
  if (!image) return {};
  int row = 0;
  for (const auto& [k, l] : micro_lenses) {
    const auto feature = project_image(optics, *image, micro_lens_of(camera, k, l));
    if (!feature) return {};
    jacobian.row(row++) = feature->u.v.transpose() / std_dev.u;
    jacobian.row(row++) = feature->v.v.transpose() / std_dev.v;
    if (optics.has_blur) jacobian.row(row++) = feature->rho.v.transpose() / rho_std_dev;
  }
  return jacobian;
}

// Computes the results from the Jacobian J = (J_x, J_t): -(J_x' J_x)^-1 J_x' J_t and (J_x' J_x)^-1.
// Returns false, with the result unchanged, if J does not determine the point.
bool solve(const Jacobian& jacobian, int intrinsics, PointSensitivity* result) {
  if (jacobian.rows() == 0) return false;
  const auto by_point = jacobian.leftCols<kPoint>();
  const Eigen::Vector3d scale = by_point.colwise().norm().cwiseInverse().transpose();
  if (!jacobian.allFinite() || !scale.allFinite()) return false;
  // Tolerance relative to the largest pivot of columns of equal length: smaller ones are rounding
  // errors of the derivatives.
  constexpr double kRankTolerance = 1e-12;
  Eigen::ColPivHouseholderQR<Eigen::Matrix<double, Eigen::Dynamic, kPoint>> qr;
  qr.setThreshold(kRankTolerance);
  qr.compute(by_point * scale.asDiagonal());
  if (qr.rank() < kPoint) return false;

  result->by_intrinsics.eigen() =
      -(scale.asDiagonal() * qr.solve(jacobian.middleCols(kPoint, intrinsics)));
  const Eigen::Matrix3d upper = qr.matrixR().topRows<kPoint>();
  const Eigen::Matrix3d root =
      scale.asDiagonal() * (qr.colsPermutation() * upper.triangularView<Eigen::Upper>().solve(
                                                       Eigen::Matrix3d::Identity()));
  Eigen::Map<Eigen::Matrix3d>(result->covariance.data()) = root * root.transpose();
  return true;
}

}  // namespace

std::vector<MicroLensIndex> micro_lenses_seeing(const Camera& camera, const Vector3<double>& point,
                                                double margin) {
  validate(camera);
  if (!(std::isfinite(margin) && margin >= 0.0)) {
    reject("the margin inside a micro-image has to be finite and not negative");
  }
  const Optics<double> optics = optics_of(camera);
  const double radius = 0.5 * optics.array.micro_image_pitch(camera.exit_pupil) - margin;
  const auto image = unfolded_image(optics.main_lens, point);
  if (radius < 0.0 || !image || !is_finite(*image)) return {};

  const LensFrame<double> frame(camera.main_lens);
  const Lattice& lattice = camera.lattice;
  const Sight sight(camera, optics.array, *image,
                    radius + largest_center_shift(camera, optics.array));
  const Box box = sight.within(sight.within(whole_array(lattice)));
  const Node first = lattice.node(0, 0);
  const Node third = lattice.node(2, 2);
  const IndexRange k = indices(box.x, first.x, 0.5 * (third.x - first.x), lattice.columns);
  const IndexRange l = indices(box.y, first.y, 0.5 * (third.y - first.y), lattice.rows);
  std::vector<MicroLensIndex> seeing;
  for (MicroLensIndex i{0, l.first}; i.l <= l.last; ++i.l) {
    for (i.k = k.first; i.k <= k.last; ++i.k) {
      const MicroLens micro_lens = micro_lens_of(camera, i.k, i.l);
      const auto feature = project_image(optics, *image, micro_lens);
      if (!feature) continue;
      const Pixel<double> center =
          optics.array.micro_image_center(frame, camera.exit_pupil, micro_lens.node);
      if (std::hypot(feature->u - center.u, feature->v - center.v) <= radius) seeing.push_back(i);
    }
  }
  return seeing;
}

PointSensitivity point_sensitivity(const Camera& camera, const Vector3<double>& point,
                                   const Feature<double>& std_dev, double margin) {
  require_std_dev(std_dev.u, "u");
  require_std_dev(std_dev.v, "v");
  const bool uses_rho = camera.lens_types() > 0 && std_dev.rho != HUGE_VAL;
  if (uses_rho) require_std_dev(std_dev.rho, "rho");
  const std::vector<MicroLensIndex> micro_lenses = micro_lenses_seeing(camera, point, margin);

  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  const int intrinsics =
      kMainLensParameters + kExitPupilParameters + kArrayParameters + camera.lens_types();
  PointSensitivity result;
  result.micro_lenses = static_cast<int>(micro_lenses.size());
  result.by_intrinsics = {kPoint, intrinsics,
                          std::vector<double>(static_cast<std::size_t>(kPoint * intrinsics), kNan)};
  result.covariance.fill(kNan);
  if (micro_lenses.size() >= 2) {
    solve(feature_jacobian(camera, point, micro_lenses, std_dev), intrinsics, &result);
  }
  return result;
}

}  // namespace plenocal
