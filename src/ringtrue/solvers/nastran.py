"""MSC, NX or Autodesk Nastran by a configured command: SOL 103 for modes, SOL 200 for their
derivatives.

The design model of SOL 200: parameters as DESVARs, modes as DRESP1s.

Each parameter is a design variable of value 1 that multiplies its fields' nominal values, so that a
sensitivity is a derivative to the factor and a normalised matrix equals the plain one. Nodes move
from their places by DVGRID times what the variable is over 1. A PCOMPG is written as the PCOMP that
it equals. Cards: MSC Nastran Quick Reference Guide.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from ringtrue.core.arrays import Any_, Float, Int
from ringtrue.core.modes import ModeSet
from ringtrue.core.parameters import CardField, ParameterSet
from ringtrue.decks.nastran.results.printed import sturm_counts
from ringtrue.decks.nastran.results.sensitivity import Sensitivities, read_sensitivities
from ringtrue.decks.nastran.writer import Value, format_card, large_card
from ringtrue.errors import (
    ConfigError,
    DataError,
    SolverFailed,
    SolverMissing,
    UnsupportedError,
    did_you_mean,
)
from ringtrue.fem.element_cards import MATERIALS
from ringtrue.fem.parametrisation.changed_model import scaled
from ringtrue.model.cards import END_A, END_B
from ringtrue.model.edit import companions, field_changes, resolve_target
from ringtrue.model.frames import axes, positions
from ringtrue.model.model import Model, Table, stacked
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.runner import (
    METHOD,
    DeckAnalysis,
    Finished,
    bulk,
    case_control,
    tail,
)

SET = 1  # id of the constraints that keep every response
_PROPERTIES = {
    "PROD": ("A", "J", "NSM"),
    "PTUBE": ("OD", "T", "NSM"),
    "PBAR": ("A", "I1", "I2", "I12", "J", "NSM", "K1", "K2"),
    "PSHELL": ("T", "I12T3", "TST", "NSM", "Z1", "Z2"),
    "PSHEAR": ("T", "NSM"),
    "PELAS": ("K", "GE"),
    "PBUSH": (
        *(f"{k}{i}" for k in "KB" for i in range(1, 7)),
        "GE",
        *(f"GE{i}" for i in range(2, 7)),
    ),
    "PBEND": ("A", "I1", "I2", "J", "NSM"),
    "PWELD": ("D",),
    "PFAST": ("KT1", "KT2", "KT3", "KR1", "KR2", "KR3", "MASS"),
    "PBUSH1D": ("K", "C", "M"),
    "PGAP": ("KA", "KB", "KT"),
    "PBEAM": (*END_A, *END_B, "K1", "K2"),
    "PCOMP": ("Z0", "NSM", "GE"),
    "PMASS": ("M",),
    "PDAMP": ("B",),
    "PVISC": ("CE", "CR"),
}
_ELEMENTS = {
    "CONROD": ("A", "J", "NSM"),
    **dict.fromkeys(("CBAR", "CBEAM"), ("W1A", "W2A", "W3A", "W1B", "W2B", "W3B")),
    "CBUSH": ("S", "S1", "S2", "S3"),
    "CONM1": tuple(f"M{i}{j}" for i in range(1, 7) for j in range(1, i + 1)),
    "CONM2": ("M", "X1", "X2", "X3", "I11", "I21", "I22", "I31", "I32", "I33"),
    "CELAS2": ("K", "GE"),
    "CELAS4": ("K",),
    "CMASS2": ("M",),
    "CMASS4": ("M",),
    "CDAMP2": ("B",),
    "CDAMP4": ("B",),
}
_PLY = re.compile(r"(T|THETA)\d+")
_NAMES: Mapping[
    tuple[str, str], str | int
] = {  # by number where the name begins with a digit or has no one spelling
    ("PSHELL", "I12T3"): 6,
    ("PSHELL", "TST"): 8,
    ("PELAS", "K"): 3,
    ("PELAS", "GE"): 4,
    ("PDAMP", "B"): 3,
    ("PVISC", "CE"): 3,
    ("PVISC", "CR"): 4,
    ("PMASS", "M"): 3,
    ("PBUSH", "GE"): "GE1",
    **{("PBEAM", f): f"{f}(A)" for f in END_A},
    **{("PBEAM", f"{f}B"): f"{f}(B)" for f in END_A},
}


@dataclass(frozen=True, slots=True)
class _Field:
    """A field that parameters multiply: its nominal value and the numbers of the parameters."""

    target: CardField
    nominal: float
    variables: tuple[int, ...]


def with_shear_moduli(model: Model) -> Model:
    """MAT1 cards with all three of E, G and ν written out, so that a factor on E can be put on G,
    too.
    """
    if "MAT1" not in model:
        return model
    t = model["MAT1"]
    blank = np.isnan(t["G"]) & ~np.isnan(t["E"]) & ~np.isnan(t["NU"])
    if not blank.any():
        return model
    return model.with_values(
        "MAT1", "G", t.ids[blank], (t["E"] / (2 * (1 + t["NU"])))[blank]
    )


def _fields(model: Model, parameters: ParameterSet, derived: Int) -> list[_Field]:
    """The fields in order of first use; `derived` are the MAT1s whose G follows E."""
    nominal = {
        CardField(c.card, c.id, c.field): float(c.value)
        for c in field_changes(model, parameters, np.ones(len(parameters)))
    }
    used: dict[CardField, list[int]] = {}
    for k, parameter in enumerate(parameters.parameters):
        for target in parameter.targets:
            for one in companions(model, target):
                used.setdefault(one, []).append(k + 1)
                if one.card == "MAT1" and one.field == "E" and one.id in derived:
                    shear = CardField("MAT1", one.id, "G")
                    used.setdefault(shear, []).append(k + 1)
                    nominal[shear] = float(
                        model["MAT1"]["G"][resolve_target(model, shear)[0]]
                    )
    return [_Field(t, nominal[t], tuple(v)) for t, v in used.items()]


def _relation(number: int, field: _Field, lower: float, upper: float) -> str:
    """DVPREL1, DVMREL1 or DVCREL1: value = C0 + Σ nominal·x, equal to the nominal value at x =
    1.
    """
    t = field.target
    if t.card in MATERIALS:
        kind = "DVMREL1"
    elif t.field in _PROPERTIES.get(t.card, ()) or (
        t.card == "PCOMP" and _PLY.fullmatch(t.field)
    ):
        kind = "DVPREL1"
    elif t.field in _ELEMENTS.get(t.card, ()):
        kind = "DVCREL1"
    else:
        raise UnsupportedError(
            f"{t.card} {t.id} {t.field} cannot be a design variable of SOL 200 here"
        )
    if field.nominal == 0:
        raise UnsupportedError(
            f"{t.card} {t.id} {t.field} is 0: a factor does not change it"
        )
    bounds = sorted((lower * field.nominal, upper * field.nominal))
    spare = (1 - len(field.variables)) * field.nominal
    name = _NAMES.get((t.card, t.field), t.field)
    head: list[Value] = [number, t.card, t.id, name, *bounds, spare, None]
    for v in field.variables:
        head += [v, field.nominal]
    return large_card(kind, head)


def _as_pcomp(model: Model) -> Model:
    """PCOMPG cards as PCOMP, whose plies design variables know by their numbers."""
    if "PCOMPG" not in model:
        return model
    t = model["PCOMPG"]
    made = Table(
        "PCOMP", {n: c for n, c in t.columns.items() if n != "GPLYID"}, t.file, t.line
    )
    tables = {c: t for c, t in model.tables.items() if c != "PCOMPG"}
    tables["PCOMP"] = stacked(tables["PCOMP"], made) if "PCOMP" in tables else made
    return replace(model, tables=tables)


def _fixed_nodes(parameters: ParameterSet) -> ParameterSet:
    """The parameters without nodes that move, PCOMPG called PCOMP."""
    made = []
    for p in parameters.parameters:
        fields = (t for t in p.targets if t.card != "GRID")
        targets = [
            replace(t, card="PCOMP") if t.card == "PCOMPG" else t for t in fields
        ]
        made.append(replace(p, targets=tuple(targets), shapes=()))
    return ParameterSet(tuple(made))


def _moved_nodes(model: Model, parameters: ParameterSet) -> str:
    """DVGRID of the nodes that move with each parameter, by their velocities in basic."""
    cards = []
    ids = model["GRID"].ids
    for k, p in enumerate(parameters.parameters):
        places = tuple(t for t in p.targets if t.card == "GRID")
        if places or p.shapes:
            moving = replace(p, targets=places, substructures=())
            step = 1e-3  # of the differences
            near = {
                j: positions(scaled(model, moving, 1 + j * step))
                for j in (-2, -1, 1, 2)
            }
            velocity = (8 * (near[1] - near[-1]) - near[2] + near[-2]) / (12 * step)
            speed = np.abs(velocity).max(axis=1)
            moves = speed > 1e-9 * speed.max()  # the others stand still
            for node, way in zip(
                ids[moves].tolist(), velocity[moves].tolist(), strict=True
            ):
                cards.append(large_card("DVGRID", (k + 1, node, 0, 1.0, *way)))
    return "".join(cards)


def design_cards(model: Model, parameters: ParameterSet) -> tuple[Model, str]:
    """The model with shear moduli written out, and its DESVAR, DVPREL1, DVMREL1, DVCREL1 and DVGRID
    cards.

    Raises
    ------
    UnsupportedError
        If a field cannot be a design variable.
    InputError
        If a target is not in the model or blank.
    """
    moves = _moved_nodes(model, parameters)
    model = _as_pcomp(model)
    parameters = _fixed_nodes(parameters)
    whole = with_shear_moduli(model)
    derived = np.empty(0, dtype=np.int64)
    if "MAT1" in model:
        derived = model["MAT1"].ids[
            np.isnan(model["MAT1"]["G"]) & ~np.isnan(whole["MAT1"]["G"])
        ]
    cards = [
        format_card("DESVAR", (k + 1, f"X{k + 1}", 1.0, float(p.lower), float(p.upper)))
        for k, p in enumerate(parameters.parameters)
    ]
    low = min((p.lower for p in parameters.parameters), default=0.1)
    high = max((p.upper for p in parameters.parameters), default=10.0)
    fields = _fields(whole, parameters, derived)
    cards += [_relation(k + 1, f, low * 1e-3, high * 1e3) for k, f in enumerate(fields)]
    return whole, "".join(cards) + moves


def response_id(mode: int, component: int, count: int) -> int:
    """DRESP1 of a mode (1-based): its eigenvalue (component 0) or its shape in component 1 to 6."""
    return mode if component == 0 else count + 6 * (mode - 1) + component


def response_cards(count: int, grids: Int) -> str:
    """DRESP1 of the eigenvalues and shapes of the lowest `count` modes, and constraints that keep
    them all.

    Parameters
    ----------
    count : int
    grids : (g,) int64
        Grid points whose six components are asked for; none for eigenvalues alone.
    """
    cards = [
        format_card("DRESP1", (m, f"L{m}", "EIGN", None, None, m))
        for m in range(1, count + 1)
    ]
    ids = list(range(1, count + 1))
    components = range(1, 7) if grids.size else ()
    for m in range(1, count + 1):
        for c in components:
            rid = response_id(m, c, count)
            ids.append(rid)
            fields = (rid, f"U{rid}"[:8], "DISP", None, None, c, m, *grids.tolist())
            cards.append(format_card("DRESP1", fields))
    # never met, so never left out
    cards += [format_card("DCONSTR", (SET, rid, 1e30, 1e30)) for rid in ids]
    cards.append(format_card("DSCREEN", ("EIGN", -1e10, count)))
    if grids.size:
        cards.append(format_card("DSCREEN", ("DISP", -1e10, 6 * count * grids.size)))
    return "".join(cards)


def spread(
    found: Sensitivities, count: int, grids: Int, variables: int
) -> tuple[Float, Float]:
    """∂λ/∂a (m, p) and ∂φ/∂a in the displacement frames (g, 6, m, p) out of the matrix.

    Raises
    ------
    SolverFailed
        If a response or a design variable is missing.
    """
    at = {int(v): k for k, v in enumerate(found.variable)}
    if any(k + 1 not in at for k in range(variables)):
        raise SolverFailed(
            f"design variables {sorted(at)} came back; {variables} were asked for"
        )
    values = found.values[:, [at[k + 1] for k in range(variables)]]
    d_lambda = np.full((count, variables), np.nan)
    d_shape = np.full((grids.size, 6, count, variables), np.nan)
    value = found.response <= count
    d_lambda[found.response[value] - 1] = values[value]
    mode, component = np.divmod(found.response[~value] - count - 1, 6)
    if grids.size:
        order = np.argsort(grids, kind="stable")
        place = np.searchsorted(grids[order], found.grid[~value]).clip(
            max=grids.size - 1
        )
        row = order[place]
        good = (mode < count) & (grids[row] == found.grid[~value])
        d_shape[row[good], component[good], mode[good]] = values[~value][good]
    lost = (
        int(np.isnan(d_lambda).any(axis=1).sum()),
        int(np.isnan(d_shape).any(axis=-1).sum()),
    )
    if any(lost):
        raise SolverFailed(
            f"sensitivities of {lost[0]} eigenvalues and {lost[1]} shape components are missing"
        )
    return d_lambda, d_shape


COMMAND = "RINGTRUE_NASTRAN"
MAKE = "RINGTRUE_NASTRAN_MAKE"
Make = Literal["msc", "nx", "autodesk"]
_MAKES: tuple[Make, ...] = ("msc", "nx", "autodesk")
_USUAL = {
    "msc": "nastran {deck} scr=yes bat=no old=no",
    "nx": "nastran {deck} scr=yes old=no",
    "autodesk": "nastran {deck}",
}
MOST_RESPONSES = 200_000  # of one run


def nastran_command() -> str:
    """The command line, `{deck}` where the deck goes: the variable RINGTRUE_NASTRAN, or `nastran`
    on the PATH.

    Raises
    ------
    SolverMissing
        If neither is there.
    """
    named = os.environ.get(COMMAND)
    if named:
        return named if "{deck}" in named else f"{named} {{deck}}"
    if shutil.which("nastran"):
        return _USUAL[nastran_make()]
    raise SolverMissing(
        f"no nastran: set {COMMAND} to its command, such as {_USUAL['msc']!r}"
    )


def nastran_make() -> Make:
    """Whose Nastran: the variable RINGTRUE_NASTRAN_MAKE, msc if it is not set.

    Raises
    ------
    ConfigError
        If it is none of msc, nx, autodesk.
    """
    named = os.environ.get(MAKE, "msc").lower()
    for make in _MAKES:
        if make == named:
            return make
    raise ConfigError(f"{MAKE}={named}{did_you_mean(named, _MAKES)}")


def sensitivity_deck(
    model: Model,
    program: NastranSolver,
    parameters: ParameterSet,
    count: int,
    grids: Int,
) -> str:
    """A SOL 200 deck that ends after the sensitivities of the lowest `count` modes.

    Raises
    ------
    UnsupportedError
        If a field cannot be a design variable.
    InputError
        If a target is not in the model or blank.
    """
    model, design = design_cards(model, parameters)
    case = ["SOL 200", "CEND", *case_control(model), "DISPLACEMENT(PRINT,PLOT) = ALL"]
    case += [
        "DSAPRT(FORMATTED,EXPORT,END=SENS) = ALL",
        "DESOBJ(MIN) = 1",
        f"DESSUB = {SET}",
    ]
    case += ["SUBCASE 1", "  ANALYSIS = MODES", "BEGIN BULK"]
    eigrl = format_card("EIGRL", (METHOD, None, None, count, None, None, None, "MASS"))
    head = "\n".join(case) + "\n" + eigrl
    return (
        head
        + design
        + response_cards(count, grids)
        + bulk(model, program)
        + "ENDDATA\n"
    )


class NastranAnalysis(DeckAnalysis):
    """A model in Nastran, with derivatives by SOL 200."""

    capabilities = frozenset({"modes", "derivatives"})
    program: NastranSolver

    def derivatives(
        self, modes: ModeSet, parameters: ParameterSet
    ) -> tuple[Float, Any_]:
        """∂λ/∂a (m, p) and ∂φ/∂a (dof, m, p) at a = 1 of modes of this model, one SOL 200 run.

        Raises
        ------
        UnsupportedError
            If a parameter is no design variable of SOL 200, eigenvalues are repeated, or there are
            too many responses.
        SolverMissing, SolverFailed
            If the program is not there, fails or gives other modes or no sensitivities.
        """
        count = self._count(modes)
        grids = np.asarray(self.model["GRID"].ids)
        responses = 6 * count * grids.size
        if responses > MOST_RESPONSES:
            raise UnsupportedError(
                f"{responses} responses; at most {MOST_RESPONSES}: use the embedded solver"
            )
        done = self.run(
            sensitivity_deck(self.model, self.program, parameters, count, grids)
        )
        d_lambda, local = spread(
            self._sensitivities(done), count, grids, len(parameters)
        )
        at, sign = self._matched(self._read(done), modes)
        return d_lambda[at], self._basic(local)[:, at] * sign[:, None]

    def _count(self, modes: ModeSet) -> int:
        """The lowest modes that hold the given ones; repeated ones have no derivative by SOL
        200.
        """
        f = np.sort(modes.frequencies)
        highest = max(float(np.max(f**2, initial=0.0)), 1e-30)
        repeated = np.abs(np.diff(np.sign(f) * f**2)) < 1e-8 * highest
        if repeated.any():
            at = float(f[1:][repeated][0])
            raise UnsupportedError(
                f"repeated modes at {at:.6g} Hz: SOL 200 has no derivatives there; use embedded"
            )
        mine = self.modes(ModesRequest(len(modes))).modes.frequencies
        reaches_last = mine[-1] >= f[-1] * (1 - 1e-4)  # as far as both are printed
        return len(modes) if reaches_last else 2 * len(modes)

    def _sensitivities(self, done: Finished) -> Sensitivities:
        problems = []
        for path in done.files(".op2", ".h5", ".f06", ".csv"):
            try:
                return read_sensitivities(path)
            except DataError as e:
                problems.append(str(e))
        raise SolverFailed(
            f"nastran wrote no sensitivities: {'; '.join(problems) or 'no results'}{tail(done.log)}"
        )

    def _matched(self, run: ModeSet, modes: ModeSet) -> tuple[Int, Float]:
        """Which modes of the run the given ones are, and the sign that turns one into the other."""
        cross = run.shapes.T @ modes.shapes
        size = np.linalg.norm(run.shapes, axis=0)[:, None] * np.linalg.norm(
            modes.shapes, axis=0
        )
        cosine = cross / np.where(size > 0, size, 1.0)
        at = np.abs(cosine).argmax(axis=0)
        worst = float(np.abs(cosine[at, np.arange(len(modes))]).min(initial=1.0))
        if np.unique(at).size != at.size or worst < 0.99:
            raise SolverFailed(
                f"SOL 200 found other modes than those given (a cosine of {worst:.3f})"
            )
        return at, np.sign(cosine[at, np.arange(len(modes))])

    def _basic(self, local: Float) -> Float:
        """Shapes (g, 6, m, p) in displacement frames to (dof, m, p) in basic; scalar points have
        none and get 0.
        """
        turn = axes(self.model, self.model["GRID"]["CD"], positions(self.model))
        g, _, m, p = local.shape
        basic = np.einsum("nji,nkjmp->nkimp", turn, local.reshape(g, 2, 3, m, p))
        scalar = np.zeros((len(self.dofs) - 6 * g, m, p))
        return np.concatenate([basic.reshape(6 * g, m, p), scalar])


class NastranSolver:
    """`with NastranSolver().open(model) as analysis: analysis.modes(ModesRequest(20))`.

    Parameters
    ----------
    command : str, optional
        With `{deck}` where the deck goes; the variable RINGTRUE_NASTRAN if not given.
    timeout : float, s
    keep : Path, optional
        A folder that keeps decks and results; without it they are removed.
    """

    name = "nastran"
    # those of double precision first
    endings: tuple[str, ...] = (".h5", ".op2", ".f06", ".pch")
    band_by_count = False

    def __init__(
        self,
        *,
        command: str | None = None,
        timeout: float = 24 * 3600.0,
        keep: Path | None = None,
    ) -> None:
        self._command = command
        self.timeout = timeout
        self.keep = keep
        writes_hdf5 = nastran_make() == "msc"
        self.more_bulk = format_card("MDLPRM", ("HDF5", 0)) if writes_hdf5 else ""

    def open(
        self, model: Model, parameters: Sequence[ParameterSet] = ()
    ) -> NastranAnalysis:
        """Hand the model over.

        Raises
        ------
        SolverMissing
            If no command is configured.
        """
        self.command(Path("model.bdf"))
        return NastranAnalysis(model, self, keep=self.keep)

    def command(self, deck: Path) -> Sequence[str | Path]:
        """The command line for a deck."""
        return [
            word.replace("{deck}", deck.name)
            for word in shlex.split(self._command or nastran_command())
        ]

    def adapted(self, model: Model) -> Model:
        """The model as it is."""
        return model

    def proof(
        self, run: Finished, modes: ModeSet, request: ModesRequest
    ) -> tuple[bool, str]:
        """Sturm counts of the Lanczos method, as printed."""
        counts = [c for f in run.files(".f06") for c in sturm_counts(f)]
        if not len(modes):
            return False, "no mode found, nothing counted"
        top = float(modes.frequencies[-1])
        f = modes.frequencies
        low, high = request.band or (0.0, 0.0)
        above = [c for c in counts if c[0] > top and c[0] >= high * (1 - 1e-3)]
        under = (
            [c for c in counts if c[0] <= low * (1 + 1e-3)] if low > 0 else [(0.0, 0)]
        )
        if not above or not under:
            return False, "Nastran printed no Sturm count above the last mode"
        there = above[0][1] - under[-1][1]
        words = (
            f"{there} eigenvalues below {above[0][0]:.6g} Hz by Nastran's Sturm count, "
            f"{f.size} taken"
        )
        return there == f.size, words
