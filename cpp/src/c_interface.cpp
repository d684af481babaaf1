// The C interface (burrlab.h): handles, sizes of structs, and no exception across the border.
#include <cstring>
#include <memory>
#include <string>

#include "burrlab.h"
#include "burrlab/bone_view.hpp"
#include "burrlab/burrlab.hpp"
#include "burrlab/flat_file.hpp"
#include "require.hpp"

using namespace burrlab;

// Each is given to one thread at a time.
struct burrlab_bone {
  std::shared_ptr<VoxelBone> bone;
  std::string error;
};
struct burrlab_burr {
  HostBurr burr;
  std::string error;
};
struct burrlab_view {
  BoneView view;
  BoneView::Changes changes;
  std::string error;
};

namespace {

/// Runs `work`; returns its status, with the sentence of an exception in `error`.
template <class Work>
int without_exception(std::string& error, Work work) noexcept {
  try {
    work();
    return BURRLAB_OK;
  } catch (const std::exception& failure) {
    try {
      error = failure.what();
    } catch (...) {  // no memory for the sentence
      error.clear();
    }
    return dynamic_cast<const std::invalid_argument*>(&failure) ? BURRLAB_REFUSED : BURRLAB_SYSTEM;
  }
}

template <class Handle, class Work>
int on(Handle* handle, Work work) noexcept {
  return handle ? without_exception(handle->error, [&] { work(*handle); }) : BURRLAB_REFUSED;
}

/// A handle that `make` returns, or null with the sentence in `error`.
template <class Make>
auto* handle_of(std::string& error, Make make) noexcept {
  decltype(make()) handle = nullptr;
  without_exception(error, [&] { handle = make(); });
  return handle;
}

template <class Type>
Type* not_null(Type* pointer, const char* name) {
  if (!pointer) throw InvalidArgument(std::string(name) + " must not be null");
  return pointer;
}

template <class Struct>
void check_struct(const Struct* given, const char* name) {
  if (not_null(given, name)->size != sizeof *given)
    refuse(std::string("size of ") + name, std::to_string(sizeof *given), given->size);
}

void check_count(const VoxelBone& bone, std::size_t count) {
  const auto voxels = std::size_t(product(bone.shape()));
  if (count != voxels)
    refuse("count of levels", "the number of voxels, " + std::to_string(voxels), double(count));
}

template <class Make>
burrlab_bone* bone_of(char* error, std::size_t error_size, Make make) noexcept {
  std::string sentence;
  burrlab_bone* handle =
      handle_of(sentence, [&] { return new burrlab_bone{std::make_shared<VoxelBone>(make()), {}}; });
  if (!handle && error && error_size) {
    const std::size_t length = std::min(sentence.size(), error_size - 1);
    std::memcpy(error, sentence.data(), length);
    error[length] = 0;
  }
  return handle;
}

Vec3 vector_of(const double (&v)[3]) { return {v[0], v[1], v[2]}; }

}  // namespace

std::uint32_t burrlab_abi_version(void) { return BURRLAB_ABI_VERSION; }
const char* burrlab_version(void) { return BURRLAB_VERSION; }

burrlab_bone* burrlab_bone_create(const burrlab_grid* grid, const std::uint8_t* levels, std::size_t count,
                                  char* error, std::size_t error_size) {
  return bone_of(error, error_size, [&] {
    check_struct(grid, "grid");
    const Index3 shape{grid->shape[0], grid->shape[1], grid->shape[2]};
    VoxelBone bone(shape, std::uint8_t(levels ? 0 : 255), vector_of(grid->spacing), vector_of(grid->origin));
    if (levels) {
      check_count(bone, count);
      bone.write({0, 0, 0}, shape, levels);
    }
    return bone;
  });
}

burrlab_bone* burrlab_bone_open(const char* path, char* error, std::size_t error_size) {
  return bone_of(error, error_size,
                 [&] { return read_bone(std::filesystem::u8path(not_null(path, "path"))); });
}

void burrlab_bone_destroy(burrlab_bone* bone) { delete bone; }
const char* burrlab_bone_error(const burrlab_bone* bone) {
  return bone ? bone->error.c_str() : "bone must not be null";
}

int burrlab_bone_save(burrlab_bone* bone, const char* path) {
  return on(bone, [&](burrlab_bone& b) {
    const VoxelBone::Reading reading(*b.bone);
    write_bone(std::filesystem::u8path(not_null(path, "path")), *b.bone);
  });
}

int burrlab_bone_grid(burrlab_bone* bone, burrlab_grid* grid) {
  return on(bone, [&](burrlab_bone& b) {
    check_struct(grid, "grid");
    for (std::size_t axis = 0; axis < 3; ++axis) {
      grid->shape[axis] = std::int32_t(b.bone->shape()[axis]);
      grid->spacing[axis] = b.bone->spacing()[Eigen::Index(axis)];
      grid->origin[axis] = b.bone->origin()[Eigen::Index(axis)];
    }
  });
}

