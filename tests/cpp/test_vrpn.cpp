// VRPN: the bytes of the real library in tests/golden/vrpn.
#include "network/vrpn.hpp"

#include <algorithm>
#include <fstream>
#include <iterator>
#include <map>
#include <string>

#include "check.hpp"
#include "network/vrpn_log.hpp"

using namespace burrlab::vrpn;

namespace {

Bytes golden(const std::string& name) {
  std::ifstream file(GOLDEN_VRPN "/" + name, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

struct Heard {
  std::vector<Kind> kinds;
  std::vector<std::string> texts;
  std::map<Kind, Message> first;  // of each kind
  Reader::Receive receive = [this](const Message& message) {
    kinds.push_back(message.kind);
    if (!message.text.empty()) texts.emplace_back(message.text);
    first.emplace(message.kind, message);
  };
};

void test_server() {
  const Bytes stream = golden("server_tcp.bin"), packet = golden("server_udp.bin");
  Reader reader({"Tracker0"});
  Heard heard;
  for (std::size_t at = 0; at < stream.size(); at += 61) {
    const std::size_t size = std::min<std::size_t>(61, stream.size() - at);
    const Bytes piece(stream.begin() + std::ptrdiff_t(at), stream.begin() + std::ptrdiff_t(at + size));
    CHECK(reader.feed({piece.data(), piece.size()}, heard.receive));
  }
  std::vector<Kind> kinds{Kind::cookie, Kind::sender, Kind::sender, Kind::buttons};
  for (int i = 0; i < 3; ++i) kinds.insert(kinds.end(), {Kind::pose, Kind::velocity});
  kinds.insert(kinds.end(), {Kind::button, Kind::pose, Kind::velocity});
  CHECK(heard.kinds.size() >= 10 && heard.kinds.size() <= kinds.size());
  CHECK(std::equal(heard.kinds.begin(), heard.kinds.end(), kinds.begin()));
  CHECK(heard.texts == std::vector<std::string>({"vrpn: ver. 07.38  0", "VRPN Control", "Tracker0"}));
  const std::array<double, 8> pose{0.001, -0.0025, 0.003, 0.5, -0.5, 0.5, 0.5, 0.0};
  CHECK(heard.first[Kind::pose].values == pose);
  CHECK((heard.first[Kind::velocity].values == std::array<double, 8>{0.01, 0.02, -0.03, 0, 0, 0, 1, 0.001}));
  CHECK(heard.first[Kind::button].number == 1 && heard.first[Kind::button].pressed);
  CHECK(heard.first[Kind::buttons].number == 2 && heard.first[Kind::buttons].states.size == 8);
  Heard over_udp;
  reader.feed_datagram({packet.data(), packet.size()}, over_udp.receive);
  CHECK(over_udp.kinds == std::vector<Kind>({Kind::pose, Kind::velocity}));
  CHECK(over_udp.first[Kind::pose].values == pose);
  CHECK(reader.counters().all_dropped() == 0 && !reader.broken());
}

void test_client() {
  const Bytes stream = golden("client_tcp.bin"), request = golden("client_request.bin");
  Reader reader({"burrlab_burr_0"}, 4096);
  Heard heard;
  CHECK(reader.feed({stream.data(), stream.size()}, heard.receive));
  const std::vector<Kind> kinds{Kind::cookie, Kind::udp, Kind::sender, Kind::sender, Kind::ping};
  CHECK(heard.kinds.size() > 5 && std::equal(kinds.begin(), kinds.end(), heard.kinds.begin()));
  CHECK(heard.first[Kind::udp].number > 1024 && heard.first[Kind::udp].number < 65536);
  CHECK(std::string(request.begin(), request.begin() + 10) == "127.0.0.1 ");
}

/// A States message that holds more buttons than one has, or a part of one, is no message.
void test_buttons() {
  const std::uint8_t payload[] = {0, 0, 0, 2, 0, 0, 0, 0, 0, 0, 1, 0};
  Message message;
  CHECK(decode_payload(Kind::buttons, {payload, 12}, message) == Drop::none);
  CHECK(!is_pressed(message.states, 0) && is_pressed(message.states, 1) && !is_pressed(message.states, 2));
  CHECK(decode_payload(Kind::buttons, {payload, 11}, message) == Drop::bad_length);
  CHECK(decode_payload(Kind::buttons, {payload, 8}, message) == Drop::bad_length);
  CHECK(decode_payload(Kind::button, {payload, 12}, message) == Drop::bad_length);
}

void test_log() {
  const Bytes file = golden("client_in.vrpn");
  const Log log = read_log({file.data(), file.size()});
  CHECK(log.messages.size() == 4 && log.others.size() == 2);
  CHECK_THROWS(read_log({file.data(), file.size() - 1}), "stands no whole message");
  CHECK(read_log({file.data(), header_size}).messages.empty());
}

}  // namespace

int main() {
  test_server();
  test_client();
  test_buttons();
  test_log();
  return check::report();
}
