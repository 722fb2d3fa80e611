"""Candidate parameters of a deck: what could be wrong with it, by property, material, region and group of springs.

A candidate is a common factor on fields of the deck. Generated from the cards alone, then held against the modes:
what no mode strains or moves cannot be found from modes, and is left out with that reason.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from types import MappingProxyType
from typing import Literal

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Float, Int
from ringtrue.core.observation import Observation
from ringtrue.core.parameters import Parameter, ParameterSet, Substructure, Target
from ringtrue.errors import InputError, UnsupportedError, did_you_mean
from ringtrue.fem.assembly import System
from ringtrue.fem.change import affected_cards, rows_of
from ringtrue.fem.derivatives import PowerTerm, bilinear, system_derivatives, terms
from ringtrue.fem.kinds import MATERIAL, PROPERTY
from ringtrue.model.frames import positions
from ringtrue.model.model import Model, Ragged, Table
from ringtrue.model.references import REFERENCES, SHELL_PROPERTIES
from ringtrue.reduce.parametric import BasisOptions, Progress, ReducedModel, observed_system, reduced_model

Kind = Literal["property", "material", "region", "spring", "mass"]
KINDS: tuple[Kind, ...] = ("property", "material", "region", "spring", "mass")
LEAST = 1e-5  # share of a mode's strain and kinetic energy below which a candidate does not change it
SAME = 1e-9  # relative distance of values that are one

_QUANTITIES = ("length", "modulus", "density", "stiffness", "torsion", "mass")
UNITS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "SI": ("m", "Pa", "kg/m3", "N/m", "N m/rad", "kg"),
        "mm-t-s": ("mm", "MPa", "t/mm3", "N/mm", "N mm/rad", "t"),
        "mm-kg-ms": ("mm", "GPa", "kg/mm3", "kN/mm", "kN mm/rad", "kg"),
        "in-lbf-s": ("in", "psi", "lbf s2/in4", "lbf/in", "lbf in/rad", "lbf s2/in"),
        "ft-lbf-s": ("ft", "lbf/ft2", "slug/ft3", "lbf/ft", "lbf ft/rad", "slug"),
    }
)
# quantity -> prior standard deviation of ln(factor), largest factor
SPREAD: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "length": (0.1, 1.5),
        "area": (0.2, 2.0),
        "inertia": (0.3, 3.0),
        "modulus": (0.3, 3.0),
        "density": (0.1, 1.5),
        "stiffness": (1.0, 20.0),
        "torsion": (1.0, 20.0),
        "mass": (0.2, 2.0),
        "line": (0.3, 3.0),
    }
)
# card -> field, what it is, quantity; fields joined by + have one factor
_SECTIONS = {
    "PSHELL": (("T", "thickness", "length"), ("NSM", "non-structural mass", "line")),
    "PROD": (("A", "area", "area"), ("J", "torsion constant", "inertia"), ("NSM", "non-structural mass", "line")),
    "CONROD": (("A", "area", "area"), ("J", "torsion constant", "inertia")),
    "PTUBE": (("OD", "outer diameter", "length"), ("T", "wall", "length")),
    "PBAR": (
        ("A", "area", "area"),
        ("I1", "bending in plane 1", "inertia"),
        ("I2", "bending in plane 2", "inertia"),
        ("J", "torsion constant", "inertia"),
        ("NSM", "non-structural mass", "line"),
    ),
}
_SECTIONS["PBEAM"] = _SECTIONS["PBAR"]
_MATERIALS = {
    "MAT1": (("E+G", "Young's modulus", "modulus"), ("RHO", "density", "density")),
    "MAT2": (("G11+G12+G13+G22+G23+G33", "moduli", "modulus"), ("RHO", "density", "density")),
    "MAT8": (
        ("E1", "modulus along the fibres", "modulus"),
        ("E2", "modulus across the fibres", "modulus"),
        ("G12", "shear modulus in the plane", "modulus"),
        ("G1Z+G2Z", "transverse shear moduli", "modulus"),
        ("RHO", "density", "density"),
    ),
    "MAT9": (
        ("+".join(f"G{i}{j}" for i in range(1, 7) for j in range(i, 7)), "moduli", "modulus"),
        ("RHO", "density", "density"),
    ),
}
_TRANSLATION = tuple((f"K{i}", f"stiffness along axis {i}", "stiffness") for i in (1, 2, 3))
_ROTATION = tuple((f"K{i + 3}", f"stiffness about axis {i}", "torsion") for i in (1, 2, 3))
_SPRINGS = {
    "PBUSH": (("K1+K2+K3+K4+K5+K6", "stiffness in all directions", "stiffness"), *_TRANSLATION, *_ROTATION),
    **dict.fromkeys(("PELAS", "CELAS2", "CELAS4"), (("K", "stiffness", "stiffness"),)),
}
_MASSES = {
    "CONM2": (("M+I11+I21+I22+I31+I32+I33", "mass and inertia", "mass"),),
    **dict.fromkeys(("PMASS", "CMASS2", "CMASS4"), (("M", "mass", "mass"),)),
}
_ENDS = {"A": "AB", "I1": "I1B", "I2": "I2B", "J": "JB", "NSM": "NSMB"}
_AIDS = ("G0", "SA", "SB")  # name a node, but do not stand on it
_NODE_FIELDS = {
    card: tuple(r.field for r in REFERENCES if r.card == card and "GRID" in r.of and r.field not in _AIDS)
    for card in PROPERTY
}
Rows = dict[str, Int]


@dataclass(frozen=True, slots=True)
class Candidate:
    """A parameter with what it means.

    Attributes
    ----------
    parameter : Parameter
    kind : {"property", "material", "region", "spring", "mass"}
    what : str
        In words, with the nominal value and its unit.
    elements : tuple of int
        Elements (EID) that it changes, ascending.
    """

    parameter: Parameter
    kind: Kind
    what: str
    elements: tuple[int, ...]

    @property
    def name(self) -> str:
        """Of the parameter."""
        return self.parameter.name


@dataclass(frozen=True, slots=True)
class CandidateSettings:
    """What is generated.

    Attributes
    ----------
    kinds : tuple of str
        Of `KINDS`.
    units : str
        A unit system (`UNITS`) for the names; "" names values without a unit.
    pieces : int
        A connected part of one property is cut into regions of about equal size, at most so many.
    smallest : int
        Fewest elements of a region.
    spread : mapping of str to (float, float)
        Prior standard deviation of ln(factor) and largest factor by quantity, in place of those of `SPREAD`.
    """

    kinds: tuple[Kind, ...] = KINDS
    units: str = ""
    pieces: int = 4
    smallest: int = 2
    spread: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for kind in self.kinds:
            if kind not in KINDS:
                raise InputError(f"candidates: no kind {kind!r}{did_you_mean(kind, KINDS)}")
        if self.units and self.units not in UNITS:
            raise InputError(f"unit system {self.units!r} is not known{did_you_mean(self.units, UNITS)}")
        for quantity in self.spread:
            if quantity not in SPREAD:
                raise InputError(f"candidates: no quantity {quantity!r}{did_you_mean(quantity, SPREAD)}")
        if self.pieces < 1 or self.smallest < 1:
            raise InputError(f"candidates: pieces {self.pieces} and smallest {self.smallest} must be 1 or more")

    def unit(self, quantity: str) -> str:
        """The unit of a quantity, "" where the system is not known."""
        if not self.units:
            return ""
        known = dict(zip(_QUANTITIES, UNITS[self.units], strict=True))
        powers = {"area": 2, "inertia": 4}
        return f"{known['length']}{powers[quantity]}" if quantity in powers else known.get(quantity, "")


def parameters(candidates: Sequence[Candidate]) -> ParameterSet:
    """The parameters of the candidates, in order."""
    return ParameterSet(tuple(c.parameter for c in candidates))


def generate(model: Model, settings: CandidateSettings | None = None) -> tuple[Candidate, ...]:
    """All candidates of a deck that an element uses, in the order material, property, region, spring, mass.

    Of two that are the same fields of the same elements, the first is kept.

    Raises
    ------
    InputError
        If the deck gives none.
    """
    s = settings or CandidateSettings()
    makers: dict[Kind, Callable[[Model, CandidateSettings], Iterator[Candidate]]] = {
        "material": lambda m, s: _fields(m, s, "material", _MATERIALS),
        "property": lambda m, s: chain(_fields(m, s, "property", _SECTIONS), _laminates(m, s)),
        "region": _regions,
        "spring": lambda m, s: _grouped(m, s, "spring", _SPRINGS),
        "mass": lambda m, s: _grouped(m, s, "mass", _MASSES),
    }
    found: dict[object, Candidate] = {}
    for kind, make in makers.items():
        if kind in s.kinds:
            for c in make(model, s):
                found.setdefault(_effect(c), c)
    if not found:
        raise InputError(f"no candidate of the kinds {', '.join(s.kinds)} in the deck")
    return tuple(found.values())


def _effect(c: Candidate) -> object:
    """Equal for candidates that do the same."""
    fields = frozenset((t.card, t.id, t.field) for t in c.parameter.targets)
    return fields, c.parameter.substructures, c.elements


def _candidate(
    s: CandidateSettings,
    kind: Kind,
    name: str,
    what: str,
    quantity: str,
    elements: Int,
    targets: Sequence[Target] = (),
    substructures: Sequence[Substructure] = (),
) -> Candidate:
    std, most = s.spread.get(quantity, SPREAD[quantity])
    p = Parameter(name, tuple(targets), 1 / most, most, "log", std, (), tuple(substructures))
    return Candidate(p, kind, what, tuple(np.unique(elements).tolist()))


def _amount(value: float, quantity: str, s: CandidateSettings) -> str:
    return f"{value:.4g} {s.unit(quantity)}".strip()


def _given(table: Table, row: int, fields: str) -> list[str]:
    """Those of the fields that hold a value other than 0."""
    plain = [f for f in fields.split("+") if f in table.columns and not isinstance(table.columns[f], Ragged)]
    return [f for f in plain if np.isfinite(table[f][row]) and table[f][row] != 0]


def _fields(
    model: Model, s: CandidateSettings, kind: Kind, catalogue: Mapping[str, tuple[tuple[str, str, str], ...]]
) -> Iterator[Candidate]:
    """One candidate a card and field."""
    for card, entries in catalogue.items():
        if card not in model:
            continue
        table = model[card]
        for row, ident in enumerate(table.ids.tolist()):  # over cards, of which a deck has hundreds, not elements
            rows = rows_of(model, Target(card, ident, ""))
            if not rows:
                continue
            for fields, word, quantity in entries:
                given = _given(table, row, fields)
                if given:
                    targets = [Target(card, ident, f) for f in given + _other_end(table, row, given)]
                    name = f"{card} {ident} {given[0]}"
                    what = f"{word} {_amount(float(table[given[0]][row]), quantity, s)} of {counted(rows)}"
                    yield _candidate(s, kind, name, what, quantity, _ids(model, rows), targets)


def _other_end(table: Table, row: int, given: Sequence[str]) -> list[str]:
    """End B of a PBEAM where it differs from end A; where it does not, it follows by itself."""
    if table.card != "PBEAM":
        return []
    pairs = [(f, _ENDS[f]) for f in given if f in _ENDS]
    return [b for a, b in pairs if table[b][row] != table[a][row] and table[b][row] != 0]


def _laminates(model: Model, s: CandidateSettings) -> Iterator[Candidate]:
    """The thickness of all plies of a laminate, by one factor."""
    for card in ("PCOMP", "PCOMPG"):
        for row, ident in enumerate(model[card].ids.tolist() if card in model else []):
            rows = rows_of(model, Target(card, ident, ""))
            if rows:
                t = model[card].ragged("T").row(row)
                targets = [Target(card, ident, f"T{k + 1}") for k in range(t.size)]
                what = f"thickness of all {t.size} plies of {counted(rows)}"
                yield _candidate(s, "property", f"{card} {ident} T", what, "length", _ids(model, rows), targets)


def counted(rows: Rows) -> str:
    """`12 CBAR and 4 CQUAD4`."""
    return " and ".join(f"{at.size} {card}" for card, at in sorted(rows.items()))


def _ids(model: Model, rows: Rows) -> Int:
    return np.concatenate([np.zeros(0, dtype=np.int64), *(model[c].ids[at] for c, at in rows.items())])


def _grouped(
    model: Model, s: CandidateSettings, kind: Kind, catalogue: Mapping[str, tuple[tuple[str, str, str], ...]]
) -> Iterator[Candidate]:
    """One candidate for all cards of equal value (one make of spring), and one for each card by itself."""
    for card, entries in catalogue.items():
        if card not in model:
            continue
        table = model[card]
        used = np.array([bool(rows_of(model, Target(card, i, ""))) for i in table.ids.tolist()], dtype=bool)
        for fields, word, quantity in entries:
            values = table[fields.split("+")[0]]
            live = np.flatnonzero(used & np.isfinite(values) & (values != 0))
            for group in _equal(values, live):
                members = [[at] for at in group.tolist()] if group.size > 1 else []
                for at in [group.tolist(), *members]:
                    yield _group(model, s, kind, table, np.array(at), fields, word, quantity)


def _equal(values: Float, live: Int) -> list[Int]:
    """Rows of `live` whose values are the same, in the order of the rows."""
    order = live[np.argsort(values[live], kind="stable")]
    v = values[order]
    cuts = np.flatnonzero(np.abs(np.diff(v)) > SAME * np.abs(v[1:])) + 1
    groups = [np.sort(g) for g in np.split(order, cuts) if g.size]
    return sorted(groups, key=lambda g: int(g[0]))


def _group(
    model: Model, s: CandidateSettings, kind: Kind, table: Table, at: Int, fields: str, word: str, quantity: str
) -> Candidate:
    ids = table.ids[at]
    targets = [Target(table.card, int(table.ids[r]), f) for r in at.tolist() for f in _given(table, r, fields)]
    rows: Rows = {}
    for i in ids.tolist():
        for c, more in rows_of(model, Target(table.card, i, "")).items():
            rows[c] = np.union1d(rows.get(c, more), more)
    lead = fields.split("+")[0]
    field_name = "K" if fields.startswith("K1+") else lead
    value = _amount(float(table[lead][at[0]]), quantity, s)
    each = " each" if ids.size > 1 else ""
    name = f"{table.card} {_listed(ids)} {field_name}"
    return _candidate(s, kind, name, f"{word} {value}{each} of {counted(rows)}", quantity, _ids(model, rows), targets)


def _listed(ids: Int) -> str:
    """`3`, `3-8`, or `3,5,9 (12 in all)`."""
    ids = np.sort(ids)
    if ids.size == 1:
        return str(ids[0])
    if ids[-1] - ids[0] == ids.size - 1:
        return f"{ids[0]}-{ids[-1]}"
    shown = ",".join(map(str, ids[:3].tolist()))
    return shown if ids.size <= 3 else f"{shown},... ({ids.size} in all, to {ids[-1]})"


# Regions


def _regions(model: Model, s: CandidateSettings) -> Iterator[Candidate]:
    """The stiffness of each connected part of a property, and of pieces of it."""
    structural = ("CROD", "CTUBE", "CBAR", "CBEAM", *[c for c in affected_cards(model) if _is_continuum(c)])
    cards = [c for c in dict.fromkeys(structural) if c in model]
    if not cards:
        return
    pid = np.concatenate([model[c]["PID"] for c in cards])
    eid = np.concatenate([model[c].ids for c in cards])
    family = np.concatenate([np.full(len(model[c]), PROPERTY[c]) for c in cards])
    nodes = _connectivity(model, cards)
    centre = np.asarray((nodes @ positions(model)) / np.maximum(nodes.sum(axis=1), 1)[:, None])
    for key in sorted({(str(f), int(p)) for f, p in zip(family, pid, strict=True)}):
        of = np.flatnonzero((family == key[0]) & (pid == key[1]))
        parts = _islands(nodes[of])
        for k, part in enumerate(parts):
            whole = of[part]
            place = f" part {k + 1}" if len(parts) > 1 else ""
            pieces = _cut(centre[whole], min(s.pieces, whole.size // s.smallest))
            sets = [(place, whole)] if place else []
            if len(pieces) > 1:
                sets += [(f"{place} piece {j + 1}", whole[p]) for j, p in enumerate(pieces)]
            for label, at in sets:
                yield _region(model, s, f"{_property(model, key)} {key[1]}{label}", eid[at], centre[at].mean(axis=0))


def _is_continuum(card: str) -> bool:
    return PROPERTY.get(card) in ("PSHELL", "PSOLID")


def _property(model: Model, key: tuple[str, int]) -> str:
    """The card that holds a property id."""
    cards = SHELL_PROPERTIES if key[0] == "PSHELL" else (key[0],)
    return next((c for c in cards if c in model and (model[c].ids == key[1]).any()), key[0])


def _connectivity(model: Model, cards: Sequence[str]) -> sparse.csr_array:
    """1 where an element (e) of the cards stands on a node (n), csr (e, n)."""
    grid = model["GRID"]
    rows, cols, first = [], [], 0
    for c in cards:
        ids = model[c].stack(*_NODE_FIELDS[c])
        e, k = np.nonzero(ids > 0)
        rows.append(e + first)
        cols.append(grid.find(ids[e, k]))
        first += len(ids)
    at = (np.concatenate(rows), np.concatenate(cols))
    keep = at[1] >= 0
    made = sparse.coo_array((np.ones(int(keep.sum())), (at[0][keep], at[1][keep])), shape=(first, len(grid)))
    return sparse.csr_array(made)


def _islands(nodes: sparse.csr_array) -> list[Int]:
    """Elements that hang together, in the order of their first."""
    _, label = sparse.csgraph.connected_components(sparse.csr_array(nodes @ nodes.T), directed=False)
    return [np.flatnonzero(label == k) for k in range(int(label.max(initial=-1)) + 1)]


def _cut(centre: Float, pieces: int) -> list[Int]:
    """Cut points (e, 3) again and again across their longest axis into parts of about equal number."""
    parts = [np.arange(len(centre))]
    while len(parts) < pieces:
        i = int(np.argmax([p.size for p in parts]))
        x = centre[parts[i]] - centre[parts[i]].mean(axis=0)
        _, _, axes = np.linalg.svd(x, full_matrices=False)
        axis = axes[0] * np.sign(axes[0][np.argmax(np.abs(axes[0]))])
        order = parts[i][np.argsort(np.round(x @ axis, 9), kind="stable")]
        half = order.size // 2
        parts[i : i + 1] = [np.sort(order[:half]), np.sort(order[half:])]
    return parts


def _region(model: Model, s: CandidateSettings, label: str, elements: Int, centre: Float) -> Candidate:
    """Young's modulus as these elements see it; a factor on their stiffness where they are not isotropic."""
    place = ", ".join(f"{x:.3g}" for x in centre.tolist())
    what = f"stiffness of {elements.size} elements around ({place}) {s.unit('length')}".strip()
    ids = tuple(np.unique(elements).tolist())
    targets = []
    for mid in _isotropic(model, elements):
        row = int(model["MAT1"].find(np.array([mid]))[0])
        targets += [Target("MAT1", mid, f, ids) for f in _given(model["MAT1"], row, "E+G")]
    if targets:
        return _candidate(s, "region", f"{label} E", what, "modulus", elements, targets)
    return _candidate(s, "region", f"{label} K", what, "modulus", elements, (), [Substructure("stiffness", ids)])


