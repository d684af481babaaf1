"""The power of a comparison, its run sheet, and what a filled-in sheet gives."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from command_line import refusal, said
from fit_scenes import BONE, BURR
from session_scenes import refused

import burrlab
from burrlab.fitting.group_effects import deviation_text
from burrlab.measured.curve import VelocityCurve

FORCES = np.geomspace(0.3, 2.2, 8)
PILOT = burrlab.fit(burrlab.synthetic_curve(BURR, BONE, FORCES, repeats=4, scatter=0.08, seed=1))


def filled(sheet, seed, *, ratio=0.9, between=0.1, of_c_e=0.0, difference=0.0, within=0.08, own=False):
    """A run sheet with velocities; specimens differ, and the drills by a ratio of alpha."""
    random = np.random.default_rng(seed)
    labels = dict.fromkeys(zip(sheet.groups["specimen"], sheet.groups["drill"], strict=True))
    materials, shared = {}, {}
    for specimen, drill in labels:
        if own or specimen not in shared:
            shared[specimen] = random.normal(size=2)
        a, c = shared[specimen]
        alpha = BONE.alpha * (ratio if drill == "B" else 1.0)
        alpha *= np.exp(between * a + difference / 2**0.5 * random.normal())
        materials[specimen, drill] = burrlab.Material("level", c_e=BONE.c_e * np.exp(of_c_e * c), alpha=alpha)
    rows = zip(sheet.groups["specimen"], sheet.groups["drill"], sheet.force, strict=True)
    v = np.array([burrlab.penetration_velocity(BURR, materials[s, d], F) for s, d, F in rows])
    groups = dict(sheet.groups)
    if own:
        groups["specimen"] = [f"{s}{d}" for s, d in zip(groups["specimen"], groups["drill"], strict=True)]
    return VelocityCurve(
        sheet.force, v * np.exp(within * random.normal(size=len(v))), radius=3.0, groups=groups
    )


def differ(curve):
    return burrlab.compare(*[burrlab.fit(x, plausible=None) for x in curve.split("drill").values()]).pairs[0]


def test_power_grows_with_what_helps(tmp_path):
    study = burrlab.compare_power(
        PILOT, specimens=[3, 6, 9], runs=[6, 18], between={"alpha": 0.1, "difference": 0.05}
    )
    assert all((np.diff(study.power, axis=axis) > 0).all() for axis in (1, 2))
    assert (study.power[0] > study.power[1]).all()
    assert (study.smallest(), study.smallest("apart")) == ((6, 6), None)
    assert study.within == PILOT.evidence.scatters[0].value
    data = PILOT.data[0]
    known = burrlab.fit(replace(data, sigma=0.05 * data.velocity), residuals="sigma")
    options = {"specimens": [6], "runs": [8], "between": {"alpha": 0.1}}
    assert burrlab.compare_power(known, **options).within == pytest.approx(0.05)
    absolute = burrlab.fit(data, residuals="absolute")
    refused(
        (
            lambda: burrlab.compare_power(absolute, **options),
            "within must be given: a fit of absolute residuals",
        )
    )
    assert [
        text in study.verdict
        for text in ("is seen in 80 % with 6 specimens and 6 runs of each drill in each", "by none of these")
    ] == [True, True]
    study.to_json(tmp_path / "study.json")
    assert repr(burrlab.ComparisonPower.from_json(tmp_path / "study.json")) == repr(study)
    assert study.plot().get_ylabel() == "power to see 10 % of α [1]"
    # no difference is found as often as the test errs
    level = burrlab.compare_power(PILOT, 1.0001, specimens=[6], runs=[8], between={"alpha": 0.1}).power
    assert level == pytest.approx(0.05, abs=0.03)


@pytest.mark.parametrize("days", [1, 2])
def test_sizes_come_from_a_fit_with_specimens(days):
    """And with days: what differs by both adds up."""
    sheet = burrlab.run_sheet(FORCES, specimens=5, runs=8, days=days, seed=1)
    fit = burrlab.fit(filled(sheet, days).split("drill")["A"], plausible=None)
    study = burrlab.compare_power(fit, specimens=[4], runs=[8])
    of_alpha = [x for x in fit.effects if x.quantity == "alpha" and x.deviation]
    deviations = {"c_e": fit.effects[-2].deviation, "alpha": np.linalg.norm([x.deviation for x in of_alpha])}
    assert study.between == pytest.approx({**deviations, "difference": 0.0})
    assert (study.unit, len(of_alpha)) == ("specimen", days)
    upper = deviation_text(np.linalg.norm([x.interval.upper for x in of_alpha]))
    assert f"but by up to {upper} is possible" in study.verdict


def test_run_sheet_is_balanced_and_comes_back(tmp_path, capsys):
    sheet = burrlab.run_sheet(FORCES, specimens=4, runs=8, days=2, radius=3.0, seed=1)
    assert (len(sheet), sheet.ok.any()) == (64, False)
    rows = list(
        zip(
            sheet.groups["day"],
            sheet.groups["specimen"],
            sheet.groups["drill"],
            sheet.force.round(3),
            strict=True,
        )
    )
    assert [day for day, *_ in rows] == ["day 1"] * 32 + ["day 2"] * 32
    of_drills = [{row[:2] + row[3:] for row in rows if row[2] == drill} for drill in ("A", "B")]
    assert of_drills[0] == of_drills[1]
    for n, days in ((4, 2), (3, 6)):  # each force on as many days as it can be
        crossed = burrlab.run_sheet(FORCES[:n], specimens=["a"], runs=2 * n, days=days, seed=1)
        assert len({*zip(crossed.groups["day"], crossed.force.tolist(), strict=True)}) == 2 * n
        assert len({*crossed.groups["day"]}) == days
    assert {(day, F) for day, _, F in of_drills[0]} == {
        (d, F) for d in ("day 1", "day 2") for F in FORCES.round(3)
    }
    order = [F for _, specimen, drill, F in rows if (specimen, drill) == ("specimen 1", "A")]
    assert order != sorted(order)
    assert burrlab.run_sheet(FORCES, specimens=4, runs=8, radius=3.0, seed=1) == sheet
    for sep in ",;":  # a spreadsheet takes comments for rows
        replace(sheet, velocity=np.ones(len(sheet))).to_csv(tmp_path / "filled.csv")
        with open(tmp_path / "filled.csv", newline="") as file:
            rows = list(csv.reader(file))
        with open(tmp_path / "saved.csv", "w", newline="") as file:
            csv.writer(file, delimiter=sep).writerows(row + [""] * (7 - len(row)) for row in rows)
        saved = burrlab.VelocityCurve.from_csv(tmp_path / "saved.csv", **({"sep": sep} if sep == ";" else {}))
        assert (saved.radius, saved.groups, saved.provenance["seed"]) == (3.0, sheet.groups, 1)
    assert set(burrlab.run_sheet(FORCES, specimens=1, runs=3).force) == {*FORCES[[0, 4, 7]]}

    filled(sheet, 2, ratio=0.7).to_csv(tmp_path / "sheet.csv")
    compared = said(capsys, "compare", tmp_path / "sheet.csv", "--by", "drill", "--json", tmp_path / "c.json")
    assert "A and B, paired by day and specimen, differ" in compared.replace("B and A", "A and B")
    (pair,) = json.loads((tmp_path / "c.json").read_text())["pairs"]
    assert pair["differ"]


def test_command(tmp_path, capsys):
    PILOT.to_json(tmp_path / "fit.json")
    design = ["design", tmp_path / "fit.json"]
    sizes = "--compare 0.9 --specimens 5:6 --runs 6,8 --between alpha=0.1,difference=0.05 --seed 3"
    command = [*design, *sizes.split(), "--json", tmp_path / "power.json"]
    report = said(capsys, *command, "--sheet", tmp_path / "sheet.csv", "--plot", tmp_path / "power.png")
    assert "6 specimens and 6 runs of each drill in each" in report
    assert json.loads((tmp_path / "power.json").read_text())["smallest"] == [6, 6]
    assert len(VelocityCurve.from_csv(tmp_path / "sheet.csv")) == 72
    assert (tmp_path / "power.png").stat().st_size > 10000
    assert "no comparison of these sizes" in refusal(capsys, *command, "--power", 0.999, "--sheet", "x.csv")
    assert "--sheet goes with --compare" in refusal(capsys, *design, "--forces", "1,2", "--sheet", "x.csv")


@pytest.mark.parametrize(
    ("call", "error", "match"),
    [
        (lambda: burrlab.compare_power(3), TypeError, "fit must be a Fit"),
        (lambda: burrlab.compare_power(PILOT), ValueError, "between must hold alpha, such as"),
        (lambda: burrlab.compare_power(PILOT, 1.0), ValueError, "ratio must lie between 0.1 and 10 and be other"),
        (lambda: burrlab.compare_power(PILOT, specimens=[1]), ValueError, "specimens must be 2 or more each"),
        (lambda: burrlab.compare_power(PILOT, runs=[]), ValueError, "runs must be 3 or more each"),
        (lambda: burrlab.compare_power(PILOT, between={"difference": 0.1}), ValueError, "between must hold alpha, such as"),
        (lambda: burrlab.compare_power(burrlab.fit(replace(PILOT.data[0], groups={"day": ["a", "b"] * 16})), between={"c_e": 0.1}), ValueError, "c_e of specimens, .* its groups are days"),
        (lambda: burrlab.compare_power(PILOT, between={"day": 1.0, "alpha": 0.1}), ValueError, "between may hold c_e, alpha, diff"),
        (lambda: burrlab.compare_power(PILOT, between={"alpha": -1.0}), ValueError, "between of alpha must lie between 0 and 3"),
        (lambda: burrlab.compare_power(PILOT, between={"alpha": 0.1}, forces=[1.0, 2.0]), ValueError, "forces must be three or more"),
        (lambda: burrlab.compare_power(PILOT, between={"alpha": 0.1}, forces=[1.0, 2.0, 9.0]), ValueError, "that leave a window"),
        (lambda: burrlab.compare_power(PILOT, between={"alpha": 0.1}, within=0.0), ValueError, "within must be positive"),
        (lambda: burrlab.compare_power(PILOT, aim=1.0), ValueError, "aim must be above 0 and below 1"),
        (lambda: burrlab.run_sheet(FORCES, specimens=["a", " a"], runs=8), ValueError, "specimens must be one or more"),
        (lambda: burrlab.run_sheet(FORCES, specimens=2, runs=8, drills=[1, "1"]), ValueError, "drills must be one or more"),
        (lambda: burrlab.run_sheet(FORCES, specimens=2, runs=8, days=9), ValueError, "runs must be as many as days or more"),
        (lambda: burrlab.run_sheet([], specimens=2, runs=8), ValueError, "forces must be positive, one or more"),
        (lambda: burrlab.run_sheet(FORCES, specimens=2.5, runs=8), ValueError, "specimens must be a whole number"),
        (lambda: burrlab.run_sheet(FORCES, specimens=2, runs=8, drills=None), TypeError, "drills must be a sequence of names"),
        (lambda: burrlab.compare_power(PILOT, between=0.1), TypeError, "between must be a dict such as"),
        (lambda: PILOT.curve.split("drill"), ValueError, "the rows have no drill: name its column by groups="),
    ],
)  # fmt: skip
def test_what_is_refused(call, error, match):
    refused((call, match, error))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("n", "ratio", "options", "own"),
    [
        (3, 0.9, {"within": 0.05}, False), (3, 0.9, {"within": 0.1}, False), (6, 0.9, {"difference": 0.05}, False),
        (6, 0.9, {"difference": 0.05, "of_c_e": 0.1}, False), (12, 0.9, {}, True), (6, 0.8, {"of_c_e": 0.1}, True),
        (6, 0.8, {"between": 0.02**0.5}, True),  # of specimens and their days, 10 % each
    ],
)  # fmt: skip
def test_powers_are_those_of_simulated_comparisons(n, ratio, options, own):
    sizes = {"between": 0.1, "within": 0.08, "of_c_e": 0.0, "difference": 0.0} | options
    deviations = {"alpha": sizes["between"], "c_e": sizes["of_c_e"], "difference": sizes["difference"]}
    study = burrlab.compare_power(
        PILOT, ratio, specimens=[n], runs=[8], between=deviations, within=sizes["within"]
    )
    sheet, sets = burrlab.run_sheet(FORCES, specimens=n, runs=8, days=1, radius=3.0, seed=1), 200
    found = (
        sum(differ(filled(sheet, seed, ratio=ratio, own=own, **sizes)).differ for seed in range(sets)) / sets
    )
    predicted = study.power[int(own), 0, 0]
    print(
        n,
        ratio,
        options,
        "of their own" if own else "the same",
        f"simulated {found:.3f}, predicted {predicted:.3f}",
    )
    # right to ten per cent, and what so few comparisons leave open
    assert found == pytest.approx(predicted, abs=0.1 + 3 * np.sqrt(found * (1 - found) / sets))
