// Multi-focus plenoptic camera as plain values: its parts, their parameters and units.
//
// Conventions: lengths in mm, angles in rad, image quantities in px; pixel (0, 0) is the centre of
// the top-left pixel. The camera frame has its origin at the centre O of the main lens, z towards
// the scene, x right, y down. The raw image is stored upright, so pixel axes are opposite to the
// optical image: u = u0 - x/s and v = v0 - y/s for a point (x, y) of the sensor plane.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <string>
#include <utility>
#include <vector>

#include "plenocal/export.hpp"
#include "plenocal/parameters.hpp"

namespace plenocal {

/// Vector in space, or coordinates of a point. T is double, or a ceres::Jet for derivatives;
/// likewise below.
template <typename T>
struct Vector3 {
  T x, y, z;
};

/// Packing of the micro-lenses: on a square lattice, or on a hexagonal one with straight rows or
/// straight columns, where every other row (column) is shifted by +1/2 pitch. Even and odd refer to
/// the indices of the shifted rows (columns).
enum class Packing {
  kOrthogonal,            ///< square; nothing is shifted
  kHexagonalRowsEven,     ///< rows 0, 2, 4 ... are shifted along u
  kHexagonalRowsOdd,      ///< rows 1, 3, 5 ... are shifted along u
  kHexagonalColumnsEven,  ///< columns 0, 2, 4 ... are shifted along v
  kHexagonalColumnsOdd,   ///< columns 1, 3, 5 ... are shifted along v
};

/// Position of a micro-lens in the plane of the array, in pitches from the centre of the array.
struct Node {
  double x;
  double y;
};

/// Micro-lens array as a lattice of indices: micro-lens (k, l) forms micro-image (k, l); k grows
/// with u and l with v.
struct Lattice {
  Packing packing = Packing::kOrthogonal;
  int columns = 0;  ///< number of micro-lenses along k
  int rows = 0;     ///< number of micro-lenses along l

  bool contains(int k, int l) const { return k >= 0 && k < columns && l >= 0 && l < rows; }

  bool has_straight_rows() const {
    return packing == Packing::kHexagonalRowsEven || packing == Packing::kHexagonalRowsOdd;
  }
  bool has_straight_columns() const {
    return packing == Packing::kHexagonalColumnsEven || packing == Packing::kHexagonalColumnsOdd;
  }

  /// Returns the position of (k, l) from the midpoint of the bounding box of all nodes, along u and
  /// v.
  Node node(int k, int l) const {
    const double kRowDistance = std::sqrt(3.0) / 2.0;
    const auto centred = [](int index, int count) { return index - (count - 1) / 2.0; };
    const auto shift = [this](int row) { return (row & 1) == shifted_parity() ? 0.5 : 0.0; };
    // `across` is the number of straight rows: together, shifted and unshifted rows extend half a
    // pitch further.
    const auto staggered = [&](int index, int count, int row, int across) {
      return centred(index, count) + shift(row) - (across > 1 ? 0.25 : shift(0));
    };
    if (has_straight_rows()) {
      return {staggered(k, columns, l, rows), kRowDistance * centred(l, rows)};
    }
    if (has_straight_columns()) {
      return {kRowDistance * centred(k, columns), staggered(l, rows, k, columns)};
    }
    return {centred(k, columns), centred(l, rows)};
  }

  /// Returns the indices (k, l) of the nearest node; they may lie outside the array. Far away, the
  /// result is only guaranteed to lie outside.
  std::array<int, 2> nearest(const Node& at) const {
    const double kRowDistance = std::sqrt(3.0) / 2.0;
    const bool by_columns = has_straight_columns();
    const double along = by_columns ? at.y : at.x;
    const double across = by_columns ? at.x : at.y;
    const int row_count = by_columns ? columns : rows, count = by_columns ? rows : columns;
    const auto bounded = [](double index, int count) {
      // The comparison is false for NaN.
      return index > -2.0 ? static_cast<int>(std::floor(std::min(index, count + 1.0))) : -2;
    };
    const auto index = [by_columns](int i, int row) {
      return by_columns ? std::array<int, 2>{row, i} : std::array<int, 2>{i, row};
    };
    const bool is_square = packing == Packing::kOrthogonal;
    const double row = across / (is_square ? 1.0 : kRowDistance) + (row_count - 1) / 2.0;
    std::array<int, 2> best{-2, -2};
    double least = HUGE_VAL;
    for (int r = bounded(row, row_count), last = r + 1; r <= last; ++r) {
      const auto first = index(0, r);
      const Node start = node(first[0], first[1]);
      const int i = bounded(along - (by_columns ? start.y : start.x) + 0.5, count);
      const auto candidate = index(i, r);
      const Node there = node(candidate[0], candidate[1]);
      const double distance = std::hypot(at.x - there.x, at.y - there.y);
      if (distance < least) {
        least = distance;
        best = candidate;
      }
    }
    return best;
  }