def _isotropic(model: Model, elements: Int) -> list[int]:
    """The MAT1 of the elements; none if one of them has another material."""
    found: set[int] = set()
    for card in affected_cards(model):
        pid = model[card]["PID"][np.isin(model[card].ids, elements)] if "PID" in model[card].columns else np.zeros(0)
        prop = PROPERTY.get(card, "")
        if not pid.size:
            continue
        row = model[prop].find(pid) if prop in model else np.full(pid.size, -1)
        if (row < 0).any() or prop not in MATERIAL:
            return []
        mids = model[prop].stack(*MATERIAL[prop])[row]
        found |= set(mids[mids > 0].tolist())
    if "MAT1" not in model or not np.isin(list(found), model["MAT1"].ids).all():
        return []
    return sorted(found)


# Against the modes


@dataclass(frozen=True, slots=True)
class Dropped:
    """A candidate that is left out, and why."""

    name: str
    reason: str


def effective(
    model: Model,
    system: System,
    candidates: Sequence[Candidate],
    values: Float,
    vectors: Float,
    least: float = LEAST,
) -> tuple[tuple[Candidate, ...], tuple[Dropped, ...]]:
    """Those candidates that change one of the modes, and those that do not.

    Of a candidate that no mode strains or moves, ∂K φ = ∂M φ = 0: neither frequency nor shape depends on it.

    Parameters
    ----------
    values : (m,) float64, (rad/s)²
    vectors : (f, m) float64, unit modal mass
    """
    share = sum(np.abs(e) for e in effects(model, system, candidates, values, vectors))
    most = np.asarray(share).max(axis=0, initial=0.0)
    keep = tuple(c for c, size in zip(candidates, most.tolist(), strict=True) if size > least)
    lost = tuple(
        Dropped(c.name, f"no mode has more than {size:.1e} of its energy in {c.what}")
        for c, size in zip(candidates, most.tolist(), strict=True)
        if size <= least
    )
    return keep, lost


