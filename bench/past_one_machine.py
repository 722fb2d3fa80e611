"""The slepc solver on MPI ranks: time, and peak memory of each process, against the embedded solver
on the same decks.

    python bench/past_one_machine.py [--quick | --full]

20 modes and their derivatives to 6 parameters at 40 channels, of a curved shell strip (CQUAD4) and
a free cube (CHEXA), on 1 and 2 ranks. Times are of the clock, from the start of the ranks on:
starting and importing is part of them. Memory is the largest peak (VmHWM) of a rank and of the
ringtrue next to it. The answers are right if they are the embedded solver's.

A study of the shell, from whose test two moduli differ, is localised: candidates
are made from the deck, screened and proposed. Each run has a process of its own, whose peak is
stated as well.

Not covered: several hosts; more ranks than this machine has cores.
"""

from __future__ import annotations

import sys
import tempfile
import time
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from outcome import Check, Peer, Report, arguments, at_least, at_most, sized
from scipy import sparse

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "verification"))
from eigen_shell import shell
from fem_cases import cards
from solid_meshes import box

from ringtrue.core.arrays import Float
from ringtrue.core.modes import ModeSet
from ringtrue.core.parameters import CardField, Parameter, ParameterSet
from ringtrue.core.testmodel import TestModel
from ringtrue.decks.nastran.writer import write_bulk
from ringtrue.errors import SolverMissing
from ringtrue.io.modes import write_modes
from ringtrue.model.frames import positions
from ringtrue.model.model import Model
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.solvers.observed import at_factors
from ringtrue.solvers.slepc import SHARE, WORKER, SlepcSolver, find_slepc
from ringtrue.study.results import LocaliseStage
from ringtrue.study.run import run_study
from ringtrue.study.session import Session
from ringtrue.study.stages import localise
from ringtrue.virtual.measurements import write_sheet

MODES, RIGID, CHANNELS = 20, 6, 40
TESTED = 12  # elastic modes of the test that is localised
WRONG = {2: 0.8, 5: 1.2}  # factors of the moduli of its regions
SAME_MOST = 1e-6  # relative, of eigenvalues, derivatives of eigenvalues and of shapes
SAME_FACTORS = 1e-5  # relative, of what is proposed: where the search stops
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


def peak(process: Path) -> float:
    """Of a process, by its folder in /proc, GB."""
    size = (process / "status").read_text().partition("VmHWM:")[2].split()
    return float(size[0]) * 1024 / GB if size else 0.0


def peaks() -> tuple[float, float]:
    """Peak memory, GB, of the processes of slepc: the largest rank, and the largest ringtrue next
    to one.
    """
    rank, share = 0.0, 0.0
    for process in Path("/proc").glob("[0-9]*"):
        try:
            words = (process / "cmdline").read_text().split("\0")
            size = peak(process) if words[0] else 0.0
        except OSError:  # it has ended
            continue
        if words[1:2] == [str(WORKER)]:
            rank = max(rank, size)
        elif words[1:3] == ["-c", SHARE]:
            share = max(share, size)
    return rank, share


def by_slepc(
    model: Model, parameters: ParameterSet, readings: sparse.csr_array, ranks: int
) -> Run:
    """Modes and derivatives on ranks."""
    start = time.perf_counter()
    with SlepcSolver(ranks=ranks).open(model) as analysis:
        modes = analysis.modes(ModesRequest(MODES)).modes
        solved = time.perf_counter()
        memory = dict(zip(("GB a rank", "GB its ringtrue"), peaks(), strict=True))
        d_lambda, d_seen = analysis.observed_derivatives(modes, parameters, readings)
        seconds = {
            "s modes": solved - start,
            "s derivatives": time.perf_counter() - solved,
        }
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
        seconds = {
            "s modes": solved - start,
            "s derivatives": time.perf_counter() - solved,
        }
    d_seen = (readings @ d_phi.reshape(d_phi.shape[0], -1)).reshape(
        -1, *d_phi.shape[1:]
    )
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
        checks.append(
            at_most(f"{what} by", np.abs(a - b).max() / np.abs(b).max(), SAME_MOST)
        )
    return checks


