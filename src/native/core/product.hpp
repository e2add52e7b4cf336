// Products of matrices, each sum in the order of its terms: the same bits on every processor, which no BLAS gives.
#pragma once

#include <algorithm>
#include <vector>

#include "core/array.hpp"

namespace cabinpose {

/// A matrix in memory of numpy's: rows and columns are `row` and `column` elements apart.
template <class T>
struct Strided {
  const T* data;
  Index rows, columns, row, column;

  T operator()(Index i, Index k) const { return data[i * row + k * column]; }
};

namespace detail {

inline constexpr Index small = 64;  // elements of a right side that is kept on the stack

/// `right` (K, N) is contiguous; K and N are known to the compiler where they are not 0.
template <Index inner, Index columns, class T>
void rows_times(const Strided<T>& a, const T* right, Index depth, Index width, T* out) {
  const Index k_end = inner > 0 ? inner : depth, n = columns > 0 ? columns : width;
  for (Index i = 0; i < a.rows; ++i, out += n) {
    const T first = a(i, 0);
    for (Index j = 0; j < n; ++j) out[j] = first * right[j];
    for (Index k = 1; k < k_end; ++k) {
      const T factor = a(i, k);
      for (Index j = 0; j < n; ++j) out[j] += factor * right[k * n + j];
    }
  }
}

}  // namespace detail

/// out (M, N), contiguous, = a (M, K) b (K, N).
template <class T>
void multiply(const Strided<T>& a, const Strided<T>& b, T* out) {
  const Index depth = b.rows, width = b.columns;
  if (depth == 0) {
    std::fill_n(out, a.rows * width, T{});
    return;
  }
  T kept[detail::small];
  std::vector<T> more;
  const T* right = b.data;
  if (!(b.column == 1 && b.row == width)) {
    T* copy = kept;
    if (depth * width > detail::small) {
      more.resize(static_cast<std::size_t>(depth * width));
      copy = more.data();
    }
    for (Index k = 0; k < depth; ++k)
      for (Index j = 0; j < width; ++j) copy[k * width + j] = b(k, j);
    right = copy;
  }
  if (depth == 3 && width == 3) {
    detail::rows_times<3, 3>(a, right, depth, width, out);
  } else if (depth == 4 && width == 4) {
    detail::rows_times<4, 4>(a, right, depth, width, out);
  } else if (width == 1) {
    detail::rows_times<0, 1>(a, right, depth, width, out);
  } else {
    detail::rows_times<0, 0>(a, right, depth, width, out);
  }
}

}  // namespace cabinpose
