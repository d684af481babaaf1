"""Numbers, files, figures and messages equal the frozen ones (tests/golden/cases.py)."""

from pathlib import Path

import pytest

pytest.importorskip("SimpleITK", reason="extra `medical` is not installed")
from golden.cases import CASES, differences, frozen, plain


@pytest.mark.parametrize("name", CASES)
def test_it_is_as_it_was(name: str, tmp_path: Path) -> None:
    assert not list(differences(frozen(name), plain(CASES[name](tmp_path))))


@pytest.mark.parametrize(
    ("before", "now", "told"),
    [
        ({"a": 1}, {"a": 1, "b": 2}, ["/b: is new"]), ({"a": 1}, {}, ["/a: is gone"]), ([1.0], [1.0 + 1e-7], []),
        ([1.0], [1.1], ["/0: 1.0 is 1.1 now"]), (True, 1, [": True is 1 now"]), ([1], [1, 2], [": [1] is [1, 2] now"]),
        (float("nan"), float("nan"), []), ("a", "b", [": 'a' is 'b' now"]),
    ],
)  # fmt: skip
def test_differences_are_found(before: object, now: object, told: list[str]) -> None:
    assert list(differences(before, now)) == told
