"""The confidence of ambient modes: whether it is what it states, and its weights fitted anew.

    python bench/confidence.py [--quick | --full]

Candidates of random records (chains, close pairs, random shapes; noise at 5 to 40 dB, coloured forces
with humps, records of noise alone; half of them short and of little damping) are weighed as
`identify_ambient` does. A candidate is a mode where the record has one within four standard
deviations of the least scatter, or a quarter of its half bandwidth, of the same shape (MAC 0.8). The
weights are fitted anew to one half of the records by logistic regression, for comparison, also
without the evidence of other estimators than SSI-cov. On the other half, modes stated at 0.9 and
more must be real in nine of ten cases. Not covered: machines and peaks of the force, which other
evidence names.
"""

from __future__ import annotations

import sys
from dataclasses import fields

import numpy as np
from ambient_families import chain, record, responses, signals
from outcome import Check, Report, arguments, at_least, share_at_least, sized
from scipy.special import expit

from ringtrue.core.arrays import Bool, Float
from ringtrue.core.iterate import quiet
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import DataError
from ringtrue.identification.ambient.confidence import WEIGHTS
from ringtrue.identification.ambient.pipeline import AmbientSettings, weighed_candidates
from ringtrue.identification.common.stabilisation import least_deviations
from ringtrue.shapes import mac

NAMES = [field.name for field in fields(WEIGHTS)]


def structure(rng: np.random.Generator) -> tuple[Float, Float]:
    """Frequencies (m,) Hz and shapes (dof, m)."""
    modes = int(rng.integers(2, 13))
    f, phi = chain(max(modes, 6), rng)
    f, phi = f[:modes] * 10 ** rng.uniform(-0.5, 1), phi[:, :modes]
    kind = rng.choice(["chain", "pairs", "frame"], p=[0.45, 0.33, 0.22])
    if kind == "frame":
        own = np.sort(rng.uniform(0.5, 5) * 10 ** rng.uniform(0, 1.2, modes))
        return own, rng.standard_normal((14, modes))
    if kind == "pairs":
        angle = rng.uniform(-0.6, 0.6, modes)
        both = np.concatenate([f, f * (1 + rng.uniform(0.003, 0.05, modes))])
        cos, sin = phi * np.cos(angle), phi * np.sin(angle)
        return both, np.block([[cos, -sin], [sin, cos]])
    return f, phi


def made(seed: int) -> tuple[TimeHistory, Float, Float, Float]:
    """A record with its frequencies, damping ratios and shapes; none of noise alone."""
    rng = np.random.default_rng([100, seed])
    f, phi = structure(rng)
    short = seed % 2 == 0
    z = (
        10 ** rng.uniform(-3.3, -2, f.size)
        if short
        else rng.uniform(0.003, 0.03, f.size)
    )
    shape = phi[rng.permutation(len(phi))[: int(rng.integers(3, 13))]]
    rate = rng.uniform(2.2, 5) * f.max()
    periods = 10 ** (rng.uniform(1.7, 2.4) if short else rng.uniform(1.75, 3.3))
    seconds = min(max(periods / f.min(), 600 / rate), 120_000 / rate)
    inputs = phi[rng.permutation(len(phi))[: int(rng.integers(2, len(phi) + 1))]]
    q, omega = responses(f, z, inputs, seconds, rate, seed)
    colour = np.maximum(omega / (2 * np.pi * f.min()), 1e-3) ** rng.uniform(-0.7, 0.3)
    for _ in range(int(rng.integers(0, 4))):  # humps of the force
        centre = 2 * np.pi * 10 ** rng.uniform(np.log10(f.min() / 2), np.log10(f.max()))
        width = rng.uniform(0.05, 0.3) * centre
        hump = np.exp(-0.5 * ((omega - centre) / width) ** 2)
        colour = colour * (1 + 10 ** rng.uniform(0, 1.2) * hump)
    noise = rng.random() < 0.1
    if noise:
        white = rng.standard_normal((len(shape), 2, omega.size))
        spectra = rng.standard_normal((len(shape),) * 2) @ (
            white[:, 0] + 1j * white[:, 1]
        )
    else:
        spectra = -(shape @ q) * omega**2
    snr = np.full(len(shape), rng.uniform(5, 40))
    if rng.random() < 0.3:
        snr[rng.integers(len(shape))] = -5.0
    y = signals(spectra * colour, snr, seed)
    there = 0 if noise else f.size
    return record(y, rate, "acceleration"), f[:there], z[:there], shape[:, :there]


