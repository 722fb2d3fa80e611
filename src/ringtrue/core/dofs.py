"""Labelled, signed degrees of freedom: the text form is `101+Z` or `101:+Z`, `101-RX`, or `7` for a
scalar point.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Bool, Float, Int, freeze_fields
from ringtrue.errors import InputError

NAMES = ("", "X", "Y", "Z", "RX", "RY", "RZ")
_TEXT = re.compile(r"(\d+)(?::?([+-]?)(R?[XYZ]))?")


@dataclass(frozen=True, slots=True, eq=False)
class DofSet:
    """An ordered set of degrees of freedom.

    Attributes
    ----------
    node : (n,) int64
    direction : (n,) int8
        ±1..±3 translations, ±4..±6 rotations, 0 a scalar point.

    Raises
    ------
    InputError
        If a direction is not in -6..6 or a degree of freedom occurs twice (whatever its sign).

    Examples
    --------
    >>> here = DofSet.parse(["101+Z", "102-RX"])
    >>> index, sign = here.align(DofSet.parse(["102+RX"]))
    >>> index.tolist(), sign.tolist()
    ([1], [-1.0])
    >>> DofSet.parse(["101:+Z"]).labels()
    ('101+Z',)
    """

    node: Int
    direction: Int

    def __post_init__(self) -> None:
        freeze_fields(self, node=np.int64, direction=np.int8)
        if self.node.shape != self.direction.shape or self.node.ndim != 1:
            raise InputError(
                f"node {self.node.shape} and direction {self.direction.shape} must be equal (n,)"
            )
        if self.direction.size and np.abs(self.direction).max() > 6:
            raise InputError(
                f"direction {int(np.abs(self.direction).max())}: allowed are -6..6"
            )
        key = self.key
        if np.unique(key).size != key.size:
            values, count = np.unique(key, return_counts=True)
            twice = int(values[count > 1][0])
            raise InputError(
                f"DOF {twice // 8}{'+' + NAMES[twice % 8] if twice % 8 else ''} occurs twice"
            )

    @property
    def key(self) -> Int:
        """(n,) int64, one number for a node and an unsigned direction."""
        return self.node * 8 + np.abs(self.direction).astype(np.int64)

    def __len__(self) -> int:
        return int(self.node.size)

    @classmethod
    def parse(cls, labels: Iterable[str]) -> DofSet:
        """Read text forms such as `101+Z`.

        Raises
        ------
        InputError
            On a text that is not a degree of freedom.
        """
        return cls(*parsed(labels))

    def take(self, at: Int | Bool) -> DofSet:
        """Some of them, by their places or by a mask."""
        return DofSet(self.node[at], self.direction[at])

    def joined(self, others: DofSet) -> DofSet:
        """These, and the others behind them."""
        return DofSet(
            np.concatenate([self.node, others.node]),
            np.concatenate([self.direction, others.direction]),
        )

    def named(self, at: Int) -> list[str]:
        """The text forms of some."""
        return list(self.take(at).labels())

    def labels(self) -> tuple[str, ...]:
        """The text forms, in order."""
        return tuple(map(_label, self.node.tolist(), self.direction.tolist()))

    def by_components(self) -> dict[str, list[int]]:
        """Nodes by the components that they have here, whatever their signs, as SPC1 lists them; 0
        is a scalar point.

        >>> DofSet.parse(["3+RX", "3+Z", "7+RX", "5+Z", "5+RX"]).by_components()
        {'34': [3, 5], '4': [7]}
        """
        node, row = np.unique(self.node, return_inverse=True)
        has = np.zeros((node.size, len(NAMES)), dtype=bool)
        has[row, np.abs(self.direction)] = True
        kinds, of = np.unique(has, axis=0, return_inverse=True)
        names = ["".join(map(str, np.flatnonzero(kind).tolist())) for kind in kinds]
        return {
            name: node[of == k].tolist()
            for k, name in sorted(enumerate(names), key=lambda x: x[1])
        }

    def find(self, node: Int, direction: Int) -> Int:
        """Positions of (node, |direction|) in this set, (k,) int64, -1 where absent."""
        key = self.key
        order = np.argsort(key, kind="stable")
        want = np.asarray(node, dtype=np.int64) * 8 + np.abs(
            np.asarray(direction, dtype=np.int64)
        )
        at = np.searchsorted(key[order], want).clip(max=max(len(self) - 1, 0))
        if not len(self):
            return np.full(want.shape, -1, dtype=np.int64)
        found = order[at]
        return np.where(key[found] == want, found, -1)

    def align(self, other: DofSet) -> tuple[Int, Float]:
        """Where the DOFs of `other` stand in this set, and with which relative sign.

        Returns
        -------
        index : (len(other),) int64
        sign : (len(other),) float64, ±1, so that `values[index] * sign` belongs to `other`

        Raises
        ------
        InputError
            If a DOF of `other` is not here; it is named.
        """
        return self.signed(other.node, other.direction)

    def signed(self, node: Int, direction: Int) -> tuple[Int, Float]:
        """As `align`, of (node, direction), (k,) each, among which a DOF may recur, as `101+Z` and
        `101-Z`.
        """
        index = self.find(node, direction)
        if (lost := np.flatnonzero(index < 0)).size:
            named = " ".join(
                map(_label, node[lost[:5]].tolist(), direction[lost[:5]].tolist())
            )
            raise InputError(f"{lost.size} DOFs are not in the set, first {named}")
        sign = np.where(
            np.sign(self.direction[index]) * np.sign(direction) < 0, -1.0, 1.0
        )
        return index, sign

    def per_length(self, unit: float) -> Float:
        """(n,) float64, 1/`unit` for rotations, else 1: what makes mass-normalised shapes those of
        another length.

        Shapes of mass-normalised modes at translations hold no length, at rotations one over a
        length; so do loads.
        """
        return np.where(np.abs(self.direction) > 3, 1 / unit, 1.0)


NO_DOFS = DofSet(np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int8))


def parsed(labels: Iterable[str]) -> tuple[Int, Int]:
    """Nodes (n,) int64 and directions (n,) int8 of text forms such as `101+Z`, a DOF as often as it
    is named.

    Raises
    ------
    InputError
        On a text that is not a degree of freedom.
    """
    node = []
    direction = []
    for text in labels:
        m = _TEXT.fullmatch(text.strip().upper())
        if not m:
            raise InputError(
                f"{text!r} is not a DOF; allowed are forms like 101+Z, 101-RX, 7"
            )
        node.append(int(m[1]))
        direction.append((-1 if m[2] == "-" else 1) * NAMES.index(m[3] or ""))
    return np.array(node, dtype=np.int64), np.array(direction, dtype=np.int8)


def _label(node: int, direction: int) -> str:
    sign = "+" if direction > 0 else "-"
    return f"{node}{sign}{NAMES[abs(direction)]}" if direction else str(node)
