"""Complex numbers in one cell of a delimited text, `1.2+3.4j`, `(1.2 - 3.4i)`: parted into two
columns.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

_NOTHING = "0"


def parted(
    lines: Sequence[str], delimiter: str, comma: bool, cells: Callable[[str], list[str]]
) -> list[str]:
    """The lines with two cells, `real` and `imag` before their titles, for each complex one; others
    as they are.

    Parameters
    ----------
    lines : sequence of str
        Titles and samples; the last one tells which columns are complex.
    delimiter : str
    comma : bool
        Commas are decimal.
    cells : callable
        Takes a line to its cells.
    """
    number = r"(?:\d+{0}?\d*|{0}\d+)(?:[eEdD][-+]?\d+)?".format("," if comma else r"\.")
    both = re.compile(rf"(?:\( *)?([-+]? *{number}) *([-+]) *({number}) *\*? *[ijIJ]\b(?: *\))?")
    one = re.compile(rf"[-+\s(]*{number}[\s)]*$")
    if both.search(lines[-1]) is None:
        return list(lines)
    mark = "\x00"
    held = [both.sub(lambda m: (m[1] + mark + m[2] + m[3]).replace(" ", ""), x) for x in lines]
    double = [mark in c for c in cells(held[-1])]
    out = []
    for line in held:
        row = cells(line)
        if len(row) != len(double):
            out.append(line)
            continue
        pairs = [_pair(c, mark, one) if d else [c] for c, d in zip(row, double, strict=True)]
        out.append(delimiter.join(_quoted(c, delimiter) for pair in pairs for c in pair))
    return out


def _pair(cell: str, mark: str, number: re.Pattern[str]) -> list[str]:
    if mark in cell:
        return cell.split(mark)
    if number.match(cell):
        return [cell.strip(" ()"), _NOTHING]
    return [f"{part}_{cell.strip()}" if cell.strip() else "" for part in ("real", "imag")]


def _quoted(cell: str, delimiter: str) -> str:
    return f'"{cell}"' if delimiter in cell or '"' in cell else cell
