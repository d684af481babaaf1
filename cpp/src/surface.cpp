// Surface nets (Gibson, Constrained elastic surface nets, MICCAI 1998, without the relaxation). A cell is a
// cube of eight voxel centres. Each part of the surface in it has one vertex: the mean of the part's
// crossings of the cell's edges. So the surface is a manifold (Nielson, Dual marching cubes, IEEE
// Visualization 2004). Each edge between two voxel centres that it crosses has one quad about it. Vertex and
// normal depend only on the levels of 4^3 voxels, in a fixed order, so blocks agree to the bit.
#include "surface.hpp"

#include <algorithm>
#include <array>
#include <cstring>
#include <numeric>
#include <string>

#include "brick_levels.hpp"
#include "brick_walk.hpp"
#include "require.hpp"

namespace burrlab {
namespace {

constexpr int margin = 2;  // voxels around a block that affect its vertices and normals
constexpr int side = surface_side + 2 * margin;
constexpr int last = surface_side + margin - 1;  // the block's own last voxel
constexpr std::array<int, 3> step = {1, side, side * side};
constexpr int most_parts = 4;  // of the surface in a cell

// Number 0..11 of the edge of a cell that leaves a corner along an axis.
constexpr int edge_number(int axis, int corner) {
  return 4 * axis + (corner >> (axis + 1) % 3 & 1) + 2 * (corner >> (axis + 2) % 3 & 1);
}

// The part of the surface, 0..3, that crosses each edge of a cell, by the cell's solid corners. On an
// ambiguous face, whose corners are solid and empty in turn, [0] joins the solid ones, so that thin walls
// hold, [1] the empty ones.
struct Parts {
  std::uint8_t of_edge[2][256][12];
  // The face, 2 axis + side, that a part of [0] crosses twice, else -1. No other face is ambiguous then.
  int twice[256];

  Parts() {
    for (int solid = 0; solid < 256; ++solid)
      for (int rule = 0; rule < 2; ++rule) divide(solid, rule);
  }

 private:
  // Joins the edges between which the surface crosses a face.
  void divide(int solid, int rule) {
    std::uint8_t* part = of_edge[rule][solid];
    std::iota(part, part + 12, std::uint8_t{0});
    const auto join = [&](int a, int b) {
      std::replace(part, part + 12, std::uint8_t(part[b]), std::uint8_t(part[a]));  // copies: both change
    };
    int edges[6][4];  // of each face, from each corner to the next
    bool ambiguous[6];
    for (int face = 0; face < 6; ++face) {
      const int axis = face / 2, first = (face & 1) << axis, u = 1 << (axis + 1) % 3, v = 1 << (axis + 2) % 3;
      const int corners[4] = {first, first | u, first | u | v, first | v};
      for (int i = 0; i < 4; ++i)
        edges[face][i] = edge_number((axis + 1 + i % 2) % 3, std::min(corners[i], corners[(i + 1) % 4]));
      for (int i = 0; i < 4; ++i) {
        const auto is_solid = [&](int k) { return (solid >> corners[(i + k) % 4] & 1) != 0; };
        const bool here = is_solid(0), alike = here == is_solid(2);
        const bool after = here != is_solid(1), before = here != is_solid(3);
        ambiguous[face] = after && before && alike;
        if (after && !before && !alike) join(edges[face][i], edges[face][(i + 2) % 4]);
        if (after && before && (!alike || here == (rule == 1)))
          join(edges[face][i], edges[face][(i + 3) % 4]);
      }
    }
    if (rule == 0) twice[solid] = -1;
    for (int face = 0; face < 6; ++face)
      if (rule == 0 && ambiguous[face] && part[edges[face][0]] == part[edges[face][2]]) twice[solid] = face;
    std::uint8_t count = 0;
    for (int edge = 0; edge < 12; ++edge)
      if (std::count(part, part + 12, edge) > 1) std::replace(part, part + 12, std::uint8_t(edge), count++);
  }
};
const Parts parts;

class Extraction {
 public:
  Extraction(const VoxelBone& bone, const Index3& block, int level)
      : bone_(bone),
        low_{block[0] * surface_side - margin, block[1] * surface_side - margin,
             block[2] * surface_side - margin},
        level_(level) {}

