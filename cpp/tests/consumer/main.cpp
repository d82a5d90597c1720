// The smallest program that uses the installed library: the feature of a point in one micro-image,
// and its derivatives by the point.
#include <ceres/jet.h>

#include <cstdio>
#include <plenocal/projection.hpp>
#include <plenocal/refine.hpp>

int main() {
  plenocal::Camera camera;
  camera.lattice = {plenocal::Packing::kOrthogonal, 5, 5};
  camera.pixel_size = 0.01;
  camera.main_lens.focal_length = 50.0;
  camera.mla.principal_point[0] = 100.0;
  camera.mla.principal_point[1] = 80.0;
  camera.mla.lens_to_mla = 59.0;
  camera.mla.mla_to_sensor = 0.5;
  camera.mla.pitch = 0.2;
  camera.mla.pitch_ratio = 1.0;
  camera.micro_lens_focal_lengths = {0.8};
  plenocal::validate(camera);

  plenocal::Pose camera_from_board;
  camera_from_board.translation = {0.0, 0.0, 300.0};

  // The main lens images the plane z = 300 mm at 60 mm behind it with a magnification of 1/5. That
  // is 1 mm behind the middle micro-lens, which halves the image on the sensor 0.5 mm away:
  // u = 100 + 3/5/2/0.01 = 130, v = 80 + 1.5/5/2/0.01 = 95,
  // rho = 0.2/0.02 * 0.5 * (1/0.8 + 1 - 1/0.5) = 1.25.
  const auto feature = plenocal::project(camera, camera_from_board, {3.0, 1.5, 0.0}, 2, 2);
  if (!feature) return 1;
  std::printf("u %.3f v %.3f rho %.3f\n", feature->u, feature->v, feature->rho);

  // Now with derivatives by the point in the camera frame: the optics are constant Jets.
  // u grows by 1/5/2/0.01 = 10 px for every mm along x.
  using Jet = ceres::Jet<double, 3>;
  const auto constant = [](auto block) {
    std::array<Jet, std::tuple_size<decltype(block)>::value> jets;
    for (std::size_t i = 0; i < block.size(); ++i) jets[i] = Jet(block[i]);
    return jets;
  };
  const auto main_lens = constant(plenocal::to_block(camera.main_lens));
  const auto array = constant(plenocal::to_block(camera.mla));
  const Jet focal_length(camera.micro_lens_focal_lengths[0]);
  const plenocal::Optics<Jet> optics(plenocal::from_block<plenocal::MainLens>(main_lens.data()),
                                     plenocal::from_block<plenocal::MicroLensArray>(array.data()),
                                     &focal_length, 1, camera.pixel_size);
  const plenocal::Vector3<Jet> point{Jet(3.0, 0), Jet(1.5, 1), Jet(300.0, 2)};
  const auto jets = plenocal::project(optics, point, plenocal::micro_lens_of(camera, 2, 2));
  if (!jets) return 1;
  std::printf("du/dx %.3f dv/dy %.3f\n", jets->u.v[0], jets->v.v[1]);

  // The solver has to link too.
  try {
    plenocal::refine(camera, {}, {}, {}, {});
  } catch (const std::exception& error) {
    std::printf("refine: %s\n", error.what());
    return 0;
  }
  return 1;
}
