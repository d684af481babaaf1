#include "burrlab/network/igtl_device.hpp"

namespace burrlab {
namespace {

constexpr double shortest_step = 1e-4,
                 longest_step = 1.0;  // between two poses [s]; beyond, no velocity is known

/// Time from one pose to the next [s]; 0 where it cannot be told.
double step_between(const NetworkPose& last, const NetworkPose& next) {
  const bool stamped = last.timestamp && next.timestamp > last.timestamp;
  const double step = stamped ? double(next.timestamp - last.timestamp) / 4294967296.0
                              : 1e-9 * double(next.arrival - last.arrival);
  return step >= shortest_step && step <= longest_step ? step : 0.0;
}

}  // namespace

IgtlDevice::IgtlDevice(const std::string& host, int port, const std::string& device_name, double lost_after)
    : MailboxDevice(lost_after, "igtl:" + host + ":" + std::to_string(port)),
      reader_(host, port, device_name, [this](const NetworkPose& pose) { take(pose); }) {}

void IgtlDevice::start(double period) {
  if (reader_.stopped())
    throw std::invalid_argument("IgtlDevice must be new: its connection was closed after a session");
  MailboxDevice::start(period);
}

void IgtlDevice::take(const NetworkPose& pose) {
  const Vec3 position(pose.position[0], pose.position[1], pose.position[2]);
  const double step = last_.count ? step_between(last_, pose) : 0.0;
  if (step > 0.0)
    velocity_ = (position - Vec3(last_.position[0], last_.position[1], last_.position[2])) / step;
  else if (last_.count && pose.arrival - last_.arrival > std::uint64_t(1e9 * longest_step))
    velocity_.setZero();  // two poses that came together keep the velocity before them
  last_ = pose;
  put(position, velocity_, pose.on != 0);
}

}  // namespace burrlab
