"""Tables of other programs: messy files go in with one command, or are refused with the whole list of faults."""

import io
import json
from functools import partial
from typing import Any

import numpy as np
import pytest
from command_line import call, refusal
from session_scenes import refused

from burrlab import DepthTrace, Indentation, VelocityCurve, fit
from burrlab.cli.descent import read_data
from burrlab.cli.main import command_parser

FORCES, VELOCITIES = [0.5, 1.0, 1.5, 2.0, 2.5], [0.0785, 0.498, 1.4982, 2.75, 3.125]
NAMES = "force=Kraft [N],velocity=v (um/s)"

LVM = """LabVIEW Measurement\t
Separator\tTab
Decimal_Separator\t.
Date\t2023/05/11
Time\t14:22:10.1234567
***End_of_Header***\t
\t
Channels\t2\t\t
Y_Unit_Label\tNewton\tMillimeter/s\t
***End_of_Header***\t\t\t
X_Value\tForce\tVelocity\tComment
0.000000\t5.000000E-1\t7.850000E-2
1.000000\t1.000000E+0\t4.980000E-1
2.000000\t1.500000E+0\t1.498200E+0\tre-zeroed
3.000000\t2.000000E+0\t2.750000E+0
4.000000\t2.500000E+0\t3.125000E+0
"""

