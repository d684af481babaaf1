"""The folder of an experiment, as BIDS 1.10.0 has behavioural data."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from burrlab._core import __version__
from burrlab.psychophysics.experiment import tsv_text
from burrlab.psychophysics.experiment.locked import locked, synced_write

BIDS_VERSION = "1.10.0"

_COLUMNS = ("participant_id", "simulated", "selected_by")
_PARTICIPANTS: Mapping[str, Any] = {
    "participant_id": {"Description": "Label of the subject"},
    "simulated": {
        "Description": "Whether the subject is a program",
        "Levels": {"yes": "a simulated subject", "no": "a person"},
    },
    "selected_by": {
        "Description": "How the subject was chosen by the outcome of an earlier experiment, if so"
    },
}


class ExperimentFolder:
    """Where everything of an experiment lies; files are made where they are missing, and none is replaced.

    Parameters
    ----------
    path : path
    name : str
        Of the experiment.
    """

    def __init__(self, path: str | os.PathLike[str], name: str) -> None:
        self.path, self.name = Path(path), name

    def answers(self, subject: str, task: str) -> Path:
        """The file of answers of a subject in a task; its side-car lies beside it."""
        return self.path / f"sub-{subject}" / "beh" / f"sub-{subject}_task-{task}_events.tsv"

    def log(self, subject: str, task: str) -> Path:
        """What the experimenter sees of it."""
        return self._source(subject) / f"sub-{subject}_task-{task}_log.txt"

    def trace(self, subject: str, task: str, phase: str, trial: int, interval: int) -> Path:
        """The trace of an interval."""
        stem = f"sub-{subject}_task-{task}_{phase}-{trial:03d}_interval-{interval}"
        return self._source(subject) / f"{stem}_trace.h5"

    def _source(self, subject: str) -> Path:
        # Not of a form that BIDS knows: it leaves what is in sourcedata alone.
        return self.path / "sourcedata" / f"sub-{subject}" / "beh"

    def prepare(self) -> None:
        """The files that describe the folder, where they are missing.

        Raises
        ------
        OSError
            If they cannot be written.
        """
        self.path.mkdir(parents=True, exist_ok=True)
        described = {
            "Name": self.name,
            "BIDSVersion": BIDS_VERSION,
            "DatasetType": "raw",
            "GeneratedBy": [{"Name": "burrlab", "Version": __version__}],
        }
        readme = (
            f"{self.name}\n\nAnswers of a psychophysical experiment with virtual bone burring, made by burrlab "
            f"{__version__}.\nOne file a subject and task: sub-LABEL/beh/sub-LABEL_task-LABEL_events.tsv, with what the run was "
            "in the\nJSON beside it.\n"
        )
        for file, text in (
            ("dataset_description.json", json.dumps(described, indent=1, ensure_ascii=False) + "\n"),
            ("participants.json", json.dumps(_PARTICIPANTS, indent=1) + "\n"),
            ("README", readme),
        ):
            try:
                stream = (self.path / file).open("x", encoding="utf-8", newline="")
            except FileExistsError:
                continue
            try:
                with stream:
                    stream.write(text)
            except OSError as error:
                (
                    self.path / file
                ).unlink()  # a part of it would stay, as whoever has written it would not again
                raise OSError(error.errno, error.strerror, os.fspath(self.path / file)) from None

    def add(self, subject: str, *, simulated: bool, selected_by: str | None = None) -> None:
        """Enters a subject in participants.tsv, unless it is there.

        Raises
        ------
        ValueError
            If simulated subjects would be among others, the subject is entered as something else, or the file is not right.
        OSError
            If it cannot be written.
        """
        self.prepare()
        path = self.path / "participants.tsv"
        row = dict(
            zip(
                _COLUMNS,
                (f"sub-{subject}", "yes" if simulated else "no", selected_by or tsv_text.NOTHING),
                strict=True,
            )
        )
        file = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o666)
        with locked(file, path, wait=True):
            columns = _mend(file, path, row)
            for other, entry in _participants(path).items():
                if entry["simulated"] != row["simulated"]:
                    raise ValueError(
                        f"{path}: simulated subjects and people do not go into one folder: sub-{other} has simulated "
                        f"{entry['simulated']}, sub-{subject} {row['simulated']}"
                    )
                if other == subject:
                    return
            # A laboratory adds columns of its own, such as age, or moves ours.
            synced_write(file, path, tsv_text.line([row.get(column, tsv_text.NOTHING) for column in columns]))

    def participants(self) -> dict[str, dict[str, str]]:
        """What participants.tsv says of each subject, by label; empty without the file.

        Raises
        ------
        ValueError
            If the file is not right: with the line.
        """
        path = self.path / "participants.tsv"
        return _participants(path) if path.exists() else {}


def _mend(file: int, path: Path, row: Mapping[str, str]) -> tuple[str, ...]:
    """The columns of participants.tsv, written where they are not; what a kill broke off is cut.

    A last line that lacks its end alone, as an editor may leave it, gets it.
    """
    found = path.read_bytes()
    content, torn = tsv_text.split_torn(found)
    own = tsv_text.line(_COLUMNS)
    if torn and not content and own.startswith(torn):
        os.ftruncate(file, 0)
    elif torn:
        columns = tsv_text.parse(os.fspath(path), content or torn).columns
        *before, last = torn.decode(errors="replace").split("\t")
        whole = row.get(columns[-1], tsv_text.NOTHING)
        if not content or (
            len(before) == len(columns) - 1 and not (last != whole and whole.startswith(last))
        ):
            synced_write(file, path, b"\n")
            return columns
        os.ftruncate(file, len(content))
    if content:
        return tsv_text.parse(os.fspath(path), content).columns
    synced_write(file, path, own)
    return _COLUMNS


def _participants(path: Path) -> dict[str, dict[str, str]]:
    table = tsv_text.parse(os.fspath(path), path.read_bytes())
    for column in _COLUMNS[:2]:
        if column not in table.columns:
            raise ValueError(f"{path}, line 1: column {column} is missing")
    found: dict[str, dict[str, str]] = {}
    for line, fields in table.rows:
        subject = fields["participant_id"].removeprefix("sub-")
        if subject in found:
            raise ValueError(f"{path}, line {line}: subject {subject} is there twice")
        if fields["simulated"] not in ("yes", "no"):
            raise ValueError(
                f"{path}, line {line}, column simulated: must be yes or no, got {fields['simulated']!r}"
            )
        found[subject] = {**fields, "participant_id": subject}
    return found
