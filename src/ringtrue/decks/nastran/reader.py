"""A Nastran deck to a `Model`: case control, parameters and one table a card."""

from __future__ import annotations

import logging
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ringtrue.core.arrays import Any_
from ringtrue.decks.nastran.beams import dimensions
from ringtrue.decks.nastran.cards import Cards, cards
from ringtrue.decks.nastran.case import (
    case_control,
    empty_choices,
    of_superelement,
    only_sets,
    params,
    stiffening,
    unclear_sets,
    value,
)
from ringtrue.decks.nastran.deck import Deck, load
from ringtrue.decks.nastran.external import op4_units
from ringtrue.decks.nastran.loads import LoadCase, PartCards, load_cases
from ringtrue.decks.nastran.parts import BulkSection, Numbers, joined
from ringtrue.decks.nastran.special import SPECIAL, special_table
from ringtrue.decks.nastran.tables import (
    DEFAULTS,
    empty,
    fault,
    fill,
    implied_points,
    make_table,
    modal_damping,
    open_bushes,
    refuse_magnitudes,
    refuse_parameter,
    written_out,
)
from ringtrue.errors import DeckError, UnsupportedCard
from ringtrue.model.cards import (
    CARDS,
    MADE,
    NONSTRUCTURAL,
    columns,
    is_unsupported,
    reason,
)
from ringtrue.model.case_control import ModalDamping, idle, left_out
from ringtrue.model.model import Model, Ragged, Table, stacked
from ringtrue.model.references import Missing, missing

log = logging.getLogger(__name__)
_SHARED_IDS = frozenset(  # several cards of one id belong together
    (
        *("SPC", "SPC1", "MPC", "SPOINT", "EPOINT", "SPCADD", "MPCADD", *NONSTRUCTURAL),
        *("ASET", "OMIT", "QSET", "ASET1", "OMIT1", "QSET1", "EXTRN", "SECONCT"),
    )
)
# a THRU passes over points that are not there
_OF_POINTS_THERE = ("SPC1", "ASET1", "OMIT1", "QSET1")
# cards that share their numbers: a field that names one does not say of which card
_ONE_NUMBER = (
    ("MAT1", "MAT2", "MAT8", "MAT9"),
    ("PSHELL", "PCOMP", "PCOMPG"),
    ("CORD1R", "CORD1C", "CORD1S", "CORD2R", "CORD2C", "CORD2S"),
)


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """What a deck holds, without refusing any of it.

    Attributes
    ----------
    model : Model
        Of the supported cards.
    cards : mapping of str to int
        Every card and how many.
    unsupported : mapping of str to str
        What would stop `read_deck`, with the first place (`path:line`) of each.
    faults : tuple of DeckError
        References to what is not in the deck.
    """

    model: Model
    cards: Mapping[str, int]
    unsupported: Mapping[str, str]
    faults: tuple[DeckError, ...]


def read_deck(path: str | Path) -> Model:
    """Read a deck with its includes.

    Raises
    ------
    DeckError
        On anything malformed, missing or twice, with file, line, card and field.
    UnsupportedCard
        On a card that carries stiffness, mass or constraint and is not supported.
    """
    return _read(load(path)).model


def read_loaded_deck(path: str | Path) -> tuple[Model, tuple[LoadCase, ...]]:
    """Read a deck, as `read_deck` does, and its static load cases, as `load_cases` does."""
    found = _read(load(path))
    parts = [PartCards(c, found.numbers[n]) for n, c in found.cards.items() if n]
    return found.model, load_cases(found.cards[0], parts)


def read_damped_deck(path: str | Path) -> tuple[Model, ModalDamping | None]:
    """Read a deck, as `read_deck` does, and the modal damping that its case control asks for
    (SDAMPING).
    """
    found = _read(load(path))
    structural = found.model.params.get("KDAMP", 1) == -1
    return found.model, modal_damping(found.cards[0], structural=structural)


@dataclass(frozen=True, slots=True, eq=False)
class _ReadDeck:
    """A deck as read: its model, and of the residual structure (0) and each superelement the cards
    and the numbers that have changed.
    """

    model: Model
    cards: Mapping[int, Cards]
    numbers: Mapping[int, Mapping[str, Numbers]] = field(default_factory=dict)


