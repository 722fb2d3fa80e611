"""Modes as a table of CSV or Excel: a column a mode below rows of frequencies and damping, or a row
a mode.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Complex, Float
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.errors import DataError
from ringtrue.io.atomic import atomic_write
from ringtrue.io.sheets import cells
from ringtrue.io.si import hertz

_WHOSE = r"(natural|nat\.?|modal|damped|undamped|resonance|resonant|critical)?\s*"
_FREQUENCY = re.compile(
    rf"{_WHOSE}(f|fn|freq\.?|frequency|frequencies|frequenz|eigenfrequenz|eigenfrequency|fréquence)(?![^\W_])"
)
_DAMPING = re.compile(rf"{_WHOSE}(damping|damping ratio|zeta|ζ|dämpfung|amortissement)(?![^\W_])")
_SPREAD = re.compile(r"(std|±|sigma|σ|deviation|uncertainty)\s*(of\s*)?")
_HIGH = 0.25  # of critical: a typical damping above is taken for percent
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
_DIGITS = 9


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
        hardly a fraction.
    """
    rows = [r for r in cells(path) if any(r) and not r[0].startswith("# ")]
    width = max(map(len, rows), default=0)
    table = [r + [""] * (width - len(r)) for r in rows]
    if not any(_FREQUENCY.match(r[0].lower()) and _NUMBER.match("".join(r[1:2])) for r in table):
        table = [list(c) for c in zip(*table, strict=True)]
    labels = [r[0] for r in table]
    found = {
        label: r[1:] for label, r in zip(labels, table, strict=True) if label.lower() not in _BESIDE
    }
    kinds = {label: _kind(label) for label in found}
    of = {kind: label for label, kind in kinds.items() if kind}
    for label, kind in kinds.items():
        if labels.count(label) > 1 or (kind and of[kind] != label):
            told = (
                f"`{label}` and `{of[kind]}` are both {kind}"
                if kind
                else f"`{label}` stands there twice"
            )
            raise DataError(f"{path}: {told}")
    if "frequency" not in of:
        raise DataError(
            f"{path}: no row or column `frequency [Hz]`; there are "
            f"{', '.join(list(found)[:8]) or 'none'}"
        )
    there = [i for i, text in enumerate(found[of["frequency"]]) if text]
    if not there:
        raise DataError(f"{path}: no mode below `{of['frequency']}`")
    number = {label: _numbers([r[i] for i in there], label, path) for label, r in found.items()}
    nothing = np.full(len(there), np.nan)
    f, std_f, zeta, std_z = (
        _scaled(number[of[k]].real, of[k], k) if k in of else nothing
        for k in ("frequency", "std frequency", "damping", "std damping")
    )
    if not np.isfinite(f).all():
        raise DataError(f"{path}: `{of['frequency']}`: frequencies must be finite")
    if (known := zeta[np.isfinite(zeta)]).size and np.median(known) > _HIGH:
        raise DataError(
            f"{path}: `{of['damping']}`: {known[0]:g} of critical? What is in percent has [%] in "
            "its title"
        )
    channels = tuple(label for label, kind in kinds.items() if not kind)
    shapes = np.array([number[c] for c in channels]).reshape(len(channels), len(there))
    order = np.argsort(f, kind="stable")
    values = shapes[:, order] if shapes.imag.any() else shapes.real[:, order]
    return (
        ModeSet(f[order], zeta[order], values, channels, source=path.name),
        std_f[order],
        std_z[order],
    )


def write_mode_table(path: Path, modes: ModeSet, uncertainty: Uncertainty | None = None) -> None:
    """Write modes as CSV, a column a mode."""
    rows: list[list[str]] = [["mode", *(str(i + 1) for i in range(len(modes)))]]
    rows.append(["frequency [Hz]", *_texts(modes.frequencies)])
    rows.append(["damping [%]", *_texts(100 * modes.damping)])
    if uncertainty is not None:
        rows.append(["std frequency [Hz]", *_texts(uncertainty.frequency)])
        rows.append(["std damping [%]", *_texts(100 * uncertainty.damping)])
    rows += [[c, *_texts(row)] for c, row in zip(modes.channels, modes.shapes, strict=True)]
    with atomic_write(path) as part, part.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows(rows)


def _kind(label: str) -> str:
    """What a row holds: frequency, damping, their standard deviations; empty for a channel."""
    text = label.lower().strip()
    spread = _SPREAD.match(text)
    text = text[spread.end() :] if spread else text
    kind = "frequency" if _FREQUENCY.match(text) else "damping" if _DAMPING.match(text) else ""
    if spread and not kind:  # `± [Hz]`
        kind = "damping" if "%" in text else "frequency" if "hz" in text else ""
    return f"std {kind}" if spread and kind else kind


def _scaled(values: Float, label: str, kind: str) -> Float:
    """In Hz, or as a fraction."""
    if kind.endswith("frequency"):
        return values * hertz(label)
    return values / 100 if "%" in label else values


def _numbers(texts: Sequence[str], label: str, path: Path) -> Complex:
    return np.array([_number(t, label, path) for t in texts], dtype=np.complex128)


def _number(text: str, label: str, path: Path) -> complex:
    if not text:
        return complex(np.nan)
    plain = text if "." in text else text.replace(",", ".")
    try:
        value = complex(
            re.sub(r"[\s()*]", "", plain.lower()).replace("i", "j").replace("jnf", "inf")
        )
        if np.isinf(value):
            raise ValueError(text)
        return value
    except ValueError as exc:
        raise DataError(
            f"{path}: {label} is {text!r}; it must be a number, such as 0.12 or 0.1+0.2j"
        ) from exc


def _texts(values: Float | Complex) -> list[str]:
    """Cells; empty where there is no number."""
    form = f".{_DIGITS}g"
    return [f"{x:{form}}".strip("()") if np.isfinite(x) else "" for x in values.tolist()]
