/* A stub of libHD: what burrlab calls of it. Devices "Default Device" (also without a name) and "Left";
   "Alias" is another name of "Left". Device 0 has handle 10, device 1 handle 11. */
#include "stub.h"

typedef unsigned (*Callback)(void*);
typedef struct {
  unsigned code;
  int internal;
  unsigned device;
} Error;

static struct {
  Callback call;
  void* data;
} scheduled[8];
static unsigned errors[16], current;
static int count_of_errors, running;
static pthread_t servo;

static Device* device_of(unsigned handle) { return &devices[handle - 10]; }

static void push_error(unsigned code) {
  if (count_of_errors < 16) errors[count_of_errors++] = code;
}

static void* run(void* none) {
  struct timespec next;
  const struct sched_param high = {.sched_priority = 80}; /* as libHD's servo; where the system grants it */
  pthread_setschedparam(pthread_self(), SCHED_FIFO, &high);
  clock_gettime(CLOCK_MONOTONIC, &next);
  while (__atomic_load_n(&running, __ATOMIC_ACQUIRE)) {
    for (int i = 0; i < 8; ++i) {
      const Callback call = __atomic_load_n(&scheduled[i].call, __ATOMIC_ACQUIRE);
      if (call && !stub_get("frozen", 0) && !call(scheduled[i].data))
        __atomic_store_n(&scheduled[i].call, (Callback)0, __ATOMIC_RELEASE);
    }
    wait_period(&next, stub_get("rate", 0));
  }
  return none;
}

unsigned hdInitDevice(const char* name) {
  const int i = !name || strcmp(name, "Default Device") == 0              ? 0
                : strcmp(name, "Left") == 0 || strcmp(name, "Alias") == 0 ? 1
                                                                          : -1;
  const unsigned code = i < 0              ? 0x0300
                        : devices[i].error ? (unsigned)devices[i].error
                        : devices[i].open  ? 0x0301
                                           : 0;
  if (code) return push_error(code), 0xFFFFFFFFu;
  devices[i].open = 1;
  return current = 10 + i;
}
void hdDisableDevice(unsigned handle) { device_of(handle)->open = 0; }
void hdMakeCurrentDevice(unsigned handle) { current = handle; }
unsigned hdCheckCalibration(void) { return 0x5000 + (unsigned)device_of(current)->uncalibrated; }
void hdUpdateCalibration(unsigned style) {
  if (style == 4) stub_set("uncalibrated", (int)current - 10, 0);
}
void hdEnable(unsigned what) {
  if (what == 0x4000) stub_set("force_on", (int)current - 10, 1);
}
void hdDisable(unsigned what) {
  if (what == 0x4000) stub_set("force_on", (int)current - 10, 0);
}
void hdBeginFrame(unsigned handle) {
  current = handle;
  const double code = stub_get("error", (int)handle - 10);
  if (code) push_error((unsigned)code);
}
void hdEndFrame(unsigned handle) { current = handle; }
void hdGetIntegerv(unsigned what, int* values) {
  if (what == 0x2000) *values = (int)stub_get("buttons", (int)current - 10);
  if (what == 0x2555) *values = 4;
}
void hdGetDoublev(unsigned what, double* values) {
  pthread_mutex_lock(&guard);
  const Device d = *device_of(current);
  pthread_mutex_unlock(&guard);
  const double angle = d.turn * acos(-1.0) / 180.0, c = d.size * cos(angle), s = d.size * sin(angle);
  const double transform[16] = {c, s, 0, 0, -s, c, 0, 0, 0, 0, d.size, 0, d.x, d.y, d.z, 1}; /* by columns */
  const double velocity[3] = {d.vx, d.vy, d.vz};
  if (what == 0x2052) memcpy(values, transform, sizeof transform);
  if (what == 0x2051) memcpy(values, velocity, sizeof velocity);
}
void hdSetDoublev(unsigned what, const double* v) {
  pthread_mutex_lock(&guard);
  if (what == 0x2700) take_force(device_of(current), v[0], v[1], v[2]);
  pthread_mutex_unlock(&guard);
}
const char* hdGetString(unsigned what) { return what == 0x2501 ? "Stub Touch" : ""; }
Error hdGetError(void) {
  const Error error = {count_of_errors ? errors[--count_of_errors] : 0, 0, current};
  return error;
}
const char* hdGetErrorString(unsigned code) {
  return code == 0x0300 ? "HD_DEVICE_FAULT" : code == 0x0302 ? "HD_COMM_ERROR" : "HD_OTHER";
}
void hdStartScheduler(void) {
  running = 1;
  pthread_create(&servo, 0, run, 0);
}
void hdStopScheduler(void) {
  __atomic_store_n(&running, 0, __ATOMIC_RELEASE);
  pthread_join(servo, 0);
}
unsigned long hdScheduleAsynchronous(Callback call, void* data, unsigned short priority) {
  unsigned long i = 0;
  while (scheduled[i].call) ++i;
  scheduled[i].data = data;
  __atomic_store_n(&scheduled[i].call, call, __ATOMIC_RELEASE);
  return i + (priority == 0xFFFF ? 0 : 1000);
}
void hdUnschedule(unsigned long handle) {
  __atomic_store_n(&scheduled[handle].call, (Callback)0, __ATOMIC_RELEASE);
}