  SurfaceBlock run() {
    if (!load() || !classify()) return {};
    vertex_.assign(std::size_t(most_parts) * step[2] * side, -1);
    for (int axis = 0; axis < 3; ++axis) cross_edges(axis);
    return std::move(out_);
  }

 private:
  // Copies the levels; returns whether they can lie on both sides.
  bool load() {
    const Index3& bricks = bone_.bricks();
    Index3 first, last;
    for (int axis = 0; axis < 3; ++axis) {
      first[axis] = low_[axis] < 0 ? -1 : low_[axis] / brick_side;
      last[axis] = (low_[axis] + side - 1) / brick_side;
    }
    bool solid = true, empty = true;
    const auto each = [&](auto visit) {
      each_place(first, last, [&](const Index3& at) {
        bool inside = true;
        for (int axis = 0; axis < 3; ++axis) inside = inside && at[axis] >= 0 && at[axis] < bricks[axis];
        visit(at, inside ? std::int64_t(number_in(bricks, at)) : -1);
      });
    };
    each([&](const Index3&, std::int64_t brick) {
      const std::uint32_t mass = brick < 0 ? 0 : bone_.sums(std::size_t(brick)).mass;
      empty = empty && mass == 0;
      solid = solid && mass == 255u * brick_voxels;
      eroded_ = eroded_ || (brick >= 0 && bone_.is_eroded(std::size_t(brick)));
    });
    if (empty || solid) return false;
    levels_.assign(std::size_t(step[2]) * side, 0);
    each([&](const Index3& at, std::int64_t brick) {
      if (brick < 0 || bone_.sums(std::size_t(brick)).mass == 0) return;
      const std::uint8_t* tile = bone_.tile(std::size_t(brick));
      each_row(at, low_, {side, side, side},
               [&](std::int64_t in_tile, std::int64_t in_box, std::size_t length) {
                 std::memcpy(&levels_[std::size_t(in_box)], tile + in_tile, length);
               });
    });
    return true;
  }

  // One bit per voxel, one word per row: inside or not. Returns whether both occur.
  bool classify() {
    std::uint64_t any = 0, all = ~std::uint64_t{0};
    for (int row = 0; row < side * side; ++row) {
      const std::uint8_t* levels = &levels_[std::size_t(row * side)];
      std::uint64_t bits = 0;
      for (int x = 0; x < side; ++x) bits |= std::uint64_t(levels[x] >= level_) << x;
      inside_[std::size_t(row)] = bits;
      any |= bits;
      all &= bits;
    }
    return any != 0 && all != (std::uint64_t{1} << side) - 1;
  }

  // The quads about the block's own edges along an axis. The first block also owns those from outside.
  void cross_edges(int axis) {
    const auto first = [&](int a) { return low_[a] < 0 ? margin - 1 : margin; };
    const std::uint64_t own = ((std::uint64_t{2} << last) - 1) & ~((std::uint64_t{1} << first(2)) - 1);
    for (int z = first(0); z <= last; ++z)
      for (int y = first(1); y <= last; ++y) {
        const std::size_t row = std::size_t(z * side + y);
        const std::uint64_t here = inside_[row];
        const std::uint64_t next = axis == 0 ? here >> 1 : inside_[row + (axis == 1 ? 1 : side)];
        for (std::uint64_t crossed = (here ^ next) & own; crossed; crossed &= crossed - 1) {
          const int x = int(lowest_bit(crossed));
          quad(axis, int(row) * side + x, (here >> x & 1) != 0);
        }
      }
  }

  void quad(int axis, int voxel, bool solid_first) {
    const int u = step[std::size_t((axis + 1) % 3)], v = step[std::size_t((axis + 2) % 3)], edge = 4 * axis;
    std::int32_t corner[4] = {vertex(voxel - u - v, edge + 3), vertex(voxel - v, edge + 2),
                              vertex(voxel, edge), vertex(voxel - u, edge + 1)};
    if (!solid_first) std::swap(corner[1], corner[3]);
    // along the shorter diagonal
    const int turn = distance(corner[0], corner[2]) <= distance(corner[1], corner[3]) ? 0 : 1;
    const auto at = [&](int i) { return corner[(i + turn) & 3]; };
    out_.triangles.insert(out_.triangles.end(), {at(0), at(1), at(2), at(0), at(2), at(3)});
  }

