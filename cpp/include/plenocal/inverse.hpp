// Inverse model: from a pixel back into space.
//
// The light of a pixel seen through a micro-lens lies along a line behind the main lens, from the
// pixel through the centre C of the micro-lens. The image p' of a point lies on it, at the virtual
// depth nu, and the main lens images the line to a ray in object space. The functions are
// templates, like the forward model (projection.hpp), so that the same code gives derivatives.
// `BackProjection` (back_projection.hpp) applies them to whole cameras, with checks.
#pragma once

#include <array>
#include <cmath>
#include <type_traits>

#include "plenocal/projection.hpp"

namespace plenocal {

/// Returns the value of a number without its derivatives.
inline double value_of(double x) { return x; }
template <typename Jet>
auto value_of(const Jet& x) -> decltype(x.a) {
  return x.a;
}

/// Magnification m, which is negative, of the point whose ideal image lies at the distance r from
/// the axis, as a function of r^2.
template <typename T>
class Magnification {
 public:
  /// Creates the magnification m of all points at one distance from the lens.
  explicit Magnification(const T& value) : terms_{value, T(0.0), T(1.0), T(0.0)} {}
  /// Creates the magnification of the points whose images lie at z, mm. A point at Z has
  /// m = -F/(Z - F), so that `image_along_axis` gives z = m F - F + (kappa - kappa_m m) r^2, which
  /// is linear in m.
  static Magnification of_images_at(const T& z, const MainLens<T>& lens) {
    return Magnification(std::array<T, 4>{z + lens.focal_length, lens.field_curvature,
                                          lens.focal_length, lens.field_curvature_growth});
  }

  T operator()(const T& r2) const {
    return (terms_[0] - terms_[1] * r2) / (terms_[2] - terms_[3] * r2);
  }
  /// Returns the derivative by r^2.
  T slope(const T& r2) const {
    const T& value = (*this)(r2);
    return (terms_[3] * value - terms_[1]) / (terms_[2] - terms_[3] * r2);
  }
  /// Returns the magnification without derivatives.
  Magnification<double> value() const {
    std::array<double, 4> values;
    for (std::size_t i = 0; i < values.size(); ++i) values[i] = value_of(terms_[i]);
    return Magnification<double>(values);
  }

 private:
  template <typename>
  friend class Magnification;
  explicit Magnification(const std::array<T, 4>& terms) : terms_(terms) {}

  std::array<T, 4> terms_;
};

/// Derivative of (x, y) -> (x, y) + `distortion`, which is symmetric.
template <typename T>
struct DistortionSlope {
  T xx, xy, yy;

