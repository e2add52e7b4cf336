#include "body/cloth.hpp"
#include "body/folds.hpp"
#include "body/kinematics.hpp"
#include "body/skinning.hpp"
#include "core/bind.hpp"

namespace cabinpose {

void bind_body(nb::module_& m) {
  describe<RestArrays, Neighbours, Blend, Trains>(m);
  m.def("bone_frames", &bone_frames, "q"_a, "rest"_a, "vehicle_from_root"_a, "rotation"_a, "position"_a, unlocked(),
        "Frames of the main bones.");
  m.def("joint_positions", &joint_positions, "rest"_a, "rotation"_a, "position"_a, "out"_a, unlocked(), "The 20 joints, m.");
  m.def("end_frames", &end_frames, "rest"_a, "rotation"_a, "position"_a, nb::kw_only(), "palms"_a, "soles"_a, unlocked(),
        "Frames of palms and soles.");
  m.def("skin_transforms", &skin_transforms, "q"_a, "rest"_a, "rotation"_a, "position"_a, "out"_a, unlocked(),
        "What skinning applies to the mesh at rest.");
  m.def("pose", &pose, "q"_a, "rest"_a, "vehicle_from_root"_a, "rotation"_a, "position"_a, "vehicle_from_mesh"_a, "joints"_a,
        nb::kw_only(), "palms"_a, "soles"_a, unlocked(), "Bones, joints, palms, soles and skin transforms of a posture.");
  m.def("blend_shapes", &blend_shapes, "mean"_a, "basis"_a, "coefficients"_a, "out"_a, unlocked(), "A body at rest.");
  m.def("skin_layers", &skin_layers, "transforms"_a, "index"_a, "weight"_a, "layers"_a, "out"_a, unlocked(),
        "Layers of a mesh at rest, posed by linear blend skinning.");
  m.def("vertex_normals", &vertex_normals, "vertices"_a, "faces"_a, "out"_a, unlocked(),
        "Unit normals of vertices, weighted by area.");
  m.def("relax", &relax, "points"_a, "neighbours"_a, "share"_a, "sweeps"_a, "out"_a, unlocked(), "Laplacian smoothing.");
  m.def("stretch", &stretch, "under"_a, "faces"_a, "neighbours"_a, "mask"_a, nb::kw_only(), "gap"_a, "evening"_a, "sweeps"_a,
        "out"_a, unlocked(), "An elastic membrane over a body.");
  m.def("refine", &refine, "points"_a, "faces"_a, "blend"_a, nb::kw_only(), "vertices"_a, "normals"_a, unlocked(),
        "The seen mesh and its normals, rounded.");
  m.def("hang", &hang, nb::kw_only(), "down"_a, "radius"_a, "angle"_a, "narrowing"_a, "out"_a, unlocked(),
        "Radius of cloth hanging about an axis.");
  m.def("roll_ball", &roll_ball, "points"_a, nb::kw_only(), "origin"_a, "direction"_a, "ball"_a, "radius"_a, "touched"_a,
        unlocked(), "How far out along rays a ball rolls on points, and which of them it touches.");
  m.def("fill_noise", &fill_noise, "points"_a, "where"_a, "waves"_a, "phases"_a, "blend"_a, "out"_a, unlocked(),
        "Smooth noise at every seen vertex.");
  m.def("raise_folds", &raise_folds, "trains"_a, "noise"_a, "where"_a, "out"_a, unlocked(), "Height of folds.");
}

}  // namespace cabinpose
