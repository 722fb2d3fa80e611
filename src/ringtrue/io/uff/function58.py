"""Data set 58, a function over time or frequency: one is read and written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ringtrue.core.arrays import Any_, Float
from ringtrue.core.channels import LINEAR
from ringtrue.core.dofs import DofSet
from ringtrue.core.signals import FrfSet
from ringtrue.errors import DataError
from ringtrue.io.files import atomic_write
from ringtrue.io.times import axis_factor
from ringtrue.io.uff.datasets import LINE, DataSet, numbers, parse_int, reals, row, words

# function types
TIME = 1
FRF = 4
TRANSMISSIBILITY = 5
COHERENCE = 6
# data types of abscissae
TIME_AXIS = 17
FREQUENCY_AXIS = 18
_HEADER = 11  # lines
_ENDS = {  # fields of line 6 and their columns
    "kind": 5,
    "number": 10,
    "version": 5,
    "load case": 10,
    "response name": 11,
    "response node": 10,
    "response direction": 4,
    "reference name": 11,
    "reference node": 10,
    "reference direction": 4,
}
_FORM = {"ordinate": 10, "count": 10, "even": 10, "first": 13, "step": 13, "z": 13}  # line 7
_AXIS = {"data type": 10, "length": 5, "force": 5, "temperature": 5, "label": 21, "unit": 21}


class _Ordinate(NamedTuple):
    """How the ordinates are stored."""

    is_complex: bool
    is_double: bool

    def widths(self, even: bool) -> tuple[int, ...]:
        """Columns of the numbers of a line of text; the abscissa of uneven data is single."""
        if not self.is_double:
            return (13,) * 6
        if even:
            return (20,) * 4
        return (13, 20, 20) if self.is_complex else (13, 20, 13, 20)

    def per_point(self, even: bool) -> int:
        """Numbers of a point."""
        return 1 + self.is_complex + (not even)


_ORDINATES = {  # by the ordinate type of line 7
    2: _Ordinate(is_complex=False, is_double=False),
    4: _Ordinate(is_complex=False, is_double=True),
    5: _Ordinate(is_complex=True, is_double=False),
    6: _Ordinate(is_complex=True, is_double=True),
}


@dataclass(frozen=True, slots=True)
class Axis:
    """What an axis measures: specific data type, exponents of length, force and temperature, label,
    unit.
    """

    data_type: int
    exponents: tuple[int, int, int]
    label: str
    unit: str


@dataclass(frozen=True, slots=True, eq=False)
class UffFunction:
    """One function at a nodal degree of freedom.

    Attributes
    ----------
    kind : int
        Function type: 1 time, 2 auto spectrum, 3 cross spectrum, 4 FRF, 5 transmissibility, 6
        coherence, ...
    ids : tuple of str
        The five lines of text.
    response, reference : (node, direction)
    names : tuple of str
        Entities of response and reference.
    x : (n,) float64
        Abscissa, Hz or s where its unit is another one of frequency or time.
    y : (n,) float64 or complex128
        Ordinates.
    even : bool
        The abscissa has one step.
    axes : tuple of Axis
        Abscissa, ordinate, its denominator, z.
    """

    kind: int
    ids: tuple[str, ...]
    response: tuple[int, int]
    reference: tuple[int, int]
    names: tuple[str, str]
    x: Float
    y: Any_
    even: bool
    axes: tuple[Axis, ...]


def read_function(block: DataSet) -> UffFunction:
    """The function of a data set.

    Raises
    ------
    DataError
        If the header or the samples are damaged or cut.
    """
    lines = _head(block)
    kind, response, reference, names = _ends(row(lines, 5))
    values = numbers(row(lines, 6), tuple(_FORM.values()))
    if not np.isfinite(values).all():
        raise DataError(
            f"the line of the form has values that are not finite: {row(lines, 6).strip()!r}"
        )
    form = dict(zip(_FORM, values, strict=True))
    count = int(form["count"])
    even = form["even"] != 0
    ordinate = _ORDINATES.get(int(form["ordinate"]))
    if ordinate is None or count < 1:
        raise DataError(
            f"ordinate type {int(form['ordinate'])} with {count} points; types are 2, 4, 5, 6 "
            "with 1 or more"
        )
    table = _samples(block, ordinate, count, even).reshape(count, -1)
    if even:
        x = form["first"] + form["step"] * np.arange(count, dtype=np.float64)
    else:
        x = table[:, 0].copy()
        table = table[:, 1:]
    y = table[:, 0] + 1j * table[:, 1] if ordinate.is_complex else table[:, 0].copy()
    axes = tuple(_axis(words(line, tuple(_AXIS.values()))) for line in lines[7:11])
    x = x * axis_factor(axes[0].unit)
    texts = tuple(line.strip() for line in lines[:5])
    return UffFunction(
        kind=kind,
        ids=texts,
        response=response,
        reference=reference,
        names=names,
        x=x,
        y=y,
        even=even,
        axes=axes,
    )


def _head(block: DataSet) -> list[str]:
    text = (
        block.text if block.binary is not None else b"\n".join(_split_lines(block.text, _HEADER)[0])
    )
    lines = text.decode("latin-1").splitlines()
    if len(lines) < _HEADER:
        raise DataError(f"the header of data set 58 has {len(lines)} of {_HEADER} lines")
    return lines


def _split_lines(text: bytes, count: int) -> tuple[list[bytes], bytes]:
    """The first lines and what follows, without splitting the rest."""
    at = 0
    lines = []
    for _ in range(count):
        end = LINE.search(text, at)
        if end is None:
            break
        lines.append(text[at : end.start()])
        at = end.end()
    return lines, text[at:]


def _ends(line: str) -> tuple[int, tuple[int, int], tuple[int, int], tuple[str, str]]:
    """Function type, response, reference and the names of both."""
    fields = dict(zip(_ENDS, words(line, tuple(_ENDS.values())), strict=True))
    try:
        for name in ("kind", "number", "version", "load case"):
            parse_int(fields[name])
        response = _end(fields, "response")
        reference = _end(fields, "reference")
    except DataError:  # columns shifted by the vendor: names without blanks, divided by blanks
        free = line.split()
        if len(free) != len(_ENDS):
            raise
        fields = dict(zip(_ENDS, free, strict=True))
        response = _end(fields, "response")
        reference = _end(fields, "reference")
    names = fields["response name"], fields["reference name"]
    return parse_int(fields["kind"]), response, reference, names


def _end(fields: Mapping[str, str], end: str) -> tuple[int, int]:
    return parse_int(fields[f"{end} node"]), parse_int(fields[f"{end} direction"])


def _axis(fields: Sequence[str]) -> Axis:
    try:
        kind, *exponents = (parse_int(f) for f in fields[:4])
    except DataError:
        return Axis(0, (0, 0, 0), "", "")
    return Axis(kind, (exponents[0], exponents[1], exponents[2]), fields[4], fields[5])


def _samples(block: DataSet, ordinate: _Ordinate, count: int, even: bool) -> Float:
    """The numbers as they are stored, flat."""
    per_point = ordinate.per_point(even)
    wanted = count * per_point
    if block.binary is None:
        return reals(_split_lines(block.text, _HEADER)[1], ordinate.widths(even), wanted)
    order = ">" if block.big_endian else "<"
    if ordinate.is_double and not even and len(block.binary) < wanted * 8:
        # the abscissa of uneven double data is single
        return _mixed(block.binary, order, per_point - 1, count)
    size = 8 if ordinate.is_double else 4
    if len(block.binary) < wanted * size:
        raise DataError(
            f"{len(block.binary)} bytes of samples where {wanted * size} are announced; the file "
            "is cut"
        )
    return np.frombuffer(block.binary, f"{order}f{size}", wanted).astype(np.float64)


def _mixed(raw: bytes, order: str, ordinates: int, count: int) -> Float:
    point = np.dtype([("x", f"{order}f4"), ("y", f"{order}f8", (ordinates,))])
    if len(raw) < count * point.itemsize:
        raise DataError(
            f"{len(raw)} bytes of samples where {count * point.itemsize} are announced; the file "
            "is cut"
        )
    table = np.frombuffer(raw, point, count)
    return np.asarray(np.column_stack([table["x"], table["y"]]), dtype=np.float64).ravel()


_CODE = {"displacement": 8, "velocity": 11, "acceleration": 12, "force": 13}


def write_frf_sets(path: str | Path, frfs: FrfSet) -> None:
    """Write the FRFs, and coherence where known, as data sets 58 of double precision.

    Raises
    ------
    DataError
        If a channel id is not a point and direction such as `101+Z`.
    """
    outputs = DofSet.parse(c.id for c in frfs.outputs)
    inputs = DofSet.parse(c.id for c in frfs.inputs)
    with atomic_write(path) as part, part.open("wb") as file:
        for j in range(len(inputs)):
            for i, channel in enumerate(frfs.outputs):
                points = _point_fields(outputs, i) + " " + _point_fields(inputs, j)
                # a motion about an axis has the code of one along it: the direction says which
                motion = _CODE.get(LINEAR.get(channel.quantity, channel.quantity), 0)
                codes = (FREQUENCY_AXIS, motion, _CODE["force"], 0)
                head = ["FRF", *("NONE",) * 4, f"{FRF:5d}{0:10d}{0:5d}{0:10d} {points}"]
                file.write(_data_set(head, codes, frfs.freqs, frfs.data[:, i, j]))
                coherence = frfs.coherence[:, i, j]
                if np.isfinite(coherence).all():
                    head[0] = "Coherence"
                    head[5] = f"{COHERENCE:5d}{0:10d}{0:5d}{0:10d} {points}"
                    codes = (FREQUENCY_AXIS, 0, 0, 0)
                    file.write(_data_set(head, codes, frfs.freqs, coherence))


def _point_fields(dofs: DofSet, i: int) -> str:
    return f"{'NONE':<10}{dofs.node[i]:10d}{dofs.direction[i]:4d}"


def _data_set(head: Sequence[str], codes: Sequence[int], x: Float, y: Any_) -> bytes:
    """A data set 58 as text; an uneven abscissa has six digits.

    Parameters
    ----------
    head : sequence of str
        Lines 1 to 6.
    codes : sequence of int
        Specific data types of abscissa, ordinate, denominator and z.
    x : (n,) float64
    y : (n,) float64 or complex128
    """
    ordinate = 6 if np.iscomplexobj(y) else 4
    step = float(x[-1] - x[0]) / (x.size - 1)
    even = bool(np.abs(np.diff(x) - step).max() < 1e-3 * abs(step))
    form = f"{ordinate:10d}{x.size:10d}{even:10d}{float(x[0]):13.6E}{step:13.6E}{0.0:13.5E}"
    axes = [f"{code:10d}{0:5d}{0:5d}{0:5d} {'NONE':<20} {'NONE':<20}" for code in codes]
    table = np.ascontiguousarray(y).view(np.float64).reshape(x.size, -1)
    cells = ["%20.12E"] * table.shape[1]
    points_a_line = 4 // len(cells)
    if not even:
        cells = ["%13.5E", *cells]
        table = np.column_stack([x, table])
        points_a_line = 2 // (len(cells) - 1)
    points = [("".join(cells)) % tuple(values) for values in table.tolist()]
    lines = ["".join(points[k : k + points_a_line]) for k in range(0, len(points), points_a_line)]
    text = "\n".join(["    -1", f"{58:6d}", *head, form, *axes, *lines, "    -1", ""])
    return text.encode("latin-1", "replace")
