// Matrices as they cross the boundary of the library.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <stdexcept>
#include <string>
#include <vector>

namespace plenocal {

/// A matrix of numbers, row by row. Eigen's own matrices allocate memory as the flags of the
/// compiler say (-march=native), so that those of a program and of a compiled library do not fit.
struct Matrix {
  using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

  int rows = 0, columns = 0;
  std::vector<double> values;  ///< `rows` x `columns`, row by row

  /// Throws std::out_of_range for a row or column that there is not.
  double operator()(int row, int column) const {
    if (row < 0 || row >= rows || column < 0 || column >= columns) {
      throw std::out_of_range("there is no entry (" + std::to_string(row) + ", " +
                              std::to_string(column) + ") in a matrix of " + std::to_string(rows) +
                              " x " + std::to_string(columns));
    }
    return values[static_cast<std::size_t>(row) * columns + column];
  }

  /// The matrix for Eigen: a view of `values`.
  Eigen::Map<const RowMajor> eigen() const { return {values.data(), rows, columns}; }
  Eigen::Map<RowMajor> eigen() { return {values.data(), rows, columns}; }
};

}  // namespace plenocal
