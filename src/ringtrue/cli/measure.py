"""`oma`, `ema` and `correlate`: modes from signals, modes from FRFs, one set against another."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from ringtrue.cli.show import json_target, out, progress, rows, write_json
from ringtrue.core.modes import ModeSet
from ringtrue.core.uncertainty import Uncertainty
from ringtrue.correlate.pairing import PairingSettings, correlation_table, pair_modes
from ringtrue.errors import ConfigError, DataError, about
from ringtrue.identify.ambient import AmbientSettings, identify_ambient
from ringtrue.identify.hammer import HammerModes, identify_hammer
from ringtrue.io.frfs import read_frfs
from ringtrue.io.modes_json import modes_to_json, read_modes
from ringtrue.io.records import read_record
from ringtrue.study.summary import correlation_json

Json = Annotated[
    str | None, typer.Option("--json", metavar="FILE", help="Write JSON; - is standard output.", callback=json_target)
]
Fmin = Annotated[float | None, typer.Option("--fmin", metavar="HZ", help="Lowest frequency of interest.")]
Fmax = Annotated[float | None, typer.Option("--fmax", metavar="HZ", help="Highest frequency of interest.")]


def _print_modes(title: str, modes: ModeSet, std: Uncertainty | None, reasons: tuple[str, ...]) -> None:
    body: list[tuple[object, ...]] = []
    for i in range(len(modes)):
        sf, sz = (std.frequency[i], std.damping[i]) if std is not None else (float("nan"), float("nan"))
        f, z = modes.frequencies[i], modes.damping[i]
        note = reasons[i] if i < len(reasons) else ""
        body.append(
            (i + 1, f"{f:.5g}", f"{sf:.1e}", f"{100 * z:.3f}", f"{100 * sz:.3f}", f"{modes.confidence[i]:.2f}", note)
        )
    rows(title, ("#", "f [Hz]", "± [Hz]", "damping [%]", "± [%]", "confidence", "why"), body)


def _check_band(fmin: float | None, fmax: float | None) -> None:
    low, high = 0.0 if fmin is None else fmin, float("inf") if fmax is None else fmax
    if not 0 <= low < high:
        raise ConfigError(f"--fmin {fmin} --fmax {fmax}: must be 0 <= fmin < fmax")


def oma(
    record: Annotated[Path, typer.Argument(help=".h5, .npy (sample, channel), .csv, .mat or .uff")],
    rate: Annotated[
        float | None, typer.Option("--rate", metavar="HZ", help="Sampling rate, if the file has none.")
    ] = None,
    fmin: Fmin = None,
    fmax: Fmax = None,
    json: Json = None,
) -> int:
    """Modes from an ambient record: automatic covariance-driven SSI with standard deviations.

    Example: ringtrue oma tower.npy --rate 100 --fmax 10
    """
    _check_band(fmin, fmax)
    history = read_record(record, rate)
    with progress("ambient modes") as show, about(record):
        found = identify_ambient(history, AmbientSettings(fmin=fmin, fmax=fmax), progress=show)
    if json:
        write_json(modes_to_json(found.modes, found.uncertainty, reasons=found.reasons), json)
    if json != "-":
        _print_modes(f"{record}: {len(found.modes)} modes", found.modes, found.uncertainty, found.reasons)
        for note in found.notes:
            out.print(note, markup=False, highlight=False, soft_wrap=True)
    return 0 if len(found.modes) else 1


def ema(
    frf: Annotated[Path, typer.Argument(help=".h5, .npz with freq (f) and H1 (reference, response, f), or .uff")],
    fmin: Fmin = None,
    fmax: Fmax = None,
    window_decay: Annotated[
        float | None,
        typer.Option(metavar="1/S", help="Decay rate of the exponential window; taken out of the damping."),
    ] = None,
    json: Json = None,
) -> int:
    """Modes from FRFs: automatic poly-reference LSCF with residues and standard deviations.

    Example: ringtrue ema frf.npz --fmin 100 --fmax 5000
    """
    _check_band(fmin, fmax)
    frfs = read_frfs(frf)
    if window_decay is not None:
        if not 0 <= window_decay < float("inf"):
            raise ConfigError(f"--window-decay {window_decay}: must be 0 or more, 1/s")
        frfs = replace(frfs, window_decay=window_decay)
    with progress("modes from FRFs") as show, about(frf):
        found = identify_hammer(frfs, HammerModes(fmin=fmin, fmax=fmax), progress=show)
    if json:
        write_json(modes_to_json(found.modes, found.uncertainty, reasons=found.reasons), json)
    if json != "-":
        _print_modes(f"{frf}: {len(found.modes)} modes", found.modes, found.uncertainty, found.reasons)
    return 0 if len(found.modes) else 1


def _common(one: ModeSet, two: ModeSet, a: Path, b: Path) -> tuple[ModeSet, ModeSet]:
    """Both sets on the channels that they share."""
    here = set(two.channels)
    common = [c for c in one.channels if c in here]
    if not common:
        raise DataError(f"{a} and {b} have no channel in common: {one.channels[:5]} against {two.channels[:5]}")
    return one.rows(common), two.rows(common)


def correlate(
    a: Annotated[Path, typer.Argument(help="Reference modes (test): .json, .h5 or .uff")],
    b: Annotated[Path, typer.Argument(help="Modes to judge: .json, .h5 or .uff")],
    json: Json = None,
) -> int:
    """Pair two sets of modes on their common channels: deviation, MAC, and why the rest have no partner.

    Example: ringtrue correlate test.json fe.json --json -
    """
    one, two = _common(read_modes(a), read_modes(b), a, b)
    names = ("A", "B")
    table = correlation_table(one, two, pair_modes(one, two, PairingSettings(), names=names), names=names)
    value: dict[str, Any] = correlation_json(table)
    if json:
        write_json(value, json)
    if json != "-":
        body = [
            (
                r["test_mode"],
                r["fe_mode"],
                f"{r['frequency_test_hz']:.4g}",
                f"{r['frequency_fe_hz']:.4g}",
                f"{r['deviation_percent']:+.2f}",
                f"{r['mac_percent']:.1f}",
            )
            for r in value["pairs"]
        ]
        rows(f"{a} against {b}", ("A", "B", "f A [Hz]", "f B [Hz]", "deviation [%]", "MAC [%]"), body)
        for u in value["unpaired"]:
            out.print(f"{u['set']} {u['mode']}: {u['reason']}", markup=False, highlight=False, soft_wrap=True)
    return 0 if value["pairs"] else 1


def register(app: typer.Typer) -> None:
    """Add the commands."""
    for command in (oma, ema, correlate):
        app.command()(command)
