// A burr on a bone: order within a tick, the burr at rest, and the descent held at a force.
#include "burrlab/burr_contact.hpp"

#include <algorithm>

#include "check.hpp"

using namespace burrlab;

namespace {

const Material soft("any", 2.145, 0.087, Shape::parabolic(), "");

/// A solid block under the plane z = 0, 6 x 6 x 3 mm of voxels of 0.1 mm.
std::shared_ptr<VoxelBone> block() {
  return std::make_shared<VoxelBone>(Index3{30, 60, 60}, std::vector<std::uint8_t>(108000, 255),
                                     Vec3::Constant(0.1), Vec3(-2.95, -2.95, -2.95));
}

BurrContact on(const std::shared_ptr<VoxelBone>& bone, Scheme scheme = Scheme::layer) {
  return BurrContact(bone, Burr(2.0), soft, 5, 0, scheme);
}

void check_step() {
  const auto bone = block();
  BurrContact contact = on(bone);
  const Vec3 center(0.0, 0.0, 1.8);

  // The force is that before the erosion.
  const Contact before = contact.probe(center);
  const Contact first = contact.step(center, 1.0, true);
  CHECK(first.force == before.force && first.m0 == before.m0 && first.m1 == before.m1);
  CHECK(first.penetration == before.penetration && first.normal == before.normal);
  CHECK(before.removed == 0.0 && first.removed > 0.0);
  CHECK_NEAR(bone->removed(), first.removed, 1e-12);
  CHECK(contact.step(center, 1.0, true).m0 < first.m0);
  CHECK(first.tick == 0 && contact.tick == 2);
  CHECK(first.touching && !first.ambiguous && !first.coarse && !first.faint);
  CHECK_NEAR(first.penetration, 0.2, 0.005);  // a cap of the half-space
  CHECK(first.normal[2] > 0.999999);

  // The burr at rest: the tick counts, nothing erodes.
  const std::string digest = bone->digest();
  const Contact rest = contact.step(center, 1.0, false);
  CHECK(rest.removed == 0.0 && rest.force.norm() > 0.0);
  CHECK(bone->digest() == digest);
  CHECK(contact.tick == 3);

  const Contact away = contact.step(Vec3(0.0, 0.0, 50.0), 1.0, true);
  CHECK(!away.touching && away.force.norm() == 0.0 && away.removed == 0.0 && bone->digest() == digest);
}

void check_hold() {
  const Vec3 start(0.0, 0.0, 2.1), axis(0.0, 0.0, -1.0);
  for (const Scheme scheme : {Scheme::layer, Scheme::cell}) {
    const double force = 0.5;
    const auto held_bone = block(), stepped_bone = block();
    BurrContact held = on(held_bone, scheme), stepped = on(stepped_bone, scheme);
    const HeldDescent descent = held.hold(force, start, axis, 0.0, 1.0, 1.0, 400);
    CHECK(descent.position.size() == 400 && !descent.reached && held.tick == 400);
    CHECK(descent.force.size() == 400 && descent.removed.size() == 400);
    double worst = 0.0;
    for (const double axial : descent.force) worst = std::max(worst, std::abs(axial - force));
    CHECK_NEAR(worst, 0.0, 1e-4);
    CHECK(std::is_sorted(descent.position.begin(), descent.position.end()));
    CHECK(descent.position.back() > descent.position.front());

    // `step` at the positions that `hold` found gives the same ticks.
    bool same = true;
    for (std::size_t i = 0; i < descent.position.size(); ++i) {
      const Contact contact = stepped.step(start + descent.position[i] * axis, 1.0, true);
      same = same && contact.removed == descent.removed[i] && -contact.force.dot(axis) == descent.force[i];
    }
    CHECK(same);
    CHECK(stepped_bone->digest() == held_bone->digest());

    // `hold` continues from its place, and ends at the end of its travel.
    const double from = descent.position.back();
    const HeldDescent rest = held.hold(force, start, axis, from, from + 0.05, 1.0, 100000);
    CHECK(rest.reached && !rest.position.empty());
    CHECK(rest.position.front() >= from && rest.position.back() < from + 0.05);
  }

  BurrContact contact = on(block());
  const HeldDescent above = contact.hold(1.0, start, axis, -5.0, -1.0, 1.0, 10);  // never reaches the bone
  CHECK(above.reached && above.position.empty() && contact.tick == 0);
}

/// One thread changes a bone, or any number read it.
void check_readers() {
  const auto bone = block();
  BurrContact contact = on(bone);
  {
    const VoxelBone::Reading reading(*bone), other(*bone);
    CHECK_THROWS(contact.step(Vec3(0.0, 0.0, 1.8), 1.0, true), "another thread reads it");
    CHECK(bone->removed() == 0.0 && contact.tick == 0);
  }
  CHECK_THROWS(contact.step(Vec3(NAN, 0.0, 0.0), 1.0, true), "finite");
  contact.step(Vec3(0.0, 0.0, 1.8), 1.0, true);
  CHECK(contact.tick == 1 && bone->removed() > 0.0);
}

}  // namespace

int main() {
  check_step();
  check_readers();
  check_hold();
  return check::report();
}
