"""The tick in whole arrays over the sphere's box: a baseline of the benchmark, docs/tick.md to the bit.

Cubic voxels, f parabolic. A first step selects voxels that hold bone inside the sphere; expensive work is for
these alone, in part by functions of the reference, which take arrays of any shape.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from reference.tick import bilinear, eroded_fraction, philox4x32

f32 = np.float32
Float = NDArray[np.float32]
Integer = NDArray[np.int64]
Levels = NDArray[np.uint8]

ZERO, HALF, ONE, TWO = f32(0), f32(0.5), f32(1), f32(2)
LEAST_W, MOST_E, MOST_TAU = f32(2.0**-20), f32(3 - 2.0**-22), f32(1 - 2.0**-24)
WORD = 0xFFFFFFFF


def mass_and_shape(
    level: Integer, pristine: Levels, r2: Float, radius: float, spacing: float, layer: bool, table: Float
) -> tuple[Integer, Float]:
    """M [1/256 level] of every voxel, and the erosion shape f at that mass."""
    R, s = f32(radius), f32(spacing)
    inv_R, inv_s = ONE / R, ONE / s
    inv_R2 = inv_R * inv_R
    deep = R - f32(3.5) * s
    mass, f = 256 * level, ONE - r2 * inv_R2
    rim = np.flatnonzero(r2 > deep * deep)
    depth = R - np.sqrt(r2[rim])
    w = np.clip(depth * inv_s + HALF, LEAST_W, ONE)
    if not layer:
        mass[rim] = (level[rim].astype(f32) * (w * f32(256)) + HALF).astype(np.int64)
        f[r2 * inv_R2 > ONE] = ZERO
        return mass, f
    p = pristine[rim].astype(f32)
    m = np.maximum(mass[rim] - (p * ((ONE - w) * f32(256)) + HALF).astype(np.int64), 0)
    mass[rim] = m
    held = np.flatnonzero(m)
    rim, depth, w, p, m = rim[held], depth[held], w[held], p[held], m[held]
    tau = np.minimum((m.astype(f32) * (ONE / (p * f32(256)))) / w, MOST_TAU)
    e = np.clip((depth * inv_s + HALF) - ONE, ZERO, MOST_E)
    delta = (w * (s * inv_R)) * bilinear(table, e, tau)
    f[rim] = delta * (TWO - delta)
    return mass, f


def draw_lanes(
    z: Integer, y: Integer, x: Integer, shape: tuple[int, ...], tick: int, index: int, draw: int, seed: int
) -> NDArray[np.uint32]:
    """The 16-bit random number of every voxel (z, y, x); a block is drawn once for all of its column."""
    if z.size == 0:
        return np.empty(0, dtype=np.uint32)
    _, ny, nx = shape
    group = y >> 3
    z0, g0, x0 = (int(i.min()) for i in (z, group, x))
    size = (int(z.max()) + 1 - z0, int(group.max()) + 1 - g0, int(x.max()) + 1 - x0)
    held = np.zeros(size, dtype=bool)
    held[z - z0, group - g0, x - x0] = True
    zs, gs, xs = np.nonzero(held)
    column = ((zs + z0) * ((ny + 7) // 8) + gs + g0) * nx + xs + x0
    counter, key = (column, tick & WORD, tick >> 32, index + (draw << 31)), (seed & WORD, seed >> 32)
    words = np.zeros((*size, 4), dtype=np.uint32)
    words[held] = np.stack(philox4x32(counter, key), axis=-1)
    lane = y & 7
    word = words[z - z0, group - g0, x - x0, lane >> 1]
    return (word >> (16 * (lane & 1)).astype(np.uint32)) & np.uint32(0xFFFF)


def select(
    q: Levels,
    spacing: float,
    origin: tuple[float, float, float],
    radius: float,
    center: tuple[float, float, float],
) -> tuple[list[int], list[Integer], Float]:
    """Voxels with bone within the sphere's reach: base (x, y, z), indices (z, y, x) and r^2 [mm^2]."""
    reach = radius + 0.501 * spacing  # beyond it no voxel is covered
    base, offset, box = [], [], []
    for axis in range(3):
        c = (center[axis] - origin[axis]) / spacing
        whole = np.rint(c)
        frac = np.rint((c - whole) * 2.0**20) / 2.0**20
        extent, count = reach / spacing + 1.0, q.shape[2 - axis]
        begin, end = (min(max(int(limit), 0), count) for limit in (c - extent, c + extent + 1.0))
        base.append(int(whole))
        box.append(slice(begin, end))
        offset.append(
            (np.arange(begin - int(whole), end - int(whole)).astype(f32) - f32(frac)) * f32(spacing)
        )
    dx, dy, dz = offset
    r2 = ((dz * dz)[:, None] + dy * dy)[:, :, None] + dx * dx
    local = np.nonzero((q[box[2], box[1], box[0]] > 0) & (r2 < f32(reach * reach)))
    return base, [i + side.start for i, side in zip(local, reversed(box), strict=True)], r2[local]


def step(
    q: Levels,
    p: Levels,
    spacing: float,
    origin: tuple[float, float, float],
    radius: float,
    layer: bool,
    a: float,
    seed: int,
    index: int,
    tick: int,
    table: Float,
    center: tuple[float, float, float],
) -> tuple[int, int, int, int, int]:
    """One tick; erodes `q` in place. Parameters and result as for `numba_tick.step`."""
    base, (z, y, x), r2 = select(q, spacing, origin, radius, center)
    level = q[z, y, x].astype(np.int64)
    mass, f = mass_and_shape(level, p[z, y, x], r2, radius, spacing, layer, table)
    held = np.flatnonzero(mass)
    z, y, x, mass, level, f = z[held], y[held], x[held], mass[held], level[held], f[held]
    first = [int(mass @ (i - b)) for i, b in zip((x, y, z), base, strict=True)]

    eroding = mass if layer else 256 * level
    expected = (eroding.astype(f32) * f32(256)) * eroded_fraction(f, a)
    whole = expected.astype(np.int64)
    total = whole + draw_lanes(z, y, x, q.shape, tick, index, 0, seed)
    loss = total >> 16
    tie = np.flatnonzero(total & 0xFFFF == 0xFFFF)
    lo = ((expected[tie] - whole[tie].astype(f32)) * f32(65536) + HALF).astype(np.int64)
    loss[tie] += draw_lanes(z[tie], y[tie], x[tie], q.shape, tick, index, 1, seed) < lo
    q[z, y, x] = (level - loss).astype(np.uint8)
    return int(mass.sum()), first[0], first[1], first[2], int(loss.sum())
