// What is done with one fuzz input.
#pragma once

#include "network/message_framer.hpp"

namespace fuzz {

/// Limit of the framers under test [bytes].
constexpr std::size_t largest_body = 4096;

/// Feeds `stream` to a framer, split as `splits` says, and every message to every decoder; ends the program
/// if an invariant fails. A valid message must then pass on a new connection. Returns the framer's counters,
/// without that message.
burrlab::openigtlink::Counters run(const burrlab::openigtlink::Bytes& stream, std::uint64_t splits);

}  // namespace fuzz