def _sections(deck: Deck) -> dict[int, Deck]:
    """The residual structure (0) and the parts, each with the case control that holds for it."""
    if not deck.parts:
        return {0: deck}
    every = {0: deck, **deck.parts}
    return {
        n: replace(d, top=of_superelement(deck.top, n), parts={})
        for n, d in every.items()
    }


def _read(deck: Deck) -> _ReadDeck:
    if deck.unread:
        file, line = deck.unread
        raise UnsupportedCard(
            "BEGIN", path=deck.files[file], line=line, why=reason("BEGIN")
        )
    every = {number: cards(d) for number, d in _sections(deck).items()}
    models = {number: _section(found) for number, found in every.items()}
    found = _ReadDeck(models[0], every)
    if deck.parts or "SEBULK" in models[0]:
        sections = [BulkSection(number, model) for number, model in models.items()]
        made = joined(sections, _op4(deck))
        found = _ReadDeck(made.model, every, made.numbers)
    model = found.model
    path = deck.files[0]
    for text in empty_choices(model):
        log.warning("%s: case control asks for %s", path, text)
    if model.case.others:
        log.warning(
            "%s: SUBCASE %s not taken, only the first with a METHOD is",
            path,
            list(model.case.others),
        )
    for text in left_out(model):
        log.warning("%s: %s", path, text)
    return found


def _op4(deck: Deck) -> dict[int, Path]:
    """OUTPUT4 files that the file management section assigns, by their units."""
    return op4_units(deck.top, Path(deck.files[0]).parent)


def _section(found: Cards) -> Model:
    """The model of one section of bulk data.

    Raises
    ------
    DeckError
        On what is wrong in it.
    UnsupportedCard
        On a card that is not supported.
    """
    for at, name in _stopping(found):
        path, line = found.place(at)
        raise UnsupportedCard(name, path=path, line=line, why=reason(name))
    model, skipped = _model(found)
    for card, (why, place) in skipped.items():
        raise UnsupportedCard(card, path=place[0], line=place[1], why=why)
    for wrong in unclear_sets(model, chosen=bool(found.deck.top)):
        raise wrong
    out = idle(model)
    for fault_ in missing(model):
        if not np.isin(fault_.rows, out.get(fault_.reference.card, ())).all():
            raise _dangling(model, fault_)
    for wrong in (*_misnamed(model), *open_bushes(model)):
        raise wrong
    return model


def survey(path: str | Path) -> Survey:
    """Read what can be read and list the rest.

    Raises
    ------
    DeckError
        On anything malformed.
    """
    deck = load(path)
    unsupported: dict[str, str] = {}
    faults: list[DeckError] = []
    counts: dict[str, int] = {}
    sections = []
    for number, part in _sections(deck).items():
        found = cards(part)
        stopping = {
            name: "{}:{}".format(*found.place(at)) for at, name in _stopping(found)
        }
        if deck.unread and not number:
            stopping["BEGIN"] = f"{deck.files[deck.unread[0]]}:{deck.unread[1]}"
        refused = {
            card: ": ".join(t for t in (place, reason(card)) if t)
            for card, place in stopping.items()
        }
        model, skipped = _model(found)
        refused |= {
            card: f"{at[0]}:{at[1]}: {why}" for card, (why, at) in skipped.items()
        }
        own = [
            _dangling(model, f) for f in missing(model, _foreign_ids(found, refused))
        ]
        own += [*unclear_sets(model, chosen=bool(deck.top)), *_misnamed(model)]
        own += [] if own else open_bushes(model)
        names, _, count = found.kinds()
        for name, n in zip(names.tolist(), count.tolist(), strict=True):
            counts[name.decode()] = counts.get(name.decode(), 0) + n
        unsupported = refused | unsupported
        faults += own
        sections.append(BulkSection(number, model))
    if deck.parts or "SEBULK" in sections[0].model:
        try:
            model = joined(sections, _op4(deck)).model
        except UnsupportedCard as e:
            unsupported[e.card] = f"{e.path}:{e.line}: {e.why}"
            model = sections[0].model
    return Survey(model, counts, unsupported, tuple(faults))


