#include "raster/render.hpp"

#include <algorithm>
#include <vector>

#include "raster/lanes.hpp"
#include "raster/shading.hpp"

namespace cabinpose {
namespace {

/// Memory of a thread, reused from frame to frame.
struct Workspace {
  std::vector<Corner> corners;
  std::vector<std::int32_t> before;
  DrawMemory drawing;
  std::vector<std::uint8_t> bent;
  Triangles triangles;
  Appearances appearances;
  std::vector<BlockHits> hits;
  std::vector<BlockRays> part_rays;
  JointRays joints;
};

template <class T>
T* room(std::vector<T>& memory, Index count) {
  const auto size = static_cast<std::size_t>(count);
  if (memory.size() < size) memory.resize(std::max(size, memory.size() * 3 / 2));
  return memory.data();
}

}  // namespace

Index render(const Surface& surface, Array<const double, 4, 4> camera_from_vehicle, bool closed, const Eye& eye,
             const Joints& joints, const Rendered& frame) {
  const Buffers& buffers = frame.buffers;
  thread_local Workspace memory;
  const Grid grid(eye.width, eye.height);
  const Pose pose(camera_from_vehicle);
  const Lens& lens = eye.lens;
  const double reach = (eye.supersample - 1) / (2.0 * eye.supersample);
  const int per_pixel = eye.supersample * eye.supersample;
  const auto* rays = reinterpret_cast<const BlockRays*>(eye.rays.data());
  const Index blocks = grid.blocks();

  Corner* corners = room(memory.corners, surface.vertices.size() + lanes);
  project(surface.vertices, pose, lens, corners);
  JointRays* joint_rays = memory.joints.start(joints, lens, eye.width, eye.height) ? &memory.joints : nullptr;
  BlockHits* hits = room(memory.hits, blocks);
  const View view{surface, corners, pose, lens, eye.looks, closed, eye.width, eye.height, reach};
  rasterise(view, grid, rays, hits, memory.triangles, joint_rays, memory.drawing);
  memory.joints.decide(surface, frame.visibility);

  memory.appearances.start(memory.triangles);
  memory.appearances.make(hits, blocks, memory.triangles, surface);
  const Samples centre{buffers.depth_m.data(), buffers.cos_incidence.data(), buffers.material.data()};
  shade_pixels(grid, rays, hits, memory.appearances.data(), pose, centre,
               {frame.depth_clean.data(), frame.labels.data(), frame.instance.data(), frame.face_id.data()});

  std::int32_t* before =
      room(memory.before, static_cast<Index>((eye.height + strip_rows - 1) / strip_rows + spare_strips) * eye.width);
  std::int32_t* mixed = buffers.mixed.data();
  const bool looks_through = memory.triangles.looks_through;
  const Index number =
      find_mixed(grid, centre.depth, centre.cosine, centre.material, eye.looks, looks_through, static_cast<Which>(eye.which),
                 per_pixel, before, mixed, room(memory.bent, static_cast<Index>(strip_rows) * eye.width));
  const Index samples = number * per_pixel, part_blocks = (samples + lanes - 1) / lanes;
  BlockRays* part_rays = room(memory.part_rays, part_blocks);
  take_rays(mixed, number, eye.part_rays, part_rays);
  hits = room(memory.hits, part_blocks);
  refine(view, memory.triangles, before, part_blocks, part_rays, hits, memory.drawing);
  memory.appearances.make(hits, part_blocks, memory.triangles, surface);
  const Samples parts{buffers.parts_depth_m.data(), buffers.parts_cos_incidence.data(), buffers.parts_material.data()};
  shade_samples(samples, part_rays, hits, memory.appearances.data(), pose, parts);

  // Pixels whose centre shows what is looked through take what the part there sees.
  const int centre_part = eye.supersample / 2 * (eye.supersample + 1);
  for (Index k = 0; looks_through && k < number; ++k) {
    const Index i = mixed[k], j = k * per_pixel + centre_part;
    if (!(eye.looks[centre.material[i]] & looked_through)) continue;
    centre.depth[i] = parts.depth[j];
    centre.cosine[i] = parts.cosine[j];
    centre.material[i] = parts.material[j];
  }
  return number;
}

}  // namespace cabinpose
