"""What a file holds that a command cannot use, in words, and the command that takes it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from pathlib import Path

FUNCTIONS = {  # of data set 58, by function type
    0: "general functions",
    1: "time records",
    2: "auto spectra",
    3: "cross spectra",
    4: "FRFs",
    5: "transmissibilities",
    6: "coherences",
    9: "spectra",
    12: "spectra",
}
_SETS = {
    15: "nodes",
    18: "coordinate systems",
    55: "mode shapes or other data at nodes",
    58: "functions",
    82: "trace lines",
    151: "a header",
    164: "units",
    1858: "attributes of functions",
    2411: "nodes",
    2412: "elements",
    2414: "mode shapes or other data at nodes",
    2420: "coordinate systems",
    2431: "trace lines",
}
_GEOMETRY = (15, 18, 82, 2411, 2412, 2420, 2431)
_TAKES = {
    "time records": "`ringtrue oma` takes records without forces, `ringtrue ema` those with a "
    "force",
    "FRFs": "`ringtrue ema` takes FRFs",
    "transmissibilities": "`ringtrue ema` takes FRFs",
    "functions": "`ringtrue oma` and `ringtrue ema` take records and FRFs",
    "mode shapes or other data at nodes": "`ringtrue correlate` takes modes",
}
_BY_ENDING = {  # of files that no record or FRF has
    **dict.fromkeys((".bdf", ".dat", ".nas"), ("a deck", "`ringtrue check` takes decks")),
    **dict.fromkeys(
        (".op2", ".f06", ".pch"), ("results of a solver", "`ringtrue convert` takes them")
    ),
    ".json": ("modes or a log", "`ringtrue correlate` takes modes"),
    ".toml": ("a study or a choice", "`ringtrue run` takes studies"),
    ".npz": ("FRFs", _TAKES["FRFs"]),
}


def functions_held(kinds: Iterable[int]) -> str:
    """How many functions of which types a universal file holds, and which command takes them."""
    count = Counter(FUNCTIONS.get(k, f"functions of type {k}") for k in kinds)
    return _sentence([f"{n} {what}" for what, n in count.items()], count)


def sets_held(kinds: Iterable[int]) -> str:
    """What the data sets of a universal file hold, and which command takes it."""
    found = sorted(set(kinds))
    named = [f"{_SETS[k]} ({k})" if k in _SETS else f"data sets {k}" for k in found]
    geometry = (
        "; the points of a test go into a sensor sheet" if set(found) & set(_GEOMETRY) else ""
    )
    return _sentence(named, [_SETS.get(k, "") for k in found]) + geometry


def ending_means(path: Path) -> str:
    """What a file with this ending holds, and which command takes it; empty where nothing can be
    said.
    """
    if (known := _BY_ENDING.get(path.suffix.lower())) is None:
        return ""
    return f": {known[0]}; {known[1]}"


def _sentence(named: Iterable[str], what: Iterable[str]) -> str:
    takes = dict.fromkeys(_TAKES[w] for w in what if w in _TAKES)
    return "; ".join([f"it holds {', '.join(named)}", *takes])
