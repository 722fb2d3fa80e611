"""Lines between resonances, condensed: the same fit from fewer lines.

Twelve modes at random between 20 and 380 Hz, half-power bandwidths from half a line to a hundred
lines; six responses, two inputs, 4000 lines, noise of 1 %.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ringtrue.core.arrays import Complex
from ringtrue.core.signals import Channel, FrfSet
from ringtrue.identification.frf import refinement as module
from ringtrue.identification.frf.lines import (
    Lines,
    condensed,
    functions_slopes,
    prepare,
    resonances,
)
from ringtrue.identification.frf.residues import noise

LINES, MODES, RESPONSES, INPUTS = 4000, 12, 6, 2
SAME = 1e-5  # of a standard deviation
PRODUCT = 1e-6  # of the norms of two functions, before residual terms come out


def _frfs(
    seed: int, decay: float, *, uneven: bool = False
) -> tuple[FrfSet, Complex, Complex]:
    rng = np.random.default_rng(seed)
    f, zeta = np.sort(rng.uniform(20, 380, MODES)), 10 ** rng.uniform(-3.7, -1.7, MODES)
    poles = 2 * np.pi * f * (-zeta + 1j * np.sqrt(1 - zeta**2))
    shapes, part = (
        rng.standard_normal((RESPONSES, MODES)),
        rng.standard_normal((MODES, INPUTS)),
    )
    freqs = np.arange(1, LINES + 1) * 0.1
    freqs = np.delete(freqs, slice(900, 1100)) if uneven else freqs
    s = 2j * np.pi * freqs + decay
    modes = (
        s[:, None] ** 2
        * (1 / (s[:, None] - poles) - 1 / (s[:, None] - poles.conj()))
        / 2j
    )
    h = np.einsum("fk,ok,ki->foi", modes, shapes, part)
    h += (
        0.01
        * np.median(np.abs(h))
        * (rng.standard_normal(h.shape) + 1j * rng.standard_normal(h.shape))
    )
    out = tuple(
        Channel(f"{k + 1}+Z", "acceleration", "m/s^2") for k in range(RESPONSES)
    )
    given = tuple(Channel(f"{k + 1}+Z", "force", "N") for k in range(INPUTS))
    unknown = np.full(h.shape, np.nan)
    frfs = FrfSet(
        h,
        freqs,
        out,
        given,
        unknown,
        np.full(INPUTS, 5.0),
        "accelerance",
        decay,
        "made",
    )
    start = poles * (1 + 1e-4 * rng.standard_normal(MODES))
    return frfs, start, part + 0.05 * rng.standard_normal(part.shape)


@pytest.mark.parametrize("smooth", [0, 24])
@pytest.mark.parametrize(("decay", "uneven"), [(0.0, False), (0.0, True), (3.0, False)])
def test_products_of_functions_and_data_are_those_of_all_lines(
    decay: float, uneven: bool, smooth: int
) -> None:
    frfs, poles, _ = _frfs(1, decay, uneven=uneven)
    lines = prepare(frfs, noise(frfs), smooth)
    reach = np.abs(poles.real)
    few = condensed(lines, poles, reach)
    assert few.s.size < 0.7 * lines.s.size
    there = poles + 0.9 * reach * np.exp(2j * np.pi * np.arange(MODES) / MODES)
    there = np.minimum(there.real, -1e-3 * np.abs(poles)) + 1j * there.imag
    mine, theirs = (
        np.concatenate(functions_slopes(x, there), axis=1) for x in (few, lines)
    )
    raw = np.concatenate(
        [np.concatenate(resonances(lines, x), axis=1) for x in (there, there.conj())],
        axis=1,
    )
    raw = (
        raw.reshape(-1, 2, 2, MODES).swapaxes(1, 2).reshape(raw.shape)
    )  # in the order of `functions_slopes`
    size, data = (
        np.linalg.norm(lines.weight[:, None] * raw, axis=0)[:, None],
        np.linalg.norm(lines.y, axis=1)[:, None],
    )
    gram = (mine.conj().T @ mine - theirs.conj().T @ theirs) / size / size.T
    assert np.abs(gram).max() < PRODUCT
    assert (
        np.abs((mine.conj().T @ few.y - theirs.conj().T @ lines.y) / size / data).max()
        < PRODUCT
    )


@pytest.mark.parametrize("seed", range(3))
def test_the_fit_is_that_of_all_lines(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    frfs, poles, part = _frfs(seed, 0.0)
    lines = prepare(frfs, noise(frfs))
    fit = module.refine(lines, poles, part)

    def all_of_them(lines: Lines, *_: object) -> Lines:
        return lines

    monkeypatch.setattr(module, "condensed", all_of_them)
    full = module.refine(lines, poles, part)
    std = np.hypot(
        full.std_frequency, np.abs(full.poles) * full.std_damping / (2 * np.pi)
    )
    assert (np.abs(fit.poles - full.poles) < SAME * 2 * np.pi * std).all()
    np.testing.assert_allclose(fit.std_frequency, full.std_frequency, rtol=SAME)
    np.testing.assert_allclose(
        fit.shapes, full.shapes, atol=SAME * np.abs(full.shapes).max()
    )


def test_lines_stay_where_the_block_cuts_responses_off() -> None:
    frfs, poles, _ = _frfs(0, 0.0)
    lines = prepare(replace(frfs, kept=8.0), noise(frfs))
    assert condensed(lines, poles, np.abs(poles.real)) is lines
