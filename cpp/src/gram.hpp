// Sums of products of rows of numbers.
#pragma once

namespace plenocal {

/// Rows have so many numbers, or a multiple of it.
constexpr int kGramColumns = 8;

/// Numbers in a row that has room for `size`.
constexpr int gram_width(int size) {
  return (size + kGramColumns - 1) / kGramColumns * kGramColumns;
}

/// A'A of `rows` rows of `width` numbers, row by row: its lower triangle, and some numbers beside
/// it. `width` is a `gram_width`.
void gram_of(const double* a, int rows, int width, double* gram);

}  // namespace plenocal
