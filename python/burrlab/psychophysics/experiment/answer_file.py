"""Writing answers: each is on disk before the next trial, and nothing is ever overwritten."""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Self

from burrlab.files import new_part, write_synced
from burrlab.json_text import in_one_line
from burrlab.psychophysics.design import Order
from burrlab.psychophysics.experiment import tsv_text
from burrlab.psychophysics.experiment.answer_reading import read_own_rows, replay
from burrlab.psychophysics.experiment.answer_row import Answer, Row, RowReader, as_text, columns_of
from burrlab.psychophysics.experiment.locked import lock, sync_folder, synced_write
from burrlab.psychophysics.experiment.side_car import SideCar, read_side_car, side_car_path


class AnswerFile:
    """A file that the answers of one run go to; make one by `create` or `open`.

    While it is open no other process can open it.

    Attributes
    ----------
    path : Path
    side_car : SideCar
        As it was at the start of the run.
    notes : tuple of str
        What the experimenter should know: a last line that was broken off and cut.
    end : float
        Of the last answer, from the start of the run [s].
    """

    def __init__(
        self, path: Path, file: int, side_car: SideCar, end: float, reader: RowReader, lines: int,
        columns: Sequence[str] = (),
    ) -> None:  # fmt: skip
        self.path, self.side_car = path, side_car
        self.notes: tuple[str, ...] = ()
        self._file: int | None = file
        self._reader, self._lines = reader, lines
        self._columns = columns or columns_of(side_car.task)
        # The wall clock may have been set back since the start: onsets never go back.
        started = datetime.fromisoformat(side_car.started)
        self.end = end
        self._zero = time.monotonic() - max((datetime.now(UTC) - started).total_seconds(), end)

    @classmethod
    def create(cls, path: str | os.PathLike[str], side_car: SideCar) -> Self:
        """A new file with its side-car, for the first trial; the folder is made.

        Parameters
        ----------
        path : path
            Ends in .tsv.
        side_car : SideCar

        Raises
        ------
        FileExistsError
            If the file, or one where its side-car belongs, is there.
        ValueError
            If the path does not end in .tsv.
        OSError
            If it cannot be written.
        """
        path = Path(path)
        if path.suffix != ".tsv":
            raise ValueError(f"path must end in .tsv, got {path}")
        path.parent.mkdir(parents=True, exist_ok=True)
        if side_car_path(path).exists():
            raise FileExistsError(f"path must be a new file, {side_car_path(path)} exists")
        try:
            file = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_EXCL, 0o666)
        except FileExistsError:
            raise FileExistsError(f"path must be a new file, {path} exists: resume the run") from None
        with _closed_on_error(file):
            lock(file, path)
            return cls._begin(path, file, side_car)

    @classmethod
    def open(cls, path: str | os.PathLike[str], order: Order, side_car: SideCar) -> Self:
        """The file of a run that was ended early, for its next trial.

        Parameters
        ----------
        path : path
        order : Order
            At its beginning; it is fed with the answers that are there, and its next trial is the one to be asked.
        side_car : SideCar
            Of the same run, as the protocol has it now.

        Returns
        -------
        AnswerFile
            A last line that was broken off is cut, and the notes say so; one that lacks its end alone gets it.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        BlockingIOError
            If another process has it open.
        ValueError
            If the protocol was changed since the start, with what; the columns were, or a row is not right (see
            `read_answers`) or not the answer to the order's trial, with its line.
        OSError
            If it cannot be read and written.
        """
        path = Path(path)
        try:
            file = os.open(path, os.O_RDWR | os.O_APPEND)
        except FileNotFoundError:
            raise FileNotFoundError(f"{path}: there is no such run to resume") from None
        with _closed_on_error(file):
            lock(file, path)
            first = read_side_car(path)
            if first is None:
                return cls._begin_again(path, file, side_car)
            if changes := first.differences(side_car):
                told = in_one_line("; ".join(changes), 2000)
                raise ValueError(f"{path}: the protocol was changed since the run began: {told}")
            found = path.read_bytes()
            rows, content, torn = read_own_rows(os.fspath(path), found, first.task)
            columns = _checked_columns(path, content, first)
            replay(os.fspath(path), rows, order)
            reader = RowReader(first.task)
            for line, row in rows:
                reader.add(line, row)
            end = max((_end(row) for _, row in rows), default=0.0)
            result = cls(path, file, first, end, reader, content.count(b"\n"), columns)
            if len(content) > len(found):
                synced_write(file, path, content[len(found) :])
            if torn:
                os.ftruncate(file, len(content))
                os.fsync(file)
                result.notes = (
                    f"{path}: the last line was broken off after {len(torn)} bytes and is cut; its trial is asked again",
                )
        return result

    @classmethod
    def _begin(cls, path: Path, file: int, side_car: SideCar) -> Self:
        """Column names first: whoever finds them without a side-car knows that no trial was asked."""
        synced_write(file, path, _head(side_car))
        text = json.dumps(side_car.to_dict(), indent=1, allow_nan=False, ensure_ascii=False) + "\n"
        with new_part(side_car_path(path)) as part:
            write_synced(part, text.encode())
            part.rename(side_car_path(path))
        sync_folder(path.parent)
        return cls(path, file, side_car, 0.0, RowReader(side_car.task), 1)

    @classmethod
    def _begin_again(cls, path: Path, file: int, side_car: SideCar) -> Self:
        """A run that was killed while its files were made, or no run of this program."""
        if not _head(side_car).startswith(path.read_bytes()) or side_car_path(path).exists():
            raise ValueError(
                f"{path}: this is no run of this program, its side-car {side_car_path(path).name} is missing"
            )
        os.ftruncate(file, 0)
        return cls._begin(path, file, side_car)

    def elapsed(self) -> float:
        """Time since the start of the run [s], across resumptions; for the onset of an answer."""
        return time.monotonic() - self._zero

    def append(self, answer: Answer) -> None:
        """Writes an answer; when it returns, the answer is on the disk.

        Parameters
        ----------
        answer : Answer
            To the trial that follows those in the file.

        Raises
        ------
        ValueError
            If it is no answer of the task, not of the trial that is due, or the file is closed.
        OSError
            If it cannot be written; the file is then as it was.
        """
        if self._file is None:
            raise ValueError(f"{self.path} is closed")
        task = self.side_car.task
        line = as_text(Row.of(answer), task, self._columns)
        fields = line.decode().rstrip("\n").split("\t")
        try:
            # As it will be read: what cannot be read back is not written.
            row = self._reader.parse(dict(zip(self._columns, fields, strict=True)))
        except ValueError as error:
            raise ValueError(f"answer: {error}") from None
        synced_write(self._file, self.path, line)
        self._lines += 1
        self._reader.add(self._lines, row)
        self.end = max(self.end, _end(row))

    def close(self) -> None:
        """Ends writing; another process may open the file."""
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __repr__(self) -> str:
        state = "closed" if self._file is None else "open"
        return f"AnswerFile({os.fspath(self.path)!r}, {self._lines - 1} answers, {state})"


def _end(row: Row) -> float:
    """Of an answer, from the start of the run [s]."""
    return row.onset + (row.duration or 0.0) + (row.response_time or 0.0)


def _checked_columns(path: Path, content: bytes, side_car: SideCar) -> tuple[str, ...]:
    """ValueError unless the columns are those that `append` writes: a row goes to the end, by its place."""
    due, found = columns_of(side_car.task), tsv_text.parse(os.fspath(path), content).columns
    if found == due[:-1]:  # begun when there were no repeats
        return found
    if found != due:
        place = next(
            (i for i, (one, other) in enumerate(zip(due, found, strict=False)) if one != other),
            min(len(due), len(found)),
        )
        one, other = (repr(names[place]) if place < len(names) else "none" for names in (due, found))
        raise ValueError(
            f"{path}, line 1: to go on, the columns must be as they were written: column {place + 1} was {one}, is now {other}"
        )
    return found


def _head(side_car: SideCar) -> bytes:
    return tsv_text.line(columns_of(side_car.task))


@contextlib.contextmanager
def _closed_on_error(file: int) -> Iterator[None]:
    try:
        yield
    except BaseException:
        os.close(file)
        raise
