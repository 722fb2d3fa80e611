"""Modes end to end, from deck to modes on disk, beside CalculiX, MYSTRAN and scipy's eigsh: ratios and memory.

    python bench/modes.py [--sizes 50000 350000] [--kinds shell solid] [--modes 30] [--repeats 2] [--threads 1]
                          [--ccx ccx] [--mystran mystran] [--peers ringtrue eigsh calculix mystran]

Free-free, the lowest modes, the same mesh of CQUAD4 (a curved strip) or CHEXA (a block) for everyone; each run is a
process of its own, the smallest CPU time of the repeats counts, memory is the peak of the process. `eigsh` is scipy
as it comes (SuperLU, shift-invert at the shift that we use), from our matrices, without reading. A peer that is not
installed is left out, and said. Frequencies are compared with ours.

Not covered: CalculiX on shells (its S4 is expanded into solids), MYSTRAN on solids by default (its CHEXA needs the
integration named in PSOLID; add it with --peers), SLEPc (see the solver of that name), more than one thread.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve()
THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "CCX_NPROC_EQUATION_SOLVER")
E, NU, RHO = 2.1e11, 0.3, 7850.0


def shell_mesh(dof: int) -> tuple[np.ndarray, np.ndarray]:
    """A curved strip of 2 m x 1.3 m: nodes (n, 3), elements (e, 4) from 0."""
    ny = max(round((dof / 6 / 1.45) ** 0.5), 2)
    nx = round(1.45 * ny)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(nx + 1), np.arange(ny + 1), indexing="ij"))
    x = 2.0 * i / nx
    a, b = (c.ravel() for c in np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij"))
    g = a * (ny + 1) + b
    return np.c_[x, 1.3 * j / ny, 0.3 * np.sin(2 * x)], np.c_[g, g + ny + 1, g + ny + 2, g + 1]


def solid_mesh(dof: int) -> tuple[np.ndarray, np.ndarray]:
    """A block of 1 m x 0.7 m x 0.4 m: nodes (n, 3), elements (e, 8) from 0."""
    h = (0.28 * 3 / dof) ** (1 / 3)
    n = np.maximum(np.round(np.array([1.0, 0.7, 0.4]) / h - 0.5).astype(int), 1)
    ijk = np.stack(np.meshgrid(*(np.arange(k + 1) for k in n), indexing="ij"), axis=-1).reshape(-1, 3)
    c = np.stack(np.meshgrid(*(np.arange(k) for k in n), indexing="ij"), axis=-1).reshape(-1, 3)
    step = np.array([(n[1] + 1) * (n[2] + 1), n[2] + 1, 1])
    corner = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
    return ijk * [1.0, 0.7, 0.4] / n, c @ step[:, None] + corner @ step


def write_nastran(path: Path, nodes: np.ndarray, elements: np.ndarray, modes: int) -> None:
    """A free-field deck for SOL 103."""
    shell = elements.shape[1] == 4
    head = "SOL 103\nCEND\nMETHOD = 1\nDISP(PLOT) = ALL\nBEGIN BULK\n"
    head += f"EIGRL,1,,,{modes}\nMAT1,1,{E:.2e},,{NU},{RHO}\n"
    head += "PSHELL,1,1,.01,1,,1\n" if shell else "PSOLID,1,1,0,2,,FULL\n"
    with path.open("w") as f:
        f.write(head.replace("e+", "+"))
        f.writelines(f"GRID,{k},,{x:.7f},{y:.7f},{z:.7f}\n" for k, (x, y, z) in enumerate(nodes.tolist(), 1))
        for k, g in enumerate((elements + 1).tolist(), 1):
            if shell:
                f.write(f"CQUAD4,{k},1,{','.join(map(str, g))}\n")
            else:
                f.write(f"CHEXA,{k},1,{','.join(map(str, g[:6]))}\n,{','.join(map(str, g[6:]))}\n")
        f.write("ENDDATA\n")


def write_calculix(path: Path, nodes: np.ndarray, elements: np.ndarray, modes: int) -> None:
    """C3D8I, the element with incompatible modes."""
    with path.open("w") as f:
        f.write("*NODE,NSET=ALL\n")
        f.writelines(f"{k},{x:.7f},{y:.7f},{z:.7f}\n" for k, (x, y, z) in enumerate(nodes.tolist(), 1))
        f.write("*ELEMENT,TYPE=C3D8I,ELSET=ALL\n")
        f.writelines(f"{k},{','.join(map(str, g))}\n" for k, g in enumerate((elements + 1).tolist(), 1))
        f.write(f"*MATERIAL,NAME=M\n*ELASTIC\n{E},{NU}\n*DENSITY\n{RHO}\n*SOLID SECTION,ELSET=ALL,MATERIAL=M\n")
        f.write(f"*STEP\n*FREQUENCY\n{modes}\n*NODE FILE\nU\n*END STEP\n")


def own(folder: Path, modes: int, method: str = "auto") -> np.ndarray:
    """Deck to modes on disk; Hz."""
    from ringtrue.backends.embedded import EmbeddedSolver
    from ringtrue.io.nastran.reader import read_deck
    from ringtrue.model.ports import ModesRequest

    marks = [time.process_time()]
    model = read_deck(folder / "m.bdf")
    marks.append(time.process_time())
    with EmbeddedSolver(method=method).open(model) as analysis:
        marks.append(time.process_time())
        result = analysis.modes(ModesRequest(modes))
        marks.append(time.process_time())
        np.savez(folder / "modes.npz", frequencies=result.modes.frequencies, shapes=result.modes.shapes)
    marks.append(time.process_time())
    (folder / "phases.json").write_text(json.dumps(np.diff(marks).round(3).tolist()))
    if not result.complete:
        raise SystemExit(f"not complete: {result.proof}")
    return result.modes.frequencies


def plain(folder: Path, modes: int) -> np.ndarray:
    """scipy's eigsh as it comes, the eigensolution alone."""
    from scipy.sparse.linalg import eigsh

    from ringtrue.fem.assembly import assemble
    from ringtrue.io.nastran.reader import read_deck

    system = assemble(read_deck(folder / "m.bdf"))
    before = time.process_time()
    shift = -0.1 * (2 * np.pi * float(np.load(folder / "modes.npz")["frequencies"][-1])) ** 2
    values = eigsh(system.stiffness.tocsc(), modes, system.mass.tocsc(), sigma=shift, return_eigenvectors=True)[0]
    (folder / "phases.json").write_text(json.dumps([time.process_time() - before]))
    return np.sqrt(np.abs(values)) / (2 * np.pi)


