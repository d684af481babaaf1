#include <cmath>
#include <variant>

#include "bone_bindings.hpp"
#include "burrlab/check.hpp"

namespace py = pybind11;
using burrlab::Index3;
using burrlab::Vec3;
using burrlab::VoxelBone;

namespace {

using Spacing = std::variant<double, Vec3>;

Vec3 to_vector(const Spacing& spacing) {
  if (const auto* one = std::get_if<double>(&spacing)) return Vec3::Constant(*one);
  return std::get<Vec3>(spacing);
}

// ValueError of the package, which knows what the machine has, for a bone that is too large.
void check_memory(const Index3& shape, double each) {
  const double voxels = double(shape[0]) * double(shape[1]) * double(shape[2]);
  if (voxels > 1e8) py::module_::import("burrlab.common.check").attr("check_bone")(voxels, each);
}

// A dense copy of a box of levels, (z, y, x).
py::array_t<std::uint8_t> levels_of(const VoxelBone& bone, const Index3& start, const Index3& shape,
                                    bool pristine) {
  bone.check_box(start, shape);
  py::array_t<std::uint8_t> out({shape[0], shape[1], shape[2]});
  std::uint8_t* to = out.mutable_data();
  const py::gil_scoped_release release;
  const VoxelBone::Reading reading(bone);
  bone.read(start, shape, pristine, to);
  return out;
}

py::array read_only(const VoxelBone& bone, bool pristine) {
  py::array out = levels_of(bone, {0, 0, 0}, bone.shape(), pristine);
  out.attr("flags").attr("writeable") = false;
  return out;
}

std::shared_ptr<VoxelBone> block(const Vec3& size, const Spacing& spacing, const Vec3& origin, int level) {
  const Vec3 s = to_vector(spacing);
  Index3 shape;
  for (int axis = 0; axis < 3; ++axis) {
    burrlab::require_positive("size", size[axis]);
    burrlab::require_positive("spacing", s[axis]);
    const double count = std::ceil(size[axis] / s[axis] - 1e-6);
    if (!(count < 1e6)) burrlab::refuse("voxels along a side", "below 1000000", count);
    shape[2 - axis] = static_cast<std::int64_t>(count);
  }
  if (level < 0 || level > 255) burrlab::refuse("level", "0 to 255", level);
  check_memory(shape, level > 0 ? 1.04 : 0.04);  // empty bricks take none but for their sums
  return std::make_shared<VoxelBone>(shape, static_cast<std::uint8_t>(level), s, origin);
}

}  // namespace