  T determinant() const { return xx * yy - xy * xy; }
  /// Returns true if distortion keeps the order of neighbours: polynomials turn back far outside
  /// the image.
  bool is_regular() const { return determinant() > 0.0 && xx > 0.0; }
  /// Returns the change of the ideal point for a change of the distorted point, to first order.
  Vector2<T> undo(const Vector2<T>& change) const {
    const T inverse = 1.0 / determinant();
    return {(yy * change.x - xy * change.y) * inverse, (xx * change.y - xy * change.x) * inverse};
  }
};

/// Returns the `DistortionSlope` at the ideal image point (x, y), mm.
template <typename T>
DistortionSlope<T> distortion_slope(const MainLens<T>& lens, const Magnification<T>& magnification,
                                    const T& x, const T& y) {
  const T* q = lens.radial;
  const T* t = lens.tangential;
  const T r2 = x * x + y * y;
  const T first = q[0] - lens.radial_growth * magnification(r2);
  const T by_magnification = lens.radial_growth * r2 * magnification.slope(r2);
  const T radial = 1.0 + r2 * (first + r2 * (q[1] + r2 * q[2]));
  const T slope = 2.0 * (first - by_magnification + r2 * (2.0 * q[1] + r2 * (3.0 * q[2])));
  return {radial + x * x * slope + 6.0 * t[0] * x + 2.0 * t[1] * y,
          x * y * slope + 2.0 * (t[0] * y + t[1] * x),
          radial + y * y * slope + 6.0 * t[1] * y + 2.0 * t[0] * x};
}

/// Returns a part of the camera without derivatives.
template <template <typename> class Part, typename T>
Part<double> values_of(const Part<T>& part) {
  const auto block = to_block(part);
  std::array<double, parameter_count<Part>()> values;
  for (std::size_t i = 0; i < values.size(); ++i) values[i] = value_of(block[i]);
  return from_block<Part>(values.data());
}

/// Returns the ideal image point that distortion moves to `distorted`, both in mm in the lens
/// frame. Returns no value if there is none on the axis's side of the fold, where polynomials turn
/// back.
template <typename T>
std::optional<Vector2<T>> undistort(const MainLens<T>& lens, const Magnification<T>& magnification,
                                    const Vector2<T>& distorted) {
  constexpr int kMaxSteps = 50;
  constexpr double kSettled = 1e-15;   // step over the distance from the axis
  constexpr double kRounding = 1e-12;  // likewise, for a step that is not smaller than the last
  const MainLens<double> at = values_of(lens);
  const Magnification<double> magnified = magnification.value();
  const Vector2<double> target{value_of(distorted.x), value_of(distorted.y)};
  const auto slope_at = [&](double x, double y) { return distortion_slope(at, magnified, x, y); };
  // Newton's method. A step that would leave the axis's side of the fold is halved.
  Vector2<double> p = target;
  for (int i = 0; i < kMaxSteps && !slope_at(p.x, p.y).is_regular(); ++i) {
    p = {0.5 * p.x, 0.5 * p.y};
  }
  double last = HUGE_VAL;
  bool settled = false;
  for (int i = 0; i < kMaxSteps && !settled; ++i) {
    const double m = magnified(p.x * p.x + p.y * p.y);
    const Vector2<double> shift = distortion(at, m, p.x, p.y);
    Vector2<double> step =
        slope_at(p.x, p.y).undo({target.x - p.x - shift.x, target.y - p.y - shift.y});
    double length = std::hypot(step.x, step.y);
    for (int k = 0; k < kMaxSteps; ++k) {
      if (slope_at(p.x + step.x, p.y + step.y).is_regular()) break;
      step = {0.5 * step.x, 0.5 * step.y};
      length = HUGE_VAL;
    }
    p = {p.x + step.x, p.y + step.y};
    const double size = std::hypot(p.x, p.y);
    settled = length <= kSettled * size || (length >= last && length <= kRounding * size) ||
              length == 0.0;
    last = length;
  }
  if (!settled || !slope_at(p.x, p.y).is_regular()) return std::nullopt;
  // One more step in T gives the derivatives of the solution.
  const T x(p.x), y(p.y);
  const Vector2<T> shift = distortion(lens, magnification(x * x + y * y), x, y);
  const Vector2<T> step = distortion_slope(lens, magnification, x, y)
                              .undo({distorted.x - x - shift.x, distorted.y - y - shift.y});
  return Vector2<T>{x + step.x, y + step.y};
}

/// Returns the point (mm) whose image through the main lens is p', both in the camera frame: the
/// inverse of `main_lens_image`. Returns no value if p' is not the image of a point beyond the
/// focal plane, or if distortion has no inverse there.
template <typename T>
std::optional<Vector3<T>> object_point(const MainLens<T>& lens, const Vector3<T>& image_point) {
  const LensFrame<T> frame(lens);
  const Vector3<T> image = frame.of_camera(image_point);
  const auto magnifications = Magnification<T>::of_images_at(image.z, lens);
  const std::optional<Vector2<T>> ideal = undistort(lens, magnifications, {image.x, image.y});
  if (!ideal) return std::nullopt;
  const T magnification = magnifications(ideal->x * ideal->x + ideal->y * ideal->y);
  if (!(magnification < 0.0)) return std::nullopt;
  return frame.to_camera({ideal->x / magnification, ideal->y / magnification,
                          lens.focal_length - lens.focal_length / magnification});
}

/// Returns the image p' at the virtual depth nu on the line from a pixel through the centre C of a
/// micro-lens. nu is the distance from the micro-lens to p' over the distance from the micro-lens
/// to the sensor, positive behind the array. Both distances are along z, also for a
/// tilted array.
template <typename T>
Vector3<T> image_at(const ArrayOptics<T>& array, const Vector3<T>& center, const Pixel<T>& pixel,
                    const T& virtual_depth) {
  const Vector3<T> on_sensor = array.on_sensor(pixel);
  return {center.x + virtual_depth * (on_sensor.x - center.x),
          center.y + virtual_depth * (on_sensor.y - center.y),
          center.z + virtual_depth * (on_sensor.z - center.z)};
}

/// Returns the virtual depth of an image p' seen through a micro-lens with the centre C.
template <typename T>
T virtual_depth_of(const ArrayOptics<T>& array, const Vector3<T>& center, const Vector3<T>& image) {
  return (image.z - center.z) / (array.sensor_z() - center.z);
}

/// Returns the virtual depth for a blur radius rho (px): the inverse of `ArrayOptics::blur_radius`.
/// It is infinite for an image at infinity.
template <typename T>
T virtual_depth_of_blur(const Optics<T>& optics, const Vector3<T>& center, int lens_type,
                        const T& rho) {
  return 1.0 /
         optics.array.inverse_depth_of_blur(center, rho, optics.inverse_focal_lengths[lens_type]);
}

/// Straight line in space: camera frame, mm.
template <typename T>
struct Ray {
  Vector3<T> origin;
  Vector3<T> direction;  ///< unit vector towards the scene
};

/// Returns the light that falls on a pixel, between micro-lens and main lens: through the point of
/// the micro-lens that is (x, y) radii from its centre. (0, 0) is the chief ray, which micro-lenses
/// do not deviate; the other rays diverge from, or converge to, the image of the pixel through the
/// micro-lens. For an array of pinholes all are the chief ray.
template <typename T>
Ray<T> ray_behind(const Optics<T>& optics, const MicroLens& micro_lens, const Pixel<T>& pixel,
                  const Vector2<double>& aperture = {0.0, 0.0}) {
  using std::sqrt;
  const ArrayOptics<T>& array = optics.array;
  const Vector3<T> center = array.micro_lens_center(micro_lens.node);
  const Vector3<T> on_sensor = array.on_sensor(pixel);
  const Vector3<T> chief = {center.x - on_sensor.x, center.y - on_sensor.y, center.z - on_sensor.z};
  Ray<T> ray{center, chief};
  if (optics.has_blur) {
    // The pixel is imaged to C + b chief/delta with 1/b = 1/f - 1/delta; per delta of z, the ray
    // through C + q leaves the chief ray by -q delta/b.
    const T delta = center.z - array.sensor_z();
    const T convergence = delta * optics.inverse_focal_lengths[micro_lens.lens_type] - 1.0;
    const T radius = array.micro_lens_radius();
    const Vector2<T> off{radius * aperture.x, radius * aperture.y};
    ray.origin = {center.x + off.x, center.y + off.y, center.z};
    ray.direction = {chief.x - convergence * off.x, chief.y - convergence * off.y, chief.z};
  }
  const Vector3<T>& d = ray.direction;
  const T length = sqrt(d.x * d.x + d.y * d.y + d.z * d.z);
  ray.direction = {d.x / length, d.y / length, d.z / length};
  return ray;
}

/// Returns the ray in object space whose image is the chief ray of a pixel, with its origin at the
/// distance z (mm). Distortion and field curvature bend the image of a straight line a little. The
/// ray is therefore the tangent, at z, to the curve that the model images onto the pixel. Returns
/// no value if the model images no point at z onto the pixel.
template <typename T>
std::optional<Ray<T>> object_ray(const Optics<T>& optics, const MicroLens& micro_lens,
                                 const Pixel<T>& pixel, const T& z) {
  using std::sqrt;
  constexpr int kMaxSteps = 20;
  constexpr double kSettled = 4e-15;  // relative size of a step
  const MainLens<T>& lens = optics.main_lens;
  const LensFrame<T> frame(lens);
  const Vector3<T> normal = frame.normal();
  const T beyond_focus = z - normal.z * lens.focal_length;
  if (!(beyond_focus > 0.0)) return std::nullopt;
  const Vector3<T> micro_lens_center = optics.array.micro_lens_center(micro_lens.node);
  const Vector3<T> on_sensor = optics.array.on_sensor(pixel);
  const Vector3<T> center = frame.of_camera(micro_lens_center);
  const Vector3<T> line =
      frame.of_camera({on_sensor.x - micro_lens_center.x, on_sensor.y - micro_lens_center.y,
                       on_sensor.z - micro_lens_center.z});
  // The point (x, y)/m, F - F/m lies at the distance z. Its magnification m is therefore linear in
  // the ideal image point (x, y), which Newton's method finds: with it, p'_z = m F - F + (kappa -
  // kappa_m m) r^2 and the virtual depth.
  const T m_axis = -normal.z * lens.focal_length / beyond_focus;
  const T m_x = normal.x / beyond_focus, m_y = normal.y / beyond_focus;
  const T depth_on_axis = ((m_axis - 1.0) * lens.focal_length - center.z) / line.z;
  T x = center.x + depth_on_axis * line.x, y = center.y + depth_on_axis * line.y;
  T magnification = m_axis + m_x * x + m_y * y;
  DistortionSlope<T> distorts = distortion_slope(lens, Magnification<T>(magnification), x, y);
  bool settled = false;
  for (int i = 0; i < kMaxSteps; ++i) {
    const T r2 = x * x + y * y;
    const T bulge = (lens.field_curvature - lens.field_curvature_growth * magnification) / line.z;
    const T depth = ((magnification - 1.0) * lens.focal_length - center.z) / line.z + bulge * r2;
    const Vector2<T> shift = distortion(lens, magnification, x, y);
    const T off_x = center.x + depth * line.x - x - shift.x;
    const T off_y = center.y + depth * line.y - y - shift.y;
    const T by_m = (lens.focal_length - lens.field_curvature_growth * r2) / line.z;
    const T by_x = 2.0 * bulge * x + by_m * m_x, by_y = 2.0 * bulge * y + by_m * m_y;
    const T growth = lens.radial_growth * r2;
    const T xx = distorts.xx - growth * x * m_x - line.x * by_x;
    const T xy = distorts.xy - growth * x * m_y - line.x * by_y;
    const T yx = distorts.xy - growth * y * m_x - line.y * by_x;
    const T yy = distorts.yy - growth * y * m_y - line.y * by_y;
    const T inverse = 1.0 / (xx * yy - xy * yx);
    const T step_x = (yy * off_x - xy * off_y) * inverse;
    const T step_y = (xx * off_y - yx * off_x) * inverse;
    x = x + step_x;
    y = y + step_y;
    magnification = m_axis + m_x * x + m_y * y;
    distorts = distortion_slope(lens, Magnification<T>(magnification), x, y);
    // The round after the last step gives the derivatives of the solution.
    if (settled) break;
    const double size = std::abs(value_of(x)) + std::abs(value_of(y)) +
                        std::abs(value_of(center.x)) + std::abs(value_of(center.y));
    const double step = std::abs(value_of(step_x)) + std::abs(value_of(step_y));
    if (!(step < HUGE_VAL)) return std::nullopt;
    settled = step <= kSettled * size;
    if (std::is_same<T, double>::value && settled) break;
  }
  if (!settled || !distorts.is_regular() || !(magnification < 0.0)) return std::nullopt;
  // Derivatives of the image and its magnification along the line: the ideal image moves with the
  // line and, since distortion changes, with the magnification.
  const Vector2<T> ideal{x, y};
  const T r2 = x * x + y * y;
  const T growth = lens.radial_growth * r2;
  const Vector2<T> by_line = distorts.undo({line.x, line.y});
  const Vector2<T> by_magnification = distorts.undo({growth * x, growth * y});
  const T curvature = lens.field_curvature - lens.field_curvature_growth * magnification;
  const T slope = (line.z - curvature * 2.0 * (x * by_line.x + y * by_line.y)) /
                  (lens.focal_length - lens.field_curvature_growth * r2 +
                   curvature * 2.0 * (x * by_magnification.x + y * by_magnification.y));
  const Vector2<T> slide{by_line.x + slope * by_magnification.x,
                         by_line.y + slope * by_magnification.y};
  // The point is (x, y)/m and z = F - F/m; these are its derivatives by the depth.
  const T inverse = 1.0 / magnification;
  const T by_slope = slope * inverse;
  Vector3<T> direction = frame.to_camera({(slide.x - ideal.x * by_slope) * inverse,
                                          (slide.y - ideal.y * by_slope) * inverse,
                                          lens.focal_length * by_slope * inverse});
  T length =
      sqrt(direction.x * direction.x + direction.y * direction.y + direction.z * direction.z);
  if (direction.z < 0.0) length = -length;
  const Vector3<T> point = frame.to_camera(
      {ideal.x * inverse, ideal.y * inverse, lens.focal_length - lens.focal_length * inverse});
  return Ray<T>{{point.x, point.y, z},
                {direction.x / length, direction.y / length, direction.z / length}};
}

}  // namespace plenocal
