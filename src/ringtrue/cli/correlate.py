"""`correlate` and `track`: modes against modes, and modes of long records from hour to hour."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from math import degrees
from pathlib import Path
from typing import Annotated, Any, get_args

import numpy as np
import typer

from ringtrue.api.comparison import Correlation, RecordParts, track_records
from ringtrue.api.comparison import correlate as compare
from ringtrue.api.measurements import TestModes, read_modes
from ringtrue.api.models import read_deck
from ringtrue.cli.identify import Fmax, Fmin, LeaveOut, Rate
from ringtrue.cli.show import (
    Json,
    Tolerance,
    file_to,
    listed,
    one_of,
    out,
    progress,
    rows,
    tell,
    warn_of_units,
    write_json,
)
from ringtrue.core.arrays import Float
from ringtrue.core.units import UNIT_SYSTEMS
from ringtrue.correlation.measures import CompleteCorrelation, complete_json
from ringtrue.correlation.sensor_mapping import Method
from ringtrue.correlation.sensor_mounting import mendings_json
from ringtrue.errors import ConfigError
from ringtrue.identification.common.tracking import ModeTrack, Tracked
from ringtrue.io.files import atomic_write
from ringtrue.io.recognition import Format, format_of
from ringtrue.model.model import Model
from ringtrue.plots.correlation import tracking_page
from ringtrue.signal.spectra import check_band
from ringtrue.study.config_sections import CorrelateSection
from ringtrue.study.placing import seats_json
from ringtrue.study.summary import correlation_json, finite

ON_SHEET = "of the places of a sheet on a deck; give --sensors"


def _decks(
    a: Path, b: Path, sensors: Path | None, align: str | None
) -> tuple[bool, bool]:
    """Whether A and B are decks; what cannot be held against each other is refused."""
    first, second = (format_of(x) is Format.DECK for x in (a, b))
    if sensors is not None and not second:
        raise ConfigError(
            f"--sensors is for a deck; {b} holds modes at channels already"
        )
    if first and not second:
        raise ConfigError(f"{a} is a deck: name the modes of the test first, `{b} {a}`")
    if first and (sensors is not None or align):
        raise ConfigError(
            f"{a} and {b}: decks are compared at their nodes, in one frame; leave out --sensors "
            "and --align"
        )
    if align and sensors is None:
        raise ConfigError(
            f"--align {align}: lays the places of a sheet onto a deck; give --sensors"
        )
    return first, second


def _modes_or_deck(path: Path, units: str) -> TestModes | Model:
    """Modes of a file or a study, or a deck that is solved."""
    if format_of(path) is not Format.DECK:
        return read_modes(path)
    model = read_deck(path, units=units)
    warn_of_units(model, units)
    return model


def _reasons(unpaired: Sequence[dict[str, Any]]) -> list[str]:
    """Why modes have no partner: a line each of A, of B (a model may have hundreds) one for all of
    one reason.
    """
    by_reason: dict[tuple[str, str], list[int]] = {}
    for u in unpaired:
        reason = u["reason"] if u["set"] == "A" else u["reason"].split(": best")[0]
        by_reason.setdefault((u["set"], reason), []).append(u["mode"])
    return [
        f"{name} {listed(modes)}: {reason}"
        for (name, reason), modes in by_reason.items()
    ]


def _show_pairs(title: str, pairs: Sequence[dict[str, Any]]) -> None:
    body = [
        (
            p["test_mode"],
            p["fe_mode"],
            f"{p['frequency_test_hz']:.4g}",
            f"{p['frequency_fe_hz']:.4g}",
            f"{round(p['deviation_percent'], 2) + 0.0:+.2f}",
            "-" if p["mac_percent"] is None else f"{p['mac_percent']:.1f}",
            "-"
            if p["subspace_mac_percent"] is None
            else f"{p['subspace_mac_percent']:.1f}",
        )
        for p in pairs
    ]
    rows(
        title,
        (
            "A",
            "B",
            "f A [Hz]",
            "f B [Hz]",
            "deviation [%]",
            "MAC [%]",
            "subspace MAC [%]",
        ),
        body,
    )


def _show_complete(c: CompleteCorrelation) -> None:
    for check in c.checks:
        out.print(
            f"{check.name}: {'' if c.judges(check) else 'not to be judged, '}{check.verdict}"
        )
    if unfit := list(dict.fromkeys(k.mass for k in c.checks if not c.judges(k))):
        tell(
            [
                f"the {' and the '.join(unfit)} mass cannot judge it: readings with 2 % error "
                'alone fail; `tam = "craig-bampton"` in [correlate] of a study may'
            ]
        )
    out.print(
        f"largest off-diagonal auto-MAC: A {100 * c.auto_mac[0]:.1f} %, B "
        f"{100 * c.auto_mac[1]:.1f} %"
    )
    if c.scale.size:  # pairs
        worst = c.by_channel.comac.argsort(kind="stable")[:5].tolist()
        out.print(
            "lowest CoMAC: "
            + ", ".join(
                f"{c.channels[i]} {100 * c.by_channel.comac[i]:.1f} %" for i in worst
            )
        )
    left_out = zip(
        c.by_channel.elimination.order[:5].tolist(),
        c.by_channel.elimination.mac[1:6],
        strict=True,
    )
    for i, (channel, mac) in enumerate(left_out):
        out.print(
            f"{'then' if i else 'first'} left out {c.channels[channel]}: mean MAC "
            f"{100 * mac.mean():.2f} %"
        )
    for group in c.subspaces:
        modes = (" ".join(str(i + 1) for i in side) for side in (group.a, group.b))
        angles = " ".join(f"{degrees(x):.1f}" for x in group.angles)
        out.print(
            "close modes A {} and B {}: principal angles {}°".format(*modes, angles)
        )
    # a mode that was not seen at these channels has none
    if (seen := c.complexity.mpc[c.complexity.mpc > 0]).size:
        out.print(f"lowest phase collinearity of A: {100 * seen.min():.1f} %")
    for s in c.suspects:
        out.print(f"channel {s.channel} looks {s.fault}: {s.message}")
    total, count, p = c.significance.chi_square
    if count:
        beyond = int(c.significance.significant.sum())
        out.print(
            f"{beyond} of {count} deviations are beyond their uncertainty (chi-square "
            f"{total:.3g}, p {p:.2g})"
        )
    tell(c.notes)


def correlate(
    a: Annotated[
        Path,
        typer.Argument(
            help="Reference modes (test): .json, .h5, .uff, .csv or .xlsx; or a deck"
        ),
    ],
    b: Annotated[
        Path,
        typer.Argument(
            help="Modes to judge: such a file, or a Nastran deck, which is solved"
        ),
    ],
    sensors: Annotated[
        Path | None,
        typer.Option(
            help="Sensor sheet of A for a deck; without it, channels are DOFs such as 101+Z."
        ),
    ] = None,
    units: Annotated[
        str | None, one_of("--units", UNIT_SYSTEMS, "Unit system of decks", "SI")
    ] = None,
    tolerance: Tolerance = None,
    match: Annotated[
        str | None,
        one_of(
            "--match", get_args(Method), "What a sensor off the nodes reads", "nearest"
        ),
    ] = None,
    align: Annotated[
        str | None,
        one_of(
            "--align",
            ("points", "nearest"),
            "Lay the sheet onto the deck, by points numbered as nodes or nearest",
        ),
    ] = None,
    mac_gate: Annotated[
        float | None,
        typer.Option(
            metavar="%",
            help="Least MAC of a pair.",
            min=0.1,
            max=99.9,
            show_default="60",
        ),
    ] = None,
    frequency_gate: Annotated[
        float | None,
        typer.Option(
            metavar="%",
            help="Largest deviation of a pair.",
            min=1e-6,
            show_default="40; farther off only modes that look like no other",
        ),
    ] = None,
    lock: Annotated[
        list[str] | None,
        typer.Option(
            "--lock", metavar="A:B", help="Modes that belong together, such as 3:4."
        ),
    ] = None,
    forbid: Annotated[
        list[str] | None,
        typer.Option(
            "--forbid", metavar="A:B", help="Modes that do not belong together."
        ),
    ] = None,
    everything: Annotated[
        bool,
        typer.Option(
            "--complete",
            help="Orthogonality, CoMAC, channels, complexity, significance.",
        ),
    ] = False,
    json: Json = None,
) -> int:
    """Pair two sets of modes on their common channels: deviation, MAC, and why the rest have no
    partner.

    Example: ringtrue correlate test.json wing.bdf --sensors sensors.csv --complete
    """
    both, deck = _decks(a, b, sensors, align)
    idle = (
        ("--units", units, deck, "no deck is given"),
        ("--match", match, sensors is not None, ON_SHEET),
        ("--tolerance", tolerance, both or sensors is not None, ON_SHEET),
    )
    for name, value, counts, why in idle:
        if value is not None and not counts:
            raise ConfigError(f"{name} {value}: {why}")
    given = {
        "match": match,
        "align": align,
        "mac_gate": None if mac_gate is None else mac_gate / 100,
        "frequency_gate": None if frequency_gate is None else frequency_gate / 100,
        "tolerance": tolerance,
    }
    settings = CorrelateSection.model_validate(
        {k: v for k, v in given.items() if v is not None}
    )
    with progress("correlate") as show:
        show(0.0, f"reading {a} and {b}")
        found = compare(
            _modes_or_deck(a, units or "SI"),
            _modes_or_deck(b, units or "SI"),
            sensors=sensors,
            lock=lock or (),
            forbid=forbid or (),
            evidence=everything,
            settings=settings,
            names=("A", "B"),
            progress=show,
        )
    _show(f"{a} against {b}", found, json)
    return 0 if len(found.table) else 1


def _show(title: str, found: Correlation, json: str | None) -> None:
    value = correlation_json(found.table)
    value |= {"sensors": seats_json(found.seats)} if found.seats else {}
    value |= {"mendings": mendings_json(found.mendings)} if found.mendings else {}
    if found.complete is not None:
        value["complete"] = complete_json(found.complete, found.table.pairing)
    if json:
        write_json(value, json)
    if json == "-":
        return
    _show_pairs(title, value["pairs"])
    tell(
        [*(m.text for m in found.mendings), *_reasons(value["unpaired"]), *found.notes]
    )
    if found.complete is not None:
        _show_complete(found.complete)


HEADS = (
    "time_h",
    "mode",
    "frequency_hz",
    "std_frequency_hz",
    "damping",
    "std_damping",
    "confidence",
    "mac",
)


def track(
    records: Annotated[
        list[Path],
        typer.Argument(help="Records in order of time: .h5, .npy, .csv, .mat or .uff"),
    ],
    hours: Annotated[
        float, typer.Option("--hours", metavar="H", help="Length of a part.")
    ] = 1.0,
    starts: Annotated[
        str | None,
        typer.Option(
            "--starts",
            metavar="H,H,...",
            help="Start of each record; without it one follows the other.",
        ),
    ] = None,
    rate: Rate = None,
    fmin: Fmin = None,
    fmax: Fmax = None,
    leave_out: LeaveOut = None,
    table: Annotated[
        Path | None,
        file_to("--csv", "Write a line for each mode and part", ".csv"),
    ] = None,
    plot: Annotated[
        Path | None,
        file_to("--plot", "Write the figures as one page", ".html"),
    ] = None,
    json: Json = None,
) -> int:
    """Modes followed through long records, from part to part.

    Example: ringtrue track day1.h5 day2.h5 --hours 1 --csv modes.csv --plot modes.html
    """
    check_band(fmin, fmax)
    try:
        begins = [float(x) for x in starts.split(",")] if starts is not None else []
    except ValueError as e:
        raise ConfigError(f"--starts {starts!r}: hours, separated by commas") from e
    cut = RecordParts(hours, begins, rate, leave_out or ())
    with progress("modes through time") as show:
        tracked, notes = track_records(
            records, cut, fmin=fmin, fmax=fmax, progress=show
        )
    if table:
        _write(table, _csv(tracked))
    if plot:
        title = " ".join(p.name for p in records[:3]) + (
            " ..." if len(records) > 3 else ""
        )
        _write(plot, tracking_page(title, tracked, notes))
    if json:
        write_json(finite(_json(tracked, notes)), json)
    if json != "-":
        _show_tracks(tracked, notes)
    return 0 if tracked.tracks else 1


def _write(path: Path, text: str) -> None:
    with atomic_write(path) as part:
        part.write_text(text, encoding="utf-8")


def _columns(t: ModeTrack) -> dict[str, Float]:
    """The columns of the table, a value for each part that shows the mode."""
    return {
        "frequency_hz": t.frequency,
        "std_frequency_hz": t.std_frequency,
        "damping": t.damping,
        "std_damping": t.std_damping,
        "confidence": t.confidence,
        "mac": t.mac,
    }


def _csv(tracked: Tracked) -> str:
    text = io.StringIO()
    write = csv.writer(text, lineterminator="\n")
    write.writerow(HEADS)
    for t in tracked.tracks:
        values = np.array(list(_columns(t).values())).T
        for at, row in zip(t.at.tolist(), values.tolist(), strict=True):
            cells = [f"{x:.8g}" if math.isfinite(x) else "" for x in row]
            write.writerow([f"{tracked.times[at]:.6g}", t.name, *cells])
    return text.getvalue()


def _json(tracked: Tracked, notes: Sequence[str]) -> dict[str, Any]:
    modes = []
    for t in tracked.tracks:
        mode = {"name": t.name, "time_h": tracked.times[t.at].tolist()}
        mode |= {name: values.tolist() for name, values in _columns(t).items()}
        mode["shape_re"] = t.shape.real.tolist()
        mode["shape_im"] = t.shape.imag.tolist()
        modes.append(mode)
    return {
        "stretches": [{"time_h": hour} for hour in tracked.times.tolist()],
        "channels": list(tracked.channels),
        "modes": modes,
        "notes": list(notes),
    }


def _show_tracks(tracked: Tracked, notes: Sequence[str]) -> None:
    body: list[tuple[object, ...]] = []
    for t in tracked.tracks:
        span = f"{t.frequency.min():.5g} .. {t.frequency.max():.5g}"
        seen = f"{t.at.size} of {tracked.times.size}"
        damping = f"{100 * np.median(t.damping):.3f}"
        first = f"{tracked.times[t.at[0]]:.4g}"
        body.append((t.name, f"{t.frequency.mean():.5g}", span, damping, seen, first))
    heads = ("mode", "f [Hz]", "from .. to", "damping [%]", "parts", "first seen [h]")
    rows(f"{len(tracked.tracks)} modes through {tracked.times.size} parts", heads, body)
    tell(notes)
