"""Families of ambient records that set no threshold: is every mode found, and nothing else?

    python bench/ambient_families.py mixed      velocities beside accelerations, without units
    python bench/ambient_families.py close      24 modes in pairs 1.5 % from each other, two channels at 0 dB
    python bench/ambient_families.py short      records of 60 periods of the first mode
    python bench/ambient_families.py machine    combs of 50 to 200 harmonics whose speed wanders by up to 0.3 %
    python bench/ambient_families.py decay      free decays of six modes that last 0.1 to 10 s
    python bench/ambient_families.py drops      ambient records with a weight dropped at equal intervals, each time elsewhere
    python bench/ambient_families.py setups     frames of 15 setups, velocities beside accelerations, without units

each with [--quick | --full]. Records are made from chains and random shapes under white forces, with
default settings identified, and compared with their modes: a mode is found where one within four
standard deviations of the least scatter, and 0.5 % at least, has its shape (MAC 0.8); one of a
free decay within 0.1 %, one of a record with drops within 3 %, as few periods lie between two.
Times are CPU seconds. Not covered: measured records (records.py), forces with peaks, setups with
drops.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from outcome import (
    Check,
    Report,
    arguments,
    at_most,
    rms_over_stated,
    share_at_least,
    share_within,
    sized,
)

import ringtrue as rt
from ringtrue.core.arrays import Complex, Float, Int
from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.identification.ambient.pipeline import AmbientResult
from ringtrue.identification.common.stabilisation import least_deviations
from ringtrue.shapes import mac


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """A record and its modes: frequencies (m,) Hz, damping (m,), shapes (ch, m); the speed of a
    machine, Hz, 0 for none; how near a mode must be found, relative to it, 0 for as the record
    allows; the records of all setups, where there are several.
    """

    record: TimeHistory
    frequency: Float
    damping: Float
    shape: Float
    speed: float = 0.0
    near: float = 0.0
    setups: tuple[TimeHistory, ...] = ()


def responses(
    frequency: Float,
    damping: Float,
    force: Float,
    seconds: float,
    rate: float,
    seed: int,
) -> tuple[Complex, Float]:
    """Spectra (m, line) of modal displacements under white forces, and ω (line,): of twice the
    record, whose middle is taken.
    """
    rng = np.random.default_rng(seed)
    omega = 2 * np.pi * np.fft.rfftfreq(2 * int(seconds * rate), 1 / rate)
    inputs = rng.standard_normal((2, len(force), omega.size))
    white = inputs[0] + 1j * inputs[1]
    own = (2 * np.pi * frequency)[:, None]
    stiffness = own**2 - omega**2 + 2j * damping[:, None] * own * omega
    return (force.T @ white) / stiffness, omega


def signals(spectra: Complex, snr: Float, seed: int) -> Float:
    """(ch, sample) the middle half, with white noise at `snr` (ch,) dB."""
    rng = np.random.default_rng(seed)
    spectra[:, 0] = 0
    whole = np.fft.irfft(spectra, axis=1)
    n = whole.shape[1] // 2
    y = whole[:, n // 2 : n // 2 + n]
    noise = rng.standard_normal(y.shape) * y.std(axis=1, keepdims=True)
    return np.asarray(y + noise * 10 ** (-snr[:, None] / 20))


def chain(modes: int, rng: np.random.Generator) -> tuple[Float, Float]:
    """Frequencies over the first, and shapes, of a shear chain of random storeys."""
    k = rng.uniform(0.7, 1.4, modes)
    m = rng.uniform(0.8, 1.3, modes)
    stiffness = (
        np.diag(k + np.append(k[1:], 0)) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    )
    squares, shapes = np.linalg.eigh(stiffness / np.sqrt(np.outer(m, m)))
    return np.sqrt(squares / squares[0]), shapes / np.sqrt(m)[:, None]


def record(y: Float, rate: float, quantity: str) -> TimeHistory:
    """A record of channels of one quantity, or of unknown ones."""
    unit = "m/s^2" if quantity == "acceleration" else ""
    names = tuple(Channel(f"{i + 1}+X", quantity, unit) for i in range(len(y)))  # type: ignore[arg-type]
    return TimeHistory(y, rate, names, "made")


def mixed(seed: int) -> Made:
    """Eleven modes; three velocities and five accelerations in units of their own."""
    rng = np.random.default_rng([11, seed])
    f, phi = chain(11, rng)
    f = f * rng.uniform(2, 6)
    z = rng.uniform(0.004, 0.015, 11)
    shape = phi[rng.permutation(11)[:8]]
    rate = 3.1 * f[-1]
    q, omega = responses(f, z, phi[rng.permutation(11)[:6]], 1200 / f[0], rate, seed)
    order = np.array([1, 1, 1, 2, 2, 2, 2, 2])
    spectra = (shape @ q) * (1j * omega) ** order[:, None]
    gain = rng.uniform(0.2, 5, 8)[:, None]
    y = gain * signals(spectra, np.full(8, 40.0), seed)
    return Made(record(y, rate, "unknown"), f, z, gain * shape)


def close(seed: int) -> Made:
    """A tower of twelve storeys: each mode in two directions, 1.5 % from each other."""
    rng = np.random.default_rng([12, seed])
    first, phi = chain(12, rng)
    first = first * rng.uniform(0.5, 1.5)
    f = np.concatenate([first, first * (1 + 0.015 * rng.uniform(0.9, 1.1, 12))])
    angle = rng.uniform(-0.5, 0.5, 12)
    cos, sin = phi * np.cos(angle), phi * np.sin(angle)
    shape = np.block([[cos, -sin], [sin, cos]])
    rank = np.argsort(f)
    f, shape = f[rank], shape[:, rank]
    z = rng.uniform(0.006, 0.012, 24)
    snr = np.full(24, 30.0)
    snr[rng.permutation(24)[:2]] = 0.0
    rate = 2.6 * f[-1]
    q, omega = responses(f, z, shape, 3600.0, rate, seed)
    y = signals(-(shape @ q) * omega**2, snr, seed)
    return Made(record(y, rate, "acceleration"), f, z, shape)


def short(seed: int) -> Made:
    """Five modes in 60 periods of the first."""
    rng = np.random.default_rng([13, seed])
    f, phi = chain(5, rng)
    f = f * rng.uniform(0.8, 3)
    z = rng.uniform(0.008, 0.02, 5)
    rate = 3 * f[-1]
    q, omega = responses(f, z, phi, 60 / f[0], rate, seed)
    y = signals(-(phi @ q) * omega**2, np.full(5, 30.0), seed)
    return Made(record(y, rate, "acceleration"), f, z, phi)


def machine(seed: int) -> Made:
    """Modes of random shapes, half of them 1 % from a harmonic of a machine."""
    rng = np.random.default_rng([14, seed])
    rate = 10 ** rng.uniform(2.6, 3.5)
    top = rate / 2.6
    speed = max(top / rng.uniform(50, 200), 3.0)
    f = rng.uniform(2 * speed, 0.9 * top, rng.integers(5, 10))
    order = np.maximum(np.round(f / speed), 1)
    beside = order * speed * (1 + 0.01 * rng.choice([-1, 1], f.size))
    f = np.sort(np.where(rng.random(f.size) < 0.5, beside, f))
    f = f[np.diff(f, prepend=0.0) > 0.03 * f]
    z = rng.uniform(0.005, 0.02, f.size)
    channels = int(rng.integers(5, 10))
    shape = rng.standard_normal((channels, f.size))
    seconds = min(600.0, 400_000 / rate)
    q, omega = responses(
        f, z, rng.standard_normal((f.size + 2, f.size)), seconds, rate, seed
    )
    y = signals(-(shape @ q) * omega**2, np.full(channels, 35.0), seed)
    lines = np.fft.rfftfreq(y.shape[1], 1 / rate)
    slow = np.exp(-0.5 * (lines * rng.uniform(10, 60)) ** 2)
    drift = rng.standard_normal(lines.size) + 1j * rng.standard_normal(lines.size)
    drift[0] = 0
    wander = np.fft.irfft(slow * drift, y.shape[1])
    wander *= rng.choice([0.0, 0.001, 0.003]) / wander.std()
    turns = 2 * np.pi * np.cumsum(speed * (1 + wander)) / rate
    comb = np.zeros(y.shape[1])
    for k in range(1, int(min(top / speed, 200)) + 1):  # harmonics
        comb += 10 ** rng.uniform(-0.7, 0) * np.cos(
            k * turns + rng.uniform(0, 2 * np.pi)
        )
    level = 10 ** rng.uniform(-1, -0.2) * y.std() / comb.std()
    y = y + level * rng.standard_normal((channels, 1)) * comb
    return Made(record(y, rate, "acceleration"), f, z, shape, speed)


def decay(seed: int) -> Made:
    """Up to three impacts without a measured force; a decay lasts as long as it takes to 60 dB."""
    rng = np.random.default_rng([15, seed])
    f = np.sort(10 ** rng.uniform(0.9, 2.9, 6))
    f = f[0] * np.cumprod(np.maximum(f / np.roll(f, 1), 1.03) ** (np.arange(6) > 0))
    lasts = np.clip(10 ** rng.uniform(-1, 1, 6), 50 / f, 10)  # of 50 cycles at least
    z = np.log(1000) / (2 * np.pi * f * lasts)
    channels = int(rng.integers(2, 8))
    shape = rng.standard_normal((channels, 6))
    rate = 2.6 * f[-1]
    impacts = int(rng.integers(1, 4))
    apart = 1.2 * lasts.max()
    before = int(0.5 * rate)
    y = np.zeros((channels, before + int(impacts * apart * rate)))
    poles = 2 * np.pi * f * (-z + 1j * np.sqrt(1 - z**2))
    for k in range(impacts):
        start = before + int(k * apart * rate)
        t = np.arange(y.shape[1] - start) / rate
        size = rng.uniform(0.5, 1.5, 6) * rng.choice([-1, 1], 6)
        y[:, start:] += ((shape * size) @ np.exp(poles[:, None] * t)).imag
    y += 1e-3 * np.abs(y).max() * rng.standard_normal(y.shape)
    return Made(record(y, rate, "acceleration"), f, z, shape, near=1e-3)


def drops(seed: int) -> Made:
    """Eight modes; drops on one storey after another, and white forces of a share of their motion."""
    rng = np.random.default_rng([17, seed])
    f, phi = chain(8, rng)
    f = f * rng.uniform(2, 8)
    z = rng.uniform(0.004, 0.015, 8)
    rate = rng.uniform(4, 6) * f[-1]
    apart = rng.uniform(5, 40) / f[0]
    seconds = rng.uniform(60, 150) * apart
    q, omega = responses(f, z, phi, seconds, rate, seed)
    at = (np.arange(0.5 * apart, 2 * seconds, apart) * rate).astype(np.int64)
    force = np.zeros((8, 2 * omega.size - 2))
    force[rng.integers(0, 8, at.size), at] = rng.uniform(0.7, 1.3, at.size)
    own = (2 * np.pi * f)[:, None]
    stiffness = own**2 - omega**2 + 2j * z[:, None] * own * omega
    dropped = (phi.T @ np.fft.rfft(force, axis=1)) / stiffness
    share = 10 ** rng.uniform(-2, 0) * np.linalg.norm(dropped) / np.linalg.norm(q)
    y = signals(-(phi @ (dropped + share * q)) * omega**2, np.full(8, 40.0), seed)
    return Made(record(y, rate, "acceleration"), f, z, phi, near=0.03)


def frame(rng: np.random.Generator) -> tuple[Float, Float]:
    """Frequencies over the first (24,), ascending, and shapes (64, 24) of eight floors that move in
    two directions and turn: two directions at four corners of each.
    """
    storeys, phi = chain(8, rng)
    corners = np.array([[-1, -0.8], [1, -0.8], [1, 0.8], [-1, 0.8]])
    apart = np.array([1.0, rng.uniform(1.03, 1.15), rng.uniform(1.3, 1.6)])
    beside = np.eye(3) + rng.uniform(-0.25, 0.25, (3, 3))
    across, along, turn = beside.T
    moves = np.stack(
        [across - np.outer(corners[:, 1], turn), along + np.outer(corners[:, 0], turn)],
        axis=1,
    )
    f = np.outer(storeys, apart).ravel()
    shape = np.einsum("sm,cdk->scdmk", phi, moves).reshape(64, 24)
    rank = np.argsort(f)
    return f[rank], shape[:, rank]


def setups(seed: int) -> Made:
    """Eleven modes of a frame: 15 setups of five minutes with two to four references."""
    rng = np.random.default_rng([16, seed])
    f, phi = frame(rng)
    # nearer ones no setup would separate
    while (np.diff(f[:11]) / f[:10]).min() < 0.012:
        f, phi = frame(rng)
    f = f[:11] * rng.uniform(1.5, 5)
    phi = phi[:, :11]
    z = rng.uniform(0.004, 0.015, 11)
    rate = 2.7 * f[-1]
    references = np.array([56, 57, 61, 34])[: rng.integers(2, 5)]
    places = np.setdiff1d(rng.permutation(64), references)
    order = rng.integers(1, 3, 64)
    records = []
    for k, moved in enumerate(np.array_split(rng.permutation(places), 15)):
        at = np.append(references, moved)
        force = rng.standard_normal((8, 11)) * rng.uniform(0.3, 1.5, 11)
        changed = f * (1 + 4e-4 * rng.standard_normal(11))  # by temperature
        q, omega = responses(changed, z, force, 300.0, rate, 100 * seed + k)
        spectra = (phi[at] @ q) * (1j * omega) ** order[at, None]
        names = tuple(Channel(f"{i + 1}+X") for i in at.tolist())
        y = signals(spectra, np.full(at.size, 40.0), 100 * seed + k)
        records.append(TimeHistory(y, rate, names, f"setup {k + 1}"))
    listed = dict.fromkeys(c.id for x in records for c in x.channels)
    rows = [int(name.split("+")[0]) - 1 for name in listed]
    return Made(records[0], f, z, phi[rows], setups=tuple(records))


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What was found of one record: modes of it, others, errors over their deviations; MAC of the
    shapes, and how many of their values are missing.
    """

    found: int
    of: int
    extra: int
    doubtful: int
    first: bool
    frequency: Float
    damping: Float
    speed: float
    seconds: float
    mac: Float
    missing: int


