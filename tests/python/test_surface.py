"""The surface in blocks: closed, without seams, and the same after an update as after a rebuild; its files, and
distances of two."""

import itertools

import numpy as np
import pytest
import scipy
from command_line import refusal, result
from session_scenes import refused
from view_scenes import carve, cortex_and_nerve, write_trace

import burrlab
from burrlab import closed_surface, surface_distance
from burrlab.view import surface
from burrlab.view.camera import Viewpoint
from burrlab.view.surface import (
    BLOCK,
    Surface,
    blocks_in_sight,
    blocks_of_bricks,
    brick_numbers,
    brick_places,
    enclosed_volume,
    surface_blocks,
    tissue_palette,
    write_surface,
)
from burrlab.volume import save_drilled

RADIUS, VOXEL, CENTER = 40.0, 0.1, (47.3, 46.1, 48.9)  # of a ball, (z, y, x), in voxels of 0.1 mm


def ball():
    z, y, x = np.indices((96, 96, 96))
    away = RADIUS - np.sqrt((z - CENTER[0]) ** 2 + (y - CENTER[1]) ** 2 + (x - CENTER[2]) ** 2)
    return burrlab.VoxelBone(np.rint(np.clip(away + 0.5, 0, 1) * 255).astype(np.uint8), VOXEL)


def noise(seed, shape=(40, 35, 66)):
    """Random levels, which give every kind of cell."""
    return np.random.default_rng(seed).integers(0, 256, shape).astype(np.uint8)


def test_what_bone_hides_is_not_in_sight():
    """A closed cell in the middle of a cube is hidden until a shaft from above opens it."""
    levels = np.full((160, 160, 160), 255, np.uint8)
    levels[70:90, 70:90, 70:90] = 0
    view = Viewpoint((7.95, 7.95, 60.0), (7.95, 7.95, 15.0), (0.0, 1.0, 0.0))

    def seen():
        blocks = surface_blocks(burrlab.VoxelBone(levels, 0.1))
        return blocks, blocks_in_sight(blocks, view, (320, 240), 0.1)

    blocks, sight = seen()
    assert {(2, 2, 2), (0, 2, 2)} <= blocks.keys()  # the cell, and the face below
    assert sight == {block for block in blocks if block[0] == 4}
    levels[90:, 75:85, 75:85] = 0
    assert {(2, 2, 2), (4, 2, 2)} <= seen()[1]
    assert (0, 2, 2) not in seen()[1]


def joined(mesh):
    """The different vertices, and triangles of their numbers."""
    unique, number = np.unique(mesh.points, axis=0, return_inverse=True)
    return unique, number.reshape(-1)[mesh.triangles]


def assert_manifold(vertices, faces):
    """Every edge is used once each way, and the triangles about a vertex are one fan."""
    assert len(np.unique(vertices, axis=0)) == len(vertices) == len(np.unique(faces))
    start, end = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64).T
    forth, back = start << 32 | end, end << 32 | start
    order = np.argsort(forth)
    np.testing.assert_array_equal(forth[order], np.unique(back))
    across = order[np.searchsorted(forth[order], back)]  # the same edge in the other triangle
    corner = np.arange(len(start))  # where an edge starts; the other triangle's next edge starts there, too
    following = (across + len(faces)) % len(start)
    graph = scipy.sparse.coo_array((np.ones(len(start)), (corner, following)), shape=(len(start),) * 2)
    assert scipy.sparse.csgraph.connected_components(graph)[0] == len(vertices)


def assert_equal_blocks(some, others):
    assert some.keys() == others.keys()
    for block, one in some.items():
        for name in ("points", "normals", "triangles", "tissues", "lost", "numbers"):
            np.testing.assert_array_equal(
                getattr(one, name), getattr(others[block], name), err_msg=str(block)
            )


def test_a_ball_is_closed_with_its_area_and_volume():
    mesh = Surface(ball()).merged()
    vertices, triangles = joined(mesh)
    assert_manifold(vertices, triangles)  # also across the borders of 27 blocks
    assert len(vertices) - len(triangles) / 2 == 2  # Euler characteristic of a sphere, 3/2 edges a triangle
    points = mesh.points.astype(float)
    a, b, c = (points[mesh.triangles[:, i]] for i in range(3))
    cross = np.cross(b - a, c - a)
    r = RADIUS * VOXEL
    assert np.linalg.norm(cross, axis=1).sum() / 2 == pytest.approx(4 * np.pi * r**2, rel=0.01)
    assert np.einsum("ij,ij", a, cross) / 6 == pytest.approx(4 / 3 * np.pi * r**3, rel=0.005)