def weighed(seed: int) -> tuple[Float, Bool, int]:
    """Evidence (k, 6) of candidates over its weights, which are modes, and how many modes there are.
    Of several candidates for one mode the most confident counts.
    """
    history, f, z, shape = made(seed)
    try:
        found = weighed_candidates([history], AmbientSettings(), None, quiet).found
    except DataError:  # too short
        return np.empty((0, len(NAMES))), np.empty(0, dtype=np.bool_), 0
    weights = np.array([getattr(WEIGHTS, name) for name in NAMES[1:]])
    least, _ = least_deviations(f, z, history.duration)
    reach = np.maximum(4 * least, 0.25 * z * f)
    rows = []
    real = []
    best: dict[int, tuple[float, int]] = {}
    for band in found:
        # a pair that stands for one candidate leaves it no orders
        for k in np.flatnonzero(band.table.orders[:, 0]):
            near = np.abs(band.table.frequencies[k] - f) < reach
            like = (
                mac(shape.astype(complex), band.shape[:, [k]])[:, 0] if f.size else near
            )
            own = np.where(near & (like > 0.8), like, 0.0)
            rows.append(np.append(1.0, band.evidence[:, k] / weights))
            real.append(False)
            if own.max(initial=0.0) > 0:
                mode = int(own.argmax())
                before = best.get(mode)
                if before is not None and before[0] >= band.confidence[k]:
                    rows.pop()
                    real.pop()
                    continue
                if before is not None:
                    real[before[1]] = False
                    rows[before[1]] = np.full(len(NAMES), np.nan)
                real[-1] = True
                best[mode] = float(band.confidence[k]), len(rows) - 1
    x = np.array(rows).reshape(-1, len(NAMES))
    kept = np.isfinite(x).all(axis=1)
    return x[kept], np.array(real, dtype=np.bool_)[kept], f.size


def fitted(x: Float, real: Bool) -> Float:
    """Weights of a logistic regression on `x` (k, evidence), by Newton's method."""
    w = np.zeros(x.shape[1])
    for _ in range(50):
        p = expit(x @ w)
        hessian = x.T @ (x * (p * (1 - p))[:, None]) + 1e-2 * np.eye(w.size)
        w = w + np.linalg.solve(hessian, x.T @ (real - p) - 1e-2 * w)
    return w


def area_under_curve(score: Float, real: Bool) -> float:
    """Chance that a mode scores more than what is none."""
    rank = np.empty(score.size)
    rank[np.argsort(score)] = np.arange(score.size)
    return float((rank[real].mean() - rank[~real].mean()) / score.size + 0.5)


def checks(stated: Float, anew: Float, alone: Float, real: Bool) -> list[Check]:
    """What is right of the confidence (k,) of candidates: stated, with weights fitted anew, and
    without other estimators.
    """
    high = stated >= 0.9
    natural = stated >= 0.5
    shown = [
        share_at_least(
            "real of those stated at 0.9 and more", real[high].sum(), high.sum(), 0.9
        ),
        share_at_least("modes that are natural", natural[real].sum(), real.sum(), 0.85),
        share_at_least("real of the natural", real[natural].sum(), natural.sum(), 0.85),
    ]
    for what, score in (
        ("area under the curve", stated),
        ("the same, weights anew", anew),
        ("the same, without other estimators", alone),
    ):
        shown.append(at_least(what, area_under_curve(score, real), 0.95))
    return shown


def main() -> None:
    options = arguments(__doc__).parse_args()
    records = sized(options, 30, 240, 1000)
    every = [weighed(seed) for seed in range(records)]
    train = every[: records // 2]
    test = every[records // 2 :]
    x, real = (np.concatenate([part[k] for part in train]) for k in (0, 1))
    w = fitted(x, real)
    w_alone = fitted(x[:, :-1], real)
    x, real = (np.concatenate([part[k] for part in test]) for k in (0, 1))
    stated = expit(x @ np.array([getattr(WEIGHTS, name) for name in NAMES]))
    anew = expit(x @ w)
    alone = expit(x[:, :-1] @ w_alone)
    report = Report(options)
    listed = ", ".join(
        f"{name} {value:.2f}" for name, value in zip(NAMES, w, strict=True)
    )
    report.row(
        f"{records} records, {real.size} candidates of the held-out half; weights anew: {listed}",
        {},
        checks(stated, anew, alone, real),
    )
    report.end()


if __name__ == "__main__":
    sys.exit(main())
