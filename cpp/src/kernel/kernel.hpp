// The tick's code for one brick, by instruction set. Plain data only: files that include this are compiled
// for different CPUs, and must not share inline functions.
#pragma once

#include <cstdint>

namespace burrlab::kernel {

enum ShapeKind : int { shape_constant, shape_linear, shape_power };

/// The layout of DepthTable::cells() [floats]; tick.cpp checks it.
constexpr float depth_rows_per_voxel = 8.0f, depth_columns_per_unit = 40.0f;
constexpr int depth_cell = 4, depth_row = 160;

/// The random numbers of one tick: key schedule and counter words of Philox4x32 (docs/tick.md).
struct Draws {
  std::uint64_t key[7][2];                 // of each round: 32 bits in words that a load spreads over lanes
  std::uint32_t tick_low, tick_high, who;  // counter words 1, 2, 3 of draw 0
  // What the first two rounds leave of the words that are the same for all voxels.
  std::uint64_t after0_x2, after1_x0, after1_x2, after1_x3;
};

Draws draws(std::uint64_t seed, std::uint64_t tick, std::uint32_t who);  // who: burr index + 2^31 draw

/// One sphere in one tick, with the names of docs/tick.md.
struct Sphere {
  float fraction[3];  // of the position, (x, y, z) [voxel]
  float spacing[3];   // (x, y, z) [mm]
  float spacing_inverse;
  float radius, radius_inverse, radius2_inverse;  // R, 1/R, inv_R2
  float outer2;                                   // a voxel beyond this r2 has w = 0
  float deep2;                                    // a voxel within this r2 is deep
  ShapeKind shape;
  int integer_order;  // the exponent of y if it is a whole number, else 0
  double exponent;
  void (*power)(float* y, double k);  // of a row, for exponents that are not whole
  const float* depth_table;           // DepthTable::cells(); null if f needs no depth
  const float* shape_table;           // Shape::Table::nodes of y over the depth, or null
  int table_size;                     // of each of its three parts
  Draws draws;
};

constexpr int most_tissues = 64, few_tissues = 16;

/// By tissue, `most_tissues` of each; for bricks of several tissues.
struct TissueTables {
  const std::int32_t* stiffness;  // K_l [1/4096 N/mm^2]
  const float* fraction_scale;    // a_k
  const std::int32_t* doublings;  // k
  int most_doublings;
  bool few;  // no number is `few_tissues` or more
};

/// One brick: its levels and its place.
struct Brick {
  std::uint8_t* density;         // 512 levels (z, y, x)
  const std::uint8_t* pristine;  // 512 levels, or null if all are `level`
  int level;
  bool faint;                        // some p lie in 1..31
  int x, y, z;                       // first voxel, from the voxel nearest to the centre
  std::uint32_t column;              // number of its first column
  std::uint32_t columns_in_slab;     // from one z to the next
  const std::uint8_t* voxel_tissue;  // 512 numbers, or null if all have the same K,
  float fraction_scale;              // its a_k
  int doublings;                     // and k
  const TissueTables* tables;        // if `voxel_tissue` is not null
};

/// Exact sums. Before the erosion: of M, of M times the voxel's index 0..7 in the brick, of M where p < 32,
/// and of K M in bricks of several tissues. After the erosion: of levels, and of levels times index.
struct Sums {
  std::int64_t mass, x, y, z, faint, stiffness;
  std::uint32_t after_mass, after_x, after_y, after_z;  // side by side, for vector stores
};

enum Pass : int { moments, erosion, both };

using Visit = void (*)(const Sphere&, const Brick&, Sums&);

/// The code for one instruction set.
struct Kernel {
  const char* name;
  Visit visit[3][2][2][2];                       // [pass][layer][isotropic][several tissues]
  void (*sum)(const std::uint8_t* tile, Sums&);  // the four `after` sums
  /// Sum of the levels of a tile where the tissue has this number.
  std::uint32_t (*sum_where)(const std::uint8_t* tile, const std::uint8_t* tissue, std::uint8_t number);
  /// U of a slab of a brick, (y, x); for tests.
  void (*draw)(const Draws&, std::uint32_t column, std::uint16_t* out);
};

const Kernel& current_kernel();  // as burrlab::cpu_path() names it

extern const Kernel scalar_kernel;
#if defined(__x86_64__) || defined(_M_X64)
#define BURRLAB_X86_64 1
extern const Kernel sse2_kernel, avx2_kernel, avx512_kernel;
#elif defined(__aarch64__) || defined(_M_ARM64)
#define BURRLAB_AARCH64 1
extern const Kernel neon_kernel;
#endif

}  // namespace burrlab::kernel
