"""Protocols from TOML, and errors that name table and key."""

import inspect
import re
from functools import partial
from pathlib import Path

import pytest
from answer_scenes import SMALL, protocol
from session_scenes import refused

import burrlab
from burrlab.psychophysics.designs import ABX, SameDifferent, Stimulus, key_of
from burrlab.psychophysics.protocol import AnalysisSettings, Protocol, template
from burrlab.psychophysics.side_car import columns_of
from burrlab.psychophysics.staircase import DESIGNS, design_of_dict
from burrlab.session.exchange import DeviceText, parse_address, parse_device

ALL_ON = re.sub(r"^#(?=[a-z\[])", "", template(), flags=re.MULTILINE)


def test_what_a_protocol_says(tmp_path):
    one = protocol(tmp_path)
    assert (one.name, one.seed, one.subjects) == ("test", 7, ("01", "02", "03"))
    assert (one.burr, one.bone.size, one.bone.voxel) == (burrlab.Burr(3.0), (12.0, 12.0, 6.0), 0.5)
    assert (one.device, one.trace, one.feedback, one.pause, one.rest) == ("hand", False, False, 1.0, 60.0)
    assert (one.folder, one.selected_by, one.selected_from) == (tmp_path / "data", None, None)
    assert one.analysis == AnalysisSettings(("independent-observations", "differencing"), None, 0.95)
    bone, pvc = (Stimulus(name, burrlab.materials[name]) for name in ("bone", "pvc"))
    assert one.tasks["probing"] == SameDifferent(bone, pvc, trials=8, practice=2, blocks=2)
    assert one.tasks["match"] == ABX(bone, pvc, trials=4)
    assert one.minutes("probing") == (10 * 2 * (20.0 + 1.0) + 60.0) / 60.0
    assert repr(one) == f"Protocol('test', 3 subjects, tasks probing, match, up, digest {one.digest[:12]})"


def test_the_template_is_the_paper_s_first_task(tmp_path):
    one = protocol(tmp_path, template())
    assert [(name, d.mode, d.trials, d.interval) for name, d in one.tasks.items()] == [
        (name, name, 12, 20.0) for name in ("probing", "drilling")
    ]
    assert [one.tasks_of(subject)[0] for subject in one.subjects] == ["probing", "drilling"] * 6
    # Orders differ between subjects and tasks.
    assert len({one.order(s, t).next().intervals[0].seed for s in one.subjects for t in one.tasks}) == 24


def test_references_are_tasks(tmp_path):
    """One a reference, in the design's own words; at the factor 1 it is the design without references."""
    plain = protocol(tmp_path)
    tasks = protocol(tmp_path, SMALL.replace("trials = 10", "trials = 10\nreferences = [0.5, 1, 4]")).tasks
    assert [name for name in tasks if name.startswith("up")] == ["up1", "up2", "up3"]
    assert tasks["up2"].to_dict() == plain.tasks["up"].to_dict()
    assert [tasks[f"up{i}"].reference.material.c_e for i in (1, 3)] == pytest.approx([1.0725, 8.58])
    along = "trials = 10\nreferences = [2, 3]\ndirection = [3, 8]"
    bone, moved = (
        plain.tasks["up"].reference.material,
        protocol(tmp_path, SMALL.replace("trials = 10", along)),
    )
    moved = moved.tasks["up1"].reference.material
    assert (moved.c_e / bone.c_e, moved.alpha / bone.alpha) == pytest.approx((8.0, 256.0))


def test_the_template_s_examples_are_of_every_design(tmp_path):
    one = protocol(tmp_path, ALL_ON)
    assert {design.to_dict()["design"] for design in one.tasks.values()} == set(DESIGNS)
    match = one.tasks["match"]
    assert (match.reference, match.reference_interval) == (Stimulus("specimen"), None)
    assert one.analysis.delta == 1.5
    assert all(one.order("01", task).next() is not None for task in one.tasks)


