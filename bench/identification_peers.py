"""Ambient identification against pyoma-2 and pyoma-toolbox: CPU seconds and memory, same data, same run, one thread.

    python bench/identification_peers.py one PYOMA TOOLBOX          16 channels, 1 h, one band, every order to 100
    python bench/identification_peers.py many PYOMA                 64 channels, likewise
    python bench/identification_peers.py automatic PYOMA            from record to modes, 16 channels, 1 h
    python bench/identification_peers.py uncertainty PYOMA TOOLBOX  16 channels, 10 min, 20 block rows, orders to 40

PYOMA and TOOLBOX are the interpreters of environments with the peers. Every run is a process of its own that loads the
same record; memory is what it takes beyond that (Linux). Peers and ringtrue have the same block rows, orders and, but
where it is said, references (all channels); ringtrue's time is the median of five. Where the peer gives no standard
deviations, ringtrue is shown with and without. Set OMP_NUM_THREADS=1 (and MKL's, OpenBLAS's). Not covered: other peers,
measured records.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from identification_ambient import system

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
    {work}
    times.append(time.process_time() - t)
print("result", np.median(times), peak() - before)
"""
OURS = """
import scipy.signal  # otherwise in the time and memory of the first run
from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.identify.ambient import identify_ambient
from ringtrue.identify.ssi import SsiCov, ssi_cov
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
    """One program's way to do it."""

    name: str
    python: str
    setup: str
    work: str


def ours(name: str, work: str) -> Run:
    """By this interpreter."""
    return Run(name, sys.executable, OURS, work)


def compare(y: np.ndarray, mine: list[Run], theirs: list[Run]) -> None:
    """Each on the record `y` (sample, ch); ratios of each peer to each of ours."""
    with tempfile.TemporaryDirectory() as folder:
        path, by_channel = Path(folder) / "y.npy", Path(folder) / "channels.npy"
        np.save(path, y)
        np.save(by_channel, np.ascontiguousarray(y.T))
        base = [(r.name, *_measured(r, by_channel, 5)) for r in mine]
        for name, seconds, size in base:
            print(f"{name}: {seconds:.2f} s, {size:.0f} MB", flush=True)
        for r in theirs:
            seconds, size = _measured(r, path, 1)
            said = "; ".join(f"{seconds / t:.1f} x the time, {size / m:.1f} x the memory" for _, t, m in base)
            print(f"{r.name}: {seconds:.2f} s, {size:.0f} MB: {said}", flush=True)


def _measured(r: Run, path: Path, repeats: int) -> tuple[float, float]:
    """CPU seconds and megabytes; not a number where the program fails, which is said."""
    text = RUN.format(setup=r.setup, work=r.work, repeats=repeats)
    done = subprocess.run([r.python, "-c", text, str(path)], capture_output=True, text=True, check=False)
    told = [line.split()[1:] for line in done.stdout.splitlines() if line.startswith("result")]
    if not told:
        print(f"{r.name} fails: {done.stderr.strip().splitlines()[-1:]}", flush=True)
        return np.nan, np.nan
    return float(told[0][0]), float(told[0][1])


def one(pyoma: str, toolbox: str) -> None:
    """One band."""
    band = "ssi_cov(h, SsiCov(50, 100, 1{}), references=every)"
    mine = [
        ours("ringtrue", band.format(", 1")),
        ours("ringtrue with standard deviations", band.format("")),
    ]
    theirs = [Run(f"pyoma-2 {m}", pyoma, PYOMA, f"run('{m}', 50, 100)") for m in ("cov_R", "cov")]
    turned = PYOMA + "y = np.asfortranarray(y)\n"  # channel by channel in memory, as a record that was transposed
    theirs.insert(1, Run("pyoma-2 cov_R, channel by channel", pyoma, turned, "run('cov_R', 50, 100)"))
    compare(system().ambient(16, 60, 0), mine, [*theirs, Run("pyoma-toolbox", toolbox, TOOLBOX, "run(50, 100)")])


def many(pyoma: str) -> None:
    """64 channels."""
    band = "ssi_cov(h, SsiCov(50, 100, 1, 1), references={})"
    mine = [ours("ringtrue", band.format("every")), ours("ringtrue, 8 references", band.format("None"))]
    compare(system().ambient(64, 60, 0), mine, [Run("pyoma-2 cov_R", pyoma, PYOMA, "run('cov_R', 50, 100)")])


def automatic(pyoma: str) -> None:
    """All bands, with standard deviations, against one band and its clusters."""
    mine = [ours("ringtrue, record to modes", "identify_ambient(h)")]
    theirs = [Run("pyoma-2 cov + Dederichs", pyoma, PYOMA, "run('cov', 50, 100, True, step=2)")]
    compare(system().ambient(16, 60, 0), mine, theirs)


def uncertainty(pyoma: str, toolbox: str) -> None:
    """Standard deviations of every order."""
    mine = [ours("ringtrue", "ssi_cov(h, SsiCov(20, 40, 1, blocks=50), references=every)")]
    theirs = [
        Run("pyoma-2 cov", pyoma, PYOMA, "run('cov', 20, 40, calc_unc=True, nb=50)"),
        Run("pyoma-toolbox", toolbox, TOOLBOX, "uncertain(20, 40, 50)"),
    ]
    compare(system().ambient(16, 10, 0), mine, theirs)


if __name__ == "__main__":
    what, *given = sys.argv[1:]
    {"one": one, "many": many, "automatic": automatic, "uncertainty": uncertainty}[what](*given)
