// Reads a TRANSFORM stream from an OpenIGTLink server, in its own thread.
#pragma once

#include <mutex>
#include <thread>

#include "burrlab/copy_under.hpp"
#include "burrlab/network/message_framer.hpp"
#include "burrlab/network/tcp_client.hpp"
#include "burrlab/network/transform_reader.hpp"
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
  openigtlink::Counters messages;  ///< TRANSFORMs accepted, and drops by reason
  std::uint64_t other_type = 0;    ///< intact SENSOR and NDARRAY messages
  std::uint64_t other_device = 0;  ///< intact TRANSFORMs with another device name
  std::uint64_t connections = 0;   ///< made
  std::uint64_t broken = 0;        ///< connections closed because the framing was lost
};

/// Connects to a server and reads. If the connection ends or its framing is lost, connects again after 0.1 s;
/// the pause doubles up to 1 s until messages come again.
///
/// The burr is on unless the device name ends in "_off" (our choice: OpenIGTLink has no switch). If a device
/// name is given, only that name, with or without "_off", is read.
class TransformReader {
 public:
  /// Called in the reader's thread with every pose; must not throw.
  using Receive = std::function<void(const NetworkPose&)>;

  /// Throws std::invalid_argument if `host` has no address, `port` is not 1 to 65535 or the name is longer
  /// than 20 bytes.
  TransformReader(const std::string& host, int port, std::string device_name = "", Receive receive = {});
  ~TransformReader() { stop(); }
  TransformReader(const TransformReader&) = delete;
  TransformReader& operator=(const TransformReader&) = delete;

  /// False if none came yet. Neither the caller nor the reader's thread waits.
  bool newest(NetworkPose& pose) const { return newest_.get(pose) && pose.count > 0; }
  bool connected() const { return connected_.load(std::memory_order_relaxed); }
  ReaderCounters counters() const { return copy_under(counters_mutex_, counters_); }
  /// Ends the thread at once. Not to be called from `receive`.
  void stop();
  bool stopped() const { return client_.stopped(); }

 private:
  void run();
  void read_connection();
  void take(const openigtlink::Message& message);
  void publish_counters();

  TcpClient client_;
  std::string device_name_;
  Receive receive_;
  openigtlink::MessageFramer framer_{65536};
  Latest<NetworkPose> newest_;
  std::uint64_t accepted_ = 0, other_type_ = 0, other_device_ = 0, connections_ = 0, broken_ = 0;
  std::array<std::uint64_t, openigtlink::drop_reasons> refused_{};  // by the decoder
  mutable std::mutex counters_mutex_;                               // the haptic loop never takes it
  ReaderCounters counters_;
  std::atomic<bool> connected_{false};
  std::mutex stop_mutex_;
  std::thread thread_;
};

/// A mailbox filled by a `TransformReader`. The burr is on unless the sender's device name ends in "_off".
///
/// TRANSFORM carries no velocity. Ours is the difference of two positions over that of their time stamps, or
/// of their arrivals if there are none; for analysis and coupling only.
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

  NetworkPose last_{};
  Vec3 velocity_ = Vec3::Zero();
  TransformReader reader_;  // the last member: its thread uses the others
};

}  // namespace burrlab