def effects(
    model: Model, system: System, candidates: Sequence[Candidate], values: Float, vectors: Float
) -> tuple[Float, Float]:
    """φᵀ(∂K/∂x)φ/λ and φᵀ(∂M/∂x)φ of each mode and candidate, (m, p) each; ∂ ln f/∂x is half their difference.

    Parameters
    ----------
    values : (m,) float64, (rad/s)²
    vectors : (f, m) float64, unit modal mass
    """
    lam = np.maximum(np.abs(values), 1e-6 * np.abs(values).max(initial=1e-300))
    dk, dm = bilinear(model, [c.parameter for c in candidates], system, vectors[None], vectors)
    return dk[0] / lam[:, None], dm[0]


def reduced_candidates(
    model: Model,
    system: System,
    candidates: Sequence[Candidate],
    observation: Observation,
    count: int,
    *,
    options: BasisOptions | None = None,
    progress: Progress | None = None,
) -> ReducedModel:
    """A reduced model over all candidates, as the choice needs it: exact sensitivities at x = 0.

    Away from there two simplifications hold, and an updating with the chosen parameters must follow: a dependence that
    is no polynomial (the section of a beam with shear) goes on along its tangent, and the effects of two candidates on
    the same field of an element add up instead of multiplying.
    """
    chosen = [c.parameter for c in candidates]
    slopes = system_derivatives(model, chosen, system)
    parts: list[tuple[PowerTerm, ...]] = []
    for i, (c, slope) in enumerate(zip(candidates, slopes, strict=True)):
        parts.append(_powers(model, c, system) or (PowerTerm(1, slope.stiffness, slope.mass),))
        if progress is not None:
            progress(0.5 * (i + 1) / len(chosen), "candidates")
    affine = observed_system(
        system.stiffness, system.mass, system.transform, parameters(candidates), parts, observation
    )
    told = None if progress is None else lambda f, t: progress(0.5 + 0.5 * f, t)
    return reduced_model(affine, count, options=options, progress=told)


