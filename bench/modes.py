"""Modes end to end, from deck to modes on disk, beside CalculiX, MYSTRAN and scipy's eigsh: times
and memory.

    python bench/modes.py [--quick | --full] [--kinds shell solid tetra] [--threads 1]

Free-free, the 30 lowest modes, the same mesh of CQUAD4 (a curved strip), CHEXA or CTETRA with ten
nodes (a block) for everyone; each run is a process of its own, the smallest CPU time of the repeats counts, memory is
the peak of the process. `eigsh` is scipy as it comes (SuperLU, shift-invert at the shift that we
use), from our matrices, without reading: it is compared with our eigensolution alone. The modes are
right if they fulfil the equations of motion, six of them are rigid, no count misses one, and the
frequencies are those of `eigsh` and near those of CalculiX, whose hexahedron has other incompatible
modes. Its tetrahedron is ours, with the consistent mass in both. MYSTRAN's shell is another element and no measure of ours.

Not covered: `eigsh` on tetrahedra (SuperLU takes minutes), CalculiX on shells (its S4 is expanded into solids), MYSTRAN on solids (its CHEXA needs
the integration named in PSOLID), SLEPc (see the solver of that name).
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path

import calculix_input
import numpy as np
from outcome import (
    THREADS,
    Check,
    Peer,
    Report,
    arguments,
    at_most,
    peer_program,
    sized,
)

from ringtrue.model.cards import TETRAHEDRON

HERE = Path(__file__).resolve()
MODES, RIGID, REPEATS = 30, 6, 2
KINDS = ("shell", "solid", "tetra")
QUICK = {"shell": (6_000,), "solid": (6_000,), "tetra": (6_000,)}  # DOFs
USUAL = {"shell": (50_000,), "solid": (42_000,), "tetra": (42_000,)}
FULL = {"shell": (50_000, 350_000), "solid": (42_000,), "tetra": (42_000, 100_000)}
EIGSH_LARGEST = 60_000  # DOFs; above it SuperLU takes many minutes
SAME_MOST = 1e-6  # of the same matrices: rounding of thin shells, docs/theory/modes.md
RIGID_MOST = 1e-2  # the square root of rounding
RESIDUAL_MOST = 1e-4  # as the solver asks of itself
OTHER_MOST = {"solid": 2.0, "tetra": 0.2}  # %, of CalculiX on the same mesh
E, NU, RHO = 2.1e11, 0.3, 7850.0


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """A program on a mesh.

    Attributes
    ----------
    seconds : float
        Of the processor, the best of the repeats.
    memory : float, GB
    frequencies : (mode,) float64, Hz
    solution : float
        Seconds of the eigensolution alone; NaN where it is not known.
    """

    seconds: float
    memory: float
    frequencies: np.ndarray
    solution: float


def shell_mesh(dof: int) -> tuple[np.ndarray, np.ndarray]:
    """A curved strip of 2 m x 1.3 m: nodes (n, 3), elements (e, 4) from 0."""
    ny = max(round((dof / 6 / 1.45) ** 0.5), 2)
    nx = round(1.45 * ny)
    i, j = (
        a.ravel()
        for a in np.meshgrid(np.arange(nx + 1), np.arange(ny + 1), indexing="ij")
    )
    x = 2.0 * i / nx
    a, b = (c.ravel() for c in np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij"))
    g = a * (ny + 1) + b
    return np.c_[x, 1.3 * j / ny, 0.3 * np.sin(2 * x)], np.c_[
        g, g + ny + 1, g + ny + 2, g + 1
    ]


def solid_mesh(dof: int) -> tuple[np.ndarray, np.ndarray]:
    """A block of 1 m x 0.7 m x 0.4 m: nodes (n, 3), elements (e, 8) from 0."""
    h = (0.28 * 3 / dof) ** (1 / 3)
    n = np.maximum(np.round(np.array([1.0, 0.7, 0.4]) / h - 0.5).astype(int), 1)
    ijk = np.stack(
        np.meshgrid(*(np.arange(k + 1) for k in n), indexing="ij"), axis=-1
    ).reshape(-1, 3)
    c = np.stack(
        np.meshgrid(*(np.arange(k) for k in n), indexing="ij"), axis=-1
    ).reshape(-1, 3)
    step = np.array([(n[1] + 1) * (n[2] + 1), n[2] + 1, 1])
    corner = np.array(
        [
            [0, 0, 0],
            [1, 0, 0],
            [1, 1, 0],
            [0, 1, 0],
            [0, 0, 1],
            [1, 0, 1],
            [1, 1, 1],
            [0, 1, 1],
        ]
    )
    return ijk * [1.0, 0.7, 0.4] / n, c @ step[:, None] + corner @ step


def tetra_mesh(dof: int) -> tuple[np.ndarray, np.ndarray]:
    """The same block, each of its boxes cut into six tetrahedra about its diagonal (Kuhn 1960):
    nodes (n, 3), elements (e, 10) from 0.
    """
    h = (0.28 * 3 / dof) ** (1 / 3)
    n = np.maximum(np.round((np.array([1.0, 0.7, 0.4]) / h - 1) / 2).astype(int), 1)
    places = np.meshgrid(*(np.arange(2 * k + 1) for k in n), indexing="ij")
    ijk = np.stack(places, axis=-1).reshape(-1, 3)
    first = ijk[(ijk % 2 == 0).all(axis=1) & (ijk < 2 * n).all(axis=1)]
    step = np.array([(2 * n[1] + 1) * (2 * n[2] + 1), 2 * n[2] + 1, 1])
    elements = []
    for order in permutations(range(3)):
        corner = np.zeros((4, 3), dtype=int)
        for k, axis in enumerate(order):
            corner[k + 1 :, axis] = 2
        if np.linalg.det(corner[1:]) < 0:
            corner = corner[[0, 2, 1, 3]]
        middle = corner[np.array(TETRAHEDRON.edges)].sum(axis=1) // 2
        elements.append((first @ step)[:, None] + np.vstack([corner, middle]) @ step)
    return ijk * [1.0, 0.7, 0.4] / (2 * n), np.concatenate(elements)


def write_nastran(path: Path, nodes: np.ndarray, elements: np.ndarray) -> None:
    """A free-field deck for SOL 103."""
    shell = elements.shape[1] == 4
    head = "SOL 103\nCEND\nMETHOD = 1\nDISP(PLOT) = ALL\nBEGIN BULK\n"
    head += f"EIGRL,1,,,{MODES}\nMAT1,1,{E:.2e},,{NU},{RHO}\n"
    head += "PSHELL,1,1,.01,1,,1\n" if shell else "PSOLID,1,1,0,2,,FULL\n"
    tetra = elements.shape[1] == 10
    card = "CTETRA" if tetra else "CHEXA"
    head += "PARAM,COUPMASS,1\n" if tetra else ""
    with path.open("w") as f:
        f.write(head.replace("e+", "+"))
        f.writelines(
            f"GRID,{k},,{x:.7f},{y:.7f},{z:.7f}\n"
            for k, (x, y, z) in enumerate(nodes.tolist(), 1)
        )
        for k, g in enumerate((elements + 1).tolist(), 1):
            if shell:
                f.write(f"CQUAD4,{k},1,{','.join(map(str, g))}\n")
            else:
                f.write(
                    f"{card},{k},1,{','.join(map(str, g[:6]))}\n,{','.join(map(str, g[6:]))}\n"
                )
        f.write("ENDDATA\n")


def write_calculix(path: Path, nodes: np.ndarray, elements: np.ndarray) -> None:
    """C3D8I, the element with incompatible modes, or C3D10."""
    kind = "C3D10" if elements.shape[1] == 10 else "C3D8I"
    with path.open("w") as f:
        f.write("*NODE,NSET=ALL\n")
        f.writelines(
            f"{k},{x:.7f},{y:.7f},{z:.7f}\n"
            for k, (x, y, z) in enumerate(nodes.tolist(), 1)
        )
        f.write(f"*ELEMENT,TYPE={kind},ELSET=ALL\n")
        f.writelines(
            f"{k},{','.join(map(str, g))}\n"
            for k, g in enumerate((elements + 1).tolist(), 1)
        )
        f.write(
            f"*MATERIAL,NAME=M\n*ELASTIC\n{E},{NU}\n*DENSITY\n{RHO}\n*SOLID "
            "SECTION,ELSET=ALL,MATERIAL=M\n"
        )
        f.write(f"*STEP\n*FREQUENCY\n{MODES}\n*NODE FILE\nU\n*END STEP\n")


def own(folder: Path) -> np.ndarray:
    """Deck to modes on disk; Hz."""
    from ringtrue.decks.nastran.reader import read_deck
    from ringtrue.model.ports import ModesRequest
    from ringtrue.solvers.embedded import EmbeddedSolver

    marks = [time.process_time()]
    model = read_deck(folder / "m.bdf")
    marks.append(time.process_time())
    with EmbeddedSolver().open(model) as analysis:
        marks.append(time.process_time())
        result = analysis.modes(ModesRequest(MODES))
        marks.append(time.process_time())
        np.savez(
            folder / "modes.npz",
            frequencies=result.modes.frequencies,
            shapes=result.modes.shapes,
        )
    marks.append(time.process_time())
    (folder / "phases.json").write_text(json.dumps(np.diff(marks).round(3).tolist()))
    if not result.complete:
        raise SystemExit(f"not complete: {result.proof}")
    return result.modes.frequencies


def plain(folder: Path) -> np.ndarray:
    """scipy's eigsh as it comes, the eigensolution alone."""
    from scipy.sparse.linalg import eigsh

    from ringtrue.decks.nastran.reader import read_deck
    from ringtrue.fem.assembly import assemble

    system = assemble(read_deck(folder / "m.bdf"))
    before = time.process_time()
    shift = (
        -0.1
        * (2 * np.pi * float(np.load(folder / "modes.npz")["frequencies"][-1])) ** 2
    )
    values = eigsh(
        system.stiffness.tocsc(),
        MODES,
        system.mass.tocsc(),
        sigma=shift,
        return_eigenvectors=True,
    )[0]
    (folder / "phases.json").write_text(json.dumps([time.process_time() - before]))
    return np.sqrt(np.abs(values)) / (2 * np.pi)


