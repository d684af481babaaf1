#include <cstring>

#include "bindings.hpp"
#include "burrlab/check.hpp"
#include "burrlab/voxel_bone.hpp"

namespace py = pybind11;
using burrlab::brick_voxels;
using burrlab::VoxelBone;

namespace {

using Numbers = py::array_t<std::uint32_t, py::array::c_style>;
using Levels = py::array_t<std::uint8_t, py::array::c_style>;

void check_numbers(const VoxelBone& bone, const Numbers& bricks) {
  if (bricks.ndim() != 1) burrlab::refuse("dimensions of bricks", "1", double(bricks.ndim()));
  for (py::ssize_t i = 0; i < bricks.size(); ++i)
    if (bricks.at(i) >= bone.brick_count())
      burrlab::refuse("brick", "below " + std::to_string(bone.brick_count()), double(bricks.at(i)));
}

Numbers take_changed(VoxelBone& bone) {
  std::vector<std::uint32_t> bricks;
  {
    const py::gil_scoped_release release;
    const VoxelBone::Changing changing(bone);
    bricks = bone.take_changed();
  }
  return Numbers(py::ssize_t(bricks.size()), bricks.data());
}

Levels read_bricks(const VoxelBone& bone, const Numbers& bricks) {
  check_numbers(bone, bricks);
  const VoxelBone::Reading reading(bone);
  Levels out({bricks.size(), py::ssize_t{brick_voxels}});
  std::uint8_t* to = out.mutable_data();
  for (py::ssize_t i = 0; i < bricks.size(); ++i)
    std::memcpy(to + i * brick_voxels, bone.tile(bricks.at(i)), brick_voxels);
  return out;
}

// All is checked before anything is written.
void restore_bricks(VoxelBone& bone, const Numbers& bricks, const Levels& density) {
  check_numbers(bone, bricks);
  if (density.ndim() != 2 || density.shape(0) != bricks.size() || density.shape(1) != brick_voxels)
    throw std::invalid_argument("density must have shape (n, 512), a row a brick");
  const VoxelBone::Changing changing(bone);
  std::uint8_t before[brick_voxels], pristine[brick_voxels];
  for (py::ssize_t i = 0; i < bricks.size(); ++i) {
    bone.read_brick(bricks.at(i), before, pristine);
    for (int j = 0; j < brick_voxels; ++j)
      if (density.at(i, j) > pristine[j])
        burrlab::refuse("density of a brick", "at most its pristine level", density.at(i, j));
  }
  for (py::ssize_t i = 0; i < bricks.size(); ++i) {
    bone.read_brick(bricks.at(i), before, pristine);
    bone.write_brick(bricks.at(i), density.data(i, 0), pristine);
  }
}

}  // namespace

void bind_bricks(py::module_& m) {
  m.def("take_changed_bricks", &take_changed, py::arg("bone"),
        "Numbers of the bricks that changed since the last call, in order, (n,) uint32. For a bone with one "
        "consumer.");
  m.def("read_bricks", &read_bricks, py::arg("bone"), py::arg("bricks"),
        "Levels now of bricks by number, copied, (n, 512) uint8, zeros beyond the volume. ValueError if a "
        "number is none.");
  m.def("restore_bricks", &restore_bricks, py::arg("bone"), py::arg("bricks"), py::arg("density"),
        "Sets the levels now of bricks, (n, 512) uint8, and keeps the pristine ones. ValueError if a number "
        "is none or a level above the pristine one; nothing is written then.");
}
