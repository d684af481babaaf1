"""What data sets have in common: read-only columns, equality, tables for pandas and notebooks."""

from __future__ import annotations

import html
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from burrlab._core import VoxelBone
from burrlab.arguments import real

if TYPE_CHECKING:
    import pandas
    from matplotlib.axis import Axis

Floats: TypeAlias = NDArray[np.float64]
Made = TypeVar("Made")


class DataSet(ABC):
    """What every data set has: equality by its fields, and its table as a DataFrame."""

    @abstractmethod
    def _table(self) -> Mapping[str, Sequence[Any]]:
        """Columns by their names in the CSV file."""

    def to_frame(self) -> pandas.DataFrame:
        """The data as a pandas DataFrame with the columns of the CSV file.

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        return frame(self._table())

    def __eq__(self, other: object) -> bool:
        return equal(self, other) if type(other) is type(self) else NotImplemented

    __hash__ = None  # type: ignore[assignment]  # it holds arrays


def frozen(name: str, values: ArrayLike) -> Floats:
    """A read-only copy of a column; ValueError unless it has one dimension."""
    array = real(values, name)
    if array.ndim != 1:
        raise ValueError(f"{name} must have one dimension: got shape {array.shape}")
    array.flags.writeable = False
    return array


def by_value(kind: type[Made]) -> type[Made]:
    """Of a dataclass with arrays: its objects are equal where all fields are, as data sets."""
    kind.__eq__ = DataSet.__eq__  # type: ignore[method-assign, assignment]
    kind.__hash__ = None  # type: ignore[assignment]
    return kind


def equal(one: Any, other: Any) -> bool:
    """Whether all fields of two data sets of one class are the same; NaN is the same as NaN."""
    return all(_same(getattr(one, f.name), getattr(other, f.name)) for f in fields(one) if f.compare)


def frame(columns: Mapping[str, Sequence[Any]], what: str = "to_frame") -> pandas.DataFrame:
    """The columns as a pandas DataFrame; ImportError with one sentence without pandas."""
    try:
        import pandas
    except ImportError:
        raise ImportError(f"{what} needs pandas: pip install 'burrlab[pandas]'") from None
    return pandas.DataFrame(dict(columns))


def html_table(title: str, columns: Mapping[str, Sequence[Any]]) -> str:
    """A title and a table for notebooks."""
    head = "".join(f"<th>{html.escape(name)}</th>" for name in columns)
    rows = zip(*columns.values(), strict=True)
    body = "".join("<tr>" + "".join(f"<td>{_cell(value)}</td>" for value in row) + "</tr>" for row in rows)
    title = f"<p>{html.escape(title)}</p>"
    return f"{title}<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def data_label(source: str) -> str:
    """The name of data in a legend, which says where they were not measured."""
    return next((f"{kind} data" for kind in ("synthetic", "simulated") if source.startswith(kind)), "data")


def log_ticks(axis: Axis) -> None:
    """Plain numbers at 1, 2 and 5 of every decade of a logarithmic axis."""
    from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter(FormatStrFormatter("%g"))
    axis.set_minor_formatter(NullFormatter())


def _same(a: object, b: object) -> bool:
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return np.array_equal(a, b, equal_nan=True)
    if isinstance(a, VoxelBone) and isinstance(b, VoxelBone):
        return a.digest() == b.digest()
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        return a.keys() == b.keys() and all(_same(a[key], b[key]) for key in a)
    if isinstance(a, list | tuple) and type(a) is type(b):
        return len(a) == len(b) and all(map(_same, a, b))
    return a is b if a is None or b is None else bool(a == b)


def _cell(value: object) -> str:
    if isinstance(value, float):
        return "" if np.isnan(value) else f"{value:.5g}"
    return html.escape(str(value))
