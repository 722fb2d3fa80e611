"""Decks: read, solve for modes, responses to forces, write back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ringtrue.core.arrays import Any_, Float
from ringtrue.core.channels import FRF_KIND, Motion, channel
from ringtrue.core.display import Displayed, plot
from ringtrue.core.dofs import DofSet
from ringtrue.core.iterate import Progress, part, quiet
from ringtrue.core.modes import ModeSet
from ringtrue.core.parameters import is_matrix
from ringtrue.core.signals import FrfSet
from ringtrue.core.units import UNIT_SYSTEMS, UnitSystem
from ringtrue.decks.nastran import reader
from ringtrue.decks.nastran.editor import edit_fields
from ringtrue.decks.nastran.results.modes import read_nastran_deflections
from ringtrue.errors import ConfigError, InputError, UnsupportedError, did_you_mean
from ringtrue.model.cards import MADE
from ringtrue.model.case_control import ModalDamping, asked_modes, responding
from ringtrue.model.edit import FieldChange, in_seconds
from ringtrue.model.model import Model, Ragged, Table
from ringtrue.model.ports import ModesRequest, ModesResult
from ringtrue.solvers.embedded import EmbeddedAnalysis, EmbeddedSolver
from ringtrue.solvers.matrices import MatrixModel
from ringtrue.solvers.registry import EMBEDDED, solver
from ringtrue.study.loads import (
    held_by_displacing,
    load_vectors,
    refuse_displaced,
    support_motions,
)
from ringtrue.study.opened import Opened


def read_deck(path: str | Path, *, units: str = "SI") -> Model:
    """Read a Nastran bulk data deck with its includes.

    Parameters
    ----------
    path : str or Path
    units : {"SI", "mm-t-s", "mm-kg-s", "mm-kg-ms", "in-lbf-s", "ft-lbf-s"}
        The consistent unit system that the deck is in. It is never guessed.

    Returns
    -------
    Model
        Values in the units of the deck; frequencies are always in Hz.

    Raises
    ------
    DeckError
        If a card is wrong; the message has file, line and field.
    UnsupportedCard
        If a card that carries stiffness, mass or a constraint is not supported.

    Examples
    --------
    >>> import ringtrue as rt
    >>> model = rt.read_deck(rt.example_deck())
    >>> len(model["GRID"])
    4
    """
    return in_units(reader.read_deck(Path(path)), units)


def in_units(model: Model, units: str) -> Model:
    """The model in the unit system that the user states, its time in seconds."""
    return replace(in_seconds(model, _unit_system(units)), units=units)


def _unit_system(units: str) -> UnitSystem:
    if units not in UNIT_SYSTEMS:
        raise ConfigError(f"units {units!r}{did_you_mean(units, UNIT_SYSTEMS)}")
    return UNIT_SYSTEMS[units]


def open_model(model: Model) -> Opened:
    """The model with its analysis, assembled when first needed."""
    return Opened(model, UNIT_SYSTEMS[model.units].length)


@dataclass(frozen=True, eq=False)
class FeModes(Displayed):
    """Modes of a model with their proof.

    Attributes
    ----------
    model : Model
    frequencies : (mode,) float64, Hz
    damping : (mode,) float64
        Fraction of critical damping; 0 of undamped modes.
    residuals : (mode,) float64
        Relative residual of each mode; NaN where the solver does not state it.
    complete : bool
        Whether inertia counts prove that no mode of the band is missing.
    proof : str
        What was counted.
    modes : ModeSet
        With labels and norm: mass-normalised, basic frame.
    result : ModesResult
        What the solver returned.
    loose : tuple of str
        Translations that are held because nothing stiffens them.
    """

    UNITS: ClassVar[Mapping[str, str]] = {
        "frequencies": "Hz",
        "damping": "-",
        "residuals": "-",
    }

    model: Model | MatrixModel
    frequencies: Float
    damping: Float
    residuals: Float
    complete: bool
    proof: str
    modes: ModeSet
    result: ModesResult
    loose: tuple[str, ...] = ()

    @property
    def shapes(self) -> Any_:
        """Mode shapes (dof, mode), mass-normalised, basic frame."""
        return self.modes.shapes

    @property
    def dofs(self) -> DofSet:
        """The rows of the shapes."""
        assert isinstance(self.modes.labels, DofSet)
        return self.modes.labels

    def at(self, channels: Sequence[str]) -> ModeSet:
        """The modes at some degrees of freedom such as `101+Z`, in the given order."""
        return self.modes.rows(channels)

    @cached_property
    def opened(self) -> Opened:
        """The model with its analysis."""
        if isinstance(self.model, MatrixModel):
            raise UnsupportedError(
                "a MatrixModel has no nodes: give its modes, `fe.at(channels)`"
            )
        return open_model(self.model)

    def plot(self) -> Any:
        """The mode shapes in motion, a 3D view; of matrices, which have no nodes, as lines."""
        if isinstance(self.model, MatrixModel):
            return plot(self.modes)
        # what draws loads when something is drawn
        from ringtrue.plots.scene import model_modes
        from ringtrue.study.scene import make_scene, scene_modes

        scene = make_scene(self.model, {}, UNIT_SYSTEMS[self.model.units].length)
        return model_modes(scene, scene_modes(self.modes, scene))


def solve_modes(
    model: Model | MatrixModel,
    *,
    band: tuple[float, float] | None = None,
    count: int | None = None,
    engine: str = EMBEDDED,
    damped: bool = False,
    ranks: int | None = None,
    launcher: str = "",
    time_limit: float | None = None,
    progress: Progress = quiet,
) -> FeModes:
    """Natural modes of a model, with the proof that none is missing.

    Parameters
    ----------
    model : Model or MatrixModel
    band : (float, float), Hz, optional
        All modes between these frequencies.
    count : int, optional
        The lowest modes; without a band too, what EIGRL or EIGR of the deck ask for, else 20.
    engine : {"embedded", "mystran", "nastran", "slepc"} or a plug-in
        The solver.
    damped : bool
        Complex modes, by dashpots, GE, PARAM G and DMIG of the deck.
    ranks : int, optional
        Processes of the slepc engine.
    launcher : str
        What starts them, in place of their number, such as `srun -n 64`.
    time_limit : float, s, optional
        Longest run of an engine that is another program.

    Returns
    -------
    FeModes

    Raises
    ------
    InputError
        If this is no model.
    ConfigError
        If an option does not fit the engine, or the deck has no damping for complex modes.
    SingularModel
        If the model has a mechanism; the message names its degrees of freedom.

    References
    ----------
    Grimes, Lewis and Simon (1994), A shifted block Lanczos algorithm.

    Examples
    --------
    >>> import ringtrue as rt
    >>> fe = rt.solve_modes(rt.read_deck(rt.example_deck()), band=(0, 100))
    >>> fe.frequencies.round(3), fe.complete
    (array([2.24 , 6.276, 9.069]), True)
    """
    if not isinstance(model, Model | MatrixModel):
        raise InputError(f"model {model!r}: a Model; read a deck by rt.read_deck(path)")
    if band is not None and not band[0] < band[1]:
        raise ConfigError(f"band {band[0]} {band[1]}: must be F0 < F1")
    if damped and engine != EMBEDDED:
        raise ConfigError(
            f"complex modes with the engine {engine}: only the embedded engine has them"
        )
    asked = None
    if isinstance(model, Model) and count is None and band is None:
        asked = asked_modes(model)
    if isinstance(model, MatrixModel):
        found = model.open(progress=progress).modes(ModesRequest(count or 20, band))
        return _fe_modes(model, found)
    made = solver(
        engine, ranks=ranks, launcher=launcher, timeout=time_limit, progress=progress
    )
    with made.open(model) as analysis:
        solve = analysis.modes
        if damped:
            if not (isinstance(analysis, EmbeddedAnalysis) and analysis.has_damping):
                raise ConfigError(
                    "complex modes: the deck has no damping; it is that of dashpots, GE, PARAM G, "
                    "ALPHA1 and ALPHA2"
                )
            solve = analysis.complex_modes
        found = asked.of(solve) if asked else solve(ModesRequest(count or 20, band))
        loose: tuple[str, ...] = ()
        if isinstance(analysis, EmbeddedAnalysis):
            loose = analysis.system.loose().labels()
    return _fe_modes(model, found, loose)


def _fe_modes(
    model: Model | MatrixModel, found: ModesResult, loose: tuple[str, ...] = ()
) -> FeModes:
    modes = found.modes
    return FeModes(
        model=model,
        frequencies=modes.frequencies,
        damping=modes.damping,
        residuals=found.residuals,
        complete=found.complete,
        proof=found.proof,
        modes=modes,
        result=found,
        loose=loose,
    )


def parse_points(points: Sequence[str] | str, what: str) -> DofSet:
    """Points such as `101+Z`, or `101+RZ` for a rotation or moment.

    Raises
    ------
    ConfigError
        If one is no degree of freedom, has no direction or is given twice.
    """
    texts = [points] if isinstance(points, str) else points
    try:
        dofs = DofSet.parse(p for text in texts for p in text.split(","))
    except InputError as e:
        raise ConfigError(f"{what}: {e}") from e
    if (bare := np.flatnonzero(dofs.direction == 0)).size:
        raise ConfigError(
            f"{what} {dofs.labels()[bare[0]]}: must be a node and a direction, such as 101+Z or "
            "101+RZ"
        )
    return dofs


def frf(
    model: Model | str | Path,
    frequencies: Float | Sequence[float],
    *,
    forces: Sequence[str] | str,
    responses: Sequence[str] | str | None = None,
    damping: float | None = None,
    quantity: Motion = "acceleration",
    direct: bool = False,
    units: str = "SI",
    progress: Progress = quiet,
) -> FrfSet:
    """Frequency response functions of a model.

    Parameters
    ----------
    model : Model or path of a deck
        SDAMPING of the deck is read from a path only.
    frequencies : (line,), Hz, ascending
    forces, responses : sequence of str
        Points such as `101+Z` in the basic frame; responses where the forces act if not given.
    damping : float, optional
        Damping ratio of all modes; that of the deck if not given.
    quantity : {"acceleration", "velocity", "displacement"}
    direct : bool
        Solve the full model at each line, without modes.
    units : str
        As in `read_deck`; for a path.

    Returns
    -------
    FrfSet
        (line, response, force) complex128, SI.

    Raises
    ------
    ConfigError
        If a point is not in the model, or neither the deck nor `damping` gives damping.

    References
    ----------
    Ewins (2000), Modal Testing, ch. 2; residual vectors: Dickens et al. (1997).

    Examples
    --------
    >>> import ringtrue as rt
    >>> h = rt.frf(rt.example_deck(), [1.0, 2.0, 3.0], forces="4+X", damping=0.01)
    >>> h.data.shape
    (3, 1, 1)
    """
    asked = FrfRequest(
        frequencies=np.asarray(frequencies, dtype=np.float64),
        forces=parse_points(forces, "force"),
        responses=parse_points(forces if responses is None else responses, "response"),
        quantity=quantity,
        damping=damping,
        direct=direct,
    )
    if isinstance(model, Model):
        return responses_of(model, None, asked, progress)[0]
    read, modal = reader.read_damped_deck(Path(model))
    return responses_of(in_units(read, units), modal, asked, progress)[0]


@dataclass(frozen=True, slots=True, eq=False)
class FrfRequest:
    """Which FRFs are wanted.

    Attributes
    ----------
    frequencies : (line,) float64, Hz
    forces, responses : DofSet
    quantity : str
    damping : float, optional
    direct : bool
    """

    frequencies: Float
    forces: DofSet
    responses: DofSet
    quantity: Motion = "acceleration"
    damping: float | None = None
    direct: bool = False

    def __post_init__(self) -> None:
        if self.quantity not in FRF_KIND:
            raise ConfigError(
                f"quantity {self.quantity!r}{did_you_mean(self.quantity, FRF_KIND)}"
            )
        if self.damping is None:
            return
        if self.direct:
            raise ConfigError(
                "direct has the damping of the deck; damping is for modes"
            )
        if not 0 < self.damping < 1:
            raise ConfigError(
                f"damping {self.damping:g}: must be a ratio between 0 and 1, such as 0.01"
            )


def responses_of(
    model: Model, modal: ModalDamping | None, asked: FrfRequest, progress: Progress
) -> tuple[FrfSet, tuple[str, ...]]:
    """The FRFs of a model, `modal` being its SDAMPING in the time unit of the deck; and the points
    that cannot move.
    """
    into = asked.forces
    out = asked.responses
    lines = asked.frequencies
    damping = asked.damping
    direct = asked.direct
    unit = UNIT_SYSTEMS[model.units]
    if modal:
        modal = replace(modal, frequencies=modal.frequencies / unit.time)
    kind = FRF_KIND[asked.quantity]
    with EmbeddedSolver(progress=part(progress, 0.2, 1.0)).open(
        responding(model)
    ) as analysis:
        _check_damping(analysis, damping, modal, direct)
        held = held_points(analysis, out, into)
        if direct:
            h = analysis.frf_direct(out, into, lines, kind=kind)
        else:
            # 2.0: an FRF has the modes up to so many times its highest line, and residual vectors
            request = ModesRequest(band=(0.0, 2.0 * float(lines[-1])))
            ratio = modal if damping is None else damping
            h = analysis.frf(out, into, lines, request, damping=ratio, kind=kind)
    scale = (
        np.outer(out.per_length(unit.length), into.per_length(unit.length))
        / unit.kilograms
    )
    found = FrfSet(
        h * scale,
        lines,
        tuple(channel(c, asked.quantity) for c in out.labels()),
        tuple(channel(c, "force") for c in into.labels()),
        kind=kind,
        source=model.files[0] if model.files else "",
        sharp=True,
    )
    return found, held


def _check_damping(
    analysis: EmbeddedAnalysis,
    damping: float | None,
    modal: ModalDamping | None,
    direct: bool,
) -> None:
    if damping is not None or analysis.has_damping or (modal and not direct):
        return
    if direct:
        raise ConfigError(
            "direct: the deck has no damping of its own (dashpots, GE, PARAM G); solve by modes "
            "with a damping ratio"
        )
    raise ConfigError(
        "the deck has no damping of its own (dashpots, GE, PARAM G, SDAMPING): give a "
        "damping ratio, such as 0.01"
    )


def held_points(
    analysis: EmbeddedAnalysis, *ends: DofSet, moved: Float | None = None
) -> tuple[str, ...]:
    """The points that cannot move.

    Raises
    ------
    ConfigError
        If the model has no such point.
    """
    free = np.diff(analysis.system.transform.indptr) > 0
    if moved is not None:
        free |= moved.any(axis=1)
    names = [name for end in ends for name in end.labels()]
    row = np.concatenate([analysis.dofs.find(end.node, end.direction) for end in ends])
    if lost := [name for name, r in zip(names, row, strict=True) if r < 0]:
        raise ConfigError(f"the deck has no {' '.join(dict.fromkeys(lost))}")
    held = [name for name, ok in zip(names, free[row], strict=True) if not ok]
    return tuple(dict.fromkeys(held))


@dataclass(frozen=True, eq=False)
class Deflections(Displayed):
    """Static deflections.

    Attributes
    ----------
    cases : tuple of str
    points : tuple of str
    values : (case, point) float64, m or rad
    model : Model, optional
        What they are of; not known of results that were read without a deck.
    held : tuple of str
        Points that cannot move.
    """

    cases: tuple[str, ...]
    points: tuple[str, ...]
    values: Float
    model: Model | None
    held: tuple[str, ...] = ()


def static(
    model: Model | str | Path,
    *,
    forces: Mapping[str, float] | None = None,
    responses: Sequence[str] | str | None = None,
    units: str = "SI",
    progress: Progress = quiet,
) -> Deflections:
    """Deflections under single forces, each a load case, or under the loads of the deck.

    Parameters
    ----------
    model : Model or path of a deck
        The loads of the deck are read from a path only.
    forces : mapping of point to N or N·m, optional
        Such as `{"3+Z": 250.0}`; the loads of the deck if not given.
    responses : sequence of str
        Points whose deflections are wanted; those of the forces if not given.
    units : str
        As in `read_deck`; for a path.

    Raises
    ------
    ConfigError
        If a point is not in the model, or there is neither a force nor a response.

    Examples
    --------
    >>> import ringtrue as rt
    >>> pull = rt.static(rt.example_deck(), forces={"4+X": 100.0})
    >>> bool(abs(pull.values[0, 0] - 0.3) < 1e-9)
    True
    """
    given = dict(forces or {})
    if responses is None and not given:
        raise ConfigError(
            "responses: name the points whose deflections are wanted, such as 101+Z"
        )
    into = parse_points(list(given), "force")
    out = parse_points(responses or list(given), "response")
    cases: tuple[Any, ...] = ()
    if not isinstance(model, Model):
        path = Path(model)
        model, cases = (
            (reader.read_deck(path), ()) if given else reader.read_loaded_deck(path)
        )
        model = replace(model, units=units)
    unit = UNIT_SYSTEMS[model.units]
    progress(0.3, "solving")
    if given:
        refuse_displaced(model)
        with EmbeddedSolver().open(model) as analysis:
            newtons = np.array(list(given.values()))
            per_newton = into.per_length(unit.length) / unit.force
            acting = _unit_loads(analysis, into) * (newtons * per_newton)
            held = held_points(analysis, out, into)
            moved = (_unit_loads(analysis, out).T @ analysis.static(acting)).T
    else:
        moved, held = _under_loads(model, cases, out)
    names = tuple(
        f"{p}={n:g}" for p, n in zip(into.labels(), given.values(), strict=True)
    ) or tuple(c.name for c in cases)
    return Deflections(
        names,
        out.labels(),
        moved * (unit.length * out.per_length(unit.length)),
        model,
        held,
    )


def read_deflections(
    path: str | Path, *, deck: Model | None = None, units: str = "SI"
) -> Deflections:
    """Static deflections that Nastran recorded, of all nodes and subcases, in the basic frame.

    Parameters
    ----------
    path : str or Path
        OP2, or HDF5 of MSC Nastran.
    deck : Model, optional
        The deck of the run: turns displacement frames (CD) to the basic frame, and gives the units.
        Not needed with an OP2 that holds the geometry.
    units : str
        Of the run, as in `read_deck`, where no deck is given.

    Raises
    ------
    DataError
        If the file is missing or damaged, holds no static deflections, or is of another model.

    Examples
    --------
    >>> import ringtrue as rt
    >>> rt.read_deflections("modes.op2")
    Traceback (most recent call last):
    ...
    ringtrue.errors.DataError: modes.op2: no such file
    """
    unit = _unit_system(deck.units if deck else units)
    cases, dofs, moved = read_nastran_deflections(path, deck)
    return Deflections(
        cases, dofs.labels(), moved * (unit.length * dofs.per_length(unit.length)), deck
    )


def _under_loads(
    model: Model, cases: Sequence[Any], out: DofSet
) -> tuple[Float, tuple[str, ...]]:
    """Motions (case, point) under the load cases of a deck, and the points that move in none."""
    moved = np.zeros((len(cases), len(out)))
    held: set[str] = set(out.labels())
    for supported, at in held_by_displacing(model, cases):
        with EmbeddedSolver().open(supported) as analysis:
            mine = [cases[j] for j in at]
            drawn, carried = support_motions(supported, analysis.dofs, mine)
            acting = load_vectors(supported, analysis.dofs, mine) + drawn
            held &= set(held_points(analysis, out, moved=carried))
            found = analysis.static(acting) + carried
            moved[list(at)] = (_unit_loads(analysis, out).T @ found).T
    return moved, tuple(point for point in out.labels() if point in held)


def _unit_loads(analysis: EmbeddedAnalysis, at: DofSet) -> Float:
    """A column (dof, k) for each degree of freedom, 1 or -1 there."""
    row, sign = analysis.dofs.align(at)
    out = np.zeros((len(analysis.dofs), len(at)))
    out[row, np.arange(len(at))] = sign
    return out


def write_deck(model: Model, folder: str | Path) -> tuple[Path, ...]:
    """Write the deck of a model into another folder; only changed fields differ from its files.

    Comments, includes, order and every other byte stay.

    Parameters
    ----------
    model : Model
        Of a deck that was read, with values changed by `update` or `Model.with_values`.
    folder : str or Path

    Returns
    -------
    tuple of Path
        The files that were written.

    Raises
    ------
    UnsupportedError
        If the model has other cards than its files.
    InputError
        If the model was not read from a file, or the folder is that of the deck.

    Examples
    --------
    >>> import tempfile
    >>> import numpy as np
    >>> import ringtrue as rt
    >>> model = rt.read_deck(rt.example_deck())
    >>> softer = model.with_values("PELAS", "K", np.array([1]), np.array([900.0]))
    >>> [path.name for path in rt.write_deck(softer, tempfile.mkdtemp())]
    ['example.bdf']
    """
    if not model.files:
        raise InputError(
            "the model was not read from a file: there is no deck to write"
        )
    before = reader.read_deck(Path(model.files[0]))
    changes = [c for card in model.tables for c in _changes(before, model, card)]
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    return tuple(edit_fields(before, changes, target))


def _changes(before: Model, after: Model, card: str) -> list[FieldChange]:
    """The fields of a card that differ, but those that follow from the dimensions of a section."""
    new = after[card]
    if card not in before or len(before[card]) != len(new):
        raise UnsupportedError(
            f"{card}: the model has other cards than its files; write its deck"
        )
    old = before[card]
    derived = [name for name, made in MADE.items() if made == card and name in after]
    free = np.ones(len(new), dtype=bool)
    for name in derived:
        free &= ~np.isin(new.ids, after[name].ids)
    found: list[FieldChange] = []
    for name in new.columns:
        found += _column_changes(old, new, name, free)
    return found


def _column_changes(old: Table, new: Table, name: str, free: Any_) -> list[FieldChange]:
    a = old.columns[name]
    b = new.columns[name]
    if isinstance(a, Ragged) and isinstance(b, Ragged):
        if is_matrix(new.card, name):
            return _matrix_changes(new, a, b)
        at = np.flatnonzero(_differ(a.values, b.values))
        rows = b.owner[at]
        numbers = at - b.offsets[rows] + 1
        return [
            FieldChange(new.card, int(new.ids[r]), f"{name}{k}", b.values[i].item())
            for i, r, k in zip(
                at.tolist(), rows.tolist(), numbers.tolist(), strict=True
            )
            if free[r]
        ]
    assert not isinstance(a, Ragged)
    assert not isinstance(b, Ragged)
    rows = np.flatnonzero(_differ(a, b) & free)
    return [
        FieldChange(new.card, int(new.ids[r]), name, b[r].item()) for r in rows.tolist()
    ]


def _matrix_changes(
    new: Table, old_terms: Ragged, new_terms: Ragged
) -> list[FieldChange]:
    """The factors on the matrices whose terms differ."""
    found = []
    for row, number in enumerate(new.ids.tolist()):
        a = old_terms.row(row)
        b = new_terms.row(row)
        if np.array_equal(a, b):
            continue
        factor = float(a @ b / (a @ a)) if a.size == b.size and a.any() else np.nan
        if not np.allclose(b, factor * a, rtol=1e-9, atol=0.0):  # of double precision
            raise UnsupportedError(
                f"DMIG {number} ({new['NAME'][row]}): its terms differ by no common factor; write "
                "its deck"
            )
        found.append(FieldChange(new.card, number, "A", factor))
    return found


def _differ(a: Any_, b: Any_) -> Any_:
    if a is b:
        return np.zeros(len(a), dtype=bool)
    different = a != b
    if a.dtype.kind == "f":
        different &= ~(np.isnan(a) & np.isnan(b))
    if different.ndim > 1:
        different = different.any(axis=tuple(range(1, different.ndim)))
    return np.asarray(different)
