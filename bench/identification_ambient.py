"""Ambient identification: time, accuracy, stated uncertainty and memory, against the truth.

    python bench/identification_ambient.py accuracy 10 16      records, channels (16 or 64)
    python bench/identification_ambient.py frame 10            a second structure: a chain of ten storeys
    python bench/identification_ambient.py uncertainty 200     records of 1000 periods of the lowest mode
    python bench/identification_ambient.py pairs 16            records of 3600 and of 12600 cycles of an equal pair
    python bench/identification_ambient.py stream 11.4         hours, 64 channels at 200 Hz, from HDF5

The system is `../shared/bench/identification_system.py`. Set OMP_NUM_THREADS=1 (and MKL's, OpenBLAS's): times are CPU
seconds of one thread; `stream` shows those of the clock, too, which OMP_NUM_THREADS=2 lessens. Not covered: measured
records, non-white forces; peers are in identification_peers.py.
"""

from __future__ import annotations

import importlib.util
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import h5py
import numpy as np
from scipy.fft import rfft
from scipy.signal import lfilter

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "verification"))
import test_oma_pairs as equal

from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.identify.ambient import AmbientResult, identify_ambient, identify_stretches

SYSTEM = Path(__file__).parents[2] / "shared/bench/identification_system.py"


def system() -> ModuleType:
    """The module that makes the records."""
    spec = importlib.util.spec_from_file_location("identification_system", SYSTEM)
    if spec is None or spec.loader is None:
        raise SystemExit(f"{SYSTEM} is not here")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def history(y: np.ndarray, rate: float) -> TimeHistory:
    """(ch, sample) accelerations."""
    return TimeHistory(y, rate, tuple(Channel(f"{i + 1}+Z", "acceleration") for i in range(len(y))), "made")


def timed(work: Callable[[], AmbientResult]) -> tuple[float, AmbientResult]:
    """CPU seconds and result."""
    t = time.process_time()
    r = work()
    return time.process_time() - t, r


def accuracy(records: int, channels: int) -> None:
    """The benchmark's system, one hour, real and complex modes by turns; the floor is that of each record."""
    s = system()
    rows = []
    for seed in range(records):
        cplx = bool(seed % 2)
        h, truth = history(s.ambient(channels, 60, seed, cplx).T, s.FS), s.truth(channels, cplx)
        t, r = timed(lambda h=h: identify_ambient(h))
        d = s.score(r.modes.frequencies, r.modes.damping, r.modes.shapes, truth)
        turn = 2 * np.pi * truth["f"] * 3600
        floor = 100 * np.sqrt(np.mean(truth["zeta"] / turn)), 100 * np.sqrt(np.mean(1 / (truth["zeta"] * turn)))
        rows.append((t, d["found"], d["extra"], d["f_rms"], d["z_rms"], d["mac_min"], *floor))
        print(f"{seed:3d} {'complex' if cplx else 'real':8s}" + " ".join(f"{x:9.4f}" for x in rows[-1]))
    a = np.array(rows)
    print(f"best {a[:, 0].min():.2f} s; all 15 in {(a[:, 1] == 15).sum()} of {records}, most extra {a[:, 2].max():.0f}")
    f_floor, z_floor = a[:, 3] / a[:, 6], a[:, 4] / a[:, 7]
    print(f"least MAC {a[:, 5].min():.4f}; median rms, and that of the floors:")
    # the dashpots of complex modes widen the lowest ones, and raise the floor
    for some, what in ((a, "all"), (a[::2], "real"), (a[1::2], "complex")):
        if len(some):
            f_rms, z_rms, f_least, z_least = np.median(some[:, [3, 4, 6, 7]], axis=0)
            print(f"{what:8s} f {f_rms:.4f} ({f_least:.4f}) %, damping {z_rms:.2f} ({z_least:.2f}) %")
    print(f"worst rms over the floor of its record: f {f_floor.max():.2f}, damping {z_floor.max():.2f}")


class Frame:
    """A chain of ten equal storeys, fixed at the base, with 1 % and 2 % damping by turns; f_1 = 0.75 Hz."""

    rate = 50.0

    def __init__(self) -> None:
        k = 2 * np.eye(10) - np.eye(10, k=1) - np.eye(10, k=-1)
        k[-1, -1] = 1
        w2, self.shapes = np.linalg.eigh(k)
        self.f = 0.75 * np.sqrt(w2 / w2[0])
        self.zeta = np.where(np.arange(10) % 2, 0.02, 0.01)

    def record(self, seed: int, seconds: float) -> np.ndarray:
        """Accelerations (10, sample) for white forces at every floor, sensor noise 20 dB below."""
        rng, w, lead = np.random.default_rng(seed), 2 * np.pi * self.f, int(80 * self.rate)
        q = []
        for s in -self.zeta * w + 1j * w * np.sqrt(1 - self.zeta**2):
            force, a = rng.standard_normal(int(seconds * self.rate) + lead), np.exp(s / self.rate)
            z = lfilter([0, (a - 1) / s], [1, -a], force)
            q.append(2 * np.real(s**2 / (2j * s.imag) * z) + 2 * np.real(s / (2j * s.imag)) * force)
        y = self.shapes @ np.array(q)[:, lead:]
        return y + 0.1 * y.std(1, keepdims=True) * rng.standard_normal(y.shape)

    def errors(self, r: AmbientResult) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """ln f and ln ζ errors (2, mode), their stated deviations, and errors of the shapes over theirs."""
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
        return e, s, gap[free]


