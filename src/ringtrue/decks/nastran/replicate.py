"""Replicated cards written out: `=` and `==` fields, increments `*(x)`, repetitions `=(n)`.

Source: MSC Nastran Quick Reference Guide, section 8, "Replication". A field `=` is that of the card
before, `==` this and all later fields of its line, `*(x)` that of the card before plus x; a card
`=(n)` or `=n` goes on n times with the increments of the card before it.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

MOST = 100_000  # cards that one repetition may make
_STEP = re.compile(rb"\*\(?([+-]?[\d.][\dEeDd.+-]*)\)?")
_COUNT = re.compile(rb"=\(?(\d{1,9})\)?")
_WHOLE = re.compile(rb"[+-]?\d{1,18}")
Fields = list[bytes]


def replicates(name: bytes, fields: Sequence[bytes]) -> bool:
    """Whether a card refers to the card before it."""
    return name[:1] == b"=" or any(f[:1] == b"=" or _STEP.fullmatch(f) for f in fields)


@dataclass(slots=True)
class Replication:
    """The card before, and the increments that made it (by field)."""

    name: bytes = b""
    fields: Fields = field(default_factory=list)
    steps: dict[int, bytes] = field(default_factory=dict)

    def plain(self, name: bytes, fields: Fields) -> None:
        """Take note of a card that is written out."""
        self.name, self.fields, self.steps = name, fields, {}

    def expand(self, name: bytes, fields: Fields) -> list[Fields]:
        """The cards that one replicated card stands for; their name is `self.name` then.

        Raises
        ------
        ValueError
            If there is no card before, or a field cannot be incremented.
        """
        if not self.name:
            raise ValueError("there is no card before it to replicate")
        count = _COUNT.fullmatch(name)
        if count:
            return self._repeat(int(count[1]))
        if name[:1] == b"=" and name not in (b"=", b"=="):
            raise ValueError(
                f"{name.decode('latin-1')!r} is no replication; allowed are =, =n and =(n)"
            )
        if name[:1] != b"=":
            self.name = name
        self.fields, self.steps = self._next([b"=="] if name == b"==" else fields)
        return [self.fields]

    def _repeat(self, count: int) -> list[Fields]:
        if count > MOST:
            raise ValueError(f"{count} repetitions; at most {MOST} are allowed")
        made = [self._raised(k) for k in range(1, count + 1)]
        self.fields = made[-1] if made else self.fields
        return made

    def _raised(self, times: int) -> Fields:
        return [
            _plus(f, self.steps[j], times) if j in self.steps else f
            for j, f in enumerate(self.fields)
        ]  # from the last card, so that sums do not drift

    def _next(self, fields: Fields) -> tuple[Fields, dict[int, bytes]]:
        before = [*self.fields, *[b""] * len(fields)]
        out: Fields = []
        steps: dict[int, bytes] = {}
        for line in range(0, len(fields), 8):
            for j in range(line, min(line + 8, len(fields))):
                f, step = fields[j], _STEP.fullmatch(fields[j])
                if f == b"==":
                    out += before[j : line + 8]
                    break
                if step:
                    steps[j] = step[1]
                out.append(before[j] if f == b"=" else _plus(before[j], step[1], 1) if step else f)
        return out, steps


def _plus(text: bytes, step: bytes, times: int) -> bytes:
    """A field plus `times` increments: an integer if both are, a real otherwise."""
    if _WHOLE.fullmatch(text) and _WHOLE.fullmatch(step):
        return b"%d" % (int(text) + times * int(step))
    return repr(_real(text) + times * _real(step)).upper().encode()


def _real(text: bytes) -> float:
    plain = re.sub(rb"(?<=[\d.])([+-]\d+)$", rb"E\1", text.upper().replace(b"D", b"E"))
    try:
        return float(plain)
    except ValueError:
        raise ValueError(f"{text.decode('latin-1')!r} cannot be incremented") from None