def child(folder: Path, what: str, modes: int) -> None:
    """In a process of its own: one run of ours or of scipy."""
    f = own(folder, modes) if what == "ringtrue" else plain(folder, modes)
    (folder / "frequencies.json").write_text(json.dumps(np.sort(f).tolist()))


def timed(command: list[str], folder: Path, threads: int) -> tuple[float, float]:
    """CPU seconds and peak GB of a command."""
    environment = os.environ | dict.fromkeys(THREADS, str(threads))
    pid = subprocess.Popen(
        command, cwd=folder, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL
    ).pid
    _, status, used = os.wait4(pid, 0)
    if status:
        raise SystemExit(f"{' '.join(command[:3])} failed with status {status}")
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1e6


def calculix_frequencies(folder: Path) -> np.ndarray:
    """From the table of the .dat file, Hz."""
    rows = (line.split() for line in (folder / "m.dat").read_text().splitlines())
    return np.array([float(r[3]) for r in rows if len(r) == 5 and r[0].isdigit()])


def mystran_frequencies(folder: Path) -> np.ndarray:
    """From the table of eigenvalues of the .F06 file, Hz."""
    text = (folder / "m.F06").read_text(errors="replace")
    if "FATAL" in text:
        raise SystemExit("MYSTRAN: fatal error, see " + str(folder / "m.F06"))
    rows = [line.split() for line in text[text.index("E I G E N V A L U E") :].splitlines()]
    return np.array([float(r[4]) for r in rows if len(r) == 7 and r[0].isdigit() and r[0] == r[1]])


