"""The slepc solver on MPI ranks: time, and peak memory of each process, against the embedded solver
on the same decks.

    python bench/past_one_machine.py [--quick | --full]

20 modes and their derivatives to 6 parameters at 40 channels, of a curved shell strip (CQUAD4) and
a free cube (CHEXA), on 1 and 2 ranks. Times are of the clock, from the start of the ranks on:
starting and importing is part of them. Memory is the largest peak (VmHWM) of a rank and of the
ringtrue next to it. The answers are right if they are the embedded solver's.

Not covered: several hosts; more ranks than this machine has cores.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from outcome import Check, Peer, Report, arguments, at_most, sized
from scipy import sparse

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "verification"))
from eigen_shell import shell
from fem_cases import cards
from solid_meshes import box

from ringtrue.core.arrays import Float
from ringtrue.core.modes import ModeSet
from ringtrue.core.parameters import CardField, Parameter, ParameterSet
from ringtrue.errors import SolverMissing
from ringtrue.model.model import Model
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.solvers.slepc import SHARE, WORKER, SlepcSolver, find_slepc

MODES, RIGID, CHANNELS = 20, 6, 40
SAME_MOST = 1e-6  # relative, of eigenvalues, derivatives of eigenvalues and of shapes
GB = 1e9


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """Modes and derivatives by a solver, with seconds and GB."""

    modes: ModeSet
    d_lambda: Float
    d_seen: Float
    seconds: dict[str, float]
    memory: dict[str, float]


def cube(n: int) -> Model:
    """n by n by n CHEXA of a free steel cube of 1 m, in six layers of a material each."""
    xyz, hexas = box(n, n, n, (1.0, 1.0, 1.0))
    layer = (6 * xyz[hexas].mean(axis=1)[:, 2]).astype(int) + 1
    ids = np.arange(len(xyz)) + 1
    part = np.arange(1, 7)
    corners = {f"G{k + 1}": hexas[:, k] + 1 for k in range(8)}
    tables = {
        "GRID": cards("GRID", ID=ids, X1=xyz[:, 0], X2=xyz[:, 1], X3=xyz[:, 2]),
        "CHEXA": cards("CHEXA", EID=np.arange(len(hexas)) + 1, PID=layer, **corners),
        "PSOLID": cards("PSOLID", PID=part, MID=part),
        "MAT1": cards("MAT1", MID=part, E=2.1e11, NU=0.3, RHO=7850.0),
    }
    return Model(tables)


def peaks() -> tuple[float, float]:
    """Peak memory, GB, of the processes of slepc: the largest rank, and the largest ringtrue next
    to one.
    """
    rank, share = 0.0, 0.0
    for process in Path("/proc").glob("[0-9]*"):
        try:
            words = (process / "cmdline").read_text().split("\0")
            status = (process / "status").read_text()
        except OSError:  # it has ended
            continue
        size = float(status.partition("VmHWM:")[2].split()[0]) * 1024 / GB if words[0] else 0.0
        if words[1:2] == [str(WORKER)]:
            rank = max(rank, size)
        elif words[1:3] == ["-c", SHARE]:
            share = max(share, size)
    return rank, share


def by_slepc(model: Model, parameters: ParameterSet, readings: sparse.csr_array, ranks: int) -> Run:
    """Modes and derivatives on ranks."""
    start = time.perf_counter()
    with SlepcSolver(ranks=ranks).open(model) as analysis:
        modes = analysis.modes(ModesRequest(MODES)).modes
        solved = time.perf_counter()
        memory = dict(zip(("GB a rank", "GB its ringtrue"), peaks(), strict=True))
        d_lambda, d_seen = analysis.observed_derivatives(modes, parameters, readings)
        seconds = {"s modes": solved - start, "s derivatives": time.perf_counter() - solved}
        memory["GB a rank with derivatives"] = peaks()[0]
    return Run(modes, d_lambda, d_seen, seconds, memory)


def by_embedded(
    model: Model, parameters: ParameterSet, readings: sparse.csr_array, like: ModeSet
) -> Run:
    """The same in this process; derivatives of the same modes."""
    start = time.perf_counter()
    with EmbeddedSolver().open(model) as analysis:
        modes = analysis.modes(ModesRequest(MODES)).modes
        solved = time.perf_counter()
        d_lambda, d_phi = analysis.derivatives(like, parameters)
        seconds = {"s modes": solved - start, "s derivatives": time.perf_counter() - solved}
    d_seen = (readings @ d_phi.reshape(d_phi.shape[0], -1)).reshape(-1, *d_phi.shape[1:])
    return Run(modes, d_lambda, d_seen, seconds, {})


def same(got: Run, want: Run) -> list[Check]:
    """How far the elastic modes and their derivatives differ."""
    f = want.modes.frequencies[RIGID:]
    off = np.abs(got.modes.frequencies[RIGID:] / f - 1).max()
    pairs = {
        "∂λ/∂a": (got.d_lambda[RIGID:], want.d_lambda[RIGID:]),
        "∂φ/∂a": (got.d_seen[:, RIGID:], want.d_seen[:, RIGID:]),
    }
    checks = [at_most("frequencies off the embedded ones by", off, SAME_MOST)]
    for what, (a, b) in pairs.items():
        checks.append(at_most(f"{what} by", np.abs(a - b).max() / np.abs(b).max(), SAME_MOST))
    return checks


def main() -> None:
    """Run and state."""
    options = arguments(__doc__).parse_args()
    report = Report(options)
    try:
        find_slepc()
    except SolverMissing as e:
        report.not_run("SLEPc", str(e))
        report.end()
    shells = sized(options, ((34, 22),), ((34, 22), (112, 74)), ((34, 22), (112, 74), (200, 130)))
    solids = sized(options, (9,), (12,), (12, 22))
    models = [shell(nx, ny, regions=6) for nx, ny in shells] + [cube(n) for n in solids]
    parameters = ParameterSet(
        tuple(Parameter(f"E{r}", (CardField("MAT1", r, "E"),)) for r in range(1, 7))
    )
    for model in models:
        nodes = len(model["GRID"])
        full = sparse.csr_array(sparse.eye_array(6 * nodes))
        readings = full[6 * np.linspace(0, nodes - 1, CHANNELS).astype(int) + 2]
        runs = {n: by_slepc(model, parameters, readings, n) for n in (1, 2)}
        own = by_embedded(model, parameters, readings, runs[1].modes)
        again = by_embedded(model, parameters, readings, runs[2].modes)
        kind, dofs = ("cube", 3 * nodes) if "CHEXA" in model else ("shell", 6 * nodes)
        for n, want in ((1, own), (2, again)):
            cost = runs[n].seconds | runs[n].memory
            report.row(
                f"{kind} of {dofs / 1000:.3g}k DOFs on {n} rank{'s' * (n > 1)}",
                cost,
                same(runs[n], want),
                [Peer("embedded", own.seconds)],
            )
    report.end()


if __name__ == "__main__":
    main()
