"""Modes whose FRFs disagree: a sensor that is moved from response to response loads the structure
at each place.

Each response of a plate has every mode lower by a part of its half-power bandwidth, uniform between
none and `shift` of it, with the shapes as they are. The mean of the poles over the responses is the
truth that a mean can have, and shift·2ζf/√12 their deviation. True pairs, a part of a bandwidth
from each other, must stay two.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ringtrue.core.signals import Channel, FrfSet
from ringtrue.identification.frf.local_fits import with_local_fits
from ringtrue.identification.frf.pipeline import identify_hammer
from ringtrue.shapes import mac

FN = np.array([90.0, 170, 262, 380, 455, 610])
ZETA = np.array([0.010, 0.006, 0.012, 0.004, 0.008, 0.005])
LEVEL, AVERAGES = 0.01, 5.0
SAYS = "the responses disagree about the modes"


def frfs(
    fn: np.ndarray,
    zeta: np.ndarray,
    phi: np.ndarray,
    references: tuple[int, ...],
    seed: int,
) -> FrfSet:
    """Accelerances of modes `fn` (out, m), white noise of 1 % of the rms of each."""
    rng = np.random.default_rng(seed)
    freqs = np.arange(40.0, 700.1, 0.5)
    s, w = 2j * np.pi * freqs[:, None, None], 2 * np.pi * fn
    h = np.einsum(
        "fok,ok,ik->foi",
        s**2 / (s**2 + 2 * zeta * w * s + w**2),
        phi,
        phi[list(references)],
    )
    sigma = LEVEL * np.sqrt(np.mean(np.abs(h) ** 2, axis=0))
    noise = (
        sigma
        * (rng.standard_normal(h.shape) + 1j * rng.standard_normal(h.shape))
        / np.sqrt(2)
    )
    coherence = 1 / (1 + AVERAGES * (sigma / np.abs(h)) ** 2)
    out = tuple(Channel(f"{i}+Z", "acceleration", "m/s^2") for i in range(phi.shape[0]))
    forces = tuple(Channel(f"{i}+Z", "force", "N") for i in references)
    return FrfSet(
        h + noise,
        freqs,
        out,
        forces,
        coherence,
        np.full(len(references), AVERAGES),
        "accelerance",
    )


def shapes(count: int, modes: int, rng: np.random.Generator) -> np.ndarray:
    """Of a simply supported plate of 10 kg, at random places."""
    x, y = rng.uniform(0.05, 0.95, (2, count, 1))
    j, k = np.array(
        [
            (1, 1),
            (1, 2),
            (2, 1),
            (2, 2),
            (1, 3),
            (3, 1),
            (2, 3),
            (3, 2),
            (3, 3),
            (1, 4),
            (4, 1),
            (4, 2),
        ]
    ).T
    phi = np.sin(np.pi * j * x) * np.sin(np.pi * k * y) + 0.1 * rng.standard_normal(
        (count, j.size)
    )
    return np.asarray(2 / np.sqrt(10.0) * phi[:, :modes])


@pytest.mark.parametrize(
    ("references", "shift"), [((0, 5), 0.25), ((0, 5, 7), 0.5), ((0,), 0.25)]
)
def test_one_mode_with_the_scatter_of_the_responses(
    references: tuple[int, ...], shift: float
) -> None:
    rng = np.random.default_rng(11)
    phi = shapes(20, FN.size, rng)
    fn = FN * (1 - 2 * shift * ZETA * rng.uniform(0, 1, (20, FN.size)))
    found = identify_hammer(frfs(fn, ZETA, phi, references, 1))
    modes = found.modes
    assert len(modes) == FN.size, modes.frequencies
    scatter = fn.std(axis=0, ddof=1)
    np.testing.assert_allclose(
        modes.frequencies, fn.mean(axis=0), atol=0.3 * scatter.max()
    )
    np.testing.assert_allclose(
        found.uncertainty.frequency, scatter, rtol=0.3
    )  # responses at nodes count less
    np.testing.assert_allclose(modes.damping, ZETA, rtol=0.02)
    assert np.diag(mac(modes.shapes, phi)).min() > 0.999
    np.testing.assert_allclose(
        np.linalg.norm(modes.shapes, axis=0), np.linalg.norm(phi, axis=0), rtol=0.02
    )
    assert any(n.startswith(SAYS) for n in found.notes)


@pytest.mark.parametrize(
    ("references", "gap"), [((0,), 0.25), ((0,), 1.0), ((0, 5), 0.1), ((0, 5), 0.5)]
)
def test_true_pairs_stay_two(references: tuple[int, ...], gap: float) -> None:
    """A second mode of each, `gap` half-power bandwidths above."""
    phi = shapes(15, 12, np.random.default_rng(3))
    fn = np.concatenate([FN, FN * (1 + 2 * gap * ZETA)])
    found = identify_hammer(
        frfs(np.tile(fn, (15, 1)), np.tile(ZETA, 2), phi, references, 2)
    )
    assert len(found.modes) == fn.size, found.modes.frequencies
    assert not any(n.startswith(SAYS) for n in found.notes)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_roving_sensor_that_begins_at_the_node_of_every_other_mode(seed: int) -> None:
    """One accelerometer on a beam, first at its middle: the batch that leads does not see the modes
    of even order.
    """
    x, order = np.linspace(0.06, 0.94, 13), np.arange(1, FN.size + 1)
    phi = np.asarray(0.6 * np.sin(np.pi * order * x[:, None]))
    load = (phi / 0.6) ** 2
    fn = FN * (1 - ZETA * load)
    data = frfs(fn, ZETA, phi, (3,), seed)
    ids = [c.id for c in data.outputs]
    begin = [6, *(k for k in range(13) if k != 6)]
    batches = [
        replace(
            data,
            data=data.data[:, [k]],
            coherence=data.coherence[:, [k]],
            outputs=(data.outputs[k],),
        )
        for k in begin
    ]
    found = with_local_fits(identify_hammer(data), batches)
    modes = found.modes
    assert len(modes) == FN.size, modes.frequencies
    assert np.all((modes.frequencies > fn.min(axis=0)) & (modes.frequencies < FN))
    np.testing.assert_allclose(modes.damping, ZETA, rtol=0.02)
    row = [ids.index(c) for c in modes.channels]
    assert np.diag(mac(modes.shapes, phi[row])).min() > 0.999
    np.testing.assert_allclose(
        np.linalg.norm(modes.shapes, axis=0), np.linalg.norm(phi, axis=0), rtol=0.02
    )