def residual(folder: Path) -> float:
    """Largest residual of the equations of motion of an elastic mode, over the forces of its
    inertia.
    """
    from ringtrue.decks.nastran.reader import read_deck
    from ringtrue.fem.assembly import assemble

    system = assemble(read_deck(folder / "m.bdf"))
    modes = np.load(folder / "modes.npz")
    phi = system.local @ modes["shapes"][:, RIGID:]
    inertia = (system.mass @ phi) * (2 * np.pi * modes["frequencies"][RIGID:]) ** 2
    rest = system.stiffness @ phi - inertia
    return float((np.linalg.norm(rest, axis=0) / np.linalg.norm(inertia, axis=0)).max())


def child(folder: Path, what: str) -> None:
    """In a process of its own: one run of ours or of scipy, or the residual of ours."""
    if what == "residual":
        (folder / "residual.json").write_text(json.dumps(residual(folder)))
        return
    f = own(folder) if what == "ringtrue" else plain(folder)
    (folder / "frequencies.json").write_text(json.dumps(np.sort(f).tolist()))


def timed(command: list[str], folder: Path, threads: int) -> tuple[float, float]:
    """CPU seconds and peak GB of a command."""
    environment = os.environ | dict.fromkeys(
        (*THREADS, "CCX_NPROC_EQUATION_SOLVER"), str(threads)
    )
    pid = subprocess.Popen(
        command,
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
    ).pid
    _, status, used = os.wait4(pid, 0)
    if status:
        raise SystemExit(f"{' '.join(command[:3])} failed with status {status}")
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1e6


