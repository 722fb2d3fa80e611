"""Modes as JSON, tables and HDF5."""

from __future__ import annotations

import csv
import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any, TextIO

import h5py
import numpy as np

from ringtrue.core.arrays import Complex, Float
from ringtrue.core.modes import ModeSet, Norm, OtherCandidates, Uncertainty
from ringtrue.core.notes import sentence
from ringtrue.errors import DataError, about
from ringtrue.io import hdf5
from ringtrue.io.files import atomic_write, existing, refuse_ending, refuse_large
from ringtrue.io.foreign.parsers import open_hdf5, read_json
from ringtrue.io.recognition import Format, format_of, refuse_format
from ringtrue.io.sheets import cells
from ringtrue.io.times import hertz
from ringtrue.io.uff.points import read_mode_sets, write_mode_sets

GROUP = "modes"
_UFF = (".uff", ".unv", ".55")
_HDF5 = (".h5", ".hdf5")
_TABLES = (Format.TEXT, Format.XLSX)
_READ = (Format.JSON, Format.HDF5, Format.UFF, *_TABLES)
WRITTEN = (".json", *_HDF5, *_UFF, ".csv")


def modes_to_json(
    modes: ModeSet,
    uncertainty: Uncertainty | None = None,
    reasons: Sequence[str] = (),
    others: OtherCandidates | None = None,
) -> dict[str, Any]:
    """A JSON form of the modes; null where a number is unknown, no `shape_im` of real shapes.

    Parameters
    ----------
    modes : ModeSet
    uncertainty : Uncertainty, optional
    reasons : sequence of str, optional
        The evidence for each mode.
    others : OtherCandidates, optional
        Doubtful modes and harmonics: rows of the same form, under `others`.
    """
    rows = list(_rows(modes, uncertainty, reasons))
    return (
        {"modes": [row | {"class": "natural"} for row in rows]}
        | _rest(modes)
        | _others(others)
    )


def _others(others: OtherCandidates | None) -> dict[str, Any]:
    if others is None:
        return {}
    rows = _rows(others.modes, others.uncertainty, tuple(map(sentence, others.notes)))
    return {
        "others": [
            row | {"class": kind}
            for row, kind in zip(rows, others.classes, strict=True)
        ]
    }


def _rest(modes: ModeSet) -> dict[str, Any]:
    return {
        "channels": list(modes.channels),
        "scaling": str(modes.norm),
        "source": modes.source,
    }


def _rows(
    modes: ModeSet, uncertainty: Uncertainty | None, reasons: Sequence[str]
) -> Iterator[dict[str, Any]]:
    nothing = np.full(len(modes), np.nan)
    std_f = uncertainty.frequency if uncertainty else nothing
    std_z = uncertainty.damping if uncertainty else nothing
    for k in range(len(modes)):
        yield {
            "frequency_hz": _number(modes.frequencies[k]),
            "damping": _number(modes.damping[k]),
            "std_frequency_hz": _number(std_f[k]),
            "std_damping": _number(std_z[k]),
            "shape_re": _numbers(modes.shapes[:, k].real),
            "shape_im": _numbers(modes.shapes[:, k].imag)
            if np.iscomplexobj(modes.shapes)
            else [],
            "confidence": _number(modes.confidence[k]),
            "reason": reasons[k] if k < len(reasons) else None,
        }


def _number(x: float) -> float | None:
    return float(x) if math.isfinite(x) else None


def _numbers(x: Float) -> list[float | None]:
    every = x.tolist()
    return every if np.isfinite(x).all() else [_number(v) for v in every]


def dump_modes(
    file: TextIO,
    modes: ModeSet,
    uncertainty: Uncertainty | None = None,
    reasons: Sequence[str] = (),
    more: Mapping[str, Any] | None = None,
) -> None:
    """Write `modes_to_json` and what `more` adds to it, one mode after the other: shapes of whole
    models are large.
    """
    file.write('{"modes": [')
    for k, row in enumerate(_rows(modes, uncertainty, reasons)):
        file.write((",\n " if k else "\n ") + json.dumps(row, allow_nan=False))
    file.write(
        "],\n" + json.dumps(_rest(modes) | dict(more or {}), allow_nan=False)[1:] + "\n"
    )


