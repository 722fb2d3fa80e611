"""Which candidates are looked at closely, and which of them cannot move together."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.core.parameters import Parameter
from ringtrue.fem.assembly import System
from ringtrue.fem.change import rows_of, within
from ringtrue.fem.dependence import form, together
from ringtrue.fem.rows import union
from ringtrue.model.model import Model
from ringtrue.update.candidates import Candidate, Kind, counted, membership

KIND: dict[str, Kind] = {
    **dict.fromkeys(("MAT1", "MAT2", "MAT8", "MAT9"), "material"),
    **dict.fromkeys(("PBUSH", "PBUSH1D", "PFAST", "PGAP", "PELAS", "CELAS2", "CELAS4"), "spring"),
    **dict.fromkeys(("CONM2", "PMASS", "CMASS2", "CMASS4"), "mass"),
}
MASS_ONLY = {"RHO", "NSM", "NSMB", "M", "I11", "I21", "I22", "I31", "I32", "I33"}
BOTH = re.compile(r"T\d*|A|AB|OD")


def screened(slopes: Float, most: int) -> Int:
    """The candidates that are looked at closely, in the order of what each adds to those before.

    Greedy on ln det(I + GᵀG), the information of the data over that of the prior: one that acts like others already
    chosen adds little, however large its effect. Those without effect are left out.

    Parameters
    ----------
    slopes : (n, p) float64
        Weighted, in units of the prior: of the frequencies alone, which cost no solution.
    """
    g, out = np.asarray(slopes, dtype=np.float64), list[int]()
    inverse = np.eye(g.shape[0])
    for _ in range(min(most, g.shape[1])):
        spread = inverse @ g
        gain = np.einsum("np,np->p", g, spread)
        gain[out] = -1.0
        best = int(np.argmax(np.round(gain, 12)))
        if gain[best] <= 0:
            break
        out.append(best)
        inverse = inverse - np.outer(spread[:, best], spread[:, best]) / (1 + gain[best])
    return np.array(out, dtype=np.int64)


def tractable(model: Model, system: System, candidates: Sequence[Candidate]) -> Int:
    """Those whose matrices can be taken apart, in order, without those of which that is too much work.

    Of those that are no powers two may do something together on an element, in a coarse series, but no three: the
    constants of a laminate would have no end.
    """
    members, out = membership(model, candidates), list[int]()
    near, met = (members @ members.T).toarray() > 0, dict[int, set[int]]()
    for i, c in enumerate(candidates):
        how = form(model, c.parameter, system)
        if how == "rough":
            continue
        if how == "series":
            kinds = {j: together(model, candidates[j].parameter, c.parameter) for j in met if near[i, j]}
            mine = {j for j, kind in kinds.items() if kind}
            if "fine" in kinds.values() or any(met[j] & mine for j in mine):
                continue
            met[i] = mine
            for j in mine:
                met[j].add(i)
        out.append(i)
    return np.array(out, dtype=np.int64)


def of_parameter(model: Model, parameter: Parameter) -> Candidate:
    """A parameter that was given as a candidate: its elements and, in words, what it changes."""
    rows = union(within(model, rows_of(model, t), t.elements) for t in parameter.targets)
    ids = [i for card, at in rows.items() for i in model[card].ids[at].tolist()]
    ids += [i for s in parameter.substructures for i in s.elements]
    elements = tuple(sorted(set(ids)))
    fields: dict[str, list[str]] = {}
    for t in parameter.targets:
        fields.setdefault(f"{t.card} {t.id}", []).append(t.field)
    named = ", ".join(f"{card} {','.join(f)}" for card, f in fields.items())
    what = f"{named} of {counted(rows)}" if rows else f"matrices of {len(elements)} elements"
    kind = KIND.get(parameter.targets[0].card, "property") if parameter.targets else "region"
    return Candidate(parameter, kind, what, elements)


def conflicts(model: Model, candidates: Sequence[Candidate]) -> Bool:
    """Pairs (p, p) that modes hardly tell apart: both scale the same field, or a product.

    A material and a section of one element make a product where both touch its stiffness, or both its mass.
    """
    members = membership(model, candidates)
    overlap = (members @ members.T).toarray() > 0
    fields = [{t.field for t in c.parameter.targets} for c in candidates]
    family = [{t.card.startswith("MAT") for t in c.parameter.targets} for c in candidates]
    mass = [any(f in MASS_ONLY or BOTH.fullmatch(f) for f in fs) for fs in fields]
    stiff = [any(f not in MASS_ONLY for f in fs) or not fs for fs in fields]
    out = np.zeros(overlap.shape, dtype=np.bool_)
    for i, j in np.argwhere(np.triu(overlap, 1)).tolist():  # over candidates, not elements
        product = (mass[i] and mass[j]) or (stiff[i] and stiff[j])
        same = bool(fields[i]) and bool(fields[j]) and family[i] == family[j]
        out[i, j] = out[j, i] = bool(fields[i] & fields[j]) if same else product
    return out
