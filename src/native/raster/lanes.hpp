// Eight samples, vertices or triangles at a time, in the vector registers that the build has: two of four lanes, or one of eight.
//
// Each operation is that of one lane eight times over, so results do not depend on the width of the registers. For source files
// of this room alone: nothing of it appears in a signature that another room sees.
#pragma once

#include <cstddef>
#include <cstdint>

namespace cabinpose {

inline constexpr int lanes = 8;

#ifdef __AVX2__
inline constexpr int register_lanes = 8;
#else
inline constexpr int register_lanes = 4;
#endif
inline constexpr int registers = lanes / register_lanes;

using FloatRegister = float __attribute__((vector_size(4 * register_lanes)));
using IntRegister = std::int32_t __attribute__((vector_size(4 * register_lanes)));
using FourFloats = float __attribute__((vector_size(16)));
using FourInts = std::int32_t __attribute__((vector_size(16)));

#define CABINPOSE_INLINE [[gnu::always_inline]] inline

/// A register's worth of an array, at any address. (A compiler may copy by `memcpy` in smaller pieces, through the stack.)
template <class Register>
struct [[gnu::packed, gnu::may_alias]] InMemory {
  Register value;
};

/// Eight values, a register's worth in each part. Built from one value, all lanes hold it.
template <class Value, class Register>
struct Lanes {
  Register part[registers];

