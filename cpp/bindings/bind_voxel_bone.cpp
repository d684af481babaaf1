#include <algorithm>
#include <type_traits>

#include "bindings.hpp"

namespace {

using VoxelBoneClass = Class<VoxelBone, std::shared_ptr<VoxelBone>>;
using Levels = VoxelBone::Levels;
using Range = std::optional<std::pair<double, double>>;  // values of empty and of solid bone

std::string dtype_name(const py::array& values) { return std::string(py::str(values.dtype())); }

// Values lo..hi of any real type as levels 0..255, rounded to nearest.
template <class T>
Levels scale(const py::array& values, double lo, double hi) {
  const auto dense = py::array_t<T, py::array::c_style>::ensure(values);
  const T* in = dense.data();
  if constexpr (std::is_same_v<T, std::uint8_t>) {
    if (lo == 0.0 && hi == 255.0) return Levels(in, in + dense.size());
  }
  constexpr bool single = std::is_same_v<T, float>;  // float values were rounded, so round the limits too
  const double low = single ? static_cast<float>(lo) : lo, high = single ? static_cast<float>(hi) : hi;
  Levels out(static_cast<std::size_t>(dense.size()));
  for (std::size_t i = 0; i < out.size(); ++i) {
    const double value = static_cast<double>(in[i]);
    if (!std::isfinite(value)) refuse("every density", "finite", value);
    if (value < low || value > high) {
      std::ostringstream rule;
      rule << "within the range " << lo << " to " << hi;
      refuse("every density", rule.str(), value);
    }
    out[i] = static_cast<std::uint8_t>(std::rint(std::clamp((value - lo) / (hi - lo), 0.0, 1.0) * 255.0));
  }
  return out;
}

/// Values (z, y, x) of any type as levels; throws unless they are finite and within the range.
Levels to_levels(const py::array& values, Range range) {
  if (values.ndim() != 3) refuse("dimensions of density", "3 (z, y, x)", double(values.ndim()));
  const bool is_levels = py::isinstance<py::array_t<std::uint8_t>>(values);
  if (values.dtype().kind() == 'b') range = range.value_or(std::make_pair(0.0, 1.0));
  if (is_levels) range = range.value_or(std::make_pair(0.0, 255.0));
  if (!range)
    throw std::invalid_argument("range must be given for densities of type " + dtype_name(values) +
                                ": the values of empty and of solid bone");
  const auto [lo, hi] = *range;
  if (!(std::isfinite(lo) && std::isfinite(hi) && lo < hi))
    throw std::invalid_argument("range must be two finite values, empty below solid, got (" +
                                std::string(py::str(py::float_(lo))) + ", " +
                                std::string(py::str(py::float_(hi))) + ")");
  if (values.dtype().kind() == 'b') return scale<bool>(values, lo, hi);
  if (is_levels) return scale<std::uint8_t>(values, lo, hi);
  if (py::isinstance<py::array_t<std::int8_t>>(values)) return scale<std::int8_t>(values, lo, hi);
  if (py::isinstance<py::array_t<std::int16_t>>(values)) return scale<std::int16_t>(values, lo, hi);
  if (py::isinstance<py::array_t<std::uint16_t>>(values)) return scale<std::uint16_t>(values, lo, hi);
  if (py::isinstance<py::array_t<float>>(values)) return scale<float>(values, lo, hi);
  const char kind = values.dtype().kind();
  if (kind == 'i' || kind == 'u' || kind == 'f')
    return scale<double>(values.attr("astype")("float64"), lo, hi);
  throw std::invalid_argument("density must be an array of integers or floats, got " + dtype_name(values));
}

/// Numbers (z, y, x) into a table, as a map of the bone's shape.
std::shared_ptr<const TissueMap> to_map(const VoxelBone& bone, const Tissues& tissues,
                                        const py::array& numbers) {
  if (!py::isinstance<py::array_t<std::uint8_t>>(numbers) || numbers.ndim() != 3 ||
      shape_of(numbers) != bone.shape())
    throw std::invalid_argument("numbers of tissues must be uint8 and have the shape of the bone");
  const auto dense = py::array_t<std::uint8_t, py::array::c_style>::ensure(numbers);
  return std::make_shared<const TissueMap>(bone.shape(), dense.data(), tissues);
}

std::shared_ptr<VoxelBone> copy(const VoxelBone& bone) {
  const VoxelBone::Reading reading(bone);
  return std::make_shared<VoxelBone>(bone);
}

void bind_voxel_bone_copies(VoxelBoneClass& bone) {
  bone.def("copy", &copy, no_gil, "An independent bone with the same present and pristine levels.")
      .def("__copy__", &copy)
      .def(
          "__deepcopy__", [](const VoxelBone& bone, const py::dict&) { return copy(bone); }, "memo"_a)
      .def(py::pickle(
          [](const py::object& self) {
            return py::make_tuple(self.attr("pristine"), self.attr("density"), self.attr("spacing"),
                                  self.attr("origin"), self.attr("tissues"), self.attr("tissue_numbers"));
          },
          [](const py::tuple& t) {
            const auto pristine = t[0].cast<py::array_t<std::uint8_t, py::array::c_style>>();
            const auto density = t[1].cast<py::array_t<std::uint8_t, py::array::c_style>>();
            if (density.ndim() != 3 || pristine.ndim() != 3 || shape_of(density) != shape_of(pristine))
              throw std::invalid_argument(
                  "density and pristine of a pickled bone must have one shape (z, y, x)");
            auto bone = std::make_shared<VoxelBone>(
                shape_of(pristine), Levels(pristine.data(), pristine.data() + pristine.size()),
                t[2].cast<Vec3>(), t[3].cast<Vec3>());
            bone->restore(density.data());
            if (t.size() > 4 && !t[4].is_none())
              bone->set_tissues(to_map(*bone, t[4].cast<Tissues>(), t[5].cast<py::array>()));
            return bone;
          }));
}

/// An array that was made for the caller, or None.
py::object read_only(py::object array) {
  if (!array.is_none()) array.attr("flags").attr("writeable") = false;
  return array;
}

/// A sum over one tissue, by its name or number.
template <double (VoxelBone::*sum)(std::size_t) const>
double of_tissue(const VoxelBone& bone, const std::variant<std::size_t, std::string>& tissue) {
  if (!bone.tissues()) throw std::invalid_argument("bone must have tissues, got one of a single material");
  const Tissues& table = bone.tissues()->table();
  const auto* given = std::get_if<std::size_t>(&tissue);
  const std::size_t number = given ? *given : table.find(std::get<std::string>(tissue));
  if (number >= table.size())
    throw std::invalid_argument("tissue must be a name or number of the bone's table");
  const VoxelBone::Reading reading(bone);
  return (bone.*sum)(number);
}

void bind_voxel_bone_tissues(VoxelBoneClass& bone) {
  bone.def(
          "set_tissues",
          [](VoxelBone& bone, const Tissues& tissues, const py::array& numbers) {
            bone.set_tissues(to_map(bone, tissues, numbers));
          },
          "tissues"_a, "numbers"_a, R"(Gives each voxel's pristine content a tissue.

Parameters
----------
tissues : Tissues
numbers : ndarray, shape (nz, ny, nx), uint8
    Numbers into the table. Copied; copies of the bone share them.

Raises
------
ValueError
    If the numbers have another type or shape, or one is not in the table.
)")
      .def_readonly(
          "tissues",
          [](const VoxelBone& bone) -> std::shared_ptr<Tissues> {
            return bone.tissues() ? std::make_shared<Tissues>(bone.tissues()->table()) : nullptr;
          },
          "Table of its tissues; None if it is of a single material")
      .def_readonly(
          "tissue_numbers",
          [](const VoxelBone& bone) { return read_only(tissue_box(bone, {0, 0, 0}, bone.shape())); },
          "Tissue number of every voxel, (z, y, x) uint8: a read-only copy; None without tissues")
      .def("mass_of", &of_tissue<&VoxelBone::mass_of>, "tissue"_a,
           "Present mass of a tissue, by name or number [mm^3]. ValueError if there is no such tissue.")
      .def("removed_of", &of_tissue<&VoxelBone::removed_of>, "tissue"_a,
           "Mass removed from a tissue, by name or number [mm^3]. ValueError if there is no such tissue.");
}

using Spacing = std::variant<double, Vec3>;

Vec3 to_spacing(const py::object& object) {
  const auto spacing = argument<Spacing>("spacing", "a number or three of them (x, y, z) [mm]", object);
  if (const auto* side = std::get_if<double>(&spacing)) return Vec3::Constant(*side);
  return std::get<Vec3>(spacing);
}

// Raises the package's ValueError, which knows the machine's memory, for a bone that is too large.
void check_memory(const Index3& shape, double each) {
  const double voxels = double(shape[0]) * double(shape[1]) * double(shape[2]);
  if (voxels > 1e8)
    py::module_::import("burrlab.common.check")
        .attr("check_memory")(voxels * each, py::str("a bone of {:.3g} voxels").format(voxels));
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

std::shared_ptr<VoxelBone> block(const py::object& sides, const py::object& spacing, const py::object& origin,
                                 int level) {
  const Vec3 size = to_point("size", sides), s = to_spacing(spacing);
  Index3 shape;
  Vec3 made;
  for (int axis = 0; axis < 3; ++axis) {
    require_positive("size", size[axis]);
    require_positive("spacing", s[axis]);
    const double count = std::ceil(size[axis] / s[axis] - 1e-6);
    if (!(count < 1e6)) refuse("voxels along a side", "below 1000000", count);
    shape[2 - axis] = static_cast<std::int64_t>(count);
    made[axis] = count * s[axis];
  }
  if (((made - size).array() > 1e-6 * s.array()).any()) {
    const py::str text = format(
        "size ({:g}, {:g}, {:g}) mm is no whole number of voxels of ({:g}, {:g}, {:g}) mm: the block has "
        "({:g}, {:g}, {:g}) mm",
        size[0], size[1], size[2], s[0], s[1], s[2], made[0], made[1], made[2]);
    warn(text);
  }
  if (level < 0 || level > 255) refuse("level", "0 to 255", level);
  check_memory(shape, level > 0 ? 1.04 : 0.04);  // empty bricks take only their sums
  return std::make_shared<VoxelBone>(shape, static_cast<std::uint8_t>(level), s, to_point("origin", origin));
}

}  // namespace

void bind_voxel_bone(py::module_& m) {
  VoxelBoneClass bone(m, "VoxelBone", R"(Bone as occupancy levels on a regular grid: 0 empty, 255 solid.

A voxel has two levels: `density`, the present one, and `pristine`, as loaded or written. The space outside
the volume is empty. Levels lie in bricks of 8^3 voxels, with exact sums of mass and first moment. Pristine
levels take memory only where erosion changed a brick that was not uniform.

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
    bool; required for other types.

Raises
------
ValueError
    If the rank is not 3, a side is 0, a value is not finite or out of range, the range is missing, a spacing
    is not positive, or the machine has too little memory. From methods that read levels, if another thread
    changes the bone; from methods that change levels, if another thread uses it (docs/session.md).

Examples
--------
>>> import numpy as np, burrlab
>>> bone = burrlab.VoxelBone(np.ones((4, 5, 6), dtype=np.float32), spacing=0.1, range=(0, 1))
>>> bone.shape, round(bone.mass, 6)
((4, 5, 6), 0.12)
)");
  bone.def(py::init([](const py::object& values, const py::object& spacing, const py::object& origin,
                       const Range& range) {
             const auto density = argument<py::array>("density", "a NumPy array", values);
             if (density.ndim() == 3) check_memory(shape_of(density), 2.04);
             const Levels levels = to_levels(density, range);
             return std::make_shared<VoxelBone>(shape_of(density), levels, to_spacing(spacing),
                                                to_point("origin", origin));
           }),
           "density"_a, "spacing"_a, "origin"_a = Vec3::Zero().eval(), py::kw_only(), "range"_a = py::none())
      .def_static("block", &block, "size"_a, "spacing"_a, py::kw_only(), "origin"_a = Vec3::Zero().eval(),
                  "level"_a = 255,
                  R"(A uniform block.

Parameters
----------
size : (x, y, z)
    Sides [mm]; rounded up to whole voxels, with a warning where that changes them.
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
      .def_readonly(
          "shape", [](const VoxelBone& b) { return three(b.shape()); }, "(nz, ny, nx)")
      .def_readonly(
          "spacing", [](const VoxelBone& b) { return three(b.spacing()); }, "(x, y, z) [mm]")
      .def_readonly(
          "origin", [](const VoxelBone& b) { return three(b.origin()); },
          "Centre of voxel (0, 0, 0), (x, y, z) [mm]")
      .def_readonly(
          "density",
          [](const VoxelBone& bone) { return read_only(levels_of(bone, {0, 0, 0}, bone.shape(), false)); },
          "Present levels, (z, y, x) uint8: a read-only copy, made at each call; `read` copies a part")
      .def_readonly(
          "pristine",
          [](const VoxelBone& bone) { return read_only(levels_of(bone, {0, 0, 0}, bone.shape(), true)); },
          "Levels as loaded or written, (z, y, x) uint8: a read-only copy")
      .def("read", &levels_of, "start"_a, "shape"_a, py::kw_only(), "pristine"_a = false,
           R"(Copies the levels of a box.

Parameters
----------
start : (z, y, x)
    Index of the box's first voxel.
shape : (z, y, x)
    Voxels along each side.
pristine : bool
    If True, levels as loaded or written; else present ones.

Returns
-------
ndarray, shape (z, y, x), uint8

Raises
------
ValueError
    If the box leaves the volume.
)")
      .def_readonly("mass", &VoxelBone::mass, "Volume of solid bone left [mm^3]")
      .def_readonly("removed", &VoxelBone::removed,
                    "Volume of solid bone removed since it was loaded, written or reset [mm^3]")
      .def(
          "write",
          [](VoxelBone& bone, const py::array& values, const Index3& start, const Range& range) {
            const Levels levels = to_levels(values, range);
            const VoxelBone::Changing changing(bone);
            bone.write(start, shape_of(values), levels.data());
          },
          "values"_a, "start"_a = Index3{0, 0, 0}, py::kw_only(), "range"_a = py::none(),
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
          "density"_a, R"(Sets present levels and keeps the pristine ones, as from a snapshot.

Parameters
----------
density : ndarray, shape (nz, ny, nx), uint8

Raises
------
ValueError
    If its shape is another than the bone's, or a level is above the pristine one.
)")
      .def("reset", &VoxelBone::reset, "Restores all that was eroded.")
      .def("digest", &VoxelBone::digest, no_gil,
           "128 bits as 32 hexadecimal digits over geometry, present and pristine levels: a sum over 8^3 "
           "bricks of a hash of brick index and content.")
      .def("__repr__", [](const VoxelBone& b) {
        return format("VoxelBone(shape=({}, {}, {}), spacing=({:g}, {:g}, {:g}) mm, mass={:.6g} mm^3)",
                      b.shape()[0], b.shape()[1], b.shape()[2], b.spacing()[0], b.spacing()[1],
                      b.spacing()[2], b.mass());
      });
  bind_voxel_bone_copies(bone);
  bind_voxel_bone_tissues(bone);
}
