#include "session/vendor_library.hpp"

#include <cstdlib>
#include <fstream>
#include <system_error>

#include "burrlab/error.hpp"

#ifdef _WIN32
#define WIN32_LEAN_AND_MEAN
#ifndef NOMINMAX
#define NOMINMAX 1
#endif
#include <windows.h>
#else
#include <dlfcn.h>
#endif

namespace burrlab {
namespace {

#ifdef _WIN32
void* open_library(const std::string& name, std::string& why) {
  HMODULE handle = LoadLibraryA(name.c_str());
  if (handle) return reinterpret_cast<void*>(handle);
  const DWORD code = GetLastError();
  why = code == ERROR_BAD_EXE_FORMAT ? "" : std::system_category().message(int(code));
  return nullptr;
}

void* find_symbol(void* handle, const char* name) {
  return reinterpret_cast<void*>(GetProcAddress(reinterpret_cast<HMODULE>(handle), name));
}
#else
/// Class, byte order and machine of an ELF file; empty if it is none.
std::string machine_of(const std::string& path) {
  char head[20] = {};
  std::ifstream(path, std::ios::binary).read(head, sizeof head);
  if (std::string(head, 4) != "\177ELF") return {};
  return {head[4], head[5], head[18], head[19]};
}

void* open_library(const std::string& name, std::string& why) {
  if (void* handle = dlopen(name.c_str(), RTLD_NOW | RTLD_LOCAL)) return handle;
  why = dlerror();
  const std::string machine = machine_of(name), here = machine_of("/proc/self/exe");
  if (!machine.empty() && !here.empty() && machine != here) why.clear();
  return nullptr;
}

void* find_symbol(void* handle, const char* name) { return dlsym(handle, name); }
#endif

}  // namespace

VendorLibrary::VendorLibrary(std::string title, const std::string& path, const char* variable,
                             std::vector<std::string> names)
    : title_(std::move(title)) {
  const char* from_variable = std::getenv(variable);
  if (!path.empty())
    names = {path};
  else if (from_variable && *from_variable)
    names = {from_variable};
  std::string failures;
  for (const std::string& name : names) {
    std::string why;
    if ((handle_ = open_library(name, why))) {
      path_ = name;
      return;
    }
    if (why.empty())
      throw InvalidArgument(title_ + " must be made for this program's kind of processor: " + name +
                            " is made for another");
    failures +=
        (failures.empty() ? "" : "; ") + (why.find(name) == std::string::npos ? name + ": " + why : why);
  }
  throw InvalidArgument(title_ + " must be installed, or " + variable + " must name its file: " + failures);
}

void* VendorLibrary::function(const char* name) const {
  if (void* found = find_symbol(handle_, name)) return found;
  throw InvalidArgument(title_ + " must have the function " + name + ": " + path_ + " lacks it");
}

#if defined(_WIN32)
#define BURRLAB_NAMES(elsewhere, mac, windows) windows
#elif defined(__APPLE__)
#define BURRLAB_NAMES(elsewhere, mac, windows) mac
#else
#define BURRLAB_NAMES(elsewhere, mac, windows) elsewhere
#endif

using Names = std::vector<std::string>;

#define BURRLAB_FIND(result, name, arguments) name = reinterpret_cast<decltype(name)>(function(#name));

HdLibrary::HdLibrary(const std::string& path)
    : VendorLibrary(
          "libHD (OpenHaptics)", path, "BURRLAB_LIBHD",
          BURRLAB_NAMES((Names{"libHD.so", "libHD.so.3.4"}), (Names{"libHD.dylib"}), (Names{"hd.dll"}))) {
  BURRLAB_HD_FUNCTIONS(BURRLAB_FIND);
}

DhdLibrary::DhdLibrary(const std::string& path)
    : VendorLibrary("libdhd (Force Dimension)", path, "BURRLAB_LIBDHD",
                    BURRLAB_NAMES((Names{"libdhd.so.3", "libdhd.so"}),
                                  (Names{"libdhd.3.dylib", "libdhd.dylib"}), (Names{"dhd64.dll"}))) {
  BURRLAB_DHD_FUNCTIONS(BURRLAB_FIND);
}

}  // namespace burrlab
