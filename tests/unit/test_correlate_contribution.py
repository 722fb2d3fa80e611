"""Shares of the MAC by channel, elimination of channels, and the user's locks."""

from __future__ import annotations

import numpy as np
import pytest

from ringtrue.core.modes import ModeSet
from ringtrue.correlation.assignment import Locks
from ringtrue.correlation.paired_shapes import eliminate, mac_contribution
from ringtrue.correlation.pairing import pair_modes
from ringtrue.errors import ConfigError, InputError
from ringtrue.shapes import paired_mac


def paired(seed: int = 0, kind: str = "real") -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    a = rng.standard_normal((12, 4)) + (
        1j * rng.standard_normal((12, 4)) if kind == "complex" else 0
    )
    return a, a + 0.3 * rng.standard_normal((12, 4))


@pytest.mark.parametrize("kind", ["real", "complex"])
def test_contributions_sum_to_the_mac_and_leaving_out_is_leaving_out(kind: str) -> None:
    a, b = paired(kind=kind)
    np.testing.assert_allclose(
        mac_contribution(a, b * 1j).sum(axis=0), paired_mac(a, b), rtol=1e-12
    )


def test_elimination_takes_the_spoilt_channels_first() -> None:
    a = np.random.default_rng(0).standard_normal((30, 4))
    b = a.copy()
    b[7] *= -1
    b[2, :2] = 0
    e = eliminate(a, b)
    assert e.order.size == 3
    assert e.order[:2].tolist() == [7, 2]
    np.testing.assert_allclose(e.mac[2], 1, rtol=1e-10)
    np.testing.assert_allclose(e.mac[0], paired_mac(a, b), rtol=1e-12)
    left = np.delete(np.arange(30), e.order[:1])
    np.testing.assert_allclose(e.mac[1], paired_mac(a[left], b[left]), rtol=1e-10)
    assert (np.diff(e.mean_mac[:3]) > 0).all()
    assert eliminate(a[:5], b[:5]).order.size == 1
    with pytest.raises(InputError, match="equal in size"):
        eliminate(a, b[:, :2])


def sets() -> tuple[ModeSet, ModeSet]:
    phi = np.sin(np.pi * np.outer(np.arange(1, 11), np.arange(1, 5)) / 11)
    names = tuple("abcdefghij")
    return (
        ModeSet(np.array([10.0, 20, 30, 40]), np.zeros(4), phi, names),
        ModeSet(
            np.array([10.0, 20, 30, 90]),
            np.zeros(4),
            phi + 0.3 * phi[:, [1, 0, 3, 2]],
            names,
        ),
    )


def test_forced_and_forbidden_pairs() -> None:
    a, b = sets()
    free = pair_modes(a, b)
    assert free.a.tolist() == free.b.tolist() == [0, 1, 2]
    p = pair_modes(a, b, locks=Locks(forced=((3, 3),), forbidden=((1, 1),)))
    assert list(zip(p.a.tolist(), p.b.tolist(), strict=True)) == [
        (0, 0),
        (2, 2),
        (3, 3),
    ]
    assert p.reasons_a[0] == "FE 2 (MAC 92 %) is forbidden by the user"
    assert p.reasons_b[0] == "test 2 (MAC 92 %) is forbidden by the user"
    crossed = pair_modes(a, b, locks=Locks(forced=((0, 1),)))
    assert (0, 1) in zip(crossed.a.tolist(), crossed.b.tolist(), strict=True)
    assert crossed.mac[0] < 0.1  # told as it is


def test_locks_that_contradict() -> None:
    a, b = sets()
    with pytest.raises(ConfigError, match="mode 1 of A is forced into two pairs"):
        Locks(forced=((0, 1), (0, 2)))
    with pytest.raises(ConfigError, match="both forced and forbidden"):
        Locks(forced=((0, 1),), forbidden=((0, 1),))
    with pytest.raises(ConfigError, match="no pair 5:1; A has 4 modes"):
        pair_modes(a, b, locks=Locks(forbidden=((4, 0),)))
