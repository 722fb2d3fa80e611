"""Decks with recorded results of MSC Nastran and Simcenter Nastran: how far ringtrue is from them.

    python bench/nastran_corpus.py

Every deck of the data beside the clone that has recorded natural frequencies or displacements is
read and solved as it is. Modes are compared one by one in ascending order; a static solution by the
largest difference of a translation over the largest recorded one, the worst load case counting.
`CASES` has the limit of each deck: 1 % or less, or more with its reason. Where they are installed,
MYSTRAN solves the same decks for modes, and CalculiX those of solids and shells that
calculix_input.py translates; their deviations stand beside. Not covered: what `LEFT_OUT` names, and
statics by MYSTRAN.
"""

from __future__ import annotations

import logging
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import calculix_input
import h5py
import numpy as np
from outcome import ROOT, Check, Peer, Report, arguments, at_most, peer_program

from ringtrue.core.arrays import Float, Int
from ringtrue.decks.nastran.reader import read_deck, read_loaded_deck
from ringtrue.decks.nastran.results.modes import read_recorded_deflections
from ringtrue.decks.nastran.results.op2 import read_tables
from ringtrue.decks.nastran.results.op2_motions import read_op2
from ringtrue.errors import RingtrueError, SolverMissing
from ringtrue.fem.element_cards import mesh
from ringtrue.model.case_control import condenses
from ringtrue.model.frames import axes, positions
from ringtrue.model.model import Model
from ringtrue.model.ports import ModalSolver, ModesRequest
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.solvers.mystran import MystranSolver, find_mystran
from ringtrue.study.loads import load_vectors, support_motions

