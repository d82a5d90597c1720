#include "plenocal/back_projection.hpp"

#include <ceres/jet.h>

#include <Eigen/Dense>
#include <algorithm>

#include "checks.hpp"

namespace plenocal {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr int kPoint = 3;
using Jet = ceres::Jet<double, kPoint>;

template <typename T>
Vector3<T> difference(const Vector3<T>& a, const Vector3<T>& b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}

double dot(const Vector3<double>& a, const Vector3<double>& b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}

Vector3<double> cross(const Vector3<double>& a, const Vector3<double>& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

bool is_finite(const Vector3<double>& v) {
  return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z);
}

/// Returns true if a ray has an origin and a direction: squares of lengths such as 1e-200 mm are 0.
bool is_ray(const Ray<double>& ray) {
  constexpr double rounding = 1e-6;
  return is_finite(ray.origin) && std::abs(dot(ray.direction, ray.direction) - 1.0) < rounding;
}

bool is_finite(const Pixel<double>& p) { return std::isfinite(p.u) && std::isfinite(p.v); }

Vector3<Jet> constant(const Vector3<double>& v) { return {Jet(v.x), Jet(v.y), Jet(v.z)}; }

// Returns the same part of the camera as a constant, for derivatives by other variables.
template <template <typename> class Part>
Part<Jet> constant(const Part<double>& part) {
  const auto values = to_block(part);
  std::array<Jet, parameter_count<Part>()> block;
  for (std::size_t i = 0; i < block.size(); ++i) block[i] = Jet(values[i]);
  return from_block<Part>(block.data());
}

// Computes C S C' for a point that depends on three variables with the covariance S.
MetricPoint with_covariance(const Vector3<Jet>& point, const Eigen::Matrix3d& covariance) {
  Eigen::Matrix3d slopes;
  slopes << point.x.v.transpose(), point.y.v.transpose(), point.z.v.transpose();
  MetricPoint result{{point.x.a, point.y.a, point.z.a}};
  Eigen::Map<Eigen::Matrix3d>(result.covariance.data()) = slopes * covariance * slopes.transpose();
  return result;
}

// Returns a point with its covariance, or nothing if numbers are not finite.
std::optional<MetricPoint> finite(const MetricPoint& point) {
  const auto& c = point.covariance;
  const bool all = is_finite(point.point) &&
                   std::all_of(c.begin(), c.end(), [](double x) { return std::isfinite(x); });
  return all ? std::optional(point) : std::nullopt;
}

// Returns the point for an image p' that depends on three variables with these sigma.
std::optional<MetricPoint> imaged(const MainLens<double>& lens, const Vector3<Jet>& image,
                                  const std::array<double, 3>& std_dev) {
  const std::optional<Vector3<Jet>> point = object_point(constant(lens), image);
  if (!point || !is_finite(Vector3<double>{point->x.a, point->y.a, point->z.a})) {
    return std::nullopt;
  }
  const Eigen::Vector3d std_devs(std_dev[0], std_dev[1], std_dev[2]);
  return finite(with_covariance(*point, std_devs.cwiseAbs2().asDiagonal()));
}

// Information of a sighting about the image p' of a point: residuals over sigma and their
// derivatives.
class Sight {
 public:
  Sight(const Optics<double>& optics, const MicroLens& micro_lens, const Sighting& sighting)
      : optics_(optics),
        sighting_(sighting),
        lens_type_(micro_lens.lens_type),
        center_(optics.array.micro_lens_center(micro_lens.node)),
        uses_rho_(optics.has_blur && sighting.std_dev.rho < HUGE_VAL),
        rest_(std::sqrt(1.0 - sighting.correlation * sighting.correlation)) {}

