"""The design model of SOL 200: parameters as DESVARs, modes as DRESP1s.

Each parameter is a design variable of value 1 that multiplies its fields' nominal values, so that a
sensitivity is a derivative to the factor and a normalised matrix equals the plain one. Nodes move
from their places by DVGRID times what the variable is over 1. A PCOMPG is written as the PCOMP that
it equals. Cards: MSC Nastran Quick Reference Guide.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.core.parameters import CardField, ParameterSet
from ringtrue.decks.nastran.results.sensitivity import Sensitivities
from ringtrue.decks.nastran.writer import Value, format_card, large_card
from ringtrue.errors import SolverFailed, UnsupportedError
from ringtrue.fem.element_cards import MATERIALS
from ringtrue.fem.parametrisation.changed_model import scaled
from ringtrue.model.edit import companions, field_changes, resolve_target
from ringtrue.model.frames import positions
from ringtrue.model.model import Model, Table, stacked

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
    "PBEAM": (
        "A",
        "I1",
        "I2",
        "I12",
        "J",
        "NSM",
        "AB",
        "I1B",
        "I2B",
        "I12B",
        "JB",
        "NSMB",
        "K1",
        "K2",
    ),
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
_STEP, _STILL = (
    1e-3,
    1e-9,
)  # of the differences that give velocities of nodes; of the fastest: one that stands still
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
    **{("PBEAM", f): f"{f}(A)" for f in ("A", "I1", "I2", "I12", "J", "NSM")},
    **{("PBEAM", f"{f}B"): f"{f}(B)" for f in ("A", "I1", "I2", "I12", "J", "NSM")},
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
    return model.with_values("MAT1", "G", t.ids[blank], (t["E"] / (2 * (1 + t["NU"])))[blank])


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
                    nominal[shear] = float(model["MAT1"]["G"][resolve_target(model, shear)[0]])
    return [_Field(t, nominal[t], tuple(v)) for t, v in used.items()]


def _relation(number: int, field: _Field, lower: float, upper: float) -> str:
    """DVPREL1, DVMREL1 or DVCREL1: value = C0 + Σ nominal·x, equal to the nominal value at x =
    1.
    """
    t = field.target
    if t.card in MATERIALS:
        kind = "DVMREL1"
    elif t.field in _PROPERTIES.get(t.card, ()) or (t.card == "PCOMP" and _PLY.fullmatch(t.field)):
        kind = "DVPREL1"
    elif t.field in _ELEMENTS.get(t.card, ()):
        kind = "DVCREL1"
    else:
        raise UnsupportedError(
            f"{t.card} {t.id} {t.field} cannot be a design variable of SOL 200 here"
        )
    if field.nominal == 0:
        raise UnsupportedError(f"{t.card} {t.id} {t.field} is 0: a factor does not change it")
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
    made = Table("PCOMP", {n: c for n, c in t.columns.items() if n != "GPLYID"}, t.file, t.line)
    tables = {c: t for c, t in model.tables.items() if c != "PCOMPG"}
    return replace(
        model,
        tables=tables | {"PCOMP": stacked(tables["PCOMP"], made) if "PCOMP" in tables else made},
    )


def _fixed_nodes(parameters: ParameterSet) -> ParameterSet:
    """The parameters without nodes that move, PCOMPG called PCOMP."""
    made = []
    for p in parameters.parameters:
        targets = [
            replace(t, card="PCOMP") if t.card == "PCOMPG" else t
            for t in p.targets
            if t.card != "GRID"
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
            near = {j: positions(scaled(model, moving, 1 + j * _STEP)) for j in (-2, -1, 1, 2)}
            velocity = (8 * (near[1] - near[-1]) - near[2] + near[-2]) / (12 * _STEP)
            for row in np.flatnonzero(
                np.abs(velocity).max(axis=1) > _STILL * np.abs(velocity).max()
            ).tolist():
                cards.append(
                    large_card("DVGRID", (k + 1, int(ids[row]), 0, 1.0, *velocity[row].tolist()))
                )
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
    moves, model, parameters = (
        _moved_nodes(model, parameters),
        _as_pcomp(model),
        _fixed_nodes(parameters),
    )
    whole = with_shear_moduli(model)
    derived = np.empty(0, dtype=np.int64)
    if "MAT1" in model:
        derived = model["MAT1"].ids[np.isnan(model["MAT1"]["G"]) & ~np.isnan(whole["MAT1"]["G"])]
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
        format_card("DRESP1", (m, f"L{m}", "EIGN", None, None, m)) for m in range(1, count + 1)
    ]
    components = range(1, 7) if grids.size else ()
    for m in range(1, count + 1):
        for c in components:
            rid = response_id(m, c, count)
            cards.append(
                format_card(
                    "DRESP1", (rid, f"U{rid}"[:8], "DISP", None, None, c, m, *grids.tolist())
                )
            )
    ids = [
        *range(1, count + 1),
        *(response_id(m, c, count) for m in range(1, count + 1) for c in components),
    ]
    cards += [
        format_card("DCONSTR", (SET, rid, 1e30, 1e30)) for rid in ids
    ]  # never met, so never left out
    keep = [("EIGN", count), *([("DISP", 6 * count * grids.size)] if grids.size else [])]
    cards += [format_card("DSCREEN", (kind, -1e10, number)) for kind, number in keep]
    return "".join(cards)


def spread(found: Sensitivities, count: int, grids: Int, variables: int) -> tuple[Float, Float]:
    """∂λ/∂a (m, p) and ∂φ/∂a in the displacement frames (g, 6, m, p) out of the matrix.

    Raises
    ------
    SolverFailed
        If a response or a design variable is missing.
    """
    at = {int(v): k for k, v in enumerate(found.variable)}
    if any(k + 1 not in at for k in range(variables)):
        raise SolverFailed(f"design variables {sorted(at)} came back; {variables} were asked for")
    values = found.values[:, [at[k + 1] for k in range(variables)]]
    d_lambda = np.full((count, variables), np.nan)
    d_shape = np.full((grids.size, 6, count, variables), np.nan)
    value = found.response <= count
    d_lambda[found.response[value] - 1] = values[value]
    mode, component = np.divmod(found.response[~value] - count - 1, 6)
    order = np.argsort(grids, kind="stable")
    place = np.searchsorted(grids[order], found.grid[~value]).clip(max=max(grids.size - 1, 0))
    row = order[place] if grids.size else place
    good = (
        (mode < count) & (grids[row] == found.grid[~value])
        if grids.size
        else np.zeros(mode.size, dtype=bool)
    )
    d_shape[row[good], component[good], mode[good]] = values[~value][good]
    lost = int(np.isnan(d_lambda).any(axis=1).sum()), int(np.isnan(d_shape).any(axis=-1).sum())
    if any(lost):
        raise SolverFailed(
            f"sensitivities of {lost[0]} eigenvalues and {lost[1]} shape components are missing"
        )
    return d_lambda, d_shape
