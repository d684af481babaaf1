"""The examples in the docstrings of the compiled core, which pytest's --doctest-modules does not find."""

import doctest

import pytest

import burrlab._core as _core

FOUND = doctest.DocTestFinder().find(_core, "_core", module=False)  # False: also those of compiled modules
EXAMPLES = {test.name.removeprefix("_core."): test for test in FOUND if test.examples}


@pytest.mark.parametrize("name", EXAMPLES)
def test_example(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    example = EXAMPLES[name]
    result = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(example)
    assert (result.attempted, result.failed) == (len(example.examples), 0), capsys.readouterr().out


def test_examples_are_found() -> None:
    """An empty collection would pass unnoticed."""
    wanted = {"Shape", "Burr", "Material", "VoxelBone", "penetration", "BurrContact", "ForceController"}
    assert set(EXAMPLES) >= wanted
