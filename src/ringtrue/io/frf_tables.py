"""Tables of frequency and complex response, as sine controllers and spreadsheets write them.

What readers of FRFs share: the lines that have values, and the warning where the motion is
unknown.
"""

from __future__ import annotations

import csv
import logging
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np

from ringtrue.core.arrays import Bool, Complex, Float
from ringtrue.core.channels import (
    BASE,
    FORCES,
    FRF_KIND,
    LINEAR,
    Motion,
    as_motion,
    base_motion,
    channel,
)
from ringtrue.core.signals import Channel, FrfSet, Quantity
from ringtrue.errors import DataError
from ringtrue.io.files import atomic_write
from ringtrue.io.frf_headers import FREQUENCY, PART, frf_titles, read_frf_columns
from ringtrue.io.times import hertz, known, to_si

log = logging.getLogger(__name__)


def known_lines(
    h: Complex,
    freqs: Float,
    outputs: Sequence[str],
    inputs: Sequence[str],
    path: str | Path,
) -> slice | Bool:
    """(f,) bool: lines with values; those where no FRF has one are left out, and 0 Hz where one
    lacks it (0/0).

    Parameters
    ----------
    h : (f, out, in) complex128
    freqs : (f,) float64, Hz
    outputs, inputs : sequence of str
        Their names.
    path : path
        Of the file, for the message.

    Raises
    ------
    DataError
        If an FRF has no value where others do, or none has any.
    """
    lost = ~np.isfinite(h)
    if not lost.any():
        return slice(None)
    none = np.asarray(np.where(freqs > 0, lost.all(axis=(1, 2)), lost.any(axis=(1, 2))))
    if (rest := lost & ~none[:, None, None]).any() or none.all():
        f, o, i = np.argwhere(rest if rest.any() else lost)[0]
        why = (
            f"{int(lost.sum())} values are not finite, the first of {outputs[o]}/{inputs[i]} "
            f"at {freqs[f]:g} Hz"
        )
        raise DataError(f"{path}: {why}")
    if (bare := freqs[none & (freqs > 0)]).size:
        log.warning(
            "%s: lines at which no FRF has a value are left out: %d, from %g Hz",
            path,
            bare.size,
            bare[0],
        )
    return ~none


def frf_set(
    h: Complex,
    freqs: Float,
    ends: tuple[Sequence[str], Sequence[Channel]],
    kind: Quantity,
    path: str | Path,
    *,
    coherence: Float | None = None,
) -> FrfSet:
    """FRFs of a file at the lines that have values.

    Parameters
    ----------
    h : (f, out, in) complex128, SI
    freqs : (f,) float64, Hz
    ends : (names of the responses, references)
    kind : str
        Quantity of the responses; the FRFs of a strain are receptances, those of none known
        accelerances.
    path : path
    coherence : (f, out, in) float64, optional

    Raises
    ------
    DataError
        As `known_lines` does.
    """
    outputs, inputs = ends
    at = known_lines(h, freqs, outputs, [c.id for c in inputs], path)
    if coherence is None:
        coherence = np.full(h.shape, np.nan)
    return FrfSet(
        data=np.ascontiguousarray(h[at]),
        freqs=freqs[at],
        outputs=tuple(channel(n, kind) for n in outputs),
        inputs=tuple(inputs),
        coherence=np.ascontiguousarray(coherence[at]),
        averages=np.full(len(inputs), np.nan),
        kind="receptance" if kind == "strain" else FRF_KIND.get(kind, "accelerance"),
        source=str(path),
    )


def references(names: Sequence[str], based: Collection[str] = ()) -> list[Channel]:
    """References by name: forces, but for those that are motions of a base."""
    return [base_motion(n) if n in based else channel(n, "force") for n in names]


def say_accelerances(path: str | Path) -> None:
    """Say that FRFs of no known kind are taken as accelerances."""
    log.warning(
        "%s: the quantity of the responses is unknown: the FRFs are taken as accelerances, m/s^2/N",
        path,
    )


_GROUP = re.compile(r"\[[^\[\]]*\]|\((?:[^()]|\([^()]*\))*\)")
_BARS = re.compile(r"^\s*\|([^|]+)\|")  # of a modulus
_CALLED = re.compile(
    r"^\W*((?i:frequency response( function)?|transfer function)[\s:_-]*)?"
    r"((H|FRF)(?=[\s_:(]|$)|H[12vV](?=[\s(]|$))?"
)
_LEVEL = re.compile(
    r"(?<![A-Za-z])dB(?![A-Za-z])(\s*re[fl]?\b[.:]?\s*(?P<one>(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?)?)?",
    re.IGNORECASE,
)
_DEGREES = re.compile(r"(?<![A-Za-z])deg(rees?)?(?![A-Za-z])|°", re.IGNORECASE)
_RADIANS = re.compile(r"(?<![A-Za-z])rad(ians?)?(?![A-Za-z])", re.IGNORECASE)
_TURN = 2 * np.pi + 0.1  # a phase beyond is in degrees


@dataclass(frozen=True, slots=True)
class _Title:
    """What the title of a column says."""

    part: str
    output: str
    reference: str
    unit: str