def modes_from_json(table: Mapping[str, Any], source: str = "") -> ModeSet:
    """The modes of `modes_to_json`; without channels they have frequencies and damping alone.

    Raises
    ------
    DataError
        If a key is missing or the numbers do not fit together.
    """
    try:
        rows = table["modes"]
        channels = tuple(str(c) for c in table.get("channels", ()))
        shapes = np.zeros((len(rows), len(channels)), dtype=np.complex128)
        for k, row in enumerate(rows):
            if not isinstance(row, Mapping):
                raise TypeError(
                    f"mode {k + 1} is {row!r}; it must be a table with frequency_hz"
                )
            re = np.array(row.get("shape_re", ()), dtype=np.float64)
            im = np.array(row.get("shape_im") or np.zeros(re.size), dtype=np.float64)
            if not re.size == im.size == len(channels):
                raise ValueError(
                    f"shape_re of mode {k + 1} has {re.size} components and shape_im {im.size}, "
                    f"for {len(channels)} channels"
                )
            shapes[k] = re + 1j * im
        frequency, damping = (_column(rows, key) for key in ("frequency_hz", "damping"))
        confidence = _column(rows, "confidence", 1.0)
        norm = Norm(table.get("scaling") or Norm.UNSCALED)
    except (KeyError, TypeError, ValueError) as exc:
        raise DataError(
            f"{source}: not a table of modes ({type(exc).__name__}: {exc})"
        ) from exc
    if not np.isfinite(frequency).all():
        at = int(np.isfinite(frequency).argmin())
        raise DataError(f"{source}: mode {at + 1} has no frequency_hz")
    return ModeSet(
        frequencies=frequency,
        damping=damping,
        shapes=(shapes if shapes.imag.any() else shapes.real).T,
        labels=channels,
        norm=norm,
        source=str(table.get("source") or source),
        confidence=confidence,
    )


def _column(
    rows: Sequence[Mapping[str, Any]], key: str, default: float = math.nan
) -> Float:
    """One number a mode; `default` where it is null or missing."""
    given = [row.get(key) for row in rows]
    for k, x in enumerate(given, start=1):
        if not (x is None or isinstance(x, int | float)):
            raise DataError(f"mode {k}: {key} is {x!r}; it must be a number")
    return np.array([default if x is None else x for x in given], dtype=np.float64)


def write_modes(
    path: str | Path,
    modes: ModeSet,
    uncertainty: Uncertainty | None = None,
    reasons: Sequence[str] = (),
    others: OtherCandidates | None = None,
) -> None:
    """Write modes as `.json`, `.h5`, `.uff` (data sets 55) or `.csv`, by the ending of the path."""
    path = Path(path)
    ext = path.suffix.lower()
    if ext == ".json":
        with atomic_write(path) as part, part.open("w", encoding="utf-8") as file:
            dump_modes(file, modes, uncertainty, reasons, more=_others(others))
    elif ext in _HDF5:
        with atomic_write(path) as part, h5py.File(part, "w") as file:
            hdf5.save(file.create_group(GROUP), modes)
            if uncertainty is not None:
                hdf5.save(file.create_group("uncertainty"), uncertainty)
    elif ext in _UFF:
        write_mode_sets(path, modes)
    elif ext == ".csv":
        write_mode_table(path, modes, uncertainty)
    else:
        refuse_ending(path, WRITTEN)


