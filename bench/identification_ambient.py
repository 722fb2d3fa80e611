"""Ambient identification: time, accuracy, stated uncertainty and memory, against the truth.

    python bench/identification_ambient.py accuracy       records of an hour, 16 channels, half of them of complex modes
    python bench/identification_ambient.py frame          a second structure: a chain of ten storeys
    python bench/identification_ambient.py uncertainty    records of 1000 periods of the lowest mode
    python bench/identification_ambient.py pairs          records of 3600 and of 12600 cycles of an equal pair
    python bench/identification_ambient.py stream         64 channels at 200 Hz, from HDF5, by half hours

each with [--quick | --full]. The system is that of identification_system.py. Times are CPU seconds.
Scatter is judged against its floor, which no method can pass: σ_f/f = sqrt(ζ/(2π f T)), σ_ζ/ζ =
sqrt(1/(2π ζ f T)). Not covered: measured records, non-white forces; peers are in
identification_peers.py.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import h5py
import identification_system as system
import numpy as np
from outcome import (
    HELD_LEAST,
    Check,
    Peer,
    Report,
    arguments,
    at_least,
    at_most,
    rms_over_stated,
    share_at_least,
    sized,
)
from scipy.fft import rfft
from scipy.signal import lfilter

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "verification"))
import test_oma_pairs as equal

from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.identification.ambient.pipeline import (
    AmbientResult,
    identify_ambient,
    identify_stretches,
)

HOUR = 3600.0  # s
OVER_FLOOR = (
    # error over its floor, root mean square over many records: close modes share their data
    1.35
)
# of an hour: the pair at 1.85 and 1.90 Hz is told apart no better in one record of a hundred
MAC_LEAST = 0.985


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """Of the modes of one record.

    Attributes
    ----------
    found, stated : (2, mode) float64
        Errors of ln f and ln ζ and their stated deviations.
    shapes : (component,) float64
        Errors over stated deviations.
    extra : int
        Modes that are not there.
    """

    found: np.ndarray
    stated: np.ndarray
    shapes: np.ndarray
    extra: int


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """What was found in a record of the system, and the (15,) floors of its errors in %."""

    seconds: float
    score: system.Score
    f_floor: np.ndarray
    z_floor: np.ndarray


def history(y: np.ndarray, rate: float) -> TimeHistory:
    """(ch, sample) accelerations."""
    return TimeHistory(
        y,
        rate,
        tuple(Channel(f"{i + 1}+Z", "acceleration") for i in range(len(y))),
        "made",
    )


def timed(work: Callable[[], AmbientResult]) -> tuple[float, AmbientResult]:
    """CPU seconds and result."""
    t = time.process_time()
    r = work()
    return time.process_time() - t, r


def record(seed: int) -> Record:
    """An hour of 16 channels; odd seeds have complex modes."""
    complex_modes = bool(seed % 2)
    h = history(system.ambient(16, 60, seed, complex_modes).T, system.FS)
    true = system.truth(system.SIXTEEN, complex_modes)
    seconds, r = timed(lambda: identify_ambient(h))
    got = system.score(r.modes.frequencies, r.modes.damping, r.modes.shapes, true)
    floor = scatter_floor(true.frequencies, true.damping, HOUR)
    return Record(seconds, got, 100 * floor[0], 100 * floor[1])


def scatter_floor(f: np.ndarray, zeta: np.ndarray, seconds: float) -> np.ndarray:
    """(2, mode) least scatter of ln f and ln ζ that any method has over a record."""
    turns = 2 * np.pi * f * seconds
    return np.array([np.sqrt(zeta / turns), np.sqrt(1 / (zeta * turns))])


def over_floor(what: str, errors: np.ndarray) -> Check:
    """Errors over the floors of their scatter."""
    return rms_over_stated(f"error over floor, {what}", errors, 0.8, OVER_FLOOR)


def accurate(records: list[Record]) -> list[Check]:
    """All modes, no other ones, with errors near the floor."""
    return [
        at_least(
            "modes found in each", min(r.score.found for r in records), system.BAND
        ),
        at_most("extra", max(r.score.extra for r in records), 0),
        over_floor(
            "frequency", np.concatenate([r.score.f / r.f_floor for r in records])
        ),
        over_floor("damping", np.concatenate([r.score.z / r.z_floor for r in records])),
        at_least("MAC", min(r.score.mac.min() for r in records), MAC_LEAST),
    ]


def accuracy(report: Report, count: int) -> None:
    """The system of the benchmarks."""
    records = [record(seed) for seed in range(count)]
    for name, some in (("real", records[::2]), ("complex", records[1::2])):
        cost = {
            "s": min(r.seconds for r in some),
            "% of frequency": system.rms(np.concatenate([r.score.f for r in some])),
            "% of damping": system.rms(np.concatenate([r.score.z for r in some])),
        }
        report.row(
            f"15 modes, {name}, in {len(some)} records of an hour, 16 channels",
            cost,
            accurate(some),
        )


class Frame:
    """A chain of ten equal storeys, fixed at the base, with 1 % and 2 % damping by turns; f_1 =
    0.75 Hz.
    """

    rate = 50.0

    def __init__(self) -> None:
        k = 2 * np.eye(10) - np.eye(10, k=1) - np.eye(10, k=-1)
        k[-1, -1] = 1
        w2, self.shapes = np.linalg.eigh(k)
        self.f = 0.75 * np.sqrt(w2 / w2[0])
        self.zeta = np.where(np.arange(10) % 2, 0.02, 0.01)

    def record(self, seed: int, seconds: float) -> np.ndarray:
        """Accelerations (10, sample) for white forces at every floor, sensor noise 20 dB below."""
        rng, w, lead = (
            np.random.default_rng(seed),
            2 * np.pi * self.f,
            int(80 * self.rate),
        )
        q = []
        for s in -self.zeta * w + 1j * w * np.sqrt(1 - self.zeta**2):
            force, a = (
                rng.standard_normal(int(seconds * self.rate) + lead),
                np.exp(s / self.rate),
            )
            z = lfilter([0, (a - 1) / s], [1, -a], force)
            q.append(
                2 * np.real(s**2 / (2j * s.imag) * z)
                + 2 * np.real(s / (2j * s.imag)) * force
            )
        y = self.shapes @ np.array(q)[:, lead:]
        return y + 0.1 * y.std(1, keepdims=True) * rng.standard_normal(y.shape)

    def errors(self, r: AmbientResult) -> Errors:
        """Against the truth; NaN for a mode that is not found."""
        like = np.abs(r.modes.frequencies[:, None] / self.f - 1)
        at = like.argmin(0) if len(r.modes) else np.full(10, -1)
        lost = like.min(0, initial=1.0) > 0.03
        f, z = r.modes.frequencies[at], r.modes.damping[at]
        e = np.array([np.log(f / self.f), np.log(z / self.zeta)])
        s = np.array([r.uncertainty.frequency[at] / f, r.uncertainty.damping[at] / z])
        psi = r.modes.shapes[:, at]
        top = np.abs(psi).argmax(0)
        free = np.arange(10)[:, None] != top
        stated = np.where(free, r.uncertainty.shape[:, at], 1.0)
        gap = (np.abs(psi) - np.abs(self.shapes / self.shapes[top, range(10)])) / stated
        e[:, lost], s[:, lost], gap[:, lost] = np.nan, np.nan, np.nan
        return Errors(e, s, gap[free], len(r.modes) - int((~lost).sum()))


def near_floor(each: list[Errors], floor: np.ndarray) -> list[Check]:
    """All modes, no other ones, with a scatter near its floor."""
    e = np.array([x.found for x in each])
    found = int(np.isfinite(e[:, 0]).sum())
    return [
        share_at_least("modes found", found, e[:, 0].size, 0.99),
        at_most("extra, most", max(x.extra for x in each), 0),
        over_floor("frequency", e[:, 0] / floor[0]),
        over_floor("damping", e[:, 1] / floor[1]),
    ]


def frame(report: Report, count: int) -> None:
    """The second structure, one hour."""
    chain = Frame()
    each, seconds = [], []
    for seed in range(count):
        h = history(chain.record(seed, HOUR), chain.rate)
        t, r = timed(lambda h=h: identify_ambient(h))
        each.append(chain.errors(r))
        seconds.append(t)
    what = f"10 modes of a chain of storeys in {count} records of an hour"
    report.row(
        what,
        {"s": min(seconds)},
        near_floor(each, scatter_floor(chain.f, chain.zeta, HOUR)),
    )


def honest(each: list[Errors]) -> list[Check]:
    """Whether intervals hold what they say."""
    e, s = np.array([x.found for x in each]), np.array([x.stated for x in each])
    shapes = np.concatenate([x.shapes for x in each])
    shapes = shapes[np.isfinite(shapes)]
    out = [
        share_at_least(
            "modes found", int(np.isfinite(e[:, 0]).sum()), e[:, 0].size, 0.99
        )
    ]
    for name, k in (("frequency", 0), ("damping", 1)):
        there = np.isfinite(e[:, k])
        gap = (e[:, k] / s[:, k])[there]
        out.append(
            share_at_least(
                f"{name} held", int((np.abs(gap) < 1.96).sum()), gap.size, HELD_LEAST
            )
        )
        out.append(rms_over_stated(f"error over stated deviation, {name}, rms", gap))
    held = int((np.abs(shapes) < 1.96).sum())
    return [*out, share_at_least("shapes held", held, shapes.size, HELD_LEAST)]


def uncertainty(report: Report, count: int) -> None:
    """Coverage over records of 1000 periods of the lowest mode of the chain."""
    chain = Frame()
    seconds = 1000 / chain.f[0]
    each = [
        chain.errors(identify_ambient(history(chain.record(seed, seconds), chain.rate)))
        for seed in range(count)
    ]
    report.row(f"{count} records of 1000 periods: intervals of 95 %", {}, honest(each))


@dataclass(frozen=True, slots=True)
class Pairs:
    """Records of two equal modes beside a third: how many show both, modes that are not there,
    errors over stated.
    """

    records: int
    both: int
    extra: int
    f: list[float]
    z: list[float]


def told(pairs_: Pairs) -> list[Check]:
    """Both modes in all, nothing else, errors as stated."""
    return [
        share_at_least("both modes told", pairs_.both, pairs_.records, 0.97),
        at_most("modes that are not there", pairs_.extra, 0),
        rms_over_stated("error over stated deviation, frequency, rms", pairs_.f),
        rms_over_stated("error over stated deviation, damping, rms", pairs_.z),
    ]


def pairs(report: Report, count: int) -> None:
    """Two modes of 5 Hz and 1 % beside one of 8 Hz at six sensors."""
    both, extra = 0, 0
    f, z = list[float](), list[float]()
    for cycles in (3600, 12600):
        for seed in range(count):
            r = equal.identified((5.0, 5.0, 8.0), cycles / 5.0, seed)
            near = np.abs(r.modes.frequencies / 5.0 - 1) < 0.01
            extra += max(int(near.sum()) - 2, 0) + max(int((~near).sum()) - 1, 0)
            if near.sum() == 2:
                both += 1
                f += ((r.modes.frequencies - 5.0) / r.uncertainty.frequency)[
                    near
                ].tolist()
                z += ((r.modes.damping - equal.DAMPING) / r.uncertainty.damping)[
                    near
                ].tolist()
    report.row(
        f"{2 * count} pairs of equal frequency",
        {},
        told(Pairs(2 * count, both, extra, f, z)),
    )


def right_stream(modes: system.Score, floor: np.ndarray) -> list[Check]:
    """All modes, no other ones, with errors near the floor of the whole record."""
    return [
        at_least("modes found", modes.found, system.BAND),
        at_most("extra", modes.extra, 0),
        over_floor("frequency", modes.f / 100 / floor[0]),
        over_floor("damping", modes.z / 100 / floor[1]),
        at_least("MAC", modes.mac.min(), MAC_LEAST),
    ]


def stream(report: Report, hours: float) -> None:
    """64 channels at 200 Hz from an HDF5 file by half hours, against reading it and taking its
    FFTs.
    """
    samples = round(HOUR / 2 * system.FS)
    stretches = [slice(k * samples, (k + 1) * samples) for k in range(round(2 * hours))]
    with (
        tempfile.TemporaryDirectory() as folder,
        h5py.File(Path(folder) / "long.h5", "w") as file,
    ):
        data = file.create_dataset(
            "data", (64, len(stretches) * samples), "f4", chunks=(64, 20_000)
        )
        for seed, part in enumerate(stretches):
            data[:, part] = system.ambient(64, 30, seed).T
        # the peak of the memory so far is forgotten
        Path("/proc/self/clear_refs").write_text("5")
        t = time.process_time()
        for part in stretches:
            rfft(data[:, part], axis=1)
        plain = time.process_time() - t
        t, r = timed(
            lambda: identify_stretches(
                history(data[:, part], system.FS) for part in stretches
            )
        )
    true = system.truth(system.points(64))
    got = system.score(r.modes.frequencies, r.modes.damping, r.modes.shapes, true)
    checks = right_stream(
        got, scatter_floor(true.frequencies, true.damping, hours * HOUR)
    )
    cost = {"s": t, "GB": peak_memory()}
    report.row(
        f"64 channels, {hours:g} h from HDF5",
        cost,
        checks,
        [Peer("reading and FFT alone", {"s": plain})],
    )


def peak_memory() -> float:
    """Most memory of this process since the peak was forgotten, GB (Linux)."""
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    return float(status.split("VmHWM:")[1].split()[0]) / 1e6


SIZES = {  # quick, usual, full: records, and hours of the stream
    accuracy: (2, 4, 10),
    frame: (2, 4, 10),
    uncertainty: (10, 40, 200),
    pairs: (2, 4, 16),
    stream: (1.0, 2.0, 11.5),
}


def main() -> None:
    """Run and state."""
    parser = arguments(__doc__)
    works = {work.__name__: work for work in SIZES}
    parser.add_argument("what", choices=list(works))
    options = parser.parse_args()
    work = works[options.what]
    report = Report(options)
    work(report, sized(options, *SIZES[work]))
    report.end()


if __name__ == "__main__":
    main()
