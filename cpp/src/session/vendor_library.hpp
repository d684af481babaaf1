// The vendors' libraries, loaded at run time: libHD (OpenHaptics) and libdhd (Force Dimension). The
// declarations are ours, from the public API references; this file lists every function that is used. 64-bit
// systems have one calling convention.
#pragma once

#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

namespace burrlab {

/// A shared library that is never unloaded: its threads may outlive all that uses it.
class VendorLibrary {
 public:
  /// Loads `path`, else what the environment's `variable` names, else the first of `names` that is there.
  VendorLibrary(std::string title, const std::string& path, const char* variable,
                std::vector<std::string> names);
  void* function(const char* name) const;  ///< throws if the library lacks it
  const std::string& path() const { return path_; }

 private:
  std::string title_, path_;
  void* handle_ = nullptr;
};

/// A library that all its devices share, one for each file.
template <class Library>
std::shared_ptr<Library> shared_library(const std::string& path) {
  static std::mutex mutex;
  static auto& loaded = *new std::map<std::string, std::shared_ptr<Library>>;  // outlives all devices
  const std::lock_guard<std::mutex> lock(mutex);
  std::shared_ptr<Library> library = std::make_shared<Library>(path);
  return loaded.emplace(library->path(), library).first->second;
}

/// HDErrorInfo: the error, the device's own code, the device.
struct HdError {
  unsigned code;
  int internal;
  unsigned device;
};

// clang-format off
#define BURRLAB_HD_FUNCTIONS(function)                                                          \
  function(unsigned, hdInitDevice, (const char* name))                                          \
  function(void, hdDisableDevice, (unsigned device))                                            \
  function(void, hdMakeCurrentDevice, (unsigned device))                                        \
  function(unsigned, hdCheckCalibration, ())                                                    \
  function(void, hdUpdateCalibration, (unsigned style))                                         \
  function(void, hdEnable, (unsigned what))                                                     \
  function(void, hdDisable, (unsigned what))                                                    \
  function(void, hdBeginFrame, (unsigned device))                                               \
  function(void, hdEndFrame, (unsigned device))                                                 \
  function(void, hdGetIntegerv, (unsigned what, int* values))                                   \
  function(void, hdGetDoublev, (unsigned what, double* values))                                 \
  function(void, hdSetDoublev, (unsigned what, const double* values))                           \
  function(const char*, hdGetString, (unsigned what))                                           \
  function(HdError, hdGetError, ())                                                             \
  function(const char*, hdGetErrorString, (unsigned code))                                      \
  function(void, hdStartScheduler, ())                                                          \
  function(void, hdStopScheduler, ())                                                           \
  function(unsigned long, hdScheduleAsynchronous, (unsigned (*)(void*), void*, unsigned short)) \
  function(void, hdUnschedule, (unsigned long handle))

#define BURRLAB_DHD_FUNCTIONS(function)                                                                 \
  function(int, dhdGetDeviceCount, ())                                                                  \
  function(int, dhdOpenID, (char id))                                                                   \
  function(int, dhdClose, (char id))                                                                    \
  function(int, dhdGetStatus, (int* status, char id))                                                   \
  function(const char*, dhdGetSystemName, (char id))                                                    \
  function(int, dhdEnableForce, (unsigned char on, char id))                                            \
  function(int, dhdGetPositionAndOrientationFrame, (double*, double*, double*, double (*)[3], char id)) \
  function(int, dhdGetLinearVelocity, (double*, double*, double*, char id))                             \
  function(int, dhdEmulateButton, (unsigned char on, char id))                                          \
  function(unsigned, dhdGetButtonMask, (char id))                                                       \
  function(int, dhdSetForce, (double, double, double, char id))                                         \
  function(int, dhdErrorGetLast, ())                                                                    \
  function(const char*, dhdErrorGetStr, (int code))
// clang-format on

#define BURRLAB_POINTER(result, name, arguments) result(*name) arguments = nullptr;

/// libHD with the state that its devices share.
struct HdLibrary : VendorLibrary {
  explicit HdLibrary(const std::string& path);
  BURRLAB_HD_FUNCTIONS(BURRLAB_POINTER)

  std::mutex mutex;                      // of the next two
  std::map<unsigned, std::string> open;  // names of devices by handle
  int running = 0;                       // devices in a session: the scheduler runs
};

/// libdhd with the state that its devices share.
struct DhdLibrary : VendorLibrary {
  explicit DhdLibrary(const std::string& path);
  BURRLAB_DHD_FUNCTIONS(BURRLAB_POINTER)

  std::mutex mutex;          // of the next
  std::map<int, bool> open;  // devices by ID
};

#undef BURRLAB_POINTER

}  // namespace burrlab
