/* burrlab in C: a bone, burrs in it, and views of it, for C#, Rust, MATLAB and plug-ins.
 *
 *     burrlab_burr_settings settings = {.size = sizeof settings};
 *     burrlab_burr_defaults(&settings, "bone");
 *     settings.radius = 3.0;
 *     burrlab_burr* burr = burrlab_burr_create(bone, &settings);
 *     burrlab_motion motion = {.size = sizeof motion, .on = 1, .center = {x, y, z}, .dt = 1.0};
 *     burrlab_feel feel = {.size = sizeof feel};
 *     if (burrlab_burr_step(burr, &motion, &feel)) puts(burrlab_burr_error(burr));
 *
 * Units are mm, N and ms, but for lengths of the host (burrlab_burr_settings.to_bone). Arrays of a bone are
 * (z, y, x) with x fastest, one byte a voxel: 0 is empty, 255 solid bone. Vectors are (x, y, z).
 *
 * Handles are independent of each other: there is no global state. A handle serves one thread at a time; a
 * burr and a view of the same bone may work in two threads at once. Two burrs of a bone, or a burr and a
 * function that reads or changes the bone's levels, must not: the later call is refused, and nothing waits. A
 * bone's handle may be destroyed before its burrs and views. A text of an error is valid until the handle's
 * next call.
 *
 * `size` of a struct is its sizeof in the caller's program: a later version may add members at the end, and
 * then goes on to accept this one. Texts are UTF-8. Functions use the C calling convention (__cdecl on
 * Windows), throw nothing, print nothing, and return 0, or a burrlab_status and a sentence in the handle's
 * error text. */
#ifndef BURRLAB_H
#define BURRLAB_H

#include <stddef.h>
#include <stdint.h>

#ifdef _WIN32
#define BURRLAB_CALL __cdecl
#else
#define BURRLAB_CALL
#endif
#if defined(_WIN32) && defined(burrlab_EXPORTS)
#define BURRLAB_FUNCTION(type) __declspec(dllexport) type BURRLAB_CALL
#elif defined(_WIN32) && defined(BURRLAB_SHARED)
#define BURRLAB_FUNCTION(type) __declspec(dllimport) type BURRLAB_CALL
#elif defined(BURRLAB_SHARED)
#define BURRLAB_FUNCTION(type) __attribute__((visibility("default"))) type BURRLAB_CALL
#else
#define BURRLAB_FUNCTION(type) type BURRLAB_CALL
#endif

