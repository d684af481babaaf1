"""A short trace of a cut in a bone with two tissues, for tests of the view."""

import numpy as np
from PIL import Image
from session_scenes import make_records, record, small_bone

import burrlab


def carve(bone, *centers, radius=1.0, ticks=100, seed=1):
    """Bricks (z, y, x) changed by a burr that stands at each of `centers` [mm] for `ticks`."""
    before = bone.density.copy()
    contact = burrlab.BurrContact(bone, burrlab.Burr(radius), burrlab.materials["bone"], seed)
    contact.run(np.repeat(np.array(centers, float), ticks, axis=0), 1.0)
    return np.unique(np.argwhere(bone.density != before) // 8, axis=0)


def cortex_and_nerve(bone, is_nerve):
    """The bone with two tissues, (200, 190, 150) and (240, 220, 20)."""
    table = [
        burrlab.Tissue("cortex", label=1, c_e=2.1, alpha=0.1, colour=(200, 190, 150)),
        burrlab.Tissue("nerve", label=2, c_e=2.1, alpha=0.1, colour=(240, 220, 20), critical=True),
    ]
    bone.set_tissues(burrlab.Tissues(table, burrlab.materials["bone"]), is_nerve.astype(np.uint8))
    return bone


def parcels(count, seed=1):
    """Parcels as the effects give them, around the origin."""
    rng = np.random.default_rng(seed)
    made = np.zeros(
        count, [("position", "f8", 3), ("radius", "f8"), ("dust", "i8"), ("blood", "i8"), ("water", "i8")]
    )
    made["position"], made["radius"] = rng.normal(0, 1, (count, 3)), 0.1
    made["dust"] = 100
    return made


def write_trace(file, ticks=400):
    """Writes a trace; returns the bone's digest at its end."""
    bone = small_bone()
    record(file, make_records(bone, ticks))
    return bone.digest()


def read(path):
    """Pixels of a picture file, (height, width, 3)."""
    with Image.open(path) as picture:
        return np.asarray(picture.convert("RGB"))


def frames_in(path):
    """Number of pictures in a GIF."""
    with Image.open(path) as film:
        return film.n_frames
