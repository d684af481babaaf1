/* A stub of libdhd: what burrlab calls of it. In metres; IDs are the indices. A read waits for the device's
   next cycle, as over USB. */
#include "stub.h"

static __thread int last;
static __thread struct timespec next;

static int failed(int id) {
  last = (int)stub_get("error", id);
  return last ? -1 : 0;
}

int dhdGetDeviceCount(void) { return DEVICES; }
int dhdOpenID(char id) {
  if (failed(id)) return -1;
  if (devices[(int)id].open) return last = 20, -1;
  devices[(int)id].open = 1;
  return id;
}
int dhdClose(char id) {
  devices[(int)id].open = 0;
  return 0;
}
int dhdGetStatus(int* status, char id) {
  memset(status, 0, 17 * sizeof *status);
  status[3] = stub_get("uncalibrated", id) != 0;
  return 0;
}
const char* dhdGetSystemName(char id) { return id ? "Stub omega.6" : "Stub omega.3"; }
int dhdEnableForce(unsigned char on, char id) {
  stub_set("force_on", id, on);
  return failed(id);
}
int dhdGetPositionAndOrientationFrame(double* x, double* y, double* z, double (*rotation)[3], char id) {
  if (!next.tv_sec) clock_gettime(CLOCK_MONOTONIC, &next);
  wait_period(&next, stub_get("rate", id));
  pthread_mutex_lock(&guard);
  const Device d = devices[(int)id];
  pthread_mutex_unlock(&guard);
  const double angle = d.turn * acos(-1.0) / 180.0, c = d.size * cos(angle), s = d.size * sin(angle);
  const double rows[3][3] = {{c, -s, 0}, {s, c, 0}, {0, 0, d.size}};
  memcpy(rotation, rows, sizeof rows);
  *x = 1e-3 * d.x, *y = 1e-3 * d.y, *z = 1e-3 * d.z;
  return failed(id) ? -1 : d.frozen != 0; /* 1: the time guard */
}
int dhdGetLinearVelocity(double* x, double* y, double* z, char id) {
  *x = 1e-3 * stub_get("vx", id), *y = 1e-3 * stub_get("vy", id), *z = 1e-3 * stub_get("vz", id);
  return failed(id);
}
int dhdEmulateButton(unsigned char on, char id) {
  stub_set("gripper", id, on);
  return id ? 0 : -1; /* an omega.3 has no gripper */
}
unsigned dhdGetButtonMask(char id) { return (unsigned)stub_get("buttons", id); }
int dhdSetForce(double x, double y, double z, char id) {
  pthread_mutex_lock(&guard);
  take_force(&devices[(int)id], x, y, z);
  pthread_mutex_unlock(&guard);
  return failed(id) ? -1 : 2; /* 2: a motor is saturated, no error */
}
int dhdErrorGetLast(void) { return last; }
const char* dhdErrorGetStr(int code) { return code == 2 ? "communication error" : "other error"; }
