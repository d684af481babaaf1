// The digest of a bone: 128 bits over geometry, present and pristine levels.
#include "burrlab/digest.hpp"

#include <cstdio>
#include <cstring>

namespace burrlab {
namespace {

std::uint64_t bits(const void* of) {
  std::uint64_t word;
  std::memcpy(&word, of, sizeof word);
  return word;
}

void mix(Hash128& h, std::uint64_t word) {
  h.a = (h.a ^ word) * 0x9E3779B97F4A7C15u;
  h.a ^= h.a >> 29;
  h.b = (h.b + word) * 0xBF58476D1CE4E5B9u;
  h.b ^= h.b >> 32;
}

void finish(Hash128& h) {
  for (int i = 0; i < 2; ++i) {
    h.a = (h.a ^ (h.a >> 30) ^ h.b) * 0x94D049BB133111EBu;
    h.b = (h.b ^ (h.b >> 27) ^ h.a) * 0xBF58476D1CE4E5B9u;
  }
  h.a ^= h.a >> 31;
  h.b ^= h.b >> 31;
}

void of_text(Hash128& hash, const std::string& text) {
  mix(hash, text.size());
  for (const char c : text) mix(hash, static_cast<unsigned char>(c));
}

void of_table(Hash128& hash, const Tissues& table) {
  mix(hash, table.size());
  of_text(hash, table.material().shape.name());
  const double exponents[] = {table.material().force_exponent, table.material().rate_exponent};
  if (exponents[0] != Material::paper_force_exponent || exponents[1] != 0.0)
    for (const double& exponent : exponents) mix(hash, bits(&exponent));
  for (std::size_t i = 0; i < table.size(); ++i) {
    const Tissue& tissue = table[i];
    of_text(hash, tissue.name);
    mix(hash, static_cast<std::uint32_t>(tissue.label));
    mix(hash, bits(&tissue.c_e));
    mix(hash, bits(&tissue.alpha));
    mix(hash, tissue.critical | tissue.bleeds << 1 | tissue.assumed << 2);
    for (const std::uint8_t part : tissue.colour) mix(hash, part);
  }
}

Hash128 of_geometry(const VoxelBone& bone) {
  Hash128 hash{0x6275727230u, 0x6C616231u};
  for (int axis = 0; axis < 3; ++axis) {
    mix(hash, std::uint64_t(bone.shape()[axis]));
    mix(hash, bits(&bone.spacing()[axis]));
    mix(hash, bits(&bone.origin()[axis]));
  }
  if (bone.tissues()) of_table(hash, bone.tissues()->table());
  finish(hash);
  return hash;
}

Hash128 of_brick(const VoxelBone& bone, std::size_t number) {
  std::uint8_t density[brick_voxels], pristine[brick_voxels];
  bone.read_brick(number, density, pristine);
  Hash128 hash{0x243F6A8885A308D3u ^ number, 0x13198A2E03707344u + number};
  const Index3 n = bone.extent(number);
  for (std::int64_t z = 0; z < n[0]; ++z) {
    for (std::int64_t y = 0; y < n[1]; ++y) {
      const std::int64_t row = (z * brick_side + y) * brick_side;
      mix(hash, bits(density + row));  // zeros beyond the volume
      mix(hash, bits(pristine + row));
    }
  }
  if (bone.tissues()) {
    const std::uint8_t* numbers = bone.tissues()->tile(number);
    if (!numbers) mix(hash, bone.tissues()->number(number));
    for (int i = 0; numbers && i < brick_voxels; i += 8) mix(hash, bits(numbers + i));
  }
  finish(hash);
  return hash;
}

}  // namespace

void Hash128::add(const Hash128& other) {
  a += other.a;
  b += other.b + (a < other.a ? 1 : 0);
}

void Hash128::subtract(const Hash128& other) {
  b -= other.b + (a < other.a ? 1 : 0);
  a -= other.a;
}

std::string Hash128::text() const {
  char digits[33];
  std::snprintf(digits, sizeof digits, "%016llx%016llx", static_cast<unsigned long long>(b),
                static_cast<unsigned long long>(a));
  return digits;
}

std::string VoxelBone::digest() const {
  const Reading reading(*this);
  return RunningDigest(*this).total().text();
}

RunningDigest::RunningDigest(const VoxelBone& bone) : brick_(bone.brick_count()), total_(of_geometry(bone)) {
  for (std::size_t brick = 0; brick < brick_.size(); ++brick)
    total_.add(brick_[brick] = of_brick(bone, brick));
}

void RunningDigest::update(const VoxelBone& bone, const std::vector<std::uint32_t>& changed) {
  for (const std::uint32_t brick : changed) {
    total_.subtract(brick_[brick]);
    total_.add(brick_[brick] = of_brick(bone, brick));
  }
}

}  // namespace burrlab
