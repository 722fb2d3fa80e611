"""A stand-in for Nastran: `python nastran_stub.py BEHAVIOUR FORMAT DECK`.

It reads the deck that it is given, solves it with the embedded solver and writes results files with
Nastran's layout: shapes in the displacement frames; for SOL 200 the derivatives of its own design
model by central differences.
"""

from __future__ import annotations

import re
import sys
import time
from pathlib import Path

import h5py
import numpy as np
from op2_writer import Op2Writer

from ringtrue.core.modes import ModeSet
from ringtrue.core.parameters import Shape
from ringtrue.decks.nastran.lexer import real
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.fem.parametrisation.changed_model import moved
from ringtrue.model.frames import axes, positions
from ringtrue.model.model import Model
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.embedded import EmbeddedSolver

STEP = 1e-3


def cards(path: Path) -> list[list[str]]:
    """The fields of each card in fixed format, small or large."""
    out: list[list[str]] = []
    for line in path.read_text().split("BEGIN BULK\n")[1].splitlines():
        width = 16 if "*" in line[:8] else 8
        cells = [line[i : i + width].strip() for i in range(8, 72, width)]
        if line[:8].strip(" *"):
            out.append([line[:8].strip(" *"), *cells])
        else:
            out[-1] += cells
    return out


def request(deck: list[list[str]]) -> ModesRequest:
    fields = next(c for c in deck if c[0] == "EIGRL")
    assert fields[8] == "MASS"
    if fields[3]:
        return ModesRequest(
            band=(real(fields[2]) if fields[2] else -1.0, real(fields[3]))
        )
    return ModesRequest(int(fields[4]))


def solve(model: Model, wanted: ModesRequest) -> ModeSet:
    with EmbeddedSolver().open(model) as analysis:
        return analysis.modes(wanted).modes


def local(model: Model, modes: ModeSet) -> np.ndarray:
    """Shapes (n, 6, m) in the displacement frames."""
    grid = model["GRID"]
    turn = axes(model, grid["CD"], positions(model))
    n = len(grid)
    basic = modes.shapes[: 6 * n].reshape(n, 2, 3, -1)
    return np.einsum("nij,nkjm->nkim", turn, basic).reshape(n, 6, -1)


def changed(model: Model, deck: list[list[str]], x: np.ndarray) -> Model:
    """The model at the design variables x."""
    for name, _, card, target, field, _, _, spare, _, *pairs in (
        c for c in deck if re.match("DV[PMC]REL1", c[0])
    ):
        pairs = [p for p in pairs if p]
        terms = zip(pairs[::2], pairs[1::2], strict=True)
        value = (real(spare) if spare else 0.0) + sum(
            real(c) * x[int(v) - 1] for v, c in terms
        )
        assert name == {"P": "DVPREL1", "M": "DVMREL1"}.get(card[0], "DVCREL1")
        model = model.with_values(
            card, field, np.array([int(target)]), np.array([value])
        )
    for _, variable, node, frame, factor, *vector in (
        c[:8] for c in deck if c[0] == "DVGRID"
    ):
        assert frame in ("", "0")
        n = Shape((int(node),), (tuple(real(v or "0.") for v in vector),))  # type: ignore[arg-type]
        model = moved(model, n, real(factor) * (x[int(variable) - 1] - 1))
    return model


def sensitivities(
    model: Model, deck: list[list[str]], wanted: ModesRequest
) -> tuple[np.ndarray, np.ndarray]:
    """Rows of DSCMCOL (r, 9) and DSCM2 (variable, r)."""
    number = sum(c[0] == "DESVAR" for c in deck)
    reference = solve(model, wanted)
    slopes = []
    for k in range(number):
        ends = []
        for sign in (1, -1):
            x = np.ones(number)
            x[k] += sign * STEP
            here = changed(model, deck, x)
            modes = solve(here, wanted)
            turn = np.sign(np.einsum("dm,dm->m", reference.shapes, modes.shapes))
            ends.append(
                ((2 * np.pi * modes.frequencies) ** 2, local(here, modes) * turn)
            )
        slopes.append([(a - b) / (2 * STEP) for a, b in zip(*ends, strict=True)])
    at = {int(n): i for i, n in enumerate(model["GRID"].ids)}
    columns, values = [], []
    for fields in (c for c in deck if c[0] == "DRESP1"):
        rid, kind = int(fields[1]), fields[3]
        if kind == "EIGN":
            columns.append([len(columns) + 1, rid, 4, int(fields[6]), 0, 1, 0, 0, 0])
            values.append([s[0][int(fields[6]) - 1] for s in slopes])
            continue
        component, mode = int(fields[6]), int(fields[7])
        for g in (int(f) for f in fields[8:] if f):
            columns.append([len(columns) + 1, rid, 5, g, component, 1, 0, 0, 0])
            values.append([s[1][at[g], component - 1, mode - 1] for s in slopes])
    return np.array(columns), np.array(values).T


