"""`probe` and then `erode` equal one `step`."""

import numpy as np
import pytest
from tick_scenes import SCHEMES, SKEW, make_pair, scene_of

FELT = ("force", "normal", "m1", "m0", "penetration", "tick", "touching", "ambiguous", "coarse", "faint")


@pytest.mark.parametrize("spacing", [(0.2, 0.2, 0.2), SKEW], ids=["equal", "skew"])
@pytest.mark.parametrize("fill", ["solid", "random", "faint"])
@pytest.mark.parametrize("shape", ["parabolic", "power(1.5)", "linear", "constant"])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_probe_and_erode_are_a_step(
    cpu_path: str, scheme: str, shape: str, fill: str, spacing: tuple[float, float, float]
) -> None:
    """Contacts, removed volume, tick and bone are equal to the last bit."""
    rate_exponent = 0.5 if fill == "random" else 0.0
    scene = scene_of(scheme, shape, fill=fill, spacing=spacing, rate_exponent=rate_exponent)
    whole, halves = (make_pair(scene)[0] for _ in range(2))
    removed = 0.0
    for center in scene.centers():
        expected = whole.step(center, scene.dt)
        got = halves.probe(center)
        for name in FELT:
            np.testing.assert_array_equal(getattr(got, name), getattr(expected, name), err_msg=name)
        assert got.removed == 0.0
        assert (halves.tick, halves.erode(center, scene.dt)) == (expected.tick, expected.removed)
        assert halves.tick == whole.tick == expected.tick + 1
        assert halves.bone.digest() == whole.bone.digest()
        removed += expected.removed
    assert removed > 0.0
    assert halves.bone.removed == whole.bone.removed


@pytest.mark.parametrize("rate_exponent", [0.0, 1.0])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_force_and_erosion_may_act_in_different_places(
    cpu_path: str, scheme: str, rate_exponent: float
) -> None:
    """`erode` does not depend on the probe before it."""
    scene = scene_of(scheme, "quartic", rate_exponent=rate_exponent)
    first, second = scene.centers()[:2]
    found = set()
    for probed in ([], [first], [second]):
        contact, _ = make_pair(scene)
        for place in probed:
            contact.probe(place)
        contact.erode(second, 1.0)
        found.add(contact.bone.digest())
    assert len(found) == 1
