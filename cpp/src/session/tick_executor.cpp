#include "burrlab/session/tick_executor.hpp"

#include "anatomy/anatomy_watch.hpp"
#include "erosion_steps.hpp"
#include "require.hpp"
#include "standard_arithmetic.hpp"

namespace burrlab {

static SessionSetup checked(const SessionSetup& setup) {
  const std::size_t burrs = setup.tools.size();
  if (burrs < 1 || burrs > std::size_t(most_burrs)) refuse("number of burrs", "1 or 2", double(burrs));
  require_positive("period", setup.period);
  return setup;
}

static std::vector<ErosionSteps> steps_of(const VoxelBone& bone, const Material& material, double period) {
  const StandardArithmetic arithmetic;
  std::vector<ErosionSteps> steps;
  for (int k = 1; k <= most_periods; ++k) steps.emplace_back(bone, material, k * period);
  return steps;
}

TickExecutor::TickExecutor(std::shared_ptr<VoxelBone> bone, const SessionSetup& setup, std::uint64_t tick)
    : bone_(std::move(bone)), setup_(checked(setup)) {
  set_tick(tick);
  for (std::size_t i = 0; i < setup.tools.size(); ++i) {
    const Tool& tool = setup.tools[i];
    contacts_.emplace_back(bone_, tool.burr, tool.material, setup.seed, std::uint32_t(i), setup.scheme);
    steps_.push_back(steps_of(*bone_, tool.material, setup.period));
  }
}

TickExecutor::~TickExecutor() = default;

void TickExecutor::execute(TickRecord& record) noexcept {
  const std::uint64_t tick = this->tick();
  version_.store(2 * tick + 1, std::memory_order_relaxed);
  std::atomic_thread_fence(std::memory_order_release);
  for (std::size_t i = 0; i < contacts_.size(); ++i) {
    BurrRecord& burr = record.burr[i];
    const Vec3 center(burr.center[0], burr.center[1], burr.center[2]);
    contacts_[i].tick = tick;
    const Contact contact = contacts_[i].step(center, burr.on ? &steps_[i][record.k - 1] : nullptr);
    burr.radius = setup_.tools[i].burr.radius;
    burr.material = std::uint32_t(i);
    burr.touching = contact.touching;
    burr.ambiguous = contact.ambiguous;
    for (int axis = 0; axis < 3; ++axis) burr.force[axis] = contact.force[axis];
    burr.penetration = contact.penetration;
    burr.removed = contact.lost;
    if (watch_) watch_->after_step(*bone_, record, i);
  }
  tick_.store(tick + 1, std::memory_order_relaxed);
  version_.store(2 * tick + 2, std::memory_order_release);
}

void TickExecutor::set_tick(std::uint64_t tick) {
  if (tick >> 53) refuse("tick", "below 2^53", double(tick));  // replicas get it as a float64
  tick_ = tick;
  version_ = 2 * tick;
  if (watch_) watch_->pass_over(*bone_, tick);
}

void TickExecutor::set_watch(std::shared_ptr<AnatomyWatch> watch) {
  const VoxelBone::Changing changing(*bone_);
  if (watch) {
    bool fits = watch->burrs() == contacts_.size();
    for (std::size_t i = 0; fits && i < contacts_.size(); ++i)
      fits = watch->radius(i) == setup_.tools[i].burr.radius;
    if (!fits) throw InvalidArgument("watch must be of the session's burrs");
    watch->begin(*bone_, tick_);
  }
  watch_ = std::move(watch);
}

void check_record(const TickRecord& record, std::size_t burrs) {
  if (record.k < 1 || record.k > std::uint32_t(most_periods)) refuse("k of a tick", "1 to 8", record.k);
  if (record.burrs != burrs)
    refuse("burrs of a tick", "as many as the session's, " + std::to_string(burrs), record.burrs);
  for (std::size_t i = 0; i < burrs; ++i) {
    for (const double c : record.burr[i].center) require_finite("center of a tick", c);
    if (record.burr[i].on > 1) refuse("the burr's switch in a tick", "0 or 1", record.burr[i].on);
  }
}

}  // namespace burrlab
