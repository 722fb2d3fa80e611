"""Result files of Nastran: the same modes and the same deck as other readers have of them.

    python bench/results_files.py

Every OP2 file of the data beside the clone: eigenvalues, eigenvectors and frequency responses
against pyNastran's, and the deck that is rebuilt of GEOM1 to GEOM4: places of the nodes, and nodes
and property of each element.
A file without modes or without geometry is named with what it holds. F06 and punch files have the
modes of the HDF5 file of the same run. OP4: matrices that pyyeti writes, in every form that it has.
"""

from __future__ import annotations

import itertools
import json
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from outcome import ROOT, Check, Report, arguments, at_most, peer_program

from ringtrue.core.arrays import Float
from ringtrue.decks.nastran.results.geometry import read_recorded_model
from ringtrue.decks.nastran.results.modes import read_recorded
from ringtrue.decks.nastran.results.op2 import read_tables
from ringtrue.decks.nastran.results.op2_motions import described, read_op2_responses
from ringtrue.errors import DataError
from ringtrue.io.matrices import read_op4
from ringtrue.model.model import Model

DATA = ROOT.parent / "shared" / "data" / "fe"
TITLE = b"R E A L   E I G E N V E C T O R   N O"
SINGLE = 1e-6  # relative, of numbers of single precision and of seven digits in print
ANSWERS = """
import json, sys
import numpy as np
from pyNastran.op2.op2 import OP2
from pyNastran.op2.op2_geom import OP2Geom
out = {}
for path in sys.argv[2:]:
    found = out[path] = {}
    try:
        file = OP2(debug=None)
        file.read_op2(path)
        for shapes in list(file.eigenvectors.values())[:1]:
            if type(shapes).__name__ == "RealEigenvectorArray":
                found["eigenvalues"] = np.asarray(shapes.eigns, dtype=float).tolist()
                found["nodes"] = shapes.node_gridtype[:, 0].tolist()
                found["motion"] = shapes.data.astype(float).tolist()
        for shapes in list(file.displacements.values())[:1]:
            if type(shapes).__name__ == "ComplexDisplacementArray":
                found["response"] = [
                    shapes.node_gridtype[:, 0].tolist(),
                    shapes._times.tolist(),
                    shapes.data.real.tolist(),
                    shapes.data.imag.tolist(),
                ]
    except BaseException as e:
        found["no modes"] = f"{type(e).__name__}: {e}".splitlines()[0][:80]
    try:
        file = OP2Geom(debug=None)
        file.read_op2(path)
        found["places"] = {n: list(map(float, node.xyz)) for n, node in file.nodes.items()}
        found["elements"] = {
            n: [e.type, [k or 0 for k in e.node_ids], max(getattr(e, "pid", 0), 0)]
            for n, e in file.elements.items()
        }
    except BaseException as e:
        found["no deck"] = f"{type(e).__name__}: {e}".splitlines()[0][:80]
json.dump(out, open(sys.argv[1], "w"))
"""
FORMS = """
import sys, json
import numpy as np
from pyyeti.nastran import op4
values = dict(np.load(sys.argv[2]))
for name, binary, form, order in json.loads(sys.argv[3]):
    op4.write(
        sys.argv[1] + "/" + name, list(values), list(values.values()),
        binary=binary, sparse=form, endian=order,
    )
"""


def apart(mine: Any, theirs: Any) -> float:
    """The largest difference over the largest size; infinite if the shapes differ."""
    a = np.asarray(mine, dtype=np.float64)
    b = np.asarray(theirs, dtype=np.float64)
    if a.shape != b.shape:
        return np.inf
    return float(np.abs(a - b).max(initial=0) / max(np.abs(b).max(initial=0), 1e-300))


def same_modes(
    eigenvalues: tuple[Float, Float], motion: tuple[Float, Float]
) -> list[Check]:
    """Ours and theirs: eigenvalues (m,), and motion of the nodes (m, n, 6)."""
    return [
        at_most("eigenvalues off", apart(*eigenvalues), SINGLE),
        at_most("eigenvectors off", apart(*motion), SINGLE),
    ]


