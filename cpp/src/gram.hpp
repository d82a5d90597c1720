// Sums of products of rows of numbers.
#pragma once

namespace plenocal {

/// The number of columns is a multiple of this.
constexpr int kGramColumns = 8;

/// Returns the number of columns of a row with space for `size` numbers.
constexpr int gram_width(int size) {
  return (size + kGramColumns - 1) / kGramColumns * kGramColumns;
}

/// Computes A'A for `rows` rows of `width` numbers, row by row: its lower triangle, and some
/// numbers beside it. `width` is a `gram_width`.
void gram_of(const double* a, int rows, int width, double* gram);

}  // namespace plenocal
