"""Data set 58, a function over time or frequency: one is read and written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Any_, Float
from ringtrue.core.channels import LINEAR
from ringtrue.core.dofs import DofSet
from ringtrue.core.signals import FrfSet
from ringtrue.errors import DataError
from ringtrue.io.files import atomic_write
from ringtrue.io.times import axis_factor
from ringtrue.io.uff.datasets import LINE, DataSet, numbers, parse_int, reals, words


class FunctionType(IntEnum):
    """What a function is, of those that are read."""

    TIME = 1
    FRF = 4
    TRANSMISSIBILITY = 5
    COHERENCE = 6


class AxisType(IntEnum):
    """Specific data types of abscissae."""

    TIME = 17
    FREQUENCY = 18


FRF_TYPES = (FunctionType.FRF, FunctionType.TRANSMISSIBILITY)


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
# line 7
_FORM = {"ordinate": 10, "count": 10, "even": 10, "first": 13, "step": 13, "z": 13}
_AXIS = {
    "data type": 10,
    "length": 5,
    "force": 5,
    "temperature": 5,
    "label": 21,
    "unit": 21,
}


_ORDINATES = {  # by the ordinate type of line 7: whether they are complex, and double
    2: (False, False),
    4: (False, True),
    5: (True, False),
    6: (True, True),
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
    body = b""
    if block.binary is None:
        lines, body = _split_lines(block.text, _HEADER)
    else:
        lines = block.text.splitlines()
    head = [line.decode("latin-1") for line in lines]
    if len(head) < _HEADER:
        raise DataError(f"the header of data set 58 has {len(head)} of {_HEADER} lines")
    kind, response, reference, names = _ends(head[5])
    values = numbers(head[6], tuple(_FORM.values()))
    if not np.isfinite(values).all():
        raise DataError(
            f"the line of the form has values that are not finite: {head[6].strip()!r}"
        )
    form = dict(zip(_FORM, values, strict=True))
    count = int(form["count"])
    even = form["even"] != 0
    ordinate = int(form["ordinate"])
    if ordinate not in _ORDINATES or count < 1:
        raise DataError(
            f"ordinate type {ordinate} with {count} points; types are 2, 4, 5, 6 with 1 or more"
        )
    is_complex, is_double = _ORDINATES[ordinate]
    size = 1 + is_complex + (not even)  # numbers of a point
    if block.binary is not None:
        table = _stored(block, is_double, even, count, size)
    else:
        widths: tuple[int, ...] = (13,) * 6
        if is_double and even:
            widths = (20,) * 4
        elif is_double:  # the abscissa of uneven data is single
            widths = (13, 20, 20) if is_complex else (13, 20, 13, 20)
        table = reals(body, widths, count * size).reshape(count, size)
    if even:
        x = form["first"] + form["step"] * np.arange(count, dtype=np.float64)
    else:
        x = table[:, 0].copy()
        table = table[:, 1:]
    axes = tuple(_axis(words(line, tuple(_AXIS.values()))) for line in head[7:11])
    return UffFunction(
        kind=kind,
        ids=tuple(line.strip() for line in head[:5]),
        response=response,
        reference=reference,
        names=names,
        x=x * axis_factor(axes[0].unit),
        y=table[:, 0] + 1j * table[:, 1] if is_complex else table[:, 0].copy(),
        even=even,
        axes=axes,
    )


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


def _stored(
    block: DataSet, is_double: bool, even: bool, count: int, size: int
) -> Float:
    """The numbers of a 58b, (count, size)."""
    raw = block.binary or b""
    order = ">" if block.big_endian else "<"
    number = np.dtype(f"{order}f{8 if is_double else 4}")
    abscissa = number
    if is_double and not even and len(raw) < count * size * 8:
        # the abscissa of uneven double data is single
        abscissa = np.dtype(f"{order}f4")
    point = np.dtype([("first", abscissa), ("others", number, (size - 1,))])
    if len(raw) < count * point.itemsize:
        raise DataError(
            f"{len(raw)} bytes of samples where {count * point.itemsize} are announced; the file "
            "is cut"
        )
    table = np.frombuffer(raw, point, count)
    return np.column_stack([table["first"], table["others"]]).astype(np.float64)


def _ends(line: str) -> tuple[int, tuple[int, int], tuple[int, int], tuple[str, str]]:
    """Function type, response, reference and the names of both."""
    free = line.split()
    texts = words(line, tuple(_ENDS.values()))
    try:
        return _parsed_ends(texts)
    # columns shifted by the vendor: names without blanks, divided by blanks
    except DataError:
        if len(free) != len(_ENDS):
            raise
        return _parsed_ends(free)


def _parsed_ends(
    texts: Sequence[str],
) -> tuple[int, tuple[int, int], tuple[int, int], tuple[str, str]]:
    number = {
        n: parse_int(t) for n, t in zip(_ENDS, texts, strict=True) if "name" not in n
    }
    response, reference = (
        (number[f"{end} node"], number[f"{end} direction"])
        for end in ("response", "reference")
    )
    return number["kind"], response, reference, (texts[4], texts[7])


def _axis(fields: Sequence[str]) -> Axis:
    try:
        kind, *exponents = (parse_int(f) for f in fields[:4])
    except DataError:
        return Axis(0, (0, 0, 0), "", "")
    return Axis(kind, (exponents[0], exponents[1], exponents[2]), fields[4], fields[5])


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
    ends = [
        [
            f"{'NONE':<10}{n:10d}{d:4d}"
            for n, d in zip(dofs.node, dofs.direction, strict=True)
        ]
        for dofs in (outputs, inputs)
    ]
    with atomic_write(path) as part, part.open("wb") as file:
        for j, reference in enumerate(ends[1]):
            for i, (channel, response) in enumerate(
                zip(frfs.outputs, ends[0], strict=True)
            ):
                # a motion about an axis has the code of one along it: the direction says which
                motion = _CODE.get(LINEAR.get(channel.quantity, channel.quantity), 0)
                h = frfs.data[:, i, j]
                coherence = frfs.coherence[:, i, j]
                sets: list[tuple[str, int, tuple[int, ...], Any_]] = [
                    (
                        "FRF",
                        FunctionType.FRF,
                        (AxisType.FREQUENCY, motion, _CODE["force"], 0),
                        h,
                    )
                ]
                if np.isfinite(coherence).all():
                    unitless = (AxisType.FREQUENCY, 0, 0, 0)
                    sets.append(
                        ("Coherence", FunctionType.COHERENCE, unitless, coherence)
                    )
                for title, kind, codes, y in sets:
                    points = f"{kind:5d}{0:10d}{0:5d}{0:10d} {response} {reference}"
                    head = [title, *("NONE",) * 4, points]
                    file.write(_data_set(head, codes, frfs.freqs, y))


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
    lines = [
        "".join(points[k : k + points_a_line])
        for k in range(0, len(points), points_a_line)
    ]
    text = "\n".join(["    -1", f"{58:6d}", *head, form, *axes, *lines, "    -1", ""])
    return text.encode("latin-1", "replace")