  // Adds two equations of the line on which p' lies: (p' - C) x (S - C) = 0, divided by the
  // distance to the sensor.
  void add_lines(Eigen::Matrix3d* normal, Eigen::Vector3d* right) const {
    const Vector3<double> line =
        difference(optics_.array.on_sensor({sighting_.observed.u, sighting_.observed.v}), center_);
    const Eigen::Vector3d along_x(1.0, 0.0, -line.x / line.z), along_y(0.0, 1.0, -line.y / line.z);
    const Eigen::Vector3d center(center_.x, center_.y, center_.z);
    for (const Eigen::Vector3d& row : {along_x, along_y}) {
      *normal += row * row.transpose();
      *right += row * row.dot(center);
    }
  }

  // Adds the normal equations of a Gauss-Newton step at p', and the sum of weighted squares.
  // Returns false if p' lies on the micro-lens.
  bool add_features(const Vector3<double>& image, const Loss& loss, Eigen::Matrix3d* normal,
                    Eigen::Vector3d* right, double* squares) const {
    const double a = image.z - center_.z;
    const auto scale = optics_.array.image_scale(image, center_);
    if (!scale) return false;
    const Pixel<double> pixel = optics_.array.through_micro_lens(image, center_, *scale);
    const double per_mm = -*scale / pixel_size();
    const double along_u = (image.x - center_.x) / a, along_v = (image.y - center_.y) / a;
    Eigen::Matrix3d own = Eigen::Matrix3d::Zero();
    Eigen::Vector3d own_right = Eigen::Vector3d::Zero();
    double square = 0.0;
    const auto add = [&](double off, double std_dev, const Eigen::Vector3d& slope) {
      const Eigen::Vector3d row = slope / std_dev;
      own += row * row.transpose();
      own_right += row * (off / std_dev);
      square += off * off / (std_dev * std_dev);
    };
    // v without the part that its correlation with u predicts.
    const auto& sigma = sighting_.std_dev;
    const double off_u = sighting_.observed.u - pixel.u, off_v = sighting_.observed.v - pixel.v;
    const double share = sighting_.correlation * sigma.v / sigma.u;
    const Eigen::Vector3d by_u(per_mm, 0.0, -per_mm * along_u);
    const Eigen::Vector3d by_v(0.0, per_mm, -per_mm * along_v);
    add(off_u, sigma.u, by_u);
    add(off_v - share * off_u, sigma.v * rest_, by_v - share * by_u);
    if (uses_rho_) {
      const double rho =
          optics_.array.blur_radius(center_, *scale, optics_.inverse_focal_lengths[lens_type_]);
      add(sighting_.observed.rho - rho, sighting_.std_dev.rho, {0.0, 0.0, rho_slope(image.z)});
    }
    const double weight = loss_weight(loss, square);
    *normal += weight * own;
    *right += weight * own_right;
    *squares += weight * square;
    return true;
  }

  int residuals() const { return uses_rho_ ? 3 : 2; }

  // Returns the derivative of rho by the position of p' along the axis, px/mm.
  double rho_slope(double z) const {
    const double a = z - center_.z, delta = center_.z - optics_.array.sensor_z();
    return delta / (a * a) * optics_.array.micro_lens_radius() / pixel_size();
  }

 private:
  double pixel_size() const { return optics_.array.pixel_size(); }

