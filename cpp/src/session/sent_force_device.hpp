// A device that keeps the force that the loop sent, for any thread to read.
#pragma once

#include <array>
#include <atomic>

#include "burrlab/session/device.hpp"
#include "session/latest.hpp"

namespace burrlab {

class SentForceDevice : public Device {
 public:
  void write(const Vec3& force) noexcept override { sent_.put({force[0], force[1], force[2]}); }
  void halt() noexcept override { halted_.store(true, std::memory_order_release); }
  Vec3 force() const {  ///< last sent by the loop; 0 after `halt` [N]
    std::array<double, 3> force{};
    if (!halted()) sent_.get(force, 1000);
    return to_vector(force);
  }

 protected:
  bool halted() const { return halted_.load(std::memory_order_acquire); }
  void resume() { halted_.store(false, std::memory_order_release); }  // at a session's start

 private:
  std::atomic<bool> halted_{false};
  Latest<std::array<double, 3>> sent_;
};

}  // namespace burrlab
