// Structs that kernels take from Python, field by field and by name: two of a type cannot be swapped.
#pragma once

#include <tuple>

/// Lists all fields of a struct, in the struct itself. Any Python object will do that has attributes of these names and types,
/// see bind.hpp.
#define CABINPOSE_FIELDS(Struct, ...)                 \
  static constexpr char struct_name[] = #Struct;      \
  static constexpr char field_names[] = #__VA_ARGS__; \
  auto fields() { return std::tie(__VA_ARGS__); }