  const Optics<double>& optics_;
  const Sighting& sighting_;
  int lens_type_;
  Vector3<double> center_;
  bool uses_rho_;
  double rest_;  // factor on sigma of v if u is known
};

// Computes the inverse of a normal matrix; returns false if it is singular up to rounding.
bool invert(const Eigen::Matrix3d& normal, Eigen::Matrix3d* inverse) {
  constexpr double kRankTolerance = 1e-13;
  const Eigen::Vector3d scale = normal.diagonal().cwiseSqrt().cwiseInverse();
  if (!scale.allFinite()) return false;
  const Eigen::Matrix3d scaled = scale.asDiagonal() * normal * scale.asDiagonal();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(scaled);
  if (!(eigen.eigenvalues()[0] > kRankTolerance)) return false;
  *inverse = scale.asDiagonal() * scaled.inverse() * scale.asDiagonal();
  return inverse->allFinite();
}

// Returns the covariance of an image p' whose position along the axis has at least the sigma
// `least`: as after a less accurate measurement of this position, with the other measurements
// unchanged.
Eigen::Matrix3d with_least_depth(const Eigen::Matrix3d& covariance, double least) {
  const double variance = covariance(2, 2), missing = least * least - variance;
  if (!(missing > 0.0)) return covariance;
  const Eigen::Vector3d along = covariance.col(2) / variance;
  return covariance + missing * along * along.transpose();
}

void require_std_devs(const Sighting& sighting, bool has_blur) {
  require_std_dev(sighting.std_dev.u, "u");
  require_std_dev(sighting.std_dev.v, "v");
  if (has_blur && sighting.std_dev.rho != HUGE_VAL) require_std_dev(sighting.std_dev.rho, "rho");
  if (!(std::abs(sighting.correlation) < 1.0)) {
    reject("the correlation of u and v has to lie between -1 and 1");
  }
}

void require_std_devs(const VirtualPoint& seen) {
  for (double std_dev : seen.std_dev) {
    if (!(std::isfinite(std_dev) && std_dev >= 0.0)) {
      reject(
          "the standard deviations of u, v and the virtual depth have to be finite and not "
          "negative");
    }
  }
}

}  // namespace

BackProjection::BackProjection(const Camera& camera)
    : camera_((validate(camera), camera)),
      optics_(optics_of(camera_)),
      frame_(camera_.main_lens),
      radius_(0.5 * optics_.array.micro_image_pitch(camera_.exit_pupil)),
      origin_(optics_.array.micro_lens_center({0.0, 0.0})),
      step_x_(difference(optics_.array.micro_lens_center({1.0, 0.0}), origin_)),
      step_y_(difference(optics_.array.micro_lens_center({0.0, 1.0}), origin_)),
      normal_(cross(step_x_, step_y_)) {}

std::optional<MicroLens> BackProjection::micro_lens(int k, int l) const {
  if (!camera_.lattice.contains(k, l)) return std::nullopt;
  return micro_lens_of(camera_, k, l);
}

std::optional<MicroImage> BackProjection::micro_image_at(const Pixel<double>& pixel) const {
  if (camera_.width > 0 && camera_.height > 0) {
    const bool is_inside = pixel.u >= -0.5 && pixel.u <= camera_.width - 0.5 && pixel.v >= -0.5 &&
                           pixel.v <= camera_.height - 0.5;
    if (!is_inside) return std::nullopt;
  }
  const Vector3<double> on_sensor = optics_.array.on_sensor(pixel);
  // The place of the pupil depends on where its ray meets the array, which is near the pixel.
  Vector3<double> on_array = on_sensor;
  double along = 0.0;
  for (int i = 0; i < 2; ++i) {
    const Vector3<double> pupil =
        frame_.to_camera(camera_.exit_pupil.seen_from(frame_.of_camera(on_array)));
    const Vector3<double> ray = difference(on_sensor, pupil);
    along = dot(normal_, difference(origin_, pupil)) / dot(normal_, ray);
    on_array = {pupil.x + along * ray.x, pupil.y + along * ray.y, pupil.z + along * ray.z};
  }
  const Vector3<double> there = difference(on_array, origin_);
  const Node node{dot(there, step_x_) / dot(step_x_, step_x_),
                  dot(there, step_y_) / dot(step_y_, step_y_)};
  if (!(along > 0.0 && std::isfinite(node.x) && std::isfinite(node.y))) return std::nullopt;
  const auto [k, l] = camera_.lattice.nearest(node);
  if (!camera_.lattice.contains(k, l)) return std::nullopt;
  const Pixel<double> center =
      optics_.array.micro_image_center(frame_, camera_.exit_pupil, camera_.lattice.node(k, l));
  const double u = pixel.u - center.u, v = pixel.v - center.v;
  return MicroImage{k, l, center, std::sqrt(u * u + v * v)};
}