DATA = ROOT.parent / "shared" / "data" / "fe"
RIGID = 1e-3  # of the highest recorded frequency of a deck: below is a rigid-body mode
# of the largest recorded displacement of a deck: a load case that moves nothing
ROUNDING = 1e-9
SINGULAR = 1e6  # %: what rounding makes of a mechanism
DIGITS = 1e-4  # %: recorded with seven digits and more
NOTHING = 1e-6  # %: less is not told apart
SINGLE = "corpus/unit"
VERIFIED = "msc2019/system_verification"
BAR = "msc2019/superelements/cantilever_bar"
THREE = "msc2019/superelements/three_element_types"


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
        How many of the recorded modes are compared; 0: all. Those of nx_sine above its band are
        residual vectors.
    """

    folder: str
    deck: str
    results: str
    limit: float = DIGITS
    why: str = ""
    first: int = 0


CASES = (
    Case("beam_modes", "beam_modes.dat", "beam_modes_m2.op2"),
    Case("naca_wing", "0012_flutter.bdf", "0012_flutter.op2"),
    Case("corpus/complex/tet10", "Simple_Example.bdf", "simple_example.f06", 0.8),
    Case("corpus/nx/sol111_solid_stress", "nx_sine.bdf", "nx_sine.op2", 0.05, first=8),
    Case("corpus/plate", "plate.bdf", "plate.op2"),
    Case("corpus/plate", "plate_mixed.bdf", "plate_mixed.op2", 0.12),
    Case("corpus/plate_py", "plate_py.dat", "plate_py.op2"),
    Case("corpus/random", "random_test_bar_plus_tri.bdf", "random_test_bar_plus_tri.op2", 0.15),
    Case("corpus/random", "rms_tri_oesrmx1.bdf", "rms_tri_oesrmx1.op2", 0.25),
    Case("corpus/sol_101_elements", "static_solid_shell_bar.bdf", "static_solid_shell_bar.op2", 0.01),
    Case("corpus/solid_bending", "solid_bending.bdf", "solid_bending.op2"),
    Case("corpus/wingbox", "wingbox_stitched_together-000.bdf", "wingbox_stitched_together-000.op2", 0.18),
    Case(f"{SINGLE}/bars", "pbarl_bar_100.bdf", "pbarl_bar_100.op2"),
    Case(f"{SINGLE}/cbush", "cbush.dat", "cbush.op2"),
    Case(f"{SINGLE}/pcomp", "pcomp_cquad4.bdf", "pcomp_cquad4.op2", 0.25),
    Case(f"{SINGLE}/pload4", "chexa.bdf", "chexa.op2"),
    Case(f"{SINGLE}/pload4", "cpenta.bdf", "cpenta.op2"),
    Case(f"{SINGLE}/pload4", "ctetra.bdf", "ctetra.op2"),
    Case(f"{SINGLE}/pload4", "ctetra10.bdf", "ctetra10.op2"),
    Case(f"{SINGLE}/pload4", "pload1.bdf", "pload1.op2"),
    Case(f"{BAR}/no_super", "noReduction.dat", "noReduction.h5"),
    Case(f"{BAR}/no_super", "guyanReduction.dat", "guyanReduction.h5"),
    Case(f"{BAR}/no_super", "dynamicReduction.dat", "dynamicReduction.h5"),
    Case(f"{THREE}/no_super", "noReduction-000.dat", "noreduction-000.h5"),
    Case(f"{THREE}/no_super", "noReduction-static.dat", "noreduction-static.h5"),
    Case(f"{THREE}/no_super", "guyanReduction-000.dat", "guyanreduction-000.h5"),
    Case(f"{THREE}/no_super", "guyanReduction-static.dat", "guyanreduction-static.h5"),
    Case(f"{THREE}/no_super", "dynamicReduction.dat-000.dat", "dynamicreduction.dat-000.h5"),
    Case(f"{THREE}/no_super", "dynamicReduction-static.dat", "dynamicreduction-static.h5"),
    Case(f"{BAR}/part_super_guyan", "guyanSuper.dat", "guyanSuper.h5"),
    *(
        Case(f"{BAR}/part_super_cb", f"{kind}.dat", f"{kind}.h5")
        for kind in ("cbSuper1Mode", "cbSuper2Modes", "cbSuper3Modes")
    ),
    Case(f"{THREE}/part_super_guyan", "guyanSuper.dat", "guyansuper.h5"),
    Case(f"{THREE}/part_super_cb", "cbSuper.dat", "cbsuper.h5"),
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
    "guyanSuperStatic of superelements": "no recorded results",
    "cbar_orientation, cquad4, ctria3 of corpus/unit": "all recorded displacements are 0",
    "modes_elements, static_elements of corpus/elements": "mechanisms, without AUTOSPC",
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
    off = [
        np.abs(a - b).max() / np.abs(b).max()
        for a, b in zip(found, recorded, strict=True)
    ]
    return Deviation(100 * float(np.max(off)), len(recorded))


def near(case: Case, off: Deviation) -> Check:
    """Whether a deck is as near to what is recorded as it is said to be."""
    why = f" ({case.why})" if case.why else ""
    return at_most(
        f"the worst of {off.answers}{why} is off by", off.percent, case.limit, "%"
    )


def recorded_frequencies(path: Path) -> Float:
    """(m,) Hz, ascending; of the first subcase with modes in a file of several."""
    if path.suffix == ".h5":
        with h5py.File(path) as file:
            table = file["NASTRAN/RESULT/SUMMARY/EIGENVALUE"][()]
        first = table[table["DOMAIN_ID"] == table["DOMAIN_ID"].min()]
        return np.sort(np.asarray(first["FREQ"], dtype=np.float64))
    if path.suffix == ".f06":
        text = path.read_text(encoding="latin-1").split(
            "R E A L   E I G E N V A L U E S"
        )[1]
        rows = re.findall(
            r"^ +\d+ +\d+ +\S+E\S+ +\S+E\S+ +(\S+E\S+)", text, re.MULTILINE
        )
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
    found = read_recorded_deflections(path)
    if found is None:
        return {}
    return {
        case: (found.nodes, found.motion[:, :3, k])
        for k, case in enumerate(found.cases)
    }


def solved_frequencies(deck: Path, solver: ModalSolver, count: int) -> Float:
    """(m,) Hz, ascending."""
    with solver.open(read_deck(deck)) as analysis:
        return analysis.modes(ModesRequest(count)).modes.frequencies[:count]


def compared(
    model: Model, names: Sequence[str], recorded: dict[int, tuple[Int, Float]]
) -> Iterator[tuple[int, Int, Float]]:
    """The load cases that are recorded and move: which, the rows of the nodes in the table of GRID
    (n,), and their translations (n, 3) in basic.
    """
    grid = model["GRID"]
    largest = max(np.abs(motion).max() for _, motion in recorded.values())
    for j, name in enumerate(names):
        number = int(name.split()[-1]) if name != "LOAD" else min(recorded)
        if number not in recorded:
            continue
        if np.abs(recorded[number][1]).max() <= ROUNDING * largest:
            continue
        nodes, motion = recorded[number]
        row = grid.find(nodes)
        there = row >= 0
        turn = axes(model, grid["CD"][row[there]], positions(model)[row[there]])
        yield j, row[there], np.einsum("nji,nj->ni", turn, motion[there])


def solved_displacements(
    deck: Path, recorded: dict[int, tuple[Int, Float]]
) -> tuple[list[Float], list[Float]]:
    """Translations (node, 3) in basic of each load case that moves, and those recorded."""
    model, cases = read_loaded_deck(deck)
    with EmbeddedSolver().open(model) as analysis:
        drawn, carried = support_motions(model, analysis.dofs, cases)
        moved = (
            analysis.static(load_vectors(model, analysis.dofs, cases) + drawn) + carried
        )
    grids = moved[: 6 * len(model["GRID"])].reshape(-1, 6, len(cases))
    told = list(compared(model, [c.name for c in cases], recorded))
    return [grids[row, :3, j] for j, row, _ in told], [motion for _, _, motion in told]


def deviation(case: Case) -> tuple[str, Deviation]:
    """Of ringtrue: what was compared, and how far it is off; not a number where it is refused."""
    deck = DATA / case.folder / case.deck
    results = deck.with_name(case.results)
    try:
        if recorded := recorded_displacements(results):
            return "statics", displacements_off(*solved_displacements(deck, recorded))
        want = recorded_frequencies(results)[: case.first or None]
        return "modes", modes_off(
            solved_frequencies(deck, EmbeddedSolver(), want.size), want
        )
    except RingtrueError as e:
        return str(e), Deviation(np.nan, 0)


class NotRun(Exception):
    """A deck that another program does not solve, and why."""


def of_mystran(case: Case) -> Peer:
    """The deviation of MYSTRAN's modes, or of half of them where it finds no more.

    Raises
    ------
    NotRun
        Where it stops, and of condensed models, of which it is given the whole mesh.
    """
    deck = DATA / case.folder / case.deck
    if condenses(read_deck(deck)):
        raise NotRun(f"{case.deck}: condensed")
    want = recorded_frequencies(deck.with_name(case.results))[: case.first or None]
    said = ""
    for count in (want.size, max(want.size // 2, 1)):
        try:
            found = solved_frequencies(deck, MystranSolver(timeout=120.0), count)
        except RingtrueError as e:
            said = " ".join(str(e).split()).removeprefix(
                "mystran stopped with a fatal error:"
            )
            continue
        off = modes_off(found, want[:count])
        if np.isfinite(off.percent):
            return Peer(f"MYSTRAN, lowest {count}", {"%": max(off.percent, NOTHING)})
        said = "fewer modes than asked for"
    raise NotRun(f"{case.deck}: {said.strip()[:60]}")


def of_calculix(case: Case, program: str) -> Peer:
    """The deviation of CalculiX, of half of the modes where it finds no more.

    Raises
    ------
    NotRun
        Where the deck is not translated, or CalculiX ends without results.
    """
    deck = DATA / case.folder / case.deck
    results = deck.with_name(case.results)
    recorded = recorded_displacements(results)
    want = (
        np.zeros(0) if recorded else recorded_frequencies(results)[: case.first or None]
    )
    name = "CalculiX"
    off = Deviation(np.nan, 0)
    try:
        with tempfile.TemporaryDirectory() as folder:
            if recorded:
                off = _calculix_statics(Path(folder), program, deck, recorded)
            for count in () if recorded else (want.size, max(want.size // 2, 1)):
                if not np.isfinite(off.percent):
                    text = calculix_input.written(read_deck(deck))
                    text += calculix_input.frequency_step(count)
                    found = calculix_input.frequencies(
                        calculix_input.run(program, Path(folder), text)
                    )
                    off = modes_off(found[:count], want[:count])
                    name = f"CalculiX, lowest {count}"
    except calculix_input.OtherDeck as e:
        raise NotRun(f"{case.deck}: {e}") from None
    if not np.isfinite(off.percent):
        raise NotRun(f"{case.deck}: it ended without these results")
    if off.percent > SINGULAR:
        raise NotRun(f"{case.deck}: a mechanism with its elements")
    return Peer(name, {"%": max(off.percent, NOTHING)})


def _calculix_statics(
    folder: Path, program: str, deck: Path, recorded: dict[int, tuple[Int, Float]]
) -> Deviation:
    model, cases = read_loaded_deck(deck)
    acting = load_vectors(model, mesh(model).dofs, cases)
    text = calculix_input.written(model)
    text += calculix_input.static_steps(model, acting)
    results = calculix_input.run(program, folder, text)
    found = calculix_input.displacements(results, model["GRID"].ids)
    told = list(compared(model, [c.name for c in cases], recorded))
    if len(found) != len(cases):
        return Deviation(np.nan, len(told))
    return displacements_off(
        [found[j][row] for j, row, _ in told], [u for _, _, u in told]
    )


def installed(report: Report) -> dict[str, Callable[[Case], Peer]]:
    """The other programs that are here."""
    found: dict[str, Callable[[Case], Peer]] = {}
    try:
        find_mystran()
        found["MYSTRAN"] = of_mystran
    except SolverMissing:
        report.not_run("MYSTRAN", "not installed")
    if calculix := peer_program("ccx", "ccx") or shutil.which("ccx"):
        found["CalculiX"] = partial(of_calculix, program=calculix)
    else:
        report.not_run("CalculiX", "not installed")
    return found


def main() -> None:
    """All decks that are here."""
    report = Report(arguments(__doc__).parse_args())
    logging.getLogger("ringtrue").setLevel(logging.ERROR)
    if not DATA.exists():
        report.not_run("all decks", f"no folder {DATA.name} beside the repository")
        report.end()
    for name, why in LEFT_OUT.items():
        report.not_run(name, why)
    programs = installed(report)
    left: dict[str, list[str]] = {name: [] for name in programs}
    for case in CASES:
        what, off = deviation(case)
        peers = []
        for name, of_program in programs.items():
            if name == "MYSTRAN" and what != "modes":
                continue
            try:
                peers.append(of_program(case))
            except NotRun as e:
                left[name].append(str(e))
        cost = {"%": max(off.percent, NOTHING)}
        deck = f"{case.folder.removesuffix('/nastran_runs')}/{case.deck}"
        report.row(f"{deck}: {what}", cost, [near(case, off)], peers)
    for name, decks in left.items():
        report.not_run(f"{name} on {len(decks)} decks", "; ".join(decks))
    report.end()


if __name__ == "__main__":
    main()
