#include "session/servo_device.hpp"

namespace burrlab {

// hdDefines.h, from the OpenHaptics API reference.
constexpr unsigned invalid_handle = 0xFFFFFFFF;
constexpr unsigned already_initiated = 0x0301;
constexpr unsigned current_buttons = 0x2000, current_velocity = 0x2051, current_transform = 0x2052;
constexpr unsigned current_force = 0x2700, force_output = 0x4000;
constexpr unsigned device_model = 0x2501, calibration_style = 0x2555;
constexpr unsigned calibration_ok = 0x5000, calibration_needs_update = 0x5001;
constexpr int style_auto = 2, style_inkwell = 4;
constexpr unsigned callback_done = 0, callback_continue = 1;
constexpr unsigned short priority = 0xFFFF;  // the highest
constexpr int most_errors = 32;              // that are taken at a time

static std::string touch_name(const std::string& name) { return name.empty() ? "touch" : "touch:" + name; }

TouchDevice::TouchDevice(const std::string& name, const ServoSettings& settings, const std::string& library)
    : ServoDevice(touch_name(name), settings), hd_(shared_library<HdLibrary>(library)) {
  const std::lock_guard<std::mutex> lock(hd_->mutex);
  if (hd_->running > 0)  // libHD's rule: all devices before its scheduler
    throw InvalidArgument(this->name() + " must be opened before a session with another touch begins");
  take_error();  // of earlier calls
  handle_ = hd_->hdInitDevice(name.empty() ? nullptr : name.c_str());
  const int code = take_error();
  const auto same = hd_->open.find(handle_);
  if (unsigned(code) == already_initiated || same != hd_->open.end())
    throw InvalidArgument(this->name() + " must be a device of its own: it is open already" +
                          (same == hd_->open.end() ? "" : ", as " + same->second));
  if (code != 0 || handle_ == invalid_handle)
    throw InvalidArgument(this->name() + " must be the name of a connected device in the vendor's set-up: " +
                          (code ? described(code) : "none found"));
  hd_->hdMakeCurrentDevice(handle_);
  unsigned calibration = hd_->hdCheckCalibration();
  if (calibration == calibration_needs_update) {  // it lies where the library can calibrate it
    int styles = 0;
    hd_->hdGetIntegerv(calibration_style, &styles);
    if (styles & (style_inkwell | style_auto)) {
      hd_->hdUpdateCalibration(styles & style_inkwell ? style_inkwell : style_auto);
      calibration = hd_->hdCheckCalibration();
    }
  }
  if (calibration != calibration_ok || take_error() != 0) {
    hd_->hdDisableDevice(handle_);
    throw InvalidArgument(this->name() +
                          " must be calibrated: put the stylus into its inkwell, or run the "
                          "vendor's set-up");
  }
  set_hardware(hd_->hdGetString(device_model));
  hd_->open[handle_] = this->name();
}

TouchDevice::~TouchDevice() {
  const std::lock_guard<std::mutex> lock(hd_->mutex);
  hd_->hdDisableDevice(handle_);
  hd_->open.erase(handle_);
}

/// The newest error code, 0 if there is none; empties the library's stack.
int TouchDevice::take_error() noexcept {
  const int code = int(hd_->hdGetError().code);
  for (int i = 0; code && i < most_errors && hd_->hdGetError().code; ++i) {
  }
  return code;
}

int TouchDevice::exchange(Pose& pose) noexcept {
  double transform[16] = {};  // by columns
  int buttons = 0;
  hd_->hdBeginFrame(handle_);
  if (!force_on_) hd_->hdEnable(force_output);
  force_on_ = true;
  hd_->hdGetDoublev(current_transform, transform);
  hd_->hdGetDoublev(current_velocity, pose.velocity.data());
  hd_->hdGetIntegerv(current_buttons, &buttons);
  hd_->hdSetDoublev(current_force, newest_force().data());
  hd_->hdEndFrame(handle_);
  for (int row = 0; row < 3; ++row) {
    pose.position[row] = transform[12 + row];
    for (int column = 0; column < 3; ++column) pose.rotation[3 * row + column] = transform[4 * column + row];
  }
  pose.buttons = std::uint32_t(buttons);
  return take_error();
}

void TouchDevice::switch_force_off() noexcept {
  const double zero[3] = {};
  hd_->hdBeginFrame(handle_);
  hd_->hdSetDoublev(current_force, zero);
  hd_->hdDisable(force_output);
  hd_->hdEndFrame(handle_);
  take_error();
  force_on_ = false;
}

void TouchDevice::begin() {
  const std::lock_guard<std::mutex> lock(hd_->mutex);
  scheduled_ = hd_->hdScheduleAsynchronous(
      [](void* self) { return static_cast<TouchDevice*>(self)->cycle() ? callback_continue : callback_done; },
      this, priority);
  if (hd_->running++ == 0) hd_->hdStartScheduler();
}

void TouchDevice::end(bool servo_ended) noexcept {
  const std::lock_guard<std::mutex> lock(hd_->mutex);
  if (!servo_ended) hd_->hdUnschedule(scheduled_);
  if (--hd_->running == 0) hd_->hdStopScheduler();
  if (!servo_ended && hd_->running == 0) {  // it did not come to this itself
    hd_->hdMakeCurrentDevice(handle_);
    switch_force_off();
  }
}

}  // namespace burrlab
