#include "core/bind.hpp"

namespace cabinpose {

void bind_pose_limbs(nb::module_& m);
void bind_pose_room(nb::module_& m);

void bind_pose(nb::module_& m) {
  bind_pose_limbs(m);
  bind_pose_room(m);
}

}  // namespace cabinpose