def test_vertices_and_normals_of_a_ball_are_right():
    """Voxels have equal and unequal sides."""
    z, y, x = np.indices((40, 80, 80))
    away = np.sqrt(((x - 40) * 0.1) ** 2 + ((y - 40) * 0.1) ** 2 + ((z - 20) * 0.2) ** 2) - 3.0  # [mm]
    levels = np.rint(np.clip(0.5 - away / 0.2, 0, 1) * 255).astype(np.uint8)
    unequal = burrlab.VoxelBone(levels, (0.1, 0.1, 0.2), (1.0, 2.0, 3.0))
    for bone, center, radius, apart, angle in (
        (ball(), VOXEL * np.array(CENTER[::-1]), RADIUS * VOXEL, 0.5 * VOXEL, 5),
        (unequal, np.array([5.0, 6.0, 7.0]), 3.0, 0.1, 8),
    ):
        mesh = Surface(bone).merged()
        out = mesh.points - center
        length = np.linalg.norm(out, axis=1)
        assert np.abs(length - radius).max() < apart
        assert ((out / length[:, None]) * mesh.normals).sum(axis=1).min() > np.cos(np.deg2rad(angle))
        np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-6)


@pytest.mark.parametrize("make", [ball, lambda: burrlab.VoxelBone(noise(1), 0.1)])
def test_neighbours_share_vertices_and_normals_to_the_bit(make):
    blocks = surface_blocks(make())
    points, normals = (
        np.concatenate([getattr(b, name) for b in blocks.values()]) for name in ("points", "normals")
    )
    different, uses = np.unique(points, axis=0, return_counts=True)
    assert (uses > 1).sum() > 500
    assert len(np.unique(np.hstack([points, normals]), axis=0)) == len(different)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_an_update_equals_a_rebuild(seed):
    rng = np.random.default_rng(seed)
    bone = burrlab.VoxelBone.block((10, 7, 9), 0.1)
    surface = Surface(bone)
    for _ in range(4):
        changed = carve(bone, *rng.uniform([0, 0, 0], [10, 7, 9], (3, 3)), radius=1.5, ticks=20, seed=seed)
        assert len(changed)
        assert set(surface.update(bone, changed)) <= set(blocks_of_bricks(changed, bone))
        assert_equal_blocks(surface.blocks, surface_blocks(bone))


def test_blocks_that_were_not_touched_are_not_made_again():
    bone = burrlab.VoxelBone.block((9.6, 9.6, 9.6), 0.1)
    surface = Surface(bone)
    before = dict(surface.blocks)
    assert surface.update(bone, [[5, 5, 5]]) == []  # the second block is full and has no surface
    assert surface.update(bone, [[0, 0, 0]]) == [(0, 0, 0)]
    assert {block for block in before if surface.blocks[block] is not before[block]} == {(0, 0, 0)}


def test_removed_bone_leaves_no_block():
    surface = Surface(burrlab.VoxelBone.block((3.2, 3.2, 3.2), 0.1))
    gone = burrlab.VoxelBone(np.zeros((32, 32, 32), np.uint8), 0.1)
    assert (surface.update(gone, [[1, 1, 1]]), surface.blocks) == ([(0, 0, 0)], {})
    merged = surface.merged()
    assert len(merged.points) == len(merged.triangles) == 0


@pytest.mark.parametrize("full", [0, 255])
def test_full_and_empty_blocks_are_left_out(full):
    blocks = surface_blocks(burrlab.VoxelBone(np.full((96, 96, 96), full, np.uint8), 0.1))
    assert (1, 1, 1) not in blocks
    assert len(blocks) == (26 if full else 0)


@pytest.mark.parametrize(
    ("brick", "blocks"),
    [
        ((1, 1, 1), {(0, 0, 0)}),
        ((5, 5, 5), {(1, 1, 1)}),
        ((3, 1, 1), {(0, 0, 0), (1, 0, 0)}),
        ((4, 1, 1), {(0, 0, 0), (1, 0, 0)}),
        ((4, 3, 5), {(0, 0, 1), (0, 1, 1), (1, 0, 1), (1, 1, 1)}),
        ((3, 4, 3), set(itertools.product((0, 1), repeat=3))),
        ((11, 11, 11), {(2, 2, 2)}),
    ],
)
def test_blocks_of_a_brick(brick, blocks):
    bone = burrlab.VoxelBone.block((9.6, 9.6, 9.6), 0.1)
    assert set(blocks_of_bricks([brick], bone)) == blocks
    assert set(blocks_of_bricks(brick_numbers([brick], bone), bone)) == blocks