  float distance(std::int32_t a, std::int32_t b) const {
    float sum = 0;
    for (int i = 0; i < 3; ++i) {
      const float d = out_.points[std::size_t(3 * a + i)] - out_.points[std::size_t(3 * b + i)];
      sum += d * d;
    }
    return sum;
  }

  // One bit per corner of a cell. A cell is named by its first voxel.
  int solid_corners(int cell) const {
    const auto pair = [&](int row) {
      return int(inside_[std::size_t(cell / side + row)] >> cell % side & 3);
    };
    return pair(0) | pair(1) << 2 | pair(side) << 4 | pair(side + 1) << 6;
  }

  // Parts of the surface in a cell. Where a part on each side of a face crosses it twice, four quads would
  // meet in an edge: both cells are by [1] then.
  const std::uint8_t* parts_in(int cell) const {
    const int solid = solid_corners(cell), face = parts.twice[solid];
    if (face < 0) return parts.of_edge[0][solid];
    const int beyond = cell + (face & 1 ? 1 : -1) * step[std::size_t(face / 2)];
    return parts.of_edge[parts.twice[solid_corners(beyond)] == (face ^ 1)][solid];
  }

  // Number of the vertex of the part that crosses a cell's edge, made if new.
  std::int32_t vertex(int cell, int edge) {
    const std::uint8_t* part = parts_in(cell);
    std::int32_t& number = vertex_[std::size_t(most_parts * cell + part[edge])];
    if (number >= 0) return number;
    number = std::int32_t(out_.tissues.size());
    const Vec3 at = crossing_mean(cell, part, part[edge]), n = normal(cell, at);
    const std::array<std::int64_t, 3> first = {cell % side + low_[2], cell / side % side + low_[1],
                                               cell / step[2] + low_[0]};
    const Index3& shape = bone_.shape();
    const std::int64_t in_volume =
        ((first[2] + 1) * (shape[1] + 1) + first[1] + 1) * (shape[2] + 1) + first[0] + 1;
    out_.numbers.push_back(most_parts * in_volume + part[edge]);
    for (int axis = 0; axis < 3; ++axis) {
      const double index = double(first[std::size_t(axis)]) + at[axis];
      out_.points.push_back(float(bone_.origin()[axis] + bone_.spacing()[axis] * index));
      out_.normals.push_back(float(n[axis]));
    }
    out_.tissues.push_back(tissue(cell, first, at));
    out_.lost.push_back(eroded_ ? lost(cell, first) : 0);
    return number;
  }

  static int corner_step(int corner) {
    return (corner & 1) + (corner >> 1 & 1) * step[1] + (corner >> 2) * step[2];
  }

  // Place of a part in the cell, 0..1 along each axis.
  Vec3 crossing_mean(int cell, const std::uint8_t* part, int number) const {
    const double surface = level_ - 0.5;
    Vec3 sum = Vec3::Zero();
    int count = 0;
    for (int corner = 0; corner < 8; ++corner)
      for (int axis = 0; axis < 3; ++axis) {
        if (corner >> axis & 1) continue;
        const int a = levels_[std::size_t(cell + corner_step(corner))];
        const int b = levels_[std::size_t(cell + corner_step(corner | 1 << axis))];
        if ((a >= level_) == (b >= level_) || part[edge_number(axis, corner)] != number) continue;
        for (int other = 0; other < 3; ++other)
          sum[other] += other == axis ? (surface - a) / (b - a) : corner >> other & 1;
        ++count;
      }
    return sum / count;
  }

