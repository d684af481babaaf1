"""A short trace of a cut in a bone with two tissues, for tests of the view."""

from __future__ import annotations

import numpy as np
from PIL import Image
from session_scenes import SEED, FakeReader, make_records, small_bone, tools

import burrlab


def parcels(count, seed=1):
    """As the effects give them, around the origin."""
    rng = np.random.default_rng(seed)
    made = np.zeros(
        count, [("position", "f8", 3), ("radius", "f8"), ("dust", "i8"), ("blood", "i8"), ("water", "i8")]
    )
    made["position"], made["radius"] = rng.normal(0, 1, (count, 3)), 0.1
    made["dust"] = 100
    return made


def write_trace(file, ticks=400):
    """Writes it; returns its digest at the end."""
    bone = small_bone()
    records = make_records(bone, ticks, burrs=1)
    writer = burrlab.TraceWriter(file, FakeReader(records), small_bone(), tools(1), seed=SEED)
    writer.stop()
    return bone.digest()


def read(path):
    """Pixels of a picture file, (height, width, 3)."""
    with Image.open(path) as picture:
        return np.asarray(picture.convert("RGB"))


def frames_in(path):
    """Pictures in a GIF."""
    with Image.open(path) as film:
        return film.n_frames
