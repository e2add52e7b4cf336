// Vectors and 3 x 3 matrices of float64, as values: for kernels that work on one pose, not for loops over pixels.
#pragma once

#include <cmath>

#include "core/array.hpp"

namespace cabinpose {

struct Vec3 {
  double x = 0.0, y = 0.0, z = 0.0;

  double& operator[](int i) { return (&x)[i]; }
  double operator[](int i) const { return (&x)[i]; }
};

inline Vec3 operator+(Vec3 a, Vec3 b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vec3 operator-(Vec3 a, Vec3 b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Vec3 operator*(double s, Vec3 a) { return {s * a.x, s * a.y, s * a.z}; }
inline double dot(Vec3 a, Vec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vec3 cross(Vec3 a, Vec3 b) { return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x}; }
inline double norm(Vec3 a) { return std::sqrt(dot(a, a)); }

/// The vector in three numbers that lie one after the other.
template <class T>
Vec3 vec3(const T* p) {
  return {static_cast<double>(p[0]), static_cast<double>(p[1]), static_cast<double>(p[2])};
}

struct Mat3 {
  double m[3][3] = {};

  double* operator[](int i) { return m[i]; }
  const double* operator[](int i) const { return m[i]; }
  Vec3 column(int j) const { return {m[0][j], m[1][j], m[2][j]}; }
};

/// The first three rows and columns of a matrix with rows of `stride` numbers.
inline Mat3 mat3(const double* p, int stride = 3) {
  Mat3 r;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) r[i][j] = p[i * stride + j];
  }
  return r;
}

inline Mat3 identity() { return {{{1.0, 0.0, 0.0}, {0.0, 1.0, 0.0}, {0.0, 0.0, 1.0}}}; }

inline Mat3 operator*(const Mat3& a, const Mat3& b) {
  Mat3 r;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) r[i][j] = a[i][0] * b[0][j] + a[i][1] * b[1][j] + a[i][2] * b[2][j];
  }
  return r;
}

inline Vec3 operator*(const Mat3& a, Vec3 b) {
  return {a[0][0] * b.x + a[0][1] * b.y + a[0][2] * b.z, a[1][0] * b.x + a[1][1] * b.y + a[1][2] * b.z,
          a[2][0] * b.x + a[2][1] * b.y + a[2][2] * b.z};
}

inline Mat3 transposed(const Mat3& a) {
  Mat3 r;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) r[i][j] = a[j][i];
  }
  return r;
}

}  // namespace cabinpose