def is_frf_table(path: Path) -> bool:
    """Whether the first column of a delimited text is named a frequency and others are parts of
    complex numbers.
    """
    try:
        names = frf_titles(path)
    except DataError:
        return False
    return (
        len(names) > 2
        and bool(FREQUENCY.match(names[0]))
        and any(_title(n) is not None for n in names[1:])
    )


def read_frf_table(path: Path) -> FrfSet:
    """FRFs of a table whose columns are a frequency and the parts of each response.

    Titles name response, reference and part, `1+Z/3+Z real [m/s^2/N]`: real and imag, or magnitude
    (dB, too) and phase (degrees, or radians where no value passes a turn and there is no unit);
    coherence as well. Without a reference it is `in1`; without a unit the responses are
    accelerations, of several kinds they become those of most. Lines may be in kHz, rad/s or rpm,
    uneven and in any order; those at which no FRF has a value are left out.

    Raises
    ------
    DataError
        If the first column is no frequency, a response lacks a part or a value, two columns are the
        same part, or a unit is not motion over force.
    """
    names, data = read_frf_columns(path)
    if len(names) != len(data) or not names or not FREQUENCY.match(names[0]):
        raise DataError(
            f"{path}: the first column must be named a frequency; it is {names[:1]}"
        )
    parts, units = _columns(names, path)
    if not parts:
        raise DataError(
            f"{path}: no column is a part of an FRF, such as `1+Z/2+Z real`; there are {names[1:9]}"
        )
    for k, name in enumerate(names):
        if name == names[0] and (data[k] != data[0]).any():
            raise DataError(
                f"{path}: column {k + 1}, {name}, has other frequencies than the first one: "
                "export FRFs of one axis"
            )
    freqs, order = np.unique(data[0] * hertz(names[0]), return_index=True)
    if freqs.size != data.shape[1]:
        raise DataError(f"{path}: {data.shape[1] - freqs.size} frequencies occur twice")
    if not any(_ratio_of(u) for u in units.values()):
        say_accelerances(path)
    outputs, inputs = (list(dict.fromkeys(names)) for names in zip(*parts, strict=True))
    shape = (freqs.size, len(outputs), len(inputs))
    h = np.full(shape, np.nan, dtype=np.complex128)
    coherence = np.full(shape, np.nan)
    kinds = {pair: _kind(units.get(pair, ""), path) for pair in parts}
    motions = [motion for motion, _, _ in kinds.values()]
    kind = max(dict.fromkeys(motions), key=motions.count)
    for pair, columns in parts.items():
        at = outputs.index(pair[0]), inputs.index(pair[1])
        motion, factor, _ = kinds[pair]
        title = {part: names[k] for part, k in columns.items()}
        values = _complex(
            {p: data[k, order] for p, k in columns.items()}, title, pair, path
        )
        h[:, *at] = as_motion(values * factor, freqs, motion, kind)
        if "coherence" in columns:
            coherence[:, *at] = data[columns["coherence"], order]
    based = {ref for (_, ref), (_, _, on_base) in kinds.items() if on_base}
    ends = outputs, references(inputs, based)
    return frf_set(h, freqs, ends, kind, path, coherence=coherence)


def _columns(
    names: Sequence[str], path: Path
) -> tuple[dict[tuple[str, str], dict[str, int]], dict[tuple[str, str], str]]:
    """The columns of the parts of each response for a reference, and its unit where it has one."""
    parts: dict[tuple[str, str], dict[str, int]] = {}
    units = {}
    for at, name in enumerate(names[1:], start=1):
        if (t := _title(name)) is None:
            continue
        pair = parts.setdefault((t.output, t.reference), {})
        if t.part in pair:
            raise DataError(
                f"{path}: {names[pair[t.part]]!r} and {name!r} are the same part of "
                f"{t.output}/{t.reference}"
            )
        pair[t.part] = at
        if t.unit and t.part in ("re", "size"):
            units[t.output, t.reference] = t.unit
    return parts, units


def write_frf_table(path: Path, frfs: FrfSet) -> None:
    """Write FRFs as CSV that `read_frf_table` reads: real and imaginary parts, 9 digits, coherence
    where known.
    """
    head = ["Frequency [Hz]"]
    columns = [frfs.freqs]
    for j, force in enumerate(frfs.inputs):
        based = force.quantity not in FORCES
        for i, c in enumerate(frfs.outputs):
            pair = f"{c.id}/{force.id.removeprefix(BASE) if based else force.id}"
            # of one motion over the other
            unit = "g/g" if based else f"{c.unit}/{force.unit}"
            head += [f"{pair} real [{unit}]", f"{pair} imag [{unit}]"]
            columns += [frfs.data[:, i, j].real, frfs.data[:, i, j].imag]
            if np.isfinite(frfs.coherence[:, i, j]).all():
                head.append(f"{pair} coherence")
                columns.append(frfs.coherence[:, i, j])
    with (
        atomic_write(path) as part,
        part.open("w", encoding="utf-8", newline="") as file,
    ):
        csv.writer(file, lineterminator="\n").writerow(head)
        np.savetxt(
            file,
            np.stack(columns, axis=1),
            fmt=["%.12g", *["%.9g"] * (len(columns) - 1)],
            delimiter=",",
        )