def calculix_frequencies(folder: Path) -> np.ndarray:
    """From the table of the .dat file, Hz."""
    return calculix_input.frequencies((folder / "m.dat").read_text())


def mystran_frequencies(folder: Path) -> np.ndarray:
    """From the table of eigenvalues of the .F06 file, Hz."""
    text = (folder / "m.F06").read_text(errors="replace")
    if "FATAL" in text:
        raise SystemExit("MYSTRAN: fatal error, see " + str(folder / "m.F06"))
    rows = [
        line.split() for line in text[text.index("E I G E N V A L U E") :].splitlines()
    ]
    return np.array(
        [float(r[4]) for r in rows if len(r) == 7 and r[0].isdigit() and r[0] == r[1]]
    )


def ours(folder: Path, what: str, threads: int) -> Run:
    """Ringtrue, or scipy on our matrices: the best of two runs; scipy's seconds are those of the
    eigensolution.
    """
    command = [sys.executable, str(HERE), "--child", what]
    runs = [timed(command, folder, threads) for _ in range(REPEATS)]
    frequencies = np.array(json.loads((folder / "frequencies.json").read_text()))
    phases = json.loads((folder / "phases.json").read_text())
    solution = phases[2] if what == "ringtrue" else phases[0]
    return Run(min(r[0] for r in runs), min(r[1] for r in runs), frequencies, solution)


def program(command: list[str], folder: Path, threads: int) -> Run:
    """CalculiX or MYSTRAN: the best of two runs."""
    runs = [timed(command, folder, threads) for _ in range(REPEATS)]
    read = mystran_frequencies if command[-1] == "m.bdf" else calculix_frequencies
    return Run(min(r[0] for r in runs), min(r[1] for r in runs), read(folder), np.nan)