  Lanes() = default;
  CABINPOSE_INLINE Lanes(Value value) {
    for (Register& p : part) p = value - Register{};  // not + 0, which would take the sign of -0
  }
};

using Floats = Lanes<float, FloatRegister>;     // float32
using Ints = Lanes<std::int32_t, IntRegister>;  // int32; as a mask, -1 where something holds and 0 where not

/// What a function gives for the number of each register.
template <class Result, class Function>
CABINPOSE_INLINE Result in_registers(const Function& function) {
  Result r;
  for (int i = 0; i < registers; ++i) r.part[i] = function(i);
  return r;
}

CABINPOSE_INLINE Floats load(const float* from) {
  return in_registers<Floats>([&](int i) { return reinterpret_cast<const InMemory<FloatRegister>*>(from)[i].value; });
}
CABINPOSE_INLINE Ints load(const std::int32_t* from) {
  return in_registers<Ints>([&](int i) { return reinterpret_cast<const InMemory<IntRegister>*>(from)[i].value; });
}
template <class Value, class Register>
CABINPOSE_INLINE void store(const Lanes<Value, Register>& value, Value* to) {
  for (int i = 0; i < registers; ++i) reinterpret_cast<InMemory<Register>*>(to)[i].value = value.part[i];
}

#define CABINPOSE_LANEWISE(RESULT, ARGUMENT, OPERATOR)                                \
  CABINPOSE_INLINE RESULT operator OPERATOR(const ARGUMENT& a, const ARGUMENT& b) {   \
    return in_registers<RESULT>([&](int i) { return a.part[i] OPERATOR b.part[i]; }); \
  }
CABINPOSE_LANEWISE(Floats, Floats, +)
CABINPOSE_LANEWISE(Floats, Floats, -)
CABINPOSE_LANEWISE(Floats, Floats, *)
CABINPOSE_LANEWISE(Floats, Floats, /)
CABINPOSE_LANEWISE(Ints, Floats, <)
CABINPOSE_LANEWISE(Ints, Floats, <=)
CABINPOSE_LANEWISE(Ints, Floats, >)
CABINPOSE_LANEWISE(Ints, Floats, >=)
CABINPOSE_LANEWISE(Ints, Floats, ==)
CABINPOSE_LANEWISE(Ints, Ints, +)
CABINPOSE_LANEWISE(Ints, Ints, -)
CABINPOSE_LANEWISE(Ints, Ints, &)
CABINPOSE_LANEWISE(Ints, Ints, |)
CABINPOSE_LANEWISE(Ints, Ints, ==)
CABINPOSE_LANEWISE(Ints, Ints, <<)
#undef CABINPOSE_LANEWISE

CABINPOSE_INLINE Ints operator~(const Ints& a) {
  return in_registers<Ints>([&](int i) { return ~a.part[i]; });
}

/// a where the mask is set, b elsewhere.
CABINPOSE_INLINE Floats select(const Ints& mask, const Floats& a, const Floats& b) {
  return in_registers<Floats>([&](int i) { return mask.part[i] ? a.part[i] : b.part[i]; });
}
CABINPOSE_INLINE Ints select(const Ints& mask, const Ints& a, const Ints& b) {
  return in_registers<Ints>([&](int i) { return mask.part[i] ? a.part[i] : b.part[i]; });
}

/// Whether a mask is set anywhere.
CABINPOSE_INLINE bool any_of(const Ints& mask) {
  IntRegister all = mask.part[0];
  for (int i = 1; i < registers; ++i) all |= mask.part[i];
  using Longs = std::int64_t __attribute__((vector_size(4 * register_lanes)));
  const Longs longs = reinterpret_cast<Longs>(all);
  std::int64_t found = 0;
  for (int i = 0; i < register_lanes / 2; ++i) found |= longs[i];
  return found != 0;
}

/// The lesser; b where one is NaN.
CABINPOSE_INLINE Floats min(const Floats& a, const Floats& b) { return select(a < b, a, b); }
/// The greater; b where one is NaN.
CABINPOSE_INLINE Floats max(const Floats& a, const Floats& b) { return select(a > b, a, b); }

CABINPOSE_INLINE Floats abs(const Floats& a) { return max(a, Floats(0.0f) - a); }

/// The whole part of values that fit.
CABINPOSE_INLINE Ints truncate(const Floats& a) {
  return in_registers<Ints>([&](int i) { return __builtin_convertvector(a.part[i], IntRegister); });
}
CABINPOSE_INLINE Floats as_floats(const Ints& a) {
  return in_registers<Floats>([&](int i) { return __builtin_convertvector(a.part[i], FloatRegister); });
}

/// The same 32 bits taken for another type.
CABINPOSE_INLINE Ints bits(const Floats& a) {
  return in_registers<Ints>([&](int i) { return reinterpret_cast<IntRegister>(a.part[i]); });
}
CABINPOSE_INLINE Floats from_bits(const Ints& a) {
  return in_registers<Floats>([&](int i) { return reinterpret_cast<FloatRegister>(a.part[i]); });
}

/// Store the first four lanes and the last four apart.
CABINPOSE_INLINE void store_halves(const Floats& value, float* low, float* high) {
#ifdef __AVX2__
  const FloatRegister v = value.part[0];
  reinterpret_cast<InMemory<FourFloats>*>(low)->value = __builtin_shufflevector(v, v, 0, 1, 2, 3);
  reinterpret_cast<InMemory<FourFloats>*>(high)->value = __builtin_shufflevector(v, v, 4, 5, 6, 7);
#else
  reinterpret_cast<InMemory<FourFloats>*>(low)->value = value.part[0];
  reinterpret_cast<InMemory<FourFloats>*>(high)->value = value.part[1];
#endif
}
CABINPOSE_INLINE void store_halves(const Ints& value, std::int32_t* low, std::int32_t* high) {
  store_halves(from_bits(value), reinterpret_cast<float*>(low), reinterpret_cast<float*>(high));
}

namespace detail {

/// Rows of four, one in each register or one in each of its halves, to columns; its own inverse.
CABINPOSE_INLINE void transpose(FloatRegister (&r)[4]) {
  const FloatRegister a = r[0], b = r[1], c = r[2], d = r[3];
#ifdef __AVX2__
  const FloatRegister ab_low = __builtin_shufflevector(a, b, 0, 8, 1, 9, 4, 12, 5, 13);
  const FloatRegister ab_high = __builtin_shufflevector(a, b, 2, 10, 3, 11, 6, 14, 7, 15);
  const FloatRegister cd_low = __builtin_shufflevector(c, d, 0, 8, 1, 9, 4, 12, 5, 13);
  const FloatRegister cd_high = __builtin_shufflevector(c, d, 2, 10, 3, 11, 6, 14, 7, 15);
  r[0] = __builtin_shufflevector(ab_low, cd_low, 0, 1, 8, 9, 4, 5, 12, 13);
  r[1] = __builtin_shufflevector(ab_low, cd_low, 2, 3, 10, 11, 6, 7, 14, 15);
  r[2] = __builtin_shufflevector(ab_high, cd_high, 0, 1, 8, 9, 4, 5, 12, 13);
  r[3] = __builtin_shufflevector(ab_high, cd_high, 2, 3, 10, 11, 6, 7, 14, 15);
#else
  const FloatRegister ab_low = __builtin_shufflevector(a, b, 0, 4, 1, 5), ab_high = __builtin_shufflevector(a, b, 2, 6, 3, 7);
  const FloatRegister cd_low = __builtin_shufflevector(c, d, 0, 4, 1, 5), cd_high = __builtin_shufflevector(c, d, 2, 6, 3, 7);
  r[0] = __builtin_shufflevector(ab_low, cd_low, 0, 1, 4, 5);
  r[1] = __builtin_shufflevector(ab_low, cd_low, 2, 3, 6, 7);
  r[2] = __builtin_shufflevector(ab_high, cd_high, 0, 1, 4, 5);
  r[3] = __builtin_shufflevector(ab_high, cd_high, 2, 3, 6, 7);
#endif
}

}  // namespace detail

/// Four values of 32 bits from each of eight places: column[j] holds value j of each.
CABINPOSE_INLINE void gather(const float* const (&row)[lanes], Floats (&column)[4]) {
  for (int i = 0; i < registers; ++i) {
    FloatRegister r[4];
    for (int j = 0; j < 4; ++j) {
      const FourFloats low = reinterpret_cast<const InMemory<FourFloats>*>(row[i * register_lanes + j])->value;
#ifdef __AVX2__
      const FourFloats high = reinterpret_cast<const InMemory<FourFloats>*>(row[j + 4])->value;
      r[j] = __builtin_shufflevector(low, high, 0, 1, 2, 3, 4, 5, 6, 7);
#else
      r[j] = low;
#endif
    }
    detail::transpose(r);
    for (int j = 0; j < 4; ++j) column[j].part[i] = r[j];
  }
}

/// The inverse of `gather`.
CABINPOSE_INLINE void scatter(const Floats (&column)[4], float* const (&row)[lanes]) {
  for (int i = 0; i < registers; ++i) {
    FloatRegister r[4];
    for (int j = 0; j < 4; ++j) r[j] = column[j].part[i];
    detail::transpose(r);
    for (int j = 0; j < 4; ++j) {
#ifdef __AVX2__
      const FourFloats low = __builtin_shufflevector(r[j], r[j], 0, 1, 2, 3),
                       high = __builtin_shufflevector(r[j], r[j], 4, 5, 6, 7);
      reinterpret_cast<InMemory<FourFloats>*>(row[j])->value = low;
      reinterpret_cast<InMemory<FourFloats>*>(row[j + 4])->value = high;
#else
      reinterpret_cast<InMemory<FourFloats>*>(row[i * register_lanes + j])->value = r[j];
#endif
    }
  }
}

}  // namespace cabinpose
