
#include "bindings.hpp"
#include "surface.hpp"

namespace {

void check_numbers(const VoxelBone& bone, const Numbers& bricks) {
  if (bricks.ndim() != 1) refuse("dimensions of bricks", "1", double(bricks.ndim()));
  for (py::ssize_t i = 0; i < bricks.size(); ++i)
    if (bricks.at(i) >= bone.brick_count())
      refuse("brick", "below " + std::to_string(bone.brick_count()), double(bricks.at(i)));
}

Numbers take_changed(VoxelBone& bone) {
  return to_array(without_gil([&] {
    const VoxelBone::Changing changing(bone);
    return bone.take_changed();
  }));
}

LevelArray read_bricks(const VoxelBone& bone, const Numbers& bricks) {
  check_numbers(bone, bricks);
  const VoxelBone::Reading reading(bone);
  LevelArray out({bricks.size(), py::ssize_t{brick_voxels}});
  std::uint8_t* to = out.mutable_data();
  for (py::ssize_t i = 0; i < bricks.size(); ++i)
    std::memcpy(to + i * brick_voxels, bone.tile(bricks.at(i)), brick_voxels);
  return out;
}

// Checks all before writing anything.
void restore_bricks(VoxelBone& bone, const Numbers& bricks, const LevelArray& density) {
  check_numbers(bone, bricks);
  if (density.ndim() != 2 || density.shape(0) != bricks.size() || density.shape(1) != brick_voxels)
    throw std::invalid_argument("density must have shape (n, 512), a row a brick");
  const VoxelBone::Changing changing(bone);
  std::uint8_t before[brick_voxels], pristine[brick_voxels];
  for (py::ssize_t i = 0; i < bricks.size(); ++i) {
    bone.read_brick(bricks.at(i), before, pristine);
    for (int j = 0; j < brick_voxels; ++j)
      if (density.at(i, j) > pristine[j])
        refuse("density of a brick", "at most its pristine level", density.at(i, j));
  }
  for (py::ssize_t i = 0; i < bricks.size(); ++i) {
    bone.read_brick(bricks.at(i), before, pristine);
    bone.write_brick(bricks.at(i), density.data(i, 0), pristine);
  }
}

// An array that owns the vector's memory.
template <class T>
py::array_t<T> to_owner(std::vector<T>&& values, py::ssize_t columns) {
  auto* kept = new std::vector<T>(std::move(values));
  const py::capsule owner(kept, [](void* memory) { delete static_cast<std::vector<T>*>(memory); });
  const auto n = py::ssize_t(kept->size());
  if (columns == 1) return py::array_t<T>({n}, kept->data(), owner);
  return py::array_t<T>({n / columns, columns}, kept->data(), owner);
}

py::tuple pack_bone(const VoxelBone& bone) {
  const VoxelBone::Reading reading(bone);
  const auto& map = bone.tissues();
  return py::make_tuple(to_owner(bone.packed(), 1), to_owner(map ? map->packed() : VoxelBone::Levels(), 1));
}

std::shared_ptr<VoxelBone> unpack_bone(const Index3& shape, const Vec3& spacing, const Vec3& origin,
                                       const LevelArray& levels, const Tissues* tissues,
                                       const LevelArray& numbers) {
  const auto size = [](const LevelArray& packed) { return static_cast<std::size_t>(packed.size()); };
  auto bone = std::make_shared<VoxelBone>(shape, levels.data(), size(levels), spacing, origin);
  if (tissues)
    bone->set_tissues(std::make_shared<const TissueMap>(shape, numbers.data(), size(numbers), *tissues));
  return bone;
}

py::list extract(const VoxelBone& bone, const Places& blocks, int level) {
  if (blocks.ndim() != 2 || blocks.shape(1) != 3)
    throw std::invalid_argument("blocks must have the shape (n, 3)");
  std::vector<SurfaceBlock> made;
  without_gil([&] {
    const VoxelBone::Reading reading(bone);
    for (const std::int64_t* at = blocks.data(); at < blocks.data() + blocks.size(); at += 3)
      made.push_back(extract_surface(bone, {at[0], at[1], at[2]}, level));
  });
  py::list out;
  for (SurfaceBlock& block : made)
    out.append(py::make_tuple(to_owner(std::move(block.points), 3), to_owner(std::move(block.normals), 3),
                              to_owner(std::move(block.triangles), 3), to_owner(std::move(block.tissues), 1),
                              to_owner(std::move(block.lost), 1), to_owner(std::move(block.numbers), 1)));
  return out;
}

}  // namespace

py::object tissue_box(const VoxelBone& bone, const Index3& start, const Index3& shape) {
  if (!bone.tissues()) return py::none();
  bone.check_box(start, shape);
  py::array_t<std::uint8_t> out({shape[0], shape[1], shape[2]});
  bone.tissues()->read(start, shape, out.mutable_data());
  return out;
}

void bind_surface(py::module_& m) {
  m.def(
      "pack_bone", &pack_bone, "bone"_a,
      "Pristine levels and tissue numbers of a bone in few bytes, two arrays (n,) uint8; the second is empty "
      "for a bone without tissues.");
  m.def("unpack_bone", &unpack_bone, "shape"_a, "spacing"_a, "origin"_a, "levels"_a, "tissues"_a, "numbers"_a,
        "The bone that was packed, not eroded. ValueError if the arrays do not fill the shape.");
  m.def("take_changed_bricks", &take_changed, "bone"_a,
        "Numbers of the bricks that changed since the last call, in order, (n,) uint32. For a bone with one "
        "consumer.");
  m.def("read_bricks", &read_bricks, "bone"_a, "bricks"_a,
        "Present levels of bricks by number, (n, 512) uint8, zeros beyond the volume; a copy. ValueError if "
        "there is no such brick.");
  m.def("restore_bricks", &restore_bricks, "bone"_a, "bricks"_a, "density"_a,
        "Sets the present levels of bricks, (n, 512) uint8. ValueError if there is no such brick or a level "
        "is above the pristine one; nothing is written then.");
  m.def("extract_surface", &extract, "bone"_a, "blocks"_a, "level"_a = 128,
        "For each block of 32^3 voxels, blocks (n, 3) (z, y, x): points (v, 3) float32 [mm], normals (v, 3) "
        "float32, triangles (t, 3) int32, tissues (v,) uint8, lost (v,) uint8, numbers (v,) int64: a vertex "
        "that blocks repeat has the same number in each.");
  m.def("tissue_box", &tissue_box, "bone"_a, "start"_a, "shape"_a,
        "Tissue numbers in a box, (z, y, x) uint8; a copy. None without tissues.");
}