def test_what_the_template_says_is_what_its_keys_default_to(tmp_path):
    """Removing a key from the template changes nothing."""
    one = protocol(tmp_path, template())
    kept = ("[", "name", "seed", "subjects", "radius", "size", "voxel", "design", "a =", "b =", "mode")
    bare = "\n".join(line for line in template().splitlines() if line.startswith(kept))
    assert protocol(tmp_path, bare).to_dict() == one.to_dict()


def test_names_of_subjects(tmp_path):
    assert protocol(tmp_path, SMALL.replace("subjects = 3", 'subjects = ["P1", "x"]')).subjects == ("P1", "x")
    many = protocol(tmp_path, SMALL.replace("subjects = 3", "subjects = 100")).subjects
    assert (many[0], many[-1]) == ("001", "100")


def test_materials_of_one_s_own(tmp_path):
    text = SMALL.replace('foil = "pvc"', 'foil = "soft_1"')
    text += '[materials.soft_1]\nc_e = 1\nalpha = 0.2\nshape = "linear"\nforce_exponent = 2\n'
    task = protocol(tmp_path, text).tasks["match"]
    soft = burrlab.Material("soft_1", c_e=1.0, alpha=0.2, shape="linear", force_exponent=2.0)
    assert task.foil == design_of_dict(task.to_dict()).foil == Stimulus("soft_1", soft)


def test_the_folder_and_a_script_lie_beside_the_protocol(tmp_path):
    text = SMALL.replace("seed = 7", 'seed = 7\nfolder = "there"\ndevice = "scripted:way.csv"')
    one = protocol(tmp_path, text)
    assert (one.folder, one.device) == (tmp_path / "there", f"scripted:{tmp_path / 'way.csv'}")
    # Neither path changes the digest: the protocol is the same on another machine.
    other = tmp_path / "other"
    other.mkdir()
    assert protocol(other, text).digest == one.digest
    assert one.side_car("01", "match").device == "scripted:way.csv"


def test_unknown_subjects_and_tasks(tmp_path):
    one = protocol(tmp_path)
    subject, task = (
        "there is no subject '9'; there are 01, 02, 03",
        "there is no task 'x'; there are probing, match, up",
    )
    refused(
        *((partial(ask, "9", "match"), subject) for ask in (one.order, one.begin)), (partial(one.tasks_of, "9"), subject),
        *((partial(ask, "01", "x"), task) for ask in (one.order, one.side_car, one.begin, one.resume)),
    )  # fmt: skip
    assert not one.folder.exists()


def test_the_digest_is_of_what_is_said_not_how(tmp_path):
    one = protocol(tmp_path)
    same = SMALL.replace("seed = 7", "feedback = false # as before\nseed = 0x7").replace(
        "radius_mm = 3", "radius_mm=3.0"
    )
    assert protocol(tmp_path, same).digest == one.digest
    for old, new in (
        ("seed = 7", "seed = 8"),
        ("trials = 4", "trials = 6"),
        ('"pvc"', '"expert"'),
        ("3\n", "4\n"),
    ):
        assert protocol(tmp_path, SMALL.replace(old, new)).digest != one.digest