  /// Returns the index of the lens type of (k, l), from 0. With fewer than three types, or on a
  /// square lattice, all have type 0. Three types follow the unique 3-colouring of the hexagonal
  /// lattice, numbered so that micro-lens (0, 0) has type 0 and the next one along the straight
  /// rows (columns) type 1.
  int lens_type(int k, int l, int types) const {
    if (types < 3 || packing == Packing::kOrthogonal) return 0;
    const int along = has_straight_rows() ? k : l;
    const int across = has_straight_rows() ? l : k;
    const int type = (along % 3 + (shifted_parity() == 0 ? 1 : 2) * (across & 1)) % 3;
    // Indices outside the array may be negative.
    return type < 0 ? type + 3 : type;
  }

 private:
  // Returns the parity of the shifted rows (columns).
  int shifted_parity() const {
    return packing == Packing::kHexagonalRowsEven || packing == Packing::kHexagonalColumnsEven ? 0
                                                                                               : 1;
  }
};

/// Main lens: a thin lens with lateral Brown-Conrady distortion (paper, section 2.1) and field
/// curvature. The model also describes a thick lens, with O as its image-side principal point, if
/// all objects are moved along z by the distance between its principal planes.
template <typename T>
struct MainLens {
  T focal_length;   ///< focal length F, mm
  T radial[3];      ///< radial distortion Q1, Q2, Q3 in mm^-2, mm^-4, mm^-6
  T radial_growth;  ///< growth Q1_m, mm^-2: the first order is Q1 + Q1_m |m| at the magnification m
  T tangential[2];  ///< tangential distortion P1, P2 in mm^-1
  /// field curvature kappa, mm^-1: images at the distance r from the axis are (kappa + kappa_m |m|)
  /// r^2 nearer to the lens, at the magnification m
  T field_curvature;
  T field_curvature_growth;  ///< growth kappa_m, mm^-1; kappa applies to objects far away
  /// rotation omega_x, omega_y of the optical axis against the normal of the sensor, rad: Ry Rx
  T rotation[2];

  /// Calls f(name, parameter) for every parameter, in the order of the solver's parameter block.
  template <typename Self, typename F>
  static constexpr void visit(Self& self, F&& f) {
#define PLENOCAL_MAIN_LENS(id, name, unit, member, ...) f(name, self.member);
#include "plenocal/parameters.def"
  }
};

/// Centre P of the exit pupil of the main lens in the lens frame (`LensFrame`), mm, the origin of
/// the light that reaches a micro-lens. In the paper it lies in the main lens, at O. z is negative
/// towards the array.
template <typename T>
struct ExitPupil {
  T x, y, z;
  /// spherical aberration e_r of the pupil, 1/mm: seen from the distance r, it lies at z + e_r r^2
  T aberration;

  /// Returns P as seen from a micro-lens with the centre C, both in the lens frame, mm.
  Vector3<T> seen_from(const Vector3<T>& center) const {
    const T dx = center.x - x, dy = center.y - y;
    return {x, y, z + aberration * (dx * dx + dy * dy)};
  }

  /// Calls f(name, parameter) for every parameter, in the order of the solver's parameter block.
  template <typename Self, typename F>
  static constexpr void visit(Self& self, F&& f) {
#define PLENOCAL_EXIT_PUPIL(id, name, unit, member, ...) f(name, self.member);
#include "plenocal/parameters.def"
  }
};

/// Micro-lens array and the sensor behind it. Distances are along the normal of the sensor.
template <typename T>
struct MicroLensArray {
  T principal_point[2];  ///< principal point (u0, v0), px: O projected onto the sensor
  T mla_to_sensor;       ///< distance d to the sensor, mm, in the middle of the array
  Vector3<T> rotation;   ///< rotation theta_x, theta_y, theta_z, rad: R_MLA = Rz Ry Rx
  T offset[2];           ///< centre t_x, t_y of the array in the camera frame, mm
  T lens_to_mla;         ///< distance D from the main lens, mm, in the middle of the array
  T pitch;               ///< distance Delta C between neighbours along x, mm
  T pitch_ratio;         ///< pitch along y over pitch along x: 1 for a regular lattice

