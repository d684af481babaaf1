/* The same from C: what C#, Rust, MATLAB or an Unreal plug-in calls. */
#include <burrlab.h>
#include <stdio.h>

static int failed(const char* sentence) {
  fprintf(stderr, "burrlab: %s\n", sentence);
  return 1;
}

int main(void) {
  char error[400];
  burrlab_grid grid = {sizeof grid, {40, 60, 60}, {0.2, 0.2, 0.2}, {0.1, 0.1, 0.1}};
  burrlab_burr_settings settings = {.size = sizeof settings};
  burrlab_motion motion = {.size = sizeof motion};
  burrlab_feel feel = {.size = sizeof feel};
  burrlab_changes changes = {.size = sizeof changes};
  burrlab_bone* bone;
  burrlab_burr* burr;
  burrlab_view* view;
  double removed = 0.0;
  char digest[33];
  int step;

  if (burrlab_abi_version() != BURRLAB_ABI_VERSION) return failed("the library has another interface");
  bone = burrlab_bone_create(&grid, NULL, 0, error, sizeof error); /* solid */
  if (!bone) return failed(error);
  burrlab_burr_defaults(&settings, "bone");
  settings.radius = 3.0; /* [mm]; positions stay in metres */
  burr = burrlab_burr_create(bone, &settings);
  view = burrlab_view_create(bone);
  if (!burr || !view) return failed(burrlab_bone_error(bone));

  motion.on = 1;
  for (step = 0; step < 600; ++step) {
    motion.dt = step % 2 ? 0.9 : 1.1; /* [ms] */
    motion.center[0] = motion.center[1] = 0.006;
    motion.center[2] = 0.008 + 0.003 - 0.000002 * step;
    if (burrlab_burr_step(burr, &motion, &feel)) return failed(burrlab_burr_error(burr));
    removed += feel.removed;
    if (step % 100 == 99) {
      if (burrlab_view_update(view, &changes)) return failed(burrlab_view_error(view));
      printf("%.3f N, %u bricks to draw anew\n", feel.force[2], (unsigned)changes.bricks);
    }
  }
  if (burrlab_bone_digest(bone, digest)) return failed(burrlab_bone_error(bone));
  printf("removed %.3f mm^3, bone %s\n", removed, digest);
  burrlab_view_destroy(view);
  burrlab_burr_destroy(burr);
  burrlab_bone_destroy(bone);
  return 0;
}