#ifdef __cplusplus
extern "C" {
#endif

#define BURRLAB_ABI_VERSION 1 /* of this file; burrlab_abi_version() of the library must be the same */

typedef enum burrlab_status {
  BURRLAB_OK = 0,
  BURRLAB_REFUSED = 1, /* an argument breaks a rule, or another thread uses the bone */
  BURRLAB_SYSTEM = 2   /* the system refused: a file, or memory */
} burrlab_status;

typedef struct burrlab_bone burrlab_bone;
typedef struct burrlab_burr burrlab_burr;
typedef struct burrlab_view burrlab_view;

typedef struct burrlab_grid {
  uint32_t size;
  int32_t shape[3];  /* voxels (z, y, x) */
  double spacing[3]; /* (x, y, z) [mm] */
  double origin[3];  /* centre of voxel (0, 0, 0) [mm] */
} burrlab_grid;

typedef struct burrlab_burr_settings {
  uint32_t size;
  uint32_t index;        /* burrs of one bone have different ones */
  double radius;         /* [mm] */
  double c_e;            /* elastic constant, Eq. 3 [N/mm^2] */
  double alpha;          /* erosion rate at 1 N, Eq. 4 [1/ms] */
  double force_exponent; /* q of |F| = c_e R^2 (h/R)^q; 1.5 in Eq. 3 */
  double rate_exponent;  /* m of the rate alpha (|F|/1 N)^m; 0 in Eq. 4 */
  const char* shape;     /* f of Eq. 4, such as "parabolic" or "power(1.5)" */
  double
      to_bone[12]; /* rows of (A | t): bone [mm] = A host + t; A a rotation or mirror image, times a scale */
  double longest_tick; /* a longer step becomes several ticks of equal length [ms] */
  uint64_t seed;       /* of the random numbers */
  uint64_t tick;       /* number of the first tick: to go on from a state kept before */
} burrlab_burr_settings;

typedef struct burrlab_motion {
  uint32_t size;
  int32_t on;          /* 0: the burr feels and does not cut */
  double center[3];    /* of the burr at the step's end [host length]; it moves there in a straight line */
  double reference[3]; /* of the torque [host length] */
  double dt;           /* above 0, at most 1000; may differ from call to call [ms] */
} burrlab_motion;

typedef struct burrlab_feel {
  uint32_t size;
  int32_t touching;   /* there is bone inside the burr */
  double force[3];    /* on the burr, host's axes, before the last tick's erosion [N] */
  double torque[3];   /* (center - reference) x force [N host length] */
  double penetration; /* h of Eq. 2 [mm] */
  double removed;     /* solid bone, in this step [mm^3] */
  uint64_t tick;      /* number of the next tick */
} burrlab_feel;

typedef struct burrlab_changes {
  uint32_t size;
  uint32_t bricks;       /* cubes of 8^3 voxels that changed */
  const int64_t* places; /* first voxel (z, y, x) of each */
  const uint8_t* levels; /* 512 levels (z, y, x) of each, zeros beyond the bone */
  uint64_t opened;       /* voxels that fell below 128 from at least 128 */
  const int64_t* opened_voxels;
  uint64_t filled;              /* voxels that rose to at least 128, as after a reset */
  const int64_t* filled_voxels; /* (z, y, x) each */
} burrlab_changes;

BURRLAB_FUNCTION(uint32_t) burrlab_abi_version(void);
BURRLAB_FUNCTION(const char*) burrlab_version(void); /* as "0.3.0" */

/* A bone with these levels, or with solid voxels if `levels` is null. `count` is the number of levels. Null
 * if it cannot be made; then `error`, if it is not null, holds a sentence of at most error_size - 1 bytes. */
BURRLAB_FUNCTION(burrlab_bone*)
burrlab_bone_create(const burrlab_grid* grid, const uint8_t* levels, size_t count, char* error,
                    size_t error_size);
/* A bone from a flat file, as `burrlab export` writes it. */
BURRLAB_FUNCTION(burrlab_bone*) burrlab_bone_open(const char* path, char* error, size_t error_size);
BURRLAB_FUNCTION(void) burrlab_bone_destroy(burrlab_bone* bone);
BURRLAB_FUNCTION(const char*) burrlab_bone_error(const burrlab_bone* bone); /* of the last call that failed */
BURRLAB_FUNCTION(int) burrlab_bone_save(burrlab_bone* bone, const char* path); /* a flat file */
BURRLAB_FUNCTION(int) burrlab_bone_grid(burrlab_bone* bone, burrlab_grid* grid);
/* The present levels, or those at the beginning; `count` must be the number of voxels. */
BURRLAB_FUNCTION(int) burrlab_bone_read(burrlab_bone* bone, int pristine, uint8_t* levels, size_t count);
/* Present levels that were read before: an undo. Refused if one is above that at the beginning. */
BURRLAB_FUNCTION(int) burrlab_bone_restore(burrlab_bone* bone, const uint8_t* levels, size_t count);
BURRLAB_FUNCTION(int) burrlab_bone_reset(burrlab_bone* bone);                    /* as at the beginning */
BURRLAB_FUNCTION(int) burrlab_bone_removed(burrlab_bone* bone, double* removed); /* [mm^3] */
BURRLAB_FUNCTION(int) burrlab_bone_digest(burrlab_bone* bone, char digest[33]);  /* 32 digits and a zero */

/* Fills all but `size` and `radius`: constants of a material of the paper ("bone", "pettigrew", "pvc",
 * "expert"), a host in metres in the bone's axes, ticks of at most 1 ms. */
BURRLAB_FUNCTION(int) burrlab_burr_defaults(burrlab_burr_settings* settings, const char* material);
/* In a bone with tissues the constants are those of the tissues: c_e, alpha, exponents and shape here are not
 * read. Null if it cannot be made; the bone's error text says why. */
BURRLAB_FUNCTION(burrlab_burr*)
burrlab_burr_create(burrlab_bone* bone, const burrlab_burr_settings* settings);
BURRLAB_FUNCTION(void) burrlab_burr_destroy(burrlab_burr* burr);
BURRLAB_FUNCTION(const char*) burrlab_burr_error(const burrlab_burr* burr);
/* A step of the host. If it is refused, nothing has changed and the forces in `feel` are zero. */
BURRLAB_FUNCTION(int) burrlab_burr_step(burrlab_burr* burr, const burrlab_motion* motion, burrlab_feel* feel);
/* The next step begins at its own end, with this tick's number: after a jump, a reset or an undo. */
BURRLAB_FUNCTION(int) burrlab_burr_lift(burrlab_burr* burr, uint64_t tick);

/* A view of the bone's changes, made by the thread that has the bone's handle, also while a burr steps in
 * another. Then any thread may use it: no step waits or fails for it. Null if it cannot be made; the bone's
 * error text says why. */
BURRLAB_FUNCTION(burrlab_view*) burrlab_view_create(burrlab_bone* bone);
BURRLAB_FUNCTION(void) burrlab_view_destroy(burrlab_view* view);
BURRLAB_FUNCTION(const char*) burrlab_view_error(const burrlab_view* view);
/* What changed since the last call; at first all bricks that hold bone. Pointers are valid until the next. */
BURRLAB_FUNCTION(int) burrlab_view_update(burrlab_view* view, burrlab_changes* changes);

#ifdef __cplusplus
}
#endif

#endif /* BURRLAB_H */
