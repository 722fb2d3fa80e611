"""Ambient identification against pyoma-2 and pyoma-toolbox: CPU seconds and memory, same data, same
run, one thread.

    python bench/identification_peers.py one            16 channels, 1 h, one band, every order to 100
    python bench/identification_peers.py many           64 channels, likewise
    python bench/identification_peers.py automatic      from record to modes, 16 channels, 1 h
    python bench/identification_peers.py uncertainty    16 channels, 10 min, 20 block rows, orders to 40

each with [--quick | --full]. Every run is a process of its own that loads the same record; memory
is what it takes beyond that (Linux). Peers and ringtrue have the same block rows, orders and, but
where it is said, references (all channels); ringtrue's time is the median of five. Where the peer
gives no standard deviations, ringtrue is shown with and without. Poles are judged against the true
modes: one band of 200 Hz holds those from 3 Hz on, since its lags are shorter than a period of the
lower ones (`automatic` finds all). Not covered: other peers, measured records.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import identification_system as system
import numpy as np
from outcome import (
    Check,
    Peer,
    Report,
    arguments,
    at_least,
    at_most,
    peer_program,
    sized,
    within,
)

FROM = 3.0  # Hz, the modes that one band over 100 Hz holds
HIGH = 5.0  # Hz, likewise with 20 block rows
NEAR = 0.01  # relative to the frequency
FREQUENCY_MOST = (
    # %, rms over these modes of an hour and less; the floor of ten minutes is 0.13 %
    0.5
)
DEVIATION = (
    0.3,
    3.0,
)  # stated over the floor of the scatter, median over the modes: its order of magnitude

RUN = """
import logging, pathlib, re, sys, time
import numpy as np
logging.disable(logging.CRITICAL)
y = np.load(sys.argv[1])
peak = lambda: float(re.search("VmHWM:[^0-9]*([0-9]+)", pathlib.Path("/proc/self/status").read_text())[1]) / 1e3
{setup}
pathlib.Path("/proc/self/clear_refs").write_text("5")  # the peak so far is forgotten
times, before = [], peak()
for _ in range({repeats}):
    t = time.process_time()
    result = {work}
    times.append(time.process_time() - t)
print("result", np.median(times), peak() - before)
{answer}
"""
POLES = """
at = result.order == result.order.max()
np.savez(sys.argv[2], f=np.abs(result.pole[at]) / (2 * np.pi), std=result.std_frequency[at])
"""
MODES = """
np.savez(sys.argv[2], f=result.modes.frequencies, std=result.uncertainty.frequency)
"""
OURS = """
import scipy.signal  # otherwise in the time and memory of the first run
from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.identification.ambient.pipeline import identify_ambient
from ringtrue.identification.ambient.ssi_cov import SsiCov
from one_band import ssi_cov
h = TimeHistory(y, 200.0, tuple(Channel(f"{i + 1}+Z", "acceleration") for i in range(len(y))), "made")
every = [c.id for c in h.channels]
"""
PYOMA = """
from pyoma2.algorithms import SSI
from pyoma2.algorithms.data.run_params import Clustering
from pyoma2.setup import SingleSetup
def run(method, br, ordmax, cluster=False, **more):
    setup = SingleSetup(y, fs=200.0)
    ssi = SSI(name="a", method=method, br=br, ordmax=ordmax, **more)
    setup.add_algorithms(ssi)
    setup.run_by_name("a")
    if cluster:
        ssi.add_clustering(Clustering(name="d", quick="Dederichs"))
        ssi.run_clustering("d")
"""
TOOLBOX = """
from pyOMA.core.PreProcessingTools import PreProcessSignals
from pyOMA.core.SSICovRef import BRSSICovRef
from pyOMA.core.VarSSIRef import VarSSIRef
def run(rows, order):
    ssi = BRSSICovRef(PreProcessSignals(y, 200.0))
    ssi.build_toeplitz_cov(rows)
    ssi.compute_modal_params(order, modal_contrib=False)
