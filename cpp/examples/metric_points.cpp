// Turns virtual depths into metric points: what a stack does with a calibrated camera. No other
// library than plenocal is needed.
//
//   metric_points camera.json depths.csv > points.csv
//
// depths.csv has the columns k, l, u, v, nu: pixel (u, v) of micro-image (k, l) shows something at
// the virtual depth nu. Points are in the camera frame, mm.
#include <cstdio>
#include <fstream>
#include <plenocal/back_projection.hpp>
#include <plenocal/io.hpp>
#include <string>

int main(int argc, char** argv) {
  if (argc != 3) {
    std::fprintf(stderr, "usage: metric_points camera.json depths.csv\n");
    return 2;
  }
  try {
    const plenocal::BackProjection camera(plenocal::read_camera(argv[1]).camera);
    std::ifstream file(argv[2]);
    if (!file) throw std::runtime_error(std::string(argv[2]) + ": cannot be read");
    std::string line;
    std::getline(file, line);
    std::printf("x,y,z\n");
    int outside = 0;
    while (std::getline(file, line)) {
      plenocal::VirtualPoint seen{};
      if (std::sscanf(line.c_str(), "%d,%d,%lf,%lf,%lf", &seen.at.k, &seen.at.l, &seen.at.pixel.u,
                      &seen.at.pixel.v, &seen.virtual_depth) != 5) {
        throw std::runtime_error(std::string(argv[2]) + ": not k,l,u,v,nu: " + line);
      }
      if (const auto point = camera.point(seen)) {
        std::printf("%.6f,%.6f,%.6f\n", point->point.x, point->point.y, point->point.z);
      } else {
        ++outside;
      }
    }
    if (outside > 0) std::fprintf(stderr, "%d rows are not points of this camera\n", outside);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "metric_points: %s\n", error.what());
    return 1;
  }
  return 0;
}
