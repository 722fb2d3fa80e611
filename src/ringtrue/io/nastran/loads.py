"""Static loads of a deck: FORCE, MOMENT and GRAV, as LOAD adds them up for the subcases."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ringtrue.errors import DeckError, UnsupportedCard
from ringtrue.io.nastran.case import load_sets
from ringtrue.io.nastran.deck import load
from ringtrue.io.nastran.defaults import written_out
from ringtrue.io.nastran.fields import Reader
from ringtrue.io.nastran.gather import Cards, cards
from ringtrue.model.cards import PRELOADS

READ = ("FORCE", "MOMENT", "GRAV")


@dataclass(frozen=True, slots=True)
class Load:
    """A force or moment at `node`, or an acceleration of all masses (GRAV, node 0), in frame `cid`; deck units."""

    card: str
    node: int
    cid: int
    vector: tuple[float, float, float]

    def times(self, factor: float) -> Load:
        """The load multiplied."""
        x, y, z = self.vector
        return Load(self.card, self.node, self.cid, (factor * x, factor * y, factor * z))


@dataclass(frozen=True, slots=True)
class LoadCase:
    """What acts in a subcase."""

    name: str
    loads: tuple[Load, ...]


def read_load_cases(path: str | Path) -> tuple[LoadCase, ...]:
    """The load cases of a deck: its subcases with a LOAD, in order.

    Raises
    ------
    DeckError
        If there is none, a set is not in the deck, a field is no number, or subcases have other SPC or MPC.
    UnsupportedCard
        If a set has loads of other cards, such as PLOAD4.
    """
    deck = load(path)
    found = cards(deck)
    if not (asked := load_sets(deck.top)):
        raise DeckError("case control has no LOAD: give one, or --force", path=deck.files[0])
    return tuple(LoadCase(name, _of_set(found, number)) for name, number in asked)


def _of_set(found: Cards, number: int) -> tuple[Load, ...]:
    for r in (Reader(c, found.deck.files) for c in written_out(found, "LOAD")):
        if r.whole(0, "SID") == number:
            every, last = r.real(1, "S", 0.0), len(r.card.fields) - 1
            pairs = [(every * r.real(i, "Si", 0.0), r.whole(i + 1, "Li")) for i in range(2, last, 2) if r.text(i + 1)]
            return tuple(ld.times(f) for f, of in pairs for ld in _alone(found, of))
    return _alone(found, number)


def _alone(found: Cards, number: int) -> tuple[Load, ...]:
    """The loads of a set, without LOAD."""
    out = list[Load]()
    for name in (n.decode() for n in found.kinds()[0].tolist()):
        if name.startswith("LOAD") or not name.startswith(PRELOADS):
            continue
        for c in written_out(found, name):  # over the loads, which are few beside the elements
            r = Reader(c, found.deck.files)
            if r.text(0) != str(number):
                continue
            if name not in READ:
                why = f"of a static load, {', '.join(READ)} are read"
                raise UnsupportedCard(name, path=found.deck.files[c.file], line=c.line, why=why)
            out.append(_load(name, r))
    if not out:
        raise DeckError(f"load set {number} is not in the deck", path=found.deck.files[0])
    return tuple(out)


def _load(name: str, r: Reader) -> Load:
    """FORCE and MOMENT: SID G CID F N1 N2 N3; GRAV: SID CID A N1 N2 N3."""
    at = 1 if name == "GRAV" else 2
    x, y, z = (r.real(at + k, f"N{k - 1}", 0.0) for k in (2, 3, 4))
    node, cid = 0 if at == 1 else r.whole(1, "G"), r.whole(at, "CID", 0)
    return Load(name, node, cid, (x, y, z)).times(r.real(at + 1, "the size", 0.0))
