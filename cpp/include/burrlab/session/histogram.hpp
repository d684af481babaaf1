// A histogram that one thread fills while any thread reads.
//
//     const double usual = loop.tick_time().quantile(0.5);  // [us]
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <vector>

#include "burrlab/error.hpp"

namespace burrlab {

/// Values [us] in 32 bins per octave, from 1/16 us to 1 s and beyond.
class BURRLAB_API Histogram {
 public:
  static constexpr int bins_per_octave = 32;              ///< bins
  static constexpr int octaves = 25;                      ///< octaves
  static constexpr int bins = bins_per_octave * octaves;  ///< in all
  static constexpr double lowest = 0.0625;                ///< lower end of the first octave [us]

  void add(double microseconds) noexcept;  ///< one thread only

  /// Values added.
  std::uint64_t count() const { return count_.load(std::memory_order_relaxed); }
  double largest() const { return largest_.load(std::memory_order_relaxed); }  ///< [us]
  /// Upper end of the bin of quantile p [us], at most the largest value; NaN without values.
  double quantile(double p) const;
  std::vector<std::uint64_t> counts() const;  ///< in each bin
  static std::vector<double> edges();         ///< bins + 1 edges [us]; the first is 0, the last infinite

 private:
  static int bin_of(double microseconds) noexcept;
  std::array<std::atomic<std::uint64_t>, bins> bin_{};
  std::atomic<std::uint64_t> count_{0};
  std::atomic<double> largest_{0.0};
};

}  // namespace burrlab
