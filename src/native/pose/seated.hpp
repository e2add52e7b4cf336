// A trunk and thighs that sink into a seat's foam, until the skin is as deep in it as it should be.
#pragma once

#include "body/kinematics.hpp"

namespace cabinpose {

/// Skin that meets a seat, and the seat, in the seat's frame: `synth.posture.seat_fit.Foam`, which says what each field holds.
struct Foam {
  Array<const double, rig::n_dofs> q;
  Array<const std::uint8_t, any, any> skin_index;
  Array<const float, any, any> skin_weight;
  Array<const float, any, 3> rest;
  Index n_back;
  Array<const bool, any> thigh;
  Array<const double, 3> normal, up, cushion;
  double free_cushion, behind, sunk, thighs_sunk, size, femur;
  bool slides;

  CABINPOSE_FIELDS(Foam, q, skin_index, skin_weight, rest, n_back, thigh, normal, up, cushion, free_cushion, behind, sunk,
                   thighs_sunk, size, femur, slides)
};

/// Sink into the foam, a number of rounds: `state` is pitch of the pelvis, angle of the thighs (rad), place of the root (m).
void sink(const RestArrays& rest, const Foam& foam, int rounds, Array<double, 5> state);

}  // namespace cabinpose
