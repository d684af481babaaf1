#include "bone_bindings.hpp"

namespace py = pybind11;
using burrlab::Tissues;
using burrlab::Vec3;
using burrlab::VoxelBone;

namespace {

std::shared_ptr<VoxelBone> copy(const VoxelBone& bone) {
  const VoxelBone::Reading reading(bone);
  return std::make_shared<VoxelBone>(bone);
}

}  // namespace

void bind_voxel_bone_copies(VoxelBoneClass& bone) {
  bone.def("copy", &copy, py::call_guard<py::gil_scoped_release>(),
           "An independent bone with the same present and pristine levels.")
      .def("__copy__", &copy)
      .def(
          "__deepcopy__", [](const VoxelBone& bone, const py::dict&) { return copy(bone); }, py::arg("memo"))
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