def _stopping(found: Cards) -> list[tuple[int, str]]:
    """The first card of each name that must not be passed over, in order."""
    names, first, _ = found.kinds()
    # beginnings of names that case control makes count
    more = stiffening(found.deck.top)
    out = []
    for at, name in zip(
        first.tolist(), (n.decode() for n in names.tolist()), strict=True
    ):
        stops = is_unsupported(name) or name[0] == "/" or name.startswith(more)
        if stops and name not in SPECIAL:
            out.append((at, name))
    # MSC's; NX lists elements
    cut = [
        (at, "BOLT")
        for at in found.named("BOLT").tolist()
        if b"TOP" in found.fields(at)
    ]
    return sorted([*out, *cut[:1]])


def _foreign_ids(found: Cards, unsupported: Collection[str]) -> dict[str, set[int]]:
    """Ids of unsupported properties and materials, under the names of the cards that stand for
    them.
    """
    out: dict[str, set[int]] = {}
    ids = set()
    for name in unsupported:
        if name.startswith(("P", "MAT")):
            for _, cells in found.cells(name):
                ids |= {int(c) for c in cells[:, 0].tolist() if c.isdigit()}
    for card in (
        "PSHELL",
        "PCOMP",
        "PBAR",
        "PBEAM",
        "PSOLID",
        "PROD",
        "PBUSH",
        "PELAS",
        "MAT1",
    ):
        out[card] = ids
    return out


def _model(found: Cards) -> tuple[Model, dict[str, tuple[str, tuple[str, int]]]]:
    """The model, and special cards that were met in a form that is not supported: why and where."""
    names, _, count = found.kinds()
    case = case_control(found.deck.top)
    tables: dict[str, Table] = {}
    kept: dict[str, int] = {}
    skipped: dict[str, tuple[str, tuple[str, int]]] = {}
    for name, n in zip(
        (x.decode() for x in names.tolist()), count.tolist(), strict=True
    ):
        # counts only where case control chooses it
        if name in NONSTRUCTURAL and not case.nsm:
            kept[name] = n
        elif name in CARDS and name not in SPECIAL and name not in _OF_POINTS_THERE:
            tables[name] = make_table(found, name)
        elif name in SPECIAL:
            try:
                made = special_table(name, written_out(found, name), found.deck.files)
            except UnsupportedCard as e:
                skipped[name] = (e.why, (str(e.path), e.line or 0))
                continue
            tables[made.card] = (
                stacked(tables[made.card], made) if made.card in tables else made
            )
            if name in MADE:
                tables[name] = dimensions(written_out(found, name), found.deck.files)
        elif name not in DEFAULTS and name not in ("PARAM", *_OF_POINTS_THERE):
            kept[name] = n
    if "INCLUDE" in kept:
        at = int(np.flatnonzero(found.name == b"INCLUDE")[0])
        raise fault(found, at, "write the file name behind INCLUDE, in quotes")
    for default in DEFAULTS:
        tables |= fill(default, tables, found)
    _refuse_both(tables, found.deck.files)
    tables |= implied_points(tables)
    # springs and masses between scalar points alone
    if "SPOINT" in tables and "GRID" not in tables:
        tables["GRID"] = empty("GRID")
    points = [tables[n].ids for n in ("GRID",) if n in tables]
    points += [tables[n].ragged("ID").values for n in ("SPOINT",) if n in tables]
    there = np.unique(np.concatenate([*points, np.empty(0, dtype=np.int64)]))
    for name in _OF_POINTS_THERE:
        if name.encode() in names:
            tables[name] = make_table(found, name, there)
    tables = {
        n: t if n in _SHARED_IDS else _unique(t, found.deck.files)
        for n, t in tables.items()
    }
    refuse_magnitudes(tables.values(), found.deck.files)
    for group in _ONE_NUMBER:
        _refuse_shared(
            [tables[card] for card in group if card in tables], found.deck.files
        )
    case = case if found.deck.top else only_sets(case, tables)
    return Model(tables, _params(found), case, found.deck.files, kept), skipped


def _params(found: Cards) -> dict[str, int | float | str]:
    out: dict[str, int | float | str] = {}
    for card in written_out(found, "PARAM"):
        name = card.fields[0]
        text = card.fields[1]
        if not name:
            raise DeckError(
                "a PARAM without a name",
                path=found.deck.files[card.file],
                line=card.line,
                card="PARAM",
            )
        out[name] = value(text)
        refuse_parameter(name, out[name], found.deck.files[card.file], card.line)
    return out | params(found.deck.top)


