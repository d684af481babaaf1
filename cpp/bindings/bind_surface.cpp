#include <vector>

#include "bindings.hpp"
#include "burrlab/surface.hpp"

namespace py = pybind11;
using namespace burrlab;

namespace {

using Places = py::array_t<std::int64_t, py::array::c_style | py::array::forcecast>;

std::vector<Index3> to_places(const char* name, const Places& places) {
  if (places.ndim() != 2 || places.shape(1) != 3)
    throw std::invalid_argument(std::string(name) + " must have the shape (n, 3)");
  std::vector<Index3> out(static_cast<std::size_t>(places.shape(0)));
  for (std::size_t i = 0; i < out.size(); ++i)
    for (std::size_t axis = 0; axis < 3; ++axis) out[i][axis] = places.at(py::ssize_t(i), py::ssize_t(axis));
  return out;
}

// The array owns what the vector held.
template <class T>
py::array_t<T> to_array(std::vector<T>&& values, py::ssize_t columns) {
  auto* kept = new std::vector<T>(std::move(values));
  const py::capsule owner(kept, [](void* memory) { delete static_cast<std::vector<T>*>(memory); });
  const auto n = py::ssize_t(kept->size());
  if (columns == 1) return py::array_t<T>({n}, kept->data(), owner);
  return py::array_t<T>({n / columns, columns}, kept->data(), owner);
}

py::list extract(const VoxelBone& bone, const Places& blocks, int level) {
  const std::vector<Index3> places = to_places("blocks", blocks);
  std::vector<SurfaceBlock> made(places.size());
  {
    const py::gil_scoped_release release;
    const VoxelBone::Reading reading(bone);
    for (std::size_t i = 0; i < places.size(); ++i) made[i] = extract_surface(bone, places[i], level);
  }
  py::list out;
  for (SurfaceBlock& block : made)
    out.append(py::make_tuple(to_array(std::move(block.points), 3), to_array(std::move(block.normals), 3),
                              to_array(std::move(block.triangles), 3), to_array(std::move(block.tissues), 1),
                              to_array(std::move(block.lost), 1)));
  return out;
}

py::object tissue_box(const VoxelBone& bone, const Index3& start, const Index3& shape) {
  if (!bone.tissues()) return py::none();
  bone.check_box(start, shape);
  py::array_t<std::uint8_t> out({shape[0], shape[1], shape[2]});
  bone.tissues()->read(start, shape, out.mutable_data());
  return out;
}

}  // namespace

void bind_surface(py::module_& m) {
  m.def("extract_surface", &extract, py::arg("bone"), py::arg("blocks"), py::arg("level") = 128,
        "For each block of 32^3 voxels, blocks (n, 3) (z, y, x): points (v, 3) float32 [mm], normals (v, 3) "
        "float32, triangles (t, 3) int32, tissues (v,) uint8, lost (v,) uint8.");
  m.def("tissue_box", &tissue_box, py::arg("bone"), py::arg("start"), py::arg("shape"),
        "Numbers of the tissues in a box, (z, y, x) uint8, copied; None without tissues.");
}