def write_study(model: Model, folder: Path) -> Path:
    """A study of a deck whose test is that of another: two moduli are wrong."""
    wrong = ParameterSet(
        tuple(Parameter(f"E{r}", (CardField("MAT1", r, "E"),)) for r in WRONG)
    )
    deck = "SOL 103\nCEND\nBEGIN BULK\n" + write_bulk(model) + "ENDDATA\n"
    (folder / "deck.bdf").write_text(deck)
    grid = model["GRID"]
    at = np.linspace(0, len(grid) - 1, CHANNELS).astype(int)
    xyz = positions(model)[at]
    points = grid.ids[at]
    channels = tuple(f"{p}+Z" for p in points.tolist())
    axes = np.tile([0.0, 0.0, 1.0], (CHANNELS, 1))
    none = np.zeros((0, 2), dtype=np.int64)
    groups = ("",) * CHANNELS
    test = TestModel(
        points, xyz, channels, at=points, axes=axes, lines=none, groups=groups
    )
    write_sheet(folder / "sensors.csv", test, channels)
    truth = at_factors(model, wrong, np.array(list(WRONG.values())))
    with EmbeddedSolver().open(truth) as analysis:
        modes = analysis.modes(ModesRequest(RIGID + TESTED)).modes.take(
            slice(RIGID, None)
        )
    seen = replace(modes, shapes=modes.shapes[6 * at + 2], labels=channels)
    write_modes(folder / "modes.json", seen)
    fmax = 1.3 * float(modes.frequencies[-1])
    study = folder / "study.toml"
    study.write_text(
        f'[model]\ndeck = "deck.bdf"\nfmax = {fmax:.1f}\n'
        '[test]\nsheet = "sensors.csv"\nmodes = "modes.json"\n'
        '[localise]\nkinds = ["material"]\npool = 4\nmost = 2\n'
    )
    return study


def localised(study: Path, ranks: int) -> tuple[LocaliseStage, dict[str, float]]:
    """The localisation of a study by the embedded solver or on ranks, with seconds and GB."""
    session = Session.of(study)
    if ranks:
        session.engine = SlepcSolver(ranks=ranks)
    memory = [(0.0, 0.0)]
    start = time.perf_counter()
    found = localise.run(session, lambda *_: memory.append(peaks()))
    cost = {
        "s": time.perf_counter() - start,
        "GB this process": peak(Path("/proc/self")),
    }
    if ranks:
        most = np.max(memory, axis=0).tolist()
        cost |= dict(zip(("GB a rank", "GB its ringtrue"), most, strict=True))
    if found is None:
        raise RuntimeError("nothing was localised: no mode is paired")
    return found, cost


def localise_row(model: Model, report: Report) -> None:
    """Localise on two ranks and in one process, and compare."""
    with tempfile.TemporaryDirectory() as folder:
        study = write_study(model, Path(folder))
        run_study(study, until="correlate")
        runs = []
        for ranks in (2, 0):
            with get_context("spawn").Pool(1) as process:
                runs.append(process.apply(localised, (study, ranks)))
    (got, cost), (want, own) = runs
    names = [[m.name for m in r.proposal.members] for r in (got, want)]
    factors = [np.array([m.factor for m in r.proposal.members]) for r in (got, want)]
    checks = [at_least("parameters proposed by the embedded solver", len(names[1]), 1)]
    checks.append(
        at_most(
            "proposed by one of the two only", len(set(names[0]) ^ set(names[1])), 0
        )
    )
    if names[0] == names[1]:
        off = np.abs(factors[0] / factors[1] - 1).max()
        checks.append(
            at_most("their factors off the embedded ones by", off, SAME_FACTORS)
        )
    dofs = 6 * len(model["GRID"])
    report.row(
        f"localise a shell of {dofs / 1000:.3g}k DOFs on 2 ranks",
        cost,
        checks,
        [Peer("embedded", own)],
    )


def main() -> None:
    """Run and state."""
    options = arguments(__doc__).parse_args()
    report = Report(options)
    try:
        find_slepc()
    except SolverMissing as e:
        report.not_run("SLEPc", str(e))
        report.end()
    shells = sized(
        options, ((34, 22),), ((34, 22), (112, 74)), ((34, 22), (112, 74), (200, 130))
    )
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
    localise_row(shell(*shells[-1], regions=6), report)
    report.end()


if __name__ == "__main__":
    main()
