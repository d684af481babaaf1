// The network device: a standard peer's TRANSFORM stream drives the burr.
#pragma once

#include "burrlab/network/transform_reader.hpp"
#include "burrlab/session/mailbox_device.hpp"

namespace burrlab {

/// A mailbox that a `TransformReader` fills. The burr is on unless the sender's device name ends in "_off".
///
/// TRANSFORM carries no velocity: it is the difference of two positions over the difference of their senders'
/// time stamps, or of their arrivals where the sender gives none; our choice, for analysis and coupling only.
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
