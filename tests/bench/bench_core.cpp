// The benchmark's library for ctypes: bones and burrs of the core on a chosen CPU path.

#include <algorithm>
#include <cstring>
#include <memory>
#include <utility>
#include <vector>

#include "anatomy/anatomy_watch.hpp"
#include "bench_lib.hpp"
#include "burrlab/burr_contact.hpp"
#include "burrlab/voxel_bone.hpp"
#include "cpu_path.hpp"

using namespace burrlab;
using namespace burrlab::bench;

namespace {

// A bone with one burr, and a watch if some of its structures are critical.
struct Core {
  std::shared_ptr<VoxelBone> bone;
  std::unique_ptr<BurrContact> contact;
  std::unique_ptr<AnatomyWatch> watch;

  Core(std::shared_ptr<VoxelBone> bone_, const Burr& burr, const Material& material, std::uint64_t seed,
       Scheme scheme, const std::string& path, std::uint64_t tick)
      : bone(std::move(bone_)) {
    use_cpu_path(path);
    contact = std::make_unique<BurrContact>(bone, burr, material, seed, 0, scheme);
    contact->tick = tick;
  }
};

// Makes a session's record for the watch.
void look(Core& core, const Vec3& center, const Contact& felt) {
  TickRecord record;
  record.index = felt.tick;
  record.burr[0].on = 1;
  for (int axis = 0; axis < 3; ++axis) {
    record.burr[0].center[axis] = center[axis];
    record.burr[0].force[axis] = felt.force[axis];
  }
  core.watch->after_step(*core.bone, record, 0);
}

// A structure whose field, with nodes 0.4 mm apart in the volume's box, is exact at every node.
WatchedStructure watched(const VoxelBone& bone, std::size_t tissue) {
  constexpr double spacing = 0.4;
  Index3 nodes;
  std::size_t count = 1;
  for (int axis = 0; axis < 3; ++axis) {
    nodes[axis] = std::int64_t(double(bone.shape()[axis]) * bone.spacing()[2 - axis] / spacing) + 2;
    count *= std::size_t(nodes[axis]);
  }
  const StructureSearch search(bone, tissue);
  const std::vector<float> unknown(count, 0.0f);
  return {std::make_shared<StructureDistance>(
              DistanceField(search, nodes, unknown.data(), spacing, bone.origin(), 1e3)),
          {}};
}

}  // namespace

extern "C" {

// `density` may be null: equal to pristine.
Core* core_new(const std::int64_t* shape, const std::uint8_t* pristine, const std::uint8_t* density,
               double spacing, const double* origin, double radius, double c_e, double alpha, int layer,
               std::uint64_t seed, const char* path, std::uint64_t tick) {
  return guarded([&] {
    std::vector<std::uint8_t> levels(pristine, pristine + shape[0] * shape[1] * shape[2]);
    auto bone =
        std::make_shared<VoxelBone>(index3(shape), std::move(levels), Vec3::Constant(spacing), vec3(origin));
    if (density) bone->restore(density);
    bone->write_pages();  // as a session does before its first tick
    return new Core(std::move(bone), Burr(radius), Material("bone", c_e, alpha, Shape::parabolic(), ""), seed,
                    layer ? Scheme::layer : Scheme::cell, path, tick);
  });
}

Core* core_clone(const Core* core, const char* path) {
  return guarded([&] {
    const BurrContact& c = *core->contact;
    return new Core(std::make_shared<VoxelBone>(*core->bone), c.burr(), c.material(), c.seed(), c.scheme(),
                    path, c.tick);
  });
}

void core_free(Core* core) { delete core; }

// Gives the bone `count` tissues of different c_e and its material's alpha, so that it is carved as without.
// The first `critical` are watched.
int core_set_tissues(Core* core, const std::uint8_t* numbers, int count, int critical) {
  return guarded([&] {
    const Material& material = core->contact->material();
    std::vector<Tissue> rows;
    for (int i = 0; i < count; ++i)
      rows.push_back(
          {std::to_string(i), i, material.c_e + i, material.alpha, {}, i < critical, false, false});
    core->bone->set_tissues(
        std::make_shared<TissueMap>(core->bone->shape(), numbers, Tissues(rows, material)));
    core->watch.reset();
    if (critical == 0) return 0;
    std::vector<WatchedStructure> structures;
    for (int i = 0; i < critical; ++i) structures.push_back(watched(*core->bone, std::size_t(i)));
    core->watch = std::make_unique<AnatomyWatch>(structures, std::vector{core->contact->burr().radius});
    core->watch->begin(*core->bone, core->contact->tick);
    return 0;
  });
}

int core_reset(Core* core) {
  return guarded([&] { return core->bone->reset(), 0; });
}

// n ticks at `centers` (n, 3), timed in batches of `batch`: seconds per tick (n / batch), interrupted (n /
// batch). moments (n, 4), m0 and m1 of each tick, or null.
int core_run(Core* core, const double* centers, std::int64_t n, double dt, std::int64_t batch,
             double* seconds, std::uint8_t* interrupted, double* moments) {
  return guarded([&] {
    for (std::int64_t first = 0; first < n; first += batch) {
      const Stopwatch watch;
      for (std::int64_t i = first; i < first + batch; ++i) {
        const Contact felt = core->contact->step(vec3(centers + 3 * i), dt, true);
        if (core->watch) look(*core, vec3(centers + 3 * i), felt);
        if (!moments) continue;
        moments[4 * i] = felt.m0;
        for (int axis = 0; axis < 3; ++axis) moments[4 * i + 1 + axis] = felt.m1[axis];
      }
      watch.stop(double(batch), seconds + first / batch, interrupted + first / batch);
    }
    return 0;
  });
}

int core_density(const Core* core, std::uint8_t* out) {
  return guarded([&] {
    const auto levels = core->bone->density();
    std::memcpy(out, levels.data(), levels.size());
    return 0;
  });
}

const char* core_digest(const Core* core) {
  static std::string digest;
  return guarded([&] { return (digest = core->bone->digest()).c_str(); });
}

std::int64_t core_hierarchy_bytes(const Core* core) {
  return static_cast<std::int64_t>(core->bone->hierarchy_bytes());
}
}
