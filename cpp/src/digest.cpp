// The fingerprint of a bone: 128 bits over its geometry, its present and its pristine levels.
#include <algorithm>
#include <cstdio>
#include <cstring>

#include "burrlab/voxel_bone.hpp"

namespace burrlab {
namespace {

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

std::string VoxelBone::digest() const {
  Hash128 total{0x6275727230u, 0x6C616231u};
  for (int axis = 0; axis < 3; ++axis) {
    total.mix(std::uint64_t(shape_[axis]));
    total.mix(bits(spacing_[axis]));
    total.mix(bits(origin_[axis]));
  }
  total.finish();
  each_brick({0, 0, 0}, shape_, [&](const Index3& at, std::size_t number) {
    std::uint8_t pristine[brick_voxels];
    copy_pristine(at, number, pristine);
    Hash128 brick{0x243F6A8885A308D3u ^ number, 0x13198A2E03707344u + number};
    const Index3 n = extent(at);
    for (std::int64_t z = 0; z < n[0]; ++z) {
      for (std::int64_t y = 0; y < n[1]; ++y) {
        const std::int64_t row = (z * brick_side + y) * brick_side;
        std::uint64_t now, before;  // beyond the volume they hold zeros
        std::memcpy(&now, tile(number) + row, sizeof now);
        std::memcpy(&before, pristine + row, sizeof before);
        brick.mix(now);
        brick.mix(before);
      }
    }
    brick.finish();
    total.add(brick);
  });
  char text[33];
  std::snprintf(text, sizeof text, "%016llx%016llx", static_cast<unsigned long long>(total.b),
                static_cast<unsigned long long>(total.a));
  return text;
}

}  // namespace burrlab
