// How the kernels' arguments come from Python: numpy arrays as `Array`, objects with named attributes as structs. For bindings
// alone.
//
// A struct with `CABINPOSE_FIELDS` is read from the attributes of any object; `describe` tells the stubs of it. One that goes to
// Python has `result()`, a tuple of what is told of it.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/tuple.h>

#include <algorithm>
#include <array>
#include <initializer_list>
#include <string>
#include <string_view>
#include <tuple>
#include <utility>
#include <vector>

#include "core/array.hpp"
#include "core/fields.hpp"

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
concept Named = requires(T t) { t.fields(); };

template <Named T>
inline constexpr std::size_t field_count = std::tuple_size_v<decltype(std::declval<T&>().fields())>;

/// Stands for a field of any type, to count those of a struct.
struct AnyField {
  template <class T>
  operator T() const;  // NOLINT: never called
};

/// Whether a struct can be made of N fields; of no more than it has.
template <class T, std::size_t... I>
constexpr bool takes_fields(std::index_sequence<I...>) {
  return requires { T{(static_cast<void>(I), AnyField{})...}; };
}

/// The names of a struct's fields, as Python's own strings.
template <Named T>
const std::array<PyObject*, field_count<T>>& field_names() {
  static const auto names = [] {
    std::array<PyObject*, field_count<T>> interned;
    std::string_view rest = T::field_names;
    for (PyObject*& name : interned) {
      const std::size_t end = std::min(rest.find(','), rest.size());
      name = PyUnicode_InternFromString(std::string(rest.substr(0, end)).c_str());
      rest.remove_prefix(std::min(end + 2, rest.size()));  // ", "
    }
    return interned;
  }();
  return names;
}

/// Tells tools/make_stubs.py of a struct: as a function that does nothing, whose parameters are the fields.
template <Named T>
void describe_one(nb::module_& m) {
  [&]<std::size_t... I, class... Fields>(std::index_sequence<I...>, std::tuple<Fields&...>*) {
    m.def(T::struct_name, [](const Fields&...) {}, nb::arg(PyUnicode_AsUTF8AndSize(field_names<T>()[I], nullptr))...);
  }(std::make_index_sequence<field_count<T>>{}, static_cast<decltype(std::declval<T&>().fields())*>(nullptr));
}

template <Named... T>
void describe(nb::module_& m) {
  (describe_one<T>(m), ...);
}

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

template <cabinpose::Named T>
struct type_caster<T, int> {
  NB_TYPE_CASTER(T, const_name(T::struct_name))

  static constexpr size_t count = cabinpose::field_count<T>;
  static_assert(cabinpose::takes_fields<T>(std::make_index_sequence<count>{}) &&
                    !cabinpose::takes_fields<T>(std::make_index_sequence<count + 1>{}),
                "CABINPOSE_FIELDS has to list every field of its struct");

  bool from_python(handle src, uint8_t flags, cleanup_list* cleanup) noexcept {
    PyObject* const* name = cabinpose::field_names<T>().data();
    return std::apply([&](auto&... field) { return (load(src, *name++, flags, cleanup, field) && ...); }, value.fields());
  }

 private:
  template <class Field>
  static bool load(handle src, PyObject* name, uint8_t flags, cleanup_list* cleanup, Field& field) noexcept {
    PyObject* attribute = PyObject_GetAttr(src.ptr(), name);
    if (attribute == nullptr) {
      PyErr_Clear();
      return false;
    }
    cleanup->append(attribute);  // kept until the call ends, even if the object made it for this call
    make_caster<Field> caster;
    if (!caster.from_python(attribute, flags, cleanup)) return false;
    field = caster.operator cast_t<Field>();
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
