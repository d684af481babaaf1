/* What both stubs share: two devices whose state a test sets and reads by name, at any time, from any thread.
 */
#include <math.h>
#include <pthread.h>
#include <string.h>
#include <time.h>

enum { DEVICES = 2, LOGGED = 1 << 16 };

/* x, y, z [mm]; vx, vy, vz [mm/s]; turn: about z [degree]; size: factor of the rotation matrix, 1 if it is
   right; rate of the servo [Hz]. error: code of every call from now on; frozen: no new position;
   uncalibrated: 1 the library can calibrate it, 2 by hand. mass [kg]: above 0 a hand moves it along z, with
   damping [N s/m] and a push downwards [N]. cycles: whole servo cycles; open, force_on, gripper: 0 or 1. */
typedef struct {
  double x, y, z, vx, vy, vz, turn, size, buttons, error, frozen, uncalibrated, rate;
  double mass, damping, push, fx, fy, fz, cycles, open, force_on, gripper;
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
          FIELD(force_on) FIELD(gripper) FIELD(mass) FIELD(damping) FIELD(push) return 0;
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

static struct {
  double time, z, force;
} logged[DEVICES][LOGGED];

int stub_log(int device, double* rows) {
  pthread_mutex_lock(&guard);
  const long cycles = (long)devices[device].cycles, first = cycles > LOGGED ? cycles - LOGGED : 0;
  for (long i = first; i < cycles; ++i) memcpy(rows + 3 * (i - first), &logged[device][i % LOGGED], 24);
  pthread_mutex_unlock(&guard);
  return (int)(cycles - first);
}

/* Ends a servo cycle: the force acts on the hand for a period. */
static void take_force(Device* d, double x, double y, double z) {
  struct timespec now;
  const int steps = 10;
  clock_gettime(CLOCK_MONOTONIC, &now);
  logged[d - devices][(long)d->cycles % LOGGED].time = (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
  logged[d - devices][(long)d->cycles % LOGGED].z = d->z;
  logged[d - devices][(long)d->cycles % LOGGED].force = z;
  d->fx = x, d->fy = y, d->fz = z;
  d->cycles += 1;
  for (int i = 0; d->mass > 0 && i < steps; ++i) {
    d->vz += (z - d->push - 1e-3 * d->damping * d->vz) * 1e3 / d->mass / (d->rate * steps);
    d->z += d->vz / (d->rate * steps);
  }
}

static void wait_period(struct timespec* next, double rate) {
  next->tv_nsec += (long)(1e9 / rate);
  while (next->tv_nsec >= 1000000000) next->tv_nsec -= 1000000000, ++next->tv_sec;
  clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, next, 0);
}