def paired(made: Made, test: rt.TestModes) -> tuple[Int, Int, Float]:
    """Modes of the truth (p,) and of the test (p,) that are each other, and the MAC of all."""
    least, _ = least_deviations(made.frequency, made.damping, made.record.duration)
    reach = np.maximum(4 * least, 0.005 * made.frequency)
    if made.near:
        reach = made.near * made.frequency
    off = np.abs(made.frequency[:, None] - test.frequencies)
    like = mac(made.shape.astype(complex), np.nan_to_num(test.shapes))
    score = np.where(
        (off < reach[:, None]) & (like > 0.8), off / reach[:, None], np.inf
    )
    pairs = []
    while np.isfinite(score.min(initial=np.inf)):
        i, j = np.unravel_index(score.argmin(), score.shape)
        pairs.append((i, j))
        score[i] = np.inf
        score[:, j] = np.inf
    at, to = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    return at, to, like


def outcome(made: Made) -> Outcome:
    """Identify a record and compare."""
    begin = time.process_time()
    if made.setups:
        test = rt.identify_ambient_setups(made.setups)
    else:
        test = rt.identify_ambient(made.record)
    seconds = time.process_time() - begin
    at, to, like = paired(made, test)
    machines = test.result.machines if isinstance(test.result, AmbientResult) else ()
    speeds = np.array([m.frequency for m in machines])
    wrong = np.abs(speeds / made.speed - 1).min(initial=np.inf) if made.speed else 0.0
    return Outcome(
        at.size,
        made.frequency.size,
        len(test) - at.size,
        len(test.others),
        bool((at == 0).any()),
        (test.frequencies[to] - made.frequency[at]) / test.std_frequency[to],
        (test.damping[to] - made.damping[at]) / test.std_damping[to],
        float(wrong),
        seconds,
        like[at, to],
        int(np.isnan(test.shapes).sum()),
    )


