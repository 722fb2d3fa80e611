"""What loggers leave among the lines of samples: a header anew, a last line that is cut, words for
values they lack.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Sequence
from pathlib import Path

log = logging.getLogger(__name__)

_LACKED = re.compile(
    r"#?n/?a|null|none|-+|overflow|ovfl|ovl|over|ol|err|error|invalid|bad|#+|\?+|\*+", re.IGNORECASE
)
_PROCESSES = {"smp", "avg", "max", "min", "std", "tot", ""}  # Campbell's fourth line of a header


def is_lacking(cell: str) -> bool:
    """Whether a cell says in words that there is no value."""
    return _LACKED.fullmatch(cell.strip(' "')) is not None


def without_words(lines: Sequence[str], delimiter: str) -> list[str]:
    """The lines with `nan` in cells that are empty or say in words that there is no value."""
    if delimiter == " ":
        cell = re.compile(rf'(?<!\S)"?(?:{_LACKED.pattern})"?(?!\S)', re.IGNORECASE)
    else:
        d = re.escape(delimiter)
        cell = re.compile(
            rf'(?:^|(?<={d}))[ "]*(?:{_LACKED.pattern}|nan|)[ "]*(?={d}|$)', re.IGNORECASE
        )
    return [cell.sub("nan", x) for x in lines]


def without_headers(lines: Sequence[str], head: Sequence[str], path: Path) -> list[str]:
    """The lines without those of the header, which some loggers write again when they start
    anew.
    """
    again = set(head)
    kept = [x for x in lines if x not in again]
    if len(kept) < len(lines):
        log.warning(
            "%s: the header stands among the samples again, %d lines, left out",
            path,
            len(lines) - len(kept),
        )
    return kept


def header_cells(head: Sequence[Sequence[str]]) -> list[list[str]]:
    """Cells of the lines of a header; in Campbell's TOA5 units stand above how each value was
    made.
    """
    rows = [[x.strip() for x in cells] for cells in head]
    words = {x.lower() for x in rows[-1]}
    if len(rows) < 3 or not words <= _PROCESSES or words == {""}:
        return rows
    units = ["" if x in ("TS", "RN") else x for x in rows[-2]]
    return [*rows[:-2], units]
