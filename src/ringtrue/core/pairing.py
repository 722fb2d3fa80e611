"""Which mode of one set belongs to which of another, and why the rest have no partner."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ringtrue.core.arrays import Bool, Float, Int, freeze_fields

SURE = -2  # in `rival`


@dataclass(frozen=True, slots=True, eq=False)
class Pairing:
    """A one-to-one assignment between modes of set A (test) and set B (model or second test).

    Attributes
    ----------
    a, b : (k,) int64
        Positions in A and B, ascending in A.
    mac : (k,) float64, 0..1
        Of the pair; of its subspace where `subspace` is true.
    frequency_error : (k,) float64
        (f_B − f_A)/f_A.
    sign : (k,) float64
        ±1, brings b to the phase of a.
    subspace : (k,) bool
        The pair belongs to a group of close modes that was treated as a subspace.
    lone_a, lone_b : (u,) int64
        Positions without a partner.
    why_a, why_b : tuple of str
        The reason for each.
    rival : (k,) int64
        Where frequencies alone decide: another mode of B that the mode of A may be, -1 if it may
        have no partner at all, `SURE` where neither is likely; empty where shapes decide.
    beyond : (k,) bool
        The pair is beyond the frequency gate: its modes look alike and like no other.
    """

    a: Int
    b: Int
    mac: Float
    frequency_error: Float
    sign: Float
    subspace: Bool
    lone_a: Int
    why_a: tuple[str, ...]
    lone_b: Int
    why_b: tuple[str, ...]
    rival: Int = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    beyond: Bool = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))

    def __post_init__(self) -> None:
        i, f, yes = np.int64, np.float64, np.bool_
        freeze_fields(
            self, a=i, b=i, mac=f, frequency_error=f, sign=f, subspace=yes, lone_a=i, lone_b=i
        )
        object.__setattr__(
            self, "beyond", self.beyond if len(self.beyond) else np.zeros(len(self.a), dtype=yes)
        )
        freeze_fields(self, rival=i, beyond=yes)

    def __len__(self) -> int:
        return int(self.a.size)

    def doubts(self, names: tuple[str, str] = ("test", "FE")) -> tuple[str, ...]:
        """Each pair that frequencies alone leave in doubt, in words."""
        a, b = names
        return tuple(
            f"{a} {i + 1} is taken for {b} {j + 1}, and may as well be "
            + (f"{b} {k + 1}" if k >= 0 else f"no mode of {b}")
            for i, j, k in zip(self.a.tolist(), self.b.tolist(), self.rival.tolist(), strict=False)
            if k != SURE
        )

    def far(self, names: tuple[str, str] = ("test", "FE")) -> tuple[str, ...]:
        """The pairs beyond the frequency gate, in words; nothing where there is none."""
        a, b = names
        pairs = [
            f"{a} {self.a[k] + 1} with {b} {self.b[k] + 1} ({100 * self.frequency_error[k]:+.3g} %)"
            for k in np.flatnonzero(self.beyond).tolist()
        ]
        why = "paired beyond the frequency gate, as they look alike and like no other mode"
        return (f"{why}: {', '.join(pairs)}",) if pairs else ()
