// Back-projection from pixels of a whole camera into space: micro-images, rays and metric points.
#pragma once

#include <array>
#include <cstddef>
#include <limits>
#include <optional>
#include <vector>

#include "plenocal/inverse.hpp"
#include "plenocal/loss.hpp"

namespace plenocal {

/// Pixel of micro-image (k, l).
struct MicroPixel {
  int k, l;
  Pixel<double> pixel;  ///< px, in the raw image
};

/// Micro-image to which a pixel belongs.
struct MicroImage {
  int k, l;
  Pixel<double> center;  ///< px
  double distance;       ///< distance of the pixel from the centre, px
};

/// Point in space that is seen once: in micro-image (k, l), at a virtual depth.
struct VirtualPoint {
  MicroPixel at;
  double virtual_depth;  ///< nu: distance of its image behind the array in units of d
  /// sigma of u, v (px) and nu; 0 for exact values.
  std::array<double, 3> std_dev{};
};

/// Observation of a point through a micro-lens.
struct Sighting {
  int k, l;
  Feature<double> observed;  ///< px
  /// sigma of u, v and rho, px; rho is not used if its sigma is infinite.
  Feature<double> std_dev{1.0, 1.0, std::numeric_limits<double>::infinity()};
  double correlation = 0.0;  ///< correlation of the errors of u and v, between -1 and 1
};

/// Point in the camera frame, mm.
struct MetricPoint {
  Vector3<double> point;
  std::array<double, 9> covariance{};  ///< covariance of x, y, z, row by row, mm^2
  /// Sum of squared residuals over sigma of a triangulated point, weighted by the loss, and the
  /// number of residuals beyond three. Their sums over many points show the error of sigma.
  double chi_square = 0.0;
  int freedom = 0;
};

/// Back-projection through a camera. Quantities that do not depend on the pixel are computed once;
/// all functions may be called by several threads.
///
/// There is no result if the camera sees nothing: outside the array, within the focal length, far
/// outside the image where distortion has no inverse, at the virtual depth 0 (on the micro-lens),
/// and for numbers that are not finite. An image before the array has a negative virtual depth, an
/// image before the sensor one below 1.
class PLENOCAL_API BackProjection {
 public:
  /// Throws std::invalid_argument if the camera is not valid.
  explicit BackProjection(const Camera& camera);

  const Camera& camera() const { return camera_; }

  /// Returns the micro-image whose micro-lens is nearest to the point where the ray from the centre
  /// of the exit pupil to the pixel meets the array. Returns no value outside the array, and off
  /// the sensor if its size is known.
  std::optional<MicroImage> micro_image_at(const Pixel<double>& pixel) const;

  /// Returns the radius of micro-images, px: half the distance between neighbours. Pixels further
  /// from all centres lie in the gaps between micro-images.
  double micro_image_radius() const { return radius_; }

  /// Returns `plenocal::ray_behind`, between micro-lens and main lens. `aperture` is the point on
  /// the micro-lens, in radii from its centre.
  std::optional<Ray<double>> ray_behind(const MicroPixel& at,
                                        const Vector2<double>& aperture = {0.0, 0.0}) const;

  /// Returns `plenocal::object_ray`, in space, with its origin at the distance z, mm.
  std::optional<Ray<double>> object_ray(const MicroPixel& at, double z) const;

  /// Returns the point whose image lies at a virtual depth, with its covariance. Throws
  /// std::invalid_argument if a sigma is negative or not finite.
  std::optional<MetricPoint> point(const VirtualPoint& seen) const;

  /// Returns the point for a pixel of a total-focus image of other software. (u, v) of the pixel is
  /// the position of the image p' across the axis, and nu its distance from the plane of the array,
  /// parallel to the axis. (k, l) is not used.
  std::optional<MetricPoint> focused_point(const VirtualPoint& seen) const;

  /// Triangulates a point seen through several micro-lenses, by weighted least squares of its
  /// features, with the covariance that follows from their sigma. A loss on |r / sigma| of each
  /// sighting makes this robust to outliers. Errors along the depth that the sightings share do not
  /// average out: sigma of the point's rho (px) is at least `rho_std_dev`, with the covariance of a
  /// point with such an uncertain depth. Nothing if the sightings do not determine the point: fewer
  /// than two, or all from one position.
  std::optional<MetricPoint> triangulate(const std::vector<Sighting>& sightings,
                                         const Loss& loss = {}, double rho_std_dev = 0.0) const;

  /// Returns the virtual depth of a point in space (mm) for a micro-lens.
  std::optional<double> virtual_depth(int k, int l, const Vector3<double>& point) const;

  /// Returns the virtual depth for a blur radius (px); nothing for an array of pinholes.
  std::optional<double> virtual_depth_of_blur(int k, int l, double rho) const;

  /// Computes the chief rays of n pixels, each in the micro-image to which it belongs, at the
  /// distance z (mm). Values are NaN if there is no ray. Returns the number of rays.
  std::size_t object_rays(const Pixel<double>* pixels, std::size_t n, double z,
                          Ray<double>* rays) const;

  /// Computes `point` for n points. Values are NaN if there is no point. Returns the number of
  /// points.
  std::size_t points(const VirtualPoint* seen, std::size_t n, MetricPoint* points) const;

 private:
  std::optional<MicroLens> micro_lens(int k, int l) const;

  Camera camera_;
  Optics<double> optics_;
  LensFrame<double> frame_;
  double radius_;
  // Plane of the array: a point, the steps to the next column and row, and the normal.
  Vector3<double> origin_, step_x_, step_y_, normal_;
};

}  // namespace plenocal
