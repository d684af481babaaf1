#include "burrlab/voxel_bone.hpp"

#include <algorithm>
#include <cstdio>
#include <cstring>
#include <numeric>
#include <utility>

#include "burrlab/check.hpp"

namespace burrlab {
namespace {

std::int64_t sum_levels(const std::vector<std::uint8_t>& levels) {
  return std::accumulate(levels.begin(), levels.end(), std::int64_t{0});
}

struct Hash128 {
  std::uint64_t a, b;

  void mix(std::uint64_t word) {
    a = (a ^ word) * 0x9E3779B97F4A7C15u;
    a ^= a >> 29;
    b = (b + word) * 0xBF58476D1CE4E5B9u;
    b ^= b >> 32;
  }
  void finish() {
    for (int i = 0; i < 2; ++i) {
      a = (a ^ (a >> 30) ^ b) * 0x94D049BB133111EBu;
      b = (b ^ (b >> 27) ^ a) * 0xBF58476D1CE4E5B9u;
    }
    a ^= a >> 31;
    b ^= b >> 31;
  }
  void add(const Hash128& other) {  // 128-bit sum
    a += other.a;
    b += other.b + (a < other.a ? 1 : 0);
  }
};

std::uint64_t bits(double value) {
  std::uint64_t word;
  std::memcpy(&word, &value, sizeof word);
  return word;
}

}  // namespace

VoxelBone::VoxelBone(Index3 shape, std::vector<std::uint8_t> levels, const Vec3& spacing, const Vec3& origin)
    : shape_(shape), spacing_(spacing), origin_(origin + Vec3::Zero()), density_(std::move(levels)) {
  for (int axis = 0; axis < 3; ++axis) {
    if (shape_[axis] < 1) refuse("every side of the volume", "at least one voxel", double(shape_[axis]));
    require_positive("spacing", spacing_[axis]);
    require_finite("origin", origin_[axis]);
  }
  const double octets = double(shape_[0]) * double(shape_[1]) * double((shape_[2] + 7) / 8);
  if (octets >= 4294967296.0) refuse("voxels / 8 of the volume", "below 2^32", octets);
  if (std::int64_t(density_.size()) != size()) throw std::invalid_argument("levels do not fill the shape");
  pristine_ = std::make_shared<std::vector<std::uint8_t>>(density_);
  level_sum_ = sum_levels(density_);
}

double VoxelBone::removed() const { return (sum_levels(*pristine_) - level_sum_) * (voxel_volume() / 255.0); }

void VoxelBone::write(const Index3& start, const Index3& shape, const std::uint8_t* levels) {
  for (int axis = 0; axis < 3; ++axis) {
    if (start[axis] < 0 || shape[axis] < 0 || start[axis] > shape_[axis] ||
        shape[axis] > shape_[axis] - start[axis]) {
      throw std::invalid_argument("values must lie inside the volume: along axis " + std::to_string(axis) +
                                  " (z, y, x) " + std::to_string(shape[axis]) + " voxels from " +
                                  std::to_string(start[axis]) + " of " + std::to_string(shape_[axis]));
    }
  }
  if (pristine_.use_count() > 1) pristine_ = std::make_shared<std::vector<std::uint8_t>>(*pristine_);
  for (std::int64_t z = 0; z < shape[0]; ++z) {
    for (std::int64_t y = 0; y < shape[1]; ++y) {
      const std::int64_t at = ((start[0] + z) * shape_[1] + start[1] + y) * shape_[2] + start[2];
      const std::uint8_t* row = levels + (z * shape[1] + y) * shape[2];
      for (std::int64_t x = 0; x < shape[2]; ++x) level_sum_ += row[x] - density_[at + x];
      std::copy(row, row + shape[2], density_.begin() + at);
      std::copy(row, row + shape[2], pristine_->begin() + at);
    }
  }
}

void VoxelBone::reset() {
  density_ = *pristine_;
  level_sum_ = sum_levels(density_);
}

std::string VoxelBone::digest() const {
  constexpr std::int64_t side = 8;
  Hash128 total{0x6275727230u, 0x6C616231u};
  for (int axis = 0; axis < 3; ++axis) {
    total.mix(std::uint64_t(shape_[axis]));
    total.mix(bits(spacing_[axis]));
    total.mix(bits(origin_[axis]));
  }
  total.finish();
  std::uint64_t brick_index = 0;
  for (std::int64_t z0 = 0; z0 < shape_[0]; z0 += side) {
    for (std::int64_t y0 = 0; y0 < shape_[1]; y0 += side) {
      for (std::int64_t x0 = 0; x0 < shape_[2]; x0 += side) {
        Hash128 brick{0x243F6A8885A308D3u ^ brick_index, 0x13198A2E03707344u + brick_index};
        ++brick_index;
        const auto length = std::size_t(std::min(side, shape_[2] - x0));
        for (std::int64_t z = z0; z < std::min(z0 + side, shape_[0]); ++z) {
          for (std::int64_t y = y0; y < std::min(y0 + side, shape_[1]); ++y) {
            const std::int64_t at = (z * shape_[1] + y) * shape_[2] + x0;
            std::uint64_t now = 0, before = 0;  // rows past the edge hold zeros
            std::memcpy(&now, density_.data() + at, length);
            std::memcpy(&before, pristine_->data() + at, length);
            brick.mix(now);
            brick.mix(before);
          }
        }
        brick.finish();
        total.add(brick);
      }
    }
  }
  char text[33];
  std::snprintf(text, sizeof text, "%016llx%016llx", static_cast<unsigned long long>(total.b),
                static_cast<unsigned long long>(total.a));
  return text;
}

}  // namespace burrlab
