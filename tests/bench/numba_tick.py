"""The tick as a loop over the sphere compiled by Numba: a baseline of the benchmark, docs/tick.md to the bit.

Cubic voxels, f parabolic, scheme `layer`. Numbers called f32 on that page are `numpy.float32`, and literals combined with
them too.
"""

import math

import numpy as np
from numba import njit

f32 = np.float32
u64 = np.uint64

ZERO, HALF, ONE, TWO = f32(0), f32(0.5), f32(1), f32(2)
LEAST_W, MOST_E, MOST_TAU = f32(2.0**-20), f32(3 - 2.0**-22), f32(1 - 2.0**-24)

P_2, P_3, P_4 = f32(0.49999714), f32(0.16652727), f32(0.03972289)  # of the eroded fraction
LEVEL, DRAWS = f32(256), f32(65536)
WORD, LOW = u64(0xFFFFFFFF), u64(32)
MULTIPLIER_0, MULTIPLIER_1 = u64(0xD2511F53), u64(0xCD9E8D57)
WEYL_0, WEYL_1 = u64(0x9E3779B9), u64(0xBB67AE85)


@njit
def draw_block(column, tick, index, draw, seed, words):
    """Philox4x32-7: the eight 16-bit numbers of a column, in four words."""
    c0, c1, c2, c3 = u64(column), u64(tick) & WORD, u64(tick) >> LOW, u64(index) + (u64(draw) << u64(31))
    k0, k1 = u64(seed) & WORD, u64(seed) >> LOW
    for _ in range(7):
        product_0, product_1 = MULTIPLIER_0 * c0, MULTIPLIER_1 * c2
        c0, c1, c2, c3 = (
            (product_1 >> LOW) ^ c1 ^ k0,
            product_1 & WORD,
            (product_0 >> LOW) ^ c3 ^ k1,
            product_0 & WORD,
        )
        k0, k1 = (k0 + WEYL_0) & WORD, (k1 + WEYL_1) & WORD
    words[0], words[1], words[2], words[3] = c0, c1, c2, c3


@njit
def lane(words, y):
    return (np.int64(words[(y & 7) >> 1]) >> (16 * (y & 1))) & 0xFFFF


@njit
def effective_depth(table, e, tau):
    """G(e, tau), bilinear in its table."""
    te, tt = e * f32(8), tau * f32(40)
    i, j = min(int(te), 23), min(int(tt), 39)
    fe, ft = te - f32(i), tt - f32(j)
    lo = table[i, j] + (table[i, j + 1] - table[i, j]) * ft
    hi = table[i + 1, j] + (table[i + 1, j + 1] - table[i + 1, j]) * ft
    return lo + (hi - lo) * fe


@njit
def eroded_fraction(f, scale, doublings):
    """1 - exp(-a f) with a = scale 2^doublings."""
    y = scale * f
    fraction = y * (ONE - y * (P_2 - y * (P_3 - y * P_4)))
    for _ in range(doublings):
        fraction = fraction * (TWO - fraction)
    return fraction


@njit
def place(center, origin, spacing, extent, count):
    """Along one axis: nearest voxel, rest of the position, and the sphere's range of voxels."""
    c = (center - origin) / spacing
    base = np.rint(c)
    frac = np.rint((c - base) * 1048576.0) / 1048576.0
    begin = min(max(int(c - extent), 0), count)
    end = min(max(int(c + extent) + 1, 0), count)
    return int(base), frac, begin, end


