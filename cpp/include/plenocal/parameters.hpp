// Table of the parameters that all frames share, from parameters.def.
#pragma once

#include <iterator>

namespace plenocal {

/// Row of the table.
struct Parameter {
  const char* name;         ///< symbol as written in options, tables and files
  const char* unit;         ///< unit of the value: mm, mm^-1, ..., rad, px or 1
  const char* key;          ///< JSON pointer into camera.json, or into the board of problem.json
  bool is_positive;         ///< true if the value has to be positive; all have to be finite
  const char* description;  ///< description in one line
};

/// Table: intrinsic parameters of a camera with three lens types, then the shape of the board.
inline constexpr Parameter kParameters[] = {
#define FINITE false
#define POSITIVE true
#define PLENOCAL_ROW(id, name, unit, member, key, bound, description) \
  {name, unit, key, bound, description},
#define PLENOCAL_MAIN_LENS PLENOCAL_ROW
#define PLENOCAL_EXIT_PUPIL PLENOCAL_ROW
#define PLENOCAL_MICRO_LENS_ARRAY PLENOCAL_ROW
#define PLENOCAL_MICRO_LENSES PLENOCAL_ROW
#define PLENOCAL_BOARD_SHAPE PLENOCAL_ROW
#include "plenocal/parameters.def"
#undef PLENOCAL_ROW
#undef POSITIVE
#undef FINITE
};

/// Largest number of lens types.
inline constexpr int kMaxLensTypes = 0
#define PLENOCAL_MICRO_LENSES(...) +1
#include "plenocal/parameters.def"
    ;

/// Number of parameters of the shape of a board.
inline constexpr int kBoardShapeParameters = 0
#define PLENOCAL_BOARD_SHAPE(...) +1
#include "plenocal/parameters.def"
    ;

/// Parameters of the shape of a board, up to the end of the table.
inline constexpr const Parameter* kBoardShapeTable = std::end(kParameters) - kBoardShapeParameters;

/// Number of intrinsic parameters of a camera of pinholes.
inline constexpr int kPinholeParameters =
    static_cast<int>(std::size(kParameters)) - kMaxLensTypes - kBoardShapeParameters;

}  // namespace plenocal