void bind_voxel_bone(py::module_& m) {
  VoxelBoneClass bone(m, "VoxelBone", R"(Bone as occupancy levels on a regular grid: 0 empty, 255 solid.

Two levels a voxel are kept: `density`, now, and `pristine`, as loaded or written. Outside the volume there is
nothing. Inside, levels lie in bricks of 8^3 voxels with exact sums of their mass and first moment; pristine levels
take memory only where erosion changed a brick that was not of one level.

Parameters
----------
density : ndarray, shape (nz, ny, nx)
    Any integer, float or bool type, finite, within `range`. Copied.
spacing : float or (x, y, z)
    Voxel spacing [mm].
origin : (x, y, z)
    Centre of voxel (0, 0, 0) [mm].
range : (empty, solid), optional
    Values that become 0 and 255, linear between, rounded to nearest. Default (0, 255) for uint8, (0, 1) for
    bool; other types must state it.

Raises
------
ValueError
    If the rank is not 3, a side is 0, a value is not finite or out of range, the range is missing, a spacing is
    not positive, or the machine has too little memory. Of every method that reads or changes levels: if another
    thread changes the bone, or, to change it, reads it (docs/session.md).

Examples
--------
>>> import numpy as np, burrlab
>>> bone = burrlab.VoxelBone(np.ones((4, 5, 6), dtype=np.float32), spacing=0.1, range=(0, 1))
>>> bone.shape, round(bone.mass, 6)
((4, 5, 6), 0.12)
)");
  bone.def(py::init(
               [](const py::array& density, const Spacing& spacing, const Vec3& origin, const Range& range) {
                 if (density.ndim() == 3) check_memory(shape_of(density), 2.04);
                 const Levels levels = to_levels(density, range);
                 return std::make_shared<VoxelBone>(shape_of(density), levels, to_vector(spacing), origin);
               }),
           py::arg("density"), py::arg("spacing"), py::arg("origin") = Vec3::Zero().eval(), py::kw_only(),
           py::arg("range") = py::none())
      .def_static("block", &block, py::arg("size"), py::arg("spacing"), py::kw_only(),
                  py::arg("origin") = Vec3::Zero().eval(), py::arg("level") = 255,
                  R"(A uniform block.

Parameters
----------
size : (x, y, z)
    Sides [mm]; rounded up to whole voxels.
spacing : float or (x, y, z)
    [mm]
origin : (x, y, z)
    Centre of the first voxel [mm].
level : int
    Occupancy, 0 to 255.

Raises
------
ValueError
    If a side or spacing is not positive, the level out of range, or the machine has too little memory.
)")
      .def_property_readonly(
          "shape",
          [](const VoxelBone& b) { return py::make_tuple(b.shape()[0], b.shape()[1], b.shape()[2]); },
          "(nz, ny, nx)")
      .def_property_readonly(
          "spacing",
          [](const VoxelBone& b) { return py::make_tuple(b.spacing()[0], b.spacing()[1], b.spacing()[2]); },
          "(x, y, z) [mm]")
      .def_property_readonly(
          "origin",
          [](const VoxelBone& b) { return py::make_tuple(b.origin()[0], b.origin()[1], b.origin()[2]); },
          "Centre of voxel (0, 0, 0), (x, y, z) [mm]")
      .def_property_readonly(
          "density", [](const VoxelBone& bone) { return read_only(bone, false); },
          "Levels now, (z, y, x) uint8: a read-only copy, made at each call; `read` copies a part.")
      .def_property_readonly(
          "pristine", [](const VoxelBone& bone) { return read_only(bone, true); },
          "Levels as loaded or written, (z, y, x) uint8: a read-only copy.")
      .def("read", &levels_of, py::arg("start"), py::arg("shape"), py::kw_only(), py::arg("pristine") = false,
           R"(Levels of a box, copied.

Parameters
----------
start : (z, y, x)
    Index of the box's first voxel.
shape : (z, y, x)
    Voxels along each side.
pristine : bool
    As loaded or written; else now.

Returns
-------
ndarray, shape (z, y, x), uint8

Raises
------
ValueError
    If the box leaves the volume.
)")
      .def_property_readonly("mass", &VoxelBone::mass, "Volume of solid bone that is left [mm^3].")
      .def_property_readonly("removed", &VoxelBone::removed,
                             "Volume of solid bone removed since it was loaded, written or reset [mm^3].")
      .def(
          "write",
          [](VoxelBone& bone, const py::array& values, const Index3& start, const Range& range) {
            const Levels levels = to_levels(values, range);
            const VoxelBone::Changing changing(bone);
            bone.write(start, shape_of(values), levels.data());
          },
          py::arg("values"), py::arg("start") = Index3{0, 0, 0}, py::kw_only(), py::arg("range") = py::none(),
          R"(Sets present and pristine levels of a box.

Parameters
----------
values : ndarray, shape (z, y, x)
    As for the constructor.
start : (z, y, x)
    Index of the box's first voxel.
range : (empty, solid), optional

Raises
------
ValueError
    If the box leaves the volume, or a value is out of range.
)")
      .def(
          "restore",
          [](VoxelBone& bone, const py::array& density) {
            const Levels levels = to_levels(density, {});
            if (shape_of(density) != bone.shape())
              throw std::invalid_argument("density must have the shape of the bone");
            bone.restore(levels.data());
          },
          py::arg("density"), R"(Sets present levels and keeps the pristine ones, as from a snapshot.

Parameters
----------
density : ndarray, shape (nz, ny, nx), uint8

Raises
------
ValueError
    If its shape is another than the bone's, or a level is above the pristine one.
)")
      .def("reset", &VoxelBone::reset, "Puts back all that was eroded.")
      .def("digest", &VoxelBone::digest, py::call_guard<py::gil_scoped_release>(),
           "128 bits as 32 hexadecimal digits over geometry, present and pristine levels: a sum over 8^3 "
           "bricks of a hash of brick index and content.")
      .def("__repr__", [](const VoxelBone& b) {
        return std::string(
            py::str("VoxelBone(shape=({}, {}, {}), spacing=({:g}, {:g}, {:g}) mm, mass={:.6g} mm^3)")
                .format(b.shape()[0], b.shape()[1], b.shape()[2], b.spacing()[0], b.spacing()[1],
                        b.spacing()[2], b.mass()));
      });
  bind_voxel_bone_copies(bone);
  bind_voxel_bone_tissues(bone);
}
