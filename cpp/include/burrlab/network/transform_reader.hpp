// Devices of the network: a TRANSFORM stream of an OpenIGTLink server, or a VRPN server's Tracker and Button.
#pragma once

#include <array>
#include <mutex>
#include <thread>

#include "burrlab/copy_under.hpp"
#include "burrlab/network/message_framer.hpp"
#include "burrlab/network/tcp_client.hpp"
#include "burrlab/network/vrpn.hpp"
#include "burrlab/session/latest.hpp"
#include "burrlab/session/mailbox_device.hpp"
#include "burrlab/types.hpp"

namespace burrlab {

/// A TRANSFORM in the bone frame.
struct NetworkPose {
  std::array<double, 3> position;  ///< bone frame, LPS [mm]: exactly the float32 numbers sent
  std::array<double, 9> rotation;  ///< row by row, both frames LPS
  std::uint64_t timestamp;         ///< the sender's, 32.32 fixed point [s]; 0 is none
  std::uint64_t arrival;           ///< steady clock [ns]
  std::uint64_t count;             ///< 1 for the first; 0: none yet
  std::uint64_t on;                ///< the burr is on: see `TransformReader`
};

struct ReaderCounters {
  openigtlink::Counters messages;  ///< poses accepted, and drops by reason
  std::uint64_t other_type = 0;    ///< intact messages of other types
  std::uint64_t other_device = 0;  ///< intact messages of other devices
  std::uint64_t connections = 0;   ///< made
  std::uint64_t broken = 0;        ///< connections closed because the framing was lost
  std::uint64_t datagrams = 0;     ///< UDP packets
  std::uint64_t lost = 0;          ///< messages over UDP that did not come, or came too late
};

/// Reads from a server, in its own thread. If the connection ends or its framing is lost, connects again
/// after 0.1 s; the pause doubles up to 1 s until messages come again.
class StreamReader {
 public:
  virtual ~StreamReader() = default;
  bool connected() const { return connected_.load(std::memory_order_relaxed); }
  ReaderCounters counters() const { return copy_under(counters_mutex_, published_); }
  /// Ends the thread at once. Not to be called from it.
  void stop();
  bool stopped() const { return client_.stopped(); }

 protected:
  StreamReader(const std::string& host, int port) : client_(host, port) {}
  void begin();  // the last line of a constructor; the destructor must call `stop`

  virtual bool open() { return client_.connect(); }
  virtual bool feed(openigtlink::ByteView bytes, bool datagram) = 0;  // false: the framing is lost
  virtual void restart() = 0;                                         // the connection has ended
  virtual void count(ReaderCounters&) const {}                        // what only the derived class knows

  TcpClient client_;
  ReaderCounters counters_;  // of the reader's thread; counters_.messages.messages are poses accepted

 private:
  void run();
  void read_connection();
  void publish_counters();

  mutable std::mutex counters_mutex_;  // the haptic loop never takes it
  ReaderCounters published_;
  std::atomic<bool> connected_{false};
  std::mutex stop_mutex_;
  std::thread thread_;
};

/// The velocity of positions that come without one: the difference of two over that of their time stamps, or
/// of their arrivals if there are none; for analysis and coupling only.
class VelocityEstimate {
 public:
  /// Velocity [mm/s] at the next position [mm]; `timestamp` in 32.32 fixed point [s], 0 is none; `arrival`
  /// [ns].
  const Vec3& next(const Vec3& position, std::uint64_t timestamp, std::uint64_t arrival);

 private:
  Vec3 position_ = Vec3::Zero(), velocity_ = Vec3::Zero();
  std::uint64_t timestamp_ = 0, arrival_ = 0;
};

/// The burr is on unless the device name ends in "_off" (our choice: OpenIGTLink has no switch). If a device
/// name is given, only that name, with or without "_off", is read.
class TransformReader : public StreamReader {
 public:
  /// Called in the reader's thread with every pose; must not throw.
  using Receive = std::function<void(const NetworkPose&)>;

