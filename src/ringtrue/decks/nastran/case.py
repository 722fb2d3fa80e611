"""Case control: which sets of constraints, loads and methods a deck chooses."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ringtrue.decks.nastran.lexer import real, whole
from ringtrue.errors import DeckError
from ringtrue.model.cards import PRELOADS
from ringtrue.model.case_control import CONSTRAINTS, METHODS
from ringtrue.model.model import CaseControl, Model, Table

# a blank may stand for =
_COMMAND = re.compile(
    r"\s*([A-Z]\w*)\s*(\([^)]*\))?(?:\s*=\s*|\s+)(.*?)\s*", re.I | re.S
)
_SUBCASE = re.compile(r"\s*SUBC\w*[\s=]*(\d{1,9})?", re.I)
_CHOICES = ("TITLE", "METHOD", "SPC", "MPC", "NSM", "AUTOSPC", "SDAMPING")
_SETS = ("SPC", "MPC", "NSM", "K2GG", "M2GG", "B2GG")


# commands that bring in stiffness which is not read, and how the names of their cards begin
STIFFENING = {
    "TEMPERATURE": ("MATT",),
    "BGSET": ("BGSET", "BGADD"),
    "BCSET": ("BCTSET", "BCTADD"),
    "BCONTACT": ("BCBODY", "BCTABL"),
    **dict.fromkeys(
        ("STATSUB", "NLIC"), (*PRELOADS, "BOLTFOR", "BOLTFRC", "PRETENS", "SPCR")
    ),
}
# modes and responses under load, by Autodesk
_PRESTRESS = re.compile(r"\s*SOL[\s=]+(18[2-9]|.*PRESTRESS)", re.I)
_MATRICES = ("K2GG", "M2GG", "B2GG", "K2PP", "M2PP", "B2PP")
_UNREAD = ("K42GG", "A2GG", "TFL")  # matrices of other solutions
_LOADING = ("TEMP(LOAD)", "DEFORM", "P2G")  # what else acts in statics, and is not read
_NAMES = (*_CHOICES, *_MATRICES, *STIFFENING, *_UNREAD, *_LOADING, "LOAD")
_SHORT = {
    "METH": "METHOD",
    "TITL": "TITLE",
    "AUTO": "AUTOSPC",
    "TEMP": "TEMPERATURE",
    "STAT": "STATSUB",
    "SDAM": "SDAMPING",
}  # Nastran reads the first four characters
_TEXT = re.compile(r"\s*(TITL|SUBT|LABE)", re.I)
_TERM = re.compile(r"(?:\(?\s*([^*()\s]+?)\s*\)?\s*\*)?\s*([A-Z]\w*)", re.I)


def commands(top: Sequence[str]) -> dict[str, str]:
    """The choices that hold in the first subcase with a METHOD, else in the first subcase.

    Parameters
    ----------
    top : sequence of str
        Executive and case control lines.
    """
    common, *subcases = (choices for _, choices in _sections(top))
    chosen = next(
        (s for s in subcases if "METHOD" in s), subcases[0] if subcases else {}
    )
    return {**common, **chosen}


_SUPER = re.compile(r"\s*SUPER\s*=?\s*(.+?)\s*", re.I)
_SET = re.compile(r"\s*SET\s+(\d+)\s*=\s*(.+?)\s*", re.I)


def of_superelement(top: Sequence[str], number: int) -> tuple[str, ...]:
    """The lines that hold for one superelement, 0 for the residual structure: those above all
    subcases, and of the subcases those whose SUPER names it, or that have none.

    >>> top = ["CEND", "SUBCASE 1", "SUPER = 1", "METHOD = 10", "SUBCASE 2", "METHOD = 1"]
    >>> of_superelement(top, 2)
    ('CEND', 'SUBCASE 2', 'METHOD = 1')
    """
    blocks: list[list[str]] = [[]]
    sets: dict[str, str] = {}
    for line in _joined(top):
        if _SUBCASE.match(line):
            blocks.append([])
        if found := _SET.fullmatch(line):
            sets[found[1]] = found[2].upper()
        blocks[-1].append(line)
    kept = list(blocks[0])
    for block in blocks[1:]:
        named = [found[1] for line in block if (found := _SUPER.fullmatch(line))]
        if not named or _names(named[-1].upper(), sets, number):
            kept += block
    return tuple(line for line in kept if not _SUPER.fullmatch(line))


def _names(text: str, sets: Mapping[str, str], number: int) -> bool:
    """Whether SUPER = `text` names a superelement: ALL, its number or a set of numbers."""
    which = text.split(",")[0].strip()
    listed = sets.get(which, which)
    if listed == "ALL":
        return True
    ranges = re.findall(r"(\d+)(?:\s+THRU\s+(\d+))?", listed)
    return any(int(a) <= number <= int(b or a) for a, b in ranges)


def stiffening(top: Sequence[str]) -> tuple[str, ...]:
    """How the names of cards begin that carry stiffness because case control chooses them: glue,
    contact, MATT1.
    """
    chosen = set(commands(top)) | (
        {"STATSUB"} if any(_PRESTRESS.match(line) for line in top) else set()
    )
    return tuple(
        start
        for command, names in STIFFENING.items()
        if command in chosen
        for start in names
    )


def _sections(top: Sequence[str]) -> list[tuple[int, dict[str, str]]]:
    """The choices above all subcases, under 0, and those of each subcase with its number."""
    begun = not any(re.match(r"\s*CEND\b", line, re.I) for line in top)
    sections: list[tuple[int, dict[str, str]]] = [(0, {})]
    for line in _joined(top):
        begun = begun or bool(re.match(r"\s*CEND\b", line, re.I))
        if begun and (subcase := _SUBCASE.match(line)):
            sections.append((int(subcase[1] or 0), {}))
        found = _COMMAND.fullmatch(line)
        name = found[1].upper() if found else ""
        name = _SHORT.get(name[:4], name)
        if begun and found and name in _NAMES and (found[2] or "").upper() != "(FLUID)":
            sections[-1][1][name] = found[3]
            if name == "TEMPERATURE" and (
                kind := re.match(r"\(?\s*(MAT|INIT|)", (found[2] or "").upper())
            ):
                of = {"MAT": "TEMP(MAT)", "INIT": "TEMP(INIT)"}.get(
                    kind[1], "TEMP(LOAD)"
                )
                sections[-1][1][of] = found[3]
    return sections


def _not_taken(top: Sequence[str], found: Mapping[str, str]) -> tuple[int, ...]:
    """Further subcases that compute modes, of other sets."""
    (_, common), *subcases = _sections(top)
    every = [(number, {**common, **choices}) for number, choices in subcases]
    return tuple(
        n
        for n, c in every
        if "METHOD" in c and any(c.get(k) != found.get(k) for k in _SETS)
    )


def load_sets(top: Sequence[str]) -> list[tuple[str, int]]:
    """Names of the subcases with a LOAD, and the numbers of their sets.

    Raises
    ------
    DeckError
        If one is no number, or a subcase has other sets of SPC or MPC than those that count for
        modes, or acts by temperatures, deformations and the like.
    """
    (_, common), *subcases = _sections(top)
    every = [(f"SUBCASE {n}", {**common, **choices}) for n, choices in subcases] or [
        ("LOAD", common)
    ]
    taken = commands(top)
    out = []
    for name, choices in every:
        if not {"LOAD", "TEMP(LOAD)"} & choices.keys():
            continue
        if any(choices.get(k) != taken.get(k) for k in _SETS):
            raise DeckError(
                f"{name} has other {', '.join(_SETS)} than the subcase that is taken; give it alone"
            )
        if other := next((k for k in _LOADING if k in choices), None):
            raise DeckError(
                f"{name} has {other} = {choices[other]}: of static loads those of LOAD are read"
            )
        text = choices["LOAD"]
        if not re.fullmatch(r"\d{1,18}", text, re.A):
            raise DeckError(
                f"LOAD = {text} in case control: it must be the number of a set"
            )
        out.append((name, int(text)))
    return out


def modal_damping_set(top: Sequence[str]) -> int:
    """The table of SDAMPING, 0 without.

    Raises
    ------
    DeckError
        If it is no number.
    """
    text = commands(top).get("SDAMPING", "0")
    if not re.fullmatch(r"\d{1,18}|NONE", text, re.A | re.I):
        raise DeckError(
            f"SDAMPING = {text} in case control: it must be the number of a TABDMP1"
        )
    return 0 if text.upper() == "NONE" else int(text)


def _joined(top: Iterable[str]) -> list[str]:
    """Commands without comments and those that SKIPON passes over; a line that ends in a comma goes
    on in the next.
    """
    out: list[str] = []
    skipped = False
    for raw in top:
        line = raw.split("$")[0].rstrip()
        if skip := re.match(r"\s*SKIP(ON|OFF)\b", line, re.I):
            skipped = skip[1].upper() == "ON"
        if skip or skipped:
            continue
        if out and out[-1].endswith(",") and not _TEXT.match(out[-1]):
            out[-1] += " " + line.strip()
        elif line:
            out.append(line)
    return out


def case_control(top: Sequence[str]) -> CaseControl:
    """The choices of the lines above BEGIN BULK.

    Raises
    ------
    DeckError
        If K2GG or its like names no matrices, or NSM, SPC or MPC no set.
    """
    found = commands(top)
    for kind in ("NSM", "SPC", "MPC"):
        if not re.fullmatch(r"\d{1,18}|NONE", found.get(kind, "0"), re.A | re.I):
            raise DeckError(
                f"{kind} = {found[kind]} in case control: it must be the number of a set"
            )
    number = {k: int(v) for k, v in found.items() if re.fullmatch(r"\d{1,18}", v, re.A)}
    return CaseControl(
        found.get("TITLE", ""),
        number.get("METHOD", 0),
        number.get("SPC", 0),
        number.get("MPC", 0),
        number.get("NSM", 0),
        **{name.lower(): _matrices(name, found) for name in _MATRICES},
        others=_not_taken(top, found),
        unread=tuple(f"{name} = {found[name]}" for name in _UNREAD if name in found),
    )


def _matrices(name: str, found: Mapping[str, str]) -> tuple[tuple[float, str], ...]:
    """`1.25*KA, KB` as factors and names."""
    made = []
    for part in found[name].split(",") if name in found else ():
        term = _TERM.fullmatch(part.strip())
        try:
            if term is None:
                raise ValueError(part)
            made.append((real(term[1] or "1."), term[2].upper()))
        except ValueError:
            raise DeckError(
                f"{name} = {found[name]}: allowed are names of DMIG matrices, as in 1.5*KA, KB"
            ) from None
    return tuple(made)


def params(top: Sequence[str]) -> dict[str, int | float | str]:
    """PARAM and AUTOSPC commands above BEGIN BULK; they go before those in the bulk data."""
    out: dict[str, int | float | str] = {}
    for line in _joined(top):
        parts = [p.strip() for p in line.split(",")]
        if parts[0].upper() == "PARAM" and len(parts) > 2 and parts[1]:
            out[parts[1].upper()] = value(parts[2].upper())
    auto = commands(top).get("AUTOSPC", "").upper()
    return out | ({"AUTOSPC": auto} if auto in ("YES", "NO") else {})


def value(text: str) -> int | float | str:
    """The value of a PARAM: an integer, a real or a word."""
    for read in (whole, real):
        try:
            return read(text)
        except ValueError:
            continue
    return text


def sets(tables: Mapping[str, Table], kind: str) -> list[int]:
    """Ids that case control may name, ascending."""
    add, own = CONSTRAINTS[kind]
    found = [tables[c].ids for c in (add, *own) if c in tables]
    return np.unique(np.concatenate(found)).tolist() if found else []


def only_sets(case: CaseControl, tables: Mapping[str, Table]) -> CaseControl:
    """The choice of a deck without case control: its only SPC and MPC set, or the one that unites
    others.
    """
    only = []
    for kind in ("SPC", "MPC"):
        add = CONSTRAINTS[kind][0]
        every = (
            np.unique(tables[add].ids).tolist() if add in tables else sets(tables, kind)
        )
        only.append(every[0] if len(every) == 1 else 0)
    return replace(case, spc=only[0], mpc=only[1])


def unclear_sets(model: Model, *, chosen: bool) -> list[DeckError]:
    """What is wrong with the choice of sets.

    Parameters
    ----------
    chosen : bool
        Whether the deck has case control.
    """
    out = []
    for kind in CONSTRAINTS:
        there = sets(model.tables, kind)
        asked = int(getattr(model.case, kind.lower()))
        names = ", ".join(map(str, there))
        where = model.files[0] if model.files else None
        if asked and there and asked not in there:
            out.append(
                DeckError(
                    f"case control asks for {kind} = {asked}; the deck has {names}",
                    path=where,
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
        out.append(
            f"METHOD = {model.case.method}: the deck has no EIGRL or EIGR of that number"
        )
    return out
