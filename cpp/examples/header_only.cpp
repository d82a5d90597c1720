// The camera model by its headers alone: nothing is linked, neither plenocal nor Ceres nor Eigen.
//
//   g++ -std=c++17 -Icpp/include header_only.cpp && ./a.out
#include <cmath>
#include <cstdio>
#include <plenocal/inverse.hpp>

int main() {
  plenocal::Camera camera;
  camera.lattice = {plenocal::Packing::kHexagonalRowsEven, 176, 152};
  camera.pixel_size = 0.0055;
  camera.main_lens.focal_length = 50.0;
  camera.mla = {{2039.5, 1533.5}, 0.32, {}, {}, 56.7, 0.1275, 1.0};
  camera.micro_lens_focal_lengths = {0.58, 0.5, 0.55};

  // A point in space, as micro-lens (90, 80) images it ...
  const auto optics = plenocal::optics_of(camera);
  const auto micro_lens = plenocal::micro_lens_of(camera, 90, 80);
  const plenocal::Vector3<double> point{3.0, -2.0, 420.0};
  const auto feature = plenocal::project(optics, point, micro_lens);
  if (!feature) return 1;
  std::printf("u %.4f v %.4f rho %.4f px\n", feature->u, feature->v, feature->rho);

  // ... and the ray from there back into space passes through it.
  const auto ray = plenocal::object_ray(optics, micro_lens, {feature->u, feature->v}, point.z);
  if (!ray) return 1;
  const double t = (point.z - ray->origin.z) / ray->direction.z;
  const double apart = std::hypot(ray->origin.x + t * ray->direction.x - point.x,
                                  ray->origin.y + t * ray->direction.y - point.y);
  std::printf("the ray misses it by %.1e mm\n", apart);
  return apart < 1e-9 ? 0 : 1;
}
