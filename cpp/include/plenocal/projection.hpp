// Forward model: board point -> BAP feature (u, v, rho), and micro-lens -> micro-image centre.
//
// This header is the only projection model of the library. It consists of templates, so that the
// same code gives values (T = double) and derivatives (T = ceres::Jet). Equation names refer to the
// paper "Blur Aware Calibration of Multi-Focus Plenoptic Camera" (CVPR 2020).
#pragma once

#include <limits>
#include <optional>
#include <stdexcept>

#include "plenocal/camera.hpp"

namespace plenocal {

/// Vector in a plane z = const of the camera frame, mm.
template <typename T>
struct Vector2 {
  T x, y;
};

/// Point in the raw image, px.
template <typename T>
struct Pixel {
  T u, v;
};

/// Blur aware plenoptic feature: position and signed blur radius, px. rho is NaN for an array of
/// pinholes, which has no blur.
template <typename T>
struct Feature {
  T u, v, rho;
};

/// Pose camera_from_board: angle-axis rotation (rad) followed by a translation (mm).
struct Pose {
  static constexpr int kSize = 6;
  Vector3<double> rotation{};
  Vector3<double> translation{};
};

/// Converts a pose to the solver's parameter block, and back.
inline std::array<double, Pose::kSize> pose_block(const Pose& pose) {
  const auto &r = pose.rotation, &t = pose.translation;
  return {r.x, r.y, r.z, t.x, t.y, t.z};
}
inline Pose pose_from_block(const std::array<double, Pose::kSize>& b) {
  return {{b[0], b[1], b[2]}, {b[3], b[4], b[5]}};
}

/// Returns the motion `first` followed by `second`: with second = camera_from_rig and first =
/// rig_from_board it is camera_from_board. This function and the next two throw
/// std::invalid_argument for a pose or a point that is not finite.
PLENOCAL_API Pose composed(const Pose& second, const Pose& first);

/// Returns the inverse motion: board_from_camera for camera_from_board.
PLENOCAL_API Pose inverse(const Pose& pose);

/// Transforms a point: with camera_from_board, from the board frame to the camera frame (mm).
PLENOCAL_API Vector3<double> transformed(const Pose& pose, const Vector3<double>& point);

/// Rigid transform of a pose block, with the rotation matrix computed once for many points.
template <typename T>
class Motion {
 public:
  explicit Motion(const T* block) : translation_{block[3], block[4], block[5]} {
    using std::cos;
    using std::sin;
    using std::sqrt;
    // R = cos a + [n] sin a + n n' (1 - cos a) with the angle a and the axis n (Rodrigues). Near 0
    // the first-order form gives correct derivatives.
    const T &x = block[0], &y = block[1], &z = block[2];
    const T square = x * x + y * y + z * z;
    T cosine(1.0), by_sine(1.0), by_cosine(0.0);  // sin a/a and (1 - cos a)/a^2
    if (square > std::numeric_limits<double>::epsilon()) {
      const T angle = sqrt(square);
      cosine = cos(angle);
      by_sine = sin(angle) / angle;
      by_cosine = (1.0 - cosine) / square;
    }
    const T entries[9] = {cosine + x * x * by_cosine,      x * y * by_cosine - z * by_sine,
                          x * z * by_cosine + y * by_sine, x * y * by_cosine + z * by_sine,
                          cosine + y * y * by_cosine,      y * z * by_cosine - x * by_sine,
                          x * z * by_cosine - y * by_sine, y * z * by_cosine + x * by_sine,
                          cosine + z * z * by_cosine};
    std::copy(entries, entries + 9, rotation_);
  }
  /// Transforms a point of the board to the camera frame, mm. U is double or T.
  template <typename U = double>
  Vector3<T> operator()(const Vector3<U>& p) const {
    const auto row = [&](int i) {
      return rotation_[3 * i] * p.x + rotation_[3 * i + 1] * p.y + rotation_[3 * i + 2] * p.z +
             translation_[i];
    };
    return {row(0), row(1), row(2)};
  }

