// How cloth lies on the skin at rest: evened, stretched over hollows, hanging from what stands out; and the refined mesh of it.
#pragma once

#include "core/array.hpp"
#include "core/fields.hpp"

namespace cabinpose {

/// The graph of a mesh: the neighbours of vertex v are near[start[v]] to near[start[v + 1] - 1].
struct Neighbours {
  Array<const std::int32_t, any> start;
  Array<const std::int32_t, any> near;

  CABINPOSE_FIELDS(Neighbours, start, near)
};

/// Vertices as weighted sums of others: row v has the parents start[v] to start[v + 1] - 1 (a sparse matrix in rows).
struct Blend {
  Array<const std::int32_t, any> start;
  Array<const std::int32_t, any> parent;
  Array<const float, any> weight;

  CABINPOSE_FIELDS(Blend, start, parent, weight)
};

/// Laplacian smoothing of points (V, 3) in the order of the vertices (Gauss-Seidel), into `out` (V, 3).
///
/// share: (V,) of each step that is taken.
void relax(Array<const float, any, 3> points, const Neighbours& neighbours, Array<const float, any> share, int sweeps,
           Array<float, any, 3> out);

/// An elastic membrane over `under` (V, 3) m, into `out` (V, 3): it bridges hollows and rests on what stands out.
///
/// The obstacle problem by projected Gauss-Seidel: each vertex goes to the middle of its neighbours, but stays at least `gap` m
/// off its place on the body, along the normals there of the body evened by `evening` sweeps. mask: (V,) 1 inside the garment, 0
/// outside; cloth is pinned near its border and beyond.
void stretch(Array<const float, any, 3> under, Array<const std::int32_t, any, 3> faces, const Neighbours& neighbours,
             Array<const float, any> mask, float gap, int evening, int sweeps, Array<float, any, 3> out);

/// The skin's vertices (V, 3), moved, and the new ones of the seen mesh, with unit normals, into `vertices` and `normals`
/// (V + N, 3): the new ones bulge as the surface does.
///
/// Phong tessellation (Boubekeur & Alexa 2008, eq. 2) with half of its shape, which is exact on a sphere.
void refine(Array<const float, any, 3> points, Array<const std::int32_t, any, 3> faces, const Blend& blend,
            Array<float, any, 3> vertices, Array<float, any, 3> normals);

/// Radius (N,) m of cloth hanging about an axis, for points at `down` (N,) m along it, `radius` (N,) m off it, at `angle` (N,)
/// rad, -pi .. pi.
///
/// Going down, the radius shrinks by no more than `narrowing` (S,) m/m, one for each sector of the turn, from what stands out
/// above.
void hang(Array<const double, any> down, Array<const double, any> radius, Array<const double, any> angle,
          Array<const double, any> narrowing, Array<double, any> out);

/// Where a ball of radius `ball` m that rolls along rays, from `origin` (n, m, 3) m in unit `direction` (n, m, 3), is last held
/// up by points (P, 3) m: how far out it touches, `radius` (n, m) m, below 0 where it meets none, and the point it touches,
/// `touched` (n, m).
void roll_ball(Array<const double, any, 3> points, Array<const double, any, any, 3> origin,
               Array<const double, any, any, 3> direction, double ball, Array<double, any, any> radius,
               Array<std::int64_t, any, any> touched);

}  // namespace cabinpose
