// Scripts and recordings, reproduced exactly.
#include "session/scripted_device.hpp"

#include <cmath>

#include "check.hpp"

using namespace burrlab;

namespace {

void check_script() {
  using Status = DeviceReading::Status;
  ScriptedDevice device(
      {{0.5, Vec3(1.0, 0.0, 0.0), false}, {1.0, Vec3(2.0, 4.0, 0.0), true}, {1.5, Vec3::Zero(), true}});
  DeviceReading now = device.read(0.2, 1);
  CHECK(now.status == Status::ok && now.position == Vec3(1.0, 0.0, 0.0) && !now.on &&
        now.velocity.isZero(0.0));
  now = device.read(0.75, 1);
  CHECK_NEAR((now.position - Vec3(1.5, 2.0, 0.0)).norm(), 0.0, 1e-15);
  CHECK_NEAR((now.velocity - Vec3(2.0, 8.0, 0.0)).norm(), 0.0, 1e-14);
  CHECK(!now.on && device.read(1.0, 1).on && device.read(1.0, 1).position == Vec3(2.0, 4.0, 0.0));
  CHECK(device.read(1.5, 1).status == Status::ok && device.read(1.5000001, 1).status == Status::finished);
  device.write(Vec3(1.0, 2.0, 3.0));
  CHECK(device.force() == Vec3(1.0, 2.0, 3.0));
  device.halt();
  CHECK(device.force().isZero(0.0));
}

void check_replay() {
  using Status = DeviceReading::Status;
  ReplayDevice device({{Vec3(1.0, 2.0, 3.0), Vec3(4.0, 5.0, 6.0)},
                       {Vec3::Zero(), Vec3::Zero(), {1.0, 0.0, 0.0, 0.0}, 0, true}});
  const DeviceReading now = device.read(0.0, 1);
  CHECK(now.position == Vec3(1.0, 2.0, 3.0) && now.velocity == Vec3(4.0, 5.0, 6.0) && !now.on);
  CHECK(device.read(0.0, 5).on);
  CHECK(device.read(0.0, 1).status == Status::finished && device.read(0.0, 1).status == Status::finished);
}

}  // namespace

int main() {
  check_script();
  check_replay();
  return check::report();
}