int burrlab_bone_read(burrlab_bone* bone, int pristine, std::uint8_t* levels, std::size_t count) {
  return on(bone, [&](burrlab_bone& b) {
    check_count(*b.bone, count);
    const VoxelBone::Reading reading(*b.bone);
    b.bone->read({0, 0, 0}, b.bone->shape(), pristine != 0, not_null(levels, "levels"));
  });
}

int burrlab_bone_restore(burrlab_bone* bone, const std::uint8_t* levels, std::size_t count) {
  return on(bone, [&](burrlab_bone& b) {
    check_count(*b.bone, count);
    b.bone->restore(not_null(levels, "levels"));
  });
}

int burrlab_bone_reset(burrlab_bone* bone) {
  return on(bone, [](burrlab_bone& b) { b.bone->reset(); });
}

int burrlab_bone_removed(burrlab_bone* bone, double* removed) {
  return on(bone, [&](burrlab_bone& b) { *not_null(removed, "removed") = b.bone->removed(); });
}

int burrlab_bone_digest(burrlab_bone* bone, char digest[33]) {
  return on(bone,
            [&](burrlab_bone& b) { std::memcpy(not_null(digest, "digest"), b.bone->digest().c_str(), 33); });
}

int burrlab_burr_defaults(burrlab_burr_settings* settings, const char* material) {
  std::string error;
  return without_exception(error, [&] {
    check_struct(settings, "settings");
    const Material& constants = paper_material(not_null(material, "material"));
    const HostSettings host;
    const double radius = settings->radius;
    *settings = {sizeof *settings,        host.index,      radius,
                 constants.c_e,           constants.alpha, constants.force_exponent,
                 constants.rate_exponent, "parabolic",     {},
                 host.longest_tick,       host.seed,       0};
    std::copy(host.to_bone.begin(), host.to_bone.end(), settings->to_bone);
  });
}

burrlab_burr* burrlab_burr_create(burrlab_bone* bone, const burrlab_burr_settings* settings) {
  if (!bone) return nullptr;
  return handle_of(bone->error, [&] {
    check_struct(settings, "settings");
    const burrlab_burr_settings& s = *settings;
    const auto& tissues = bone->bone->tissues();
    const Material material =
        tissues ? tissues->table().material()
                : Material("host's", s.c_e, s.alpha, Shape::parse(not_null(s.shape, "shape")), "",
                           s.force_exponent, s.rate_exponent);
    HostSettings host;
    std::copy(s.to_bone, s.to_bone + 12, host.to_bone.begin());
    host.longest_tick = s.longest_tick;
    host.seed = s.seed;
    host.index = s.index;
    auto* handle = new burrlab_burr{HostBurr(bone->bone, Burr(s.radius), material, host), {}};
    handle->burr.contact().tick = s.tick;
    return handle;
  });
}

void burrlab_burr_destroy(burrlab_burr* burr) { delete burr; }
const char* burrlab_burr_error(const burrlab_burr* burr) {
  return burr ? burr->error.c_str() : "burr must not be null";
}

int burrlab_burr_step(burrlab_burr* burr, const burrlab_motion* motion, burrlab_feel* feel) {
  return on(burr, [&](burrlab_burr& b) {
    check_struct(feel, "feel");
    *feel = {sizeof *feel, 0, {}, {}, 0.0, 0.0, b.burr.contact().tick};
    check_struct(motion, "motion");
    const HostForce now =
        b.burr.step(vector_of(motion->center), motion->dt, motion->on != 0, vector_of(motion->reference));
    if (now.refused) throw InvalidArgument(now.refused);
    const Contact& last = b.burr.last();
    *feel = {sizeof *feel,
             last.touching,
             {now.force[0], now.force[1], now.force[2]},
             {now.torque[0], now.torque[1], now.torque[2]},
             last.penetration,
             now.removed,
             b.burr.contact().tick};
  });
}

int burrlab_burr_lift(burrlab_burr* burr, std::uint64_t tick) {
  return on(burr, [&](burrlab_burr& b) {
    b.burr.lift();
    b.burr.contact().tick = tick;
  });
}

burrlab_view* burrlab_view_create(burrlab_bone* bone) {
  if (!bone) return nullptr;
  return handle_of(bone->error, [&] { return new burrlab_view{BoneView(*bone->bone), {}, {}}; });
}

void burrlab_view_destroy(burrlab_view* view) { delete view; }
const char* burrlab_view_error(const burrlab_view* view) {
  return view ? view->error.c_str() : "view must not be null";
}

int burrlab_view_update(burrlab_view* view, burrlab_changes* changes) {
  return on(view, [&](burrlab_view& v) {
    check_struct(changes, "changes");
    v.view.update(v.changes);
    const BoneView::Changes& now = v.changes;
    const auto voxels = [](const std::vector<Index3>& all) { return all.empty() ? nullptr : all[0].data(); };
    *changes = {sizeof *changes,    std::uint32_t(now.bricks.size()),
                voxels(now.places), now.levels.data(),
                now.opened.size(),  voxels(now.opened),
                now.filled.size(),  voxels(now.filled)};
  });
}
