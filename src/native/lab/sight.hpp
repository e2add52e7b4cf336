// What hides markers from the cameras of an optical system: triangles between them.
#pragma once

#include "core/array.hpp"

namespace cabinpose {

/// Into `possible` (F,): faces (F, 3) of vertices (V, 3) m that may come between one of the eyes (N, 3) and a point within the
/// hull of points (P, 3).
void faces_between(Array<const double, any, 3> eyes, Array<const double, any, 3> points, Array<const float, any, 3> vertices,
                   Array<const std::int32_t, any, 3> faces, Array<bool, any> possible);

/// Into `seen` (N, M): which eyes (N, 3) see which markers (M, 3). Rays against triangles (Moeller & Trumbore 1997); each ends
/// `ends` m before its marker. All in one frame, m.
void see_markers(Array<const double, any, 3> eyes, Array<const double, any, 3> markers, Array<const float, any, 3> vertices,
                 Array<const std::int32_t, any, 3> faces, double ends, Array<bool, any, any> seen);

}  // namespace cabinpose
