// A burr in a host: its units, frame, time steps and arithmetic; several burrs; undo. Public headers alone.
#include <Eigen/Geometry>
#include <cfenv>
#if defined(__x86_64__) || defined(_M_X64)
#include <immintrin.h>
#endif

#include <cstring>

#include "burrlab/burrlab.hpp"
#include "check.hpp"
#include "count_allocations.hpp"

using namespace burrlab;

namespace {

const Burr burr(2.0);
const Vec3 none = Vec3::Zero();
std::shared_ptr<VoxelBone> bone() { return std::make_shared<VoxelBone>(half_space(burr, 0.2, 1.0)); }
const Material& material() { return paper_material("bone"); }

/// Downwards along a slope, 0.7 mm in 400 ms.
Vec3 center(double time) { return {0.001 * time, 0.0, 2.0 - 0.00175 * time}; }

void check_frames() {
  // A host in metres whose z axis points down and whose frame is the mirror image of the bone's.
  HostSettings mirrored;
  mirrored.to_bone = {0, 1000, 0, 5, 1000, 0, 0, -3, 0, 0, -1000, 2};
  const auto plain_bone = bone(), host_bone = bone();
  BurrContact plain(plain_bone, burr, material(), 0);
  HostBurr host(host_bone, burr, material(), mirrored);
  for (int i = 0; i < 400; ++i) {
    const Vec3 place = center(i), tip = host.to_host(place), handle(0.1, 0.2, 0.3);
    const Contact contact = plain.step(host.to_bone(tip), 1.0, true);
    const HostForce feel = host.step(tip, 1.0, true, handle);
    CHECK(host.to_bone(tip).isApprox(place, 1e-12) && feel.ticks == 1 && feel.removed == contact.removed);
    CHECK(feel.force == Vec3(contact.force[1], contact.force[0], -contact.force[2]));
    CHECK(feel.torque == (tip - handle).cross(feel.force));
  }
  CHECK(host.last().force.z() > 0.1 && host.last().penetration > 0.05);
  CHECK(plain_bone->digest() == host_bone->digest());

  for (const std::array<double, 12>& refused : {std::array<double, 12>{},
                                                {1, 0, 0, 0, 0, 2, 0, 0, 0, 0, 1, 0},
                                                {1, 0.1, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}}) {
    HostSettings settings;
    settings.to_bone = refused;
    CHECK_THROWS(HostBurr(bone(), burr, material(), settings), "to_bone");
  }
}

/// Steps of 20 ms are ticks of 1 ms along the way; other steps come between without an allocation.
void check_steps() {
  HostSettings mm;
  mm.to_bone = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};
  const auto slow_bone = bone(), fast_bone = bone();
  HostBurr slow(slow_bone, burr, material(), mm), fast(fast_bone, burr, material(), mm);
  slow.step(center(0), 1.0, true);
  fast.step(center(0), 1.0, true);
  HostForce feel;
  for (int call = 0; call < 20; ++call) {
    const long before = allocations;
    feel = slow.step(center(20 * (call + 1)), 20.0, true);
    CHECK(allocations == before && feel.ticks == 20);
    for (int i = 19; i >= 0; --i)
      fast.step(center(20 * (call + 1)) - (center(20) - center(0)) * (i / 20.0), 1.0, true);
  }
  CHECK(slow_bone->removed() > 0.5);
  CHECK_NEAR(slow_bone->removed(), fast_bone->removed(), 1e-3 * fast_bone->removed());
  const long before = allocations;
  for (const double dt : {0.2, 3.3, 1.0, 16.6, 1000.0})
    CHECK(slow.step(center(401), dt, true).ticks == std::ceil(dt));
  CHECK(allocations == before);
  CHECK(slow.step(1e3 * center(0), 1e-10, false).ticks == 1 && slow.last().magnitude == 0.0);
  const std::uint64_t tick = slow.contact().tick;
  const auto refused = [&](const Vec3& at, double dt, const char* why) {
    const HostForce feel = slow.step(at, dt, true);
    return feel.refused && std::strstr(feel.refused, why) && feel.force == none && !feel.ticks;
  };
  CHECK(refused(center(0), 0.0, "dt") && refused(center(0), 1001.0, "dt") && refused(center(0), NAN, "dt"));
  CHECK(refused({0, 0, HUGE_VAL}, 1.0, "center"));
  {
    const VoxelBone::Reading reading(*slow_bone);
    CHECK(refused(center(0), 1.0, "another thread"));
  }
  CHECK(slow.contact().tick == tick);
}

