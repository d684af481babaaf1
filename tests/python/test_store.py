"""Results on disk: keys, exact round trips, torn lines, simultaneous writers."""

import functools
import math
import os
import subprocess
import sys
from dataclasses import dataclass, field, make_dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from session_scenes import refused

import burrlab
from burrlab.common.study import _HEADER, LATER, Store, _name, key_of
from burrlab.descent.sweep import SweepItem, run_item
from burrlab.fitting import bootstrap, calibration, group_effects, observations, profile


@dataclass(frozen=True)
class Item:
    number: float
    parts: tuple = ()
    note: str = field(default="", compare=False)
    later: float = field(default=1.5, metadata=LATER)


ITEM = SweepItem(
    burrlab.Burr(3.0), burrlab.materials["bone"], 1.0, 7, 0.2, 1.0, "layer", True, None, None, 120.0
)


def same(a, b):
    """Whether two results have the same types and are equal to the bit, but for the bits of a NaN."""
    if isinstance(a, np.ndarray | np.generic):
        return (type(a), a.dtype, a.shape, a.tobytes()) == (type(b), b.dtype, b.shape, b.tobytes())
    return repr(a) == repr(b)  # it tells types and -0.0 apart, and floats to the bit


def through(folder, value):
    path = folder / f"{len(list(folder.iterdir()))}.jsonl"
    Store(path).add("a", value)
    return Store(path).get("a")


CHANGES = {
    "burr": burrlab.Burr(math.nextafter(3.0, 4.0)), "force": math.nextafter(1.0, 2.0), "seed": 8, "voxel": (0.2, 0.2, 0.2),
    "dt": 0.5, "scheme": "cell", "ideal": False, "stop": 1.0, "max_duration": 121.0,
}  # fmt: skip
LAWS = ({"shape": "linear"}, {"force_exponent": 2.0}, {"rate_exponent": 0.5})
MATERIALS = [
    burrlab.Material("bone", c_e=2.145, alpha=0.087, source=ITEM.material.source, **law) for law in LAWS
]


@pytest.mark.parametrize(("name", "change"), [*CHANGES.items(), *(("material", m) for m in MATERIALS)])
def test_every_parameter_of_a_descent_is_in_its_key(name, change):
    assert key_of(run_item, replace(ITEM, **{name: change})) != key_of(run_item, ITEM)


def test_a_key_says_function_item_and_version(monkeypatch):
    key = key_of(run_item, ITEM)
    assert key_of(burrlab.descend, ITEM) != key == key_of(run_item, replace(ITEM)), "equal items, equal keys"
    monkeypatch.setattr("burrlab.common.study.SAME_NUMBERS_SINCE", "0.0.0")
    assert key != key_of(run_item, ITEM)


def test_names_in_the_keys_of_a_bootstrap_stay():
    assert [
        _name(kind).removeprefix("burrlab.fitting.")
        for kind in (
            bootstrap.BootstrapItem, bootstrap.MixedItem, calibration.MixedCalibration, group_effects.MixedEffect,
            group_effects.MixedEvidence, observations.Box, observations.Group, observations.Observations, profile.ConfidenceInterval,
        )
    ] == [
        "bootstrap.BootstrapItem", "bootstrap.MixedItem", "calibration.MixedCalibration", "mixed.MixedEffect",
        "mixed.MixedEvidence", "observations.Box", "observations.Group", "observations.Observations", "profile.Interval",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (0.1, math.nextafter(0.1, 1)), (0.0, -0.0), (1, 1.0), (1, True), (1, "1"), ((1, 2), ((1, 2),)), ((), None),
        (np.zeros(2), np.zeros((2, 1))), (np.zeros(2), np.zeros(2, np.float32)), (np.array([1]), np.array([2])),
        ({"a": 1}, {"b": 1}), (Item(1.0), (1.0,)), (Item(1.0), Item(1.0, later=2.0)), (float("nan"), float("inf")), ("x", ["x"]),
    ],
)  # fmt: skip
def test_what_differs_has_another_key(one, other):
    assert key_of(run_item, one) != key_of(run_item, other)


def test_what_is_the_same_has_the_same_key():
    assert key_of(run_item, {"a": 1, "b": 2}) == key_of(run_item, {"b": 2, "a": 1})
    assert key_of(run_item, np.float64(0.1)) == key_of(run_item, 0.1)
    assert key_of(run_item, Item(1.0, note="x")) == key_of(run_item, Item(1.0, note="y")), "not compared"
    earlier = make_dataclass("Item", [("number", float), ("parts", tuple, ())], frozen=True)
    earlier.__module__ = Item.__module__
    assert key_of(run_item, Item(1.0)) == key_of(run_item, earlier(1.0)), "a field of later, at its default"
    bone = burrlab.VoxelBone.block((1, 1, 1), 0.1)
    assert (
        key_of(run_item, burrlab.VoxelBone.block((1, 1, 1), 0.1, level=254))
        != key_of(run_item, bone)
        == key_of(run_item, bone.copy())
    )


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.lists(inner, max_size=3).map(tuple)
        | st.dictionaries(st.text(), inner, max_size=3)
    ),
    max_leaves=8,
)


@settings(max_examples=100, deadline=None)
@given(value=VALUES)
def test_results_come_back_to_the_bit(tmp_path_factory, value):
    assert same(through(tmp_path_factory.mktemp("s"), value), value)


@pytest.mark.parametrize(
    "value",
    [
        np.array([0.1, np.nan, -np.inf, -0.0]), np.zeros((2, 0, 3), np.int8), np.array(3.5), np.arange(6).reshape(2, 3).T,
        np.float32(0.1), np.bool_(True), np.int64(-(2**63)), np.array([1 + 2j]), {"tuple": ({"float": [float("nan")]},)},
    ],
)  # fmt: skip
def test_arrays_and_awkward_results_come_back(tmp_path, value):
    assert same(through(tmp_path, value), value)