  /// Returns this motion after another one: camera_from_rig.after(rig_from_board) is
  /// camera_from_board.
  Motion after(const Motion& first) const {
    Motion both = *this;
    for (int i = 0; i < 3; ++i) {
      const T* row = rotation_ + 3 * i;
      for (int j = 0; j < 3; ++j) {
        both.rotation_[3 * i + j] = row[0] * first.rotation_[j] + row[1] * first.rotation_[3 + j] +
                                    row[2] * first.rotation_[6 + j];
      }
      both.translation_[i] += row[0] * first.translation_[0] + row[1] * first.translation_[1] +
                              row[2] * first.translation_[2];
    }
    return both;
  }

 private:
  T rotation_[9];
  T translation_[3];
};

/// The lens frame: the camera frame, whose z axis is normal to the sensor, turned about O so that z
/// is the optical axis. camera_from_lens is Ry(omega_y) Rx(omega_x).
template <typename T>
class LensFrame {
 public:
  explicit LensFrame(const MainLens<T>& lens) {
    using std::cos;
    using std::sin;
    const T &x = lens.rotation[0], &y = lens.rotation[1];
    cos_x_ = cos(x), sin_x_ = sin(x), cos_y_ = cos(y), sin_y_ = sin(y);
  }

  /// Converts a vector from the camera frame to the lens frame.
  Vector3<T> of_camera(const Vector3<T>& v) const {
    const T z = sin_y_ * v.x + cos_y_ * v.z;
    return {cos_y_ * v.x - sin_y_ * v.z, cos_x_ * v.y + sin_x_ * z, cos_x_ * z - sin_x_ * v.y};
  }
  /// Converts a vector from the lens frame to the camera frame.
  Vector3<T> to_camera(const Vector3<T>& v) const {
    const T z = sin_x_ * v.y + cos_x_ * v.z;
    return {cos_y_ * v.x + sin_y_ * z, cos_x_ * v.y - sin_x_ * v.z, cos_y_ * z - sin_y_ * v.x};
  }
  /// Returns the z axis of the camera frame, the normal of the sensor, in the lens frame.
  Vector3<T> normal() const { return {-sin_y_, cos_y_ * sin_x_, cos_y_ * cos_x_}; }

