"""The examples in the docstrings of the compiled core, which pytest's --doctest-modules does not see."""

from __future__ import annotations

import doctest
from collections.abc import Iterator

import pytest

import burrlab._core as _core


def documented() -> Iterator[tuple[str, str]]:
    """Every docstring of the core: its functions, its classes and their members."""
    for name, value in vars(_core).items():
        if name.startswith("_"):
            continue
        yield name, getattr(value, "__doc__", None) or ""
        if isinstance(value, type):
            for member, attribute in vars(value).items():
                if not member.startswith("__"):
                    yield f"{name}.{member}", getattr(attribute, "__doc__", None) or ""


EXAMPLES = [
    test
    for name, text in documented()
    if (test := doctest.DocTestParser().get_doctest(text, {}, name, None, 0)).examples
]


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda test: test.name)
def test_example(example: doctest.DocTest, capsys: pytest.CaptureFixture[str]) -> None:
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE)
    result = runner.run(example)
    assert result.attempted == len(example.examples)
    assert result.failed == 0, capsys.readouterr().out


def test_examples_are_found() -> None:
    """An empty collection would pass in silence."""
    found = {example.name for example in EXAMPLES}
    assert {
        "Shape",
        "Burr",
        "Material",
        "VoxelBone",
        "penetration",
        "BurrContact",
        "ForceController",
    } <= found
