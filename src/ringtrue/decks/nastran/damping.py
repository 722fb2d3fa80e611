"""Modal damping that case control asks for: SDAMPING and its TABDMP1."""

from __future__ import annotations

import numpy as np

from ringtrue.decks.nastran.case import modal_damping_set
from ringtrue.decks.nastran.defaults import written_out
from ringtrue.decks.nastran.fields import Reader
from ringtrue.decks.nastran.gather import Cards
from ringtrue.errors import DeckError
from ringtrue.model.case_control import ModalDamping

_RATIO = {"": 0.5, "G": 0.5, "CRIT": 1.0, "Q": 0.5}  # of a value, of Q of its inverse


def modal_damping(found: Cards, *, structural: bool = False) -> ModalDamping | None:
    """The table that SDAMPING names; None where case control has none.

    Raises
    ------
    DeckError
        If the table is not in the deck, or its frequencies fall.
    """
    number = modal_damping_set(found.deck.top)
    if not number:
        return None
    for r in (Reader(c, found.deck.files) for c in written_out(found, "TABDMP1")):
        if r.whole(0, "TID") == number:
            return _table(r, structural)
    raise DeckError(
        f"case control has SDAMPING = {number}: the deck has no such TABDMP1",
        path=found.deck.files[0],
    )


def _table(r: Reader, structural: bool) -> ModalDamping:
    """TABDMP1: TID TYPE FLAT, then f1 g1 f2 g2 ... ENDT; a pair with SKIP does not count."""
    kind = r.text(1).upper()
    if kind not in _RATIO:
        raise r.fail("TYPE", f"{kind!r}: allowed are G, CRIT and Q")
    pairs = []
    for i in range(8, len(r.card.fields), 2):
        texts = {r.text(i).upper(), r.text(i + 1).upper()}
        if "ENDT" in texts:
            break
        if "SKIP" not in texts and texts != {""}:
            pairs.append((r.real(i, "f"), r.real(i + 1, "g")))
    f, g = np.array(pairs, dtype=np.float64).reshape(-1, 2).T
    if not f.size or (np.diff(f) < 0).any():
        raise r.fail("f", "frequencies must be given, and rise")
    if kind == "Q" and (g <= 0).any():
        raise r.fail("g", "Q must be above 0")
    return ModalDamping(
        f, _RATIO[kind] * (1 / g if kind == "Q" else g), r.text(2) == "1", structural
    )
