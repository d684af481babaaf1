// A device of one's own in the 1 kHz loop. Its session is written to device.burr, which Python reads:
// `burrlab replay device.burr` executes it again, with the same digest.
#include <atomic>
#include <burrlab/burrlab.hpp>
#include <cmath>
#include <cstdio>

// A hand that presses for a second and goes round; a real device would ask its driver in `read`.
class Hand : public burrlab::Device {
 public:
  burrlab::DeviceReading read(double time, std::uint64_t) noexcept override {
    burrlab::DeviceReading now;
    now.position = {std::sin(4.0 * time), std::cos(4.0 * time) - 1.0, 3.0 - 0.8 * time};  // [mm]
    now.on = true;
    if (time > 1.0) now.status = burrlab::DeviceReading::Status::finished;
    return now;
  }
  void write(const burrlab::Vec3& force) noexcept override { force_ = force.norm(); }
  void halt() noexcept override { force_ = 0.0; }
  std::string name() const override { return "hand"; }
  double force() const { return force_; }  // last sent [N]

 private:
  std::atomic<double> force_{0.0};
};

int main() try {
  const burrlab::Burr burr(3.0);
  const auto bone = std::make_shared<burrlab::VoxelBone>(
      burrlab::block({-6.0, -7.0, -3.0}, {6.0, 5.0, 0.0}, /*spacing=*/0.2));
  burrlab::SessionSetup setup;
  setup.tools = {{burr, burrlab::paper_material("bone")}};
  setup.seed = 1;
  const auto executor = std::make_shared<burrlab::TickExecutor>(bone, setup);
  burrlab::LoopSettings settings;
  settings.message = [](const std::string& sentence) { std::printf("loop: %s\n", sentence.c_str()); };
  burrlab::HapticLoop loop(executor, {std::make_shared<Hand>()}, settings);
  burrlab::FlatTrace("device.burr", executor).record(loop);  // starts the loop; returns when it has ended
  std::printf("%llu ticks, %.0f us at most, bone %s\n", static_cast<unsigned long long>(loop.counts().ticks),
              loop.wall_time().largest(), bone->digest().c_str());
} catch (const burrlab::Error& error) {
  std::fprintf(stderr, "%s\n", error.what());
  return 1;
}
