"""Correlating two large sets of modes, channel faults that are named, and pairs of modes that mix.

    python bench/correlation.py sets      200 modes at 5,000 channels, beside the MAC as a loop over pairs of modes
    python bench/correlation.py faults    alarms in healthy tests of a plate, and the share of faults that are named
    python bench/correlation.py groups    pairs of models and tests whose modes mix, and how many of them are wrong

each with [--quick | --full]. Each job of `sets` runs in a process of its own, so that its peak
memory is its own; it includes what it takes to hold the two sets (2 x channels x modes x 8 bytes).
Not covered: reading the files, complex shapes, the reduction of a model to the channels.
"""

from __future__ import annotations

import itertools
import multiprocessing
import resource
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from outcome import (
    Check,
    Peer,
    Report,
    arguments,
    at_least,
    at_most,
    share_at_least,
    share_at_most,
    sized,
)

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "unit"))
import test_correlate_faults as random_tests

from ringtrue.core.arrays import Float
from ringtrue.core.modes import ModeSet, Norm
from ringtrue.correlation.assignment import ComparedModes, scores
from ringtrue.correlation.measures import complete
from ringtrue.correlation.pairing import PairingSettings, pair_modes
from ringtrue.shapes import mac

Job = Callable[[ModeSet, ModeSet], Float]
ROUNDING = 1e-12  # of a MAC, a sum over thousands of channels
# of the modes, paired with their own: their shapes are 20 % noise, some neighbours 0.1 % apart
RIGHT_LEAST = 0.98
COMAC_LEAST = 0.9  # of channels with 20 % noise
ALARMS_MOST = 0.01  # of healthy tests
# of the pairs, as they share less than 40 %: an error of 15 % in stiffness, modes 1.5 % apart
WRONG_MOST = 0.1
SHARED_LEAST = 0.4


@dataclass(frozen=True, slots=True, eq=False)
class Timed:
    """Processor seconds, MB of the whole process, and what the job gave."""

    seconds: float
    memory: float
    answer: Float


def sets(modes: int, channels: int) -> tuple[ModeSet, ModeSet, Float]:
    """A dense band of random shapes, a test of it (noise, shifted frequencies), and which mode each
    test mode is.
    """
    rng = np.random.default_rng(0)
    phi = np.linalg.qr(rng.standard_normal((channels, modes)))[0]
    f = np.cumsum(rng.uniform(0.02, 2.0, modes)) + 20
    names = tuple(f"{i}+Z" for i in range(channels))
    noise = 0.2 * rng.standard_normal(phi.shape) / np.sqrt(channels)
    test = ModeSet(
        f * (1 + 0.01 * rng.standard_normal(modes)),
        np.full(modes, 0.01),
        phi + noise,
        names,
    )
    order = np.argsort(test.frequencies)
    return test.take(order), ModeSet(f, np.zeros(modes), phi, names, Norm.MASS), order


def mac_alone(a: ModeSet, b: ModeSet) -> Float:
    """All MAC values (test, FE)."""
    return mac(a.shapes, b.shapes)


def mac_by_pairs(a: ModeSet, b: ModeSet) -> Float:
    """The peer: one pair of modes after the other."""
    out = np.empty((len(a), len(b)))
    for i, x in enumerate(a.shapes.T):
        for j, y in enumerate(b.shapes.T):
            out[i, j] = np.abs(x.conj() @ y) ** 2 / ((x.conj() @ x) * (y.conj() @ y))
    return out


def pairing(a: ModeSet, b: ModeSet) -> Float:
    """The assignment: the FE mode of each test mode, -1 for none."""
    pairs = pair_modes(a, b)
    out = np.full(len(a), -1)
    out[pairs.a] = pairs.b
    return out


def everything(a: ModeSet, b: ModeSet) -> Float:
    """The assignment and all measures of `correlate --complete`; the CoMAC of the channels."""
    return complete(a, b, pair_modes(a, b), std=(0.01, float("nan"))).by_channel.comac


def _timed(
    job: Job, modes: int, channels: int, answer: multiprocessing.Queue[Timed]
) -> None:
    a, b, _ = sets(modes, channels)
    start = time.process_time()
    found = job(a, b)
    seconds = time.process_time() - start
    answer.put(
        Timed(seconds, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, found)
    )


def measure(job: Job, modes: int, channels: int) -> Timed:
    """In a fresh process."""
    context = multiprocessing.get_context("spawn")
    answer: multiprocessing.Queue[Timed] = context.Queue()
    process = context.Process(target=_timed, args=(job, modes, channels, answer))
    process.start()
    result = answer.get()
    process.join()
    return result


def same_mac(found: Float, expected: Float) -> Check:
    """Of all pairs against those of the loop."""
    return at_most(
        "MAC off that of the loop by", np.abs(found - expected).max(), ROUNDING
    )


def right_pairs(found: Float, true: Float) -> Check:
    """Modes paired with their own."""
    return share_at_least(
        "modes paired with their own",
        int((found == true).sum()),
        true.size,
        RIGHT_LEAST,
    )


def plausible_comac(found: Float) -> Check:
    """All channels are alike, with noise."""
    return at_least("CoMAC, mean", found.mean(), COMAC_LEAST)


