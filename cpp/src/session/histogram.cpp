#include "burrlab/session/histogram.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace burrlab {

// Octave o holds lowest 2^o .. lowest 2^(o+1); smaller values count in the first bin.
int Histogram::bin_of(double microseconds) noexcept {
  if (!(microseconds > lowest)) return 0;
  int exponent;
  const double mantissa = std::frexp(std::min(microseconds / lowest, 1e300), &exponent);  // 0.5..1
  const int bin =
      (exponent - 1) * bins_per_octave + static_cast<int>((2.0 * mantissa - 1.0) * bins_per_octave);
  return std::min(bin, bins - 1);
}

void Histogram::add(double microseconds) noexcept {
  auto& bin = bin_[static_cast<std::size_t>(bin_of(microseconds))];
  bin.store(bin.load(std::memory_order_relaxed) + 1, std::memory_order_relaxed);
  if (microseconds > largest()) largest_.store(microseconds, std::memory_order_relaxed);
  count_.store(count() + 1, std::memory_order_relaxed);
}

std::vector<std::uint64_t> Histogram::counts() const {
  std::vector<std::uint64_t> out(bins);
  std::transform(bin_.begin(), bin_.end(), out.begin(),
                 [](const auto& bin) { return bin.load(std::memory_order_relaxed); });
  return out;
}

std::vector<double> Histogram::edges() {
  std::vector<double> out(bins + 1);
  for (int i = 1; i < bins; ++i)
    out[static_cast<std::size_t>(i)] =
        std::ldexp(lowest * (1.0 + double(i % bins_per_octave) / bins_per_octave), i / bins_per_octave);
  out.back() = std::numeric_limits<double>::infinity();
  return out;
}

double Histogram::quantile(double p) const {
  const std::vector<std::uint64_t> counted = counts();
  std::uint64_t total = 0;
  for (const std::uint64_t n : counted) total += n;
  if (total == 0) return std::numeric_limits<double>::quiet_NaN();
  const double wanted = p * double(total);
  std::uint64_t sum = 0;
  std::size_t bin = 0;
  while (bin + 1 < counted.size() && double(sum += counted[bin]) < wanted) ++bin;
  return std::min(edges()[bin + 1], largest());
}

}  // namespace burrlab
