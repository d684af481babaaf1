// Threads: each with its own bone, or all reading one.
#include <thread>
#include <vector>

#include "burrlab/burr_contact.hpp"
#include "check.hpp"
#include "cpu_path.hpp"

using namespace burrlab;

namespace {

constexpr int workers = 4;
const Material soft("any", 2.145, 0.5, Shape::parse("power(1.5)"), "");

VoxelBone some_bone() {
  VoxelBone::Levels levels(40 * 40 * 40);
  for (std::size_t i = 0; i < levels.size(); ++i) levels[i] = static_cast<std::uint8_t>(i * i % 251);
  return VoxelBone({40, 40, 40}, levels, Vec3::Constant(0.1), Vec3::Zero());
}

BurrContact contact_on(std::shared_ptr<VoxelBone> bone, int number) {
  return BurrContact(std::move(bone), Burr(1.5), soft, std::uint64_t(number), 0,
                     number % 2 ? Scheme::cell : Scheme::layer);
}

/// Digest after a run on a copy.
std::string run(const VoxelBone& fresh, int number) {
  const auto bone = std::make_shared<VoxelBone>(fresh);
  BurrContact contact = contact_on(bone, number);
  for (int i = 0; i < 60; ++i) contact.step(Vec3(0.05 * i, 2.0, 2.5 - 0.02 * i), 1.0, true);
  return bone->digest();
}

template <class Work>
void in_threads(Work work) {
  std::vector<std::thread> threads;
  for (int number = 0; number < workers; ++number) threads.emplace_back(work, number);
  for (std::thread& thread : threads) thread.join();
}

}  // namespace

int main() {
  const VoxelBone fresh = some_bone();
  const std::string untouched = fresh.digest();
  for (const std::string& path : cpu_paths()) {
    use_cpu_path(path);
    std::vector<std::string> alone(workers), together(workers);
    for (int number = 0; number < workers; ++number) alone[std::size_t(number)] = run(fresh, number);
    in_threads([&](int number) { together[std::size_t(number)] = run(fresh, number); });
    CHECK(together == alone);
    CHECK(alone[0] != alone[1] && alone[0] != alone[2] && fresh.digest() == untouched);

    const auto shared = std::make_shared<VoxelBone>(fresh);
    const BurrContact contact = contact_on(shared, 0);
    std::vector<Vec3> forces(workers, Vec3::Zero());
    const auto probes = [&contact] {
      Vec3 sum = Vec3::Zero();
      for (int i = 0; i < 200; ++i) sum += contact.probe(Vec3(0.01 * i, 2.0, 2.5)).force;
      return sum;
    };
    in_threads([&](int number) { forces[std::size_t(number)] = probes(); });
    for (const Vec3& force : forces) CHECK(force == probes() && force.norm() > 0.0);
    CHECK(shared->digest() == untouched);
  }
  return check::report();
}
