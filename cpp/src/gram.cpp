#include "gram.hpp"

#include <cstdlib>  // defines __GLIBC__

// Compiles the function for AVX2 too if compiler and C library can choose at the start of the
// program.
#if defined(__x86_64__) && defined(__GLIBC__) && __GNUC__ >= 12 && !defined(__clang__) && \
    !defined(__SANITIZE_THREAD__) && !defined(__SANITIZE_ADDRESS__)
#define PLENOCAL_WIDE __attribute__((target_clones("arch=x86-64-v3", "default")))
#else
#define PLENOCAL_WIDE
#endif

namespace plenocal {
namespace {

// Numbers of columns of a tile of products whose sums stay in registers.
constexpr int kTileRows = 4, kTileColumns = kGramColumns;

}  // namespace

PLENOCAL_WIDE void gram_of(const double* a, int rows, int width, double* gram) {
  for (int i = 0; i < width; i += kTileRows) {
    for (int j = 0; j < i + kTileRows; j += kTileColumns) {
      double sum[kTileRows][kTileColumns] = {};
      const double *left = a + i, *right = a + j;
      for (int row = 0; row < rows; ++row, left += width, right += width) {
        for (int p = 0; p < kTileRows; ++p) {
          for (int q = 0; q < kTileColumns; ++q) sum[p][q] += left[p] * right[q];
        }
      }
      for (int p = 0; p < kTileRows; ++p) {
        for (int q = 0; q < kTileColumns; ++q) gram[(i + p) * width + j + q] = sum[p][q];
      }
    }
  }
}

}  // namespace plenocal
