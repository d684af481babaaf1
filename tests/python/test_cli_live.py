"""Views and effects of the commands session and replica: options, refusals and final reports."""

import json

import pytest
from command_line import call, refusal, result
from replica_scenes import soon

import burrlab
import burrlab.cli.session as cli_live
from burrlab.cli import main
from burrlab.effects.companion import Companion
from burrlab.session.network import block_recipe, make_bone

FAST = ["--device", "hand", "--voxel", "0.4", "--radius", "3", "--seed", "5"]
BLOCK = block_recipe((8, 8, 4), 0.2, origin=(-3.9, -3.9, -3.9))


@pytest.fixture
def shown(monkeypatch):
    """Replaces the page: notes its arguments and waits for the session's end."""
    served = {}

    def serve(source, **options):
        served.update(options, source=source)
        served.get("meanwhile", lambda: None)()
        source.wait(60.0)

    monkeypatch.setattr(cli_live, "pyvista", lambda: None)
    monkeypatch.setattr(cli_live, "check_page", lambda **_: None)
    monkeypatch.setattr(cli_live, "serve", serve)
    return served


def leader(seconds):
    """A published block that a hand cuts."""
    return burrlab.Session(
        burrlab.StartingBone(make_bone(BLOCK), source=BLOCK),
        (burrlab.Burr(2.0), burrlab.materials["bone"]),
        burrlab.HandDevice((0.0, 0.0, 2.2), strokes_after=0.0),
        seed=11,
        duration=seconds,
        publish=0,
        clock=burrlab.Clock(realtime=False),
    )


@pytest.mark.parametrize("option", ["effects", "stereo"])
def test_what_needs_a_place_to_be_seen(option, capsys):
    assert (
        refusal(capsys, "replica", "127.0.0.1:1", f"--{option}")
        == f"burrlab replica: --{option} goes with --view or --web\n"
    )


def test_effects_of_a_session_are_reported(shown, tmp_path, capsys):
    file = tmp_path / "said.json"
    arguments = ["session", *FAST, "--duration", "1.5", "--no-realtime", "--web", "--effects", "--stereo"]
    said, plain = call(capsys, *arguments, "--json", file)[1], json.loads(file.read_text())
    session, companion, told = shown["source"], shown["effects"], plain["effects"]
    assert shown["stereo"]
    assert not companion.running
    assert companion.seed == told["seed"] == 5
    assert told["frames"] == companion.report().frames > 5
    assert told["budget"] == 0.02
    assert told["balance_mm3"]["dust"]["made"] == pytest.approx(session.snapshot()[0].removed) != 0
    assert told["balance_mm3"]["water"]["made"] > 0
    assert all(account["exact"] for account in told["balance_mm3"].values())
    assert f"effects at assumed rates, seed 5: {told['frames']} frames of at most" in said
    assert "budget 20 ms: " in said
    assert max(len(line) for line in str(companion.report()).splitlines()) <= 80  # a terminal's width
    assert f"dust: made {told['balance_mm3']['dust']['made']:.3f}, present " in said


def test_without_effects_nothing_is_said_of_them(shown, capsys):
    told = result(capsys, "session", *FAST, "--duration", "0.3", "--web")
    assert (shown["effects"], shown["stereo"], "effects" in told) == (None, False, False)


def test_effects_of_a_replica_are_reported(shown, tmp_path, capsys):
    """Effects are also reported if a duration ends the replica while it is shown."""
    file = tmp_path / "said.json"
    with leader(60.0) as session:
        assert soon(lambda: session.snapshot()[0].removed > 0)
        where = ["replica", f"127.0.0.1:{session.port}", "--web", "--effects"]
        assert main([*where, "--duration", "1.5"]) == 0
        assert shown["source"].wait(0.0)
        assert not shown["effects"].running
        assert "ended (stopped): tick " in capsys.readouterr().out

        def meanwhile():
            assert soon(lambda: shown["effects"].balance()["dust"].made > 0)
            session.stop()

        shown["meanwhile"] = meanwhile
        assert main([*where, "--json", str(file)]) == 0
    plain = json.loads(file.read_text())
    assert (plain["digest"], plain["effects"]["seed"]) == (session.snapshot()[0].digest(), 11)
    assert plain["effects"]["balance_mm3"]["dust"]["exact"]
    assert 0 < plain["effects"]["balance_mm3"]["dust"]["made"] <= session.snapshot()[0].removed * (1 + 1e-12)
    assert "effects at assumed rates, seed 11: " in capsys.readouterr().out


def test_effects_that_ended_early_are_said(monkeypatch):
    assert cli_live.end_effects(None) == ("", {})
    with leader(0.3) as session:
        companion = Companion(session, seed=1).start()
        session.wait()
    monkeypatch.setattr(Companion, "error", "no memory")
    text, plain = cli_live.end_effects(companion)
    assert "\neffects ended early: no memory\n" in text
    assert plain["effects"]["error"] == "no memory"