std::optional<Ray<double>> BackProjection::ray_behind(const MicroPixel& at,
                                                      const Vector2<double>& aperture) const {
  const auto lens = micro_lens(at.k, at.l);
  if (!lens || !is_finite(at.pixel)) return std::nullopt;
  const Ray<double> ray = plenocal::ray_behind(optics_, *lens, at.pixel, aperture);
  return is_ray(ray) ? std::optional(ray) : std::nullopt;
}

std::optional<Ray<double>> BackProjection::object_ray(const MicroPixel& at, double z) const {
  const auto lens = micro_lens(at.k, at.l);
  if (!lens || !is_finite(at.pixel) || !std::isfinite(z)) return std::nullopt;
  const auto ray = plenocal::object_ray(optics_, *lens, at.pixel, z);
  return ray && is_ray(*ray) ? ray : std::nullopt;
}

std::optional<MetricPoint> BackProjection::point(const VirtualPoint& seen) const {
  const auto lens = micro_lens(seen.at.k, seen.at.l);
  if (!lens) return std::nullopt;
  require_std_devs(seen);
  // The image lies on the micro-lens, so that every pixel behind it shows it.
  if (seen.virtual_depth == 0.0) return std::nullopt;
  // These variables give derivatives by u, v and nu.
  const ArrayOptics<Jet> array(constant(camera_.mla), camera_.pixel_size);
  const Vector3<Jet> center = constant(optics_.array.micro_lens_center(lens->node));
  const Pixel<Jet> pixel{Jet(seen.at.pixel.u, 0), Jet(seen.at.pixel.v, 1)};
  return imaged(camera_.main_lens, image_at(array, center, pixel, Jet(seen.virtual_depth, 2)),
                seen.std_dev);
}

std::optional<MetricPoint> BackProjection::focused_point(const VirtualPoint& seen) const {
  require_std_devs(seen);
  if (seen.virtual_depth == 0.0) return std::nullopt;
  // These variables give derivatives by u, v and nu.
  const ArrayOptics<Jet> array(constant(camera_.mla), camera_.pixel_size);
  const Vector3<Jet> on_sensor =
      array.on_sensor({Jet(seen.at.pixel.u, 0), Jet(seen.at.pixel.v, 1)});
  // z of the plane of the array at this pixel.
  const Jet z =
      origin_.z -
      (normal_.x * (on_sensor.x - origin_.x) + normal_.y * (on_sensor.y - origin_.y)) / normal_.z;
  const Jet depth(seen.virtual_depth, 2);
  return imaged(camera_.main_lens, {on_sensor.x, on_sensor.y, z + depth * (on_sensor.z - z)},
                seen.std_dev);
}

