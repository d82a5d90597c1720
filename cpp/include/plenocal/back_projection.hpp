// From pixels of a whole camera back into space: micro-images, rays and metric points.
#pragma once

#include <array>
#include <cstddef>
#include <limits>
#include <optional>
#include <vector>

#include "plenocal/inverse.hpp"
#include "plenocal/loss.hpp"

namespace plenocal {

/// A pixel of micro-image (k, l).
struct MicroPixel {
  int k, l;
  Pixel<double> pixel;  ///< px, in the raw image
};

/// The micro-image that a pixel belongs to.
struct MicroImage {
  int k, l;
  Pixel<double> center;  ///< px
  double distance;       ///< of the pixel from the centre, px
};

/// A point in space that is seen once: in micro-image (k, l), at a virtual depth.
struct VirtualPoint {
  MicroPixel at;
  double virtual_depth;  ///< nu: distance of its image behind the array in units of d
  /// sigma of u, v (px) and nu; 0 for what is known.
  std::array<double, 3> std_dev{};
};

/// A point seen through a micro-lens.
struct Sighting {
  int k, l;
  Feature<double> observed;  ///< px
  /// px; rho is not used where its sigma is infinite.
  Feature<double> std_dev{1.0, 1.0, std::numeric_limits<double>::infinity()};
  double correlation = 0.0;  ///< of the errors of u and v, between -1 and 1
};

/// A point in the camera frame, mm.
struct MetricPoint {
  Vector3<double> point;
  std::array<double, 9> covariance{};  ///< of x, y, z, row by row, mm^2
  /// Of a triangulated point: the sum of squared residuals over sigma, weighted by the loss, and
  /// the number of residuals beyond three. Their sums over many points say by how much sigma is
  /// wrong.
  double chi_square = 0.0;
  int freedom = 0;
};

/// Back-projection through a camera. What does not depend on the pixel is computed once; all
/// functions may be called by several threads.
///
/// Where the camera sees nothing, there is no result: outside the array, within the focal length,
/// far outside the image where distortion has no inverse, at the virtual depth 0 (on the
/// micro-lens), and for numbers that are not finite. A negative virtual depth is that of an image
/// before the array, and one below 1 that of an image before the sensor.
class PLENOCAL_API BackProjection {
 public:
  /// Throws std::invalid_argument if the camera is not valid.
  explicit BackProjection(const Camera& camera);

  const Camera& camera() const { return camera_; }

  /// The micro-image whose micro-lens is the nearest where the ray from the middle of the exit
  /// pupil to the pixel meets the array. None outside the array, and off the sensor if its size is
  /// known.
  std::optional<MicroImage> micro_image_at(const Pixel<double>& pixel) const;

  /// Radius of micro-images, px: half the distance between neighbours. Pixels further from all
  /// centres lie in the gaps between them.
  double micro_image_radius() const { return radius_; }

  /// `plenocal::ray_behind`: between micro-lens and main lens. The aperture is the place on the
  /// micro-lens, in radii off its centre.
  std::optional<Ray<double>> ray_behind(const MicroPixel& at,
                                        const Vector2<double>& aperture = {0.0, 0.0}) const;

  /// `plenocal::object_ray`: in space, with its origin at the distance z, mm.
  std::optional<Ray<double>> object_ray(const MicroPixel& at, double z) const;

  /// The point whose image lies at a virtual depth, with its covariance. Throws
  /// std::invalid_argument if a sigma is negative or not finite.
  std::optional<MetricPoint> point(const VirtualPoint& seen) const;

  /// The point whose image lies at a virtual depth straight behind a pixel of a total-focus image,
  /// as other software renders it: (u, v) of the pixel is where the image p' lies across the axis,
  /// and nu its distance from the plane of the array. (k, l) is not used.
  std::optional<MetricPoint> focused_point(const VirtualPoint& seen) const;

  /// The point that several micro-lenses see, by weighted least squares of its features, with the
  /// covariance that their sigma leads to. A loss on |r / sigma| of each sighting withstands false
  /// ones. Errors along the depth that sightings share do not average out: sigma of the rho (px)
  /// that belongs to the point is at least `rho_std_dev`, the covariance being that of a point
  /// whose depth is known less well. Nothing if the sightings do not determine the point: fewer
  /// than two, or all from one place.
  std::optional<MetricPoint> triangulate(const std::vector<Sighting>& sightings,
                                         const Loss& loss = {}, double rho_std_dev = 0.0) const;

  /// The virtual depth of a point in space (mm) for a micro-lens.
  std::optional<double> virtual_depth(int k, int l, const Vector3<double>& point) const;

  /// The virtual depth that a blur radius (px) stands for; nothing for an array of pinholes.
  std::optional<double> virtual_depth_of_blur(int k, int l, double rho) const;

  /// Chief rays of n pixels, each of the micro-image that it belongs to, at the distance z (mm).
  /// Values are not numbers where there is none. Returns how many there are.
  std::size_t object_rays(const Pixel<double>* pixels, std::size_t n, double z,
                          Ray<double>* rays) const;

  /// `point` of n points. Values are not numbers where there is none. Returns how many there are.
  std::size_t points(const VirtualPoint* seen, std::size_t n, MetricPoint* points) const;

 private:
  std::optional<MicroLens> micro_lens(int k, int l) const;

  Camera camera_;
  Optics<double> optics_;
  double radius_;
  // Of the plane of the array: a point, the steps to the next column and row, and the normal.
  Vector3<double> origin_, step_x_, step_y_, normal_;
};

}  // namespace plenocal
