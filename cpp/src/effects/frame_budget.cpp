#include "effects/frame_budget.hpp"

#include <algorithm>

namespace burrlab {

constexpr double share = 0.5;     // of the budget, planned for sub-steps
constexpr double most = 0.7;      // of the budget, for a single sub-step; above it parcels merge
constexpr double forget = 0.2;    // weight of the newest frame
constexpr double enough = 256.0;  // movements or parcels; with fewer a cost means nothing

FrameDecision FrameBudget::plan(std::size_t moving, std::size_t parcels, int sub_steps,
                                std::int64_t limit) const {
  FrameDecision plan;
  plan.merge_to = limit;
  const double planned = share * nanoseconds_, fixed = of_parcel_ * double(parcels);
  const double each = of_move_ * double(moving);
  plan.sub_steps = sub_steps;
  while (plan.sub_steps > 1 && fixed + each * plan.sub_steps > planned) --plan.sub_steps;
  if (fixed + each > most * nanoseconds_) {
    const double part = planned / (fixed + each);
    plan.merge_to = std::min(limit, std::max(std::int64_t(part * double(parcels)), least_parcels));
  }
  plan.done = plan.sub_steps;
  return plan;
}

void FrameBudget::learn(double moves, double moving_time, double parcels, double other_time) {
  if (moves > enough) of_move_ += forget * (moving_time / moves - of_move_);
  if (parcels > enough) of_parcel_ += forget * (other_time / parcels - of_parcel_);
}

}  // namespace burrlab
