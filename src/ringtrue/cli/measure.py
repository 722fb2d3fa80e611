"""`correlate`: one set of modes against another."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from math import degrees
from pathlib import Path
from typing import Annotated, Any, get_args

import numpy as np
import typer

from ringtrue.cli.show import (
    Json,
    Tolerance,
    listed,
    one_of,
    out,
    progress,
    rows,
    tell,
    write_json,
)
from ringtrue.cli.stated import stated
from ringtrue.core.arrays import Float
from ringtrue.core.channels import match_channels, split_label
from ringtrue.core.modes import ModeSet, elastic
from ringtrue.core.progress import part
from ringtrue.core.testmodel import Observation, TestModel
from ringtrue.core.units import UNIT_SYSTEMS
from ringtrue.correlation.measures import CompleteCorrelation, complete, complete_json
from ringtrue.correlation.pairing import Locks, pair_modes
from ringtrue.correlation.sensor_mapping import Method, at_dofs
from ringtrue.correlation.sensor_mounting import (
    AXES,
    Readings,
    find_mendings,
    mendings_json,
    readings_by_name,
)
from ringtrue.correlation.table import correlation_table
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.errors import ConfigError, DataError, about
from ringtrue.io.matrices import read_matrices
from ringtrue.io.modes_json import READ, read_modes, read_std
from ringtrue.io.sheets import read_sensor_sheet
from ringtrue.model.ports import ModesRequest
from ringtrue.study.config_correlate import CorrelateSection, Tam
from ringtrue.study.evidence import NAMES, ChannelMass, channel_mass, gate
from ringtrue.study.opened import Opened
from ringtrue.study.placing import (
    alignment,
    between_nodes,
    mesh_points,
    near_mesh,
    placed,
    readings,
    shared_places,
    words,
)
from ringtrue.study.reference import at_common, highest, positions
from ringtrue.study.results import Seat
from ringtrue.study.seats import seat_words, seats, seats_json
from ringtrue.study.summary import correlation_json

LOWEST = 26  # modes of a deck in the place of a test
OF_ORTHOGONALITY = "gate of the orthogonality; give --complete or --mass"
BY_FREQUENCY = (
    "no shapes: modes are paired by frequency alone; --lock and --forbid decide otherwise"
)


def _common(one: ModeSet, two: ModeSet, a: Path, b: Path) -> tuple[ModeSet, ModeSet]:
    """Both sets on the channels that they share; on none where one tells frequencies alone."""
    index, sign = match_channels(one.channels, two.channels)
    at = np.flatnonzero(index >= 0)
    if not at.size and one.channels and two.channels:
        raise DataError(
            f"{a} and {b} have no channel in common: {one.channels[:5]} against {two.channels[:5]}"
        )
    common = tuple(one.channels[k] for k in at.tolist())
    return one.rows(common), replace(
        two, shapes=two.shapes[index[at]] * sign[at, None], labels=common
    )


def _decks(a: Path, b: Path, sensors: Path | None, align: str | None) -> tuple[bool, bool]:
    """Whether A and B are decks; what cannot be held against each other is refused."""
    first, second = (x.suffix.lower() not in READ for x in (a, b))
    if sensors is not None and not second:
        raise ConfigError(f"--sensors is for a deck; {b} holds modes at channels already")
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


def _refuse_idle(given: Mapping[str, tuple[object, bool, str]]) -> None:
    """Refuse options (value, whether it counts here, why not) that would change nothing."""
    for name, (value, counts, why) in given.items():
        if value is not None and not counts:
            raise ConfigError(f"{name} {value}: {why}")


def _as_test(deck: Path, units: str) -> tuple[ModeSet, TestModel, str]:
    """The lowest elastic modes of a deck at its nodes, as of a test, and how they are numbered."""
    with progress("correlate") as show:
        show(0.0, f"reading {deck}")
        opened = Opened(stated(read_deck(deck), units), UNIT_SYSTEMS[units].length)
        found = opened.analysis.modes(ModesRequest(LOWEST)).modes
    at = np.flatnonzero(elastic(found.frequencies))
    if not at.size:
        raise DataError(f"{deck}: none of its {len(found)} lowest modes is elastic")
    modes, points = found.take(at), mesh_points(opened)
    shapes = at_dofs(points.channels, opened.analysis.dofs, opened.length)(modes.shapes)
    there = ModeSet(
        modes.frequencies, modes.damping, shapes, points.channels, modes.norm, str(deck)
    )
    return there, points, f"mode 1 of A is mode {at[0] + 1} of {deck}" if at[0] else ""


@dataclass(frozen=True, slots=True, eq=False)
class OfDeck:
    """What is held against a test.

    Attributes
    ----------
    modes : ModeSet
        At the channels of the test.
    notes : tuple of str
    mass : callable
        Of a deck, at the channels.
    seats : tuple of Seat
        Where channels on a sheet are read.
    readings : Readings, optional
        To try other mountings of the sensors by.
    """

    modes: ModeSet
    notes: tuple[str, ...] = ()
    mass: Callable[[], ChannelMass] = ChannelMass
    seats: tuple[Seat, ...] = ()
    readings: Readings | None = None


def _of_deck(
    deck: Path,
    test: ModeSet,
    sensors: Path | TestModel | None,
    units: str,
    asked: CorrelateSection,
) -> OfDeck:
    """The modes of a deck at the channels of a test, as far up as a partner may lie."""
    unit = UNIT_SYSTEMS[units].length
    reach = highest(test.frequencies, asked.gates())
    notes: list[str] = []
    places: tuple[Seat, ...] = ()
    with progress("correlate") as show:
        show(0.0, f"reading {deck}")
        opened = Opened(stated(read_deck(deck), units), unit)
        here, channels = sensors if isinstance(sensors, TestModel) else None, test.channels
        if isinstance(sensors, Path):
            sheet = read_sensor_sheet(sensors)
            here = sheet.model
            names = dict(zip(channels, here.named(channels)[0], strict=True))
            if lost := [c for c in channels if names[c] in sheet.strain]:
                channels = tuple(c for c in channels if c not in lost)
                notes.append(
                    f"not compared, of strain: {' '.join(lost[:8])}{' ...' * (len(lost) > 8)}"
                )
        if isinstance(sensors, TestModel):
            here, near = near_mesh(sensors, opened, asked.tolerance)
            channels = here.channels
            count = np.unique(here.at).size
            notes.append(
                f"{count} of {sensors.points.size} nodes of A are within {near:.3g} m of one of B"
            )
        with about(sensors) if isinstance(sensors, Path) else nullcontext():
            given = here
            found = (
                alignment(here, opened, asked.align) if here is not None and asked.align else None
            )
            if here is not None and found is not None:
                here = found.move(here)
                notes.append(words(found))

            def bridge(there: TestModel) -> Observation:
                on_deck = found.move(there) if found is not None else there
                return placed(
                    opened, there.channels, on_deck, tolerance=asked.tolerance, method=asked.match
                )

            look = placed(opened, channels, here, tolerance=asked.tolerance, method=asked.match)
        modes = opened.modes(reach, part(show, 0.3, 1.0)).modes
    there = ModeSet(
        modes.frequencies, modes.damping, look(modes.shapes), look.channels, modes.norm, str(deck)
    )
    if isinstance(sensors, Path) and here is not None:
        notes += (
            shared_places(opened, here.pick(channels), modes) if asked.match == "nearest" else ()
        )
        notes += between_nodes(opened, look, asked.match)
        places = seats(look, here)
        notes += seat_words(places)
    at_sensors = test.rows(channels)
    if given is None:
        tried = readings_by_name(at_sensors, _along_all(opened, modes, channels))
    else:
        tried = readings(at_sensors, modes, given, bridge)
    return OfDeck(
        there,
        tuple(notes),
        lambda: channel_mass(opened, look, channels, asked, reach),
        places,
        tried,
    )


def _along_all(opened: Opened, modes: ModeSet, channels: Sequence[str]) -> ModeSet:
    """The modes of a deck at channels that are its DOFs, and along the other axes of their
    nodes.
    """
    labels = [split_label(c) for c in channels]
    more = [f"{label[0]}+{axis}" for label in labels if label for axis in AXES]
    names = tuple(dict.fromkeys((*channels, *more)))
    shapes = at_dofs(names, opened.analysis.dofs, opened.length)(modes.shapes)
    return ModeSet(modes.frequencies, modes.damping, shapes, names, modes.norm, modes.source)


def _pair_list(option: str, texts: list[str] | None) -> tuple[tuple[int, int], ...]:
    """Pairs such as 3:4, modes from one, as positions from zero."""
    for text in texts or []:
        left, _, right = text.partition(":")
        if not (left.isdigit() and right.isdigit() and int(left) > 0 and int(right) > 0):
            raise ConfigError(
                f"{option} {text!r}: must be a mode of A and one of B, from 1, such as 3:4"
            )
    return positions(texts or ())


def _mass(path: Path, channels: int) -> Float:
    """The one matrix of a file, or that named M, over the channels."""
    found = read_matrices(path)
    mass = next(iter(found.matrices.values())) if len(found.matrices) == 1 else found["M"]
    if mass.shape != (channels, channels):
        raise DataError(
            f"{path}: mass {mass.shape}; there are {channels} common channels, in the order of A"
        )
    return mass.toarray()


def _reasons(unpaired: Sequence[dict[str, Any]]) -> list[str]:
    """Why modes have no partner: a line each of A, of B (a model may have hundreds) one for all of
    one reason.
    """
    told: dict[tuple[str, str], list[int]] = {}
    for u in unpaired:
        reason = u["reason"] if u["set"] == "A" else u["reason"].split(": best")[0]
        told.setdefault((u["set"], reason), []).append(u["mode"])
    return [f"{name} {listed(modes)}: {reason}" for (name, reason), modes in told.items()]


def _show_pairs(title: str, pairs: Sequence[dict[str, Any]]) -> None:
    body = [
        (
            p["test_mode"],
            p["fe_mode"],
            f"{p['frequency_test_hz']:.4g}",
            f"{p['frequency_fe_hz']:.4g}",
            f"{round(p['deviation_percent'], 2) + 0.0:+.2f}",
            "-" if p["mac_percent"] is None else f"{p['mac_percent']:.1f}",
            "-" if p["subspace_mac_percent"] is None else f"{p['subspace_mac_percent']:.1f}",
        )
        for p in pairs
    ]
    rows(
        title,
        ("A", "B", "f A [Hz]", "f B [Hz]", "deviation [%]", "MAC [%]", "subspace MAC [%]"),
        body,
    )


def _show_complete(c: CompleteCorrelation) -> None:
    for check in c.checks:
        out.print(f"{check.name}: {'' if c.judges(check) else 'not to be judged, '}{check.verdict}")
    if unfit := list(dict.fromkeys(k.mass for k in c.checks if not c.judges(k))):
        other = "" if "Craig-Bampton" in (k.mass for k in c.checks) else "; --tam craig-bampton may"
        tell(
            [
                f"the {' and the '.join(unfit)} mass cannot judge it: readings with 2 % error "
                f"alone fail{other}"
            ]
        )
    out.print(
        f"largest off-diagonal auto-MAC: A {100 * c.auto_mac[0]:.1f} %, B "
        f"{100 * c.auto_mac[1]:.1f} %"
    )
    if c.scale.size:  # pairs
        worst = c.comac.argsort(kind="stable")[:5].tolist()
        out.print(
            "lowest CoMAC: " + ", ".join(f"{c.channels[i]} {100 * c.comac[i]:.1f} %" for i in worst)
        )
    left_out = zip(c.elimination.order[:5].tolist(), c.elimination.mac[1:6], strict=True)
    for i, (channel, mac) in enumerate(left_out):
        out.print(
            f"{'then' if i else 'first'} left out {c.channels[channel]}: mean MAC "
            f"{100 * mac.mean():.2f} %"
        )
    for group in c.subspaces:
        modes = (" ".join(str(i + 1) for i in side) for side in (group.a, group.b))
        angles = " ".join(f"{degrees(x):.1f}" for x in group.angles)
        out.print("close modes A {} and B {}: principal angles {}°".format(*modes, angles))
    if (seen := c.mpc[c.mpc > 0]).size:  # a mode that was not seen at these channels has none
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
        typer.Argument(help="Reference modes (test): .json, .h5, .uff, .csv or .xlsx; or a deck"),
    ],
    b: Annotated[
        Path, typer.Argument(help="Modes to judge: such a file, or a Nastran deck, which is solved")
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
        one_of("--match", get_args(Method), "What a sensor off the nodes reads", "nearest"),
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
            metavar="%", help="Least MAC of a pair.", min=0.1, max=99.9, show_default="60"
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
        typer.Option("--lock", metavar="A:B", help="Modes that belong together, such as 3:4."),
    ] = None,
    forbid: Annotated[
        list[str] | None,
        typer.Option("--forbid", metavar="A:B", help="Modes that do not belong together."),
    ] = None,
    everything: Annotated[
        bool,
        typer.Option(
            "--complete", help="Orthogonality, CoMAC, channels, complexity, significance."
        ),
    ] = False,
    tam: Annotated[
        str | None,
        one_of("--tam", get_args(Tam), "Mass of a deck at the channels, with --complete", "irs"),
    ] = None,
    mass: Annotated[
        Path | None,
        typer.Option(
            "--mass", metavar="FILE", help="Mass at the common channels, in the order of A."
        ),
    ] = None,
    diagonal: Annotated[
        float | None,
        typer.Option(
            "--diagonal",
            metavar="%",
            help="Gate: least cross-orthogonality of a pair.",
            min=0,
            max=100,
            show_default="90",
        ),
    ] = None,
    off_diagonal: Annotated[
        float | None,
        typer.Option(
            "--off-diagonal",
            metavar="%",
            help="Gate: largest between different modes.",
            min=0,
            max=100,
            show_default="10",
        ),
    ] = None,
    json: Json = None,
) -> int:
    """Pair two sets of modes on their common channels: deviation, MAC, and why the rest have no
    partner.

    Example: ringtrue correlate test.json wing.bdf --sensors sensors.csv --complete
    """
    locks = Locks(_pair_list("--lock", lock), _pair_list("--forbid", forbid))
    both, deck = _decks(a, b, sensors, align)
    whole = everything or mass is not None
    _refuse_idle(
        {
            "--units": (units, deck, "no deck is given"),
            "--match": (
                match,
                sensors is not None,
                "of the places of a sheet on a deck; give --sensors",
            ),
            "--tolerance": (
                tolerance,
                both or sensors is not None,
                "of the places of a sheet from a deck; give --sensors",
            ),
            "--tam": (
                tam,
                everything and deck and mass is None,
                "the mass of a deck, for --complete without --mass",
            ),
            "--diagonal": (diagonal, whole, OF_ORTHOGONALITY),
            "--off-diagonal": (off_diagonal, whole, OF_ORTHOGONALITY),
        }
    )
    given = {
        "match": "rigid" if both else match,
        "align": align,
        "tam": tam,
        "mac_gate": None if mac_gate is None else mac_gate / 100,
        "frequency_gate": None if frequency_gate is None else frequency_gate / 100,
        "tolerance": tolerance,
        "accept_orthogonality": diagonal,
        "accept_off_diagonal": off_diagonal,
    }
    asked = CorrelateSection.model_validate({k: v for k, v in given.items() if v is not None})
    units = units or "SI"
    settings = asked.gates()
    test, points, first = _as_test(a, units) if both else (read_modes(a), sensors, "")
    test, gaps = at_common(test)
    if deck:
        held = _of_deck(b, test, points, units, asked)
    else:
        there, missing = at_common(read_modes(b))
        held = OfDeck(there, tuple(f"B: {g}" for g in missing))
    notes = (*(f"A: {g}" for g in gaps), *held.notes)
    one, two = _common(test, held.modes, a, b)
    tried = held.readings if deck else readings_by_name(one, held.modes)
    mendings = (
        find_mendings(tried, settings) if tried is not None and one.channels and not both else ()
    )
    if not one.channels:
        if whole:
            raise ConfigError(
                f"--complete and --mass compare shapes; {a if not test.channels else b} has none"
            )
        notes = (*notes, BY_FREQUENCY)
    names = ("A", "B")
    table = correlation_table(
        one, two, pair_modes(one, two, settings, names=names, locks=locks), names=names
    )
    notes = (*notes, *table.pairing.doubts(names), *table.pairing.far(names))
    value: dict[str, Any] = correlation_json(table)
    value |= {"sensors": seats_json(held.seats)} if held.seats else {}
    value |= {"mendings": mendings_json(mendings)} if mendings else {}
    full: CompleteCorrelation | None = None
    if whole:
        weight = ChannelMass(_mass(mass, len(one.channels))) if mass is not None else held.mass()
        full = complete(
            one,
            two,
            table.pairing,
            mass=weight.matrix,
            mass_name="given" if mass is not None else NAMES.get(asked.tam, asked.tam),
            lift=weight.lift,
            gate=gate(asked),
            std_a=0.0 if both else read_std(a)[0],
            std_b=0.0 if deck else read_std(b)[0],
            settings=settings,
        )
        notes = (*notes, *filter(None, [weight.why]))
        value["complete"] = complete_json(full, table.pairing)
    if json:
        write_json(value, json)
    if json != "-":
        _show_pairs(f"{a} against {b}", value["pairs"])
        tell(
            [
                *(m.text for m in mendings),
                *_reasons(value["unpaired"]),
                *filter(None, [first]),
                *notes,
            ]
        )
        if full is not None:
            _show_complete(full)
    return 0 if value["pairs"] else 1
