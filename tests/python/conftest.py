"""What the tests share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

import burrlab

ROOT = Path(__file__).parents[2]


@pytest.fixture
def burr():
    return burrlab.Burr(3.0)


@pytest.fixture
def bone():
    return burrlab.materials["bone"]


@pytest.fixture
def shared_data():
    """Folder of the local test data, which is no part of the project; skips without it."""
    folder = Path(os.environ.get("BURRLAB_SHARED", ROOT.parent / "shared")) / "data"
    if not folder.is_dir():
        pytest.skip(f"local test data is not here: {folder} (set BURRLAB_SHARED)")
    return folder
