// A renderer beside the loop: 20 times a second it takes the bricks that changed and holds its own picture of the
// bone. The loop never waits for it.
#include <burrlab/burrlab.hpp>
#include <chrono>
#include <cstdio>
#include <thread>

using namespace burrlab;

int main() {
  const Burr burr(3.0);
  const auto bone = std::make_shared<VoxelBone>(block({-6.0, -6.0, -4.0}, {6.0, 6.0, 0.0}, 0.2));
  const Index3 shape = bone->shape();
  std::vector<std::uint8_t> picture(bone->density());  // (z, y, x), as a texture
  BoneView view(*bone);
  view.skip();  // the picture has the bone as it is
  BoneView::Changes changes;

  std::atomic<bool> done{false};
  std::thread loop([&] {  // the simulator's own loop
    BurrContact contact(bone, burr, paper_material("bone"), /*seed=*/1);
    auto next = std::chrono::steady_clock::now();
    for (int tick = 0; tick < 1000; ++tick) {
      contact.step({0.0, 0.0, 3.0 - 0.001 * tick}, 1.0, true);
      std::this_thread::sleep_until(next += std::chrono::milliseconds(1));
    }
    done = true;
  });

  for (bool last = false; !last; std::this_thread::sleep_for(std::chrono::milliseconds(50))) {
    last = done;
    view.update(changes);
    for (std::size_t i = 0; i < changes.bricks.size(); ++i) {
      const Index3 first = changes.places[i], size = bone->extent(changes.bricks[i]);
      const std::uint8_t* levels = changes.levels.data() + i * brick_voxels;
      for (std::int64_t z = 0; z < size[0]; ++z)
        for (std::int64_t y = 0; y < size[1]; ++y)
          std::copy_n(levels + (z * brick_side + y) * brick_side, size[2],
                      picture.data() + ((first[0] + z) * shape[1] + first[1] + y) * shape[2] + first[2]);
    }
    std::printf("%3zu bricks, %4zu voxels opened\n", changes.bricks.size(), changes.opened.size());
  }
  loop.join();
  const bool same = picture == bone->density();
  std::puts(same ? "the picture is the bone" : "the picture differs from the bone");
  return !same;
}