#: Name: the text, its encoding, the options of the command, and what it tells.
GO_IN: dict[str, tuple[str, str, list[str], list[str]]] = {
    "Excel, German, Windows": (
        "Versuch 12;;;\nMaschine: Bär;;;\n\nKraft [N];v (µm/s);Datum;\n0,5;78,5;03.05.2023;\n1;498;03.05.2023;\n"
        "1,5;1.498,2;03.05.2023;\n2;2750;;\n2,5;3125;;\n;;;\n",
        "cp1252", ["--columns", "force=Kraft [N],velocity=v (µm/s)", "--unit", "um/s", "--decimal", ","],
        ["lines above the headings (2)", "marks between thousands (1)", "separated by semicolons", "kept apart: Datum\n"],
    ),
    "Excel, French, thin blanks, unit row": (
        "Essai;Force appliquée;Vitesse;Opérateur\n;N;µm/s;\n1;0,5;78,5;Zoë\n2;1;498;Zoë\n3;1,5;1\u202f498,2;Zoë\n"
        "4;2;2\u00a0750;Zoë\n5;2,5;3\u00a0125;\n",
        "utf-8", ["--columns", "force=Force appliquée,velocity=Vitesse", "--unit", "um/s", "--decimal", ","],
        ["lines of units (1)", "marks between thousands (3)", "kept apart: Essai, Opérateur"],
    ),
    "Excel, Italian, quoted headings with commas, repeats side by side": (
        '"Forza, media [N]";"Velocità, 1 [mm/min]";"σ [mm/min]";"Velocità, 2 [mm/min]";σ2\n0,5;4,71;0,6;;\n1,0;29,88;0,6;;\n'
        "1,5;;;89,892;0,6\n2,0;165;0,6;;0,6\n2,5;;;187,5;0,6\n",
        "utf-8-sig",
        ["--columns", "force=Forza, media [N],velocity='Velocità, 1 [mm/min]',velocity=Velocità, 2 [mm/min]",
         "--columns", 'sigma="σ [mm/min]"', "--columns", "sigma=σ2", "--unit", "velocity=mm/min,sigma=mm/min", "--decimal", ","],
        ["sigma from σ [mm/min], σ2 in mm/min", "passed over: empty fields (5)"],
    ),
    "Excel, Spanish, line breaks in headings and cells": (
        '"Fuerza\n[mN]";"Velocidad\n[m/s]";Observación\n500;"0,0000785";"mal\nalineado"\n1.000,0;0,000498;\n1500;1,4982E-03;\n'
        "2000;0,00275;\n2500;0,003125;fin\n",
        "latin-1", ["--columns", "force=Fuerza [mN],velocity=Velocidad [m/s]", "--unit", "force=mN,velocity=m/s",
                    "--decimal", ","],
        ["force from Fuerza [mN] in mN", "kept apart: Observación"],
    ),
    "Excel, English, Unicode text, thousands": (
        'Run\tForce (N)\tSpeed (um/s)\t\t\r\n1\t0.5\t78.5\t\t\r\n2\t1\t498\t\t\r\n3\t1.5\t"1,498.2"\t\t\r\n'
        '4\t2\t"2,750.0"\t\t\r\n5\t2.5\t"3,125.00"\t\t\r\n',
        "utf-16", ["--columns", "force=Force (N),velocity=Speed (um/s)", "--unit", "um/s"],
        ["separated by tabs", "marks between thousands (3)", "kept apart: Run\n"],
    ),
    "LabVIEW": (LVM, "ascii", ["--columns", "force=Force,velocity=Velocity"],
                ["lines above the headings (9)", "kept apart: X_Value, Comment"]),
    "TSV, upper micro and s^-1": (
        "F / N\tv in \u03bcm s^-1\n0.5\t78.5\n1\t498\n1.5\t1498.2\n2\t2750\n2.5\t3125\n",
        "utf-8", ["--columns", "force=F / N,velocity=v in \u00b5m s^-1", "--unit", "velocity=\u00b5m s-1", "--sep", "tab"], [],
    ),
    "comments everywhere, headings in one": (
        "# source: bench 3\n# radius_mm: 3.0\n# Kraft [N], v (um/s)\n0.5, 78.5\n# drift checked\n1, 498\n1.5, 1498.2\n"
        "% pause\n2, 2750\n2.5, 3125\n",
        "utf-8", ["--columns", NAMES, "--unit", "um/s"], ["comments (2)"],
    ),
    "appended exports": (
        "Kraft [N];v (um/s)\n[N];[um/s]\n0,5;78,5\n1;498\n\nKraft [N];v (um/s)\n[N];[um/s]\n1,5;1498,2\n2;2750\n2,5;3125\n",
        "utf-8", ["--columns", NAMES, "--unit", "um/s", "--decimal", ","],
        ["repeated headings (1)", "lines of units (2)"],
    ),
    "Swiss apostrophes, commas and quoted decimals": (
        "Kraft [N],v (um/s),Bemerkung\n\"0,5\",\"78,5\",\n1,498,\"a, b\"\n\"1,5\",\"1'498,2\",\n2,2\u2019750,\n\"2,5\",3'125,\n",
        "utf-8", ["--columns", NAMES, "--unit", "um/s", "--decimal", ",", "--sep", ","],
        ["marks between thousands (3)", "kept apart: Bemerkung"],
    ),
    "columns of blanks": (
        "load cell report\n  kgf     mm/s   n\n  0.050985811      0.0785   1\n  0.101971621     0.498   2\n 0.152957432   1.4982   3\n"
        "0.203943243 2.75 4\n0.254929053 3.125 5\n",
        "ascii", ["--columns", "force=kgf,velocity=mm/s", "--unit", "force=kgf", "--sep", " "], ["kept apart: n"],
    ),
    "integers before a last comma": (
        "Run,Kraft [N],v (um/s)\n1,0.5,78.5,\n2,1,498,\n3,1.5,1498.2,\n4,2,2750,\n5,2.5,3125,\n",
        "utf-8", ["--columns", NAMES, "--unit", "um/s"], ["separated by commas", "kept apart: Run\n"],
    ),
    "our own headings with other columns": (
        "# source: bench 3\nforce_N,day,velocity_mm_s\n0.5,Mo,0.0785\n1,Tu,0.498\n1.5,We,1.4982\n2,,2.75\n2.5,Fr,3.125\n",
        "utf-8", [], ["other columns, kept apart: day\n"],
    ),
    "our own headings, a spreadsheet's error value first": (
        "day,force_N,velocity_mm_s\nMo,0.5,0.0785\n#N/A,1,0.498\n# no row\n#DATA\n#NOTE, no row\n#DIV/0!,1.5,1.4982\nTh,2,2.75\n#NV,2.5,3.125\n",
        "utf-8", [], ["other columns, kept apart: day\n"],
    ),
    "the same in another program's file": (
        "Tag;F;v\nMo;0,5;0,0785\n#N/A;1;0,498\n# no row;1;1\n#DIV/0!;1,5;1,4982\nTh;2;2,75\n#NV;2,5;3,125\n",
        "utf-8", ["--columns", "force=F,velocity=v", "--decimal", ","], ["comments (1)", "kept apart: Tag"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", GO_IN)
def test_messy_files_go_in_with_one_command(name: str, tmp_path: Any, capsys: Any) -> None:
    text, encoding, options, told = GO_IN[name]
    (tmp_path / "a.csv").write_bytes(text.encode(encoding))
    if encoding not in ("utf-8", "utf-8-sig", "ascii", "utf-16"):
        options = [*options, "--encoding", encoding]
    words = ["fit", str(tmp_path / "a.csv"), "--radius", "3", *options]
    code, out, err = call(capsys, *words, "--json", "-")
    assert (code, err.count("\n")) == (0, 1)
    assert all(one in err for one in told), err
    clean = fit(VelocityCurve(FORCES, VELOCITIES, radius=3.0))
    assert json.loads(out)["c_e"] == pytest.approx(clean.c_e, rel=1e-6)
    (curve,) = read_data(command_parser().parse_args(words), "file")
    np.testing.assert_allclose(curve.force, FORCES, rtol=1e-7)
    assert curve.velocity.tolist() == pytest.approx(VELOCITIES, rel=1e-15)
    assert curve.provenance["read"] in err
    assert curve.provenance["read"] in repr(curve)
    assert curve.sigma is None or curve.sigma.tolist() == pytest.approx([0.01] * 5)
    assert all(len(texts) == 5 for texts in curve.others.values())
    curve.to_csv(tmp_path / "b.csv")
    assert VelocityCurve.from_csv(tmp_path / "b.csv") == curve


@pytest.mark.parametrize(
    ("text", "options", "told"),
    [
        ("Kraft [N];v (um/s)\n0,5;78,5\n1,0;498\n", ["--columns", NAMES],
         "a.csv: 4 faults: line 1: column v (um/s) tells um/s, but would be read in mm/s; line 2, column Kraft [N]: "
         "'0,5' has a comma, decimals a point; line 2, column v (um/s): '78,5' has a comma, decimals a point; line 3, "
         "column Kraft [N]: '1,0' has a comma, decimals a point: give unit={'velocity': 'um/s'} (--unit velocity=um/s); "
         "if decimals have a comma, give decimal=',' (--decimal ,)\n"),
        ("Kraft [N];v (um/s)\n0.5;78.5\n", ["--columns", NAMES, "--unit", "um/s", "--decimal", ","],
         "a.csv: 2 faults: line 2, column Kraft [N]: '0.5' has a point, decimals a comma; line 2, column v (um/s): '78.5' "
         "has a point, decimals a comma; if decimals have a point, give decimal='.' (--decimal .)\n"),
        ("Kraft [N];v (um/s)\n1;1.498\n", ["--columns", NAMES, "--unit", "um/s", "--decimal", ","],
         "'1.498' has a point: it may be 1498 or 1.498"),
        ("Kraft [N];v (um/s);\n;78;\n1;-5\n2;fast\n3\n4;1;;note\n-;0\n5;\"1\n6;7\n", ["--columns", NAMES, "--unit", "um/s"],
         "a.csv: 8 faults: line 2, column Kraft [N]: every row needs a force; line 3, column v (um/s): must be a finite "
         "number above 0, in mm/s: got -0.005; line 4, column v (um/s): 'fast' is not a number; line 5: 3 fields are due, "
         "found 1; line 6: 3 fields are due, found 4; line 7, column Kraft [N]: '-' is not a number: leave the field empty "
         "where there is none; line 7, column v (um/s): "),
        # commas that may stand in decimals: rows longer than the headings, values where no heading is, some quoted
        *((f"force_N,velocity_mm_s,note{rows}", ["--sep", ",", *more], f"a.csv, {fault}") for rows, more, fault in [
            ("\n0,5,0,12,\n", [], "line 2: 3 fields are due, found 5: a number with a decimal comma must stand in quot"), ("\n1,5,12,\n", [], "line 2: '1,5,12,' may have commas in"),
            (",remark\n2,3,,\n1,5,0,12,,\n", [], "line 3: '1,5,0,12,,' may have"), (",,\n1,5,0,12,\n", [], "line 2: '1,5,0,12,' may"),
            ("\n\"1,5\",0,12,\n", ["--decimal", ","], "line 2: '1,5,0,12,' may have commas in its decimals: put such numbers in "
             "quotation marks, or take the comma off the end of each line; if commas only separate, give decimal='.' (--decimal .)\n"),
            ("\n0,5,12,\n", ["--decimal", "."], "line 2, column force_N: must be a finite number above 0"),
        ]),
        ("a  b\n1;2\n", ["--columns", NAMES],
         "a.csv: no line of headings has Kraft [N], v (um/s); line 1 has a, b between blanks, for which give sep=' ' "
         "(--sep ' '): give columns={'force': 'its heading', "
         "'velocity': 'its heading'} (--columns force=its heading,velocity=its heading)\n"),
        ("1;2\n", ["--columns", NAMES], "has Kraft [N], v (um/s); add a line of headings to a file without one: give"),
        ("1;2\n3;4\n", ["--columns", "force=1,velocity=2"],
         "a.csv: columns must be headings, not numbers (1, 2); add a line of headings to a file without one\n"),
        ("force_N,velocity_mm_s\n-1,2\n-2,n/a\n", [],
         "a.csv: 4 faults: column force_N: all are below 0: turn their sign; line 2, column force_N: must be a finite number "),
        ("PK\3\4", [], "a.csv: this is a workbook, such as .xlsx or .ods: save it as CSV\n"),
        ("Kraft [N];v (um/s)\n05. Jan;1\n", ["--columns", NAMES, "--unit", "um/s", "--decimal", ","],
         "column Kraft [N]: '05. Jan' is not a number\n"),
        ("Kraft [N];v (um/s)\n", ["--columns", NAMES, "--unit", "um/s"], "a.csv: there is no row below the headings"),
        ("Kraft [N];Kraft [N];v (um/s)\n1;2;3\n", ["--columns", NAMES, "--unit", "um/s"],
         "line 1: column Kraft [N] is there twice"),
        ("v (um/s);Kraft [N]\n1;2\n", ["--columns", "velocity=Kraft [N],force=v (um/s)"],
         "2 faults: line 1: column v (um/s) tells um/s, which is no unit of force (N, mN, cN, daN, kN, gf, kgf, kp, lbf); "
         "line 1: column Kraft [N] tells N, which is no unit of velocity (mm/s, "),
        ("F [kg];v [Skt]\n1;2\n", ["--columns", "force=F [kg],velocity=v [Skt]"],
         "give unit={'force': 'kgf', 'velocity': 'its unit'} (--unit force=kgf,velocity=its unit)\n"),
        ("F [MN];v [\u00b5m/sec]\n1;2\n", ["--columns", "force=F [MN],velocity=v [\u00b5m/sec]"],
         "tells um/s, but would be read in mm/s: give unit={'force': 'its unit', 'velocity': 'um/s'}"),
        ("Kraft in Gramm;v um per second\n1;2\n", ["--columns", "force=Kraft in Gramm,velocity=v um per second"],
         "give unit={'force': 'gf', 'velocity': 'um/s'} (--unit force=gf,velocity=um/s)\n"),
        ("Force..mN.;v_um_s.1\n1;2\n", ["--columns", "force=Force..mN.,velocity=v_um_s.1"],
         "give unit={'force': 'mN', 'velocity': 'um/s'} (--unit force=mN,velocity=um/s)\n"),
        ("F|mN|;v \u00b5m s\u207b\u00b9\n1;2\n", ["--columns", "force=F|mN|,velocity=v \u00b5m s\u207b\u00b9"],
         "give unit={'force': 'mN', 'velocity': 'um/s'} (--unit force=mN,velocity=um/s)\n"),
        ("load_kg;feed mm/Minute\n1;2\n", ["--columns", "force=load_kg,velocity=feed mm/Minute"],
         "give unit={'force': 'kgf', 'velocity': 'mm/min'} (--unit force=kgf,velocity=mm/min)\n"),
        ("force_N;v\n;\u00b5m/s\n1;2\n", ["--columns", "velocity=v"],
         "line 2, column v: tells um/s, but would be read in mm/s: give unit={'velocity': 'um/s'}"),
        ("force_N;velocity_mm_s\n1;2\n", ["--unit", "velocity=um/s"],
         "column velocity_mm_s tells mm/s, but would be read in um/s: give unit={'velocity': 'mm/s'}"),
        ("Kraft [N];v (um/s);sigma_mm_s\n1;2;3\n", ["--columns", NAMES, "--unit", "um/s"],
         "give unit={'velocity': 'um/s', 'sigma': 'mm/s'} (--unit velocity=um/s,sigma=mm/s)\n"),
        ("Kraft [N];v (um/s);window_end_mm\n1;2;3\n", ["--columns", NAMES, "--unit", "velocity=um/s"],
         "line 1: column window_end_mm needs column window_start_mm beside it"),
        # our own headings: unknown columns are kept apart only if no column is missing; all faults are told
        ("force_N,velocity\n1,1\n0,1\n", [],
         "3 faults: line 1: unknown column 'velocity'; known are force_N, velocity_mm_s, sigma_mm_s, window_start_mm, "
         "window_end_mm, status, limit_mm_s; line 1: column velocity_mm_s is missing; line 3, column force_N: must be a finite number "
         "above 0, in N: got 0.0; for a file of another program, give columns, unit, sep, decimal or encoding\n"),
        ("force_N,velocity_mm_s,day,day\n1,1,2,2\n", [], "line 1: column day is there twice"),
        ("force_N,velocity_mm_s\n" + "x,1\n" * 12, [], "line 11, column force_N: 'x' is not a number; and 2 more\n"),
        ("Kr\xe4fte;v\n", [], "a.csv: this is not a text file in UTF-8; for a file of another program, give columns"),
        ("Kr\xe4fte;v\n", ["--sep", ";"], "UTF-8; if Windows wrote it, give encoding='cp1252' (--encoding cp1252)\n"),
        ("Kr\xe4fte;v\n", ["--encoding", "ascii"], "a.csv: this is not a text file in ascii"),
        ("x", ["--encoding", "latin-0"], "encoding must be one such as cp1252 or utf-16, got 'latin-0'"),
        ("", ["--columns", NAMES, "--unit", "furlong"], "unit must be one of N, mN, "),
        ("", ["--unit", "velocity=N"], "unit of velocity must be one of mm/s, "),
        ("", ["--unit", "status=N"], "unit must be of force, velocity, sigma, window_start, window_end, limit: got 'status'"),
        ("", ["--columns", "Kraft"], "--columns: must begin with NAME=, a NAME of force, velocity, "),
        ("", ["--columns", "time=t"], "--columns: no file has a time"),
        ("", ["--columns", "force=a,velocity=a"], "columns must differ: got a, a"),
        ("", ["--sep", ";;"], "sep must be one character, or tab: got ';;'"),
    ],
)  # fmt: skip
def test_refused_with_the_whole_list(
    text: str, options: list[str], told: str, tmp_path: Any, capsys: Any
) -> None:
    (tmp_path / "a.csv").write_bytes(text.encode("latin-1" if "\xe4" in text else "utf-8"))
    assert told in refusal(capsys, "fit", tmp_path / "a.csv", "--radius", "3", *options)


def test_other_kinds_and_what_only_python_can_ask(tmp_path: Any, capsys: Any) -> None:
    press = "# radius_mm: 3\nKraft [mN];Weg (\u00b5m)\n1200;95\n2000;133\n"
    columns = {"force": "Kraft [mN]", "depth": "Weg (\u00b5m)"}
    found = Indentation.from_csv(io.StringIO(press), columns=columns, unit={"force": "mN", "depth": "um"})
    assert (found.force.tolist(), found.depth.tolist(), found.radius) == ([1.2, 2.0], [0.095, 0.133], 3.0)
    rows = "".join(f"{100 * i}\t{500 + 50 * i}\n" for i in range(11))
    trace = DepthTrace.from_csv(
        io.BytesIO(f"Zeit (ms)\tWeg (um)\n{rows}".encode("utf-16")), force=1, radius=3, encoding="utf-16",
        columns={"time": "Zeit (ms)", "immersion": "Weg (um)"}, unit={"time": "ms", "immersion": "um"},
    )  # fmt: skip
    assert trace == DepthTrace(np.arange(11) / 10, 0.5 + np.arange(11) / 20, 1, 3, source="CSV text",
                               provenance={"read": trace.provenance["read"]})  # fmt: skip
    read = partial(VelocityCurve.from_csv, io.StringIO(press))
    refused(
        (lambda: read(columns={"kraft": "x"}), "columns must be of force, velocity, .*: got 'kraft'"),
        (lambda: read(decimal=";"), "decimal must be a point or a comma: got ';'"),
        (lambda: read(encoding="latin-1"), "encoding must be left out for a file that is open as text"),
    )
    # one command reads files of several kinds; names that a kind does not have are for the others
    (tmp_path / "v.csv").write_text("Kraft [mN];v\n500;0.0785\n1000;0.498\n2000;2.75\n")
    (tmp_path / "p.csv").write_text(press)
    words = ["--columns", "force=Kraft [mN],velocity=v,depth=Weg (\u00b5m)", "--unit", "force=mN,depth=um"]
    code, _, err = call(
        capsys, "fit", tmp_path / "v.csv", "--indentation", tmp_path / "p.csv", "--radius", "3", *words
    )
    assert (code, err.count("force from Kraft [mN] in mN")) == (0, 2)


def test_from_dataframe() -> None:
    pandas = pytest.importorskip("pandas", reason="extra `pandas` is not installed")
    frame = pandas.DataFrame(
        {"F [N]": [1, 2, 3], "v": [78.5, None, 498.0], "s": [1.0, 2.0, np.nan], "by": ["a", None, "b"]}
    )
    options = {"force": "F [N]", "velocity": "v", "sigma": "s", "unit": "um/s", "radius": 3.0}
    curve = VelocityCurve.from_dataframe(frame, **options)
    columns = frame.to_dict("list")
    assert curve == VelocityCurve.from_dataframe(columns, **options)
    assert (curve.force.tolist(), curve.ok.tolist(), curve.radius) == ([1, 2, 3], [True, False, True], 3.0)
    assert (curve.velocity[0], *curve.sigma[:2], curve.others["by"]) == (0.0785, 0.001, 0.002, ("a", "", "b"))
    assert "sigma from s in um/s; other columns, kept apart: by" in repr(curve)
    assert VelocityCurve.from_dataframe(curve.to_dataframe(), radius=3.0) == VelocityCurve(
        curve.force, curve.velocity, curve.sigma, radius=3.0,
        provenance={"read": "force from force_N in N, velocity from velocity_mm_s in mm/s, sigma from sigma_mm_s in mm/s"},
    )  # fmt: skip
    beside = {"velocity": ["v", "w"], "sigma": ["s", "s2"], "unit": "um/s"}
    wide = VelocityCurve.from_dataframe(columns | {"w": [60, 70, 400], "s2": [3, 3, 3]}, **options | beside)
    assert [*wide.force, *wide.velocity] == [1, 1, 2, 3, 3, 0.0785, 0.06, 0.07, 0.498, 0.4]
    read = partial(VelocityCurve.from_dataframe, frame, **options)
    refused(
        (lambda: read(velocity="w"), "DataFrame: no column is w; there are F .N., v, s, by$"),
        (lambda: read(velocity=["v", "s"], sigma="by"), "columns of sigma must be 2 or none: got by"),
        (lambda: read(sigma="by"), "Frame: 2 faults: row 1, column by: 'a' is not a number; row 3, column by: 'b' is"),
        (lambda: read(unit="mN"), "column F .N. tells N, but would be read in mN"),
        (lambda: VelocityCurve.from_dataframe(pandas.concat({"lab": frame}, axis=1)),
         "columns must have one level of names, got a MultiIndex of 2"),
    )  # fmt: skip
