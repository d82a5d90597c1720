#include "plenocal/board.hpp"

#include <sstream>

#include "checks.hpp"

namespace plenocal {
namespace {

constexpr double kLargestAspect = 0.1;

}  // namespace

void validate(const Board& board) {
  const double half_diagonal = std::hypot(board.half_width, board.half_height);
  BoardShape<double>::visit(board.shape, [](const std::string& name, double value) {
    if (!std::isfinite(value)) reject("the board's " + name + " is not a finite number");
  });
  if (board.is_flat()) return;
  require_size(board);
  BoardShape<double>::visit(board.shape, [&](const std::string& name, double value) {
    const bool is_aspect = name == "aspect";
    const double limit = is_aspect ? kLargestAspect : half_diagonal;
    if (std::abs(value) < limit) return;
    std::ostringstream text;
    text << "the board's " << name << " is " << value << (is_aspect ? "" : " mm")
         << ", but has to be smaller than " << limit
         << (is_aspect ? "" : " mm, half the diagonal of the board");
    reject(text.str());
  });
}

void require_size(const Board& board) {
  if (!is_positive(board.half_width) || !is_positive(board.half_height)) {
    std::ostringstream text;
    text << "a board that is not flat needs a size: half its width is " << board.half_width
         << " mm, half its height is " << board.half_height << " mm";
    reject(text.str());
  }
}

}  // namespace plenocal
