// The forward model: board point -> BAP feature (u, v, rho), and micro-lens -> micro-image centre.
//
// This header is the only projection model of the library. It is a template so that the same code
// gives values (T = double) and derivatives (T = ceres::Jet). Equation names are those of the paper
// "Blur Aware Calibration of Multi-Focus Plenoptic Camera" (CVPR 2020).
#pragma once

#include <ceres/rotation.h>

#include "plenocal/camera.hpp"

namespace plenocal {

/// A point of space, mm.
template <typename T>
struct Point {
  T x, y, z;
};

/// A point of the raw image, px.
template <typename T>
struct Pixel {
  T u, v;
};

/// A blur aware plenoptic feature: position and signed blur radius, px.
template <typename T>
struct Feature {
  T u, v, rho;
};

/// camera_from_board: angle-axis rotation (rad) followed by a translation (mm).
struct Pose {
  static constexpr int kSize = 6;
  std::array<double, 3> rotation{};
  std::array<double, 3> translation{};
};

/// A pose as the solver's parameter block, and back.
inline std::array<double, Pose::kSize> pose_block(const Pose& pose) {
  const auto &r = pose.rotation, &t = pose.translation;
  return {r[0], r[1], r[2], t[0], t[1], t[2]};
}
inline Pose pose_from_block(const std::array<double, Pose::kSize>& b) {
  return {{b[0], b[1], b[2]}, {b[3], b[4], b[5]}};
}

/// The motion of a pose block, its rotation matrix worked out once for many points.
template <typename T>
class Motion {
 public:
  explicit Motion(const T* block) : translation_{block[3], block[4], block[5]} {
    ceres::AngleAxisToRotationMatrix(block, ceres::RowMajorAdapter3x3(rotation_));
  }
  Point<T> operator()(const std::array<double, 3>& p) const {
    const auto row = [&](int i) {
      return rotation_[3 * i] * p[0] + rotation_[3 * i + 1] * p[1] + rotation_[3 * i + 2] * p[2] +
             translation_[i];
    };
    return {row(0), row(1), row(2)};
  }

 private:
  T rotation_[9];
  T translation_[3];
};

/// The optics between object space and sensor, everything that does not depend on the observation
/// worked out once.
template <typename T>
class Optics {
 public:
  Optics(const MainLens<T>& lens, const MicroLensArray<T>& mla, double pixel_size)
      : lens_(lens),
        mla_(mla),
        pixels_per_mm_(1.0 / pixel_size),
        sensor_z_(-(mla.lens_to_mla + mla.mla_to_sensor)) {
    // Half a micro-lens in pixels. The diameter of a micro-lens is taken to be the distance of
    // its neighbours (paper, section 2.1); where the two pitches differ, their geometric mean.
    using std::sqrt;
    half_diameter_px_ = mla.pitch * sqrt(mla.pitch_ratio) * (0.5 * pixels_per_mm_);
    set_array_axes();
  }

  /// p': image of a point of the camera frame through the main lens, K(F) and the distortion of
  /// Eq. (completemodel). False when the point is not beyond the focal plane.
  bool main_lens_image(const Point<T>& p, Point<T>* image) const {
    const T beyond_focus = p.z - lens_.focal_length;
    if (!(beyond_focus > 0.0)) return false;
    const T magnification = -lens_.focal_length / beyond_focus;
    const T x = magnification * p.x;
    const T y = magnification * p.y;
    const T* q = lens_.radial;
    const T* t = lens_.tangential;
    const T r2 = x * x + y * y;
    const T radial = r2 * (q[0] + r2 * (q[1] + r2 * q[2]));
    const T xy = 2.0 * x * y;
    image->x = x + x * radial + t[0] * (r2 + 2.0 * x * x) + t[1] * xy;
    image->y = y + y * radial + t[1] * (r2 + 2.0 * y * y) + t[0] * xy;
    image->z = magnification * p.z;
    return true;
  }

  /// C: centre of a micro-lens in the camera frame. The lattice runs against x and y because the
  /// indices grow with the pixels.
  Point<T> micro_lens_center(const Node& node) const {
    return {axis_x_[0] * node.x + axis_y_[0] * node.y + mla_.offset[0],
            axis_x_[1] * node.x + axis_y_[1] * node.y + mla_.offset[1],
            axis_x_[2] * node.x + axis_y_[2] * node.y - mla_.lens_to_mla};
  }

  /// (u, v) and `scale` = -delta/a: the straight ray from p' through C met with the sensor plane.
  /// False when p' lies in the plane of the micro-lens.
  bool through_micro_lens(const Point<T>& image, const Point<T>& center, Pixel<T>* pixel,
                          T* scale) const {
    const T a = image.z - center.z;
    if (a == 0.0) return false;
    *scale = (sensor_z_ - center.z) / a;
    pixel->u = to_u(center.x + *scale * (image.x - center.x));
    pixel->v = to_v(center.y + *scale * (image.y - center.y));
    return true;
  }

  /// rho: signed blur radius, Eq. (blurradius), with delta/a known from `through_micro_lens`:
  /// rho = dC/(2s) delta (1/f - 1/a - 1/delta) = dC/(2s) (delta/f - delta/a - 1).
  T blur_radius(const Point<T>& center, const T& scale, const T& inverse_focal_length) const {
    return half_diameter_px_ * ((center.z - sensor_z_) * inverse_focal_length + scale - 1.0);
  }

  /// Centre of the micro-image of a micro-lens: the ray from O through C met with the sensor.
  Pixel<T> micro_image_center(const Point<T>& center) const {
    const T scale = sensor_z_ / center.z;
    return {to_u(scale * center.x), to_v(scale * center.y)};
  }

 private:
  T to_u(const T& x) const { return mla_.principal_point[0] - x * pixels_per_mm_; }
  T to_v(const T& y) const { return mla_.principal_point[1] - y * pixels_per_mm_; }

  // First two columns of Rz Ry Rx, times minus the pitch.
  void set_array_axes() {
    using std::cos;
    using std::sin;
    const T* angle = mla_.rotation;
    const T cx = cos(angle[0]), cy = cos(angle[1]), cz = cos(angle[2]);
    const T sx = sin(angle[0]), sy = sin(angle[1]), sz = sin(angle[2]);
    const T step_x = -mla_.pitch;
    const T step_y = -mla_.pitch * mla_.pitch_ratio;
    axis_x_[0] = step_x * cz * cy;
    axis_x_[1] = step_x * sz * cy;
    axis_x_[2] = -step_x * sy;
    axis_y_[0] = step_y * (cz * sy * sx - sz * cx);
    axis_y_[1] = step_y * (sz * sy * sx + cz * cx);
    axis_y_[2] = step_y * cy * sx;
  }

  MainLens<T> lens_;
  MicroLensArray<T> mla_;
  double pixels_per_mm_;
  T sensor_z_;
  T half_diameter_px_;
  T axis_x_[3];
  T axis_y_[3];
};

/// Feature of a board point seen through micro-lens (k, l). False where the model is not defined
/// (point within the focal length, or imaged onto the micro-lens). rho is 0 for a pinhole array.
bool project(const Camera& camera, const Pose& camera_from_board,
             const std::array<double, 3>& board_point, int k, int l, Feature<double>* feature);

/// Micro-image centre of micro-lens (k, l).
Pixel<double> project_center(const Camera& camera, int k, int l);

}  // namespace plenocal
