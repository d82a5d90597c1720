// Matrices at the interface of the library.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <stdexcept>
#include <string>
#include <vector>

namespace plenocal {

/// Matrix of numbers, row by row. Eigen's own matrices allocate memory according to flags of the
/// compiler (-march=native), so that a program and a compiled library may be incompatible.
struct Matrix {
  using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

  int rows = 0, columns = 0;
  std::vector<double> values;  ///< `rows` x `columns`, row by row

  /// Throws std::out_of_range for a row or column that does not exist.
  double operator()(int row, int column) const {
    if (row < 0 || row >= rows || column < 0 || column >= columns) {
      throw std::out_of_range("there is no entry (" + std::to_string(row) + ", " +
                              std::to_string(column) + ") in a matrix of " + std::to_string(rows) +
                              " x " + std::to_string(columns));
    }
    return values[static_cast<std::size_t>(row) * columns + column];
  }

  /// Returns the matrix for Eigen: a view of `values`.
  Eigen::Map<const RowMajor> eigen() const { return {values.data(), rows, columns}; }
  Eigen::Map<RowMajor> eigen() { return {values.data(), rows, columns}; }
};

}  // namespace plenocal
