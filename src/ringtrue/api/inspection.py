"""What is in a file of any format, and which commands take it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Any

import numpy as np

from ringtrue.core.display import Displayed
from ringtrue.core.modes import ModeSet
from ringtrue.core.signals import Channel, FrfSet, TimeHistory
from ringtrue.decks.nastran.deck import other_program
from ringtrue.decks.nastran.reader import survey
from ringtrue.decks.nastran.results.geometry import read_recorded_model
from ringtrue.decks.nastran.results.modes import (
    is_nastran_h5,
    read_recorded,
    read_recorded_deflections,
)
from ringtrue.decks.nastran.results.op2 import read_grid_point_weight
from ringtrue.decks.nastran.results.sensitivity import read_sensitivities
from ringtrue.errors import DataError, InputError, UnsupportedError
from ringtrue.io.campaign_tables import STATICS
from ringtrue.io.files import FUNCTIONS
from ringtrue.io.foreign.parsers import (
    open_hdf5,
    read_json,
    read_npy,
    read_npz,
    read_toml,
)
from ringtrue.io.frfs import holds_frfs, read_frfs
from ringtrue.io.matrices import read_matrices
from ringtrue.io.modes import read_modes
from ringtrue.io.recognition import SOLVER_RESULTS, Format, format_of
from ringtrue.io.record_table import RecordChannel, find_record
from ringtrue.io.records import raw_record, record_info
from ringtrue.io.sheets import REQUIRED, cells, read_sensor_sheet
from ringtrue.io.times import LONG, to_si
from ringtrue.io.uff.datasets import scan
from ringtrue.io.uff.function58 import FRF_TYPES, FunctionType
from ringtrue.io.uff.functions import read_functions
from ringtrue.io.uff.points import NODES
from ringtrue.signal.impacts import HammerSettings, force_channel
from ringtrue.study.store import Store, is_store

_CHOICES = frozenset(("automatic", "pick", "reject", "merge"))
_OF_FRF = (*FRF_TYPES, FunctionType.COHERENCE)


@dataclass(frozen=True)
class FilePart:
    """One thing that a file holds.

    Attributes
    ----------
    kind : str
        `record`, `FRFs`, `functions`, `modes`, `results`, `deck`, `sensors`, `choice`, `log`,
        `study`, `store`, `matrices`, `statics`, `deflections`, `weight`, `sensitivities`,
        `table` or `arrays`.
    values : mapping
        Its figures: counts, `rate_hz`, `duration_s`, `band_hz`, lists of names.
    commands : tuple of str
        What takes it, as lines to copy: of the shell, or of a study.toml.
    """

    kind: str
    values: Mapping[str, Any]
    commands: tuple[str, ...] = ()


@dataclass(frozen=True)
class FileContents(Displayed):
    """What a file is and holds.

    Attributes
    ----------
    path, format : str
    parts : tuple of FilePart
    problem : str
        Why it cannot be read, or read whole; empty where it can.
    """

    path: str
    format: str
    parts: tuple[FilePart, ...]
    problem: str = ""

    @property
    def commands(self) -> tuple[str, ...]:
        """What takes the file, as lines to copy."""
        return tuple(dict.fromkeys(c for part in self.parts for c in part.commands))


def inspect_file(path: str | Path) -> FileContents:
    """What is in a file of any format that ringtrue reads, found by its content.

    Parameters
    ----------
    path : str or Path
        A deck, results of a solver, a record, FRFs, modes, a sensor sheet, a study, ...

    Returns
    -------
    FileContents
        With shapes, units, rates and names, and the commands that take it. A damaged file has its
        `problem`.

    Raises
    ------
    DataError
        If there is no such file, or its format is not known.

    Examples
    --------
    >>> import ringtrue as rt
    >>> found = rt.inspect_file(rt.example_deck())
    >>> found.parts[0].kind, found.parts[0].values["nodes"]
    ('deck', 4)
    """
    path = Path(path)
    held = format_of(path)
    parts: list[FilePart] = []
    problem = ""
    try:
        parts += _PARTS[held](path) if held in _PARTS else _measured(path, held)
    except (InputError, UnsupportedError) as exc:
        problem = str(exc)
    return FileContents(str(path), str(held), tuple(parts), problem)


def _deck(path: Path) -> list[FilePart]:
    found = survey(path)
    name = quote(str(path))
    values = _counts(found.cards) | {"not read": sorted(found.unsupported)}
    commands = (
        f"ringtrue check {name} --units SI",
        f"ringtrue modes {name} --band 0 HZ",
    )
    return [FilePart("deck", values, commands)]


def _results(path: Path) -> list[FilePart]:
    """Modes, deflections, or the sensitivities of a SOL 200; the weight and the deck in an OP2."""
    others = (
        [*_weight(path), *_held_deck(path)] if format_of(path) is Format.OP2 else []
    )
    try:
        return [*_solved(path, any(part.kind == "deck" for part in others)), *others]
    except DataError:
        if others:
            return others
        raise


def _weight(path: Path) -> list[FilePart]:
    """Mass and centre of gravity, in the units of the run."""
    found = read_grid_point_weight(path)
    if found is None:
        return []
    centre = dict(zip(("x", "y", "z"), found.centre, strict=True))
    return [FilePart("weight", {"mass": found.mass, **centre})]


def _held_deck(path: Path) -> list[FilePart]:
    try:
        found = read_recorded_model(path)
    except DataError:
        return []
    values = _counts({card: len(table) for card, table in found.model.tables.items()})
    if not values["elements"]:
        return []
    values["not read"] = list(found.missing)
    return [
        FilePart("deck", values, (f"ringtrue convert {quote(str(path))} model.bdf",))
    ]


def _counts(cards: Mapping[str, int]) -> dict[str, Any]:
    """Nodes, elements and cards of a deck."""
    return {
        "nodes": cards.get("GRID", 0),
        "elements": sum(
            n for card, n in cards.items() if card[0] == "C" and card[:4] != "CORD"
        ),
        "cards": dict(sorted(cards.items(), key=lambda item: -item[1])),
    }


def _solved(path: Path, with_deck: bool) -> list[FilePart]:
    try:
        found = read_recorded(path)
    except DataError as exc:
        if moved := read_recorded_deflections(path):
            sizes = {"cases": len(moved.cases), "nodes": moved.nodes.size}
            command = f"ringtrue convert {quote(str(path))} deflections.csv"
            return [FilePart("deflections", sizes, (command,))]
        try:
            s = read_sensitivities(path)
        except DataError:
            raise exc from None
        sizes = {"responses": s.response.size, "variables": s.variable.size}
        return [FilePart("sensitivities", sizes)]
    f = np.sqrt(np.abs(found.eigenvalues)) / (2 * np.pi)
    values = {"modes": f.size, "nodes": found.nodes.size, "band_hz": _band(f)}
    command = f"ringtrue convert {quote(str(path))} modes.h5"
    if not with_deck:
        command += " --deck MODEL.bdf"
    return [FilePart("results", values, (command,))]


def _band(f: Any) -> list[float]:
    return [float(f.min()), float(f.max())] if len(f) else []


def _hdf5(path: Path) -> list[FilePart]:
    name = quote(str(path))
    if is_store(path):
        commands = (f"ringtrue report {name}", f"ringtrue convert {name} modes.json")
        return [FilePart("store", {"stages": list(Store(path).stages())}, commands)]
    if is_nastran_h5(path):
        return _results(path)
    with open_hdf5(path) as file:
        own = find_record(file) is not None
        modes = "modes" in file
    if own:
        info = record_info(path)
        return [_record(path, info.rate, info.samples, info.channels)]
    return [_modes(path, read_modes(path))] if modes else _measured(path, Format.HDF5)


def _measured(path: Path, held: Format) -> list[FilePart]:
    """FRFs, matrices or a record in a file of others."""
    if holds_frfs(path):
        return [_frfs(path, read_frfs(path))]
    if held in (Format.MATLAB, Format.HDF5):
        found = read_matrices(path)
        largest = max((a.size for a in found.arrays.values() if a.ndim == 2), default=0)
        if any(m.shape[0] * m.shape[1] >= largest for m in found.matrices.values()):
            return _matrices(path)
    return [_stored(path)]


def _stored(path: Path) -> FilePart:
    """A record of others; a short table without a rate is none."""
    table = raw_record(path)
    count, samples = table.data.shape
    if table.rate is None and samples < LONG:
        return FilePart(
            "table", {"columns": count, "rows": samples, "names": list(table.names)}
        )
    given = zip(table.names, table.units, table.quantities, strict=True)
    rows = tuple(
        RecordChannel(name, quantity=to_si(u, q)[0], unit=u) for name, u, q in given
    )
    return _record(path, table.rate, samples, rows)


def _record(
    path: Path, rate: float | None, samples: int, rows: Sequence[RecordChannel]
) -> FilePart:
    """A time record: `ema` takes those with a force."""
    channels = tuple(r.channel() for r in rows)
    values = {
        "channels": len(channels),
        "samples": samples,
        "rate_hz": rate,
        "duration_s": samples / rate if rate else None,
        "names": [f"{r.id} [{r.unit}]" if r.unit else r.id for r in rows],
    }
    name = quote(str(path)) + ("" if rate else " --rate HZ")
    if _has_force(channels):
        return FilePart("record", values, (f"ringtrue ema {name} --struck POINT",))
    return FilePart("record", values, (f"ringtrue oma {name}",))


def _has_force(channels: tuple[Channel, ...]) -> bool:
    try:
        force_channel(
            TimeHistory(np.zeros((len(channels), 2)), 1.0, channels),
            HammerSettings(force=""),
        )
    except InputError:
        return False
    return True


def _frfs(path: Path, frfs: FrfSet) -> FilePart:
    values = {
        "lines": frfs.freqs.size,
        "responses": len(frfs.outputs),
        "references": len(frfs.inputs),
        "band_hz": _band(frfs.freqs),
        "kind": frfs.kind,
        "names": [f"{c.id} [{c.unit}]" for c in frfs.outputs],
        "forces": [f"{c.id} [{c.unit}]" for c in frfs.inputs],
    }
    return FilePart("FRFs", values, (f"ringtrue ema {quote(str(path))}",))


def _modes(path: Path, modes: ModeSet) -> FilePart:
    values = {
        "modes": len(modes),
        "channels": len(modes.channels),
        "band_hz": _band(modes.frequencies),
        "names": list(modes.channels),
    }
    return FilePart(
        "modes", values, (f"ringtrue correlate {quote(str(path))} MODEL.bdf",)
    )


def _sensors(path: Path) -> FilePart:
    model = read_sensor_sheet(path).model
    values: dict[str, Any] = {
        "points": model.points.size,
        "channels": len(model.channels),
    }
    values |= {"forces": len(model.forces)} if model.forces else {}
    values |= {"lines": len(model.lines)} if len(model.lines) else {}
    values |= {"names": list(model.channels)}
    name = quote(str(path))
    commands = (
        f"ringtrue oma RECORD --sensors {name}",
        f"ringtrue correlate MODES.json MODEL.bdf --sensors {name}",
    )
    return FilePart("sensors", values, commands)


def _universal(path: Path) -> Iterator[FilePart]:
    held = {block.kind for block in scan(path)}
    if 58 in held:
        functions = read_functions(path)
        kinds = {f.kind for f in functions}
        if kinds & set(_OF_FRF):
            yield _frfs(path, read_frfs(path))
        if FunctionType.TIME in kinds:
            yield _stored(path)
        others = Counter(
            f.kind for f in functions if f.kind not in (*_OF_FRF, FunctionType.TIME)
        )
        if others:
            yield FilePart(
                "functions",
                {FUNCTIONS.get(k, f"type {k}"): n for k, n in others.items()},
            )
    if held & {55, 2414}:
        yield _modes(path, read_modes(path))
    if held & set(NODES):
        yield _sensors(path)
    if not held & {58, 55, 2414, *NODES}:
        yield FilePart("table", {"data sets": sorted(held)})


def _table(path: Path) -> list[FilePart]:
    """FRFs, a sensor sheet, static tests, modes or a record: by the titles of a text or sheet."""
    if format_of(path) is Format.TEXT:
        with path.open("rb") as file:
            if program := other_program(file.read(1 << 16)):
                raise DataError(
                    f"{path}: a deck of {program}; ringtrue reads Nastran's"
                )
        if holds_frfs(path):
            return [_frfs(path, read_frfs(path))]
    try:
        titles = {c.lower() for c in next((r for r in cells(path) if any(r)), [])}
    except DataError:
        titles = set()
    if set(REQUIRED) <= titles:
        return [_sensors(path)]
    if set(STATICS) <= titles:
        cases = {row[0] for row in cells(path)[1:] if any(row)}
        line = f'residual = [{{ kind = "static", file = "{path}" }}]'
        return [FilePart("statics", {"cases": len(cases)}, (line,))]
    try:
        return [_modes(path, read_modes(path))]
    except DataError:
        if format_of(path) is Format.XLSX:
            raise
    return _measured(path, Format.TEXT)


def _array(path: Path) -> list[FilePart]:
    a = read_npy(path)
    if a.ndim in (1, 2) and a.dtype.kind in "fiu":
        return [_stored(path)]
    return [FilePart("arrays", {"names": [f"{a.shape} {a.dtype}"]})]


def _archive(path: Path) -> list[FilePart]:
    arrays = read_npz(path)
    if {"freq", "H1"} <= set(arrays):
        return [_frfs(path, read_frfs(path))]
    if {"format", "shape"} <= set(arrays):
        return _matrices(path)
    return [
        FilePart("arrays", {"names": [f"{k} {v.shape}" for k, v in arrays.items()]})
    ]


def _matrices(path: Path) -> list[FilePart]:
    found = read_matrices(path).matrices
    shapes = [f"{name} {m.shape[0]} x {m.shape[1]}" for name, m in found.items()]
    return [FilePart("matrices", {"matrices": len(found), "names": shapes})]


def _settings(path: Path) -> list[FilePart]:
    """Modes, a choice, a log or a study, by the keys of a JSON or TOML."""
    is_json = format_of(path) is Format.JSON
    value = read_json(path) if is_json else read_toml(path)
    keys: Iterable[str] = value if isinstance(value, dict) else ()
    name = quote(str(path))
    if "modes" in keys:
        return [_modes(path, read_modes(path))]
    if keys and set(keys) <= _CHOICES:
        counts = {f"{k}s": len(v) for k, v in value.items() if isinstance(v, list)}
        return [FilePart("choice", counts, (f"ringtrue oma RECORD --choice {name}",))]
    if is_json and "tests" in keys:
        return [
            FilePart("log", {"tests": len(value["tests"])}, (f'test.log = "{path}"',))
        ]
    if not is_json and {"study", "model", "test"} & set(keys):
        return [FilePart("study", {"sections": list(keys)}, (f"ringtrue run {name}",))]
    return [FilePart("table", {"keys": list(keys)})]


_PARTS: Mapping[Format, Callable[[Path], Iterable[FilePart]]] = {
    Format.EMPTY: lambda path: (),
    Format.DECK: _deck,
    **dict.fromkeys(SOLVER_RESULTS, _results),
    **dict.fromkeys(
        (Format.OP4, Format.MATRIX_MARKET, Format.HARWELL_BOEING), _matrices
    ),
    Format.HDF5: _hdf5,
    Format.UFF: _universal,
    Format.NPY: _array,
    Format.NPZ: _archive,
    **dict.fromkeys((Format.TEXT, Format.XLSX), _table),
    **dict.fromkeys((Format.JSON, Format.TOML), _settings),
}
