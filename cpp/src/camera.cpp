#include "plenocal/camera.hpp"

#include <sstream>

#include "checks.hpp"
#include "plenocal/inverse.hpp"

namespace plenocal {
namespace {

constexpr double kRightAngle = 1.5707963267948966;

void require_positive(double value, const std::string& name) {
  if (!is_positive(value)) {
    std::ostringstream text;
    text << "the camera's " << name << " is " << value << ", but has to be positive and finite";
    reject(text.str());
  }
}

}  // namespace

void validate(const Camera& camera) {
  const auto& lattice = camera.lattice;
  const auto possible = [](int count) { return count >= 1 && count <= kMaxMicroLenses; };
  if (!possible(lattice.columns) || !possible(lattice.rows)) {
    reject("the columns and rows of the micro-lens array have to be positive and at most " +
           std::to_string(kMaxMicroLenses));
  }
  const int types = camera.lens_types();
  if (types != 0 && types != 1 && !(types == 3 && lattice.packing != Packing::kOrthogonal)) {
    reject("a camera of " + std::to_string(types) +
           " lens types is not supported: give 0 or 1, or 3 on a hexagonal lattice");
  }
  require_positive(camera.pixel_size, "pixel size (mm)");
  if (camera.width < 0 || camera.height < 0) reject("the camera's width or height is negative");
  if (static_cast<long long>(camera.width) * camera.height > kMaxPixels) {
    reject("a sensor of " + std::to_string(camera.width) + " x " + std::to_string(camera.height) +
           " px is too large: at most " + std::to_string(kMaxPixels) + " px are possible");
  }
  const Parameter* parameter = kParameters;
  for_each_parameter(camera, [&parameter](const std::string& name, double value) {
    if (parameter->is_positive) {
      require_positive(value, name + (parameter->unit == std::string("mm") ? " (mm)" : ""));
    } else if (!std::isfinite(value)) {
      reject("the camera's " + name + " is not a finite number");
    }
    ++parameter;
  });
  for (const double angle : camera.main_lens.rotation) {
    if (!(std::abs(angle) < kRightAngle)) {
      reject("the main lens is rotated by " + std::to_string(angle) +
             " rad (omega_x, omega_y), but its axis has to meet the sensor: give radians");
    }
  }
  const auto require_behind = [](double distance, const std::string& what) {
    if (!is_positive(distance)) reject("the exit pupil (e_z) does not lie " + what);
  };
  require_behind(camera.mla.lens_to_mla + camera.exit_pupil.z, "in front of the array");
  require_behind(camera.main_lens.focal_length + camera.exit_pupil.z,
                 "in front of the rear focal point");
}

std::optional<Vector3<double>> unfolded_image(const MainLens<double>& lens,
                                              const Vector3<double>& point) {
  const LensFrame<double> frame(lens);
  const Vector3<double> from_lens = frame.of_camera(point);
  const auto image = image_along_axis(lens, from_lens);
  if (!image) return std::nullopt;
  const double magnification = -lens.focal_length / (from_lens.z - lens.focal_length);
  const auto ideal = undistort(lens, Magnification(magnification), {image->x, image->y});
  if (!ideal) return std::nullopt;
  const double off =
      std::hypot(ideal->x - magnification * from_lens.x, ideal->y - magnification * from_lens.y);
  constexpr double kSame = 1e-6;
  if (!(off <= kSame * std::max(1.0, std::hypot(ideal->x, ideal->y)))) return std::nullopt;
  return frame.to_camera(*image);
}

std::optional<Feature<double>> project(const Camera& camera, const Pose& camera_from_board,
                                       const Vector3<double>& board_point, int k, int l) {
  validate(camera);
  if (!camera.lattice.contains(k, l)) return std::nullopt;
  const Motion<double> motion(pose_block(camera_from_board).data());
  const Vector3<double> point = motion(board_point);
  if (!std::isfinite(point.z)) return std::nullopt;
  const auto image = unfolded_image(camera.main_lens, point);
  if (!image) return std::nullopt;
  const auto feature = project_image(optics_of(camera), *image, micro_lens_of(camera, k, l));
  if (!feature || !std::isfinite(feature->u) || !std::isfinite(feature->v)) return std::nullopt;
  return feature;
}

Pixel<double> project_center(const Camera& camera, int k, int l) {
  validate(camera);
  const ArrayOptics<double> optics(camera.mla, camera.pixel_size);
  return optics.micro_image_center(LensFrame<double>(camera.main_lens), camera.exit_pupil,
                                   camera.lattice.node(k, l));
}

}  // namespace plenocal
