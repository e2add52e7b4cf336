// Arrays of numpy as the kernels see them: C-contiguous memory that the caller owns, with its shape.
//
// The shape is part of the type: `Array<const float, any, 3>` is an (N, 3) float32 array that is only read. Extents that are
// known cost nothing; the bindings refuse arrays of another type, shape or layout, and never copy.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace cabinpose {

using Index = std::ptrdiff_t;
inline constexpr Index any = -1;  // an extent that is known at run time only

template <class T, Index First, Index... Rest>
class Array {
 public:
  using Value = T;
  static constexpr std::size_t rank = 1 + sizeof...(Rest);
  static constexpr std::array<Index, rank> extents{First, Rest...};

  Array() = default;
  Array(T* data, const std::array<Index, rank>& shape) : data_(data), shape_(shape) {}
  /// An array whose extents are all known.
  explicit Array(T* data)
    requires(First != any && ((Rest != any) && ...))
      : data_(data), shape_(extents) {}
  /// An array can be read as one that may not be written.
  operator Array<const T, First, Rest...>() const { return {data_, shape_}; }

  Index size(std::size_t k = 0) const { return extents[k] == any ? shape_[k] : extents[k]; }
  const std::array<Index, rank>& shape() const { return shape_; }
  T* data() const { return data_; }
  /// Number of elements.
  Index count() const { return size(0) * row(); }

  /// An element.
  template <class... I>
  T& operator()(I... i) const {
    static_assert(sizeof...(I) == rank, "one index for each extent");
    const Index index[] = {static_cast<Index>(i)...};
    Index at = index[0];
    for (std::size_t k = 1; k < rank; ++k) at = at * size(k) + index[k];
    return data_[at];
  }

  /// The element, or the array, at an index of the first extent.
  decltype(auto) operator[](Index i) const {
    if constexpr (rank == 1) {
      return (data_[i]);
    } else {
      std::array<Index, rank - 1> rest{};
      for (std::size_t k = 1; k < rank; ++k) rest[k - 1] = size(k);
      return Array<T, Rest...>(data_ + i * row(), rest);
    }
  }

 private:
  Index row() const {
    Index n = 1;
    for (std::size_t k = 1; k < rank; ++k) n *= size(k);
    return n;
  }

  T* data_ = nullptr;
  std::array<Index, rank> shape_{};
};

/// Numbers whose count a kernel finds out: to Python a new array (N,), or (N, Width) of rows.
template <class T, Index Width = 1>
struct Grown : std::vector<T> {};

}  // namespace cabinpose
