// Board with its shape: a flat grid of corners, slightly bent and stretched.
#pragma once

#include <stdexcept>

#include "plenocal/camera.hpp"

namespace plenocal {

/// Deviation of a board from a flat grid of squares, the same in all frames. With (x, y) from
/// corner 0, and xi and eta from -1 to 1 over the corners along x and y,
///   corner = (x (1 + aspect/2), y (1 - aspect/2), sag_x xi^2 + sag_y eta^2 + twist xi eta),
/// where z of the board points away from the camera.
template <typename T>
struct BoardShape {
  T sag_x;   ///< mm: distance of the ends of the rows behind their middle
  T sag_y;   ///< mm: distance of the ends of the columns behind their middle
  T twist;   ///< mm: distance of the first and the last corner behind the middle
  T aspect;  ///< 1: fraction by which squares are longer along x than along y

  /// Calls f(name, parameter) for every parameter, in the order of the solver's parameter block.
  template <typename Self, typename F>
  static constexpr void visit(Self& self, F&& f) {
#define PLENOCAL_BOARD_SHAPE(id, name, unit, member, ...) f(name, self.member);
#include "plenocal/parameters.def"
  }
};
static_assert(sizeof(BoardShape<double>) == kBoardShapeParameters * sizeof(double),
              "every member is a parameter");

/// Board that all features show. The size of its squares is not a parameter, since images cannot
/// separate it from the lengths of the camera.
struct Board {
  /// Distances from the middle of all corners to the outermost along x and y, mm; not needed for a
  /// flat board.
  double half_width = 0.0, half_height = 0.0;
  BoardShape<double> shape{};

  bool is_flat() const {
    return shape.sag_x == 0.0 && shape.sag_y == 0.0 && shape.twist == 0.0 && shape.aspect == 0.0;
  }
};

/// Returns the position of a corner of the flat grid (mm, board frame) on a board of this size and
/// shape.
template <typename T>
Vector3<T> corner_of(const Board& size, const BoardShape<T>& shape, const Vector3<double>& flat) {
  const double xi = flat.x / size.half_width - 1.0;
  const double eta = flat.y / size.half_height - 1.0;
  return {flat.x * (1.0 + 0.5 * shape.aspect), flat.y * (1.0 - 0.5 * shape.aspect),
          flat.z + shape.sag_x * (xi * xi) + shape.sag_y * (eta * eta) + shape.twist * (xi * eta)};
}

/// Returns the position of a corner of the flat grid on a board. Throws std::invalid_argument if a
/// board that is not flat has no size.
inline Vector3<double> corner_of(const Board& board, const Vector3<double>& flat) {
  if (!board.is_flat() && !(board.half_width > 0.0 && board.half_height > 0.0)) {
    throw std::invalid_argument("a board that is not flat needs a size");
  }
  return board.is_flat() ? flat : corner_of(board, board.shape, flat);
}

/// Returns the names of the parameters that all frames share: `intrinsic_names`, then the shape of
/// the board. Indices of shared parameters refer to this order.
inline std::vector<std::string> shared_names(int lens_types) {
  std::vector<std::string> names = intrinsic_names(lens_types);
  for (const Parameter* p = kBoardShapeTable; p != std::end(kParameters); ++p) {
    names.emplace_back(p->name);
  }
  return names;
}

/// Throws std::invalid_argument with the offending value unless a board is possible: everything
/// finite, a size unless it is flat, the aspect below 0.1, and sag and twist below half the
/// diagonal.
PLENOCAL_API void validate(const Board& board);

}  // namespace plenocal
