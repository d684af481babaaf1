"""JSON that is foreign or changed: one sentence that names the file."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

import burrlab
from burrlab.bone.tissues import read_tissues
from burrlab.common.study import _HEADER, Store
from burrlab.psychophysics.analysis import Analysis
from burrlab.psychophysics.protocol import Protocol

BONE = burrlab.materials["bone"]
DEEP = "[" * 100_000 + "]" * 100_000
READERS = {"{}": (burrlab.Descent.load, burrlab.Fit.from_json, Store, Analysis.from_json),
           "# material: {}\nlabel,name\n1,bone\n": (read_tissues,),
           "[experiment]\nname = {}\n": (Protocol.read,),
           "[experiment]\nname." + "a." * 2_000 + "a = {}\n": (Protocol.read,)}  # fmt: skip


def refused(read: Callable[[Path], object], path: Path) -> bool:
    told = ""
    try:
        read(path)
    except ValueError as error:
        told = str(error)
    assert not told or (path.name in told and len(told) < 500 and "\n" not in told)
    return bool(told)


@pytest.mark.parametrize("text", [DEEP, "1" * 5000, "1" + "0" * 400, "[]", '{"name": []}', "NaN", ""])
@pytest.mark.parametrize(
    ("frame", "read"), [(frame, read) for frame, all_ in READERS.items() for read in all_]
)
def test_another_json_is_refused(tmp_path: Path, frame: str, read, text: str) -> None:
    path = tmp_path / "x.json"
    path.write_text(frame.replace("{}", text))
    empty = read is Store and not text  # a new store
    assert refused(read, path) is not empty


@pytest.mark.parametrize("what", ["descent", "fit"])
def test_a_value_of_another_kind_is_refused_or_harmless(tmp_path: Path, what: str) -> None:
    path = tmp_path / "x.json"
    if what == "descent":
        read = burrlab.Descent.load
        burrlab.descend(burrlab.Burr(1.5), BONE, 1.0, voxel=0.3, seed=1, ideal=True).save(path)
        numbers = ["force_N", "stop_mm", "radius_mm", "penetration_velocity_mm_s"]
    else:
        read = burrlab.Fit.from_json
        burrlab.fit(burrlab.synthetic_curve(burrlab.Burr(3.0), BONE, [0.5, 1, 2, 3], seed=1)).to_json(path)
        numbers = ["c_e", "alpha", "residual", "n_points"]
    good = json.loads(path.read_text())
    places = [(key,) for key in good] + [(a, b) for a in good if isinstance(good[a], dict) for b in good[a]]
    values = [None, [], "x", 10**400, float("nan"), [[1]], "missing"]
    for place, (*parents, key) in enumerate(places):
        for value in values if key in numbers else values[place % 3 :: 3]:
            changed = at = {**good}
            if parents:
                at = changed[parents[0]] = {**good[parents[0]]}
            at[key] = value
            if value == "missing":
                del at[key]
            path.write_text(json.dumps(changed))
            harmless = not refused(read, path)
            assert not (harmless and key in numbers and not parents and value is not None), (key, value)


@pytest.mark.parametrize(
    "result",
    ['{"array": ["O", [1], "AAAAAAAAAAA="]}', '{"array": ["V8", [1], "AAAAAAAAAAA="]}', '{"array": [[["a", "<f8"]], [1], ""]}',
     '{"array": ["<f8", [1000000000000], ""]}', '{"array": ["x", [1], ""]}', '{"other": 1}', '{"tuple": 5}', '{"dict": [1]}',
     '{"float": 1%s}' % ("0" * 400)],
)  # fmt: skip
def test_a_store_gives_no_result_that_it_never_took(tmp_path: Path, result: str) -> None:
    line = f'{{"key": "a", "result": {result}}}\n{{"key": "b", "result": {DEEP}}}\n'
    (tmp_path / "x.json").write_text(_HEADER.decode() + "\n" + line)
    store = Store(tmp_path / "x.json")
    assert "1 torn lines left out" in repr(store)
    assert refused(lambda path: store.get("a"), store.path)
