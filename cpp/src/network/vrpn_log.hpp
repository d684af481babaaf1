// Logs that the library VRPN wrote: the messages that a connection carried, in a file (docs/wire.md).
#pragma once

#include <map>
#include <string>
#include <vector>

#include "network/vrpn.hpp"

namespace burrlab::vrpn {

/// The messages of one kind and sender, in the file's order. The states of all buttons are messages of a
/// button each.
struct LoggedMessages {
  Kind kind = Kind::none;
  std::string sender;
  std::vector<std::int64_t> times;    ///< [us since epoch]
  std::vector<std::int32_t> numbers;  ///< of the sensor or button
  /// Of each message: position [mm] and orientation (w, x, y, z); velocity [mm/s], turn (w, x, y, z) within
  /// step [s], and step; force [N]; or whether a button is pressed. They need not be finite.
  std::vector<double> values;
};

struct Log {
  std::vector<LoggedMessages> messages;
  std::map<std::string, std::uint64_t> others;  ///< messages of other types by name
};

/// Reads a whole log, whose cookie is passed over. Throws InvalidArgument at a message that is not
/// whole.
Log read_log(ByteView file);

}  // namespace burrlab::vrpn