def _unique(table: Table, files: tuple[str, ...]) -> Table:
    """The table; equal definitions of one node or frame count once, as Nastran does."""
    ids = table.ids
    if (ids[1:] > ids[:-1]).all():
        return table
    _, first, inverse = np.unique(ids, return_index=True, return_inverse=True)
    if first.size == ids.size:
        return table
    again = np.flatnonzero(first[inverse] != np.arange(ids.size))
    if table.card.startswith(("GRID", "CORD")):
        before = first[inverse[again]]
        equal = [table[name][again] == table[name][before] for name in table.columns]
        again = again[~np.all(equal, axis=0)]
    if again.size:
        raise _twice(table, int(again[0]), table, int(first[inverse[again[0]]]), files)
    keep = np.sort(first)
    columns: dict[str, Any_ | Ragged] = {
        name: table[name][keep] for name in table.columns
    }
    return replace(table, columns=columns, file=table.file[keep], line=table.line[keep])


def _refuse_shared(tables: Sequence[Table], files: tuple[str, ...]) -> None:
    """Refuse two cards of these tables with one number."""
    for i, table in enumerate(tables):
        for other in tables[:i]:
            if (rows := np.flatnonzero(np.isin(table.ids, other.ids))).size:
                raise _twice(
                    table,
                    int(rows[0]),
                    other,
                    int(other.find(table.ids[rows[:1]])[0]),
                    files,
                )


def _refuse_both(tables: Mapping[str, Table], files: tuple[str, ...]) -> None:
    """Refuse an SPOINT with the number of a GRID: which of the two a card names would be open."""
    if "SPOINT" in tables and "GRID" in tables:
        points = tables["SPOINT"]
        ids, owner = points.entries("ID")
        both = np.flatnonzero(np.isin(ids, tables["GRID"].ids))
        if both.size:
            row = int(owner[both[0]])
            raise DeckError(
                f"{ids[both[0]]} is the number of a GRID, too",
                path=files[points.file[row]],
                line=int(points.line[row]),
                card="SPOINT",
            )


def _twice(
    table: Table, row: int, other: Table, before: int, files: tuple[str, ...]
) -> DeckError:
    first = f"{files[other.file[before]]}:{other.line[before]}"
    return DeckError(
        f"{table.ids[row]} is defined twice, first "
        f"{'' if other is table else f'as {other.card} '}at {first}",
        path=files[table.file[row]],
        line=int(table.line[row]),
        card=table.card,
    )


def _dangling(model: Model, lost: Missing) -> DeckError:
    table = model[lost.reference.card]
    row = int(lost.rows[0])
    wanted = int(lost.ids[0])
    of = lost.reference.names
    more = f" ({lost.rows.size - 1} more like it)" if lost.rows.size > 1 else ""
    what = (
        f"names {of} {wanted}, which is not in the deck"
        if wanted
        else f"is blank; it must name a {of}"
    )
    if "MAT9" in of and "MAT10" in model.kept:
        what += f"; MAT10 makes a fluid ({reason('MFLUID')})"
    return DeckError(
        f"{what}{more}",
        path=model.files[table.file[row]],
        line=int(table.line[row]),
        card=f"{table.card} {table.ids[row]}",
        field=lost.reference.field,
    )


def _misnamed(model: Model) -> Iterator[DeckError]:
    """Lists of components with more than the digits 1 to 6, the first of each field."""
    for table in model.tables.values():
        for name in (s.name for s in columns(table.card) if s.kind == "c"):
            if name not in table.columns:
                continue
            text, owner = table.entries(name)
            bad = np.flatnonzero((np.char.strip(text, "123456") != "") & (text != "0"))
            if bad.size:
                row = int(owner[bad[0]])
                yield DeckError(
                    f"{str(text[bad[0]])!r} is no list of components; allowed are the digits 1 "
                    "to 6",
                    path=model.files[table.file[row]],
                    line=int(table.line[row]),
                    card=f"{table.card} {table.ids[row]}",
                    field=name,
                )
