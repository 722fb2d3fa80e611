"""Regions of a deck with a loss factor or dashpots of their own, and what they dissipate in each
pair of modes.

A loss factor is a GE of the region's materials or springs, a dashpot its B: the coefficient of a
mechanism is the value of the field itself, so that it can be written into the deck.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy import linalg

from ringtrue.core.arrays import Float
from ringtrue.core.parameters import CardField, ParameterSet
from ringtrue.errors import InputError
from ringtrue.fem.element_cards import mesh, pieces
from ringtrue.fem.mesh import union
from ringtrue.fem.parametrisation.changed_model import rows_of
from ringtrue.model.edit import FieldChange, resolve_target
from ringtrue.model.model import Model, Table
from ringtrue.updating.damping import Mechanism
from ringtrue.updating.selection.candidates import listed

DASHPOTS = {
    "PBUSH": ("B1", "B2", "B3", "B4", "B5", "B6"),
    "PDAMP": ("B",),
    "CDAMP2": ("B",),
    "CDAMP4": ("B",),
    "PVISC": ("CE", "CR"),
}
OWN_LOSS = (
    "MAT1",
    "MAT2",
    "MAT8",
    "MAT9",
    "PCOMP",
    "PCOMPG",
)  # a laminate has the loss factor of its property
STIFFNESS = {"PBUSH": ("K1", "K2", "K3", "K4", "K5", "K6"), "PELAS": ("K",)}
SPRINGS = ("PBUSH", "PELAS", "CELAS2")


@dataclass(frozen=True, slots=True)
class DampingPriors:
    """Priors in units of the loss factor that all modes together show, mean and standard deviation.

    Attributes
    ----------
    material : tuple of float
        Of a material.
    joint : tuple of float
        Of a joint: it slips, a material does not.
    dashpot : tuple of float
        Of a dashpot.
    ratio : float
        Largest damping ratio that the dashpots of one region may give a mode.
    faint : float
        Share of the energy of a mode below which a region has none of it.
    """

    material: tuple[float, ...] = (1.0, 1.0)
    joint: tuple[float, ...] = (3.0, 5.0)
    dashpot: tuple[float, ...] = (1.0, 5.0)
    ratio: float = 0.5
    faint: float = 1e-9


PRIORS = DampingPriors()

LARGEST = {"material": 0.2, "joint": 1.0}  # loss factors


@dataclass(frozen=True, slots=True)
class DampingRegion:
    """Cards with one common loss factor (GE) or dashpot (B).

    Attributes
    ----------
    name : str
    targets : tuple of CardField
        Fields of one kind.
    lower, upper : float
        Bounds of the coefficient; upper None: 0.2 for a material, 1 for springs, ζ = 0.5 for
        dashpots.
    expected, std : float or None
        What is known beforehand; None: from the damping that all modes together show.
    """

    name: str
    targets: tuple[CardField, ...]
    lower: float = 0.0
    upper: float | None = None
    expected: float | None = None
    std: float | None = None

    def __post_init__(self) -> None:
        loss = {
            t
            for t in self.targets
            if t.field == "GE" and t.card in (*OWN_LOSS, *SPRINGS)
        }
        dashpots = {t for t in self.targets if _is_dashpot(t)}
        if set(self.targets) not in (loss, dashpots) or not self.targets:
            wrong = [
                t for t in self.targets if t not in loss | dashpots
            ] or self.targets
            got = ", ".join(f"{t.card} {t.id} {t.field}" for t in wrong)
            raise InputError(
                f"damping region {self.name}: got {got or 'no target'}; allowed are loss factors "
                f"(GE of {', '.join((*OWN_LOSS, *SPRINGS))}) or dashpots (B1 .. B6 of PBUSH, B of "
                "PDAMP, CDAMP2 and CDAMP4, CE and CR of PVISC), not both in one region"
            )

    @property
    def kind(self) -> Literal["viscous", "structural"]:
        """Which matrix it is part of."""
        return "viscous" if _is_dashpot(self.targets[0]) else "structural"

    @property
    def nature(self) -> Literal["dashpot", "joint", "material"]:
        """What dissipates."""
        if self.kind == "viscous":
            return "dashpot"
        return "joint" if self.targets[0].card in SPRINGS else "material"

    def changes(self, value: float) -> list[FieldChange]:
        """The fields with the value of the coefficient."""
        return [FieldChange(t.card, t.id, t.field, value) for t in self.targets]


def _is_dashpot(t: CardField) -> bool:
    return t.field in DASHPOTS.get(t.card, ())


def default_regions(
    model: Model, suspension: ParameterSet, properties: Mapping[str, Sequence[int]]
) -> tuple[DampingRegion, ...]:
    """A region for each material and each group of springs; the suspension gets dashpots in place
    of a loss factor.

    MAT1 cards of one density and one Poisson's ratio are one material: a deck has several of them
    where the stiffness of its regions is uncertain, and what dissipates in them is the same. So are
    laminates of the same materials, and springs of the same stiffness are one make, unless they are
    regions of different names.

    Parameters
    ----------
    model : Model
    suspension : ParameterSet
        Parameters on PBUSH stiffnesses Kn: their bushes get one dashpot a parameter, on Bn.
    properties : mapping of name to property numbers
        Regions are called by these names where they belong to few enough of them.
    """
    sprung = []
    for p in suspension.parameters:
        bushes = [
            t
            for t in p.targets
            if t.card == "PBUSH" and re.fullmatch("K[1-6]", t.field)
        ]
        if bushes:
            dashpots = tuple(CardField("PBUSH", t.id, f"B{t.field[1]}") for t in bushes)
            sprung.append(DampingRegion(p.name, dashpots))
    soft = {t.id for r in sprung for t in r.targets}
    found = [
        DampingRegion(
            _name(model, card, ids, properties),
            tuple(CardField(card, i, "GE") for i in ids),
        )
        for card in (*OWN_LOSS, "PBUSH", "PELAS")
        if card in model
        for ids in _alike(model[card], properties, soft if card == "PBUSH" else ())
    ]
    if "CELAS2" in model:
        ids = model["CELAS2"].ids.tolist()
        found.append(
            DampingRegion("CELAS2", tuple(CardField("CELAS2", i, "GE") for i in ids))
        )
    found += sprung
    names = [r.name for r in found]
    # the card behind a name that two regions would share
    return tuple(
        replace(r, name=f"{r.name} ({r.targets[0].card} {r.targets[0].id})")
        if names.count(r.name) > 1
        else r
        for r in found
    )


def _alike(
    table: Table, properties: Mapping[str, Sequence[int]], left_out: Collection[int]
) -> list[tuple[int, ...]]:
    """Ids of the cards that are one region: materials, laminates or springs of one make."""
    ids = table.ids.tolist()
    if table.card == "MAT1":  # of one density and Poisson's ratio
        looks = np.nan_to_num(np.stack([table["RHO"], table["NU"]], axis=1), nan=-1.0)
        keys: list[object] = [tuple(row) for row in np.round(looks, 9).tolist()]
    elif table.card in ("PCOMP", "PCOMPG"):
        keys = [
            frozenset(table.ragged("MID").row(i).tolist()) for i in range(len(table))
        ]
    elif table.card in ("PBUSH", "PELAS"):
        stiffness = np.stack([table[k] for k in STIFFNESS[table.card]], axis=1)
        keys = []
        for i, row in zip(ids, stiffness.tolist(), strict=True):
            named = frozenset(
                name for name, members in properties.items() if i in members
            )
            keys.append((named, *(f"{k:.9e}" for k in row)))
    else:
        keys = list(ids)
    groups: dict[object, list[int]] = {}
    for key, ident in zip(keys, ids, strict=True):
        if ident not in left_out:
            groups.setdefault(key, []).append(int(ident))
    return sorted(tuple(dict.fromkeys(g)) for g in groups.values())


def _name(
    model: Model, card: str, ids: Sequence[int], properties: Mapping[str, Sequence[int]]
) -> str:
    """The named regions of the cards; the cards themselves where they have none, their density
    where they are many.
    """
    if card in ("PBUSH", "PELAS", "PCOMP", "PCOMPG"):
        mine = set(ids)
    else:
        mine = {
            int(i)
            for name in ("PSOLID", "PSHELL", "PBAR", "PBEAM", "PROD", "PTUBE")
            for column in ("MID", "MID1", "MID2")
            if name in model and column in model[name].columns
            for i in model[name].ids[np.isin(model[name][column], ids)]
        }
    names = [name for name, pids in properties.items() if mine & set(pids)]
    if 0 < len(names) <= 2 and mine <= {p for name in names for p in properties[name]}:
        return ", ".join(names)
    first = int(model[card].find(np.array(ids[:1]))[0])
    if card in ("PCOMP", "PCOMPG"):
        made_of = np.unique(model[card].ragged("MID").row(first))
        return f"laminates of materials {', '.join(map(str, made_of.tolist()))}"
    if card in STIFFNESS:
        return f"{card} {listed(ids)}"
    if len(ids) > 1:
        return f"material of density {float(model[card]['RHO'][first]):g}"
    return f"{card} {ids[0]}"


def undamped(model: Model) -> Model:
    """A copy of the model without loss factors and dashpots."""
    fields = [(card, "GE") for card in (*OWN_LOSS, *SPRINGS)]
    fields += [(card, name) for card, names in DASHPOTS.items() for name in names]
    tables = dict(model.tables)
    for card, name in fields:
        if card in tables:
            tables[card] = tables[card].with_column(name, np.zeros(len(tables[card])))
    for name in (f"GE{i}" for i in range(2, 7)):
        # a blank one goes with GE, the others have a value of their own
        if "PBUSH" in tables and name in tables["PBUSH"].columns:
            tables["PBUSH"] = tables["PBUSH"].with_column(
                name, 0 * tables["PBUSH"][name]
            )
    return replace(model, tables=tables)


def seen(
    model: Model, targets: Sequence[CardField], shapes: Float
) -> tuple[Float, Float]:
    """ΦᵀDΦ and ΦᵀHΦ, (n, n) each, of the elements that the targets damp.

    Parameters
    ----------
    model : Model
        With the fields of the targets at their values.
    shapes : (full, n) float64
        Motion of all nodes, basic frame.
    """
    rows = union(rows_of(model, t) for t in targets)
    m = mesh(model)
    n = shapes.shape[1]
    piece = max(64, 300_000 // n)  # elements times vectors that are held at once
    motion = np.concatenate([shapes, np.zeros((1, n))])  # DOF -1 is the row of zeros
    d = np.zeros((n, n))
    h = np.zeros((n, n))
    for _, _, part in pieces(m, rows, piece):
        x = motion[part.dofs].reshape(part.dofs.shape[0], -1, n)
        if len(structural := part.structural):
            h += np.einsum("edm,edn->mn", x, structural @ x, optimize=True)
        if len(part.viscous):
            d += np.einsum("edm,edn->mn", x, part.viscous @ x, optimize=True)
    return (d + d.T) / 2, (h + h.T) / 2


def _set(model: Model, changes: Sequence[FieldChange]) -> Model:
    for c in changes:
        resolve_target(model, c)
        model = model.with_values(
            c.card, c.field, np.array([c.id]), np.array([c.value])
        )
    return model


def _held(model: Model, region: DampingRegion) -> list[FieldChange]:
    """The fields of a region as they are in the deck; a blank is 0."""
    out = []
    for t in region.targets:
        value = float(model[t.card][t.field][resolve_target(model, t)[0]])
        out.append(
            FieldChange(t.card, t.id, t.field, 0.0 if np.isnan(value) else value)
        )
    return out


@dataclass(frozen=True, slots=True, eq=False)
class Dampers:
    """The regions that take part, their mechanisms, and the damping of the deck that is not theirs.

    Attributes
    ----------
    regions : tuple (k) of DampingRegion
    mechanisms : tuple (k) of Mechanism
    base : (n, n), (n, n) float64
        ΦᵀDΦ and ΦᵀHΦ of what else the deck holds.
    """

    regions: tuple[DampingRegion, ...]
    mechanisms: tuple[Mechanism, ...]
    base: tuple[Float, Float]


def dampers(
    model: Model,
    regions: Sequence[DampingRegion],
    values: Float,
    shapes: Float,
    total: tuple[Float, Float],
    ratio: float,
) -> Dampers:
    """What each region dissipates; regions that take no part in any mode are left out.

    Parameters
    ----------
    model : Model
    regions : sequence of DampingRegion
    values : (n,) float64, λ, (rad/s)²
        Above 0.
    shapes : (full, n) float64
        Mass-normalised modes, all nodes in the basic frame.
    total : (n, n), (n, n) float64
        ΦᵀDΦ and ΦᵀHΦ of the deck as it is.
    ratio : float
        Damping ratio that the modes show, for the priors.

    Raises
    ------
    InputError
        If a target is not in the model, or in two regions.
    """
    w = np.sqrt(values)
    kept = []
    mechanisms = []
    matrices, base = matrices_of(model, regions, shapes, total)
    for r, matrix in zip(regions, matrices, strict=True):
        share = np.diag(matrix) / (2 * w if r.kind == "viscous" else values)
        if share.max(initial=0.0) <= (0.0 if r.kind == "viscous" else PRIORS.faint):
            continue
        expected, std, upper = _known(r, share, ratio)
        kept.append(r)
        mechanisms.append(
            Mechanism(
                r.name,
                r.kind,
                matrix,
                lower=r.lower,
                upper=upper,
                prior=expected,
                std=std,
            )
        )
    return Dampers(tuple(kept), tuple(mechanisms), base)


def joined_dampers(parts: Sequence[Dampers]) -> Dampers:
    """The regions of several decks with common coefficients: modes of all of them side by side,
    uncoupled.

    A region that two decks share is one; what is known of it beforehand is what the first of them
    says.
    """
    sizes = [len(p.base[0]) for p in parts]
    first = np.cumsum([0, *sizes])
    regions: dict[str, DampingRegion] = {}
    mechanisms: dict[str, Mechanism] = {}
    for i, part in enumerate(parts):
        for r, m in zip(part.regions, part.mechanisms, strict=True):
            if r.name not in regions:
                regions[r.name] = r
                mechanisms[r.name] = replace(m, matrix=np.zeros((first[-1], first[-1])))
            wide = mechanisms[r.name].matrix.copy()
            wide[first[i] : first[i + 1], first[i] : first[i + 1]] = m.matrix
            mechanisms[r.name] = replace(mechanisms[r.name], matrix=wide)
    d, h = (linalg.block_diag(*(p.base[k] for p in parts)) for k in range(2))
    return Dampers(tuple(regions.values()), tuple(mechanisms.values()), (d, h))


def matrices_of(
    model: Model,
    regions: Sequence[DampingRegion],
    shapes: Float,
    total: tuple[Float, Float],
) -> tuple[list[Float], tuple[Float, Float]]:
    """What a unit of each region's coefficient adds to ΦᵀDΦ or ΦᵀHΦ, (n, n) each, and what else the
    deck holds.

    Parameters
    ----------
    model : Model
    regions : sequence of DampingRegion
    shapes : (full, n) float64
        Vectors, all nodes in the basic frame.
    total : (n, n), (n, n) float64
        ΦᵀDΦ and ΦᵀHΦ of the deck as it is.

    Raises
    ------
    InputError
        If a target is not in the model, or in two regions.
    """
    every = [t for r in regions for t in r.targets]
    if twice := [t for t in every if every.count(t) > 1]:
        raise InputError(
            f"{twice[0].card} {twice[0].id} {twice[0].field} is in two damping regions"
        )
    bare = undamped(model)
    found = []
    base = total
    for r in regions:
        unit = seen(_set(bare, r.changes(1.0)), r.targets, shapes)
        found.append(unit[0] if r.kind == "viscous" else unit[1])
        now = _held(model, r)
        # damping is proportional to its fields
        own = unit
        scale = float(now[0].value)
        if any(c.value != scale for c in now):
            own = seen(_set(bare, now), r.targets, shapes)
            scale = 1.0
        base = (base[0] - scale * own[0], base[1] - scale * own[1])
    return found, base


def _known(
    region: DampingRegion, share: Float, ratio: float
) -> tuple[float, float, float]:
    """Expected coefficient, its standard deviation and the upper bound; `share` (n,) per unit
    coefficient.
    """
    if region.nature == "dashpot":  # of the mode that it damps most
        unit = ratio / share.max()
        many = PRIORS.dashpot
        most = PRIORS.ratio / share.max()
    else:
        unit = 2 * ratio
        many = PRIORS.material if region.nature == "material" else PRIORS.joint
        most = LARGEST[region.nature]
    expected = region.expected if region.expected is not None else many[0] * unit
    std = region.std if region.std is not None else many[1] * unit
    upper = region.upper if region.upper is not None else max(most, 2 * expected)
    return expected, std, upper
