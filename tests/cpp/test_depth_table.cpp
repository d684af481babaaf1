// Effective depth G(e, tau) of scheme `layer`: closed forms at its edges, order and bounds inside.
#include "burrlab/depth_table.hpp"

#include "check.hpp"

using burrlab::DepthTable;

namespace {

void check_order(double k) {
  const DepthTable& table = *DepthTable::of_order(k);
  // A full voxel at the surface, and a thin layer: tau [(k+1) Gamma(1 + 1/(k+1))^(k+1)]^(-1/k).
  CHECK_NEAR(table(0.0f, 1.0f), std::pow(k + 1.0, -1.0 / k), 1e-6);
  const double gamma = std::tgamma(1.0 + 1.0 / (k + 1.0));
  const double thin = std::pow((k + 1.0) * std::pow(gamma, k + 1.0), -1.0 / k);
  CHECK_NEAR(table(0.0f, 0.025f), 0.025 * thin, 1e-5);
  CHECK_NEAR(table(0.0f, 0.001f), 0.001 * thin, 1e-6);  // linear below the first node
  // A full voxel at depth e: the mean of x^k.
  for (const double e : {0.5, 1.0, 3.0}) {
    const double mean = (std::pow(e + 1.0, k + 1.0) - std::pow(e, k + 1.0)) / (k + 1.0);
    CHECK_NEAR(table(static_cast<float>(e), 1.0f), std::pow(mean, 1.0 / k), 1e-6 * (e + 1.0));
  }

  const auto& node = table.nodes();
  for (int i = 0; i < DepthTable::rows; ++i) {
    const float e = static_cast<float>(i) / DepthTable::rows_per_voxel;
    CHECK(table(e, 0.0f) == e);  // nothing left: the outer face
    for (int j = 0; j < DepthTable::columns; ++j) {
      const int at = i * DepthTable::columns + j;
      const float tau = static_cast<float>(j) / DepthTable::columns_per_unit;
      CHECK(node[at] >= e && node[at] <= e + 1.0f);
      CHECK_NEAR(table(e, tau), node[at], 1e-5);
      if (j > 0) CHECK(node[at] > node[at - 1]);
      if (i > 0) CHECK(node[at] > node[at - DepthTable::columns]);
    }
  }
}

}  // namespace

int main() {
  for (const double k : {0.5, 1.0, 1.5, 2.0, 3.0, 8.0}) check_order(k);
  const double pi = 3.14159265358979323846;
  CHECK_NEAR((*DepthTable::of_order(1.0))(0.0f, 0.01f), 2.0 / pi * 0.01, 1e-7);
  CHECK(DepthTable::of_order(2.0) == DepthTable::of_order(2.0));  // shared
  CHECK_THROWS(DepthTable::of_order(0.0), "order must be in (0, 8], got 0");
  CHECK_THROWS(DepthTable::of_order(8.5), "order must be in (0, 8], got 8.5");
  CHECK_THROWS(DepthTable::of_order(std::nan("")), "order must be in (0, 8]");
  return check::report();
}