def uncertain(rows, order, blocks):
    ssi = VarSSIRef(PreProcessSignals(y, 200.0))
    ssi.build_subspace_mat(rows, num_blocks=blocks)
    ssi.compute_state_matrices(order)
    ssi.prepare_sensitivities()
    ssi.compute_modal_params(order)
"""


@dataclass(frozen=True, slots=True)
class Run:
    """One program's way to do it, and what it writes of its answer."""

    name: str
    python: str | None
    setup: str
    work: str
    answer: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """CPU seconds, megabytes, and the frequencies with their deviations (Hz) if the run wrote
    them.
    """

    seconds: float
    memory: float
    f: np.ndarray
    std: np.ndarray


def ours(name: str, work: str, answer: str = POLES) -> Run:
    """By this interpreter."""
    tests = Path(__file__).parents[1] / "tests" / "verification"
    return Run(
        name,
        sys.executable,
        f"sys.path.insert(0, {str(tests)!r})\n{OURS}",
        work,
        answer,
    )


def pyoma(name: str, work: str, setup: str = PYOMA) -> Run:
    """By that of pyoma-2."""
    return Run(f"pyoma-2 {name}", peer_program("pyoma-2"), setup, work)


def toolbox(work: str) -> Run:
    """By that of pyoma-toolbox."""
    return Run("pyoma-toolbox", peer_program("pyoma-toolbox"), TOOLBOX, work)


Judge = Callable[[Measured], list[Check]]


def true_frequencies(low: float) -> np.ndarray:
    """Of the modes from `low` on, Hz."""
    f = system.truth(system.SIXTEEN).frequencies
    return np.asarray(f[f >= low])


def checks(
    got: Measured,
    low: float,
    minutes: float,
    *,
    exact: bool = False,
    deviations: bool = False,
) -> list[Check]:
    """Whether the true modes are among the poles (`exact`: and nothing else), and the deviations
    plausible.
    """
    f = true_frequencies(low)
    apart = np.abs(got.f[:, None] / f - 1)
    nearest = apart.min(axis=0, initial=1.0)
    found = nearest < NEAR
    out = [
        at_least(f"modes found of {f.size}", found.sum(), f.size),
        at_most(
            "frequency rms",
            100 * system.rms(np.where(found, nearest, np.nan)),
            FREQUENCY_MOST,
            "%",
        ),
    ]
    if exact:
        out.append(at_most("extra", got.f.size - found.sum(), 0))
    if deviations:
        zeta = system.truth(system.SIXTEEN).damping[-f.size :]
        floor = f * np.sqrt(zeta / (2 * np.pi * f * 60 * minutes))
        stated = (
            got.std[apart.argmin(axis=0)] if got.f.size else np.full(f.size, np.nan)
        )
        ratio = float(np.median(stated / floor))
        out.append(within("stated deviation over floor, median", ratio, *DEVIATION))
    return out


def compare(
    report: Report,
    what: str,
    y: np.ndarray,
    mine: list[tuple[Run, Judge]],
    theirs: list[Run],
) -> None:
    """Each on the record `y` (sample, ch); each peer beside each of ours."""
    with tempfile.TemporaryDirectory() as folder:
        path, by_channel = Path(folder) / "y.npy", Path(folder) / "channels.npy"
        np.save(path, y)
        np.save(by_channel, np.ascontiguousarray(y.T))
        peers = []
        for run in theirs:
            got = measured(run, path, 1)
            if isinstance(got, str):
                report.not_run(run.name, got)
            else:
                peers.append(Peer(run.name, {"s": got.seconds, "MB": got.memory}))
        for run, judge in mine:
            got = measured(run, by_channel, 5)
            if isinstance(got, str):
                raise SystemExit(got)
            report.row(
                f"{what}, {run.name}",
                {"s": got.seconds, "MB": got.memory},
                judge(got),
                peers,
            )


