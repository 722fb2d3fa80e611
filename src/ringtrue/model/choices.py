"""What case control takes of the sets and matrices of a deck, and what of the deck takes no
part.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ringtrue.core.arrays import Int
from ringtrue.errors import UnsupportedError
from ringtrue.model.model import Model
from ringtrue.model.references import unused

CONSTRAINTS = {"SPC": ("SPCADD", ("SPC", "SPC1")), "MPC": ("MPCADD", ("MPC",))}


def taken_sets(model: Model, kind: str) -> Int:
    """Ids of the SPC or MPC sets that hold: the one that case control names, or those that an
    SPCADD or MPCADD of that number unites, which goes before a set of its own number.
    """
    add, sid = CONSTRAINTS[kind][0], int(getattr(model.case, kind.lower()))
    rows = np.flatnonzero(model[add]["SID"] == sid) if add in model else np.empty(0, dtype=np.int64)
    united = [model[add].ragged("S").row(i) for i in rows.tolist()]
    return np.unique(
        np.concatenate(united) if united else [sid] if sid else np.empty(0, dtype=np.int64)
    )


def untaken_matrices(model: Model) -> Int:
    """Rows of DMIG that no K2GG, M2GG or B2GG takes, and no K2PP, M2PP or B2PP."""
    if "DMIG" not in model:
        return np.empty(0, dtype=np.int64)
    case = model.case
    terms = (*case.k2gg, *case.m2gg, *case.b2gg, *case.k2pp, *case.m2pp, *case.b2pp)
    taken = [name for _, name in terms]
    return np.flatnonzero(~np.isin(np.char.upper(model["DMIG"]["NAME"].astype(str)), taken))


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
    108 and 111).

    Raises
    ------
    UnsupportedError
        If PARAM CK2, CM2 or CB2 scale K2GG and its like, but not these.
    """
    case = model.case
    for scale, more in (("CK2", case.k2pp), ("CM2", case.m2pp), ("CB2", case.b2pp)):
        if more and model.param(scale, 1.0) != 1:
            raise UnsupportedError(
                f"PARAM,{scale} beside {scale[1]}2PP: give the factor in case control, as in 1.5*KA"
            )
    k, m, b = (*case.k2gg, *case.k2pp), (*case.m2gg, *case.m2pp), (*case.b2gg, *case.b2pp)
    return replace(model, case=replace(case, k2gg=k, m2gg=m, b2gg=b, k2pp=(), m2pp=(), b2pp=()))


def idle(model: Model) -> dict[str, Int]:
    """Rows, by card, that take no part, whatever they name: Nastran leaves them alone, too.

    Properties and materials that nothing names, constraints of sets and matrices that case control
    does not take.
    """
    out = {
        card: rows
        for card, rows in (*unused(model).items(), ("DMIG", untaken_matrices(model)))
        if rows.size
    }
    for kind, (_, cards) in CONSTRAINTS.items():
        for card in (c for c in cards if c in model):
            if (rows := np.flatnonzero(~np.isin(model[card]["SID"], taken_sets(model, kind)))).size:
                out[card] = rows
    return out