 private:
  T cos_x_, sin_x_, cos_y_, sin_y_;
};

/// Returns the displacement of the ideal image point (x, y) by distortion, all in mm in the lens
/// frame (Brown-Conrady; paper, section 2.1). At the magnification m, which is negative, the first
/// order of the radial distortion is Q1 + Q1_m |m|.
template <typename T>
Vector2<T> distortion(const MainLens<T>& lens, const T& magnification, const T& x, const T& y) {
  const T* q = lens.radial;
  const T* t = lens.tangential;
  const T r2 = x * x + y * y;
  const T first = q[0] - lens.radial_growth * magnification;
  const T radial = r2 * (first + r2 * (q[1] + r2 * q[2]));
  const T xy = 2.0 * x * y;
  return {x * radial + t[0] * (r2 + 2.0 * x * x) + t[1] * xy,
          y * radial + t[1] * (r2 + 2.0 * y * y) + t[0] * xy};
}

/// Returns p', the image of a point through the main lens, both in the lens frame: K(F) and the
/// distortion of Eq. (completemodel), and the field curvature. Returns no value if the point is not
/// beyond the focal plane.
template <typename T>
std::optional<Vector3<T>> image_along_axis(const MainLens<T>& lens, const Vector3<T>& point) {
  const T beyond_focus = point.z - lens.focal_length;
  if (!(beyond_focus > 0.0)) return std::nullopt;
  const T magnification = -lens.focal_length / beyond_focus;
  const T x = magnification * point.x;
  const T y = magnification * point.y;
  const Vector2<T> shift = distortion(lens, magnification, x, y);
  const T curvature = lens.field_curvature - lens.field_curvature_growth * magnification;
  return Vector3<T>{x + shift.x, y + shift.y,
                    magnification * point.z + curvature * (x * x + y * y)};
}

/// Returns p', the image of a point through the main lens, both in the camera frame, like
/// `image_along_axis`.
template <typename T>
std::optional<Vector3<T>> main_lens_image(const MainLens<T>& lens, const Vector3<T>& point) {
  const LensFrame<T> frame(lens);
  const std::optional<Vector3<T>> image = image_along_axis(lens, frame.of_camera(point));
  if (!image) return std::nullopt;
  return frame.to_camera(*image);
}

/// Returns the pupil magnification p = 1 + e_z/F, the ratio of the diameters of exit pupil and
/// entrance pupil. One is the image of the other, so that by Newton's equation the exit pupil lies
/// pF before the rear focal point z = -F.
template <typename T>
T pupil_magnification(const MainLens<T>& lens, const ExitPupil<T>& pupil) {
  return 1.0 + pupil.z / lens.focal_length;
}

/// Returns |m| = d p F / 2(D + e_z), mm: the slope of the radius of a micro-image over 1/N. With
/// the pupil in the lens it is dF/2D, Eq. (miradiusfnumber); the entrance pupil has the diameter
/// F/N.
template <typename T>
T micro_image_slope(const MainLens<T>& lens, const ExitPupil<T>& pupil,
                    const MicroLensArray<T>& mla) {
  return 0.5 * mla.mla_to_sensor * pupil_magnification(lens, pupil) * lens.focal_length /
         (mla.lens_to_mla + pupil.z);
}

/// Returns q'_i = dC d / 2 f_i, mm: the part of the blur radius that depends on the lens type and
/// not on the virtual depth, Eq. (radiusfinal). If the pitches differ, dC is their geometric mean.
template <typename T>
T blur_intercept(const MicroLensArray<T>& mla, const T& focal_length) {
  using std::sqrt;
  return 0.5 * mla.pitch * sqrt(mla.pitch_ratio) * mla.mla_to_sensor / focal_length;
}

/// Returns the tilt gradient of the array with respect to the sensor, as visible in micro-images:
/// the gradient of ln d along u and v, 1/mm of the sensor. The normal of the array is Rz Ry Rx e_z;
/// u and v are opposite to x and y; micro-images lie further apart than their micro-lenses.
template <typename T>
Vector2<T> tilt_gradient(const ExitPupil<T>& pupil, const MicroLensArray<T>& mla) {
  using std::cos;
  using std::sin;
  const Vector3<T>& angle = mla.rotation;
  const T cx = cos(angle.x), cy = cos(angle.y), cz = cos(angle.z);
  const T sx = sin(angle.x), sy = sin(angle.y), sz = sin(angle.z);
  const T to_pupil = mla.lens_to_mla + pupil.z;
  const T scale = to_pupil / ((to_pupil + mla.mla_to_sensor) * mla.mla_to_sensor * cy * cx);
  return {scale * (cz * sy * cx + sz * sx), scale * (sz * sy * cx - cz * sx)};
}

/// Geometry of micro-lenses and sensor, without the main lens. Quantities that do not depend on the
/// observation are computed once.
template <typename T>
class ArrayOptics {
 public:
  ArrayOptics(const MicroLensArray<T>& mla, double pixel_size)
      : mla_(mla),
        pixels_per_mm_(1.0 / pixel_size),
        sensor_z_(-(mla.lens_to_mla + mla.mla_to_sensor)) {
    // Radius of a micro-lens in pixels. Its diameter is assumed to be the distance between
    // neighbours (paper, section 2.1); if the two pitches differ, their geometric mean.
    using std::sqrt;
    half_diameter_px_ = mla.pitch * sqrt(mla.pitch_ratio) * (0.5 * pixels_per_mm_);
    set_array_axes();
  }

  /// Returns C, the centre of a micro-lens in the camera frame. The lattice is opposite to x and y
  /// because the indices grow with the pixels.
  Vector3<T> micro_lens_center(const Node& node) const {
    return {axis_x_.x * node.x + axis_y_.x * node.y + mla_.offset[0],
            axis_x_.y * node.x + axis_y_.y * node.y + mla_.offset[1],
            axis_x_.z * node.x + axis_y_.z * node.y - mla_.lens_to_mla};
  }

