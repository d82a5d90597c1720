// Single points in space: the micro-lenses that see them, and the accuracy of their reconstruction.
#pragma once

#include <array>
#include <vector>

#include "plenocal/matrix.hpp"
#include "plenocal/projection.hpp"

namespace plenocal {

/// Micro-lens (k, l) of the array.
struct MicroLensIndex {
  int k, l;
};

/// Returns the micro-lenses in whose micro-image a point of the camera frame (mm) is seen at least
/// `margin` px inside the edge, in order of l, then k. Micro-images are discs with the diameter
/// `ArrayOptics::micro_image_pitch`. Empty if the point is not finite or not beyond the focal
/// plane. The time grows with the number of micro-lenses found, not with the size of the array,
/// unless the array is tilted so far that it reaches the sensor.
///
/// Throws std::invalid_argument if the camera is not valid or the margin negative or not finite.
PLENOCAL_API std::vector<MicroLensIndex> micro_lenses_seeing(const Camera& camera,
                                                             const Vector3<double>& point,
                                                             double margin);

/// Sensitivity of the reconstruction of a point by weighted least squares from its features (u, v
/// and rho; u and v alone for an array of pinholes) to errors of the camera and of the features.
///
/// Values are NaN if fewer than two micro-lenses see the point, or if the features do not determine
/// it.
struct PointSensitivity {
  int micro_lenses = 0;  ///< number of micro-lenses that see the point
  /// 3 x number of intrinsics, mm per unit of the parameter: derivative of the reconstructed x, y,
  /// z by every parameter in the order of `for_each_parameter`, for fixed features.
  Matrix by_intrinsics;
  /// 3 x 3 row by row, mm^2: covariance of x, y, z due to the noise of the features.
  std::array<double, 9> covariance{};
};

/// Computes the sensitivity of a point of the camera frame (mm), seen without error by all of
/// `micro_lenses_seeing`. `std_dev` is the noise of its features, px; the noise of rho is not used
/// for an array of pinholes, and is infinite if rho is not used. The n values of rho come from a
/// single measurement: each has sqrt(n) times its noise, so that together they have the weight of
/// one.
///
/// Throws std::invalid_argument like `micro_lenses_seeing`, and if the noise is not positive and
/// finite.
PLENOCAL_API PointSensitivity point_sensitivity(const Camera& camera, const Vector3<double>& point,
                                                const Feature<double>& std_dev, double margin);

}  // namespace plenocal