def write(
    out: Path,
    kind: str,
    model: Model,
    modes: ModeSet,
    design: tuple[np.ndarray, np.ndarray] | None,
) -> None:
    nodes, motion = model["GRID"].ids, local(model, modes)
    lam = np.sign(modes.frequencies) * (2 * np.pi * modes.frequencies) ** 2
    top = float(modes.frequencies[-1]) * 1.001 + 1e-3
    count = f"NUMBER OF EIGENVALUES BELOW THIS VALUE = {len(lam):5d}"
    text = f" TRIAL EIGENVALUE = {lam[-1]:.6E}, CYCLES = {top:.6E} {count}\n"
    if kind == "f06":
        text += printed(lam, nodes, motion)
    out.with_suffix(".f06").write_text(text)
    if kind == "h5":
        write_h5(out.with_suffix(".h5"), lam, nodes, motion)
    writer = Op2Writer()
    writer.head()
    if kind == "op2":
        writer.modes(lam, nodes, motion, np.ones(lam.size))
    if design is not None:
        writer.table("DSCMCOL", [design[0].ravel().tolist()])
        writer.matrix("DSCM2", design[1])
    writer.write(out.with_suffix(".op2"))


def printed(lam: np.ndarray, nodes: np.ndarray, motion: np.ndarray) -> str:
    text = "    R E A L   E I G E N V A L U E S\n"
    for k, v in enumerate(lam):
        text += (
            f"{k + 1:9d}{k + 1:10d}"
            + "".join(f"{x:20.6E}" for x in (v, 0.0, 0.0, 1.0, v))
            + "\n"
        )
    for k in range(lam.size):
        text += (
            f"      R E A L   E I G E N V E C T O R   N O .  {k + 1:10d}\n      POINT ID.   "
            "TYPE          T1\n"
        )
        for n, v in zip(nodes.tolist(), motion[:, :, k], strict=True):
            text += f" {n:13d}      G  " + "".join(f"{x:15.6E}" for x in v) + "\n"
    return text


def write_h5(
    path: Path, lam: np.ndarray, nodes: np.ndarray, motion: np.ndarray
) -> None:
    names = ("X", "Y", "Z", "RX", "RY", "RZ")
    shapes = np.zeros(
        nodes.size * lam.size,
        dtype=[("ID", "i8"), *((n, "f8") for n in names), ("DOMAIN_ID", "i8")],
    )
    shapes["ID"], shapes["DOMAIN_ID"] = (
        np.tile(nodes, lam.size),
        np.repeat(np.arange(lam.size) + 2, nodes.size),
    )
    for c, name in enumerate(names):
        shapes[name] = motion[:, c].T.ravel()
    ints = ("ID", "SUBCASE", "ANALYSIS", "MODE", "SE")
    domains = np.zeros(
        lam.size, dtype=[(n, "i8") for n in ints] + [("TIME_FREQ_EIGR", "f8")]
    )
    domains["ID"], domains["MODE"], domains["TIME_FREQ_EIGR"] = (
        np.arange(lam.size) + 2,
        np.arange(lam.size) + 1,
        lam,
    )
    domains["SUBCASE"], domains["ANALYSIS"] = 1, 2
    with h5py.File(path, "w") as file:
        file["NASTRAN/RESULT/NODAL/EIGENVECTOR"], file["NASTRAN/RESULT/DOMAINS"] = (
            shapes,
            domains,
        )


def main() -> int:
    behaviour, kind, name = sys.argv[1:]
    path = Path(name)
    if behaviour == "hang":
        time.sleep(600)
    if behaviour == "background":
        return 0
    if behaviour == "fatal":
        path.with_suffix(".f06").write_text(
            " *** USER FATAL MESSAGE 9050 (SEKRRS)\n     RUN TERMINATED DUE TO EXCESSIVE PIVOT "
            "RATIOS\n"
        )
        return 0
    deck = cards(path)
    model, wanted = read_deck(path), request(deck)
    design = (
        sensitivities(model, deck, wanted)
        if path.read_text().startswith("SOL 200")
        else None
    )
    write(path, kind, model, solve(model, wanted), design)
    if behaviour in ("full", "cut"):
        for ending in (".op2", ".h5"):
            file = path.with_suffix(ending)
            if file.is_file():
                file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    if behaviour == "full":
        sys.stderr.write("forrtl: No space left on device\n")
        return 28
    return 0


if __name__ == "__main__":
    sys.exit(main())