  /// Returns the distance between neighbouring micro-image centres without tilt, px,
  /// Eq. (mlinterdist) with distances from the exit pupil: Delta C (D + e_z + d)/(D + e_z). If the
  /// pitches along u and v differ, Delta C is their geometric mean.
  T micro_image_pitch(const ExitPupil<T>& pupil) const {
    return 2.0 * half_diameter_px_ * ((pupil.z - sensor_z_) / (pupil.z + mla_.lens_to_mla));
  }

  /// Returns -delta/a, the scale at which the sensor shows an image p' seen through a micro-lens
  /// with the centre C. Returns no value if p' lies in the plane of the micro-lens.
  std::optional<T> image_scale(const Vector3<T>& image, const Vector3<T>& center) const {
    const T a = image.z - center.z;
    if (a == 0.0) return std::nullopt;
    return (sensor_z_ - center.z) / a;
  }

  /// Returns (u, v), where the straight ray from p' through C meets the sensor; `scale` is their
  /// `image_scale`.
  Pixel<T> through_micro_lens(const Vector3<T>& image, const Vector3<T>& center,
                              const T& scale) const {
    return {to_u(center.x + scale * (image.x - center.x)),
            to_v(center.y + scale * (image.y - center.y))};
  }

  /// Returns rho, the signed blur radius, Eq. (blurradius), with `scale` = -delta/a
  /// (`image_scale`): rho = dC/(2s) delta (1/f - 1/a - 1/delta) = dC/(2s) (delta/f - delta/a - 1).
  T blur_radius(const Vector3<T>& center, const T& scale, const T& inverse_focal_length) const {
    return half_diameter_px_ * ((center.z - sensor_z_) * inverse_focal_length + scale - 1.0);
  }

  /// Returns 1/nu for the blur radius rho (px): the inverse of `blur_radius`. It is 0 for an image
  /// at infinity.
  T inverse_depth_of_blur(const Vector3<T>& center, const T& rho,
                          const T& inverse_focal_length) const {
    return rho / half_diameter_px_ - (center.z - sensor_z_) * inverse_focal_length + 1.0;
  }

  /// Returns the position of a pixel in the camera frame, mm.
  Vector3<T> on_sensor(const Pixel<T>& pixel) const {
    return {(mla_.principal_point[0] - pixel.u) / pixels_per_mm_,
            (mla_.principal_point[1] - pixel.v) / pixels_per_mm_, sensor_z_};
  }

  /// Returns z of the sensor in the camera frame, mm.
  const T& sensor_z() const { return sensor_z_; }

  /// Returns the pixel size s, mm.
  double pixel_size() const { return 1.0 / pixels_per_mm_; }

  /// Returns the radius of a micro-lens, mm.
  T micro_lens_radius() const { return half_diameter_px_ / pixels_per_mm_; }

  /// Returns the centre of a micro-image, where the ray from the centre P of the exit pupil through
  /// the centre C of the micro-lens meets the sensor. It is finite if the micro-lens lies behind
  /// the pupil.
  Pixel<T> micro_image_center(const LensFrame<T>& frame, const ExitPupil<T>& pupil,
                              const Node& node) const {
    const Vector3<T> center = micro_lens_center(node);
    const Vector3<T> origin = frame.to_camera(pupil.seen_from(frame.of_camera(center)));
    const T scale = (sensor_z_ - origin.z) / (center.z - origin.z);
    return {to_u(origin.x + scale * (center.x - origin.x)),
            to_v(origin.y + scale * (center.y - origin.y))};
  }

 private:
  T to_u(const T& x) const { return mla_.principal_point[0] - x * pixels_per_mm_; }
  T to_v(const T& y) const { return mla_.principal_point[1] - y * pixels_per_mm_; }

  // These are the first two columns of Rz Ry Rx, times minus the pitch.
  void set_array_axes() {
    using std::cos;
    using std::sin;
    const Vector3<T>& angle = mla_.rotation;
    const T cx = cos(angle.x), cy = cos(angle.y), cz = cos(angle.z);
    const T sx = sin(angle.x), sy = sin(angle.y), sz = sin(angle.z);
    const T step_x = -mla_.pitch;
    const T step_y = -mla_.pitch * mla_.pitch_ratio;
    axis_x_ = {step_x * cz * cy, step_x * sz * cy, -step_x * sy};
    axis_y_ = {step_y * (cz * sy * sx - sz * cx), step_y * (sz * sy * sx + cz * cx),
               step_y * cy * sx};
  }