def run(peer: str, folder: Path, args: argparse.Namespace) -> tuple[float, float, np.ndarray, list[float]]:
    """Least CPU seconds, peak GB, frequencies (Hz) and phases of a peer."""
    commands = {
        "ringtrue": [sys.executable, str(HERE), "--child", "ringtrue", "--modes", str(args.modes)],
        "eigsh": [sys.executable, str(HERE), "--child", "eigsh", "--modes", str(args.modes)],
        "calculix": [args.ccx, "m"],
        "mystran": [args.mystran, "m.bdf"],
    }
    runs = [timed(commands[peer], folder, args.threads) for _ in range(args.repeats)]
    cpu, peak = min(r[0] for r in runs), min(r[1] for r in runs)
    if peer in ("ringtrue", "eigsh"):
        phases = json.loads((folder / "phases.json").read_text())
        f = np.array(json.loads((folder / "frequencies.json").read_text()))
        return (phases[0] if peer == "eigsh" else cpu), peak, f, phases
    return cpu, peak, (calculix_frequencies if peer == "calculix" else mystran_frequencies)(folder), []


def case(kind: str, dof: int, args: argparse.Namespace, folder: Path) -> None:
    """One mesh: ours, then the peers that can and are there."""
    nodes, elements = (shell_mesh if kind == "shell" else solid_mesh)(dof)
    write_nastran(folder / "m.bdf", nodes, elements, args.modes)
    if kind == "solid":
        write_calculix(folder / "m.inp", nodes, elements, args.modes)
    size = len(nodes) * (6 if kind == "shell" else 3)
    print(f"\n{kind}, {size} DOF, {args.modes} modes, {args.threads} thread(s)")
    cpu, peak, f, phases = run("ringtrue", folder, args)
    solve = phases[2]
    print(f"  ringtrue  {cpu:8.2f} s CPU  {peak:5.2f} GB   read, assemble, modes, write: {phases}")
    for peer in args.peers:
        program = {"calculix": args.ccx, "mystran": args.mystran}.get(peer)
        if peer == "ringtrue" or (peer == "calculix" and kind == "shell"):
            continue
        if peer == "mystran" and kind == "solid" and "mystran" not in args.solids:
            continue
        if peer == "eigsh" and dof > args.eigsh_limit:
            continue
        if program and not shutil.which(program):
            print(f"  {peer:9s} is not installed ({program}): left out")
            continue
        c, p, g, _ = run(peer, folder, args)
        n = min(f.size, g.size)
        elastic = f[:n] > 1e-3 * f[n - 1]
        apart = np.abs(g[:n][elastic] / f[:n][elastic] - 1).max()
        base, what = (solve, "eigensolution") if peer == "eigsh" else (cpu, "end to end")
        print(
            f"  {peer:9s} {c:8.2f} s CPU  {p:5.2f} GB   {c / base:5.1f}x our {what}, memory {p / peak:4.2f}x; "
            f"frequencies apart by {apart:.1e}"
        )


def main() -> None:
    """Parse and run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=[50_000])
    parser.add_argument("--kinds", nargs="+", default=["shell", "solid"], choices=["shell", "solid"])
    parser.add_argument("--modes", type=int, default=30)
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--peers", nargs="+", default=["eigsh", "calculix", "mystran"])
    parser.add_argument("--solids", nargs="*", default=[], help="Peers that run solids beside CalculiX: mystran.")
    parser.add_argument("--eigsh-limit", type=int, default=60_000, help="Most DOF for eigsh.")
    parser.add_argument("--ccx", default="ccx")
    parser.add_argument("--mystran", default="mystran")
    parser.add_argument("--child", choices=["ringtrue", "eigsh"], help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.child:
        child(Path.cwd(), args.child, args.modes)
        return
    for kind in args.kinds:
        for dof in args.sizes:
            with tempfile.TemporaryDirectory() as folder:
                case(kind, dof, args, Path(folder))
    print(f"\npeak of this process {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB")


if __name__ == "__main__":
    main()