def large_sets(report: Report, modes: int, channels: int) -> None:
    """Times of the MAC, of the pairing and of all."""
    true = sets(modes, channels)[2]
    what = f"{modes} modes x {channels:,} channels"
    loop = measure(mac_by_pairs, modes, channels)
    alone = measure(mac_alone, modes, channels)
    peer = Peer("a loop over pairs", {"s": loop.seconds, "MB": loop.memory})
    cost = {"s": alone.seconds, "MB": alone.memory}
    report.row(f"MAC, {what}", cost, [same_mac(alone.answer, loop.answer)], [peer])
    paired = measure(pairing, modes, channels)
    cost = {"s": paired.seconds, "MB": paired.memory}
    report.row(
        f"pairs with their subspaces and reasons, {what}",
        cost,
        [right_pairs(paired.answer, true)],
    )
    every = measure(everything, modes, channels)
    cost = {"s": every.seconds, "MB": every.memory}
    report.row(f"all measures, {what}", cost, [plausible_comac(every.answer)])


def few_alarms(alarms: int, healthy: int) -> Check:
    """In healthy tests."""
    return share_at_most("alarms", alarms, healthy, ALARMS_MOST)


def named(fault: str, share: float, wrong: int, each: int) -> list[Check]:
    """Of tests with a fault."""
    return [
        share_at_least("named", round(share * each), each, random_tests.LEAST[fault]),
        share_at_most("other channels named", wrong, each, 3 * ALARMS_MOST),
    ]


def faults(report: Report, healthy: int, each: int) -> None:
    """Alarms in healthy tests, and the share of faults that are named."""
    report.row(
        f"{healthy} healthy tests of a plate",
        {},
        [few_alarms(random_tests.alarms(healthy)[0], healthy)],
    )
    for fault in random_tests.LEAST:
        checks = named(fault, *random_tests.found(fault, each), each)
        report.row(f"{each} tests with a channel fault: {fault}", {}, checks)


def mixed(seed: int, channels: int, spacing: float) -> tuple[ModeSet, ModeSet, Float]:
    """A test of 30 modes, a model whose stiffness is 15 % off at random, and how much of each they
    share (test, FE).
    """
    rng = np.random.default_rng(seed)
    modes, beyond = 30, 10
    f = 20 * np.exp(np.cumsum(rng.exponential(spacing, modes + beyond)))
    v = rng.standard_normal((f.size, modes // 2)) / np.sqrt(modes // 2)
    error = np.diag(f) @ (v * rng.uniform(-0.15, 0.15, modes // 2)) @ v.T @ np.diag(f)
    squared, turn = np.linalg.eigh(np.diag(f**2) + error)
    phi = rng.standard_normal((channels, f.size))
    test = phi @ turn[:, :modes]
    test += (
        0.1
        * rng.standard_normal(test.shape)
        * np.linalg.norm(test, axis=0)
        / np.sqrt(channels)
    )
    names = tuple(f"{i}+Z" for i in range(channels))
    a = ModeSet(np.sqrt(squared[:modes]), np.zeros(modes), test, names)
    return (
        a,
        ModeSet(f, np.zeros(f.size), phi, names, Norm.MASS),
        turn[:, :modes].T ** 2,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Paired:
    """Pairs of many models and tests: their MAC and the share of themselves that the two modes have
    in common.
    """

    mac: Float
    shared: Float


def paired(cases: list[tuple[ModeSet, ModeSet, Float]], largest: int) -> Paired:
    """With groups of close modes of at most so many."""
    settings = PairingSettings(largest_group=largest)
    macs, shares = list[float](), list[float]()
    for a, b, share in cases:
        p = pair_modes(a, b, settings)
        turns = scores(
            ComparedModes(a.frequencies, a.shapes, b.frequencies, b.shapes), settings
        ).turns
        macs += p.mac.tolist()
        for i, j in zip(p.a.tolist(), p.b.tolist(), strict=True):
            gained = sum(
                w[i] * (share[i, list(g)].sum() - share[i, j])
                for g, w in turns
                if j in g
            )
            shares.append(float(share[i, j] + gained))
    return Paired(np.array(macs), np.array(shares))


def few_wrong(found: Paired) -> list[Check]:
    """Pairs that have something in common, and more of them than none."""
    wrong = int((found.shared < SHARED_LEAST).sum())
    return [
        share_at_most(
            f"pairs that share less than {SHARED_LEAST:.0%}",
            wrong,
            found.shared.size,
            WRONG_MOST,
        )
    ]


def groups(report: Report, count: int) -> None:
    """Pairs, mean MAC and mean share, by distance of the modes, channels and the largest group."""
    usual = PairingSettings().largest_group
    for spacing, channels in itertools.product((0.015, 0.04), (24, 60)):
        cases = [mixed(seed, channels, spacing) for seed in range(count)]
        peers = []
        for largest in sorted({1, 3, 6} - {usual}):
            other = paired(cases, largest)
            peers.append(Peer(f"groups of {largest}", of_thirty(other, count)))
        ours = paired(cases, usual)
        what = (
            f"{count} models of 30 modes {100 * spacing:g} % apart, {channels} channels, "
            f"groups of {usual}"
        )
        report.row(what, of_thirty(ours, count), few_wrong(ours), peers)


def of_thirty(found: Paired, count: int) -> dict[str, float]:
    """Pairs of a model, mean MAC and mean share."""
    return {
        "pairs": found.mac.size / count,
        "% MAC": 100 * float(found.mac.mean()),
        "% shared": 100 * float(found.shared.mean()),
    }


def main() -> None:
    """Run and state."""
    parser = arguments(__doc__)
    parser.add_argument(
        "what", nargs="?", default="sets", choices=["sets", "faults", "groups"]
    )
    options = parser.parse_args()
    report = Report(options)
    if options.what == "sets":
        large_sets(report, *sized(options, (60, 1000), (200, 5000), (200, 5000)))
    elif options.what == "faults":
        faults(report, *sized(options, (100, 30), (400, 100), (2000, 300)))
    else:
        groups(report, sized(options, 3, 10, 30))
    report.end()


if __name__ == "__main__":
    main()
