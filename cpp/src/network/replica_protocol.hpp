// Messages between a leader and its replicas: NDARRAY messages of OpenIGTLink with their own device names,
// byte by byte in docs/wire.md.
#pragma once

#include <string>

#include "burrlab/session/tick_record.hpp"
#include "network/openigtlink.hpp"

namespace burrlab::replica_protocol {

constexpr std::uint32_t version = 2;       ///< 2: with orientation and buttons
constexpr std::uint32_t law_version = 3;   ///< of a hello whose tools have another law than the paper's
constexpr std::size_t digest_digits = 32;  ///< hexadecimal digits of a bone's digest
constexpr std::size_t brick_bytes = 4 + 2 * 512;  ///< number, q, p
constexpr std::size_t bricks_a_message = 60;
constexpr std::size_t longest_text = 900000;             ///< of a hello [bytes]
constexpr std::uint64_t exact = std::uint64_t(1) << 53;  ///< integers up to this are exact in float64

/// Kinds of messages, in the order of their names in the source.
enum class Kind { other, word, hello, tick, digest, bricks, idle, end };
Kind kind_of(const openigtlink::Message& message);

enum class Holds : std::uint32_t {
  nothing = 0,  ///< not even the initial volume: wants the hello only
  ticks = 1,    ///< the bone after `tick` ticks
  suspect = 2,  ///< as `ticks`, but different from the leader's: wants bricks too
  all = 3       ///< all it wants: leaves for good
};

/// The only message of a replica, sent on connecting and before it leaves for good.
struct Word {
  Holds holds = Holds::nothing;
  std::uint64_t session = 0;                             ///< number of the followed session; 0: none yet
  std::uint64_t tick = 0;                                ///< ticks executed
  std::string digest = std::string(digest_digits, '0');  ///< of its initial volume
  std::uint32_t version = replica_protocol::version;
};

struct Hello {
  std::uint32_t version = replica_protocol::version;
  std::uint64_t session = 0;     ///< random number that names the session
  std::uint64_t first_tick = 0;  ///< ticks executed on the initial volume
  std::string digest;            ///< of the initial volume
  std::string text;              ///< JSON about the session
};

struct TickMessage {
  TickRecord record;              ///< index, k, burrs, time; per burr the first two blocks,
                                  ///< orientation and buttons
  std::uint64_t digest_tick = 0;  ///< of the last digest sent before this tick
};

struct Digest {
  std::uint64_t tick = 0;  ///< ticks executed
  std::string digest;
};

/// Some of the bricks that differ from the initial volume.
struct Bricks {
  std::uint64_t tick = 0;              ///< ticks executed
  std::string digest;                  ///< of the whole bone at that tick
  std::uint32_t total = 0, first = 0;  ///< bricks in all, and before this message
  openigtlink::ByteView bricks;        ///< `brick_bytes` each: number, 512 q, 512 p
};

struct Idle {
  std::uint64_t tick = 0;  ///< ticks executed so far
};

struct End {
  std::uint64_t tick = 0;
  std::string digest;
  std::uint32_t failed = 0;  ///< 1: ended on a fault
  std::string reason;
};

// Each appends one message with a header of version 1 or 2.
void encode(openigtlink::Bytes& out, int header_version, const Word& word);
void encode(openigtlink::Bytes& out, int header_version, const Hello& hello);
void encode(openigtlink::Bytes& out, int header_version, const TickMessage& tick);
void encode(openigtlink::Bytes& out, int header_version, const Digest& digest);
void encode(openigtlink::Bytes& out, int header_version, const Bricks& bricks);
void encode(openigtlink::Bytes& out, int header_version, const Idle& idle);
void encode(openigtlink::Bytes& out, int header_version, const End& end);

// False if the message is of another kind, or its content is invalid.
bool decode(const openigtlink::Message& message, Word& word);
bool decode(const openigtlink::Message& message, Hello& hello);
bool decode(const openigtlink::Message& message, TickMessage& tick);
bool decode(const openigtlink::Message& message, Digest& digest);
bool decode(const openigtlink::Message& message, Bricks& bricks);
bool decode(const openigtlink::Message& message, Idle& idle);
bool decode(const openigtlink::Message& message, End& end);

}  // namespace burrlab::replica_protocol