def test_a_voxel_changes_only_the_blocks_of_its_brick():
    """Voxels near borders of blocks may change several."""
    levels = noise(3, (72, 40, 40))
    bone = burrlab.VoxelBone(levels, 0.1)
    before = surface_blocks(bone)
    rng = np.random.default_rng(4)
    found = set()
    near_borders = np.array([*range(24, 40), *range(56, 72)])
    for _ in range(20):
        z, y, x = (int(rng.choice(near_borders[near_borders < n])) for n in levels.shape)
        changed = levels.copy()
        changed[z, y, x] ^= 255
        after = surface_blocks(burrlab.VoxelBone(changed, 0.1))
        differ = {
            block
            for block in before.keys() | after.keys()
            if not (
                block in before
                and block in after
                and np.array_equal(before[block].points, after[block].points)
                and np.array_equal(before[block].normals, after[block].normals)
            )
        }
        assert differ <= set(blocks_of_bricks([[z // 8, y // 8, x // 8]], bone))
        found |= differ
    assert len(found) > 4


def test_brick_numbers_match_the_core():
    bone = burrlab.VoxelBone.block((2.9, 4.1, 1.7), 0.1)
    levels = bone.density.copy()
    numbers = np.arange(np.prod([-(-n // 8) for n in bone.shape]))
    places = brick_places(numbers, bone)
    np.testing.assert_array_equal(brick_numbers(places, bone), numbers)
    np.testing.assert_array_equal(brick_numbers(numbers, bone), numbers)
    z, y, x = places[17] * 8
    kept = burrlab._core.read_bricks(bone, np.array([17], np.uint32))
    box = levels[z : z + 8, y : y + 8, x : x + 8]
    np.testing.assert_array_equal(kept.reshape(8, 8, 8)[: box.shape[0], : box.shape[1], : box.shape[2]], box)
    assert brick_places([], bone).shape == (0, 3)


def test_a_cut_is_lighter_and_tissues_have_their_colours():
    is_nerve = np.zeros((40, 40, 40), bool)
    is_nerve[:, :, 20:] = True
    bone = cortex_and_nerve(burrlab.VoxelBone.block((4, 4, 4), 0.1), is_nerve)
    palette = tissue_palette(bone)
    np.testing.assert_array_equal(palette, [(200, 190, 150), (240, 220, 20)])
    mesh = Surface(bone).merged()
    assert mesh.lost.max() == 0
    right = mesh.points[:, 0] > 2.0
    np.testing.assert_array_equal(mesh.tissues, right)
    np.testing.assert_array_equal(mesh.colours(palette)[right], np.tile(palette[1], (right.sum(), 1)))
    carve(bone, (2.0, 2.0, 4.0))
    mesh = Surface(bone).merged()
    cut = mesh.lost > 200
    assert cut.sum() > 100
    assert np.linalg.norm(mesh.points[cut] - [2.0, 2.0, 4.0], axis=1).max() < 1.3
    assert (mesh.colours(palette)[cut, 2] > palette[mesh.tissues[cut], 2]).all()


def test_levels_move_the_surface():
    levels = np.zeros((16, 16, 16), np.uint8)
    levels[:8], levels[8] = 255, 100
    bone = burrlab.VoxelBone(levels, 0.1)
    top = [Surface(bone, level=level).merged().points[:, 2].max() for level in (50, 100, 128)]
    assert top[0] > top[1] > 0.8 > top[2] > 0.7


@pytest.mark.parametrize("level", [30, 100, 128, 220])
def test_cells_of_every_kind_make_a_manifold(level):
    """Also at the borders of blocks, on all axes, and of the volume."""
    bone = burrlab.VoxelBone(noise(level, (36, 35, 40)), (0.1, 0.2, 0.3))
    assert_manifold(*closed_surface(bone, left=True, level=level))


def drilled(radius=1.5, spacing=(0.1, 0.1, 0.2), origin=(-200.0, 30.0, 5.0)):
    """A block drilled into an edge, near another one, and to one voxel's depth."""
    bone = burrlab.VoxelBone.block((6, 6, 6), spacing, origin=origin)
    carve(bone, *(np.array([[0, 3, 6], [4, 4, 5], [3, 1, 6.9]]) + origin), radius=radius, ticks=300)
    return bone


@pytest.mark.parametrize("left", [False, True])
def test_a_cavity_is_closed_and_holds_what_was_removed(left):
    bone = drilled()
    vertices, faces = closed_surface(bone, left=left)
    assert_manifold(vertices, faces)
    volume, box = bone.mass if left else bone.removed, np.array(bone.origin) - [0.05, 0.05, 0.1]
    assert enclosed_volume(vertices, faces) == pytest.approx(volume, rel=0.01)
    np.testing.assert_allclose(vertices.min(axis=0)[0], box[0], atol=0.01)  # the volume's border
    assert (vertices > box - 0.01).all()
    assert (vertices < box + 6.01).all()


def read_triangles(path):
    """Corners of the triangles of a binary STL or PLY file, (t, 3, 3)."""
    content = path.read_bytes()
    if path.suffix == ".stl":
        (count,) = np.frombuffer(content, "<u4", 1, 80)
        return np.frombuffer(content, [("n", "<f4", 3), ("at", "<f4", (3, 3)), ("_", "<u2")], count, 84)["at"]
    head, _, body = content.partition(b"end_header\n")
    count, faces = (
        int(line.split()[-1]) for line in head.decode().splitlines() if line.startswith("element")
    )
    rows = np.frombuffer(body, [("n", "u1"), ("at", "<i4", 3)], faces, 24 * count)
    return np.frombuffer(body, "<f8", 3 * count).reshape(-1, 3)[rows["at"]]


@pytest.mark.parametrize("ending", [".stl", ".ply"])
def test_a_cavity_is_exported(tmp_path, capsys, ending):
    """Of a bone, a trace, and a half-drilled volume with turned, left-handed axes."""
    bone, mapping = drilled(), burrlab.OccupancyMap.two_point(0, 1000)
    burrlab.save_bone(tmp_path / "bone.h5", bone)
    write_trace(tmp_path / "trace.h5")
    turn = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    greys = np.full(bone.shape, 1000, np.int16)
    like = burrlab.Volume(greys, bone.spacing, turn @ bone.origin, turn, "made here")
    burrlab.write_volume(tmp_path / "like.nrrd", like)
    save_drilled(tmp_path / "kept.nrrd", bone, burrlab.read_volume(tmp_path / "like.nrrd"), mapping=mapping)
    exported = {}
    for name in ("bone.h5", "trace.h5", "kept.nrrd"):
        out = tmp_path / f"{name}{ending}"
        written = result(capsys, "export", tmp_path / name, "--out", out)
        assert written["volume_mm3"] == pytest.approx(written["voxels_mm3"], rel=0.01)
        corners = exported[name] = read_triangles(out).astype(float)
        points, faces = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
        assert_manifold(points, faces.reshape(-1, 3))
        assert enclosed_volume(points, faces.reshape(-1, 3)) == pytest.approx(written["volume_mm3"], rel=1e-3)
    vertices, faces = closed_surface(bone)
    np.testing.assert_allclose(exported["bone.h5"], vertices[faces], atol=1e-4)
    np.testing.assert_allclose(exported["kept.nrrd"], (vertices @ turn.T)[faces[:, ::-1]], atol=1e-4)


def test_exports_that_are_refused(tmp_path, capsys):
    burrlab.save_bone(tmp_path / "whole.h5", burrlab.VoxelBone.block((2, 2, 2), 0.1))
    (tmp_path / "old.stl").touch()
    for out, options, words in (
        ("new", (), "--out must end in .hdf5, .stl, .ply, .burr, .csv, got"),
        ("old.stl", (), "--out must be a new file"),
        ("new.stl", (), "bone has no voxel that lost 1 of 255 levels"),
        ("new.stl", ("--burr", "0"), "--burr goes with --out FILE.hdf5"),
        ("new.hdf5", ("--left",), "--left goes with --out FILE.stl and FILE.ply"),
    ):
        assert words in refusal(capsys, "export", tmp_path / "whole.h5", "--out", tmp_path / out, *options)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["old.stl", "whole.h5"]


def box(low, high):
    """The 12 triangles of a box."""
    corners = np.array(list(itertools.product(*zip(low, high, strict=True))), float)
    return corners, np.array(scipy.spatial.ConvexHull(corners).simplices)


def test_distances_are_exact():
    """Of a cube and itself half a side farther: on average (1/2 + 1/6 + 4/8) / 6."""
    cubes = box((0, 0, 0), (1, 1, 1)), box((0.5, 0, 0), (1.5, 1, 1))
    assert surface_distance(*cubes) == pytest.approx((7 / 36, 0.5, 0.5), rel=1e-3)
    # a large sheet is nearer than the 12 triangles of a speck above it, whose middles are nearer
    sheet, speck = box((-5, -5, -1e-9), (5, 5, 0)), box((0, 0, 0.8), (0.01, 0.01, 0.81))
    both = np.concatenate([sheet[0], speck[0]]), np.concatenate([sheet[1], speck[1] + 8])
    y, x = np.indices((41, 41)).reshape(2, -1)
    squares = np.arange(41 * 40).reshape(40, 41)[:, :40].reshape(-1, 1)
    cover = (
        np.stack([x / 4 - 5, y / 4 - 5, np.full(41 * 41, 0.3)], 1),
        np.concatenate([squares + [0, 1, 42], squares + [0, 42, 41]]),
    )
    assert surface_distance(both, cover) == pytest.approx((0.3, 0.3, 0.51), abs=1e-6)


def test_distances_of_bones():
    """Of burrs of which one is larger by 0.1 mm."""
    a, b = drilled(), drilled(radius=1.6)
    there, back, none = (surface_distance(*two) for two in ((a, b), (b, a), (a, a.copy())))
    assert there == pytest.approx(back, rel=1e-12)
    assert none == pytest.approx((0, 0, 0), abs=1e-12)
    assert 0.05 < there[0] < 0.1


def test_distances_of_far_surfaces(monkeypatch):
    """In another frame by mistake: few triangles are looked at, not all of them, which took minutes."""
    looked_at, to_triangles = [], surface._to_triangles

    def counted(points, corners):
        looked_at.append(corners.size / 9)
        return to_triangles(points, corners)

    monkeypatch.setattr(surface, "_to_triangles", counted)
    vertices, faces = closed_surface(burrlab.VoxelBone.block((2, 2, 2), 0.1), left=True)
    distances = surface_distance((vertices, faces), (vertices + [0, 0, 20], faces))
    assert distances[1:] == pytest.approx((20, 20))
    assert sum(looked_at) < 200 * 40_000 < len(faces) * 40_000


def test_refused():
    bone = burrlab.VoxelBone.block((2, 2, 2), 0.1)
    gone, cube = burrlab.VoxelBone(np.zeros((4, 4, 4), np.uint8), 0.1), box((0, 0, 0), (1, 1, 1))
    larger = burrlab.VoxelBone.block((2, 2, BLOCK * 0.1 + 2), 0.1)
    refused(
        (lambda: Surface(bone, level=0), "level must be from 1 to 255, got 0"),
        (lambda: Surface(bone, level=256), "level must be from 1 to 255, got 256"),
        (
            lambda: surface_blocks(bone, [(0, 0, 1)]),
            "every index of a block must be from 0 to below 1, got 1",
        ),
        (lambda: brick_places([3, 27], bone), "bricks must be from 0 to below 27, got 3 to 27"),
        (
            lambda: brick_places([[1, 2]], bone),
            r"bricks must have the shape \(n,\) or \(n, 3\), got \(1, 2\)",
        ),
        (lambda: blocks_of_bricks([[0, 0, 3]], bone), r"bricks must lie within \(3, 3, 3\)"),
        (lambda: Surface(bone).update(larger, []), "bone must have the shape of the surface"),
        (lambda: closed_surface(bone), "no voxel that lost 1 of 255 levels; left=True"),
        (lambda: closed_surface(gone, left=True), "no voxel that has 1 of 255 levels$"),
        (lambda: closed_surface(bone, left=True, level=0), "level must be from 1 to 255, got 0"),
        (
            lambda: closed_surface(drilled(), level=256),
            "bone has no voxel that lost 256 of 255 levels$",
        ),
        (lambda: write_surface("far.stl", cube[0] * 1e-3 + 1e6, cube[1]), "STL cannot hold a surface so far"),
        *(
            (lambda mesh=mesh: surface_distance(cube, mesh), "b must be a bone, or finite vertices")
            for mesh in ((cube[0][:7], cube[1]), (cube[0] * np.nan, cube[1]), (cube[0] * 0, cube[1]))
        ),
    )