  /// Throws std::invalid_argument if `host` has no address, `port` is not 1 to 65535 or the name is longer
  /// than 20 bytes.
  TransformReader(const std::string& host, int port, std::string device_name = "", Receive receive = {});
  ~TransformReader() override { stop(); }
  TransformReader(const TransformReader&) = delete;
  TransformReader& operator=(const TransformReader&) = delete;

  /// False if none came yet. Neither the caller nor the reader's thread waits.
  bool newest(NetworkPose& pose) const { return newest_.get(pose) && pose.count > 0; }

 private:
  bool feed(openigtlink::ByteView bytes, bool) override { return framer_.feed(bytes, on_message_); }
  void restart() override { framer_.restart(); }
  void count(ReaderCounters& counters) const override;
  void take(const openigtlink::Message& message);

  std::string device_name_;
  Receive receive_;
  openigtlink::MessageFramer framer_{65536};
  Latest<NetworkPose> newest_;
  openigtlink::MessageFramer::Receive on_message_ = [this](const openigtlink::Message& m) { take(m); };
};

/// A mailbox filled by a `TransformReader`. The burr is on unless the sender's device name ends in "_off".
/// TRANSFORM carries no velocity: it is a `VelocityEstimate`.
class IgtlDevice : public MailboxDevice {
 public:
  /// lost_after [ms]. Throws as `TransformReader` does.
  IgtlDevice(const std::string& host, int port, const std::string& device_name = "",
             double lost_after = 100.0);

  void start(double period) override;  ///< throws after `stop`
  void stop() noexcept override { reader_.stop(); }
  ReaderCounters counters() const { return reader_.counters(); }
  bool connected() const { return reader_.connected(); }

 private:
  void take(const NetworkPose& pose);

  VelocityEstimate velocity_;
  TransformReader reader_;  // the last member: its thread uses the others
};

struct VrpnSettings {
  int port = vrpn::default_port;
  bool tcp = false;           ///< connect directly, and do without UDP; else ask to be called back
  int on_button = -1;         ///< 0 to 7; the burr turns while it is pressed; -1: always
  double lost_after = 100.0;  ///< [ms]
};

/// A mailbox filled by sensor 0 of a Tracker, and the Buttons of the same name, of a VRPN server. VRPN is in
/// metres and states no axes: they are the bone's. Without Velocity messages it is a `VelocityEstimate`.
class VrpnDevice : public MailboxDevice, public StreamReader {
 public:
  /// Throws if the name is empty or longer than 99 bytes, or as a `TransformReader` does.
  VrpnDevice(const std::string& name, const std::string& host, const VrpnSettings& settings = {});
  ~VrpnDevice() override { StreamReader::stop(); }

  void start(double period) override;  ///< throws after `stop`
  void stop() noexcept override { StreamReader::stop(); }
  std::string fault() const override;  ///< why there is no position, empty without a fault
  std::string note() const;            ///< that the server's minor version is another, else empty

 private:
  bool open() override;
  bool feed(openigtlink::ByteView bytes, bool datagram) override;
  void restart() override;
  void count(ReaderCounters& counters) const override;
  void take(const vrpn::Message& message);
  void take_pose(const vrpn::Message& message);
  void send();
  void say(const std::string& fault);

  VrpnSettings settings_;
  std::string tracker_, server_;
  vrpn::Reader reader_;
  VelocityEstimate estimate_;
  Vec3 position_ = Vec3::Zero(), velocity_ = Vec3::Zero();  // [mm], [mm/s]
  Quaternion orientation_{1.0, 0.0, 0.0, 0.0};
  std::uint32_t buttons_ = 0;
  std::uint64_t newest_ = 0, arrival_ = 0;  // time stamp of the newest pose, and when it came [ns]
  bool has_pose_ = false, has_velocity_ = false;
  mutable std::mutex fault_mutex_;  // the haptic loop takes it only when the device is lost
  std::string fault_, heard_;       // and the senders that the server has
  std::string note_;
  bool found_ = false;
};

}  // namespace burrlab
