// The effective depth of the bone left in a voxel, in the scheme `layer`: a table of G(e, tau).
#pragma once

#include <array>
#include <memory>

namespace burrlab {

/// G(e, tau) = [ int x^k exp(-a x^(k+1)) dx / tau ]^(1/k) over x = e..e+1, with a from int exp(-a x^(k+1)) dx
/// = tau. G is the depth, in voxels, at which a steady layer cut at the voxel's faces erodes as fast as its
/// mean. e is the depth of the voxel's outer face, tau the fraction left, k the order of the zero of f at r =
/// R. Bilinear between the nodes e = 0, 1/8 .. 3 and tau = 0, 1/40 .. 1.
class DepthTable {
 public:
  static constexpr int rows = 25, columns = 41;  // e, tau
  static constexpr float rows_per_voxel = 8.0f, columns_per_unit = 40.0f;

  /// The table of an order k in (0, 8], computed once per process. The bits are the same on every CPU.
  static std::shared_ptr<const DepthTable> of_order(double k);

  const std::array<float, rows * columns>& nodes() const { return node_; }
  /// The table by cells, (24, 40, 4): the value at (i, j) and its rise to j + 1, then both at i + 1. Aligned
  /// to 16 bytes, so that one load reads a cell.
  const float* cells() const { return cell_.data(); }

 private:
  explicit DepthTable(double k);
  std::array<float, rows * columns> node_;
  alignas(16) std::array<float, 4 * (rows - 1) * (columns - 1)> cell_;
};

}  // namespace burrlab