def read_modes(path: str | Path) -> ModeSet:
    """Read modes from JSON, HDF5, universal files (data sets 55), or a table of text or Excel.

    Raises
    ------
    DataError
        If the file is missing, unreadable or holds no modes.
    """
    path = existing(path)
    held = format_of(path)
    if held is Format.JSON:
        table = read_json(path)
        if not isinstance(table, dict):
            raise DataError(
                f"{path}: not a table of modes; it must have `modes` and `channels`"
            )
        modes = modes_from_json(table, str(path))
    elif held is Format.HDF5:
        with open_hdf5(path) as file:
            modes = hdf5.load(file.get(GROUP, file))
        if not isinstance(modes, ModeSet):
            raise DataError(f"{path}: holds a {type(modes).__name__}, not modes")
    elif held is Format.UFF:
        modes = read_mode_sets(path)
    elif held in _TABLES:
        modes = read_mode_table(path)[0]
    else:
        refuse_format(path, "modes", _READ)
    with about(path):
        refuse_large(modes.frequencies, "frequency")
        refuse_large(modes.damping, "damping")
        refuse_large(modes.shapes, "shape")
    return modes


def read_std(path: str | Path) -> tuple[Float, Float]:
    """Standard deviations in a file that `read_modes` reads; NaN where it has none.

    Returns
    -------
    frequency : (m,) float64, Hz
    damping : (m,) float64, of the ratio
    """
    path = existing(path)
    held = format_of(path)
    if held in _TABLES:
        return read_mode_table(path)[1:]
    modes = read_modes(path)
    nothing = np.full(len(modes), np.nan)
    if held is Format.JSON:
        rows = read_json(path)["modes"]
        with about(path):
            return _column(rows, "std_frequency_hz"), _column(rows, "std_damping")
    if held is Format.HDF5:
        with open_hdf5(path) as file:
            found = hdf5.load(file["uncertainty"]) if "uncertainty" in file else None
        if isinstance(found, Uncertainty) and found.frequency.size == len(modes):
            return found.frequency, found.damping
    return nothing, nothing


_WHOSE = r"(natural|nat\.?|modal|damped|undamped|resonance|resonant|critical)?\s*"
_FREQUENCY = re.compile(
    rf"{_WHOSE}(f|fn|freq\.?|frequency|frequencies|frequenz|eigenfrequenz|eigenfrequency|fréquence)(?![^\W_])"
)
_DAMPING = re.compile(
    rf"{_WHOSE}(damping|damping ratio|zeta|ζ|dämpfung|amortissement)(?![^\W_])"
)
_SPREAD = re.compile(r"(std|±|sigma|σ|deviation|uncertainty)\s*(of\s*)?")
_NUMBER = re.compile(r"[-+]?[\d.,]+([eEdD][-+]?\d+)?$")
_BESIDE = {
    "",
    "#",
    "no",
    "no.",
    "nr",
    "number",
    "mode",
    "modes",
    "name",
    "description",
    "comment",
    "reason",
    "mac",
    "mpc",
}


