"""Names of channels: `4-X` is the sensor `4+X` read the other way."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from ringtrue.core.arrays import Float, Int

SHOWN = 8  # channels that a message names
_LABEL = re.compile(
    r"(\d+):?([+-]?)(R?[XYZ]S?)", re.IGNORECASE
)  # an S: skewed, named after its nearest axis


def split_label(name: str) -> tuple[int, float, str] | None:
    """Point, sign and axis of a name such as `101+Z` or `101:-Z`; None for one of another form.

    >>> split_label("101-Z")
    (101, -1.0, 'Z')
    >>> split_label("4x")
    (4, 1.0, 'X')
    """
    found = _LABEL.fullmatch(name.strip())
    if found is None:
        return None
    return int(found[1]), -1.0 if found[2] == "-" else 1.0, found[3].upper()


def other_names(
    given: Sequence[str], known: Sequence[str], sign: Sequence[float] | Float
) -> tuple[str, ...]:
    """That channels bear other names than on the sensor sheet, in words; nothing where none
    does.
    """
    pairs = zip(given, known, map(float, sign), strict=True)
    renamed = [f"{one} is {two}{' turned' * (way < 0)}" for one, two, way in pairs if one != two]
    renamed = list(dict.fromkeys(renamed))
    if not renamed:
        return ()
    more = f" and {len(renamed) - SHOWN} more" if len(renamed) > SHOWN else ""
    return (f"channel names on the sensor sheet: {', '.join(renamed[:SHOWN])}{more}",)


def input_id(channel: str) -> str:
    """The point and direction of a force channel: its id without a leading `F:` or `force:`."""
    head, _, tail = channel.partition(":")
    return tail.strip() if tail and head.strip().lower() in ("f", "force") else channel


def opposite(name: str) -> str:
    """The name of the same sensor read the other way, `4-X` of `4+X`; empty where the name has no
    direction.
    """
    label = split_label(name)
    return f"{label[0]}{'+' if label[1] < 0 else '-'}{label[2]}" if label else ""


def match_channels(asked: Sequence[str], known: Sequence[str]) -> tuple[Int, Float]:
    """Where channels stand among others: by the same name, else by the same point and axis,
    whatever the sign.

    Parameters
    ----------
    asked : sequence (k,) of str
    known : sequence (n,) of str

    Returns
    -------
    index : (k,) int64
        -1 where there is no such channel.
    sign : (k,) float64
        What a reading by the asked name is of one by the known name: +1 or -1.

    Examples
    --------
    >>> index, sign = match_channels(["4-X", "4+X", "5+X"], ["3+X", "4+X"])
    >>> index.tolist(), sign.tolist()
    ([1, 1, -1], [-1.0, 1.0, 1.0])
    """
    by_name: dict[str, int] = {}
    by_label: dict[tuple[int, float, str], int] = {}
    for i, name in enumerate(known):
        by_name.setdefault(name, i)
        if (label := split_label(name)) is not None:
            by_label.setdefault(label, i)
    index = np.full(len(asked), -1, dtype=np.int64)
    sign = np.ones(len(asked))
    for k, name in enumerate(asked):  # names are text: hundreds of them
        if name in by_name:
            index[k] = by_name[name]
        elif (label := split_label(name)) is not None:
            point, way, axis = label
            index[k] = by_label.get(label, -1)
            if index[k] < 0 and (point, -way, axis) in by_label:
                index[k] = by_label[point, -way, axis]
                sign[k] = -1.0
    return index, sign
