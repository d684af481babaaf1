// What one fuzz input is put through.
#pragma once

#include "burrlab/network/message_framer.hpp"

namespace fuzz {

/// Limit of the framers under test [bytes].
constexpr std::size_t largest_body = 4096;

/// Feeds `stream` to a framer, split where `splits` says, and every message to every decoder; ends the
/// program where an invariant does not hold. Afterwards, on a new connection, a valid message must come
/// through. Returns the framer's counters, less that message.
burrlab::openigtlink::Counters run(const burrlab::openigtlink::Bytes& stream, std::uint64_t splits);

}  // namespace fuzz
