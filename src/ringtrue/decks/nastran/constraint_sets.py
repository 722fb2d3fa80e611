"""Which SPC and MPC sets hold: those of case control, or the only ones of a deck that has none."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ringtrue.errors import DeckError
from ringtrue.model.case_control import CONSTRAINTS, METHODS
from ringtrue.model.model import CaseControl, Model, Table


def sets(tables: Mapping[str, Table], kind: str) -> list[int]:
    """Ids that case control may name, ascending."""
    add, own = CONSTRAINTS[kind]
    found = [tables[c].ids for c in (add, *own) if c in tables]
    return np.unique(np.concatenate(found)).tolist() if found else []


def only_sets(case: CaseControl, tables: Mapping[str, Table]) -> CaseControl:
    """The choice of a deck without case control: its only SPC and MPC set, or the one that unites
    others.
    """
    return replace(case, spc=_only(tables, "SPC"), mpc=_only(tables, "MPC"))


def _only(tables: Mapping[str, Table], kind: str) -> int:
    add = CONSTRAINTS[kind][0]
    united: list[int] = np.unique(tables[add].ids).tolist() if add in tables else []
    every = united or sets(tables, kind)
    return every[0] if len(every) == 1 else 0


def unclear_sets(model: Model, *, chosen: bool) -> list[DeckError]:
    """What is wrong with the choice of sets.

    Parameters
    ----------
    chosen : bool
        Whether the deck has case control.
    """
    out = []
    for kind in CONSTRAINTS:
        there, asked = sets(model.tables, kind), int(getattr(model.case, kind.lower()))
        names = ", ".join(map(str, there))
        where = model.files[0] if model.files else None
        if asked and there and asked not in there:
            out.append(
                DeckError(
                    f"case control asks for {kind} = {asked}; the deck has {names}", path=where
                )
            )
        elif not asked and not chosen and there:
            why = (
                f"without case control, which of the {kind} sets {names} holds? Write {kind} = "
                "n above BEGIN BULK"
            )
            out.append(DeckError(why, path=where))
    return out


def empty_choices(model: Model) -> list[str]:
    """What case control chooses and the deck has none of: the structure is free of it, its modes
    are not limited.
    """
    chosen = {kind: int(getattr(model.case, kind.lower())) for kind in CONSTRAINTS}
    out = [
        f"{kind} = {n}: the deck has no {kind}"
        for kind, n in chosen.items()
        if n and not sets(model.tables, kind)
    ]
    methods = [i for card in METHODS if card in model for i in model[card].ids.tolist()]
    if model.case.method not in (0, *methods) and "EIGB" not in model.kept:
        out.append(f"METHOD = {model.case.method}: the deck has no EIGRL or EIGR of that number")
    return out
