// A Touch and an Omega over stubs of libHD and libdhd (tests/stubs): what they read, send and refuse.
#include "session/servo_device.hpp"

#include <dlfcn.h>
#include <unistd.h>

#include <filesystem>

#include "burrlab/session/haptic_loop.hpp"
#include "count_allocations.hpp"
#include "loop_scenes.hpp"

using namespace burrlab;
using namespace scenes;
using Status = DeviceReading::Status;

namespace {

/// A stub of its own for a scene: a copy of the file has its own state.
struct Stub {
  std::string file;
  void* handle;

  explicit Stub(const char* source) {
    static int number = 0;
    file = (std::filesystem::temp_directory_path() /
            ("burrlab_stub_" + std::to_string(getpid()) + "_" + std::to_string(number++) + ".so"))
               .string();
    std::filesystem::copy_file(source, file, std::filesystem::copy_options::overwrite_existing);
    handle = dlopen(file.c_str(), RTLD_NOW);
    CHECK(handle != nullptr);
  }
  ~Stub() { std::filesystem::remove(file); }
  void set(const char* name, double value, int device = 0) const {
    reinterpret_cast<void (*)(const char*, int, double)>(dlsym(handle, "stub_set"))(name, device, value);
  }
  double get(const char* name, int device = 0) const {
    return reinterpret_cast<double (*)(const char*, int)>(dlsym(handle, "stub_get"))(name, device);
  }
  double force(int device = 0) const {
    return std::abs(get("fx", device)) + std::abs(get("fy", device)) + std::abs(get("fz", device));
  }
  /// The servo cycle that is under way, and the next.
  void two_cycles(int device = 0) const { wait_for(get("cycles", device) + 2, device); }
  void wait_for(double due, int device = 0) const {
    for (int i = 0; i < 1000 && get("cycles", device) < due; ++i) sleep(1);
    CHECK(get("cycles", device) >= due);
  }
};

struct Touch {
  static constexpr const char* source = LIBHD;
  static constexpr double error = 0x0302;
  static constexpr const char* failed = "touch failed: HD_COMM_ERROR (error 770)";
  static std::shared_ptr<ServoDevice> open(const Stub& stub, int device = 0,
                                           const ServoSettings& settings = {}) {
    return std::make_shared<TouchDevice>(device ? "Left" : "", settings, stub.file);
  }
};

struct Omega {
  static constexpr const char* source = LIBDHD;
  static constexpr double error = 2;
  static constexpr const char* failed = "omega:0 failed: communication error (error 2)";
  static std::shared_ptr<ServoDevice> open(const Stub& stub, int device = 0,
                                           const ServoSettings& settings = {}) {
    return std::make_shared<OmegaDevice>(device, settings, stub.file);
  }
};

/// A pose arrives in mm; a force by the next whole servo cycle; none after `halt` and between sessions.
template <class Kind>
void pose_and_force() {
  const Stub stub(Kind::source);
  ServoSettings settings;
  settings.on_button = 1;
  const auto device = Kind::open(stub, 0, settings);
  CHECK(stub.get("force_on") == 0.0);
  for (int session = 0; session < 2; ++session) {
    device->start(1e-3);
    CHECK(device->read(0.0, 1).status == Status::ok);
    stub.set("x", 12.5), stub.set("y", -3.0), stub.set("z", 40.0), stub.set("vy", 7.0);
    stub.set("turn", 90.0), stub.set("buttons", 2.0);
    stub.two_cycles();
    sleep(1);  // the reading follows the force
    const DeviceReading reading = device->read(0.0, 1);
    CHECK((reading.position - Vec3(12.5, -3.0, 40.0)).norm() < 1e-12);
    CHECK((reading.velocity - Vec3(0.0, 7.0, 0.0)).norm() < 1e-12);
    CHECK_NEAR(reading.orientation[0], std::sqrt(0.5), 1e-12);
    CHECK_NEAR(reading.orientation[3], std::sqrt(0.5), 1e-12);
    CHECK(reading.buttons == 2 && reading.on);
    CHECK(reading.age >= 0.0 && reading.age < 100.0);
    stub.set("buttons", 1.0);
    device->write({1.0, -2.0, 3.0});
    stub.two_cycles();
    CHECK(stub.get("fx") == 1.0 && stub.get("fy") == -2.0 && stub.get("fz") == 3.0);
    CHECK(stub.get("force_on") == 1.0);
    stub.set("rate", 5.0);  // a force that comes while the servo waits acts in the cycle that is under way
    stub.two_cycles();
    sleep(50);
    const double due = stub.get("cycles") + 1;
    device->write({0.0, 0.0, 2.0});
    stub.wait_for(due);
    CHECK(stub.get("fz") == 2.0);
    stub.set("rate", 1000.0);
    device->halt();
    device->write({1.0, -2.0, 3.0});
    stub.two_cycles();
    CHECK(stub.force() == 0.0);
    CHECK(!device->read(0.0, 1).on);
    device->stop();
    CHECK(stub.get("force_on") == 0.0 && stub.force() == 0.0);
    CHECK(device->fault().empty());
  }
}

/// Neither the loop's calls nor the servo's cycles allocate.
template <class Kind>
void nothing_is_allocated() {
  const Stub stub(Kind::source);
  const auto device = Kind::open(stub);
  device->start(1e-3);
  const long before = allocations;
  for (int i = 0; i < 1000; ++i) {
    device->read(1e-3 * i, 1);
    device->write({0.0, 0.0, 1e-3 * i});
  }
  stub.two_cycles();
  device->halt();
  CHECK(allocations == before);
  device->stop();
}

/// In a session: an error of the library, or a matrix that is no rotation, ends it with force zero.
template <class Kind>
void unplugged(const char* what, double value, const std::string& why) {
  const Stub stub(Kind::source);
  const auto device = Kind::open(stub);
  LoopSettings settings;
  settings.realtime.priority = settings.realtime.lock_memory = false;
  HapticLoop loop(executor(), {device}, settings);
  loop.start();
  stub.set("z", 1.4);
  for (int i = 0; i < 1000 && stub.force() == 0.0; ++i) sleep(1);
  CHECK(stub.force() > 0.0);
  stub.set(what, value);
  CHECK(loop.wait(5.0));
  CHECK(stub.force() == 0.0 && stub.get("force_on") == 0.0);
  CHECK(loop.failed() && loop.reason().find("device 0 was lost") == 0);
  CHECK(device->fault() == why);
  loop.stop();
}

/// A device that falls silent is lost when its position is too old; its servo may be stuck.
template <class Kind>
void silent(const char* what, double value, bool servo_ends) {
  const Stub stub(Kind::source);
  ServoSettings settings;
  settings.lost_after = 50.0;
  const auto device = Kind::open(stub, 0, settings);
  device->start(1e-3);
  device->write({0.0, 0.0, 1.0});
  stub.two_cycles();
  CHECK(stub.get("fz") == 1.0);
  stub.set(what, value);
  DeviceReading reading;
  for (int i = 0; i < 1000 && reading.status == Status::ok; ++i) {
    sleep(1);
    reading = device->read(0.0, 1);
  }
  CHECK(reading.status == Status::lost && reading.age > 50.0 && device->fault().empty());
  if (servo_ends) stub.two_cycles();
  if (servo_ends) CHECK(stub.force() == 0.0);
  device->stop();
  if (Kind::source == Touch::source) CHECK(stub.force() == 0.0 && stub.get("force_on") == 0.0);
  if (!servo_ends) CHECK_THROWS(device->start(1e-3), "its servo did not end");
}

template <class Kind>
void two_devices() {
  const Stub stub(Kind::source);
  const auto first = Kind::open(stub, 0), second = Kind::open(stub, 1);
  CHECK_THROWS(Kind::open(stub, 1), "must be a device of its own: it is open already");
  first->start(1e-3);
  if (Kind::source == Touch::source)
    CHECK_THROWS(Kind::open(stub, 1), "touch:Left must be opened before a session with another touch begins");
  second->start(1e-3);
  stub.set("x", 1.0, 0), stub.set("x", 2.0, 1);
  first->write({1.0, 0.0, 0.0});
  second->write({2.0, 0.0, 0.0});
  stub.two_cycles(0);
  stub.two_cycles(1);
  sleep(1);
  CHECK(first->read(0.0, 1).position[0] == 1.0 && second->read(0.0, 1).position[0] == 2.0);
  CHECK(stub.get("fx", 0) == 1.0 && stub.get("fx", 1) == 2.0);
  first->stop();
  stub.two_cycles(1);
  CHECK(stub.force(0) == 0.0 && stub.get("fx", 1) == 2.0);
  second->stop();
  CHECK(stub.force(1) == 0.0);
}

void refusals() {
  const Stub hd(LIBHD), dhd(LIBDHD);
  CHECK_THROWS(TouchDevice("None", {}, hd.file), "touch:None must be the name of a connected device");
  {
    const TouchDevice left("Left", {}, hd.file);
    CHECK(left.hardware() == "Stub Touch" && left.library() == hd.file && left.name() == "touch:Left");
    CHECK_THROWS(TouchDevice("Alias", {}, hd.file), "touch:Alias must be a device of its own");
  }
  CHECK_THROWS(OmegaDevice(2, {}, dhd.file), "index of an omega must be 0 to 1, got 2");
  CHECK(OmegaDevice::count(dhd.file) == 2 && OmegaDevice(1, {}, dhd.file).hardware() == "Stub omega.6");
  CHECK_THROWS(OmegaDevice(0, {0.0, -1}, dhd.file), "lost_after must be positive");
  CHECK_THROWS(OmegaDevice(0, {100.0, 8}, dhd.file), "on_button must be 0 to 7");
  hd.set("uncalibrated", 2);
  dhd.set("uncalibrated", 1);
  CHECK_THROWS(TouchDevice("", {}, hd.file), "touch must be calibrated: put the stylus into its inkwell");
  CHECK_THROWS(OmegaDevice(0, {}, dhd.file),
               "omega:0 must be calibrated: put its pole into the calibration pit");
  CHECK(hd.get("open") == 0.0 && dhd.get("open") == 0.0);
  hd.set("uncalibrated", 1);  // the stylus is in the inkwell
  TouchDevice("", {}, hd.file);
  hd.set("error", 0x0302);
  dhd.set("uncalibrated", 0), dhd.set("error", 2);
  CHECK_THROWS(TouchDevice("", {}, hd.file), "set-up: HD_COMM_ERROR (error 770)");
  CHECK_THROWS(OmegaDevice(0, {}, dhd.file), "can be opened: communication error (error 2)");
  hd.set("error", 0), hd.set("frozen", 1);
  const auto touch = std::make_shared<TouchDevice>("", ServoSettings{}, hd.file);
  CHECK_THROWS(touch->start(1e-3), "touch must give positions: none came within 1 s");
  dhd.set("error", 0);
  const auto omega = std::make_shared<OmegaDevice>(0, ServoSettings{}, dhd.file);
  dhd.set("error", 2);
  CHECK_THROWS(omega->start(1e-3),
               "omega:0 must let its force be switched on: communication error (error 2)");
  CHECK(dhd.get("force_on") == 0.0);
  dhd.set("error", 0), dhd.set("size", -1);
  CHECK_THROWS(omega->start(1e-3),
               "omega:0 must give positions: omega:0 gave an orientation that is not a rotation");
  CHECK(dhd.force() == 0.0 && dhd.get("force_on") == 0.0);
}

template <class Kind>
void all(const char* name) {
  pose_and_force<Kind>();
  nothing_is_allocated<Kind>();
  unplugged<Kind>("error", Kind::error, Kind::failed);
  for (const double size : {0.0, -1.0, std::nan("")})
    unplugged<Kind>("size", size, std::string(name) + " gave an orientation that is not a rotation");
  two_devices<Kind>();
}

}  // namespace

int main() {
  all<Touch>("touch");
  all<Omega>("omega:0");
  silent<Touch>("frozen", 1, false);
  silent<Omega>("frozen", 1, true);
  silent<Omega>("rate", 0.5, false);
  refusals();
  return check::report();
}
