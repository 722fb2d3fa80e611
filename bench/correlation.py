"""Seconds and peak memory of correlating two large sets of modes, beside the MAC as a loop over pairs of modes.

    python bench/correlation.py [--modes 200] [--channels 5000]
    python bench/correlation.py --study lsf/study.h5
    python bench/correlation.py --faults 2000 300
    python bench/correlation.py --groups 30

The second: how far the modes of a finished study's deck are from orthogonal over each mass at its channels. The third:
alarms in that many healthy tests of a plate, and how many of so many faults of each kind are named. The fourth: pairs
of so many models and tests whose modes mix, by the largest group of close modes, and how many of them are wrong.

Each job runs in a process of its own, so that its peak memory is its own; it includes what it takes to hold the two
sets (2 x channels x modes x 8 bytes). Not covered: reading the files, complex shapes, the reduction of a model to the
channels.
"""

from __future__ import annotations

import argparse
import itertools
import multiprocessing
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "unit"))
import test_correlate_faults as random_tests

from ringtrue.core.arrays import Float
from ringtrue.core.modes import ModeSet, Norm
from ringtrue.correlate.assign import scores
from ringtrue.correlate.complete import complete
from ringtrue.correlate.pairing import PairingSettings, pair_modes
from ringtrue.shapes.mac import mac
from ringtrue.shapes.orthogonality import self_orthogonality
from ringtrue.study.evidence import channel_mass
from ringtrue.study.reference import reference_modes
from ringtrue.study.run import load_study

Job = Callable[[ModeSet, ModeSet], object]


def sets(modes: int, channels: int) -> tuple[ModeSet, ModeSet]:
    """A dense band of random shapes, and a test of them: noise, shifted frequencies, close modes turned."""
    rng = np.random.default_rng(0)
    phi = np.linalg.qr(rng.standard_normal((channels, modes)))[0]
    f = np.cumsum(rng.uniform(0.02, 2.0, modes)) + 20
    names = tuple(f"{i}+Z" for i in range(channels))
    noise = 0.2 * rng.standard_normal(phi.shape) / np.sqrt(channels)
    test = ModeSet(f * (1 + 0.01 * rng.standard_normal(modes)), np.full(modes, 0.01), phi + noise, names)
    return test.take(np.argsort(test.frequencies)), ModeSet(f, np.zeros(modes), phi, names, Norm.MASS)


def mac_alone(a: ModeSet, b: ModeSet) -> object:
    """All MAC values."""
    return mac(a.shapes, b.shapes)


def mac_by_pairs(a: ModeSet, b: ModeSet) -> object:
    """The peer: one pair of modes after the other."""
    out = np.empty((len(a), len(b)))
    for i, x in enumerate(a.shapes.T):
        for j, y in enumerate(b.shapes.T):
            out[i, j] = np.abs(x.conj() @ y) ** 2 / ((x.conj() @ x) * (y.conj() @ y))
    return out


def pairing(a: ModeSet, b: ModeSet) -> object:
    """The assignment with its subspaces and reasons."""
    return pair_modes(a, b)


def everything(a: ModeSet, b: ModeSet) -> object:
    """The assignment and all measures of `correlate --complete`."""
    return complete(a, b, pair_modes(a, b), std_a=0.01)


def _timed(job: Job, modes: int, channels: int, answer: multiprocessing.Queue[tuple[float, float]]) -> None:
    a, b = sets(modes, channels)
    start = time.perf_counter()
    job(a, b)
    answer.put((time.perf_counter() - start, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024))


def measure(job: Job, modes: int, channels: int) -> tuple[float, float]:
    """Seconds, and MB of the whole process, in a fresh process."""
    context = multiprocessing.get_context("spawn")
    answer: multiprocessing.Queue[tuple[float, float]] = context.Queue()
    process = context.Process(target=_timed, args=(job, modes, channels, answer))
    process.start()
    result = answer.get()
    process.join()
    return result


