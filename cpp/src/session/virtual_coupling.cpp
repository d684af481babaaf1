#include "session/virtual_coupling.hpp"

#include <algorithm>
#include <limits>
#include <optional>

#include "require.hpp"

namespace burrlab {
namespace {

constexpr double stiffest = 1e3;  // of a contact, at most [N/mm]

struct Trial {
  Vec3 offset = Vec3::Zero(), force = Vec3::Zero();
  Vec3 miss(double stiffness) const { return force - stiffness * offset; }
};

}  // namespace

VirtualCoupling::VirtualCoupling(double stiffness) : stiffness_(stiffness) {
  require_positive("stiffness of the coupling", stiffness);
  if (stiffness < 1e-6) refuse("stiffness of the coupling", "at least 1e-6 N/mm", stiffness);
}

void VirtualCoupling::reset() noexcept {
  offset_.setZero();
  contact_ = 0.0;
}

// Newton's step, with the secant along the last step as the contact's stiffness. A burr that came free under
// an offset is tried without offset: if it is free there too, it is there; else the balance is between, and
// false position finds it.
Coupled VirtualCoupling::couple(const TickExecutor& executor, std::size_t burr, const Vec3& device) noexcept {
  Coupled result;
  result.center = device;
  if (!device.allFinite()) return result;

  Trial best, last;
  std::optional<Trial> inside, outside;
  double best_miss = std::numeric_limits<double>::infinity();
  Vec3 offset = offset_;
  for (int i = 0; i < most_probes; ++i) {
    const Trial now{offset, executor.probe(burr, device + offset).force};
    ++result.probes;
    const Vec3 miss = now.miss(stiffness_);
    const double length = miss.norm();
    const bool free = now.force.isZero(0.0);
    if (free && now.offset.isZero(0.0)) return reset(), result;
    if (length < best_miss) best = now, best_miss = length;
    if (length <= tolerance && !free) break;
    if (i > 0) {
      const Vec3 step = now.offset - last.offset;
      const double squared = step.squaredNorm();
      if (squared > 1e-14)
        contact_ = std::clamp(-(now.force - last.force).dot(step) / squared, 0.0, stiffest);
    }
    // Too deep or too far out, along the line from the device.
    const Vec3 along = now.offset.squaredNorm() > 0.0 ? now.offset : now.force;
    (miss.dot(along) > 0.0 ? inside : outside) = now;
    last = now;
    offset = now.offset + miss / (stiffness_ + contact_);
    if (free) offset.setZero();
    if (inside && outside) {
      const Vec3 span = outside->offset - inside->offset;
      const double far = span.squaredNorm(), place = (offset - inside->offset).dot(span);
      if (!(place > 0.0 && place < far)) {
        const double in = inside->miss(stiffness_).norm(), out = outside->miss(stiffness_).norm();
        offset = inside->offset + span * (in / (in + out));
      }
    }
  }
  offset_ = best.offset;
  result.center = device + best.offset;
  result.force = stiffness_ * best.offset;
  result.residual = best_miss;
  return result;
}

}  // namespace burrlab