def same_deck(
    mine: dict[int, Any], theirs: dict[int, Any], places: float
) -> list[Check]:
    """Elements by number: card, nodes and property; and how far the nodes are apart, relative."""
    other = [n for n in set(mine) | set(theirs) if mine.get(n) != theirs.get(n)]
    return [
        at_most("elements otherwise", len(other), 0),
        at_most("nodes off", places, SINGLE),
    ]


def by_peer(python: str, script: str, *words: str) -> str:
    """Run a script by the Python of a peer; what it says if it fails."""
    done = subprocess.run(
        [python, "-c", script, *words], capture_output=True, text=True, check=False
    )
    return (
        (done.stderr.strip().splitlines() or ["no answer"])[-1]
        if done.returncode
        else ""
    )


def elements_of(model: Model) -> dict[int, Any]:
    """Card, nodes and property of each element but for masses, by number."""
    out: dict[int, Any] = {}
    for card, table in model.tables.items():
        names = list(table.columns)
        if (
            names[0] != "EID"
            or not card.startswith("C")
            or card.startswith(("CONM", "CMASS"))
        ):
            continue
        ends = (
            "GA",
            "GB",
            "G",
            *(f"{letter}{k}" for k in range(1, 21) for letter in "GS"),
        )
        nodes = table.stack(
            *(n for n in ends if n in names and f"{card}{n}" not in _NO_NODES)
        )
        pid = table["PID"] if "PID" in names else np.zeros(len(table), dtype=int)
        for number, row, of in zip(
            table.ids.tolist(), nodes.tolist(), pid.tolist(), strict=True
        ):
            out[number] = [card, sorted(n for n in row if n), of]
    return out


_NO_NODES = frozenset({"CBUSHS1", "CBUSHS2", "CBUSHS3"})  # offsets


def op2_file(report: Report, path: Path, theirs: dict[str, Any]) -> None:
    """One row: what is in the file, and how it compares."""
    checks = []
    said = []
    try:
        modes = read_recorded(path)
        said.append(f"{modes.eigenvalues.size} modes at {modes.nodes.size} nodes")
        if "motion" in theirs:
            at = np.argsort(modes.nodes)
            motion = np.moveaxis(modes.motion[at], 2, 0)
            their_motion = np.array(theirs["motion"])[:, np.argsort(theirs["nodes"])]
            checks += same_modes(
                (modes.eigenvalues, np.array(theirs["eigenvalues"])),
                (motion, their_motion),
            )
        else:
            said.append(f"pyNastran: {theirs.get('no modes', 'no modes')}")
    except DataError:
        held = {t.name + described(t) for t in read_tables(path)}
        motions = ", ".join(sorted(name for name in held if name.endswith(")")))
        said.append(f"no modes; {motions or 'no motion'}")
        checks.append(
            at_most("modes by pyNastran", len(theirs.get("eigenvalues", ())), 0)
        )
    if "response" in theirs:
        checks += same_response(path, theirs["response"])
    checks += deck_of(path, theirs, said)
    report.row(f"{path.name}: {'; '.join(said)}", {}, checks)


def same_response(path: Path, theirs: list[Any]) -> list[Check]:
    """The frequency response of displacements of the first subcase."""
    nodes, times, real, imaginary = map(np.array, theirs)
    mine = next(r for r in read_op2_responses(path) if r.quantity == "displacements")
    motion = np.moveaxis(mine.motion, 2, 0)[:, np.argsort(mine.nodes)]
    order = np.argsort(nodes)
    off = max(
        apart(motion.real, real[:, order]),
        apart(motion.imag, imaginary[:, order]),
        apart(mine.frequencies, times),
    )
    return [at_most("frequency response off", off, SINGLE)]