# least share found, records
FAMILIES: dict[str, tuple[Callable[[int], Made], float, int]] = {
    "mixed": (mixed, 0.98, 80),
    "close": (close, 23.5 / 24, 16),
    "short": (short, 0.95, 240),
    "machine": (machine, 0.97, 80),
    "decay": (decay, 0.99, 80),
    "drops": (drops, 0.97, 80),
    "setups": (setups, 0.98, 16),
}
HELD = 0.93, 0.97  # of intervals of 95 %
FIRST_SEED = 1000  # those below were looked at when the statistic was made


def checks(family: str, every: list[Outcome]) -> list[Check]:
    """What is right of the records of a family."""
    records = len(every)
    _, least, _ = FAMILIES[family]
    found = sum(x.found for x in every)
    judged = [
        share_at_least("modes found", found, sum(x.of for x in every), least),
        at_most(
            "others among the modes, a record",
            sum(x.extra for x in every) / records,
            0.1,
        ),
    ]
    for what in ("frequency", "damping"):
        errors = np.concatenate([getattr(x, what) for x in every])
        held = int((np.abs(errors) < 1.96).sum())
        judged += [
            rms_over_stated(what, errors),
            share_within(f"{what} held by 95 %", held, errors.size, *HELD),
        ]
    if family == "short":
        first = sum(x.first for x in every)
        judged.append(
            share_at_least("records with their first mode", first, records, 0.95)
        )
    if family == "machine":
        right = sum(x.speed < 1e-3 for x in every)
        judged.append(share_at_least("speeds within 0.1 %", right, records, 0.95))
    if family == "setups":
        good = int(sum((x.mac > 0.997).sum() for x in every))
        judged.append(share_at_least("shapes of MAC above 0.997", good, found, 0.95))
        missing = float(sum(x.missing for x in every))
        judged.append(at_most("missing values of shapes", missing, 0))
    return judged


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("family", choices=sorted(FAMILIES))
    options = parser.parse_args()
    make, _, records = FAMILIES[options.family]
    records = sized(options, records // 8, records, 4 * records)
    every = [outcome(make(FIRST_SEED + k)) for k in range(records)]
    modes = sum(x.of for x in every)
    report = Report(options)
    doubtful = sum(x.doubtful for x in every) / records
    what = f"{records} records, {modes} modes; doubtful or harmonic besides: {doubtful:.2g} a record"
    mean = float(np.mean([x.seconds for x in every]))
    report.row(
        f"family `{options.family}`: {what}",
        {"s a record": mean},
        checks(options.family, every),
    )
    report.end()


if __name__ == "__main__":
    sys.exit(main())