def test_a_result_handed_out_can_be_changed(tmp_path):
    store = Store(tmp_path / "s.jsonl")
    store.add("a", np.zeros(3))
    store.get("a")[:] = 1
    assert not store.get("a").any()


@pytest.mark.parametrize(
    ("call", "told"),
    [
        *((lambda store, v=value: store.add("a", v), "a result that is stored must be made of None, bool")
          for value in ({1: 2}, {1, 2}, b"x", Item(1.0), np.array([None]), np.array(["x"]), object(), 1 + 2j, [lambda: 1])),
        *((lambda _, i=item: key_of(run_item, i), "item must be made of None, bool")
          for item in ({1: 2}, b"x", object(), np.array([None]), (1, {2}), Item)),
        *((lambda _, f=function: key_of(f, 1), "function must be one of a module")
          for function in (lambda x: x, functools.partial(round, ndigits=2))),
    ],
)  # fmt: skip
def test_other_types_are_refused(tmp_path, call, told):
    store = Store(tmp_path / "s.jsonl")
    refused((lambda: call(store), told, TypeError))
    assert len(Store(store.path)) == 0


def test_a_store_is_appended_to(tmp_path):
    path = tmp_path / "s.jsonl"
    store = Store(path)
    store.add("a", 1)
    store.add("a", 2)
    assert store.get("a") == 1, "the first is kept"
    before = path.read_bytes()
    again = Store(path)
    again.add("b", 2)
    assert path.read_bytes().startswith(before)
    assert "a" in again
    assert "c" not in again
    assert (len(again), repr(again)) == (2, f"Store({str(path)!r}, 2 results)")
    refused((lambda: again.get("c"), "c", KeyError))


def test_a_line_torn_anywhere_is_left_out_and_harms_no_other(tmp_path):
    """A kill may tear a line at any byte while another process goes on writing."""
    path = tmp_path / "s.jsonl"
    Store(path)
    header = path.stat().st_size
    Store(path).add("a", (0.5, "é\n"))
    first = path.stat().st_size
    Store(path).add("b", [1.5])
    whole = path.read_bytes()
    for size in range(len(whole)):
        path.write_bytes(whole[:size])
        store = Store(path)
        assert ("a" in store, "b" in store) == (size >= first, False), size
        assert ("torn lines left out" in repr(store)) == (
            size not in (0, header - 1, header, header + 1, first, first + 1)
        ), size
        store.add("c", 3)
        store.add("d", 4)
        again = Store(path)
        assert (again.get("c"), again.get("d"), len(again)) == (3, 4, 2 + (size >= first)), size


WRITER = """
import sys
from burrlab.common.study import Store
store = Store(sys.argv[1])
print("ready", flush=True)
sys.stdin.readline()
for i in range(200):
    store.add(f"{sys.argv[2]}{i}", [i] * (i * 37 % 4000))
"""


def test_processes_may_write_into_one_store(tmp_path):
    path = tmp_path / "s.jsonl"
    writers = [
        subprocess.Popen(
            [sys.executable, "-c", WRITER, path, name], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        for name in "xy"
    ]  # fmt: skip
    for writer in writers:
        assert writer.stdout.readline() == "ready\n"
    for writer in writers:  # all run at once
        writer.stdin.write("\n")
        writer.stdin.flush()
    for writer in writers:
        with writer:
            assert writer.wait(60) == 0
    store = Store(path)
    assert "torn" not in repr(store)
    assert len(store) == 400
    for name in "xy":
        for i in range(200):
            assert store.get(f"{name}{i}") == [i] * (i * 37 % 4000)


OTHER = r"store must be a file of burrlab results or a new one, got .*s\.csv"


@pytest.mark.parametrize(
    ("content", "told"),
    [
        *((content, OTHER) for content in (b"force_N,velocity_mm_s\n", b"{}\n", b"[1]\n", b"1\n", b"\x93NUMPY\x01\x00", b"{\nx")),
        (_HEADER.replace(b"1", b"2") + b"\n", r"store must be of format 1, got .* of format 2"),
    ],
)  # fmt: skip
def test_another_file_is_refused_and_left_as_it_is(tmp_path, content, told):
    path = tmp_path / "s.csv"
    path.write_bytes(content)
    refused((lambda: Store(path), told))
    assert path.read_bytes() == content


def test_a_store_that_cannot_be_written_says_so_at_once(tmp_path):
    refused(
        (lambda: Store(tmp_path / "none" / "s.jsonl"), "none"), (lambda: Store(tmp_path), None, IsADirectoryError),
        error=OSError,
    )  # fmt: skip


def test_a_full_disk_is_an_error_and_the_store_goes_on(tmp_path, monkeypatch):
    store = Store(tmp_path / "s.jsonl")
    write = os.write
    monkeypatch.setattr(os, "write", lambda file, text: write(file, text[:20]))
    refused((lambda: store.add("a", 1), r"took 20 of \d+ bytes: is the disk full", OSError))
    assert "a" not in store
    monkeypatch.undo()
    store.add("a", 2)
    assert Store(store.path).get("a") == 2


def test_a_store_of_an_earlier_version_is_taken_up(tmp_path):
    """Its keys hold former names of modules."""
    store = tmp_path / "store.jsonl"
    store.write_bytes((Path(__file__).parents[1] / "golden/files/store.jsonl").read_bytes())
    before = store.read_bytes()
    burrlab.force_sweep(
        burrlab.Burr(3.0), burrlab.materials["bone"], [0.8, 1.2], repeats=2, voxel=0.3, seed=4, store=store
    )
    assert store.read_bytes() == before