  // Against the gradient of the levels. At each corner of the cell: central differences along one axis,
  // weights 1 2 1 along the others. Between the corners: trilinear. All computed as sums over the 4^3 voxels
  // around, one axis after another.
  Vec3 normal(int cell, const Vec3& at) const {
    std::array<double, 4> slope[3], smooth[3];
    for (int axis = 0; axis < 3; ++axis) {
      const double f = at[axis], g = 1.0 - f;
      slope[axis] = {-g, -f, g, f};
      smooth[axis] = {g, 2.0 * g + f, g + 2.0 * f, f};
    }
    Vec3 wide = Vec3::Zero();
    for (int z = 0; z < 4; ++z) {
      double along_x = 0.0, along_y = 0.0, plain = 0.0;
      for (int y = 0; y < 4; ++y) {
        const std::uint8_t* row = &levels_[std::size_t(cell + (z - 1) * step[2] + (y - 1) * step[1] - 1)];
        double d = 0.0, w = 0.0;
        for (int x = 0; x < 4; ++x) {
          d += slope[0][x] * row[x];
          w += smooth[0][x] * row[x];
        }
        along_x += smooth[1][y] * d;
        along_y += slope[1][y] * w;
        plain += smooth[1][y] * w;
      }
      wide += Vec3(smooth[2][z] * along_x, smooth[2][z] * along_y, slope[2][z] * plain);
    }
    Vec3 narrow = Vec3::Zero();
    for (int corner = 0; corner < 8; ++corner) {
      const int here = levels_[std::size_t(cell + corner_step(corner))];
      for (int axis = 0; axis < 3; ++axis) narrow[axis] += corner >> axis & 1 ? here : -here;
    }
    for (const Vec3* gradient : {&wide, &narrow}) {
      const Vec3 out = -gradient->cwiseQuotient(bone_.spacing());
      if (out.squaredNorm() > 1e-6) return out.normalized();
    }
    return Vec3::UnitZ();  // equal on all sides, as in a plate of one voxel
  }

  std::uint8_t tissue(int cell, const std::array<std::int64_t, 3>& first, const Vec3& at) const {
    if (!bone_.tissues()) return 0;
    int best = 0;
    double least = 1e9;
    for (int corner = 0; corner < 8; ++corner) {
      if (levels_[std::size_t(cell + corner_step(corner))] < level_) continue;
      Vec3 away;
      for (int axis = 0; axis < 3; ++axis)
        away[axis] = (at[axis] - (corner >> axis & 1)) * bone_.spacing()[axis];
      if (away.squaredNorm() >= least) continue;
      least = away.squaredNorm();
      best = corner;
    }
    const Place place = locate(first, best);
    const TissueMap& map = *bone_.tissues();
    const std::uint8_t* tile = map.tile(place.brick);
    return tile ? tile[place.voxel] : map.number(place.brick);
  }

  std::uint8_t lost(int cell, const std::array<std::int64_t, 3>& first) const {
    int most = 0;
    for (int corner = 0; corner < 8; ++corner) {
      if (!within(first, corner)) continue;
      const Place place = locate(first, corner);
      if (!bone_.is_eroded(place.brick)) continue;
      const std::uint8_t* pristine = bone_.pristine_tile(place.brick);
      const int before = pristine ? pristine[place.voxel] : bone_.pristine_level(place.brick);
      most = std::max(most, before - levels_[std::size_t(cell + corner_step(corner))]);
    }
    return std::uint8_t(most);
  }

  struct Place {
    std::size_t brick;
    int voxel;
  };
  bool within(const std::array<std::int64_t, 3>& first, int corner) const {
    for (int axis = 0; axis < 3; ++axis) {
      const std::int64_t i = first[std::size_t(axis)] + (corner >> axis & 1);
      if (i < 0 || i >= bone_.shape()[std::size_t(2 - axis)]) return false;
    }
    return true;
  }
  Place locate(const std::array<std::int64_t, 3>& first, int corner) const {
    const std::int64_t x = first[0] + (corner & 1), y = first[1] + (corner >> 1 & 1),
                       z = first[2] + (corner >> 2);
    return {bone_.brick_number(z / brick_side, y / brick_side, x / brick_side),
            int(((z & 7) * brick_side + (y & 7)) * brick_side + (x & 7))};
  }

  const VoxelBone& bone_;
  Index3 low_;  // first voxel of the copy, (z, y, x)
  int level_;
  bool eroded_ = false;
  std::vector<std::uint8_t> levels_;
  std::array<std::uint64_t, side * side> inside_;
  std::vector<std::int32_t> vertex_;  // by cell; -1: not made
  SurfaceBlock out_;
};

}  // namespace

SurfaceBlock extract_surface(const VoxelBone& bone, const Index3& block, int level) {
  if (level < 1 || level > 255) refuse("level", "from 1 to 255", level);
  const Index3 n = covering(bone.shape(), surface_side);
  for (std::size_t axis = 0; axis < 3; ++axis)
    if (block[axis] < 0 || block[axis] >= n[axis])
      refuse("every index of a block", "from 0 to below " + std::to_string(n[axis]), double(block[axis]));
  return Extraction(bone, block, level).run();
}

}  // namespace burrlab
