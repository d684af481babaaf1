// The device of a TRANSFORM stream, with a server in this process.
#include "network/network_device.hpp"

#include "check.hpp"
#include "network/bone_frame.hpp"
#include "network/tcp_server.hpp"

#include <chrono>
#include <thread>

using namespace burrlab;
using openigtlink::Bytes;
using openigtlink::Drop;

namespace {

class Server {
 public:
  ~Server() { hang_up(); }
  int port() const { return listener_.port(); }
  void accept() {
    while (listener_.accept(peer_) != TcpServer::Accepted::connection) {
      std::vector<TcpServer::Interest> none;
      listener_.wait(none, true, 1000);
    }
  }
  void send(const Bytes& bytes) {
    CHECK(TcpServer::send(peer_, bytes.data(), bytes.size()) == long(bytes.size()));
  }
  void hang_up() {
    TcpServer::close(peer_);
    peer_ = -1;
  }

 private:
  TcpServer listener_{"127.0.0.1", 0, 1 << 16};
  int peer_ = -1;
};

Bytes transform(float x, float y, float z, const char* name = "burr", std::uint64_t time = 0) {
  Bytes bytes;
  openigtlink::Transform pose;
  pose.position = {x, y, z};
  pose.rotation = {1, 2, 3, 4, 5, 6, 7, 8, 9};
  encode_transform(bytes, {name, time}, pose);
  return bytes;
}

/// Waits at most 10 s for `condition`.
template <class Condition>
bool soon(Condition&& condition) {
  for (int i = 0; i < 10000 && !condition(); ++i) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  return condition();
}

void test_drops_and_reconnects() {
  Server server;
  IgtlDevice reader("localhost", server.port(), "burr");
  const auto x = [&] { return reader.read(0, 1).position[0]; };
  server.accept();
  server.send(transform(2e6f, 0, 0));
  server.send(transform(7, 0, 0, "drill"));
  Bytes force;
  const double value = 1.0;
  openigtlink::encode_sensor(force, {"force"}, &value, 1);
  server.send(force);
  Bytes wrong = transform(7, 0, 0);
  wrong[80] ^= 1;
  server.send(wrong);
  server.send(transform(1, 0, 0));
  CHECK(soon([&] { return reader.counters().messages.messages == 1; }));
  ReaderCounters counters = reader.counters();
  CHECK(counters.messages[Drop::out_of_range] == 1 && counters.messages[Drop::bad_crc] == 1);
  CHECK(counters.other_device == 1 && counters.other_type == 1 && counters.connections == 1);
  CHECK(x() == -1.0);

  server.send(Bytes(58, 0xFF));  // no header
  server.accept();
  server.send(transform(2, 0, 0));
  CHECK(soon([&] { return x() == -2.0; }));
  counters = reader.counters();
  CHECK(counters.broken == 1 && counters.connections == 2 && counters.messages[Drop::bad_version] == 1);

  Bytes half = transform(3, 0, 0);
  half.resize(70);
  server.send(half);
  server.hang_up();
  server.accept();
  server.send(transform(4, 0, 0));
  CHECK(soon([&] { return x() == -4.0; }));
  counters = reader.counters();
  CHECK(counters.messages[Drop::truncated] == 1 && counters.connections == 3);
  CHECK(reader.connected());
}

void test_stop() {
  Server server;
  for (const bool connected : {false, true}) {  // during its pause, and while it waits for bytes
    IgtlDevice reader("127.0.0.1", connected ? server.port() : 1);
    if (connected) server.accept();
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    reader.stop();
    CHECK(!reader.connected());
    reader.stop();
  }
}

/// The last position of an earlier session does not end the next one.
void test_reuse() {
  MailboxDevice device(30.0);
  device.put(Vec3(0.0, 0.0, 1.0), Vec3::Zero(), true);
  std::this_thread::sleep_for(std::chrono::milliseconds(40));
  CHECK(device.read(0, 1).status == DeviceReading::Status::lost);
  device.start(1e-3);
  CHECK(device.read(0, 1).status == DeviceReading::Status::waiting);
  device.put(Vec3(0.0, 0.0, 2.0), Vec3::Zero(), true);
  CHECK(device.read(0, 1).position[2] == 2.0);
}

void test_device() {
  Server server;
  IgtlDevice device("127.0.0.1", server.port());
  CHECK(device.name() == "igtl:127.0.0.1:" + std::to_string(server.port()));
  CHECK(device.read(0, 1).status == DeviceReading::Status::waiting);
  server.accept();
  using openigtlink::timestamp_of;
  server.send(transform(1, 2, 3, "burr", timestamp_of(10, 0)));
  server.send(transform(1, 2, 3.5f, "burr", timestamp_of(10, 250000000)));
  CHECK(soon([&] { return device.read(0, 1).position[2] == 3.5; }));
  DeviceReading reading = device.read(0, 1);
  CHECK(reading.position == Vec3(-1, -2, 3.5) && reading.on);
  CHECK_NEAR(reading.velocity[2], 2.0, 1e-9);
  server.send(transform(1, 2, 3, "burr_off", timestamp_of(10, 500000000)));
  CHECK(soon([&] { return !device.read(0, 1).on; }));
  CHECK(soon([&] { return device.read(0, 1).status == DeviceReading::Status::lost; }));
  device.stop();
}

}  // namespace

int main() {
  CHECK(std::isfinite(openigtlink::to_ras({1e300, -1e300, 0}).position[1]));  // a force beyond float32
  test_drops_and_reconnects();
  test_stop();
  test_device();
  test_reuse();
  return check::report();
}