def measured(run: Run, path: Path, repeats: int) -> Measured | str:
    """A run in a process of its own, or why there is none."""
    if run.python is None:
        return "not installed"
    file = path.with_suffix(".npz")
    text = RUN.format(
        setup=run.setup, work=run.work, repeats=repeats, answer=run.answer
    )
    command = [run.python, "-c", text, str(path), str(file)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    stated = [
        line.split()[1:]
        for line in done.stdout.splitlines()
        if line.startswith("result")
    ]
    if not stated or done.returncode:
        return (done.stderr.strip().splitlines() or [f"status {done.returncode}"])[-1]
    f, std = np.zeros(0), np.zeros(0)
    if run.answer:
        with np.load(file) as arrays:
            f, std = arrays["f"], arrays["std"]
    return Measured(float(stated[0][0]), float(stated[0][1]), f, std)


def one(report: Report, minutes: float) -> None:
    """One band."""
    band = "ssi_cov(h, SsiCov(50, 100, True{}), references=every)"
    mine: list[tuple[Run, Judge]] = [
        (
            ours("no deviations", band.format(", 1")),
            lambda got: checks(got, FROM, minutes),
        ),
        (
            ours("with deviations", band.format("")),
            lambda got: checks(got, FROM, minutes, deviations=True),
        ),
    ]
    turned = PYOMA + "y = np.asfortranarray(y)\n"
    theirs = [
        pyoma("`cov_R`", "run('cov_R', 50, 100)"),
        pyoma("`cov_R`, record by channel in memory", "run('cov_R', 50, 100)", turned),
        pyoma("`cov`", "run('cov', 50, 100)"),
        toolbox("run(50, 100)"),
    ]
    what = f"SSI-cov, 16 channels, {minutes:g} min, orders to 100, one band"
    compare(report, what, system.ambient(16, minutes, 0), mine, theirs)


def many(report: Report, minutes: float) -> None:
    """64 channels."""
    band = "ssi_cov(h, SsiCov(50, 100, True, 1), references={})"

    def judge(got: Measured) -> list[Check]:
        return checks(got, FROM, minutes)

    mine: list[tuple[Run, Judge]] = [
        (ours("all as references", band.format("every")), judge),
        (ours("8 references", band.format("None")), judge),
    ]
    theirs = [pyoma("`cov_R`", "run('cov_R', 50, 100)")]
    what = f"SSI-cov, 64 channels, {minutes:g} min, orders to 100, one band"
    compare(report, what, system.ambient(64, minutes, 0), mine, theirs)


def automatic(report: Report, minutes: float) -> None:
    """All bands, with standard deviations, against one band and its clusters."""
    run = ours("all bands", "identify_ambient(h)", MODES)
    theirs = [pyoma("`cov` and its clusters", "run('cov', 50, 100, True, step=2)")]
    what = f"record to modes, automatic, 16 channels, {minutes:g} min"
    mine: list[tuple[Run, Judge]] = [
        (run, lambda got: checks(got, 0.0, minutes, exact=True, deviations=True))
    ]
    compare(report, what, system.ambient(16, minutes, 0), mine, theirs)


def uncertainty(report: Report, minutes: float) -> None:
    """Standard deviations of every order."""
    run = ours(
        "all deviations",
        "ssi_cov(h, SsiCov(20, 40, True, blocks=50), references=every)",
    )
    theirs = [
        pyoma("`cov`", "run('cov', 20, 40, calc_unc=True, nb=50)"),
        toolbox("uncertain(20, 40, 50)"),
    ]
    what = f"SSI-cov, 16 channels, {minutes:g} min, orders to 40"
    mine: list[tuple[Run, Judge]] = [
        (run, lambda got: checks(got, HIGH, minutes, deviations=True))
    ]
    compare(report, what, system.ambient(16, minutes, 0), mine, theirs)


SIZES = {
    one: (10, 60, 60),
    many: (5, 60, 60),
    automatic: (20, 60, 60),
    uncertainty: (5, 10, 10),
}  # minutes


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