def read_mode_table(path: Path) -> tuple[ModeSet, Float, Float]:
    """Modes of a table whose first column, or first row, names `frequency [Hz]`, `damping [%]` and
    the channels.

    `std frequency [Hz]` and `std damping [%]` are standard deviations; frequencies in `[rad/s]`,
    `[rpm]` or `[kHz]` become Hz, damping without `[%]` is a fraction. Without channels the modes
    have frequencies alone. Empty cells were not measured.

    Returns
    -------
    modes : ModeSet
        In ascending frequency; complex where a cell is, such as 0.1+0.2j.
    frequency, damping : (m,) float64
        Standard deviations, Hz and of the ratio; NaN where there are none.

    Raises
    ------
    DataError
        If there is no mode, a cell is no number, two rows are one, or damping without `[%]` is
        above 0.25.
    """
    rows = [r for r in cells(path) if any(r) and not r[0].startswith("# ")]
    if not any(
        _FREQUENCY.match(r[0].lower()) and _NUMBER.match("".join(r[1:2])) for r in rows
    ):
        rows = [list(column) for column in zip_longest(*rows, fillvalue="")]
    found: dict[str, list[str]] = {}
    of: dict[str, str] = {}  # the row of each kind
    channels = []
    for label, *texts in rows:
        if label.lower() in _BESIDE:
            continue
        kind = _kind(label)
        if label in found or kind in of:
            why = (
                f"`{of[kind]}` and `{label}` are both {kind}"
                if kind
                else f"`{label}` occurs twice"
            )
            raise DataError(f"{path}: {why}")
        found[label] = texts
        if kind:
            of[kind] = label
        else:
            channels.append(label)
    if "frequency" not in of:
        raise DataError(
            f"{path}: no row or column `frequency [Hz]`; there are "
            f"{', '.join(list(found)[:8]) or 'none'}"
        )
    there = [i for i, text in enumerate(found[of["frequency"]]) if text]
    if not there:
        raise DataError(f"{path}: no mode below `{of['frequency']}`")
    number: dict[str, Complex] = {}
    for label, texts in found.items():
        texts = [*texts, *[""] * len(found[of["frequency"]])]
        numbers = [_cell_value(texts[i], label, path) for i in there]
        number[label] = np.array(numbers, dtype=np.complex128)
    nothing = np.full(len(there), np.nan)
    f, std_f = (
        number[of[k]].real * hertz(of[k]) if k in of else nothing
        for k in ("frequency", "std frequency")
    )
    zeta, std_z = (
        number[of[k]].real / (100 if "%" in of[k] else 1) if k in of else nothing
        for k in ("damping", "std damping")
    )
    if not np.isfinite(f).all():
        raise DataError(f"{path}: `{of['frequency']}`: frequencies must be finite")
    # 0.25: of critical: a typical damping above is taken for percent
    if (known := zeta[np.isfinite(zeta)]).size and np.median(known) > 0.25:
        raise DataError(
            f"{path}: `{of['damping']}`: {known[0]:g} of critical? What is in percent has [%] in "
            "its title"
        )
    order = np.argsort(f, kind="stable")
    shapes = np.array([number[c] for c in channels]).reshape(len(channels), len(there))[
        :, order
    ]
    values = shapes if shapes.imag.any() else shapes.real
    modes = ModeSet(f[order], zeta[order], values, tuple(channels), source=path.name)
    return modes, std_f[order], std_z[order]


def write_mode_table(
    path: Path, modes: ModeSet, uncertainty: Uncertainty | None = None
) -> None:
    """Write modes as CSV, a column a mode."""
    rows = [["mode", *(str(i + 1) for i in range(len(modes)))]]
    numbers = {"frequency [Hz]": modes.frequencies, "damping [%]": 100 * modes.damping}
    if uncertainty is not None:
        numbers["std frequency [Hz]"] = uncertainty.frequency
        numbers["std damping [%]"] = 100 * uncertainty.damping
    for title, values in (
        *numbers.items(),
        *zip(modes.channels, modes.shapes, strict=True),
    ):
        texts = (
            f"{x:.9g}".strip("()") if np.isfinite(x) else "" for x in values.tolist()
        )
        rows.append([title, *texts])
    with (
        atomic_write(path) as part,
        part.open("w", encoding="utf-8", newline="") as file,
    ):
        csv.writer(file).writerows(rows)


def _kind(label: str) -> str:
    """What a row holds: frequency, damping, their standard deviations; empty for a channel."""
    text = label.lower().strip()
    spread = _SPREAD.match(text)
    text = text[spread.end() :] if spread else text
    kind = (
        "frequency"
        if _FREQUENCY.match(text)
        else "damping"
        if _DAMPING.match(text)
        else ""
    )
    if spread and not kind:  # `± [Hz]`
        kind = "damping" if "%" in text else "frequency" if "hz" in text else ""
    return f"std {kind}" if spread and kind else kind


def _cell_value(text: str, label: str, path: Path) -> complex:
    if not text:
        return complex(np.nan)
    plain = text.lower() if "." in text else text.lower().replace(",", ".")
    try:
        value = complex(
            re.sub(r"[\s()*]", "", plain).replace("i", "j").replace("jnf", "inf")
        )
    except ValueError:
        value = complex(np.inf)
    if np.isinf(value):
        raise DataError(
            f"{path}: {label} is {text!r}; it must be a number, such as 0.12 or 0.1+0.2j"
        )
    return value