std::optional<MetricPoint> BackProjection::triangulate(const std::vector<Sighting>& sightings,
                                                       const Loss& loss, double rho_std_dev) const {
  if (!is_positive(loss.scale)) reject("the scale of the loss has to be positive and finite");
  if (!(rho_std_dev >= 0.0 && rho_std_dev < HUGE_VAL)) {
    reject("sigma of rho has to be 0 or positive, and finite");
  }
  std::vector<Sight> sights;
  int residuals = 0;
  for (const Sighting& sighting : sightings) {
    require_std_devs(sighting, optics_.has_blur);
    const auto lens = micro_lens(sighting.k, sighting.l);
    if (!lens || !is_finite(Pixel<double>{sighting.observed.u, sighting.observed.v}))
      return std::nullopt;
    sights.emplace_back(optics_, *lens, sighting);
    residuals += sights.back().residuals();
  }
  if (sights.size() < 2) return std::nullopt;

  // Gauss-Newton steps start from the image nearest to all lines.
  Eigen::Matrix3d normal = Eigen::Matrix3d::Zero(), inverse;
  Eigen::Vector3d right = Eigen::Vector3d::Zero();
  for (const Sight& sight : sights) sight.add_lines(&normal, &right);
  if (!invert(normal, &inverse)) return std::nullopt;
  Eigen::Vector3d image = inverse * right;
  constexpr int kMaxSteps = 100;  // number of steps with weights that follow the residuals
  double squares = 0.0;
  const double kSettled = loss.kind == LossKind::kNone ? 1e-9 : 1e-6;  // size of a step, in sigma
  bool settled = false;
  for (int i = 0; i < kMaxSteps && !settled; ++i) {
    normal.setZero();
    right.setZero();
    squares = 0.0;
    for (const Sight& sight : sights) {
      if (!sight.add_features({image.x(), image.y(), image.z()}, loss, &normal, &right, &squares)) {
        return std::nullopt;
      }
    }
    if (!invert(normal, &inverse)) return std::nullopt;
    const Eigen::Vector3d step = inverse * right;
    image += step;
    settled = step.dot(normal * step) <= kSettled * kSettled ||
              step.norm() <= std::numeric_limits<double>::epsilon() * image.norm();
  }
  if (!settled) return std::nullopt;
  const Vector3<Jet> variable{Jet(image.x(), 0), Jet(image.y(), 1), Jet(image.z(), 2)};
  const auto point = object_point(constant(camera_.main_lens), variable);
  if (!point) return std::nullopt;
  const double least = rho_std_dev / std::abs(sights.front().rho_slope(image.z()));
  MetricPoint result = with_covariance(*point, with_least_depth(inverse, least));
  result.chi_square = squares;
  result.freedom = residuals - kPoint;
  return finite(result);
}

std::optional<double> BackProjection::virtual_depth(int k, int l,
                                                    const Vector3<double>& point) const {
  const auto lens = micro_lens(k, l);
  const auto image = unfolded_image(optics_.main_lens, point);
  if (!lens || !image) return std::nullopt;
  const double depth =
      virtual_depth_of(optics_.array, optics_.array.micro_lens_center(lens->node), *image);
  return std::isfinite(depth) ? std::optional(depth) : std::nullopt;
}

std::optional<double> BackProjection::virtual_depth_of_blur(int k, int l, double rho) const {
  const auto lens = micro_lens(k, l);
  if (!lens || !optics_.has_blur) return std::nullopt;
  const double depth = plenocal::virtual_depth_of_blur(
      optics_, optics_.array.micro_lens_center(lens->node), lens->lens_type, rho);
  return std::isfinite(depth) ? std::optional(depth) : std::nullopt;
}

std::size_t BackProjection::object_rays(const Pixel<double>* pixels, std::size_t n, double z,
                                        Ray<double>* rays) const {
  if (n > 0 && (pixels == nullptr || rays == nullptr)) reject("there are no pixels or no rays");
  std::size_t found = 0;
  for (std::size_t i = 0; i < n; ++i) {
    const auto at = micro_image_at(pixels[i]);
    const auto ray = at ? object_ray({at->k, at->l, pixels[i]}, z) : std::nullopt;
    rays[i] = ray.value_or(Ray<double>{{kNan, kNan, kNan}, {kNan, kNan, kNan}});
    found += ray.has_value();
  }
  return found;
}

std::size_t BackProjection::points(const VirtualPoint* seen, std::size_t n,
                                   MetricPoint* points) const {
  if (n > 0 && (seen == nullptr || points == nullptr)) reject("there are no points to find");
  MetricPoint none{{kNan, kNan, kNan}};
  none.covariance.fill(kNan);
  std::size_t found = 0;
  for (std::size_t i = 0; i < n; ++i) {
    const auto result = point(seen[i]);
    points[i] = result.value_or(none);
    found += result.has_value();
  }
  return found;
}

}  // namespace plenocal
