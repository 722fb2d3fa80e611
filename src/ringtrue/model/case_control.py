"""What case control takes of a deck: sets of constraints, matrices, the eigenvalue method and modal
damping; what of the deck takes no part; and what is condensed.

Condensed are points that are omitted and interior points of superelements; modal coordinates stand
for them (MSC Nastran Superelements User's Guide).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Float, FrozenArrays, Int
from ringtrue.core.dofs import DofSet
from ringtrue.errors import UnsupportedError
from ringtrue.model.model import ComponentModes, Model, stacked
from ringtrue.model.ports import ModesRequest, ModesResult
from ringtrue.model.references import unused

CONSTRAINTS = {"SPC": ("SPCADD", ("SPC", "SPC1")), "MPC": ("MPCADD", ("MPC",))}


def taken_sets(model: Model, kind: str) -> Int:
    """Ids of the SPC or MPC sets that hold: the one that case control names, or those that an
    SPCADD or MPCADD of that number unites, which goes before a set of its own number.
    """
    add = CONSTRAINTS[kind][0]
    sid = int(getattr(model.case, kind.lower()))
    united = [np.array([sid] if sid else [], dtype=np.int64)]
    if add in model and sid in model[add]["SID"]:
        rows = np.flatnonzero(model[add]["SID"] == sid)
        united = [model[add].ragged("S").row(i) for i in rows.tolist()]
    return np.unique(np.concatenate(united))


def untaken_matrices(model: Model) -> Int:
    """Rows of DMIG that no K2GG, M2GG or B2GG takes, and no K2PP, M2PP or B2PP."""
    if "DMIG" not in model:
        return np.empty(0, dtype=np.int64)
    case = model.case
    terms = (*case.k2gg, *case.m2gg, *case.b2gg, *case.k2pp, *case.m2pp, *case.b2pp)
    taken = [name for _, name in terms]
    return np.flatnonzero(
        ~np.isin(np.char.upper(model["DMIG"]["NAME"].astype(str)), taken)
    )


def left_out(model: Model) -> list[str]:
    """What a deck asks for that none of the answers holds."""
    instead = "K2GG, M2GG and B2GG act on the modes"
    out = [
        f"case control asks for {command}: it is left out; {instead}"
        for command in model.case.unread
    ]
    if cyclic := [card for card in ("CYAX", "CYJOIN", "CYSYM") if card in model.kept]:
        modes = "the modes are those of this segment alone, not of the whole; give all segments"
        out.append(f"{', '.join(cyclic)}: kept, not applied: {modes}")
    return out


def responding(model: Model) -> Model:
    """The model as it responds: K2PP, M2PP and B2PP are added to stiffness, mass and damping (SOL
    108 and 111), and extra points to the scalar points.

    Raises
    ------
    UnsupportedError
        If PARAM CK2, CM2 or CB2 scale K2GG and its like, but not these, or an extra point has mass
        or damping without stiffness.
    """
    case = model.case
    for scale, more in (("CK2", case.k2pp), ("CM2", case.m2pp), ("CB2", case.b2pp)):
        if more and model.param(scale, 1.0) != 1:
            raise UnsupportedError(
                f"PARAM,{scale} with {scale[1]}2PP: give the factor in case control, as in 1.5*KA"
            )
    model = _with_extra_points(model)
    k = (*case.k2gg, *case.k2pp)
    m = (*case.m2gg, *case.m2pp)
    b = (*case.b2gg, *case.b2pp)
    return replace(
        model,
        case=replace(
            case,
            k2gg=k,
            m2gg=m,
            b2gg=b,
            k2pp=(),
            m2pp=(),
            b2pp=(),
        ),
    )


def _with_extra_points(model: Model) -> Model:
    """EPOINT as SPOINT, of which AUTOSPC would hold those without stiffness."""
    if "EPOINT" not in model:
        return model
    extra = model["EPOINT"]
    points = extra.entries("ID")[0]
    case = model.case
    stiffened = _named_by(model, case.k2pp)
    loose = np.intersect1d(points, _named_by(model, (*case.m2pp, *case.b2pp)))
    loose = np.setdiff1d(loose, stiffened)
    if loose.size:
        raise UnsupportedError(
            f"EPOINT {loose[0]} has mass or damping by M2PP or B2PP and no stiffness by K2PP: give "
            "it one"
        )
    tables = {name: t for name, t in model.tables.items() if name != "EPOINT"}
    made = replace(extra, card="SPOINT")
    tables["SPOINT"] = stacked(tables["SPOINT"], made) if "SPOINT" in tables else made
    return replace(model, tables=tables)


def _named_by(model: Model, terms: tuple[tuple[float, str], ...]) -> Int:
    """The points that chosen matrices name, (n,) int64."""
    if "DMIG" not in model or not terms:
        return np.empty(0, dtype=np.int64)
    table = model["DMIG"]
    names = np.char.upper(table["NAME"].astype(str))
    taken = np.isin(names, [name for _, name in terms])
    return np.unique(
        np.concatenate(
            [ids[taken[row]] for ids, row in map(table.entries, ("GJ", "GI"))]
        )
    )


def idle(model: Model) -> dict[str, Int]:
    """Rows, by card, that take no part, whatever they name: Nastran leaves them alone, too.

    Properties and materials that nothing names, constraints of sets and matrices that case control
    does not take.
    """
    out = unused(model) | {"DMIG": untaken_matrices(model)}
    for kind, (_, cards) in CONSTRAINTS.items():
        taken = taken_sets(model, kind)
        for card in (c for c in cards if c in model):
            out[card] = np.flatnonzero(~np.isin(model[card]["SID"], taken))
    return {card: rows for card, rows in out.items() if rows.size}


METHODS = {
    "EIGRL": ("V1", "V2"),
    "EIGRA": ("V1", "V2"),
    "EIGR": ("F1", "F2"),
}  # and their limits, Hz
# of EIGR: their F1 and F2 count only where ND is blank (MSC Nastran Quick Reference Guide, EIGR)
_BY_COUNT = frozenset(("GIV", "MGIV", "AGIV", "HOU", "MHOU", "AHOU"))


@dataclass(frozen=True, slots=True)
class AskedModes:
    """The lowest `count` modes (0: all) of those between `low` and `high`, Hz; -inf and inf where
    open.
    """

    low: float
    high: float
    count: int

    def of(self, solve: Callable[[ModesRequest], ModesResult]) -> ModesResult:
        """The modes of a solution; it is asked for more until they are enough or pass the upper
        limit.
        """
        if not self.count:
            return solve(ModesRequest(band=(max(self.low, -1.0), self.high)))
        wanted = self.count
        if np.isfinite(self.high):  # few of the modes that are asked for may lie below
            wanted = min(wanted, 40)
        while True:
            found = solve(ModesRequest(wanted))
            f = found.modes.frequencies
            at = np.flatnonzero((f >= self.low) & (f <= self.high))[: self.count]
            if at.size == self.count or (f > self.high).any() or f.size < wanted:
                return replace(
                    found, modes=found.modes.take(at), residuals=found.residuals[at]
                )
            wanted = min(2 * wanted, wanted + self.count - at.size)


def asked_modes(model: Model) -> AskedModes | None:
    """By the method that case control names, or the only one of a deck that names none; None where
    none asks.
    """
    rows = [
        (card, i) for card in METHODS if card in model for i in range(len(model[card]))
    ]
    if model.case.method:
        rows = [
            (card, i) for card, i in rows if model[card].ids[i] == model.case.method
        ]
    if len(rows) != 1:
        return None
    card, i = rows[0]
    table = model[card]
    count = int(table["ND"][i])
    low, high = (float(table[name][i]) for name in METHODS[card])
    if card == "EIGR" and count > 0 and str(table["METHOD"][i]).upper() in _BY_COUNT:
        low = np.nan
        high = np.nan
    if not low > 0:
        low = -np.inf
    if np.isnan(high):
        high = np.inf
    asks = count > 0 or max(low, 0.0) < high < np.inf
    return AskedModes(low, high, count) if asks else None


@dataclass(frozen=True, slots=True, eq=False)
class ModalDamping(FrozenArrays):
    """Damping ratios of modes by their frequencies.

    Attributes
    ----------
    frequencies : (k,) float64, Hz, ascending
    ratios : (k,) float64, fraction of critical
    flat : bool
        Beyond the ends the last ratio holds; else the line through the last two points goes on.
    structural : bool
        Twice the ratio is a loss factor (PARAM,KDAMP,-1); else the damping is viscous.
    """

    frequencies: Float
    ratios: Float
    flat: bool = False
    structural: bool = False

    def at(self, frequencies: Float) -> Float:
        """Ratios (m,) of modes of these frequencies (m,), Hz."""
        f = self.frequencies
        z = self.ratios
        out = np.interp(frequencies, f, z)
        if not self.flat and f.size > 1:
            for beyond, (a, b) in (
                (frequencies < f[0], (0, 1)),
                (frequencies > f[-1], (-2, -1)),
            ):
                slope = (z[b] - z[a]) / (f[b] - f[a]) if f[b] > f[a] else 0.0
                out = np.where(beyond, z[b] + slope * (frequencies - f[b]), out)
        return out


KEPT = ("ASET", "ASET1")
OMITTED = ("OMIT", "OMIT1")
MODAL = ("QSET", "QSET1")


def listed_dofs(model: Model, cards: tuple[str, ...]) -> DofSet:
    """The DOFs that cards such as ASET and ASET1 list, each once; 0 is a scalar point.

    >>> from ringtrue.model.model import table
    >>> listed_dofs(Model({"ASET": table("ASET", ID=[6, 7], C=["26", "0"])}), KEPT).labels()
    ('6+Y', '6+RZ', '7')
    """
    pairs: dict[tuple[int, int], None] = {}
    for card in (c for c in cards if c in model):
        nodes, row = model[card].entries("ID")
        components = model[card]["C"][row]
        for node, text in zip(nodes.tolist(), components.tolist(), strict=True):
            pairs |= {(node, int(c)): None for c in text or "0"}
    node, direction = np.array(list(pairs), dtype=np.int64).reshape(-1, 2).T
    return DofSet(node, direction)


def condenses(model: Model) -> bool:
    """Whether Nastran's modes of the deck are those of a condensed model."""
    listed = any(card in model for card in (*KEPT, *OMITTED, *MODAL))
    return listed or bool("GRID" in model and (model["GRID"]["SEID"] > 0).any())


def whole_mesh(model: Model) -> Model:
    """The model without what condenses it: its modes are those of the whole mesh.

    Studies take it: a condensation is an approximation, and its error would go into the parameters.
    """
    if not condenses(model):
        return model
    tables = {
        n: t for n, t in model.tables.items() if n not in (*KEPT, *OMITTED, *MODAL)
    }
    if "GRID" in tables:
        grid = tables["GRID"]
        tables["GRID"] = grid.with_column("SEID", np.zeros_like(grid["SEID"]))
    return replace(model, tables=tables)


def component_modes(model: Model) -> ComponentModes:
    """Those that METHOD of a component asks for, on the coordinates of its QSET."""
    modal = listed_dofs(model, MODAL)
    asked = asked_modes(model)
    if asked is None:
        return ComponentModes(modal, len(modal))
    return ComponentModes(modal, min(len(modal), asked.count or len(modal)), asked.high)