/// The calls' order is the burrs' order; a state kept before comes back, and the same steps carve the same
/// bone.
void check_order_and_undo() {
  HostSettings first, second;
  second.index = 1;
  std::string digests[2];
  for (const bool swapped : {false, true}) {
    const auto both = bone();
    HostBurr a(both, burr, material(), first), b(both, burr, material(), second);
    const auto carve = [&](int from, int to) {
      for (int i = from; i < to; ++i) {
        const Vec3 at = 1e-3 * center(i), beside = at + Vec3(5e-4, 0, 0);
        swapped ? b.step(beside, 1.0, true) : a.step(at, 1.0, true);
        swapped ? a.step(at, 1.0, true) : b.step(beside, 1.0, true);
      }
    };
    carve(0, 200);
    const VoxelBone::Levels kept = both->density();
    const std::string digest = both->digest();
    const std::uint64_t tick = a.contact().tick;
    carve(200, 400);
    const std::string end = both->digest();
    both->restore(kept.data());
    a.contact().tick = b.contact().tick = tick;
    CHECK(both->digest() == digest && end != digest);
    carve(200, 400);
    CHECK(both->digest() == end);
    digests[swapped] = end;
    both->reset();
    CHECK(both->digest() == bone()->digest());
  }
  CHECK(digests[0] != digests[1]);
}

/// All that computes, from these inputs alone, with a law and tissues whose every power is a broken one.
std::pair<std::string, std::vector<double>> outcome(const std::vector<Vec3>& centers) {
  std::vector<double> out;
  const Material law("own", 2.1, 0.09, Shape::parse("power(1.3)"), "", 1.7, 0.6);
  const Tissues table({{"a", 0, 1.234567, 0.07, {}, true, {}, {}}, {"b", 1, 2.7654, 0.11, {}, {}, {}, {}}},
                      law);
  const auto carved = bone();
  std::vector<std::uint8_t> numbers(carved->density().size());
  for (std::size_t i = 0; i < numbers.size(); ++i) numbers[i] = i % 3 == 0;
  carved->set_tissues(std::make_shared<TissueMap>(carved->shape(), numbers.data(), table));
  CHECK_THROWS(TissueMap({-1, 2, 2}, numbers.data(), table), "side of a tissue map must be zero or positive");
  HostBurr host(carved, burr, law, {});
  for (const Vec3& center : centers) {
    const HostForce feel = host.step(center, 10.3, true);
    out.insert(out.end(), {feel.force[0], feel.force[2], feel.torque[1], feel.removed});
  }
  const HeldDescent held = host.contact().hold(0.4, {0, 0, 2}, {0, 0, -1}, 0.0, 1.5, 1.0, 100);
  out.insert(out.end(), held.position.begin(), held.position.end());
  SessionSetup setup;
  setup.tools = {{burr, law}};
  TickExecutor executor(carved, setup);
  CHECK_THROWS(executor.set_tick(std::uint64_t{1} << 53), "tick must be below 2^53");
  TickRecord record;
  record.burr[0].on = 1;
  record.burr[0].center = {0.4, 0.1, 1.2};
  executor.execute(record);
  const MeanFieldDescent descent = mean_field_descent(law.shape, 0.1, 0.5);
  NearestVoxel nearest;
  out.insert(out.end(), {record.burr[0].force[2], carved->removed(), penetration(0.7, 2.0),
                         window_velocity(descent.time, descent.immersion, 0.3, 0.45),
                         StructureSearch(*carved, 0).distance({1.03, 2.07, 3.01}, nearest)});
  return {carved->digest(), out};
}

void check_arithmetic() {
  std::vector<Vec3> centers;
  for (int i = 0; i < 40; ++i) centers.push_back(1e-3 * center(10 * i));
  const auto plain = outcome(centers);
  CHECK(plain.second.size() > 200 && plain.second[157] > 0.1);
  for (const int rounding : {FE_UPWARD, FE_DOWNWARD, FE_TOWARDZERO}) {
    std::fesetround(rounding);
    const bool same = outcome(centers) == plain, kept = std::fegetround() == rounding;
    std::fesetround(FE_TONEAREST);
    CHECK(same && kept);
  }
#if defined(__x86_64__) || defined(_M_X64)
  const unsigned host = 0x9FC0 & ~0x0200u;  // subnormals flushed and taken as zero; a division by zero traps
  const unsigned before = _mm_getcsr();
  _mm_setcsr(host);
  const bool same = outcome(centers) == plain;
  const unsigned after = _mm_getcsr();
  _mm_setcsr(before);
  CHECK(same && (after & ~0x3Fu) == host);
#endif
}

}  // namespace

int main() {
  check_frames();
  check_steps();
  check_order_and_undo();
  check_arithmetic();
  return check::report();
}
