"""Beyond the usual: modes just outside the lines, damped as elastomers and ballast damp, or of
forty references.

FRFs are sums of the modes of a simply supported plate of 10 kg and unit sides, φ_jk = 2 sin(jπx)
sin(kπy)/√m, at random places, with white noise of 1 % of the rms of each and the coherence that it
leaves.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from ringtrue.core.signals import Channel, FrfSet
from ringtrue.identification.frf.pipeline import HammerResult, identify_hammer
from ringtrue.shapes import mac

MASS, LEVEL, AVERAGES = 10.0, 0.01, 5.0
EXACT = 0.995  # MAC: ten times what the noise leaves
# of a modal mass: what modes far beyond the lines may leave near an end of these
SCALE = 0.03


def plate(
    fn: np.ndarray,
    zeta: np.ndarray,
    freqs: np.ndarray,
    rng: np.random.Generator,
    points: int = 20,
    references: Sequence[int] = (0, 5),
    level: float = LEVEL,
) -> tuple[FrfSet, np.ndarray]:
    """Accelerances of some points by references among them, and the shapes."""
    x, y = rng.uniform(0.05, 0.95, (2, points, 1))
    pairs = sorted(
        ((j, k) for j in range(1, 9) for k in range(1, 9)),
        key=lambda p: p[0] ** 2 + 1.3 * p[1] ** 2,
    )
    j, k = np.array(pairs[: fn.size]).T
    phi = 2 / np.sqrt(MASS) * np.sin(np.pi * j * x) * np.sin(np.pi * k * y)
    s, w = 2j * np.pi * freqs[:, None], 2 * np.pi * fn
    h = np.einsum(
        "fk,ok,ik->foi",
        s**2 / (s**2 + 2 * zeta * w * s + w**2),
        phi,
        phi[list(references)],
    )
    sigma = level * np.sqrt(np.mean(np.abs(h) ** 2, axis=0))
    noise = (
        sigma
        * (rng.standard_normal(h.shape) + 1j * rng.standard_normal(h.shape))
        / np.sqrt(2)
    )
    coherence = 1 / (1 + AVERAGES * (sigma / np.abs(h)) ** 2)
    out = tuple(Channel(f"{i}+Z", "acceleration", "m/s^2") for i in range(points))
    forces = tuple(Channel(f"{i}+Z", "force", "N") for i in references)
    return FrfSet(
        h + noise,
        freqs,
        out,
        forces,
        coherence,
        np.full(len(references), AVERAGES),
        "accelerance",
    ), phi


def same(
    found: HammerResult, fn: np.ndarray, zeta: np.ndarray, phi: np.ndarray
) -> None:
    modes = found.modes
    assert len(modes) == fn.size, (modes.frequencies, found.others.sentences())
    np.testing.assert_allclose(modes.frequencies, fn, rtol=1e-3)
    np.testing.assert_allclose(modes.damping, zeta, rtol=0.02)
    assert np.diag(mac(modes.shapes, phi)).min() > EXACT
    np.testing.assert_allclose(
        np.linalg.norm(modes.shapes, axis=0), np.linalg.norm(phi, axis=0), rtol=SCALE
    )


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_lines_that_end_beside_modes(seed: int) -> None:
    """Two modes within 2 % outside the lines, where no residual term stands for them, and one
    within 1 % inside.
    """
    rng = np.random.default_rng(seed)
    fn = np.array(
        [60, 210, 390, 403, 500, 640, 655, 820, 1010, 1090, 1193, 1218, 1500, 1700.0]
    )
    zeta = rng.uniform(0.003, 0.012, fn.size)
    frfs, phi = plate(fn, zeta, np.arange(398.0, 1200.1, 0.5), rng)
    at = (fn > 400) & (fn < 1200)
    same(identify_hammer(frfs), fn[at], zeta[at], phi[:, at])


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_heavy_beside_light_damping(seed: int) -> None:
    """As of a track: the rail on its pads and the ballast beside the pinned-pinned mode."""
    rng = np.random.default_rng(seed)
    fn = np.array([120, 310, 480, 560, 1060, 1100, 1650, 2300.0])
    zeta = np.array([0.25, 0.2, 0.03, 0.15, 0.004, 0.02, 0.02, 0.015])
    frfs, phi = plate(fn, zeta, np.arange(1.0, 2500.0), rng)
    same(identify_hammer(frfs), fn, zeta, phi)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_matrix_of_forty_references(seed: int) -> None:
    """As for substructuring: overlapping modes of 3 to 6 %, more references than the polynomials
    have orders for.
    """
    rng = np.random.default_rng(seed)
    fn, zeta = (
        np.arange(22.0, 55.0, 3.0) + rng.uniform(-1, 1, 11),
        rng.uniform(0.03, 0.06, 11),
    )
    frfs, phi = plate(fn, zeta, np.arange(10.0, 70.1, 0.25), rng, 50, range(40))
    same(identify_hammer(frfs), fn, zeta, phi)


@pytest.mark.parametrize("seed", [1, 3, 4, 5])
def test_a_crowded_band(seed: int) -> None:
    """As of a trimmed body: 35 modes of 1 to 4 %, more than one in a bandwidth, and noise of 5
    %.
    """
    rng = np.random.default_rng(seed)
    fn = np.sort(rng.uniform(5, 42, 35))
    zeta = np.exp(rng.uniform(np.log(0.01), np.log(0.04), fn.size))
    frfs, phi = plate(fn, zeta, np.arange(2.0, 45.0, 0.0625), rng, 40, level=0.05)
    found = identify_hammer(frfs)
    far = np.abs(found.modes.frequencies[:, None] - fn) / (zeta * fn) + (
        1 - mac(found.modes.shapes, phi)
    )
    mode, true = linear_sum_assignment(far)
    assert len(mode) == len(found.modes) >= fn.size - 3, found.others.sentences()
    # a neighbour that is missed costs half a bandwidth
    assert far[mode, true].max() < 1
    assert not any(n.startswith("the responses disagree") for n in found.notes)
