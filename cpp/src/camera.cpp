#include "plenocal/camera.hpp"

#include <sstream>
#include <stdexcept>

#include "plenocal/projection.hpp"

namespace plenocal {
namespace {

[[noreturn]] void reject(const std::string& what) { throw std::invalid_argument(what); }

void require_positive(double value, const std::string& name) {
  if (!(std::isfinite(value) && value > 0.0)) {
    std::ostringstream text;
    text << "the camera's " << name << " is " << value << "; it has to be positive and finite";
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
  if (lattice.shifted_parity != 0 && lattice.shifted_parity != 1) {
    reject("the parity of the shifted rows has to be 0 or 1");
  }
  const int types = camera.lens_types();
  if (types != 0 && types != 1 && !(types == 3 && lattice.kind != LatticeKind::kOrthogonal)) {
    reject("a camera of " + std::to_string(types) +
           " lens types is not known: 0 or 1, or 3 on a hexagonal lattice");
  }
  require_positive(camera.pixel_size, "pixel size (mm)");
  require_positive(camera.main_lens.focal_length, "F (mm)");
  require_positive(camera.mla.lens_to_mla, "D (mm)");
  require_positive(camera.mla.mla_to_sensor, "d (mm)");
  require_positive(camera.mla.pitch, "dC (mm)");
  require_positive(camera.mla.pitch_ratio, "dC_ratio");
  for (int i = 0; i < types; ++i) {
    require_positive(camera.micro_lens_focal_lengths[i], "f_" + std::to_string(i + 1) + " (mm)");
  }
  const auto names = intrinsic_names(0);
  std::size_t index = 0;
  const auto require_finite = [&](double value) {
    if (!std::isfinite(value)) reject("the camera's " + names[index] + " is not a finite number");
    ++index;
  };
  for (double value : camera.main_lens.block()) require_finite(value);
  for (double value : camera.mla.block()) require_finite(value);
}

bool project(const Camera& camera, const Pose& camera_from_board,
             const std::array<double, 3>& board_point, int k, int l, Feature<double>* feature) {
  const Optics<double> optics(camera.main_lens, camera.mla, camera.pixel_size);
  const std::array<double, 6> block = pose_block(camera_from_board);
  Point<double> image;
  if (!optics.main_lens_image(Motion<double>(block.data())(board_point), &image)) return false;
  const Point<double> center = optics.micro_lens_center(camera.lattice.node(k, l));
  Pixel<double> pixel;
  double scale = 0.0;
  if (!optics.through_micro_lens(image, center, &pixel, &scale)) return false;
  double rho = 0.0;
  if (camera.lens_types() > 0) {
    const int type = camera.lattice.lens_type(k, l, camera.lens_types());
    rho = optics.blur_radius(center, scale, 1.0 / camera.micro_lens_focal_lengths[type]);
  }
  *feature = {pixel.u, pixel.v, rho};
  return true;
}

Pixel<double> project_center(const Camera& camera, int k, int l) {
  const Optics<double> optics(camera.main_lens, camera.mla, camera.pixel_size);
  return optics.micro_image_center(optics.micro_lens_center(camera.lattice.node(k, l)));
}

}  // namespace plenocal