def _powers(model: Model, candidate: Candidate, system: System) -> tuple[PowerTerm, ...]:
    """The exact parts of a thickness or section; none where it is linear anyway, or no polynomial."""
    if candidate.kind != "property":
        return ()
    try:
        return terms(model, candidate.parameter, system)
    except UnsupportedError:
        return ()


def elements_of(model: Model) -> Int:
    """Ids of all elements that are assembled, in the order of their cards, (e,) int64."""
    return _ids(model, {c: np.arange(len(model[c])) for c in affected_cards(model)})


def membership(model: Model, candidates: Sequence[Candidate]) -> sparse.csr_array:
    """1 where a candidate (p) changes an element (e, in the order of `elements_of`), csr (p, e)."""
    ids = elements_of(model)
    order = np.argsort(ids, kind="stable")
    rows = [np.full(len(c.elements), i) for i, c in enumerate(candidates)]
    wanted = np.concatenate([np.zeros(0, dtype=np.int64), *(np.array(c.elements, dtype=np.int64) for c in candidates)])
    at = order[np.searchsorted(ids[order], wanted).clip(max=ids.size - 1)]
    entries = (np.ones(at.size), (np.concatenate([np.zeros(0, dtype=np.int64), *rows]), at))
    return sparse.csr_array(sparse.coo_array(entries, shape=(len(candidates), ids.size)))
