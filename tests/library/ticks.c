/* The ticks of ticks.cpp through the C interface; and what it refuses. */
#include <burrlab.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

int main(void) {
  char error[100], digest[33];
  burrlab_grid grid = {sizeof grid, {15, 30, 70}, {0.2, 0.2, 0.2}, {-6.9, -2.9, -2.9}};
  burrlab_burr_settings settings = {.size = sizeof settings};
  burrlab_motion motion = {.size = sizeof motion};
  burrlab_feel feel = {.size = sizeof feel};
  burrlab_bone* bone = burrlab_bone_create(&grid, NULL, 0, error, sizeof error);
  burrlab_burr* burr;
  double sum = 0.0;
  clock_t start;
  int i;
  if (!bone || burrlab_burr_defaults(&settings, "bone")) return 1;
  settings.radius = 2.0;
  settings.seed = 5;
  memset(settings.to_bone, 0, sizeof settings.to_bone);
  settings.to_bone[0] = settings.to_bone[5] = settings.to_bone[10] = 1.0;
  burr = burrlab_burr_create(bone, &settings);
  if (!burr) return puts(burrlab_bone_error(bone)), 1;
  motion.on = 1;
  motion.dt = 1.0;
  start = clock();
  for (i = 0; i < 100000; ++i) {
    motion.center[0] = -4.0 + i / 16384.0;
    motion.center[1] = (i & 1023) / 2048.0;
    motion.center[2] = 2.0 - (i & 4095) / 4096.0;
    if (burrlab_burr_step(burr, &motion, &feel)) return puts(burrlab_burr_error(burr)), 1;
    sum += feel.force[2];
    burrlab_burr_lift(burr, feel.tick);
  }
  if (burrlab_bone_digest(bone, digest)) return 1;
  printf("%s %a %.4f\n", digest, sum, (double)(clock() - start) / CLOCKS_PER_SEC);

  motion.dt = -1.0; /* refused, and the burr goes on */
  if (burrlab_burr_step(burr, &motion, &feel) != BURRLAB_REFUSED ||
      !strstr(burrlab_burr_error(burr), "dt must be"))
    return 2;
  motion.dt = 1.0;
  motion.size = 4;
  if (burrlab_burr_step(burr, &motion, &feel) != BURRLAB_REFUSED ||
      !strstr(burrlab_burr_error(burr), "size of motion"))
    return 3;
  grid.spacing[0] = -1.0;
  if (burrlab_bone_create(&grid, NULL, 0, error, sizeof error) || !strstr(error, "spacing must be")) return 4;
  if (burrlab_bone_open("none.burr", error, 8) || strlen(error) != 7) return 5;
  burrlab_bone_destroy(bone); /* before its burr */
  motion.size = sizeof motion;
  if (burrlab_burr_step(burr, &motion, &feel)) return 6;
  burrlab_burr_destroy(burr);
  return 0;
}
