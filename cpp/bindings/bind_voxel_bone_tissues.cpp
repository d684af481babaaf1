#include <variant>

#include "bone_bindings.hpp"

namespace py = pybind11;
using burrlab::Index3;
using burrlab::TissueMap;
using burrlab::Tissues;
using burrlab::VoxelBone;

namespace {

py::object numbers_of(const VoxelBone& bone) {
  if (!bone.tissues()) return py::none();
  const Index3& shape = bone.shape();
  py::array_t<std::uint8_t> out({shape[0], shape[1], shape[2]});
  bone.tissues()->read({0, 0, 0}, shape, out.mutable_data());
  out.attr("flags").attr("writeable") = false;
  return out;
}

/// A sum over one tissue, by its name or number.
template <double (VoxelBone::*sum)(std::size_t) const>
double of_tissue(const VoxelBone& bone, const std::variant<std::size_t, std::string>& tissue) {
  if (!bone.tissues()) throw std::invalid_argument("bone must have tissues, got one of a single material");
  const Tissues& table = bone.tissues()->table();
  std::size_t number = table.size();
  if (const auto* given = std::get_if<std::size_t>(&tissue))
    number = *given;
  else
    for (std::size_t i = table.size(); i-- > 0;)
      if (table[i].name == std::get<std::string>(tissue)) number = i;
  if (number >= table.size())
    throw std::invalid_argument("tissue must be a name or number of the bone's table");
  const VoxelBone::Reading reading(bone);
  return (bone.*sum)(number);
}

}  // namespace

std::shared_ptr<const TissueMap> to_map(const VoxelBone& bone, const Tissues& tissues,
                                        const py::array& numbers) {
  if (!py::isinstance<py::array_t<std::uint8_t>>(numbers) || numbers.ndim() != 3 ||
      shape_of(numbers) != bone.shape())
    throw std::invalid_argument("numbers of tissues must be uint8 and have the shape of the bone");
  const auto dense = py::array_t<std::uint8_t, py::array::c_style>::ensure(numbers);
  return std::make_shared<const TissueMap>(bone.shape(), dense.data(), tissues);
}

void bind_voxel_bone_tissues(VoxelBoneClass& bone) {
  bone.def(
          "set_tissues",
          [](VoxelBone& bone, const Tissues& tissues, const py::array& numbers) {
            bone.set_tissues(to_map(bone, tissues, numbers));
          },
          py::arg("tissues"), py::arg("numbers"), R"(Says of every voxel which tissue its pristine content is.

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
      .def_property_readonly(
          "tissues",
          [](const VoxelBone& bone) -> std::shared_ptr<Tissues> {
            return bone.tissues() ? std::make_shared<Tissues>(bone.tissues()->table()) : nullptr;
          },
          "Table of its tissues; None where it is of a single material.")
      .def_property_readonly(
          "tissue_numbers", &numbers_of,
          "Number of every voxel's tissue, (z, y, x) uint8: a read-only copy; None without tissues.")
      .def("mass_of", &of_tissue<&VoxelBone::mass_of>, py::arg("tissue"),
           "What is left of a tissue, by name or number [mm^3]. ValueError if there is none of it.")
      .def("removed_of", &of_tissue<&VoxelBone::removed_of>, py::arg("tissue"),
           "What was removed of a tissue, by name or number [mm^3]. ValueError if there is none of it.");
}