@njit
def step(q, p, spacing, origin, radius, a, seed, index, tick, table, center):
    """One tick; erodes `q` in place.

    Parameters
    ----------
    q, p : ndarray of uint8, (nz, ny, nx)
        Present and pristine levels.
    spacing : float
        [mm]
    origin, center : (x, y, z)
        Centres of voxel (0, 0, 0) and of the burr [mm].
    radius : float
        [mm]
    a : float
        alpha dt [1].
    seed, index, tick : int
        `index` of the burr.
    table : ndarray of float32, (25, 41)
        Effective depth.

    Returns
    -------
    tuple of 5 int
        Mass [1/256 level], first moments (x, y, z) [1/256 level voxel], levels lost.
    """
    nz, ny, nx = q.shape
    groups = (ny + 7) // 8
    reach = radius + 0.501 * spacing  # beyond it no voxel is covered
    extent = reach / spacing + 1.0
    base_x, frac_x, begin_x, end_x = place(center[0], origin[0], spacing, extent, nx)
    base_y, frac_y, begin_y, end_y = place(center[1], origin[1], spacing, extent, ny)
    base_z, frac_z, begin_z, end_z = place(center[2], origin[2], spacing, extent, nz)
    fx, fy, fz = f32(frac_x), f32(frac_y), f32(frac_z)
    doublings = 0
    while a > 0.125:
        a *= 0.5
        doublings += 1
    scale = f32(a)
    R, s = f32(radius), f32(spacing)
    inv_R, inv_s = ONE / R, ONE / s
    inv_R2 = inv_R * inv_R
    deep = R - f32(3.5) * s
    deep2 = deep * deep

    columns = max(end_x - begin_x, 0)
    words = np.empty((columns, 4), dtype=np.uint32)
    drawn = np.empty(columns, dtype=np.bool_)
    second = np.empty(4, dtype=np.uint32)
    mass = first_x = first_y = first_z = lost = 0

    for z in range(begin_z, end_z):
        dz = (f32(z - base_z) - fz) * s
        for y in range(begin_y, end_y):
            if y & 7 == 0 or y == begin_y:
                drawn[:] = False
            dy = (f32(y - base_y) - fy) * s
            row2 = dz * dz + dy * dy
            chord2 = reach * reach - float(row2)
            if chord2 <= 0.0:
                continue
            half = math.sqrt(chord2) / spacing
            left = max(begin_x, math.ceil(base_x + frac_x - half))
            right = min(end_x, math.floor(base_x + frac_x + half) + 1)
            row_mass = 0
            for x in range(left, right):
                level = np.int64(q[z, y, x])
                if level == 0:
                    continue

                # Mass inside the sphere [1/256 level], and the erosion shape f where it lies.
                dx = (f32(x - base_x) - fx) * s
                r2 = row2 + dx * dx
                m = 256 * level
                f = ONE - r2 * inv_R2
                if r2 > deep2:
                    depth = R - math.sqrt(r2)
                    w = min(max(depth * inv_s + HALF, LEAST_W), ONE)
                    pristine = f32(p[z, y, x])
                    m -= int(pristine * ((ONE - w) * LEVEL) + HALF)
                    if m <= 0:
                        continue
                    tau = min((f32(m) * (ONE / (pristine * LEVEL))) / w, MOST_TAU)
                    e = min(max((depth * inv_s + HALF) - ONE, ZERO), MOST_E)
                    delta = (w * (s * inv_R)) * effective_depth(table, e, tau)
                    f = delta * (TWO - delta)
                row_mass += m
                first_x += m * (x - base_x)

                # The expected loss [2^-16 level], rounded up or down by the voxel's random number.
                expected = (f32(m) * LEVEL) * eroded_fraction(f, scale, doublings)
                whole = int(expected)
                column = (z * groups + (y >> 3)) * nx + x
                i = x - begin_x
                if not drawn[i]:
                    draw_block(column, tick, index, 0, seed, words[i])
                    drawn[i] = True
                total = whole + lane(words[i], y)
                loss = total >> 16
                if total & 0xFFFF == 0xFFFF:
                    lo = int((expected - f32(whole)) * DRAWS + HALF)
                    draw_block(column, tick, index, 1, seed, second)
                    loss += lane(second, y) < lo
                q[z, y, x] = level - loss
                lost += loss
            mass += row_mass
            first_y += row_mass * (y - base_y)
            first_z += row_mass * (z - base_z)
    return mass, first_x, first_y, first_z, lost
