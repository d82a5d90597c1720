// The multi-focus plenoptic camera as plain values: what it is made of and in which units.
//
// Conventions. Lengths in mm, angles in rad, image quantities in px; pixel (0, 0) is the centre of
// the top-left pixel. The camera frame has its origin at the centre O of the main lens, z towards
// the scene, x right, y down. The raw image is stored upright, so pixel axes run against the
// optical image: u = u0 - x/s and v = v0 - y/s for a point (x, y) of the sensor plane.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <string>
#include <vector>

namespace plenocal {

/// How the micro-lenses are packed.
enum class LatticeKind {
  kOrthogonal,        ///< a square lattice
  kHexagonalRows,     ///< hexagonal, straight rows; every other row is moved by half a pitch
  kHexagonalColumns,  ///< hexagonal, straight columns; every other column is moved by half a pitch
};

/// Position of a micro-lens in the plane of the array, in pitches, about the centre of the array.
struct Node {
  double x;
  double y;
};

/// The micro-lens array as a lattice of indices: micro-lens and micro-image (k, l) are the same
/// one, k grows with u and l with v.
struct Lattice {
  LatticeKind kind = LatticeKind::kOrthogonal;
  int columns = 0;         ///< number of micro-lenses along k
  int rows = 0;            ///< number of micro-lenses along l
  int shifted_parity = 0;  ///< 0 or 1: the rows (columns) of this parity are moved by +1/2 pitch

  bool contains(int k, int l) const { return k >= 0 && k < columns && l >= 0 && l < rows; }

  /// Position of (k, l) about the midpoint of the bounding box of all nodes, along u and v.
  Node node(int k, int l) const {
    const double kRowHeight = std::sqrt(3.0) / 2.0;
    const auto centred = [](int index, int count) { return index - (count - 1) / 2.0; };
    const auto shift = [this](int row) { return (row & 1) == shifted_parity ? 0.5 : 0.0; };
    // Along the straight rows, of which there are `across`: shifted and unshifted ones together
    // reach half a pitch further.
    const auto staggered = [&](int index, int count, int row, int across) {
      return centred(index, count) + shift(row) - (across > 1 ? 0.25 : shift(0));
    };
    switch (kind) {
      case LatticeKind::kHexagonalRows:
        return {staggered(k, columns, l, rows), kRowHeight * centred(l, rows)};
      case LatticeKind::kHexagonalColumns:
        return {kRowHeight * centred(k, columns), staggered(l, rows, k, columns)};
      case LatticeKind::kOrthogonal:
        break;
    }
    return {centred(k, columns), centred(l, rows)};
  }

  /// Index of the lens type of (k, l), from 0. One type anywhere; three types follow the unique
  /// 3-colouring of the hexagonal lattice, named so that micro-lens (0, 0) is of type 0 and its
  /// successor along the straight rows (columns) of type 1.
  int lens_type(int k, int l, int types) const {
    if (types < 3) return 0;
    const bool by_rows = kind != LatticeKind::kHexagonalColumns;
    const int along = by_rows ? k : l;
    const int across = by_rows ? l : k;
    return (along + (shifted_parity == 0 ? 1 : 2) * (across & 1)) % 3;
  }
};

/// The main lens: a thin lens with lateral Brown-Conrady distortion (paper, section 2.1).
/// T is double, or a Jet when derivatives are wanted; likewise below.
template <typename T>
struct MainLens {
  static constexpr int kSize = 6;
  T focal_length;   ///< F, mm
  T radial[3];      ///< Q1, Q2, Q3 in mm^-2, mm^-4, mm^-6
  T tangential[2];  ///< P1, P2 in mm^-1

  static MainLens from_block(const T* b) { return {b[0], {b[1], b[2], b[3]}, {b[4], b[5]}}; }
  std::array<T, kSize> block() const {
    return {focal_length, radial[0], radial[1], radial[2], tangential[0], tangential[1]};
  }
};

/// The micro-lens array and the sensor behind it.
template <typename T>
struct MicroLensArray {
  static constexpr int kSize = 11;
  T principal_point[2];  ///< (u0, v0), px: where the optical axis meets the sensor
  T mla_to_sensor;       ///< d, mm, along the optical axis at the centre of the array
  T rotation[3];         ///< theta_x, theta_y, theta_z, rad: R_MLA = Rz Ry Rx
  T offset[2];           ///< t_x, t_y, mm: centre of the array in the camera frame
  T lens_to_mla;         ///< D, mm, along the optical axis at the centre of the array
  T pitch;               ///< Delta C, mm: distance of neighbours, along x
  T pitch_ratio;         ///< pitch along y over pitch along x: 1 for a regular lattice

  static MicroLensArray from_block(const T* b) {
    return {{b[0], b[1]}, b[2], {b[3], b[4], b[5]}, {b[6], b[7]}, b[8], b[9], b[10]};
  }
  std::array<T, kSize> block() const {
    return {principal_point[0], principal_point[1], mla_to_sensor, rotation[0], rotation[1],
            rotation[2],        offset[0],          offset[1],     lens_to_mla, pitch,
            pitch_ratio};
  }
};

/// A whole camera. I = `micro_lens_focal_lengths.size()` lens types: 0 (an array of pinholes), 1,
/// or 3 on a hexagonal lattice.
struct Camera {
  Lattice lattice;
  double pixel_size = 0.0;  ///< s, mm
  MainLens<double> main_lens{};
  MicroLensArray<double> mla{};
  std::vector<double> micro_lens_focal_lengths;  ///< f_1 .. f_I, mm

  int lens_types() const { return static_cast<int>(micro_lens_focal_lengths.size()); }
};

/// The largest number of micro-lenses along a side.
constexpr int kMaxMicroLenses = 1 << 16;

/// The largest number of lens types.
constexpr int kMaxLensTypes = 3;

/// Names of the intrinsic parameters in the order of the blocks main lens, array, focal lengths;
/// wherever parameters are counted, this is the order.
inline std::vector<std::string> intrinsic_names(int lens_types) {
  std::vector<std::string> names = {"F",   "Q1",  "Q2", "Q3",      "P1",      "P2",
                                    "u0",  "v0",  "d",  "theta_x", "theta_y", "theta_z",
                                    "t_x", "t_y", "D",  "dC",      "dC_ratio"};
  for (int i = 1; i <= lens_types; ++i) names.push_back("f_" + std::to_string(i));
  return names;
}

/// Throws std::invalid_argument with the offending value unless the camera is one the model is
/// defined for: sizes positive, everything finite, the number of lens types possible.
void validate(const Camera& camera);

}  // namespace plenocal
