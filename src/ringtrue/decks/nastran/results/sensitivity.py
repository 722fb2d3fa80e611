"""The design sensitivity matrix of SOL 200: DSCM2 with DSCMCOL in OP2 and HDF5, printed in F06, or
as CSV.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ringtrue.core.arrays import Float, Int, freeze_arrays
from ringtrue.decks.nastran.results.op2 import Op2Table, matrix, read_tables
from ringtrue.errors import DataError, about
from ringtrue.io.files import existing, read_text, refuse_large
from ringtrue.io.foreign.door import door
from ringtrue.io.foreign.parsers import open_hdf5
from ringtrue.io.recognition import Format, format_of, refuse_format

_WORDS = 9  # of a response in DSCMCOL: internal id, id, type, then by type
_DISPLACEMENT = 5  # a response type: Quick Reference Guide, DSCMCOL


@dataclass(frozen=True, slots=True, eq=False)
class Sensitivities:
    """Derivatives of responses to design variables.

    Attributes
    ----------
    response : (r,) int64
        Id of the DRESP1; one with several grid points gives several rows.
    grid, component : (r,) int64
        Of a displacement response; 0 else.
    variable : (v,) int64
        Ids of the DESVARs.
    values : (r, v) float64
    """

    response: Int
    grid: Int
    component: Int
    variable: Int
    values: Float

    def __post_init__(self) -> None:
        freeze_arrays(self)
        r = self.response.size
        v = self.variable.size
        if not r or not v:
            raise DataError("no design sensitivities")
        if (
            self.values.shape != (r, v)
            or self.grid.shape != (r,)
            or self.component.shape != (r,)
        ):
            raise DataError(
                f"{r} responses and {v} design variables do not fit a matrix of {self.values.shape}"
            )
        if not np.isfinite(self.values).all():
            raise DataError("a sensitivity is not finite")
        refuse_large(self.values, "sensitivity")


def read_sensitivities(path: str | Path) -> Sensitivities:
    """Sensitivities from OP2, F06, HDF5 or delimited text.

    Raises
    ------
    DataError
        If the file is missing, damaged or holds none.
    """
    path = existing(path)
    readers = {Format.OP2: _op2, Format.F06: _f06, Format.HDF5: _h5, Format.TEXT: _csv}
    held = format_of(path)
    if held not in readers:
        refuse_format(path, "sensitivities", tuple(readers))
    with about(path), door(path, "file of sensitivities"):
        return readers[held](path)


def _op2(path: Path) -> Sensitivities:
    """A column of DSCM2 for each response, a row for each design variable."""
    found: dict[str, Op2Table] = {}
    for table in read_tables(path):
        found[table.name] = table  # the last design cycle
    if "DSCM2" not in found or "DSCMCOL" not in found:
        raise DataError(
            "no DSCM2 and DSCMCOL: ask for DSAPRT(EXPORT,END=SENS) = ALL and PARAM,POST,-1"
        )
    columns = found["DSCMCOL"]
    words = [columns.ints(body) for body in columns.bodies()]
    first = (
        words[0].reshape(-1, _WORDS)
        if words and words[0].size % _WORDS == 0
        else np.empty((0, _WORDS), np.int64)
    )
    values = matrix(found["DSCM2"]).T
    variables = np.arange(1, values.shape[1] + 1)
    if destab := found.get("DESTAB"):  # words: internal id, id, label, bounds
        ids = [int(destab.ints(body)[1]) for body in destab.bodies()]
        if len(ids) == variables.size:
            variables = np.array(ids, dtype=np.int64)
    return _labelled(first, values[: len(first)], variables)


def _labelled(columns: Int, values: Float, variables: Int) -> Sensitivities:
    """Rows of the matrix with their words in DSCMCOL."""
    moved = columns[:, 2] == _DISPLACEMENT
    grid = np.where(moved, columns[:, 3], 0)
    component = np.where(moved, columns[:, 4], 0)
    return Sensitivities(columns[:, 1], grid, component, variables, values)


_RESPONSE = re.compile(r"DRESP1\s+ID\s*=\s*(\d+)\s+RESPONSE\s+TYPE\s*=\s*(\w+)")
_GRID = re.compile(r"GRID\s+ID\s*=\s*(\d+)\s+COMP(?:ONENT)?\s*(?:NO\.?)?\s*=\s*(\d+)")
_PAIR = re.compile(
    r"(?<![\w.])(\d+)\s+(?:([A-Z]\w{0,7})\s+)?([-+]?\d\.\d+(?:E[-+]?\d+|[-+]\d+))(?![\w.])"
)


def _f06(path: Path) -> Sensitivities:
    """The matrix DSCM2 as it is printed without FORMATTED, else the formatted blocks."""
    lines = path.read_text(encoding="latin-1").splitlines()
    return _matrix(lines) if any(map(_MATRIX.search, lines)) else _blocks(lines)


_MATRIX = re.compile(r"MATRIX\s+DSCM2\s.*?(\d+)\s+COLUMN\s+X\s+(\d+)\s+ROW")
_DESVAR = re.compile(r"^\s+(\d+)\s+(\d+)\s+[A-Z]\w{0,7}(?:\s+[-+]?\d?\.\d+\S*){3}\s*$")
_ENTRY = re.compile(r"^\s+(\d+)\s+(\d+)\s+([A-Z]\w*)((?:\s+\d+)*)\s*$")
_COLUMN = re.compile(r"COLUMN\s+(\d+)\s+ROWS")
_VALUES = re.compile(r"^\s+(\d+)\)\s+(\S.*)$")


def _matrix(lines: Sequence[str]) -> Sensitivities:
    """Matrix DSCM2 of the last design cycle and the table of its columns; columns of DRESP2 and 3
    are left out.

    A column goes on over pages; what is not printed is 0.
    """
    variables = dict[int, int]()
    columns = dict[int, tuple[int, int, int]]()
    values = np.zeros((0, 0))
    column = 0
    section = ""
    done = False
    for line in lines:
        if found := _MATRIX.search(line):
            columns_of_matrix = int(found[1])
            rows = int(found[2])
            if columns_of_matrix * rows > 1 << 27:  # 1 GB
                raise DataError(
                    f"DSCM2 of {columns_of_matrix} columns and {rows} rows: the file is damaged"
                )
            values = np.zeros((columns_of_matrix, rows))
            section = "DSCM2"
            done = False
        elif "THE NUMBER OF NON-ZERO TERMS" in line and section == "DSCM2":
            section = ""
            done = True
        elif found := re.search(
            r"ASSOCIATED WITH (DRESP\d)|-----\s+(DESIGN VARIABLES)\s+-----", line
        ):
            section = found[1] or found[2]
        elif section == "DSCM2" and (found := _COLUMN.search(line)):
            column = int(found[1])
        elif section == "DSCM2" and (found := _VALUES.match(line)):
            row = [_real(x) for x in found[2].split()]
            values[column - 1, int(found[1]) - 1 : int(found[1]) - 1 + len(row)] = row
        elif section == "DRESP1" and (found := _ENTRY.match(line)):
            place = (
                [int(x) for x in found[4].split()][:2] if found[3] == "DISP" else [0, 0]
            )
            columns[int(found[1])] = (int(found[2]), place[0], place[1])
        elif section == "DESIGN VARIABLES" and (found := _DESVAR.match(line)):
            variables[int(found[1])] = int(found[2])
    if not done:
        raise DataError("the print of DSCM2 has no end: the file is cut off?")
    if not columns:
        raise DataError(
            "DSCM2 is printed without the table that identifies its columns"
        )
    at = sorted(columns)
    labels = np.array([columns[i] for i in at], dtype=np.int64)
    ids = np.array(
        [variables.get(i + 1, i + 1) for i in range(values.shape[1])], dtype=np.int64
    )
    return Sensitivities(
        labels[:, 0], labels[:, 1], labels[:, 2], ids, values[np.array(at) - 1]
    )


def _blocks(lines: Sequence[str]) -> Sensitivities:
    """Printed blocks: a response, then pairs of design variable and coefficient in columns."""
    rows: list[list[int]] = []
    values: list[dict[int, float]] = []
    for line in lines:
        head = _RESPONSE.search(line)
        if head:
            rows.append([int(head[1]), 0, 0])
            values.append({})
        where = _GRID.search(line)
        if where and rows:
            rows[-1][1:] = int(where[1]), int(where[2])
        if rows and not head and not where and "VALUE" not in line:
            values[-1] |= {int(v): _real(x) for v, _, x in _PAIR.findall(line)}
    variables = sorted({v for row in values for v in row})
    if not variables:
        raise DataError(
            "no printed design sensitivities: ask for DSAPRT(FORMATTED,END=SENS) = ALL"
        )
    for (response, _, _), row in zip(rows, values, strict=True):
        if lost := [v for v in variables if v not in row]:
            raise DataError(
                f"response {response} has no coefficient of design variable {lost[0]}: the file "
                "is cut off?"
            )
    labels = np.array(rows, dtype=np.int64)
    table = np.array([[row[v] for v in variables] for row in values])
    return Sensitivities(
        labels[:, 0], labels[:, 1], labels[:, 2], np.array(variables), table
    )


def _real(text: str) -> float:
    return float(text if "E" in text else re.sub(r"(?<=\d)([-+])", r"E\1", text))


def _h5(path: Path) -> Sensitivities:
    """The same data blocks as in OP2, wherever they stand in the file: `DSCM2` (row, column) and
    `DSCMCOL`.
    """
    found: dict[str, Any] = {}

    def visit(name: str, item: Any) -> None:
        last = name.rsplit("/", 1)[-1].upper()
        if isinstance(item, h5py.Dataset) and last in ("DSCM2", "DSCMCOL"):
            found[last] = item[()]

    with open_hdf5(path) as file:
        file.visititems(visit)
    if "DSCM2" not in found or "DSCMCOL" not in found:
        raise DataError("no data sets DSCM2 and DSCMCOL")
    columns = found["DSCMCOL"]
    if columns.dtype.names:
        columns = np.stack(
            [columns[n].astype(np.int64) for n in columns.dtype.names], axis=1
        )
    columns = np.asarray(columns, dtype=np.int64).reshape(-1, _WORDS)
    values = np.asarray(found["DSCM2"], dtype=np.float64)
    values = values.T if values.shape[0] != len(columns) else values
    return _labelled(columns, values, np.arange(1, values.shape[-1] + 1))


def _csv(path: Path) -> Sensitivities:
    """A head `response,grid,component,<id of each design variable>`, a line a response."""
    with door(path, "CSV table"):
        table = csv.reader(StringIO(read_text(path), newline=""))
        lines = [line for line in table if any(c.strip() for c in line)]
    head = [c.strip() for c in lines[0]] if lines else []
    if [h.lower() for h in head[:3]] != ["response", "grid", "component"]:
        raise DataError(
            f"the head must begin with response,grid,component; got {','.join(head[:3])!r}"
        )
    if any(len(line) != len(head) for line in lines):
        raise DataError(f"a line has not {len(head)} cells: the file is cut off?")
    cells = np.array(lines[1:], dtype=np.str_).reshape(-1, len(head))
    labels = cells[:, :3].astype(np.int64)
    variables = np.array(head[3:]).astype(np.int64)
    return Sensitivities(
        labels[:, 0],
        labels[:, 1],
        labels[:, 2],
        variables,
        cells[:, 3:].astype(np.float64),
    )