def _title(name: str) -> _Title | None:
    """Part, response and reference of a title; None where it names no part."""
    rest, unit = _unit_of(_BARS.sub(r"abs \1 ", name))
    hits = (
        (part, hit) for part, pattern in PART.items() if (hit := pattern.search(rest))
    )
    by_unit = ""
    if _LEVEL.search(unit):
        by_unit = "size"
    elif _DEGREES.search(unit) or _RADIANS.search(unit):
        by_unit = "phase"
    part, hit = next(hits, (by_unit, None))
    if not part:
        return None
    rest = rest[: hit.start()] + rest[hit.end() :] if hit else rest
    label = _CALLED.sub("", rest.strip()).strip(" _:()[]|.,;#=").rstrip(" -")
    sides = re.split(r"\s*(?:/|<-|\||,)\s*", label, maxsplit=1)
    return _Title(part, sides[0] or "out1", sides[1] if len(sides) > 1 else "in1", unit)


def _unit_of(title: str) -> tuple[str, str]:
    """The title without its unit, and that: in brackets, as a word such as `g/N`, or `dB` and `deg`
    anywhere.
    """
    rest = title
    units = list[str]()
    for found in _GROUP.finditer(title):
        inside = found[0][1:-1].strip()
        closing = (
            not title[found.end() :].strip()
            and not title[: found.start()][-1:].isalpha()
        )
        points = re.search(r"\d[+-]R?[XYZ]", inside)  # such as `1+Z,3+Z`
        part = any(p.fullmatch(inside) for p in PART.values())
        if _says_unit(inside) or (closing and not points and not part):
            rest = rest.replace(found[0], " ", 1)
            units = [*units, inside]
    for pattern in (_LEVEL, _DEGREES, _RADIANS):
        if found_mark := pattern.search(rest):
            rest = rest.replace(found_mark[0], " ", 1)
            units = [*units, found_mark[0]]
    for word in rest.split():
        if _says_unit(word):
            rest = rest.replace(word, " ", 1)
            units = [*units, word]
    return rest, " ".join(units)


def _says_unit(text: str) -> bool:
    """Whether it is a motion over a force or another motion, a level or an angle, and nothing
    else.
    """
    bare = _LEVEL.sub("", text).strip(" ,()")
    return _ratio(bare) is not None if bare else bare != text


def _complex(
    columns: Mapping[str, Float],
    title: Mapping[str, str],
    key: Sequence[str],
    path: Path,
) -> Complex:
    if {"re", "im"} <= set(columns):
        return columns["re"] + 1j * columns["im"]
    if {"size", "phase"} <= set(columns):
        size = columns["size"]
        if _LEVEL.search(title["size"]):
            size = 10 ** (size / 20)
        phase = columns["phase"]
        degrees = _DEGREES.search(title["phase"]) or np.abs(phase).max() > _TURN
        if degrees and not _RADIANS.search(title["phase"]):
            phase = np.radians(phase)
        return np.asarray(size * np.exp(1j * phase))
    raise DataError(
        f"{path}: {'/'.join(key)} has {' and '.join(columns)}; needed: real and imag, or "
        "magnitude and phase"
    )


def _kind(unit: str, path: Path) -> tuple[Motion, float, bool]:
    """Quantity of the response, the factor to SI of a unit such as `dB re 1 g/N`, and whether it is
    over a base.
    """
    level = _LEVEL.search(unit)
    one = float(level["one"] or 1) if level else 1.0
    text = _ratio_of(unit)
    if not text:
        return "acceleration", one, False
    # rad is an angle, or a motion
    found = _ratio(_LEVEL.sub("", unit).strip(" ,()-")) or _ratio(text)
    if found is None:
        raise DataError(
            f"{path}: unit {unit!r}: an FRF is a motion over a force, such as m/s^2/N, g/N, "
            "mm/N, or over the same "
            "motion of the base, g/g"
        )
    return found[0], one * found[1], found[2]


def _ratio_of(unit: str) -> str:
    """A unit without its level and angle."""
    return _RADIANS.sub("", _DEGREES.sub("", _LEVEL.sub("", unit))).strip(" ,()-")


def _ratio(text: str) -> tuple[Motion, float, bool] | None:
    """Quantity and factor to SI of a motion over a force or over the same motion of a base; else
    None.
    """
    over, _, under = text.replace("(", "").replace(")", "").rpartition("/")
    if not (over and under and known(over) and known(under)):
        return None
    (quantity, factor, _), (other, size, _) = to_si(over), to_si(under)
    quantity = LINEAR.get(quantity, quantity)
    other = LINEAR.get(other, other)
    if quantity not in FRF_KIND or other not in ("force", quantity):
        return None
    # as the accelerations of a held base for a force of inertia, up to constants
    based = other == quantity
    return "acceleration" if based else cast(Motion, quantity), factor / size, based
