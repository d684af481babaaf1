#include "effects/sources.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "philox.hpp"
#include "portable_math.hpp"

namespace burrlab {

constexpr std::int64_t most_of_a_brick = 64;     // parcels of dust, in a frame
constexpr std::int64_t most_of_a_nozzle = 1024;  // parcels, in a frame

static const BurrAt* nearest(const std::vector<BurrAt>& burrs, const Vec3& place) {
  const BurrAt* found = nullptr;
  double least = 0.0;
  for (const BurrAt& burr : burrs) {
    const double distance = (place - burr.center).norm() - burr.radius;
    if (found && distance >= least) continue;
    least = distance;
    found = &burr;
  }
  return found;
}

double EffectDraws::number() {
  if (count_ == 0) {
    const PhiloxBlock block = philox4x32<philox_rounds>({std::uint32_t(frame_), std::uint32_t(frame_ >> 32),
                                                         std::uint32_t(block_), std::uint32_t(block_ >> 32)},
                                                        seed_);
    std::copy(block.begin(), block.end(), left_);
    ++block_;
    count_ = 4;
  }
  return double(left_[--count_]) * 0x1p-32;
}

Vec3 EffectDraws::in_ball() {
  for (;;) {
    const double x = 2.0 * number() - 1.0, y = 2.0 * number() - 1.0, z = 2.0 * number() - 1.0;
    if (x * x + y * y + z * z <= 1.0) return {x, y, z};
  }
}

void Sources::split(std::int64_t quanta, double parcel, int substance, const Emission& like,
                    EffectDraws& draws, std::vector<Emission>& out) const {
  const auto wanted = std::int64_t(std::ceil(double(quanta) * quantum_ / parcel));
  const std::int64_t count = std::clamp(wanted, std::int64_t{1}, std::min(quanta, most_of_a_nozzle));
  for (std::int64_t i = 0; i < count; ++i) {
    Emission made = like;
    made.mass[std::size_t(substance)] = quanta / count + (i < quanta % count);
    made.part = draws.number();
    made.velocity += (parameters_->water_spread * like.velocity.norm()) * draws.in_ball();
    out.push_back(made);
  }
}

// A free place, towards the burr's centre and on through the burr: outside the volume nothing is solid.
Vec3 Sources::free_place(const LevelField& field, const Vec3& place, const BurrAt* burr) const {
  Vec3 way = burr ? Vec3(burr->center - place) : Vec3(-down_);
  if (way.norm() < 1e-9) way = -down_;
  way *= 0.5 * field.least_spacing() / way.norm();
  Vec3 at = place;
  while (field.solid(at)) at += way;
  return at;
}

void Sources::remove(const LevelField& field, std::size_t brick, const BrickLoss& loss,
                     const std::vector<BurrAt>& burrs, EffectDraws& draws, std::vector<Emission>& out) {
  if (loss.lost == 0) return;
  const TissueMap* tissues = field.tissues().get();
  if (removed_.empty()) removed_.resize(tissues ? tissues->table().size() : 1, 0);
  const std::uint8_t* numbers = tissues ? tissues->tile(brick) : nullptr;
  double opened = 0.0;
  int bleeding_voxel = -1;
  for (int i = 0; i < brick_voxels; ++i) {
    const std::uint8_t lost = loss.by_voxel[std::size_t(i)];
    if (!lost) continue;
    const std::size_t number = numbers ? numbers[i] : tissues ? tissues->number(brick) : 0;
    removed_[number] += lost;
    if (!tissues || !tissues->table()[number].bleeds) continue;
    opened += quantum_ * lost;
    bleeding_voxel = i;
  }

  const auto wanted = std::int64_t(std::ceil(double(loss.lost) * quantum_ / parameters_->dust_parcel));
  const std::int64_t count = std::min({wanted, loss.lost, most_of_a_brick});
  for (std::int64_t n = 0; n < count; ++n) {
    // The voxel of a level drawn from the lost ones.
    auto chosen = std::int64_t(draws.number() * double(loss.lost));
    int voxel = 0;
    while (chosen >= loss.by_voxel[std::size_t(voxel)]) chosen -= loss.by_voxel[std::size_t(voxel++)];
    const Vec3 from = field.center(brick, voxel);
    const BurrAt* burr = nearest(burrs, from);
    Vec3 along = burr ? spin_.cross(from - burr->center) : Vec3::Zero();
    if (along.norm() < 1e-9) along = draws.in_ball();
    along /= std::max(along.norm(), 1e-9);
    out.push_back({free_place(field, from, burr),
                   parameters_->dust_speed * (along + parameters_->dust_spread * draws.in_ball()),
                   {loss.lost / count + (n < loss.lost % count), 0, 0},
                   draws.number()});
  }

  if (bleeding_voxel < 0) return;
  Wound& wound = wounds_[brick];
  wound.rate += parameters_->blood_rate * opened;
  const Vec3 from = field.center(brick, bleeding_voxel);
  wound.place = free_place(field, from, nearest(burrs, from));
}

void Sources::bleed(double seconds, EffectDraws& draws, std::vector<Emission>& out) {
  const double decay = parameters_->blood_decay, kept = portable::exp(-seconds / decay);
  for (auto at = wounds_.begin(); at != wounds_.end();) {
    Wound& wound = at->second;
    wound.ready += wound.rate * decay * (1.0 - kept);
    wound.rate *= kept;
    const double to_come = wound.rate * decay;
    if (wound.ready >= std::max(parameters_->blood_parcel, quantum_) ||
        (to_come < quantum_ && wound.ready >= quantum_)) {
      const auto quanta = std::int64_t(wound.ready / quantum_);
      wound.ready -= double(quanta) * quantum_;
      split(quanta, parameters_->blood_parcel, blood, {wound.place, Vec3::Zero()}, draws, out);
    }
    at = to_come + wound.ready < quantum_ ? wounds_.erase(at) : std::next(at);
  }
}

double Sources::bleeding() const {
  double rate = 0.0;
  for (const auto& wound : wounds_) rate += wound.second.rate;
  return rate;
}

void Sources::irrigate(const Nozzle& nozzle, double seconds, const std::vector<BurrAt>& burrs,
                       const std::vector<BurrAt>& before, EffectDraws& draws, std::vector<Emission>& out) {
  if (nozzle.burr >= int(burrs.size())) return;
  water_ready_ += nozzle.rate * seconds / quantum_;
  const auto quanta = std::int64_t(water_ready_);
  water_ready_ -= double(quanta);
  if (quanta == 0) return;
  Vec3 now = Vec3::Zero(), last = Vec3::Zero();
  if (nozzle.burr >= 0) {
    const auto which = std::size_t(nozzle.burr);
    now = burrs[which].center;
    last = which < before.size() ? before[which].center : now;
  }
  Emission like;
  like.velocity = nozzle.direction.normalized() * nozzle.speed;
  const std::size_t first = out.size();
  split(quanta, parameters_->water_parcel, water, like, draws, out);
  for (std::size_t i = first; i < out.size(); ++i)
    out[i].place = nozzle.position + now + out[i].part * (last - now);
}

}  // namespace burrlab
