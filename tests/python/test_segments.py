"""Segmentations of 3D Slicer: names, colours, layers."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from session_scenes import refused

from burrlab.bone.formats import merged, read_labels, segments_of, write_volume
from burrlab.bone.image import LabelVolume

FIELDS = {
    "Segment0_ID": "Segment_1", "Segment0_Name": "Bone", "Segment0_LabelValue": "1", "Segment0_Layer": "0",
    "Segment0_Color": "1 0.5 0", "Segment1_ID": "Segment_2", "Segment1_Name": "Facial_Nerve", "Segment1_LabelValue": "4",
    "Segment1_Layer": "0", "Segment1_Color": "0.2 0.4 0.6", "Segmentation_MasterRepresentation": "Binary labelmap",
}  # fmt: skip


def seg_nrrd(path: Path, values: np.ndarray, fields: dict[str, str]) -> Path:
    """File of raw values (z, y, x) or (z, y, x, layers)."""
    layers = values.ndim == 4
    sizes = " ".join(str(n) for n in values.shape[::-1])
    lines = [
        "NRRD0004", "type: unsigned char", f"dimension: {values.ndim}", "space: left-posterior-superior", f"sizes: {sizes}",
        f"space directions: {'none ' if layers else ''}(0.2,0,0) (0,0.3,0) (0,0,0.4)",
        f"kinds: {'list ' if layers else ''}domain domain domain", "endian: little", "encoding: raw",
        "space origin: (5,6,7)", *(f"{key}:={value}" for key, value in fields.items()), "", "",
    ]  # fmt: skip
    path.write_bytes("\n".join(lines).encode() + values.astype(np.uint8).tobytes())
    return path


def test_names_and_colours_of_a_label_map(tmp_path: Path) -> None:
    values = np.random.default_rng(2).choice([0, 1, 4], (3, 4, 5))
    labels = read_labels(seg_nrrd(tmp_path / "a.seg.nrrd", values, FIELDS))
    np.testing.assert_array_equal(labels.labels, values)
    assert labels.names == {1: "Bone", 4: "Facial_Nerve"}
    assert labels.colours == {1: (255, 128, 0), 4: (51, 102, 153)}
    np.testing.assert_allclose(labels.spacing, (0.2, 0.3, 0.4))


@pytest.mark.parametrize("far", [2, 70_000])
def test_names_and_colours_survive_nrrd(tmp_path: Path, far: int) -> None:
    pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
    nrrd = pytest.importorskip("nrrd", reason="an independent reader, extra `dev`")
    values = np.zeros((4, 5, 6), np.int32)
    values[1:3, 2, 3:], values[3, 4, 5] = 1, far
    names, colours = {1: "Facial_Nerve", far: "a\\b\nö", 9: "absent"}, {1: (1, 2, 3), 3: (255, 128, 0)}
    labels = LabelVolume(values, 0.3, (1, 2, 3), np.eye(3), "made", names, colours)
    write_volume(tmp_path / "a.seg.nrrd", labels)
    again = read_labels(tmp_path / "a.seg.nrrd")
    np.testing.assert_array_equal(again.labels, values)
    assert (again.names, again.colours) == (names, colours)
    header = nrrd.read_header(str(tmp_path / "a.seg.nrrd"))
    assert (header["Segment0_ID"], header["Segment0_Extent"]) == ("Segment_1", "3 5 2 2 1 2")
    found = segments_of(header)
    assert [(s.label, s.layer) for s in found] == [(label, 0) for label in sorted({*names, *colours})]
    extents = {header[f"Segment{i}_LabelValue"]: header[f"Segment{i}_Extent"] for i in range(len(found))}
    assert (extents[str(far)], extents["9"]) == ("5 5 4 4 3 3", "0 -1 0 -1 0 -1")


def layered() -> tuple[np.ndarray, dict[str, str]]:
    values = np.zeros((3, 4, 5, 2), np.uint8)
    values[0, :, :, 0] = 1
    values[1, 2, 3, 1] = 1
    return values, {**FIELDS, "Segment1_LabelValue": "1", "Segment1_Layer": "1"}


def test_layers_become_one_volume(tmp_path: Path) -> None:
    values, fields = layered()
    labels = read_labels(seg_nrrd(tmp_path / "a.seg.nrrd", values, fields))
    expected = values[..., 0] + 2 * values[..., 1]
    np.testing.assert_array_equal(labels.labels, expected)
    assert labels.names == {1: "Bone", 2: "Facial_Nerve"}
    assert labels.notes[-1].startswith("labels are renumbered, 1 to 2")
    np.testing.assert_allclose(labels.origin, (5, 6, 7))
    old = {key: value for key, value in fields.items() if "Label" not in key and "Layer" not in key}
    np.testing.assert_array_equal(read_labels(seg_nrrd(tmp_path / "old.nrrd", values, old)).labels, expected)
    kept = dict(fields, Segment1_LabelValue="7")
    values[1, 2, 3, 1] = 7
    found = read_labels(seg_nrrd(tmp_path / "b.seg.nrrd", values, kept))
    assert (found.labels[1, 2, 3], found.names, found.notes) == (7, {1: "Bone", 7: "Facial_Nerve"}, ())


def test_overlap_is_refused(tmp_path: Path) -> None:
    values, fields = layered()
    values[0, 1, :2, 1] = 1
    with pytest.raises(
        ValueError,
        match=r"a.seg.nrrd: segments must not overlap, 'Bone' and 'Facial_Nerve' share voxels, 2 in all, the first at "
        r"\(z, y, x\) = \(0, 1, 0\)",
    ):
        read_labels(seg_nrrd(tmp_path / "a.seg.nrrd", values, fields))


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"Segment1_LabelValue": "x"},
         "Segment1_LabelValue must be a whole number from 0 to 2147483647, got 'x'"),
        ({"Segment1_Layer": "2"}, "Segment1_Layer must be a whole number from 0 to 1, got '2'"),
        ({"Segment1_Color": "1 2 3"}, "Segment1_Color must be three numbers from 0 to 1, got '1 2 3'"),
        ({"Segment1_Color": "1 1"}, "Segment1_Color must be three numbers from 0 to 1"),
        ({"Segment1_LabelValue": "1"},
         "segments must differ in label or layer, 'Bone' and 'Facial_Nerve' do not"),
    ],
)  # fmt: skip
def test_bad_fields_are_refused(changes: dict[str, Any], match: str) -> None:
    refused((lambda: segments_of({**FIELDS, **changes}, layers=2), match))


def test_one_layer_follows_the_same_rules(tmp_path: Path) -> None:
    path, values = tmp_path / "one.seg.nrrd", layered()[0][..., 0]
    refused(
        (lambda: read_labels(seg_nrrd(path, values, {**FIELDS, "Segment1_LabelValue": "1"})),
         "'Bone' and 'Facial_Nerve' do not"),
    )  # fmt: skip
    assert read_labels(seg_nrrd(path, values, {"Segment0_Name": "Bone"})).names == {1: "Bone"}


def test_a_segment_without_a_name_has_its_identifier() -> None:
    [segment] = segments_of({"Segment3_ID": "one", "Segment3_LabelValue": "2"})
    assert (segment.name, segment.label, segment.colour) == ("one", 2, None)
    labels, names, _, notes = merged(np.full((1, 1, 1, 1), 2, np.uint8), [segment])
    assert (labels[0, 0, 0], names, notes) == (2, {2: "one"}, ())
