// How the kernels' arguments come from Python: numpy arrays as `Array`, named tuples as structs. For bindings alone.
//
// A struct that stands for a named tuple has a member function `members()`, which ties its members in the tuple's order; one
// that goes to Python has `result()`, a tuple of what is told of it.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/tuple.h>

#include <algorithm>
#include <initializer_list>
#include <tuple>
#include <utility>
#include <vector>

#include "core/array.hpp"

namespace cabinpose {

namespace nb = nanobind;
using namespace nb::literals;

/// Kernels run without the interpreter's lock: `m.def("name", &kernel, "a"_a, ..., unlocked)`.
using unlocked = nb::call_guard<nb::gil_scoped_release>;

/// A new numpy array that takes over the elements of a vector. The interpreter's lock is held.
template <class T, Index... Dims>
nb::ndarray<nb::numpy, T, nb::shape<Dims...>, nb::c_contig> owned(std::vector<T> values,
                                                                  std::initializer_list<std::size_t> shape) {
  auto* kept = new std::vector<T>(std::move(values));
  nb::capsule owner(kept, [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
  return {kept->data(), shape, owner};
}

template <class T>
concept NamedTuple = requires(T t) { t.members(); };

template <class T>
concept Result = requires(const T& t) { t.result(); };

}  // namespace cabinpose

namespace nanobind::detail {

template <class T, cabinpose::Index... Dims>
struct type_caster<cabinpose::Array<T, Dims...>> {
  using Borrowed = make_caster<ndarray<T, numpy, shape<Dims...>, c_contig, device::cpu>>;
  using Seen = cabinpose::Array<T, Dims...>;
  NB_TYPE_CASTER(Seen, Borrowed::Name)

  bool from_python(handle src, uint8_t flags, cleanup_list* cleanup) noexcept {
    Borrowed borrowed;
    // No conversion: what a kernel writes must reach the caller, and what it reads is not copied unseen.
    if (!borrowed.from_python(src, static_cast<uint8_t>(flags & ~static_cast<uint8_t>(cast_flags::convert)), cleanup))
      return false;
    std::array<cabinpose::Index, sizeof...(Dims)> extents;
    for (size_t k = 0; k < sizeof...(Dims); ++k) extents[k] = static_cast<cabinpose::Index>(borrowed.value.shape(k));
    value = Value(borrowed.value.data(), extents);  // the caller's reference keeps the memory alive during the call
    return true;
  }
};

template <cabinpose::NamedTuple T>
struct type_caster<T, int> {
  NB_TYPE_CASTER(T, const_name("tuple[object, ...]"))

  bool from_python(handle src, uint8_t flags, cleanup_list* cleanup) noexcept {
    if (!PyTuple_Check(src.ptr())) return false;
    auto members = value.members();
    constexpr size_t count = std::tuple_size_v<decltype(members)>;
    if (PyTuple_Size(src.ptr()) != static_cast<Py_ssize_t>(count)) return false;
    return load(src, flags, cleanup, members, std::make_index_sequence<count>{});
  }

 private:
  template <class Members, size_t... I>
  static bool load(handle src, uint8_t flags, cleanup_list* cleanup, Members& members, std::index_sequence<I...>) noexcept {
    return (load_one(PyTuple_GetItem(src.ptr(), I), flags, cleanup, std::get<I>(members)) && ...);
  }

  template <class Member>
  static bool load_one(handle item, uint8_t flags, cleanup_list* cleanup, Member& member) noexcept {
    make_caster<Member> caster;
    if (!caster.from_python(item, flags, cleanup)) return false;
    member = caster.operator cast_t<Member>();
    return true;
  }
};

template <class T, cabinpose::Index Width>
struct type_caster<cabinpose::Grown<T, Width>> {
  static constexpr bool flat = Width == 1;
  using Made = make_caster<
      std::conditional_t<flat, ndarray<T, numpy, shape<-1>, c_contig>, ndarray<T, numpy, shape<-1, Width>, c_contig>>>;
  using Grown = cabinpose::Grown<T, Width>;
  NB_TYPE_CASTER(Grown, Made::Name)

  static handle from_cpp(Grown&& grown, rv_policy policy, cleanup_list* cleanup) noexcept {
    auto* kept = new Grown(std::move(grown));
    const capsule owner(kept, [](void* p) noexcept { delete static_cast<Grown*>(p); });
    const size_t extents[] = {kept->size() / Width, Width};
    return Made::from_cpp({kept->data(), flat ? 1u : 2u, extents, owner}, policy, cleanup);
  }
};

template <cabinpose::Result T>
struct type_caster<T, int> {
  using Tuple = make_caster<decltype(std::declval<const T&>().result())>;
  NB_TYPE_CASTER(T, Tuple::Name)

  static handle from_cpp(const T& found, rv_policy policy, cleanup_list* cleanup) noexcept {
    return Tuple::from_cpp(found.result(), policy, cleanup);
  }
};

}  // namespace nanobind::detail
