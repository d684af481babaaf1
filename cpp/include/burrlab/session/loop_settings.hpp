// The settings of the haptic loop. It checks them when it is made.
//
//     burrlab::LoopSettings settings;
//     settings.guard.force = 3.0;  // the hand never gets more [N]
//     settings.message = [](const std::string& sentence) { std::puts(sentence.c_str()); };
#pragma once

#include <cstdint>
#include <functional>
#include <limits>
#include <string>
#include <vector>

#include "burrlab/session/device.hpp"

namespace burrlab {

/// What a thread asks for.
struct RealtimeRequest {
  bool priority = true;     ///< first-in-first-out scheduling before all ordinary threads
  int level = 80;           ///< of the priority
  bool lock_memory = true;  ///< keeps all pages of the process in memory
  int cpu = -1;             ///< to run on; -1: any
};

/// What a guard keeps to. The defaults are ours: above what burring needs (2 N and a few N/mm at 100 mm/s),
/// below what a desktop device gives for long; no continuous limit, no ramp.
struct GuardLimits {
  double force = 8.0;                                           ///< size of a force [N]
  double slew = 1.0;                                            ///< its change [N/ms]
  double continuous = std::numeric_limits<double>::infinity();  ///< its RMS over the window [N]
  double window = 10.0;  ///< time constant of the exponential window [s]; ours
  double ramp = 0.0;     ///< time over which the allowed force grows from zero after the first contact [s]
};

/// position = scale x rotation x device + offset. The default changes nothing.
struct DeviceFrame {
  double scale = 1.0;                       ///< of motion; forces are not scaled
  Quaternion rotation{1.0, 0.0, 0.0, 0.0};  ///< unit quaternion, device axes to bone axes
  Vec3 offset = Vec3::Zero();               ///< of the device's origin, bone frame [mm]
  int clutch = -1;  ///< while this button is held the burr stands still, at zero force; -1: none
};

/// What a session asks for.
struct LoopSettings {
  bool wall_clock = true;             ///< false: one period after another, as fast as possible
  RealtimeRequest realtime{};         ///< used with the wall clock
  double stall_limit = 100.0;         ///< the session stops after this time without a tick [ms]
  double ring = 60.0;                 ///< time of records kept for readers [s]
  std::uint64_t ticks = 0;            ///< after which the session ends; 0: it runs until `stop`
  GuardLimits guard{};                ///< of each burr without an own one in `guards`
  double coupling = 0.0;              ///< spring between device and burr [N/mm]; 0: none
  std::vector<DeviceFrame> frames{};  ///< one a device; empty: the devices' positions are the bone's
  std::vector<GuardLimits> guards{};  ///< one a burr, or none
  std::vector<DeviceModel> models{};  ///< one a burr, or none: what a device does not say itself
  double stop_force = std::numeric_limits<double>::infinity();  ///< the session ends when it is wanted [N]
  std::uint32_t stop_buttons = 0;                               ///< bits of buttons that end the session
  /// Called by the loop's thread, before its first tick with what the system granted, a sentence each, and
  /// after the last with why it ended. It must not throw, call the loop, or
  /// wait for a thread that starts or stops it.
  std::function<void(const std::string&)> message{};
};

}  // namespace burrlab
