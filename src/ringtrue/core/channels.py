"""Names of channels, and the motions that sensors measure.

`4-X` is the sensor `4+X` read the other way. A motion has an order of derivative, an SI unit and
the kinds of FRF that it gives; one is made another.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np

from ringtrue.core.arrays import Complex, Float, Int
from ringtrue.core.signals import Channel, FrfKind, Quantity

Motion = Literal["displacement", "velocity", "acceleration"]
DERIVATIVE: dict[str, int] = {"displacement": 0, "velocity": 1, "acceleration": 2}
SI_UNIT: dict[str, str] = {
    "displacement": "m",
    "velocity": "m/s",
    "acceleration": "m/s^2",
}
FRF_KIND: dict[str, FrfKind] = {
    "displacement": "receptance",
    "velocity": "mobility",
    "acceleration": "accelerance",
}
OF_KIND: dict[str, Motion] = {FRF_KIND[m]: m for m in get_args(Motion)}
POWER: dict[str, int] = {
    FRF_KIND[motion]: n for motion, n in DERIVATIVE.items()
}  # of s, over the receptance
ANGULAR: dict[str, Quantity] = {  # the same about an axis, of the same kind of FRF
    "displacement": "rotation",
    "velocity": "angular velocity",
    "acceleration": "angular acceleration",
    "force": "moment",
}
LINEAR: dict[str, Quantity] = {about: along for along, about in ANGULAR.items()}  # type: ignore[misc]
UNIT: dict[str, str] = {
    **SI_UNIT,
    "force": "N",
    "rotation": "rad",
    "angular velocity": "rad/s",
    "angular acceleration": "rad/s^2",
    "moment": "N*m",
}
FORCES = ("force", "moment")
MOTIONS: dict[str, FrfKind] = {
    **FRF_KIND,
    **{ANGULAR[motion]: kind for motion, kind in FRF_KIND.items()},
}

_ABOUT = re.compile(r"[+-]R[XYZ]$")
BASE = "base "  # how the name of a base begins


def channel(name: str, quantity: Quantity) -> Channel:
    """A motion or force at a point; of a rotation or moment where the name says so, as `3+RX`."""
    kind = ANGULAR.get(quantity, quantity) if _ABOUT.search(name) else quantity
    return Channel(name, kind, UNIT.get(kind, ""))


def base_motion(name: str) -> Channel:
    """The input of transmissibilities, the motion of a base; by its name no response is its driving
    point.
    """
    return Channel(BASE + name, "acceleration", SI_UNIT["acceleration"])


def as_motion(
    h: Complex, freqs: Float, motion: str, wanted: str, decay: float = 0.0
) -> Complex:
    """FRFs of one motion as those of another; the line at 0 Hz becomes 0 without a window.

    Parameters
    ----------
    h : (f, ...) complex128, SI
    freqs : (f,) float64, Hz
    motion, wanted : str
        Quantities; what is no motion stays what it is.
    decay : float, 1/s
        Of an exponential window that is in the FRFs: they stand at iω + decay.
    """
    if motion == wanted or not {motion, wanted} <= set(DERIVATIVE):
        return h
    s = decay + 2j * np.pi * freqs.reshape(-1, *(1,) * (h.ndim - 1))
    factor = np.where(s == 0, 1, s) ** (DERIVATIVE[wanted] - DERIVATIVE[motion])
    return h * np.where(s == 0, 0, factor)


SHOWN = 8  # channels that a message names
# an S: skewed, named after its nearest axis
_LABEL = re.compile(r"(\d+):?([+-]?)(R?[XYZ]S?)", re.IGNORECASE)


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
    renamed = [
        f"{one} is {two}{' turned' * (way < 0)}"
        for one, two, way in pairs
        if one != two
    ]
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