  /// Calls f(name, parameter) for every parameter, in the order of the solver's parameter block.
  template <typename Self, typename F>
  static constexpr void visit(Self& self, F&& f) {
#define PLENOCAL_MICRO_LENS_ARRAY(id, name, unit, member, ...) f(name, self.member);
#include "plenocal/parameters.def"
  }
};

/// Returns the number of parameters of `MainLens`, `ExitPupil` or `MicroLensArray`.
template <template <typename> class Part>
constexpr int parameter_count() {
  const Part<double> part{};
  int count = 0;
  Part<double>::visit(part, [&count](const char*, const double&) { ++count; });
  return count;
}
constexpr int kMainLensParameters = parameter_count<MainLens>();
constexpr int kExitPupilParameters = parameter_count<ExitPupil>();
constexpr int kArrayParameters = parameter_count<MicroLensArray>();
static_assert(sizeof(MainLens<double>) == kMainLensParameters * sizeof(double),
              "every member is a parameter");
static_assert(sizeof(ExitPupil<double>) == kExitPupilParameters * sizeof(double),
              "every member is a parameter");
static_assert(sizeof(MicroLensArray<double>) == kArrayParameters * sizeof(double),
              "every member is a parameter");

/// Converts the parameters of a part to the solver's parameter block.
template <template <typename> class Part, typename T>
std::array<T, parameter_count<Part>()> to_block(const Part<T>& part) {
  std::array<T, parameter_count<Part>()> block;
  T* next = block.data();
  Part<T>::visit(part, [&next](const char*, const T& parameter) { *next++ = parameter; });
  return block;
}

/// Creates a part from a parameter block: from_block<MainLens>(block).
template <template <typename> class Part, typename T>
Part<T> from_block(const T* block) {
  Part<T> part;
  Part<T>::visit(part, [&block](const char*, T& parameter) { parameter = *block++; });
  return part;
}

/// Returns a part with its parameters as constants of another type:
/// cast<ceres::Jet<double, 6>>(lens).
template <typename T, template <typename> class Part>
Part<T> cast(const Part<double>& part) {
  const auto block = to_block(part);
  std::array<T, parameter_count<Part>()> constants;
  for (std::size_t i = 0; i < block.size(); ++i) constants[i] = T(block[i]);
  return from_block<Part>(constants.data());
}

/// Whole camera. It has I = `micro_lens_focal_lengths.size()` lens types: 0 (an array of pinholes),
/// 1, or 3 on a hexagonal lattice.
struct Camera {
  Lattice lattice;
  double pixel_size = 0.0;    ///< pixel size s, mm
  int width = 0, height = 0;  ///< size of the sensor, px; 0 if not known
  MainLens<double> main_lens{};
  ExitPupil<double> exit_pupil{};
  MicroLensArray<double> mla{};
  std::vector<double> micro_lens_focal_lengths;  ///< focal lengths f_1 .. f_I, mm

  int lens_types() const { return static_cast<int>(micro_lens_focal_lengths.size()); }
};

/// Largest number of micro-lenses along a side, and of pixels of a sensor.
constexpr int kMaxMicroLenses = 1 << 16;
constexpr long long kMaxPixels = 1LL << 28;

/// Calls f(name, parameter) for every intrinsic parameter of a `Camera` or `const Camera`: main
/// lens, exit pupil, array, focal lengths. Indices of parameters always refer to this order. The
/// name is a std::string or converts to one.
template <typename AnyCamera, typename F>
void for_each_parameter(AnyCamera& camera, F&& f) {
  MainLens<double>::visit(camera.main_lens, f);
  ExitPupil<double>::visit(camera.exit_pupil, f);
  MicroLensArray<double>::visit(camera.mla, f);
  int type = 0;
  for (auto& focal_length : camera.micro_lens_focal_lengths) {
    f("f_" + std::to_string(++type), focal_length);
  }
}

/// Returns the names of the intrinsic parameters in the order of `for_each_parameter`.
inline std::vector<std::string> intrinsic_names(int lens_types) {
  std::vector<std::string> names;
  for (int i = 0; i < kPinholeParameters + lens_types; ++i) names.emplace_back(kParameters[i].name);
  return names;
}

/// Throws std::invalid_argument with the offending value unless the model is defined for the
/// camera: sizes positive, no more than `kMaxPixels`, everything finite, the exit pupil between the
/// array and the front focal point, the number of lens types supported.
PLENOCAL_API void validate(const Camera& camera);

}  // namespace plenocal
