// A tick allocates nothing: step, probe and erode, every scheme and shape, every CPU path, from the first
// tick on; bones uniform and not, fresh, copied, written and restored, with and without tissues. Nor does a
// view of the bone, once it has grown.
#include <cstring>
#include <memory>
#include <random>

#include "burrlab/bone_view.hpp"
#include "burrlab/burr_contact.hpp"
#include "check.hpp"
#include "count_allocations.hpp"
#include "cpu_path.hpp"

using namespace burrlab;

namespace {

constexpr int side = 44;
constexpr double spacing = 0.1;

VoxelBone::Levels levels(int lowest, int highest) {
  std::mt19937 random(7);
  VoxelBone::Levels out(std::size_t(side) * side * side);
  for (std::uint8_t& level : out)
    level = static_cast<std::uint8_t>(lowest + static_cast<int>(random() % unsigned(highest - lowest + 1)));
  return out;
}

VoxelBone bone_of(const VoxelBone::Levels& some) {
  return VoxelBone({side, side, side}, some, Vec3::Constant(spacing), Vec3::Zero());
}

/// Sixteen tissues by voxel in one half and by brick in the other; two of them erode in doublings.
void give_tissues(VoxelBone& bone, const Material& material) {
  std::vector<Tissue> rows;
  for (int i = 0; i < 16; ++i)
    rows.push_back({std::to_string(i), i, 1.0 + i, i > 13 ? 2.0 : 0.4, {}, {}, {}, {}});
  VoxelBone::Levels numbers = levels(0, 15);
  for (std::size_t i = 0; i < numbers.size(); ++i)
    if (i % side >= 24) numbers[i] = static_cast<std::uint8_t>(i % side / 8);
  bone.set_tissues(std::make_shared<TissueMap>(bone.shape(), numbers.data(), Tissues(rows, material)));
}

/// Bones with bricks in every state.
std::vector<VoxelBone> bones() {
  std::vector<VoxelBone> all;
  all.push_back(VoxelBone({side, side, side}, 255, Vec3::Constant(spacing), Vec3::Zero()));
  all.push_back(bone_of(levels(0, 255)));  // copied below: the first erosion saves the pristine levels
  all.push_back(bone_of(levels(0, 31)));   // faint
  VoxelBone mixed = all[0];
  const VoxelBone::Levels box = levels(0, 255);
  mixed.write({5, 5, 5}, {20, 20, 20}, box.data());
  all.push_back(mixed);
  mixed.restore(VoxelBone::Levels(box.size(), 0).data());
  mixed.reset();
  all.push_back(mixed);
  all.push_back(
      VoxelBone({side, side, side}, 255, Vec3(spacing, 0.8 * spacing, 1.2 * spacing), Vec3::Zero()));
  return all;
}

template <class Work>
void allocates_nothing(Work work) {
  const long before = allocations;
  work();
  CHECK(allocations == before);
}

void check_contact(const VoxelBone& fresh, Scheme scheme, const Shape& shape, bool tissues,
                   double rate_exponent) {
  const auto bone = std::make_shared<VoxelBone>(fresh);
  const Material material("any", 2.0, 0.4, shape, "", 1.5 + rate_exponent, rate_exponent);
  if (tissues) give_tissues(*bone, material);
  BurrContact contact(bone, Burr(1.5), material, 1, 0, scheme);
  const auto center = [](int i) { return Vec3(2.0 + 0.01 * i, 2.1, 2.9 - 0.02 * i); };
  double force = 0.0, probed = 0.0, stepped = 0.0, eroded = 0.0;
  allocates_nothing([&] { probed = contact.probe(center(0)).force.norm(); });
  allocates_nothing([&] {
    for (int i = 0; i < 10; ++i) stepped += contact.step(center(i), 1.0, true).removed;
  });
  allocates_nothing([&] {
    for (int i = 10; i < 20; ++i) {
      force += contact.probe(center(i)).force.norm();
      eroded += contact.erode(center(i), 1.0);
    }
  });
  allocates_nothing([&] { force += contact.step(center(20), 1.0, false).force.norm(); });
  allocates_nothing([&] { force += contact.step(Vec3(1e9, 0.0, 0.0), 1.0, true).force.norm(); });
  CHECK(probed > 0.0 && force > 0.0 && stepped > 0.0 && eroded > 0.0);
}

void check_view() {
  const auto bone = std::make_shared<VoxelBone>(bone_of(levels(100, 255)));
  BurrContact contact(bone, Burr(1.5), Material("any", 2.0, 0.4, Shape::parabolic(), ""), 1, 0,
                      Scheme::layer);
  BoneView view(*bone);
  BoneView::Changes changes;
  std::size_t opened = 0;
  const auto work = [&] {
    bone->reset();
    contact.tick = 0;
    view.update(changes);
    for (int i = 0; i < 200; ++i) {
      contact.step(Vec3(2.0, 2.1, 4.9 - 0.005 * i), 1.0, true);
      view.update(changes);
      opened += changes.opened.size();
    }
  };
  work();
  work();
  allocates_nothing(work);
  CHECK(opened > 1000);
}

/// The counter sees every allocation; if `counts_malloc` is false, only operator new.
void check_counter() {
  long seen = allocations;
  const auto counted = [&seen] {
    const bool more = allocations > seen;
    seen = allocations;
    return more;
  };
  static int* volatile object;  // not optimised away
  object = new int(3);
  CHECK(counted());
  delete object;
#ifdef __GLIBC__
  if (!counts_malloc) return;
  static void* volatile memory;
  memory = std::malloc(100);
  CHECK(counted());
  memory = std::realloc(memory, 1000);
  CHECK(counted());
  std::free(memory);
  memory = std::calloc(100, 100);
  CHECK(counted());
  std::free(memory);
  memory = std::aligned_alloc(64, 640);
  CHECK(counted());
  std::free(memory);
  memory = strdup("as a library allocates");
  CHECK(counted());
  std::free(memory);
#endif
}

}  // namespace

int main() {
  check_counter();
  std::printf("counted: operator new%s\n",
              counts_malloc ? " and malloc" : " alone: no glibc, or a sanitizer");
  check_view();
  const std::vector<VoxelBone> all = bones();
  bool by_force = false;  // whether the rate grows with the force
  for (const std::string& path : cpu_paths()) {
    use_cpu_path(path);
    for (const Scheme scheme : {Scheme::layer, Scheme::cell})
      for (const char* shape : {"parabolic", "linear", "constant", "power(0.5)", "power(7.3)"})
        for (const VoxelBone& bone : all)
          for (const bool tissues : {false, true}) {
            check_contact(bone, scheme, Shape::parse(shape), tissues, by_force ? 0.5 : 0.0);
            by_force = tissues == by_force;  // each with each in turn
          }
  }
  return check::report();
}
