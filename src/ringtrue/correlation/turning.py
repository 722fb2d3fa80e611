"""Shapes of close modes as they were paired: turned inside their group towards those of the other
set.
"""

from __future__ import annotations

import numpy as np
from scipy import linalg

from ringtrue.core.arrays import Any_
from ringtrue.core.modes import ModeSet
from ringtrue.core.pairing import Pairing
from ringtrue.correlation.assign import PairingSettings, scores
from ringtrue.correlation.beyond import among
from ringtrue.shapes.subspace import rotation


def paired_shapes(
    a: ModeSet,
    b: ModeSet,
    pairing: Pairing,
    settings: PairingSettings = PairingSettings(),  # noqa: B008  frozen
) -> tuple[Any_, Any_]:
    """The shapes (n, k) of the pairs; those of B turned inside their close group as far as the
    pairing did so.

    Parameters
    ----------
    a, b : ModeSet
        As they were paired.
    settings : PairingSettings
        Those of the pairing.
    """
    b = b.rows(a.channels)
    turn = turning(a, b, pairing, settings)[:, pairing.b] if pairing.subspace.any() else None
    return a.shapes[:, pairing.a], np.array(
        b.shapes[:, pairing.b]
    ) if turn is None else b.shapes @ turn


def turning(
    a: ModeSet,
    b: ModeSet,
    pairing: Pairing,
    settings: PairingSettings = PairingSettings(),  # noqa: B008  frozen
) -> Any_:
    """The matrix U (mb, mb), UᴴU = 1, that turns close modes of B as the pairing did: compare A
    with `b.shapes @ U`.

    Mass-normalised shapes stay orthonormal; what a group holds beyond its pairs takes the
    directions that are left. Where closeness fades, U is as far between no rotation and the whole
    one.

    Parameters
    ----------
    a, b : ModeSet
        As they were paired.
    settings : PairingSettings
        Those of the pairing.
    """
    b = b.rows(a.channels)
    out = np.eye(len(b), dtype=np.result_type(a.shapes, b.shapes, np.float64))
    turned = np.flatnonzero(pairing.subspace)
    if not turned.size:
        return out
    plain = out.copy()
    f = (a.frequencies, a.shapes, b.frequencies, b.shapes)
    turns = scores(*f, settings).turns
    if pairing.beyond.any():
        left = np.setdiff1d(np.arange(len(b)), pairing.b[~pairing.beyond])
        turns += among(*f, pairing.a[pairing.beyond], left, settings).turns
    for group, weight in turns:
        at = turned[np.isin(pairing.b[turned], group)]
        if at.size:
            inside = np.ix_(list(group), list(group))
            rotated, far = (
                _rotated(a.shapes, b.shapes, pairing, at, group),
                np.full(len(group), weight.max()),
            )
            far[np.searchsorted(group, pairing.b[at])] = weight[pairing.a[at]]
            out[inside] += (rotated - plain[inside]) * far
    out = linalg.polar(out)[0]
    mine = pairing.b[turned]
    out[:, mine] *= _phase(
        ((b.shapes @ out[:, mine]).conj() * a.shapes[:, pairing.a[turned]]).sum(axis=0)
    )
    return np.asarray(out)


def _rotated(a: Any_, b: Any_, pairing: Pairing, at: Any_, group: tuple[int, ...]) -> Any_:
    """The rotation (g, g) of an ascending group of B towards its pairs `at`; each column near the
    mode it replaces.
    """
    turn = rotation(a[:, pairing.a[at]], b[:, list(group)])
    rest = linalg.null_space(turn.conj().T) if turn.shape[1] < len(group) else turn[:, :0]
    columns = [*pairing.b[at].tolist(), *(j for j in group if j not in pairing.b[at])]
    out = np.concatenate([turn, rest], axis=1)[:, np.argsort(columns)]
    return np.asarray(out * _phase(out.diagonal().conj()))


def _phase(z: Any_) -> Any_:
    """z/|z|, 1 where z is 0."""
    size = np.abs(z)
    return np.asarray(np.where(size > 0, z / np.where(size > 0, size, 1.0), 1.0))
