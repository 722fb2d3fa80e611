"""Missing members as cards: a brace as CBAR, a joint or support as CBUSH."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.decks.nastran.writer import Value, format_card
from ringtrue.errors import InputError
from ringtrue.fem.element_cards import MATERIAL, PROPERTY
from ringtrue.model.frames import positions
from ringtrue.model.model import Model
from ringtrue.updating.selection.member_pairs import AXIAL, LINES
from ringtrue.updating.selection.missing_members import MissingMember


def member_cards(model: Model, members: Sequence[MissingMember], unit: str = "") -> str:
    """A file of cards for `[[remodel]]`: the first member; the others, each of which may stand in
    its place, as comments.

    A brace has the material of a member at its ends, the area of its stiffness, and hinges. It is
    a square bar: area A, second moments A²/12.

    Parameters
    ----------
    model : Model
        The deck.
    members : sequence of MissingMember
        The first first.
    unit : str
        Of a stiffness, for the comments.

    Raises
    ------
    InputError
        If there is no member, or no member of the deck has an isotropic material for a brace.
    """
    if not members:
        raise InputError("no missing member is proposed: there are no cards to write")
    tables = model.tables.values()
    number = 1 + max(int(t.ids.max(initial=0)) for t in tables if t.card.startswith(("C", "P")))
    parts = []
    for rank, member in enumerate(members, start=1):
        made = _cards(model, member, number)
        number += len(member.nodes) + 1
        head = (
            f"$ {rank}. {member.name}, {member.stiffness:.3g} +- {member.std:.1g} {unit}".rstrip()
        )
        head += f", explains {100 * member.share:.0f} %, worth {member.worth:.1f} (AICc)\n"
        if rank > 1:
            made = "".join(f"$ {line}\n" for line in made.splitlines())
        parts.append(head + made)
    return "".join(parts)


def _cards(model: Model, member: MissingMember, number: int) -> str:
    """The property, then an element for each of the like members."""
    if member.form == "brace":
        return _bars(model, member, number)
    along, about = member.stiffness, member.stiffness * member.arm**2
    named = "1" if member.components == AXIAL else member.components
    held: list[Value] = [
        (along if k <= 3 else about) if str(k) in named else None for k in range(1, 7)
    ]
    frame = None if member.components == AXIAL else 0
    out = format_card("PBUSH", [number, "K", *held])
    for eid, (a, b) in enumerate(member.nodes, start=number + 1):
        out += format_card("CBUSH", [eid, number, a, b or None, None, None, None, frame])
    return out


def _bars(model: Model, member: MissingMember, number: int) -> str:
    """Of one area, between hinges."""
    grid = model["GRID"]
    ends = positions(model)[grid.find(np.array(member.nodes).ravel())].reshape(-1, 2, 3)
    line = ends[:, 1] - ends[:, 0]
    mid = _material(model, member)
    table = model["MAT1"]
    modulus = float(table["E"][table.find(np.array([mid]))[0]])
    area = member.stiffness * float(np.linalg.norm(line[0])) / modulus
    inertia = area**2 / 12
    out = format_card("PBAR", [number, mid, area, inertia, inertia, 2 * inertia])
    for k, (a, b) in enumerate(member.nodes):
        ends_and_plane = [a, b, *_beside(line[k])]
        pins = [None, 56, 56]
        out += format_card("CBAR", [number + 1 + k, number, *ends_and_plane, *pins])
    return out


def _beside(along: Float) -> list[Value]:
    """The basic axis that is least along a line: the bar is square, any will do."""
    return [float(k == int(np.argmin(np.abs(along)))) for k in range(3)]


def _material(model: Model, member: MissingMember) -> int:
    """The MAT1 of a line element at the first node, or at any of the nodes."""
    for node in (n for pair in member.nodes for n in pair):
        for card in (c for c in LINES if c in model):
            table = model[card]
            first, second = ("G1", "G2") if "G1" in table.columns else ("GA", "GB")
            for row in np.flatnonzero((table[first] == node) | (table[second] == node)).tolist():
                if "MID" in table.columns:
                    mid = int(table["MID"][row])
                else:
                    held = model[PROPERTY[card]]
                    at = held.find(table["PID"][[row]])
                    mid = int(held[MATERIAL[held.card][0]][at[0]])
                if "MAT1" in model and mid in model["MAT1"].ids:
                    return mid
    raise InputError(f"{member.name}: no line element at its nodes has a MAT1")
