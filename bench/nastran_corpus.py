"""Decks with recorded results of MSC Nastran and Simcenter Nastran: how far ringtrue is from them.

    python bench/nastran_corpus.py

Every deck of the data beside the clone that has recorded natural frequencies or displacements is
read and solved as it is. Modes are compared one by one in ascending order; a static solution by the
largest difference of a translation over the largest recorded one, the worst load case counting.
`CASES` has the limit of each deck: 1 % or less, or more with its reason. MYSTRAN, where it is
installed, solves the same decks for modes, and its deviation stands beside. Not covered: what
`LEFT_OUT` names, statics by MYSTRAN, and CalculiX, which reads no Nastran decks.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from outcome import ROOT, Check, Peer, Report, arguments, at_most

from ringtrue.core.arrays import Float, Int
from ringtrue.decks.nastran.reader import read_deck, read_loaded_deck
from ringtrue.decks.nastran.results.op2 import Op2Table, read_op2, read_tables
from ringtrue.errors import RingtrueError, SolverMissing
from ringtrue.model.frames import axes, positions
from ringtrue.model.ports import ModalSolver, ModesRequest
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.solvers.mystran import MystranSolver, find_mystran
from ringtrue.study.loads import load_vectors, support_motions

DATA = ROOT.parent / "shared" / "data" / "fe"
RIGID = 1e-3  # of the highest recorded frequency of a deck: below is a rigid-body mode
DIGITS = 1e-4  # %: recorded with seven digits and more
NOTHING = 1e-6  # %: less is not told apart
SINGLE = "corpus/unit"
VERIFIED = "msc2019/system_verification"
BAR = "msc2019/superelements/cantilever_bar"
THREE = "msc2019/superelements/three_element_types"
LUMPED = "lumped mass of CTETRA10 is split otherwise"
SHELLS = "shells bend too stiffly on coarse meshes"


@dataclass(frozen=True, slots=True)
class Case:
    """A deck, its recorded results, and how near to them it is said to be.

    Attributes
    ----------
    folder, deck, results : str
        `results` beside the deck.
    limit : float, %
    why : str
        Of a limit above 1 %.
    first : int
        How many of the recorded modes are compared; 0: all.
    """

    folder: str
    deck: str
    results: str
    limit: float = DIGITS
    why: str = ""
    first: int = 0


GUYAN = "recorded on the DOFs of ASET; ringtrue solves the full model"
CASES = (
    Case("beam_modes", "beam_modes.dat", "beam_modes_m2.op2"),
    Case("naca_wing", "0012_flutter.bdf", "0012_flutter.op2"),
    Case("corpus/complex/tet10", "Simple_Example.bdf", "simple_example.f06", 24.0, LUMPED),
    Case("corpus/nx/sol111_solid_stress", "nx_sine.bdf", "nx_sine.op2", 122.5, SHELLS),
    Case("corpus/plate", "plate.bdf", "plate.op2"),
    Case("corpus/plate", "plate_mixed.bdf", "plate_mixed.op2", 1.8, SHELLS),
    Case("corpus/plate_py", "plate_py.dat", "plate_py.op2", 0.65),
    Case("corpus/random", "random_test_bar_plus_tri.bdf", "random_test_bar_plus_tri.op2", 9.9, SHELLS),
    Case("corpus/random", "rms_tri_oesrmx1.bdf", "rms_tri_oesrmx1.op2", 0.4),
    Case("corpus/sol_101_elements", "static_solid_shell_bar.bdf", "static_solid_shell_bar.op2", 1.5, SHELLS),
    Case("corpus/solid_bending", "solid_bending.bdf", "solid_bending.op2"),
    Case("corpus/wingbox", "wingbox_stitched_together-000.bdf", "wingbox_stitched_together-000.op2", 8.5, SHELLS),
    Case(f"{SINGLE}/bars", "pbarl_bar_100.bdf", "pbarl_bar_100.op2"),
    Case(f"{SINGLE}/cbush", "cbush.dat", "cbush.op2"),
    Case(f"{SINGLE}/pcomp", "pcomp_cquad4.bdf", "pcomp_cquad4.op2", 1.4, SHELLS),
    Case(f"{SINGLE}/pload4", "chexa.bdf", "chexa.op2", 0.96),
    Case(f"{SINGLE}/pload4", "cpenta.bdf", "cpenta.op2", 11.0, "a single CPENTA, of other strains"),
    Case(f"{SINGLE}/pload4", "ctetra.bdf", "ctetra.op2"),
    Case(f"{SINGLE}/pload4", "ctetra10.bdf", "ctetra10.op2"),
    Case(f"{SINGLE}/pload4", "pload1.bdf", "pload1.op2"),
    Case(f"{BAR}/no_super", "noReduction.dat", "noReduction.h5"),
    Case(f"{BAR}/no_super", "guyanReduction.dat", "guyanReduction.h5", 2.7, GUYAN, 1),
    Case(f"{BAR}/no_super", "dynamicReduction.dat", "dynamicReduction.h5", 0.13, first=3),
    Case(f"{THREE}/no_super", "noReduction-000.dat", "noreduction-000.h5"),
    Case(f"{THREE}/no_super", "noReduction-static.dat", "noreduction-static.h5"),
    Case(f"{THREE}/no_super", "guyanReduction-000.dat", "guyanreduction-000.h5", 11.0, GUYAN, 2),
    Case(f"{THREE}/no_super", "guyanReduction-static.dat", "guyanreduction-static.h5"),
    Case(f"{THREE}/no_super", "dynamicReduction.dat-000.dat", "dynamicreduction.dat-000.h5", 0.2, first=4),
    Case(f"{THREE}/no_super", "dynamicReduction-static.dat", "dynamicreduction-static.h5"),
    *(
        Case(f"{VERIFIED}/{folder}/nastran_runs", f"{kind}.dat", f"{kind}.h5")
        for folder, kinds in {
            "001_ten_bar_truss": ("modes", "static", "buckling"),
            "002_svanberg_beam": ("modes", "static"),
            "003_svanberg_bar": ("modes", "static"),
            "004_72_bar_truss": ("modes", "static"),
        }.items()
        for kind in kinds
    ),
)  # fmt: skip
LEFT_OUT = {
    "8 decks of superelements": "BEGIN SUPER and SEBULK are refused",
    "cbar_orientation, cquad4, ctria3 of corpus/unit": "all recorded displacements are 0",
    "modes_elements, static_elements of corpus/elements": "mechanisms, without AUTOSPC",
    "CalculiX": "it reads no Nastran decks",
}


@dataclass(frozen=True, slots=True)
class Deviation:
    """Largest deviation of the answers in %, and how many there are."""

    percent: float
    answers: int


def modes_off(found: Float, recorded: Float) -> Deviation:
    """Frequencies (m,) and recorded ones (m,), Hz, both ascending; rigid-body modes must be such in
    both.
    """
    if not found.size == recorded.size > 0:
        return Deviation(np.nan, recorded.size)
    rigid = np.abs(recorded) <= RIGID * recorded.max()
    off = np.abs(found - recorded) / np.where(rigid, recorded.max(), recorded)
    off = np.where(rigid, np.where(off <= RIGID, 0.0, off), off)
    return Deviation(100 * float(off.max()), recorded.size)


def displacements_off(found: Sequence[Float], recorded: Sequence[Float]) -> Deviation:
    """Translations (node, 3) of each load case."""
    if not len(found) == len(recorded) > 0:
        return Deviation(np.nan, len(recorded))
    off = [np.abs(a - b).max() / np.abs(b).max() for a, b in zip(found, recorded, strict=True)]
    return Deviation(100 * float(np.max(off)), len(recorded))


def near(case: Case, off: Deviation) -> Check:
    """Whether a deck is as near to what is recorded as it is said to be."""
    why = f" ({case.why})" if case.why else ""
    return at_most(f"the worst of {off.answers}{why} is off by", off.percent, case.limit, "%")


def recorded_frequencies(path: Path) -> Float:
    """(m,) Hz, ascending; of the first subcase with modes in a file of several."""
    if path.suffix == ".h5":
        with h5py.File(path) as file:
            table = file["NASTRAN/RESULT/SUMMARY/EIGENVALUE"][()]
        first = table[table["DOMAIN_ID"] == table["DOMAIN_ID"].min()]
        return np.sort(np.asarray(first["FREQ"], dtype=np.float64))
    if path.suffix == ".f06":
        text = path.read_text(encoding="latin-1").split("R E A L   E I G E N V A L U E S")[1]
        rows = re.findall(r"^ +\d+ +\d+ +\S+E\S+ +\S+E\S+ +(\S+E\S+)", text, re.MULTILINE)
        return np.array(rows, dtype=np.float64)
    for table in read_tables(path):
        if table.name.startswith("LAMA"):
            return np.sort(table.floats(table.bodies()[1]).reshape(-1, 7)[:, 4])
    lam = read_op2(path).eigenvalues
    return np.sort(np.sign(lam) * np.sqrt(np.abs(lam)) / (2 * np.pi))


def recorded_displacements(path: Path) -> dict[int, tuple[Int, Float]]:
    """Nodes (n,) and their translations (n, 3) in their displacement frames, by subcase; none in a
    file of modes.
    """
    if path.suffix == ".h5":
        at = "NASTRAN/RESULT/NODAL/DISPLACEMENT"
        with h5py.File(path) as file:
            if at not in file:
                return {}
            table = file[at][()]
            domains = file["NASTRAN/RESULT/DOMAINS"][()]
        subcase = dict(zip(domains["ID"].tolist(), domains["SUBCASE"].tolist(), strict=True))
        rows = {subcase[i]: table[table["DOMAIN_ID"] == i] for i in np.unique(table["DOMAIN_ID"])}
        return {k: (r["ID"], np.stack([r[c] for c in "XYZ"], axis=1)) for k, r in rows.items()}
    out: dict[int, tuple[Int, Float]] = {}
    for table in read_tables(path) if path.suffix == ".op2" else ():
        if table.name.startswith("OUG") and len(table.records) > 2:
            bodies = table.bodies()
            for head, body in zip(bodies[::2], bodies[1::2], strict=True):
                words = table.ints(head)
                if (words[0] // 10, words[1]) == (1, 1):
                    out[int(words[3])] = _translations(table, body)
    return out


def _translations(table: Op2Table, body: bytes) -> tuple[Int, Float]:
    return table.ints(body).reshape(-1, 8)[:, 0] // 10, table.floats(body).reshape(-1, 8)[:, 2:5]


def solved_frequencies(deck: Path, solver: ModalSolver, count: int) -> Float:
    """(m,) Hz, ascending."""
    with solver.open(read_deck(deck)) as analysis:
        return analysis.modes(ModesRequest(count)).modes.frequencies[:count]


def solved_displacements(
    deck: Path, recorded: dict[int, tuple[Int, Float]]
) -> tuple[list[Float], list[Float]]:
    """Translations (node, 3) in basic of each load case that moves, and those recorded."""
    model, cases = read_loaded_deck(deck)
    grid = model["GRID"]
    with EmbeddedSolver().open(model) as analysis:
        drawn, carried = support_motions(model, analysis.dofs, cases)
        moved = analysis.static(load_vectors(model, analysis.dofs, cases) + drawn) + carried
    found = []
    told = []
    for j, case in enumerate(cases):
        number = int(case.name.split()[-1]) if case.name != "LOAD" else min(recorded)
        if number not in recorded:
            continue
        nodes, motion = recorded[number]
        at = grid.find(nodes)
        there = at >= 0
        row = at[there]
        turn = axes(model, grid["CD"][row], positions(model)[row])
        if motion.any():
            found.append(moved[: 6 * len(grid), j].reshape(-1, 6)[row, :3])
            told.append(np.einsum("nij,nj->ni", turn.swapaxes(1, 2), motion[there]))
    return found, told


def deviation(case: Case) -> tuple[str, Deviation]:
    """Of ringtrue: what was compared, and how far it is off; not a number where it is refused."""
    deck = DATA / case.folder / case.deck
    results = deck.with_name(case.results)
    try:
        if recorded := recorded_displacements(results):
            return "statics", displacements_off(*solved_displacements(deck, recorded))
        want = recorded_frequencies(results)[: case.first or None]
        return "modes", modes_off(solved_frequencies(deck, EmbeddedSolver(), want.size), want)
    except RingtrueError as e:
        return str(e), Deviation(np.nan, 0)


def of_mystran(report: Report, case: Case) -> list[Peer]:
    """The deviation of MYSTRAN's modes, or of half of them where its solver leaves so few DOFs that
    it cannot find all; none where it does not solve the deck.
    """
    deck = DATA / case.folder / case.deck
    want = recorded_frequencies(deck.with_name(case.results))[: case.first or None]
    said = ""
    for count in (want.size, max(want.size // 2, 1)):
        try:
            found = solved_frequencies(deck, MystranSolver(timeout=120.0), count)
        except RingtrueError as e:
            said = " ".join(str(e).split()).removeprefix("mystran stopped with a fatal error:")
            continue
        off = modes_off(found, want[:count])
        if np.isfinite(off.percent):
            return [Peer(f"MYSTRAN, lowest {count}", {"%": max(off.percent, NOTHING)})]
        said = "fewer modes than asked for"
    report.not_run(f"MYSTRAN on {case.folder}/{case.deck}", said.strip()[:120])
    return []


def main() -> None:
    """All decks that are here."""
    report = Report(arguments(__doc__).parse_args())
    logging.getLogger("ringtrue").setLevel(logging.ERROR)
    if not DATA.exists():
        report.not_run("all decks", f"no folder {DATA.name} beside the repository")
        report.end()
    for name, why in LEFT_OUT.items():
        report.not_run(name, why)
    try:
        find_mystran()
        installed = True
    except SolverMissing:
        report.not_run("MYSTRAN", "not installed")
        installed = False
    for case in CASES:
        what, off = deviation(case)
        peers = of_mystran(report, case) if installed and what == "modes" else []
        cost = {"%": max(off.percent, NOTHING)}
        name = f"{case.folder.removesuffix('/nastran_runs')}/{case.deck}: {what}"
        report.row(name, cost, [near(case, off)], peers)
    report.end()


if __name__ == "__main__":
    main()
