"""Candidate parameters by region: the stiffness of each connected part of a property, and of pieces
of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Float, Int
from ringtrue.core.parameters import CardField, Substructure
from ringtrue.fem.element_cards import MATERIAL, PROPERTY
from ringtrue.fem.parametrisation.changed_model import affected_cards
from ringtrue.model.frames import positions
from ringtrue.model.model import Model
from ringtrue.model.references import REFERENCES, SHELL_PROPERTIES
from ringtrue.updating.candidates import Candidate, CandidateSettings, given_fields, new_candidate

_AIDS = ("G0", "SA", "SB")  # name a node, but do not stand on it
_NODE_FIELDS = {
    card: tuple(
        r.field for r in REFERENCES if r.card == card and "GRID" in r.of and r.field not in _AIDS
    )
    for card in PROPERTY
}


def regions(model: Model, s: CandidateSettings) -> Iterator[Candidate]:
    """The stiffness of each connected part of a property, and of pieces of it."""
    structural = (
        "CROD",
        "CTUBE",
        "CBAR",
        "CBEAM",
        *[c for c in affected_cards(model) if _is_continuum(c)],
    )
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
                yield _region(
                    model,
                    s,
                    f"{_property(model, key)} {key[1]}{label}",
                    eid[at],
                    centre[at].mean(axis=0),
                )


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
    made = sparse.coo_array(
        (np.ones(int(keep.sum())), (at[0][keep], at[1][keep])), shape=(first, len(grid))
    )
    return sparse.csr_array(made)


def _islands(nodes: sparse.csr_array) -> list[Int]:
    """Elements that hang together, in the order of their first."""
    _, label = sparse.csgraph.connected_components(
        sparse.csr_array(nodes @ nodes.T), directed=False
    )
    return [np.flatnonzero(label == k) for k in range(int(label.max(initial=-1)) + 1)]


def _cut(centre: Float, pieces: int) -> list[Int]:
    """Cut points (e, 3) again and again across their longest axis into parts of about equal
    number.
    """
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


def _region(
    model: Model, s: CandidateSettings, label: str, elements: Int, centre: Float
) -> Candidate:
    """Young's modulus as these elements see it; a factor on their stiffness where they are not
    isotropic.
    """
    place = ", ".join(f"{x:.3g}" for x in centre.tolist())
    what = f"stiffness of {elements.size} elements around ({place}) {s.unit('length')}".strip()
    ids = tuple(np.unique(elements).tolist())
    targets = []
    for mid in _isotropic(model, elements):
        row = int(model["MAT1"].find(np.array([mid]))[0])
        targets += [CardField("MAT1", mid, f, ids) for f in given_fields(model["MAT1"], row, "E+G")]
    if targets:
        return new_candidate(s, "region", f"{label} E", what, "modulus", elements, targets)
    return new_candidate(
        s, "region", f"{label} K", what, "modulus", elements, (), [Substructure("stiffness", ids)]
    )


def _isotropic(model: Model, elements: Int) -> list[int]:
    """The MAT1 of the elements; none if one of them has another material."""
    found: set[int] = set()
    for card in affected_cards(model):
        pid = (
            model[card]["PID"][np.isin(model[card].ids, elements)]
            if "PID" in model[card].columns
            else np.zeros(0)
        )
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
