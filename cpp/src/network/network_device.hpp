// Devices of the network: a TRANSFORM stream of an OpenIGTLink server, or a VRPN server's Tracker and Button.
#pragma once

#include <mutex>
#include <thread>

#include "burrlab/types.hpp"
#include "copy_under.hpp"
#include "network/message_framer.hpp"
#include "network/tcp_client.hpp"
#include "network/vrpn.hpp"
#include "session/mailbox_device.hpp"

namespace burrlab {

struct ReaderCounters {
  openigtlink::Counters messages;  ///< poses accepted, and drops by reason
  std::uint64_t other_type = 0;    ///< intact messages of other types
  std::uint64_t other_device = 0;  ///< intact messages of other devices
  std::uint64_t connections = 0;   ///< made
  std::uint64_t broken = 0;        ///< connections closed because the framing was lost
  std::uint64_t datagrams = 0;     ///< UDP packets
  std::uint64_t lost = 0;          ///< messages over UDP that did not come, or came too late
};

/// A mailbox that a thread of its own fills from a server. If the connection ends or its framing is lost, it
/// connects again after 0.1 s; the pause doubles up to 1 s until poses come again.
class NetworkDevice : public MailboxDevice {
 public:
  void start(double period) override;  ///< throws after `stop`
  void stop() noexcept override;       ///< ends the thread at once
  bool connected() const { return connected_.load(std::memory_order_relaxed); }
  ReaderCounters counters() const { return copy_under(counters_mutex_, published_); }
  std::string fault() const override;  ///< why there is no position, empty without a fault

 protected:
  /// `on_button`: 0 to 7, the burr turns while it is pressed; -1: as the sender says.
  NetworkDevice(const std::string& name, const std::string& host, int port, double lost_after, int on_button);
  /// The last line of a constructor; the destructor must call `stop`.
  void start_thread() {
    thread_ = std::thread([this] { run(); });
  }

  virtual bool open() { return client_.connect(); }
  virtual bool feed(openigtlink::ByteView bytes, bool datagram) = 0;  // false: the framing is lost
  virtual void before_close() {}                                      // before the connection is closed
  virtual void after_close() = 0;                                     // it is closed
  virtual void count(ReaderCounters&) const {}                        // what only the derived class knows
  virtual const openigtlink::StreamCutter& cutter() const = 0;

  /// A position [mm], with the sender's time in 32.32 fixed point [s], 0 is none. It is counted; dropped, as
  /// a velocity is, if no tick can use it. Without velocities the velocity is the difference of two over that
  /// of their time stamps, or of their arrivals: for analysis and coupling only.
  void put_pose(const Vec3& position, const Quaternion& orientation, std::uint64_t timestamp, bool on);
  void put_velocity(const Vec3& velocity);  // [mm/s]
  void put_buttons(std::uint32_t buttons);
  std::uint32_t buttons() const { return buttons_; }

  TcpClient client_;
  std::string server_;
  ReaderCounters counters_;  // of the device's thread; counters_.messages.messages are poses accepted

 private:
  void run();
  void read_connection();
  void publish_counters();
  bool is_usable(const Vec3& vector);
  void estimate_velocity(const Vec3& position, std::uint64_t timestamp, std::uint64_t arrival);
  void put_all();

  Vec3 position_ = Vec3::Zero(), velocity_ = Vec3::Zero();  // [mm], [mm/s]
  Quaternion orientation_{1.0, 0.0, 0.0, 0.0};
  std::uint64_t timestamp_ = 0, arrival_ = 0;  // of the pose; 0: none on this connection [ns]
  int on_button_;
  std::uint32_t buttons_ = 0;
  bool on_ = true, has_velocity_ = false;

  mutable std::mutex counters_mutex_;  // the haptic loop takes it only when the device is lost
  ReaderCounters published_;
  std::atomic<bool> connected_{false};
  std::mutex stop_mutex_;
  std::thread thread_;
};

/// The burr is on unless the sender's device name ends in "_off" (our choice: OpenIGTLink has no switch). If
/// a device name is given, only that name, with or without "_off", is read.
///
/// A haptic device behind PLUS sends the tools Stylus, StylusVelocity (translation part, mm/s) and Buttons
/// (first column), alone or as in "StylusToTracker"; once a Stylus has come, no other tool is the burr. Each
/// Stylus is answered with the tool Force, whose translation part is the newest force on the hand [N]; it is
/// zero before the connection is closed.
class IgtlDevice : public NetworkDevice {
 public:
  /// lost_after [ms]. Throws InvalidArgument if `host` has no address, `port` is not 1 to 65535 or the
  /// name is longer than 20 bytes.
  IgtlDevice(const std::string& host, int port, const std::string& device_name = "",
             double lost_after = 100.0, int on_button = -1);
  ~IgtlDevice() override { stop(); }

 private:
  bool feed(openigtlink::ByteView bytes, bool) override { return framer_.feed(bytes, on_message_); }
  void before_close() override;
  void after_close() override { framer_.restart(); }
  const openigtlink::StreamCutter& cutter() const override { return framer_; }
  void take(const openigtlink::Message& message);
  void encode_force(const Vec3& force);

  std::string device_name_;
  openigtlink::MessageFramer framer_{65536};
  openigtlink::MessageFramer::Receive on_message_ = [this](const openigtlink::Message& m) { take(m); };
  std::string stylus_;  // as it is named on this connection, which then reads no other; empty: none yet
  int force_version_ = 1;
  openigtlink::Bytes unsent_;  // at most one answer
};

struct VrpnSettings {
  int port = vrpn::default_port;
  bool tcp = false;           ///< connect directly, and do without UDP; else ask to be called back
  int on_button = -1;         ///< 0 to 7; the burr turns while it is pressed; -1: always
  double lost_after = 100.0;  ///< [ms]
};

/// Sensor 0 of a Tracker, and the Buttons of the same name, of a VRPN server. VRPN is in metres and states no
/// axes: they are the bone's.
class VrpnDevice : public NetworkDevice {
 public:
  /// Throws if the name is empty or longer than 99 bytes, or as an `IgtlDevice` does.
  VrpnDevice(const std::string& name, const std::string& host, const VrpnSettings& settings = {});
  ~VrpnDevice() override { stop(); }

  std::string fault() const override;
  /// That the server's minor version is another, else empty.
  std::string note() const { return copy_under(fault_mutex_, note_); }

 private:
  bool open() override;
  bool feed(openigtlink::ByteView bytes, bool datagram) override;
  void after_close() override;
  void count(ReaderCounters& counters) const override;
  const openigtlink::StreamCutter& cutter() const override { return reader_; }
  void take(const vrpn::Message& message);
  void take_pose(const vrpn::Message& message);
  void set_fault(const std::string& fault);

  VrpnSettings settings_;
  std::string tracker_;
  vrpn::Reader reader_;
  std::uint64_t newest_ = 0;        // time stamp of the newest pose
  mutable std::mutex fault_mutex_;  // the haptic loop takes it only when the device is lost
  std::string fault_, senders_;     // and the senders that the server has
  std::string note_;
  bool has_tracker_ = false;
};

}  // namespace burrlab
