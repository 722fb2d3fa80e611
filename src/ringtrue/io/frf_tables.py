"""Tables of frequency and complex response, as sine controllers and spreadsheets write them."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Complex, Float
from ringtrue.core.motions import BASE, FRF_KIND, SI_UNIT, base_motion
from ringtrue.core.signals import Channel, FrfSet, Quantity
from ringtrue.errors import DataError
from ringtrue.io.atomic import atomic_write
from ringtrue.io.delimited import read_columns
from ringtrue.io.si import known, to_si

_FREQUENCY = re.compile(r"^\W*(freq\w*|f|hz|frequenz|fr[eé]quence|x)\b", re.IGNORECASE)
_PARTS = {
    "re": r"real|re",
    "im": r"imaginary|imag|im",
    "size": r"magnitude|mag|amplitude|ampl|amp|abs|modulus|gain",
    "phase": r"phase|phi|arg|angle",
    "coherence": r"coherence|coh|gamma2",
}
_PART = {k: re.compile(rf"(?<![A-Za-z])({v})(?![A-Za-z])", re.IGNORECASE) for k, v in _PARTS.items()}
_BRACKETS = re.compile(r"(?:\[([^\[\]]*)\]|\(([^()]*)\))\s*$")
_LEVEL = re.compile(r"\bdB\b(\s*re[fl]?\b[.:]?\s*(?P<one>(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?)?)?", re.IGNORECASE)
_TURN = 2 * np.pi + 0.1  # a phase beyond is in degrees


@dataclass(frozen=True, slots=True)
class _Title:
    """What the title of a column says."""

    part: str
    output: str
    reference: str
    unit: str


def is_frf_table(path: Path) -> bool:
    """Whether the first column of a delimited text is named a frequency and others are parts of complex numbers."""
    try:
        names = read_columns(path)[0]
    except DataError:
        return False
    return len(names) > 2 and bool(_FREQUENCY.match(names[0])) and any(_title(n) is not None for n in names[1:])


def read_frf_table(path: Path) -> FrfSet:
    """FRFs of a table whose columns are a frequency and the parts of each response.

    Titles name response, reference and part, `1+Z/3+Z real [m/s^2/N]`: real and imag, or magnitude (dB, too) and
    phase (degrees, or radians where no value passes a turn and no unit tells); coherence as well. Without a reference
    it is `in1`; without a unit the responses are accelerations. Lines may be uneven and in any order.

    Raises
    ------
    DataError
        If the first column is no frequency, a response lacks a part, or a unit is not motion over force.
    """
    names, data = read_columns(path)
    if len(names) != len(data) or not names or not _FREQUENCY.match(names[0]):
        raise DataError(f"{path}: the first column must be named a frequency; it is {names[:1]}")
    titles = [_title(n) for n in names[1:]]
    parts: dict[tuple[str, str], dict[str, int]] = {}
    for at, t in enumerate(titles, start=1):
        if t is not None:
            parts.setdefault((t.output, t.reference), {})[t.part] = at
    units = {(t.output, t.reference): t.unit for t in titles if t and t.part in ("re", "size") and t.unit}
    freqs, order = np.unique(data[0], return_index=True)
    if freqs.size != data.shape[1]:
        raise DataError(f"{path}: {data.shape[1] - freqs.size} frequencies occur twice")
    outputs, inputs = (list(dict.fromkeys(k[i] for k in parts)) for i in (0, 1))
    shape = (freqs.size, len(outputs), len(inputs))
    h, coherence = np.full(shape, np.nan, dtype=np.complex128), np.full(shape, np.nan)
    kinds = {k: _kind(units.get(k, ""), path) for k in parts}
    if len({k[0] for k in kinds.values()}) > 1:
        raise DataError(f"{path}: responses of several kinds: {', '.join(sorted({k[0] for k in kinds.values()}))}")
    based = {key[1] for key, k in kinds.items() if k[2]}
    for key, columns in parts.items():
        o, i = outputs.index(key[0]), inputs.index(key[1])
        title = {p: names[at] for p, at in columns.items()}
        h[:, o, i] = _complex({p: data[at, order] for p, at in columns.items()}, title, key, path) * kinds[key][1]
        if "coherence" in columns:
            coherence[:, o, i] = data[columns["coherence"], order]
    if np.isnan(h).any():
        o, i = np.argwhere(np.isnan(h))[0][1:]
        raise DataError(f"{path}: no value, or none at some line, of {outputs[o]} for {inputs[i]}")
    kind: Quantity = next(iter(kinds.values()))[0]
    return FrfSet(
        h,
        freqs,
        tuple(Channel(n, kind, SI_UNIT[kind]) for n in outputs),
        tuple(base_motion(n) if n in based else Channel(n, "force", "N") for n in inputs),
        coherence,
        np.full(len(inputs), np.nan),
        FRF_KIND[kind],
        source=str(path),
    )


def write_frf_table(path: Path, frfs: FrfSet) -> None:
    """Write FRFs as CSV that `read_frf_table` reads: real and imaginary parts, 9 digits, coherence where known."""
    head, columns = ["Frequency [Hz]"], [frfs.freqs]
    for j, force in enumerate(frfs.inputs):
        based = force.quantity != "force"
        for i, c in enumerate(frfs.outputs):
            pair = f"{c.id}/{force.id.removeprefix(BASE) if based else force.id}"
            unit = "g/g" if based else f"{c.unit}/N"  # of one motion over the other
            head += [f"{pair} real [{unit}]", f"{pair} imag [{unit}]"]
            columns += [frfs.data[:, i, j].real, frfs.data[:, i, j].imag]
            if np.isfinite(frfs.coherence[:, i, j]).all():
                head.append(f"{pair} coherence")
                columns.append(frfs.coherence[:, i, j])
    with atomic_write(path) as part, part.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerow(head)
        np.savetxt(file, np.stack(columns, axis=1), fmt=["%.12g", *["%.9g"] * (len(columns) - 1)], delimiter=",")


def _title(name: str) -> _Title | None:
    """Part, response and reference of a title; None where it names no part."""
    found = _BRACKETS.search(name)
    inside = (found[1] or found[2] or "").strip() if found else ""
    unit = "" if _points(inside) or any(p.fullmatch(inside) for p in _PART.values()) else inside
    rest = name[: found.start()] if found and unit else name
    for part, pattern in _PART.items():
        if hit := pattern.search(rest):
            rest = rest[: hit.start()] + rest[hit.end() :]
            label = re.sub(r"^\W*(?:H|FRF)(?=[\s_:(])", "", rest.strip()).strip(" _:()[]|.,;#=")
            sides = re.split(r"\s*(?:/|<-|\||,)\s*", label, maxsplit=1)
            return _Title(part, sides[0] or "out1", sides[1] if len(sides) > 1 else "in1", unit)
    return None


def _points(text: str) -> bool:
    """Whether brackets hold points such as `1+Z,3+Z` and no unit."""
    return re.search(r"\d[+-][XYZ]", text) is not None


def _complex(columns: Mapping[str, Float], title: Mapping[str, str], key: Sequence[str], path: Path) -> Complex:
    if {"re", "im"} <= set(columns):
        return np.asarray(columns["re"] + 1j * columns["im"])
    if {"size", "phase"} <= set(columns):
        size, phase = columns["size"], columns["phase"]
        size = 10 ** (size / 20) if re.search(r"\bdB\b", title["size"], re.IGNORECASE) else size
        radians = re.search(r"\brad", title["phase"], re.IGNORECASE) is not None
        degrees = re.search(r"\bdeg|°", title["phase"], re.IGNORECASE) is not None
        turn = phase if radians or (not degrees and np.abs(phase).max() <= _TURN) else np.radians(phase)
        return np.asarray(size * np.exp(1j * turn))
    raise DataError(
        f"{path}: {'/'.join(key)} has {' and '.join(columns)}; needed: real and imag, or magnitude and phase"
    )


def _kind(unit: str, path: Path) -> tuple[Quantity, float, bool]:
    """Quantity of the response, the factor to SI of a unit such as `dB re 1 g/N`, and whether it is over a base."""
    level = _LEVEL.search(unit)
    one = float(level["one"] or 1) if level else 1.0
    text = _LEVEL.sub("", unit).strip(" ,()")
    if not text or text.lower() in ("deg", "rad", "°", "-"):
        return "acceleration", one, False
    over, _, under = text.replace("(", "").replace(")", "").rpartition("/")
    quantity, factor, _ = to_si(over) if known(over) else ("unknown", 1.0, "")
    if quantity not in FRF_KIND or not known(under) or to_si(under)[0] not in ("force", quantity):
        raise DataError(
            f"{path}: unit {unit!r}: an FRF is a motion over a force, such as m/s^2/N, g/N, mm/N, or over the same "
            "motion of the base, g/g"
        )
    based = to_si(under)[0] == quantity
    if based:  # like the accelerations of a held base for a force of inertia, constants apart
        quantity = "acceleration"
    return quantity, one * factor / to_si(under)[1], based
