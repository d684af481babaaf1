// Prints digests of descents and of a session, one per line, the same on every CPU.
// tests/python/test_aarch64.py runs it for another CPU, and has the same scenes in Python.
#include <cinttypes>
#include <cstdio>
#include <cstring>

#include "burrlab/session/haptic_loop.hpp"
#include "session/scripted_device.hpp"

using namespace burrlab;

namespace {

Tissue tissue(const char* name, int label, double c_e, double alpha) {
  return {name, label, c_e, alpha, {}, false, false, true};
}

/// 6 x 6 x 4 mm with its top at z = 0; every third layer along x is the second tissue.
std::shared_ptr<VoxelBone> block(const Material& material, bool tissues) {
  const Index3 shape{32, 48, 48};
  const auto bone = std::make_shared<VoxelBone>(shape, std::uint8_t{240}, Vec3(0.125, 0.125, 0.1),
                                                Vec3(-2.9375, -2.9375, -3.15));
  if (!tissues) return bone;
  VoxelBone::Levels numbers(32 * 48 * 48);
  for (std::size_t i = 0; i < numbers.size(); ++i) numbers[i] = i % 3 == 0;
  const Tissues table({tissue("bone", 1, 2.145, 0.087), tissue("soft", 2, 0.462, 0.256)}, material);
  bone->set_tissues(std::make_shared<const TissueMap>(shape, numbers.data(), table));
  return bone;
}

void print(const VoxelBone& bone, double value) {
  std::uint64_t bits;
  std::memcpy(&bits, &value, sizeof bits);
  std::printf("%s %016" PRIx64 "\n", bone.digest().c_str(), bits);
}

void session(const Material& material) {
  const auto bone = block(material, true);
  SessionSetup setup{{{Burr(1.5), material}, {Burr(1.0), material}}, 11, 1.0, Scheme::layer};
  const auto executor = std::make_shared<TickExecutor>(bone, setup);
  const std::vector<ScriptedDevice::Row> left{{0.0, {-1.0, 0.0, 1.5}}, {1.0, {-0.5, 0.5, 1.0}}},
      right{{0.0, {1.0, 0.0, 0.75}}, {1.0, {1.5, -0.5, 0.5}}};
  LoopSettings settings;
  settings.wall_clock = false;
  settings.ticks = 800;
  HapticLoop loop(executor, {std::make_shared<ScriptedDevice>(left), std::make_shared<ScriptedDevice>(right)},
                  settings);
  loop.start();
  loop.wait(300.0);
  loop.stop();
  print(*bone, executor->probe(0, left[1].position).force[2]);
}

}  // namespace

int main() {
  for (const char* shape : {"parabolic", "linear", "constant", "power(1.5)"})
    for (const Scheme scheme : {Scheme::layer, Scheme::cell})
      for (const bool tissues : {false, true}) {
        const Material material("bone", 2.145, 0.087, Shape::parse(shape), "");
        const auto bone = block(material, tissues);
        BurrContact contact(bone, Burr(1.5), material, 7, 0, scheme);
        print(
            *bone,
            contact.hold(0.5, Vec3(0.0, 0.0, 1.5), Vec3(0.0, 0.0, -1.0), 0.0, 1.0, 1.0, 300).position.back());
      }
  session(Material("bone", 2.145, 0.087, Shape::parabolic(), "", 1.7, 0.5));
}