def deck_of(path: Path, theirs: dict[str, Any], said: list[str]) -> list[Check]:
    """What is rebuilt of the deck, against pyNastran's."""
    try:
        found = read_recorded_model(path)
    except DataError:
        said.append("no deck")
        return [at_most("nodes by pyNastran", len(theirs.get("places", ())), 0)]
    grid = found.model["GRID"]
    said.append(f"deck of {len(grid)} nodes")
    if found.missing:
        names = ", ".join(name.partition(" ")[2] for name in found.missing)
        said.append(f"named and not rebuilt: {names}")
    if "places" not in theirs:
        said.append(f"pyNastran: {theirs['no deck']}")
        return []
    held = set(grid.ids.tolist())
    places = {int(n): v for n, v in theirs["places"].items() if int(n) in held}
    mine = dict(
        zip(grid.ids.tolist(), grid.stack("X1", "X2", "X3").tolist(), strict=True)
    )
    off = apart([mine[n] for n in sorted(mine)], [places[n] for n in sorted(places)])
    other = {
        int(n): (c, g, p)
        for n, (c, g, p) in theirs["elements"].items()
        if c != "PLOTEL"
    }
    sorted_ = {n: [c, sorted(k for k in g if k), p] for n, (c, g, p) in other.items()}
    return same_deck(elements_of(found.model), sorted_, off)


def printed(report: Report) -> None:
    """Modes of F06 and punch files against the HDF5 file of the run."""
    unprinted = list[Path]()
    for path in sorted([*DATA.rglob("*.f06"), *DATA.rglob("*.pch")]):
        try:
            mine = read_recorded(path)
        except DataError:
            unprinted.append(path)
            continue
        beside = [
            h for h in path.parent.glob("*.h5") if h.stem.lower() == path.stem.lower()
        ]
        for h5 in beside:
            other = read_recorded(h5)
            pairs = (mine.eigenvalues, other.eigenvalues), (mine.motion, other.motion)
            what = f"{path.parents[1].name}: {path.name} and {h5.name}"
            report.row(what, {}, same_modes(*pairs))
    with_title = [path for path in unprinted if TITLE in path.read_bytes()]
    report.row(
        f"refused: {len(unprinted)} F06 and punch files, without real eigenvectors",
        {},
        [at_most("of them with such a title", len(with_title), 0)],
    )


def forms() -> Iterator[tuple[str, bool, str, str]]:
    """File name, binary, form and byte order of the OP4 files."""
    for form, order in itertools.product(("dense", "bigmat", "nonbigmat"), "<>"):
        yield (
            f"binary {form} {'little' if order == '<' else 'big'}-endian",
            True,
            form,
            order,
        )
    for form in ("dense", "bigmat", "nonbigmat"):
        yield f"ascii {form}", False, form, "<"


def op4_files(report: Report, python: str) -> None:
    """Real and complex matrices with holes."""
    rng = np.random.default_rng(3)
    real = rng.normal(size=(90, 40)) * (rng.random((90, 40)) < 0.3)
    values = {"k": real, "z": real[:40] + 1j * real[50:]}
    with tempfile.TemporaryDirectory() as folder:
        np.savez(f"{folder}/values.npz", **values)
        every = list(forms())
        why = by_peer(python, FORMS, folder, f"{folder}/values.npz", json.dumps(every))
        if why:
            report.not_run("pyyeti", why)
            return
        checks = []
        for name, *_ in every:
            found = read_op4(Path(folder) / name)
            off = [
                apart(part(found[n.upper()].toarray()), part(v))
                for n, v in values.items()
                for part in (np.real, np.imag)
            ]
            checks.append(at_most(name, max(off), 1e-15))
        report.row("OP4 that pyyeti writes: real and complex, values off", {}, checks)


def main() -> None:
    """All files that are here."""
    report = Report(arguments(__doc__).parse_args())
    if not DATA.exists():
        report.not_run("all files", f"no folder {DATA.name} beside the repository")
        report.end()
    python = peer_program("pynastran")
    if python is None:
        report.not_run("pyNastran", "not installed")
    else:
        paths = sorted(DATA.rglob("*.op2"))
        with tempfile.TemporaryDirectory() as folder:
            answers = Path(folder) / "answers.json"
            why = by_peer(python, ANSWERS, str(answers), *map(str, paths))
            if why:
                report.not_run("pyNastran", why)
            else:
                theirs = json.loads(answers.read_text(encoding="utf-8"))
                for path in paths:
                    op2_file(report, path, theirs[str(path)])
    printed(report)
    if python := peer_program("pyyeti"):
        op4_files(report, python)
    else:
        report.not_run("pyyeti", "not installed")
    report.end()


if __name__ == "__main__":
    main()
