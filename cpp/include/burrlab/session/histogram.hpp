// A histogram that one thread fills and any thread reads while it is filled.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <vector>

namespace burrlab {

/// Values [us] in bins that are 1/32 of their value wide, from 1/16 us to 1 s and beyond.
class Histogram {
 public:
  static constexpr int bins_per_octave = 32, octaves = 25, bins = bins_per_octave * octaves;
  static constexpr double lowest = 0.0625;  ///< upper end of the first octave's begin [us]

  void add(double microseconds) noexcept;  ///< one thread only

  std::uint64_t count() const { return count_.load(std::memory_order_relaxed); }
  double largest() const { return largest_.load(std::memory_order_relaxed); }  ///< [us]
  /// Upper end of the bin that holds quantile p of the values [us], at most the largest; NaN without values.
  double quantile(double p) const;
  std::vector<std::uint64_t> counts() const;
  static std::vector<double> edges();  ///< bins + 1 of them [us]; the first is 0, the last infinite

 private:
  static int bin_of(double microseconds) noexcept;
  std::array<std::atomic<std::uint64_t>, bins> bin_{};
  std::atomic<std::uint64_t> count_{0};
  std::atomic<double> largest_{0.0};
};

}  // namespace burrlab
