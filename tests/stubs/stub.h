/* What both stubs share: two devices whose state a test sets and reads by name, at any time, from any thread.
 */
#include <math.h>
#include <pthread.h>
#include <string.h>
#include <time.h>

enum { DEVICES = 2 };

/* x, y, z [mm]; vx, vy, vz [mm/s]; turn: about z [degree]; size: factor of the rotation matrix, 1 if it is
   right; rate of the servo [Hz]. error: code of every call from now on; frozen: no new position;
   uncalibrated: 1 the library can calibrate it, 2 by hand. cycles: whole servo cycles; open, force_on: 0
   or 1. */
typedef struct {
  double x, y, z, vx, vy, vz, turn, size, buttons, error, frozen, uncalibrated, rate;
  double fx, fy, fz, cycles, open, force_on;
} Device;

#define START {.z = 5, .size = 1, .rate = 1000}
static Device devices[DEVICES] = {START, START};
static pthread_mutex_t guard = PTHREAD_MUTEX_INITIALIZER;

static double* field(const char* name, int i) {
  Device* d = &devices[i];
#define FIELD(n) \
  if (strcmp(name, #n) == 0) return &d->n;
  FIELD(x)
  FIELD(y) FIELD(z) FIELD(vx) FIELD(vy) FIELD(vz) FIELD(turn) FIELD(size) FIELD(buttons) FIELD(error)
      FIELD(frozen) FIELD(uncalibrated) FIELD(rate) FIELD(fx) FIELD(fy) FIELD(fz) FIELD(cycles) FIELD(open)
          FIELD(force_on) return 0;
}

void stub_set(const char* name, int device, double value) {
  pthread_mutex_lock(&guard);
  *field(name, device) = value;
  pthread_mutex_unlock(&guard);
}

double stub_get(const char* name, int device) {
  pthread_mutex_lock(&guard);
  const double value = *field(name, device);
  pthread_mutex_unlock(&guard);
  return value;
}

static void take_force(Device* d, double x, double y, double z) {
  d->fx = x, d->fy = y, d->fz = z;
  d->cycles += 1;
}

static void wait_period(struct timespec* next, double rate) {
  next->tv_nsec += (long)(1e9 / rate);
  while (next->tv_nsec >= 1000000000) next->tv_nsec -= 1000000000, ++next->tv_sec;
  clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, next, 0);
}
