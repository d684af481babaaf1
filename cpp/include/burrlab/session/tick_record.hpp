// The record of one tick of a session: what is needed to execute it again, and its results.
//
//     burrlab::TickRecord record;
//     if (loop.ring()->read(0, record)) std::printf("%g s, h = %g mm\n", record.time,
//     record.burr[0].penetration);
#pragma once

#include <array>
#include <cstdint>
#include <type_traits>

namespace burrlab {

constexpr int most_burrs = 2;    ///< on one bone at once
constexpr int most_periods = 8;  ///< that one tick may stand for

/// One burr in one tick. The first block is the tick's input, the second the model's results, the third is
/// for analysis only.
struct BurrRecord {
  std::array<double, 3> center{};  ///< used in the tick, bone frame [mm]
  double radius = 0.0;             ///< [mm]
  std::uint32_t material = 0;      ///< number in the session's table
  std::uint8_t on = 0;             ///< the burr turns

  std::uint8_t touching = 0;      ///< bone inside the sphere
  std::uint8_t ambiguous = 0;     ///< the contact has no direction
  std::uint8_t buttons = 0;       ///< bit i: button i is pressed; for analysis only
  std::array<double, 3> force{};  ///< of the model, before limits and coupling [N]
  double penetration = 0.0;       ///< h [mm]
  std::int64_t removed = 0;       ///< [levels]

  std::array<double, 3> sent{};                           ///< force sent to the device [N]
  std::array<double, 3> device_position{};                ///< [mm]
  std::array<double, 3> device_velocity{};                ///< [mm/s]
  double age = 0.0;                                       ///< of the position [ms]
  std::array<double, 4> orientation{1.0, 0.0, 0.0, 0.0};  ///< DeviceReading::orientation
};

/// A tick, and its burrs by index.
struct TickRecord {
  std::uint64_t index = 0;  ///< number of executed ticks before this one
  std::uint32_t k = 1;      ///< periods it stands for: dt = k periods
  std::uint32_t burrs = 1;  ///< number of burrs in use

  double time = 0.0;      ///< of its beginning, since the session's start [s]
  double cpu_time = 0.0;  ///< of the thread, in this tick [us]

  std::array<BurrRecord, most_burrs> burr{};  ///< the first `burrs` are used
};

static_assert(std::is_trivially_copyable_v<TickRecord> && sizeof(TickRecord) % 8 == 0);
static_assert(sizeof(BurrRecord) == 192 && sizeof(TickRecord) == 32 + 2 * 192);

}  // namespace burrlab