def apart(f: np.ndarray, g: np.ndarray) -> float:
    """Largest relative difference of two lists of frequencies of a free structure, rigid-body modes
    left out.
    """
    if f.size < MODES or g.size < MODES:
        return np.nan
    return float(np.abs(g[RIGID:MODES] / f[RIGID:MODES] - 1).max())


def rigid(f: np.ndarray) -> float:
    """Largest of six frequencies over the first elastic one."""
    return float(np.abs(f[:RIGID]).max() / f[RIGID])


def solved(frequencies: np.ndarray, rest: float) -> list[Check]:
    """Whether these are modes of a free structure."""
    return [
        at_most(
            "six rigid-body modes over the first elastic one",
            rigid(frequencies),
            RIGID_MOST,
        ),
        at_most("residual of the equations of motion", rest, RESIDUAL_MOST),
    ]


def same(mine: np.ndarray, eigsh: np.ndarray) -> Check:
    """Against scipy on the same matrices."""
    return at_most("frequencies off those of eigsh by", apart(mine, eigsh), SAME_MOST)


def near(mine: np.ndarray, other: np.ndarray, kind: str) -> Check:
    """Against CalculiX on the same mesh."""
    off = 100 * apart(mine, other)
    return at_most("frequencies off those of CalculiX by", off, OTHER_MOST[kind], "%")


def case(kind: str, dof: int, threads: int, report: Report, folder: Path) -> None:
    """One mesh: ours, then the peers that can and are there."""
    meshes = {"shell": shell_mesh, "solid": solid_mesh, "tetra": tetra_mesh}
    nodes, elements = meshes[kind](dof)
    write_nastran(folder / "m.bdf", nodes, elements)
    size = len(nodes) * (6 if kind == "shell" else 3)
    own_run = ours(folder, "ringtrue", threads)
    timed([sys.executable, str(HERE), "--child", "residual"], folder, threads)
    checks = solved(
        own_run.frequencies, json.loads((folder / "residual.json").read_text())
    )
    body = "solid of CTETRA10" if kind == "tetra" else kind
    what = f"{MODES} modes of a {body} of {size / 1000:.0f}k DOFs"
    if size < EIGSH_LARGEST and kind != "tetra":
        plain = ours(folder, "eigsh", threads)
        check = same(own_run.frequencies, plain.frequencies)
        scipy_itself = Peer("scipy `eigsh`", {"s": plain.solution})
        report.row(
            f"{what}, eigensolution alone",
            {"s": own_run.solution},
            [check],
            [scipy_itself],
        )
    name = "MYSTRAN" if kind == "shell" else "CalculiX"
    command = mystran() if kind == "shell" else calculix()
    peers = []
    if command is None:
        report.not_run(name, "not installed")
    else:
        if kind != "shell":
            write_calculix(folder / "m.inp", nodes, elements)
        other = program(command, folder, threads)
        if kind != "shell":
            checks.append(near(own_run.frequencies, other.frequencies, kind))
        peers = [Peer(name, {"s": other.seconds, "GB": other.memory})]
    report.row(
        f"{what}, deck to disk",
        {"s": own_run.seconds, "GB": own_run.memory},
        checks,
        peers,
    )


def calculix() -> list[str] | None:
    """The command, if it is there."""
    found = peer_program("ccx", "ccx") or shutil.which("ccx")
    return [found, "m"] if found else None


def mystran() -> list[str] | None:
    """The command, if it is there."""
    from ringtrue.errors import SolverMissing
    from ringtrue.solvers.mystran import find_mystran

    try:
        return [str(find_mystran()), "m.bdf"]
    except SolverMissing:
        return None


def main() -> None:
    """Run and state."""
    parser = arguments(__doc__)
    parser.add_argument("--kinds", nargs="+", default=KINDS, choices=KINDS)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument(
        "--child", choices=["ringtrue", "eigsh", "residual"], help=argparse.SUPPRESS
    )
    options = parser.parse_args()
    if options.child:
        child(Path.cwd(), options.child)
        return
    report = Report(options)
    for kind in options.kinds:
        for dof in sized(options, QUICK[kind], USUAL[kind], FULL[kind]):
            with tempfile.TemporaryDirectory() as folder:
                case(kind, dof, options.threads, report, Path(folder))
    report.end()


if __name__ == "__main__":
    main()
