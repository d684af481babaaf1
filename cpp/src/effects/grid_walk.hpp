// Every cell of a grid that a segment meets, in order.
// Amanatides, Woo, A fast voxel traversal algorithm for ray tracing, Eurographics 1987.
#pragma once

#include <algorithm>
#include <array>
#include <limits>

#include "burrlab/types.hpp"

namespace burrlab {

using Cell3 = std::array<std::int64_t, 3>;  // (x, y, z)

/// Cells of edge `size` in [low, high) that `from + t move`, t in [begin, end], meets. visit(cell, t, axis)
/// tells the t of entry and the axis it was entered along, -1 at the beginning, and returns true to stop.
template <class Visit>
bool walk_grid(const Vec3& from, const Vec3& move, double begin, double end, double size, const Cell3& low,
               const Cell3& high, int axis, Visit visit) {
  Cell3 cell;
  double next[3];
  const auto crossing = [&](int i) {
    if (move[i] == 0.0) return std::numeric_limits<double>::infinity();
    return (double(cell[i] + (move[i] > 0.0)) * size - from[i]) / move[i];
  };
  for (int i = 0; i < 3; ++i) {
    // Truncation is rounding down here: `low` is not negative.
    cell[i] = std::clamp(std::int64_t((from[i] + begin * move[i]) / size), low[i], high[i] - 1);
    next[i] = crossing(i);
  }
  for (double t = begin;;) {
    if (visit(cell, t, axis)) return true;
    axis = next[0] <= next[1] ? (next[0] <= next[2] ? 0 : 2) : (next[1] <= next[2] ? 1 : 2);
    if (next[axis] > end) return false;
    t = std::max(t, next[axis]);
    cell[axis] += move[axis] > 0.0 ? 1 : -1;
    if (cell[axis] < low[axis] || cell[axis] >= high[axis]) return false;
    next[axis] = crossing(axis);
  }
}

}  // namespace burrlab