def frame(records: int) -> None:
    """The second structure, one hour."""
    c = Frame()
    turn = 2 * np.pi * c.f * 3600
    floor = np.array([np.sqrt(c.zeta / turn), np.sqrt(1 / (c.zeta * turn))])
    out, extra, seconds = [], [], []
    for seed in range(records):
        h = history(c.record(seed, 3600), c.rate)
        t, r = timed(lambda h=h: identify_ambient(h))
        out.append(c.errors(r)[0])
        seconds.append(t)
        extra.append(len(r.modes) - np.isfinite(out[-1][0]).sum())
    e = np.array(out)
    print(f"best {min(seconds):.2f} s; found {np.isfinite(e[:, 0]).sum(1).min()}+ of 10, most extra {max(extra)}")
    ratio = np.sqrt(np.nanmean(e**2, axis=0)) / floor
    print(f"scatter over the floor by mode: f {ratio[0].round(2)}, damping {ratio[1].round(2)}")


def uncertainty(records: int) -> None:
    """Bias, scatter and coverage over records of 1000 periods of the lowest mode of the chain."""
    c = Frame()
    seconds = 1000 / c.f[0]
    got = [c.errors(identify_ambient(history(c.record(seed, seconds), c.rate))) for seed in range(records)]
    e, s = np.array([g[0] for g in got]), np.array([g[1] for g in got])
    shape = np.concatenate([g[2] for g in got])
    turn = 2 * np.pi * c.f * seconds
    floor = np.array([np.sqrt(c.zeta / turn), np.sqrt(1 / (c.zeta * turn))])
    scatter = np.nanstd(e, axis=0)
    for name, k in (("frequency", 0), ("ln damping", 1)):
        inside = np.abs(e[:, k]) < 1.96 * s[:, k]
        print(name, f"95 % intervals hold {100 * inside[np.isfinite(e[:, k])].mean():.1f} %")
        print("  stated over scatter", (np.sqrt(np.nanmean(s[:, k] ** 2, 0)) / scatter[k]).round(2))
        print("  scatter over floor ", (scatter[k] / floor[k]).round(2))
        print("  bias, %            ", (100 * np.nanmean(e[:, k], 0)).round(3))
    shape = shape[np.isfinite(shape)]
    print(f"shapes: 95 % intervals hold {100 * (np.abs(shape) < 1.96).mean():.1f} %")
    print(f"found in all records: {np.isfinite(e[:, 0]).all(0).sum()} of 10 modes")


def pairs(records: int) -> None:
    """Two modes of 5 Hz and 1 % beside one of 8 Hz at six sensors: how often both are told, and nothing else."""
    told, extra, f, z = 0, 0, [], []
    for cycles in (3600, 12600):
        for seed in range(records):
            r = equal.identified((5.0, 5.0, 8.0), cycles / 5.0, seed)
            near = np.abs(r.modes.frequencies / 5.0 - 1) < 0.01
            extra += max(near.sum() - 2, 0) + int((~near).sum()) - 1
            if near.sum() == 2:
                told += 1
                f.append((r.modes.frequencies - 5.0)[near] / r.uncertainty.frequency[near])
                z.append((r.modes.damping - equal.DAMPING)[near] / r.uncertainty.damping[near])
    print(f"both told in {told} of {2 * records} records, modes that are not there {extra}")
    f_rms, z_rms = (np.sqrt(np.mean(np.square(e))) for e in (f, z))
    print(f"errors over stated deviations, rms: frequency {f_rms:.2f}, damping {z_rms:.2f}")


def stream(hours: float) -> None:
    """64 channels at 200 Hz from an HDF5 file by half hours, against reading it and taking its FFTs."""
    s, n = system(), 360_000
    half = s.ambient(64, 30, 0, False).T.astype(np.float32)
    with tempfile.TemporaryDirectory() as folder, h5py.File(Path(folder) / "long.h5", "w") as file:
        data = file.create_dataset("data", (64, int(2 * hours) * n), "f4", chunks=(64, 20_000))
        for k in range(int(2 * hours)):  # half hours
            data[:, k * n : (k + 1) * n] = half + 0.01 * half.std() * np.random.default_rng(k).standard_normal(
                half.shape, dtype=np.float32
            )
        t, wall = time.process_time(), time.perf_counter()
        for k in range(int(2 * hours)):  # half hours
            rfft(data[:, k * n : (k + 1) * n], axis=1)
        plain, plain_wall = time.process_time() - t, time.perf_counter() - wall
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        parts = (history(data[:, k * n : (k + 1) * n], s.FS) for k in range(int(2 * hours)))
        wall = time.perf_counter()
        t, r = timed(lambda: identify_stretches(parts))
        wall = time.perf_counter() - wall
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(f"{hours} h: {len(r.modes)} modes in {t:.1f} s, {t / plain:.2f} x reading and FFT ({plain:.1f} s)")
    print(f"by the clock {wall:.1f} s, {wall / plain_wall:.2f} x ({plain_wall:.1f} s, one thread)")
    print(f"peak {after / 1e6:.2f} GB, {(after - before) / 1e6:.2f} GB above what reading and FFT took")


if __name__ == "__main__":
    what, *given = sys.argv[1:]
    if what == "accuracy":
        accuracy(int(given[0]), int(given[1]))
    elif what == "stream":
        stream(float(given[0]))
    else:
        {"frame": frame, "uncertainty": uncertainty, "pairs": pairs}[what](int(given[0]))