def masses(store: Path) -> None:
    """Print the largest entry off the diagonal, that each mass at the channels gives the modes of the deck."""
    desk = load_study(store).desk
    opened, config = desk.remodelled, desk.config.correlate
    test, look = reference_modes(desk.get("identify"), desk.config).elastic, desk.bridge(opened)
    channels, top = test.channels, test.frequencies.max()
    modes = opened.modes(desk.fmax).modes
    modes = modes.take(np.flatnonzero(modes.frequencies <= top))
    seen = ModeSet(modes.frequencies, modes.damping, look(modes.shapes), look.channels).rows(channels).shapes
    print(f"{len(opened.analysis.system.free)} DOFs, {len(channels)} channels, {len(modes)} modes to {top:.1f} Hz")
    for tam in ("irs", "guyan"):
        mass = channel_mass(opened, look, channels, config.model_copy(update={"tam": tam}), desk.fmax).matrix
        off = np.abs(self_orthogonality(seen, mass) - np.eye(len(modes))).max()
        print(f"{tam:8s} {100 * off:5.1f} % off the diagonal at most")


def faults(healthy: int, each: int) -> None:
    """Print alarms in healthy tests, and the share of faults that are named."""
    alarms, mac = random_tests.alarms(healthy)
    print(f"{alarms} alarms in {healthy} healthy tests, mean MAC {100 * mac:.0f} %")
    for fault in random_tests.LEAST:
        share, wrong = random_tests.found(fault, each)
        print(f"{fault:8s} {100 * share:.0f} % of {each} found, {wrong} other channels named")


def mixed(seed: int, channels: int, spacing: float) -> tuple[ModeSet, ModeSet, Float]:
    """A test of 30 modes, a model whose stiffness is 15 % off at random, and how much of each they share (test, FE)."""
    rng = np.random.default_rng(seed)
    modes, beyond = 30, 10
    f = 20 * np.exp(np.cumsum(rng.exponential(spacing, modes + beyond)))
    v = rng.standard_normal((f.size, modes // 2)) / np.sqrt(modes // 2)
    error = np.diag(f) @ (v * rng.uniform(-0.15, 0.15, modes // 2)) @ v.T @ np.diag(f)
    squared, turn = np.linalg.eigh(np.diag(f**2) + error)
    phi = rng.standard_normal((channels, f.size))
    test = phi @ turn[:, :modes]
    test += 0.1 * rng.standard_normal(test.shape) * np.linalg.norm(test, axis=0) / np.sqrt(channels)
    names = tuple(f"{i}+Z" for i in range(channels))
    a = ModeSet(np.sqrt(squared[:modes]), np.zeros(modes), test, names)
    return a, ModeSet(f, np.zeros(f.size), phi, names, Norm.MASS), turn[:, :modes].T ** 2


def groups(count: int) -> None:
    """Pairs, those whose modes share less than 40 %, mean MAC and mean share, by the largest group."""
    print("mean distance  channels  largest group  pairs  wrong  MAC %  shared %")
    for spacing, channels in itertools.product((0.005, 0.015, 0.04), (12, 24, 60, 150)):
        cases = [mixed(seed, channels, spacing) for seed in range(count)]
        for largest in (1, 3, 4, 6):
            settings, macs, shares = PairingSettings(largest_group=largest), list[float](), list[float]()
            for a, b, share in cases:
                p = pair_modes(a, b, settings)
                turns = scores(a.frequencies, a.shapes, b.frequencies, b.shapes, settings).turns
                macs += p.mac.tolist()
                for i, j in zip(p.a.tolist(), p.b.tolist(), strict=True):
                    gained = sum(w[i] * (share[i, list(g)].sum() - share[i, j]) for g, w in turns if j in g)
                    shares.append(float(share[i, j] + gained))
            wrong = (np.array(shares) < 0.4).sum() / count
            print(
                f"{100 * spacing:11.1f} %  {channels:8d}  {largest:13d}  {len(macs) / count:5.1f}  {wrong:5.1f}"
                f"  {100 * np.mean(macs):5.0f}  {100 * np.mean(shares):8.0f}"
            )


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--modes", type=int, default=200)
    parser.add_argument("--channels", type=int, default=5000)
    parser.add_argument("--study", type=Path)
    parser.add_argument("--faults", type=int, nargs=2, metavar=("HEALTHY", "EACH"))
    parser.add_argument("--groups", type=int, metavar="COUNT")
    options = parser.parse_args()
    if options.groups:
        groups(options.groups)
        return
    if options.faults:
        faults(*options.faults)
        return
    if options.study:
        masses(options.study)
        return
    print(f"{options.modes} modes x {options.channels} channels")
    for job in (mac_by_pairs, mac_alone, pairing, everything):
        seconds, peak = measure(job, options.modes, options.channels)
        print(f"{job.__name__:14s} {seconds:8.3f} s  peak {peak:6.0f} MB")


if __name__ == "__main__":
    main()