  MicroLensArray<T> mla_;
  double pixels_per_mm_;
  T sensor_z_;
  T half_diameter_px_;
  Vector3<T> axis_x_;
  Vector3<T> axis_y_;
};

/// Optics between object space and sensor.
template <typename T>
struct Optics {
  MainLens<T> main_lens;
  ArrayOptics<T> array;
  T inverse_focal_lengths[kMaxLensTypes]{};  ///< 1/f of every lens type, mm^-1
  bool has_blur;                             ///< false for an array of pinholes

  /// Creates the optics. `focal_lengths` has `lens_types` values: 0 (then the pointer may be null)
  /// to `kMaxLensTypes`. Throws std::invalid_argument for another number.
  Optics(const MainLens<T>& lens, const MicroLensArray<T>& mla, const T* focal_lengths,
         int lens_types, double pixel_size)
      : main_lens(lens), array(mla, pixel_size), has_blur(lens_types > 0) {
    if (lens_types < 0 || lens_types > kMaxLensTypes) {
      throw std::invalid_argument("cameras with " + std::to_string(lens_types) +
                                  " lens types are not supported");
    }
    for (int i = 0; i < lens_types; ++i) inverse_focal_lengths[i] = 1.0 / focal_lengths[i];
  }
};

/// Returns the optics of a camera.
inline Optics<double> optics_of(const Camera& camera) {
  return {camera.main_lens, camera.mla, camera.micro_lens_focal_lengths.data(), camera.lens_types(),
          camera.pixel_size};
}

/// Properties of a micro-lens that the projection needs.
struct MicroLens {
  Node node;
  int lens_type;
};

/// Returns micro-lens (k, l) of a camera.
inline MicroLens micro_lens_of(const Camera& camera, int k, int l) {
  return {camera.lattice.node(k, l), camera.lattice.lens_type(k, l, camera.lens_types())};
}

/// Projects a point whose image p' through the main lens is known, see `main_lens_image`. Returns
/// no value if the point is imaged onto the micro-lens.
template <typename T>
std::optional<Feature<T>> project_image(const Optics<T>& optics, const Vector3<T>& image,
                                        const MicroLens& micro_lens) {
  const Vector3<T> center = optics.array.micro_lens_center(micro_lens.node);
  const std::optional<T> scale = optics.array.image_scale(image, center);
  if (!scale) return std::nullopt;
  const Pixel<T> pixel = optics.array.through_micro_lens(image, center, *scale);
  return Feature<T>{pixel.u, pixel.v,
                    optics.has_blur
                        ? optics.array.blur_radius(
                              center, *scale, optics.inverse_focal_lengths[micro_lens.lens_type])
                        : T(std::numeric_limits<double>::quiet_NaN())};
}

/// Projects a point in the camera frame (mm). Returns no value if the model is not defined: for a
/// point within the focal length, or imaged onto the micro-lens.
template <typename T>
std::optional<Feature<T>> project(const Optics<T>& optics, const Vector3<T>& point,
                                  const MicroLens& micro_lens) {
  const std::optional<Vector3<T>> image = main_lens_image(optics.main_lens, point);
  return image ? project_image(optics, *image, micro_lens) : std::nullopt;
}

/// Projects a board point (mm) through micro-lens (k, l), in one call and with checks. Returns no
/// value if the model is not defined, as above, for a micro-lens that the array does not have, for
/// numbers that are not finite, and for points so far off the axis that distortion turns back.
/// Throws std::invalid_argument if the camera is not valid.
PLENOCAL_API std::optional<Feature<double>> project(const Camera& camera,
                                                    const Pose& camera_from_board,
                                                    const Vector3<double>& board_point, int k,
                                                    int l);

/// Returns the micro-image centre of micro-lens (k, l), which may lie outside the array. Throws
/// std::invalid_argument if the camera is not valid.
PLENOCAL_API Pixel<double> project_center(const Camera& camera, int k, int l);

}  // namespace plenocal
