// A burr sinks into a block of bone for a second: the force of each tick, and what is left.
#include <burrlab/burrlab.hpp>
#include <cstdio>

int main() {
  const burrlab::Burr burr(3.0);  // radius [mm]
  const auto bone = std::make_shared<burrlab::VoxelBone>(burrlab::half_space(burr, 0.1, 1.0));
  burrlab::BurrContact contact(bone, burr, burrlab::paper_material("bone"), /*seed=*/1);
  for (int tick = 0; tick < 1000; ++tick) {
    const burrlab::Vec3 center(0.0, 0.0, 3.0 - 0.0007 * tick);  // [mm]; the bone's surface is z = 0
    const burrlab::Contact now = contact.step(center, /*dt=*/1.0, /*burr_on=*/true);
    if (tick % 100 == 99) std::printf("%4d ms  %.3f N\n", tick + 1, now.force.z());
  }
  std::printf("removed %.3f mm^3, bone %s\n", bone->removed(), bone->digest().c_str());
}