_TASKS = SMALL[SMALL.index("[tasks.probing]") :]
_RESIN = '[materials.resin]\nreal = true\n[tasks.match]\ndesign = "abx"\nreference = "resin"\n'


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("[experiment]", "[experiments]", r": the table [experiment] is missing"),
        ('name = "test"\n', "", r", [experiment]: name is missing"),
        ('name = "test"', "name = 1", r", [experiment]: name must be a text, got 1"),
        ('name = "test"', 'name = ""', r", [experiment]: name must be a text, got ''"),
        ("seed = 7", "seed = -7", r", [experiment]: seed must be a whole number from 0 to"),
        ("seed = 7", "seed = true", r", [experiment]: seed must be a whole number"),
        ("seed = 7", "seed = 7\nseeds = 7", r", [experiment]: unknown key 'seeds'; known are name, seed, subjects"),
        ("seed = 7", "seed = 7\nseed = 8", r": this is not TOML: Cannot overwrite a value (at line 5"),
        ("seed = 7", "seed = 7\ntrace = 1", r", [experiment]: trace must be true or false, got 1"),
        *(
            ("seed = 7", f"seed = 7\nkeys = {keys}", f", [experiment]: keys must be two signs that differ, none a space, such as \"fj\", got {said}")
            for keys, said in (("12", "12"), ('"f"', "'f'"), ('"ff"', "'ff'"), ('"f "', "'f '"), ('"fgh"', "'fgh'"), ('"f\\n"', "'f\\n'"))
        ),
        ("seed = 7", "seed = 7\npause_s = -1", r", [experiment]: pause_s must be at least 0, got -1.0"),
        ("seed = 7", "seed = 7\nbreak_s = inf", r", [experiment]: break_s must be a finite number, got inf"),
        ("seed = 7", 'seed = 7\ndevice = "mouse"', r", [experiment]: device must be hand, scripted:FILE, igtl:HOST:PORT"),
        ("seed = 7", 'seed = 7\ndevice = "igtl:x"', r", [experiment]: device igtl: must be HOST:PORT, got 'x'"),
        ("seed = 7", "seed = 7\nlost_after_ms = 0", r", [experiment]: lost_after_ms must be positive, got 0.0"),
        ("seed = 7", "seed = 7\npublish = 65536", r", [experiment]: publish must be a port, 1 to 65535, got 65536"),
        ("seed = 7", "seed = 7\npublish = true", r", [experiment]: publish must be a port, 1 to 65535, got True"),
        ("seed = 7", "seed = 7\nselected_from = 2", r", [experiment]: selected_from must be more than the"),
        ("seed = 7", 'seed = 7\nselected_from = "x"', r", [experiment]: selected_from must be a whole number"),
        ("seed = 7", "seed = 7\nselected_by = 3", r", [experiment]: selected_by must be a text"),
        ("seed = 7", 'seed = 7\nselected_by = "a\\tb"', r", [experiment]: selected_by must be without tabs"),
        ("subjects = 3\n", "", r", [experiment]: subjects is missing"),
        ("subjects = 3", "subjects = 0", r", [experiment]: subjects must be 1 to 9999, or a list of names, got 0"),
        ("subjects = 3", "subjects = []", r", [experiment]: subjects must be a number or a list of names, got []"),
        ("subjects = 3", "subjects = [1]", r", [experiment]: subjects must be a number or a list of names, got [1]"),
        ("subjects = 3", 'subjects = ["a b"]', r", [experiment]: a subject's name must be of letters and digits"),
        ("subjects = 3", 'subjects = ["a_b"]', r", [experiment]: a subject's name must be of letters and digits"),
        ("subjects = 3", 'subjects = ["ä"]', r", [experiment]: a subject's name must be of letters and digits"),
        ("subjects = 3", 'subjects = ["a", "a"]', r", [experiment]: a subject's name must be there once, got 'a' and 'a'"),
        ("subjects = 3", 'subjects = ["a", "A"]', r", [experiment]: a subject's name must be there once, got 'a' and 'A'"),
        ("[burr]\n", "[burr]\nwidth = 1\n", r", [burr]: unknown key 'width'; known are radius_mm"),
        ("radius_mm = 3", "radius_mm = -3", r", [burr]: radius must be"),
        ("radius_mm = 3", "radius_mm = nan", r", [burr]: radius_mm must be a finite number, got nan"),
        ("radius_mm = 3", "radius_mm = 1", r", [bone]: radius of the burr must be at least 4 voxels of 0.5 mm, got 1"),
        ("radius_mm = 3", "radius_mm = 7", r", [bone]: diameter of the burr must be less than the block's sides"),
        ("[12, 12, 6]", "12", r", [bone]: size_mm must be a list of numbers, got 12"),
        ("[12, 12, 6]", "[12, 12]", r", [bone]: size must have three lengths, got 2"),
        ("[12, 12, 6]", "[12, 12, 'x']", r", [bone]: size_mm must be a finite number, got 'x'"),
        ("[12, 12, 6]", "[12, 12, -6]", r", [bone]: size must be positive"),
        ("voxel_mm = 0.5", "voxel_mm = 0", r", [bone]: voxel must be positive and finite, got 0.0"),
        ("voxel_mm = 0.5", "voxel_mm = 0.35", r", [bone]: size must be a whole number of voxels of 0.35 mm"),
        ("voxel_mm = 0.5", "voxel_mm = 0.001", r", [bone]: the block has 8.64e+11 voxels, and 2e+08 are the most"),
        ("[tasks.probing]", "[tasks.pro-bing]", r", [tasks]: a task's name must be of letters and digits"),
        ("[tasks.match]", "[tasks.Probing]", r", [tasks]: a task's name must be there once, got 'probing' and 'Probing'"),
        ("[tasks.match]", "[tasks.probing]", r": this is not TOML: Cannot declare ('tasks', 'probing') twice"),
        ('design = "abx"', 'design = "xab"', r", [tasks.match]: design must be one of same-different, abx, constant-stimuli"),
        ('design = "abx"\n', "", r", [tasks.match]: design is missing"),
        ('foil = "pvc"\n', "", r", [tasks.match]: foil is missing"),
        ('foil = "pvc"', 'foil = "pvk"', r", [tasks.match]: foil must be a material, one of bone, "),
        ('foil = "pvc"', 'foil = "bone"', r", [tasks.match]: match and foil must have different names"),
        ('foil = "pvc"', 'foil = "pvc"\nfile = 1', r", [tasks.match]: unknown key 'file'; known are design, reference, foil"),
        ('foil = "pvc"', 'foil = "pvc"\ninterval = 1', r", [tasks.match]: unknown key 'interval'; known are design, reference"),
        ('foil = "pvc"', 'foil = "pvc"\ninterval_s = 0', r", [tasks.match]: interval_s must be a time above 0 [s], got 0"),
        ('foil = "pvc"', 'foil = "pvc"\nmode = "up"', r", [tasks.match]: mode must be one of probing, drilling, got 'up'"),
        ("trials = 8", "trials = 10", r", [tasks.probing]: trials must be a multiple of 4 (AA, AB, BA, BB equally often), got 10"),
        ("trials = 8", "trials = 8.0", r", [tasks.probing]: trials must be a whole number"),
        ('parameter = "c_e"', 'parameter = "alpha"', r", [tasks.up]: mode must be 'drilling' for parameter 'alpha', got 'probing'"),
        ('parameter = "c_e"', 'parameter = "rho"', r", [tasks.up]: parameter must be one of c_e, alpha, got 'rho'"),
        (
            "[tasks.match]",
            '[tasks.again]\ndesign = "same-different"\na="bone"\nb="pvc"\ntrials=8\npractice=2\nblocks=2\n[tasks.match]',
            r", [tasks.again]: this is task probing again, trial by trial",
        ),
        ("[burr]", "[mood]\n[burr]", r": unknown key 'mood'; known are experiment, burr, bone, materials, tasks, analysis"),
        ("[burr]", "[analysis]\nrules = ['x']\n[burr]",
         r", [analysis]: rules must be a list of independent-observations"),
        ("[burr]", "[analysis]\nrules = []\n[burr]", r", [analysis]: rules must be a list of"),
        ("[burr]", "[analysis]\nrules = [1]\n[burr]", r", [analysis]: rules must be a list of"),
        ("[burr]",
         "[analysis]\nrules = [['differencing']]\n[burr]", r", [analysis]: rules must be a list of"),
        ("[burr]", "[analysis]\ndelta = 0\n[burr]", r", [analysis]: delta must be a d' above 0, got 0.0"),
        ("[burr]",
         "[analysis]\nlevel = 95\n[burr]", r", [analysis]: level must be from 0.5 to below 1, got 95.0"),
        ("[burr]", "[analysis]\npower = 1\n[burr]", r", [analysis]: unknown key 'power'; known are rules, delta, level"),
        ("[burr]", "[materials.bone]\nc_e = 1\nalpha = 1\n[burr]",
         r", [materials]: 'bone' is a material of the paper"),
        ("[burr]", "[materials.'a b']\nc_e = 1\nalpha = 1\n[burr]",
         r", [materials]: a material's name must be of letters"),
        ("[burr]", "[materials.a]\nalpha = 1\n[burr]", r", [materials.a]: c_e is missing"),
        ("[burr]", "[materials.a]\nc_e = -1\nalpha = 1\n[burr]", r", [materials.a]: c_e must be"),
        ("[burr]", "[materials.a]\nc_e = 2.1e6\nalpha = 1\n[burr]", r", [materials.a]: c_e must be at most 1000 [N/mm^2], got 2100000.0"),
        ("[burr]", "[materials.a]\nc_e = 1\nalpha = 1\nforce_exponent = 0\n[burr]", r", [materials.a]: force_exponent must be 1 to 8, got 0"),
        ("[burr]",
         "[materials.a]\nc_e = 1\nalpha = 1\nshape = 'x'\n[burr]", r", [materials.a]: shape must be"),
        ("[burr]",
         "[materials.a]\nreal = true\nc_e = 1\n[burr]", r", [materials.a]: unknown key 'c_e'; known are real"),
        ("[burr]", "[materials]\na = 1\n[burr]", r", [materials]: a must be a table, [materials.a], got 1"),
        ("[burr]", "[burr", r": this is not TOML: "),
        ("seed = 7", "seed = 7\nx = " + "[" * 5000, r": lists or tables are nested too deeply"),
        ("seed = 7", "seed = " + "1" * 5000, r": this is not TOML: Exceeds the limit"),
        ("seed = 7", "seed = " + "1" * 400, r", [experiment]: seed must be a whole number from 0 to 9223372036854775807, got 1111"),
        ("seed = 7", "seed = 7\npause_s = " + "1" * 400, r", [experiment]: pause_s must be a finite number, got 1111"),
        ("seed = 7", "seed = 7\npause_s = 1e308", r", [experiment]: pause_s must be at most 86400 [s], got 1e+308"),
        ("voxel_mm = 0.5", "voxel_mm = 1e308", r", [bone]: "),
        ("voxel_mm = 0.5", "voxel_mm = 1e-308", r", [bone]: the block has inf voxels, and 2e+08 are the most"),
        ('foil = "pvc"', 'foil = "pvc"\ninterval_s = 1e9', r", [tasks.match]: interval_s must be at most 86400 [s], got 1000000000.0"),
        ("practice = 2", "practice = 9223372036854775807",
         r", [tasks.probing]: practice must be a whole number from 0 to 10000, got 9223372036854775807"),
        ("trials = 10", "trials = 10\nreferences = []", r", [tasks.up]: references must be two or more different factors, got none"),
        ("trials = 10", "trials = 10\nstart = 1001", r", [tasks.up]: limit must be a ratio from 1e-6 to 1e6, got 1002001.0"),
        ("trials = 10", "trials = 10\nreferences = [1, 1e6]\ndirection = [2, 0]", r", [tasks.up]: c_e must be at most 1e12 N/mm^2, got"),
        ("trials = 10", "trials = 10\nreferences = [1, 300]\nmode = 'drilling'\nboundary_mm = [0.1, 0.2]",
         r": level 4 of task up2 cannot be rendered: c_e of 'below' must be from 1/4096 to 1000 N/mm^2, got"),
        ("trials = 10", "trials = 10\nreferences = [1.0]", r", [tasks.up]: references must be two or more different factors from 1e-6 to 1e6, got [1.0]"),
        ("trials = 10", "trials = 10\nreferences = [1, -2]", r", [tasks.up]: references must be two or more different factors from 1e-6 to 1e6, got [1.0, -2.0]"),
        ("trials = 10", "trials = 10\nreferences = [1, 2]\ndirection = [0, 1]", r", [tasks.up]: direction must be two numbers from -10 to 10, along ln c_e and ln alpha, that move c_e"),
        ("trials = 10", "trials = 10\ndirection = [1, 1]", r", [tasks.up]: direction goes with references"),
        ("trials = 4", "trials = 4\nreferences = [1, 2]", r", [tasks.match]: unknown key 'references'; known are design, reference, foil"),
        ("trials = 10", "trials = 1000000000000", r", [tasks.up]: trials must be a whole number from 0 to 10000, got 1000000000000"),
        (_TASKS, "", ": the table [tasks] is missing"),
        (_TASKS, "[tasks]", ", [tasks]: there must be at least one task"),
        (_TASKS, _RESIN + 'foil = "pvc"', ", [tasks.match]: match must be given, as the reference 'resin' is a real"),
        (_TASKS, _RESIN + 'foil = "resin"\nmatch = "pvc"', ", [tasks.match]: foil must have a material to be rendered"),
    ],
)  # fmt: skip
def test_every_mistake_is_named_by_table_and_key(tmp_path, old, new, sentence):
    assert old in SMALL
    with pytest.raises(ValueError, match=re.escape(f"test.toml{sentence}")) as error:
        protocol(tmp_path, SMALL.replace(old, new))
    assert "\n" not in str(error.value)


