"""Where on a card a named field stands."""

from __future__ import annotations

from collections.abc import Sequence

from ringtrue.decks.nastran.added_mass import VALUE
from ringtrue.decks.nastran.beams import BETWEEN, beam_stations, bend_places, dimension_place
from ringtrue.decks.nastran.fields import Card, Reader
from ringtrue.decks.nastran.lists import BUSH, PLY, ply_places
from ringtrue.errors import InputError
from ringtrue.model.cards import CARDS, columns
from ringtrue.model.dimensions import END_A, END_B, MADE
from ringtrue.model.edit import ply_field

_SEVERAL = {
    **dict.fromkeys(("CORD1R", "CORD1C", "CORD1S"), ("G1", "G2", "G3")),
    "PELAS": ("K", "GE", "S"),
    "PMASS": ("M",),
    "PDAMP": ("B",),
    "PVISC": ("CE", "CR", ""),
}
_BEAM = (
    "K1",
    "K2",
    "S1",
    "S2",
    "NSIA",
    "NSIB",
    "CWA",
    "CWB",
    "M1A",
    "M2A",
    "M1B",
    "M2B",
    "N1A",
    "N2A",
    "N1B",
    "N2B",
)


def field_place(name: str, fields: Sequence[str], id: int, field: str) -> int | None:
    """Number (from 0) of a data field of a card with the data fields `fields`; None where it has no
    place.

    Raises
    ------
    InputError
        If the field is no single field of that card.
    """
    if name in _SEVERAL:
        return _of_several(name, fields, id, field)
    if name in VALUE and field == "VALUE":
        return VALUE[name]
    if name in CARDS:
        return _by_schema(name, field)
    if name in PLY:
        return _of_laminate(name, fields, field)
    if name in MADE:
        return dimension_place(fields, field)
    if field in ("PID", "MID"):
        return ("PID", "MID").index(field)
    if name == "PBUSH":
        return _of_bush(fields, field)
    if name == "PBEND":
        return bend_places(fields).get(field)
    if name == "PBEAM":
        return _of_beam(fields, field)
    raise InputError(f"fields of {name} cannot be changed in place")


def _by_schema(name: str, field: str) -> int:
    for i, spec in enumerate(columns(name)):
        if field in (spec.name, spec.other) and not spec.tail and not spec.blank:
            return i
    raise InputError(f"{name} field {field} cannot be changed in place")


def _of_several(name: str, fields: Sequence[str], id: int, field: str) -> int | None:
    names = ("PID", *_SEVERAL[name])
    starts = range(0, len(fields), len(names))
    return next((i + names.index(field) for i in starts if fields[i] == str(id)), None)


def _of_laminate(name: str, fields: Sequence[str], field: str) -> int | None:
    head = [s.name for s in columns(name) if not s.tail]
    if field in head:
        return head.index(field)
    key, number = ply_field(field) or ("", 0)
    plies = ply_places(name, fields)
    return (
        plies[number - 1] + PLY[name].index(key)
        if key in PLY[name] and 1 <= number <= len(plies)
        else None
    )


def inherited(name: str, fields: Sequence[str], field: str) -> tuple[int, str] | None:
    """The blank field of the next ply that takes its MID or T from this one: its place, and the
    text it stands for.
    """
    key, number = ply_field(field) or ("", 0)
    if name not in PLY or key not in ("MID", "T"):
        return None
    places = [i + PLY[name].index(key) for i in ply_places(name, fields)]
    if not 1 <= number < len(places) or fields[places[number]]:
        return None
    return places[number], next((fields[i] for i in reversed(places[:number]) if fields[i]), "")


def bush_flag(field: str) -> str:
    """K, B, GE, ...: what the line of a PBUSH begins with that holds the field."""
    return next(flag for flag, names in BUSH.items() if field in names)


def _of_bush(fields: Sequence[str], field: str) -> int | None:
    flag = bush_flag(field)
    at = next((i for i in range(1, len(fields), 8) if fields[i] == flag), None)
    return None if at is None else at + 1 + BUSH[flag].index(field)


def _of_beam(fields: Sequence[str], field: str) -> int | None:
    if field in END_A:
        return 2 + END_A.index(field)
    stations, behind = beam_stations(Reader(Card("PBEAM", list(fields), 0, 0), ("",)))
    if field in END_B:
        return next((p + END_B.index(field) for x, p in stations if x == 1.0), None)
    key, number = ply_field(field) or ("", 0)
    if key in ("X", *BETWEEN):
        between = [p for x, p in stations if x < 1.0]
        return (
            between[number - 1] + ("X", *BETWEEN).index(key) - 1
            if 1 <= number <= len(between)
            else None
        )
    return behind + _BEAM.index(field)
