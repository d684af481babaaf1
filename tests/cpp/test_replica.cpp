// The replica protocol's messages, the log they are sent from, and a replica beside its leader.
#include "network/replica.hpp"

#include <cmath>
#include <cstring>
#include <limits>
#include <random>

#include "check.hpp"
#include "network/publisher.hpp"
#include "network/tick_log.hpp"
#include "session/hand_device.hpp"
#include "session_scenes.hpp"

using namespace burrlab;
using namespace burrlab::replica_protocol;
using openigtlink::Bytes;
using openigtlink::Drop;
using openigtlink::Message;

namespace {

const std::string digest = "0123456789abcdef0123456789abcdef";

Message message_of(const Bytes& bytes) {
  Message message;
  openigtlink::Header header;
  const openigtlink::ByteView body{bytes.data() + openigtlink::header_size,
                                   bytes.size() - openigtlink::header_size};
  CHECK(decode_header({bytes.data(), bytes.size()}, header) == Drop::none);
  CHECK(decode_body(header, body, message) == Drop::none);
  return message;
}

template <class Content>
Content back(const Content& content, int version, Kind kind) {
  Bytes bytes;
  encode(bytes, version, content);
  const Message message = message_of(bytes);
  CHECK(kind_of(message) == kind);
  Content other{};
  CHECK(decode(message, other));
  return other;
}

TickRecord extreme_record() {
  TickRecord record;
  record.index = exact;
  record.k = 8;
  record.burrs = 2;
  record.time = 1e9 / 3.0;
  for (BurrRecord& burr : record.burr) {
    burr.center = {-0.0, 1.0 / 3.0, std::numeric_limits<double>::denorm_min()};
    burr.radius = 3.0000000000000004;
    burr.material = 1;
    burr.on = 1;
    burr.force = {std::numeric_limits<double>::min(), -1e300, 0.1};
    burr.penetration = std::nextafter(1.0, 2.0);
    burr.removed = std::int64_t(exact);
  }
  return record;
}

void test_round_trips() {
  for (const int version : {1, 2}) {
    const Word word = back(Word{Holds::suspect, 1u << 31, exact, digest}, version, Kind::word);
    CHECK(word.holds == Holds::suspect && word.session == 1u << 31 && word.tick == exact);
    CHECK(word.digest == digest);
    const Hello hello =
        back(Hello{1, ~std::uint64_t(0), 7, digest, "{\"\xC3\xBC\": 1}"}, version, Kind::hello);
    CHECK(hello.session == ~std::uint64_t(0) && hello.first_tick == 7 && hello.text == "{\"\xC3\xBC\": 1}");
    const replica_protocol::Digest at = back(replica_protocol::Digest{9, digest}, version, Kind::digest);
    CHECK(at.tick == 9 && at.digest == digest);
    CHECK(back(Idle{11}, version, Kind::idle).tick == 11);
    const End end = back(End{12, digest, 1, "a reason"}, version, Kind::end);
    CHECK(end.tick == 12 && end.failed == 1 && end.reason == "a reason");

    const TickRecord record = extreme_record();
    const TickMessage tick = back(TickMessage{record, exact - 1}, version, Kind::tick);
    CHECK(std::memcmp(&tick.record, &record, sizeof record) == 0);  // to the bit
    CHECK(tick.digest_tick == exact - 1);

    const Bytes content(2 * brick_bytes, 5);
    Bytes bytes;
    encode(bytes, version, Bricks{3, digest, 9, 7, {content.data(), content.size()}});
    Bricks bricks;
    CHECK(decode(message_of(bytes), bricks));
    CHECK(bricks.tick == 3 && bricks.total == 9 && bricks.first == 7 && bricks.digest == digest);
    CHECK(std::equal(content.begin(), content.end(), bricks.bricks.data));
  }
}

template <class Change>
bool accepted(Change&& change) {
  TickMessage tick{extreme_record(), 0};
  change(tick.record);
  Bytes bytes;
  encode(bytes, 1, tick);
  return decode(message_of(bytes), tick);
}

void test_ticks_that_cannot_be() {
  CHECK(accepted([](TickRecord&) {}));
  CHECK(!accepted([](TickRecord& record) { record.k = 0; }));
  CHECK(!accepted([](TickRecord& record) { record.k = 9; }));
  CHECK(!accepted([](TickRecord& record) { record.burrs = 0; }));
  CHECK(!accepted([](TickRecord& record) { record.index = 2 * exact; }));
  CHECK(!accepted([](TickRecord& record) { record.burr[1].center[2] = NAN; }));
  CHECK(!accepted([](TickRecord& record) { record.burr[0].on = 2; }));
  CHECK(!accepted([](TickRecord& record) { record.burr[0].removed = -1; }));
}

void test_bricks_that_cannot_be() {
  const Bytes content(2 * brick_bytes, 5);
  const auto accepted = [&](std::uint32_t total, std::uint32_t first, std::size_t size) {
    Bytes bytes;
    encode(bytes, 1, Bricks{3, digest, total, first, {content.data(), size}});
    Bricks bricks;
    return decode(message_of(bytes), bricks);
  };
  CHECK(accepted(2, 0, content.size()) && accepted(0, 0, 0));
  CHECK(!accepted(1, 0, content.size()));
  CHECK(!accepted(9, 8, content.size()));
  CHECK(!accepted(0xFFFFFFFFu, 0xFFFFFFFFu, content.size()));
  CHECK(!accepted(2, 3, 0));
  CHECK(!accepted(2, 0, 0));
  CHECK(!accepted(2, 0, content.size() - 1));
}

/// A decoder refuses or accepts any bytes; sanitizers watch.
void test_random_bytes() {
  std::mt19937 random(1);
  std::vector<Bytes> seeds(7);
  const Bytes content(2 * brick_bytes, 5);
  encode(seeds[0], 1, Word{Holds::ticks, 1, 2, digest});
  encode(seeds[1], 1, Hello{1, 2, 3, digest, "{}"});
  encode(seeds[2], 1, TickMessage{extreme_record(), 4});
  encode(seeds[3], 1, replica_protocol::Digest{5, digest});
  encode(seeds[4], 1, Bricks{3, digest, 9, 7, {content.data(), content.size()}});
  encode(seeds[5], 1, Idle{6});
  encode(seeds[6], 1, End{7, digest, 0, "done"});
  int good = 0;
  for (int i = 0; i < 200000; ++i) {
    Bytes body(seeds[i % 7].begin() + openigtlink::header_size, seeds[i % 7].end());
    for (int change = int(random() % 4); change > 0; --change)
      body[random() % body.size()] = std::uint8_t(random());
    if (random() % 3 == 0) body.resize(random() % (body.size() + 1));
    openigtlink::Header header;
    Bytes head = seeds[i % 7];
    CHECK(decode_header({head.data(), head.size()}, header) == Drop::none);
    header.body_size = body.size();
    Message message;
    if (decode_body(header, {body.data(), body.size()}, message) != Drop::none) continue;
    Word word;
    Hello hello;
    TickMessage tick;
    replica_protocol::Digest at;
    Bricks bricks;
    Idle idle;
    End end;
    good += decode(message, word) + decode(message, hello) + decode(message, tick) + decode(message, at) +
            decode(message, bricks) + decode(message, idle) + decode(message, end);
  }
  CHECK(good > 1000);
}

void test_log() {
  TickLog log(1000, 8, 5);
  std::uint64_t place = 0, other = 0;
  CHECK(log.next() == 5 && log.place_of(5, place) && place == 0 && !log.place_of(6, place) &&
        !log.place_of(4, place));
  Bytes message(30);
  for (std::uint8_t tick = 5; tick < 200; ++tick) {
    std::fill(message.begin(), message.end(), tick);
    log.append_tick({message.data(), message.size()});
    if (tick % 10 == 0) log.append({message.data(), 7});
    CHECK(log.next() == tick + 1u);
    const std::uint64_t oldest = std::uint64_t(std::max(5, tick - 7));
    CHECK(log.place_of(oldest, place) && log.place_of(log.next(), other));
    CHECK(oldest == 5 || !log.place_of(oldest - 1, place));
    CHECK(log.place_of(oldest, place));
    Bytes held;
    CHECK(log.copy(place, 10000, held) == log.end() - place && held.size() == log.end() - place);
    CHECK(held.front() == std::uint8_t(oldest) ||
          held.front() == std::uint8_t(oldest - 1));  // the 7 bytes between
    CHECK(held.back() == tick);
  }
  log.restart(1000);
  CHECK(log.begin() == log.end() && log.next() == 1000 && !log.place_of(199, place) &&
        log.place_of(1000, place));
  Bytes none;
  CHECK(log.copy(place - 1, 10, none) == 0 && log.copy(place, 10, none) == 0 && none.empty());

  TickLog small(100, 8, 0);  // bytes run out before ticks
  for (int tick = 0; tick < 8; ++tick) small.append_tick({message.data(), message.size()});
  CHECK(small.place_of(5, place) && !small.place_of(4, place));
  CHECK_THROWS(small.append({Bytes(101).data(), 101}), "length of a message in a log must be");
  CHECK_THROWS(TickLog(0, 1, 0), "bytes of a log must be at least 1");
  CHECK_THROWS(TickLog(1, 0, 0), "ticks of a log must be at least 1");
}

/// A session on a virtual clock: thousands of ticks in a moment, through a socket.
void test_replica_follows(const Material& material, std::uint32_t version) {
  const auto executor =
      std::make_shared<TickExecutor>(scenes::block(), scenes::executor(scenes::block(), material).setup());
  LoopSettings settings;
  settings.wall_clock = false;
  settings.ticks = 3000;
  const auto loop = std::make_shared<HapticLoop>(
      executor, std::vector<std::shared_ptr<Device>>{std::make_shared<HandDevice>(HandSettings{})}, settings);
  Follower follower(loop, {100, 50.0, 1.0});
  const auto publisher = std::make_shared<Publisher>(follower, PublisherSettings{});
  follower.add(publisher);
  Replica replica("127.0.0.1", publisher->port());
  CHECK(replica.fetch_hello(5.0));
  CHECK(replica.hello().version == version);
  CHECK_THROWS(replica.start(nullptr, executor->setup()), "bone must be a VoxelBone, got None");
  replica.start(scenes::block(), executor->setup());
  loop->start();
  follower.start();
  for (int look = 0; !loop->wait(0.002); ++look) {  // others look on meanwhile
    if (look == 20)
      replica.visit([](FollowedBone& bone) {
        const std::uint8_t level = 0;
        bone.bone().write({0, 0, 0}, {1, 1, 1}, &level);
      });
    replica.take_changed();
    CHECK(publisher->status().tick <= 3000 && replica.status().tick <= 3000);
  }
  follower.stop();
  publisher->finish(loop->reason(), loop->failed(), 30.0);
  CHECK(replica.wait(30.0));
  const ReplicaStatus status = replica.status();
  CHECK(status.tick == 3000 && status.reason == "all ticks were executed" && !status.failed);
  CHECK(status.differing_ticks == 0);
  for (const Divergence& divergence : status.divergences)
    CHECK(divergence.exact && divergence.bricks == std::vector<std::uint32_t>{0});
  CHECK(replica.digest() == executor->bone()->digest());
  CHECK(executor->bone()->removed() > 0.0);
}

}  // namespace

int main() {
  test_round_trips();
  test_ticks_that_cannot_be();
  test_bricks_that_cannot_be();
  test_random_bytes();
  test_log();
  test_replica_follows(scenes::bone_material, 2);
  for (const double q : {1.5, 2.0})  // with m, with q
    test_replica_follows(Material("bone", 2.145, 0.087, Shape::parabolic(), "", q, 2.0 - q), 3);
  return check::report();
}