def test_not_text(tmp_path):
    (tmp_path / "x.toml").write_bytes(b"\xff")
    refused(
        (lambda: Protocol.read(tmp_path / "x.toml"), "this is not a text file in UTF-8"),
        (lambda: Protocol.read(tmp_path / "none.toml"), r"none\.toml", OSError),
    )


def test_the_page_has_every_key_and_column():
    page = (Path(__file__).parents[2] / "docs" / "experiment_files.md").read_text(encoding="utf-8")
    for key in re.findall(r"^#?(\w+) =", template(), flags=re.MULTILINE):
        assert f"`{key}`" in page or key in ("a", "b"), key
    for name, kind in DESIGNS.items():
        (row,) = [line for line in page.splitlines() if line.startswith(f'| `"{name}"`')]
        common = page[page.index("All have") :].partition("\n\n")[0]
        for key in map(key_of, inspect.signature(kind).parameters):
            assert f"`{key}`" in row or f"`{key}`" in common, (name, key)
    for column in columns_of("abx"):
        assert f"`{column}`" in page or column[-1] in "23", column


@pytest.mark.parametrize(
    ("text", "device"),
    [
        ("hand", DeviceText("hand")), ("scripted:a:b.csv", DeviceText("scripted", file="a:b.csv")),
        ("igtl:[::1]:1", DeviceText("igtl", host="::1", port=1)), ("touch", DeviceText("touch")),
        ("touch:Left Hand", DeviceText("touch", name="Left Hand")), ("omega", DeviceText("omega")),
        ("omega:1", DeviceText("omega", index=1)), ("haply", DeviceText("haply", host="localhost", port=10001)),
        ("haply:[::1]:7", DeviceText("haply", host="::1", port=7)),
        ("vrpn:T@host", DeviceText("vrpn", name="T", host="host", port=3883)),
        ("vrpn:T@tcp://host:1", DeviceText("vrpn", name="T", host="host", port=1, tcp=True)),
    ],
)  # fmt: skip
def test_devices_in_words(text, device):
    assert parse_device(text) == device


@pytest.mark.parametrize(
    ("ask", "text", "sentence"),
    [
        *((parse_device, text, "must be hand, scripted:FILE, "
                               "igtl:HOST:PORT, touch") for text in (
            "", "hands", "hand:1", "scripted:", "igtl:", "touch:", "omega:", "omega:x", "omega:-1", "haply:")),
        *((parse_address, text, "must be HOST:PORT, got") for text in ("x", "x:0", "x:65536", ":1", "x:y")),
        *((parse_device, text, "^[a-z]*: must be HOST:PORT, got")
          for text in ("igtl:x", "haply:host", "haply:host:0", "haply:host:x")),
    ],
)  # fmt: skip
def test_devices_that_are_none(ask, text, sentence):
    refused((lambda: ask(text), sentence))
