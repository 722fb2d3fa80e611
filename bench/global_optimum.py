"""How often an updating with frequencies, MAC and FRFs reaches the global optimum from the deck.

    python bench/global_optimum.py [--quick | --full]

Structures that are made here, with four parameters each that are drawn 20 to 60 % off, some up and
some down:

    plate   1.2 x 0.8 m, 6 mm, clamped along one edge, with ribs: plate, ribs along and across,
            springs at two corners
    frame   three storeys on a base of 1.6 x 1.1 m: columns of each storey, girders
    beam    6 m on four springs: both halves, both pairs of springs

Measured are the lowest modes at 12 to 16 channels (0.1 % of a frequency, 2 % of a shape) and
accelerances of one or two excitation points (3 %, and noise 80 dB below their root mean square)
with 1 %, or with 0.3 % of damping, where peaks that are shifted do not overlap. In one family the
FRFs cover twice as many modes as were identified. Each test is updated as `ringtrue update` does
it. The optimum is the end of the same updating from the truth, compared by the objective that the
study states; it is reached where J is at most `J_MOST` above. Beside it: all data at once from the
deck.

The plate and the frame have set how peaks are broadened; the beam has not. Decks whose density is
wrong, which no parameter can mend, must be said not to be fitted. No end at an optimum of the
others may be, and every other end must.

Not covered: errors of form that parameters imitate, wrong channels, wrong damping.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from outcome import Check, Peer, Report, arguments, at_least, at_most, sized

from ringtrue.api.study_update import UpdateRequest, update_study
from ringtrue.core.arrays import Float
from ringtrue.core.modes import ModeSet
from ringtrue.core.signals import Channel, FrfSet
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.fem.response import frf
from ringtrue.io.frfs import write_frfs
from ringtrue.io.modes import write_modes
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.study.direct import as_stated, not_fitted
from ringtrue.study.objective import course_of
from ringtrue.updating.problem import Problem
from ringtrue.updating.solver import Solution
from ringtrue.updating.strategy import settled, solve_verified, whole_cost

YOUNG = 2.1e11  # Pa
J_MOST = 1.0  # over that of the optimum: odds of e^-½, which the data do not decide
REACHED_LEAST = 95.0  # %
LINES = 900  # of the measured FRFs
SUMMED = 40  # modes
HEAVY = 1.25  # density of the unmendable deck


@dataclass(frozen=True, slots=True, eq=False)
class Structure:
    """A deck and its test.

    Attributes
    ----------
    name : str
    targets : dict of str to str
        Parameters.
    deck : callable (factors, density) -> str
    channels, inputs : tuple of str
    modes : int
        In the band.
    """

    name: str
    targets: dict[str, str]
    deck: Callable[[Float, float], str]
    channels: tuple[str, ...]
    inputs: tuple[str, ...]
    modes: int


@dataclass(frozen=True, slots=True)
class Family:
    """What is measured: damping, and the share of the modes in the band that were identified."""

    damping: float
    identified: float


@dataclass(frozen=True, slots=True)
class Case:
    """One updating: J at its end, at the optimum and of all at once; whether it says that the
    data are not fitted; its time.
    """

    found: float
    optimum: float
    at_once: float
    unfit: bool
    seconds: float

    @property
    def reached(self) -> bool:
        """Whether the end is the optimum."""
        return self.found <= self.optimum + J_MOST


def materials(factors: Float, density: float) -> list[str]:
    """A material for each modulus."""
    return [
        f"MAT1,{k},{YOUNG * a:.9e},,.3,{7850.0 * density:.6f}"
        for k, a in enumerate(factors.tolist(), start=1)
    ]


def whole(cards: list[str]) -> str:
    """The deck of some bulk data."""
    return "\n".join(
        ["SOL 103", "CEND", "SPC = 1", "BEGIN BULK", *cards, "ENDDATA", ""]
    )


def plate(a: Float, density: float) -> str:
    """12 x 8 shells, three ribs along, two across."""
    nx, ny = 12, 8
    cards = materials(a[:3], density)
    cards += [
        "PSHELL,1,1,.006,1",
        "PBARL,2,2,,BAR",
        ",.008,.03",
        "PBARL,3,3,,BAR",
        ",.008,.03",
    ]
    for i in range(nx + 1):
        for j in range(ny + 1):
            cards.append(
                f"GRID,{plate_node(i, j)},,{1.2 * i / nx:.5f},{0.8 * j / ny:.5f},0."
            )
    corners = [(i, j) for i in range(nx) for j in range(ny)]
    for k, (i, j) in enumerate(corners, start=1):
        nodes = [plate_node(i + p, j + q) for p, q in ((0, 0), (1, 0), (1, 1), (0, 1))]
        cards.append(f"CQUAD4,{k},1," + ",".join(map(str, nodes)))
    along = [
        (2, plate_node(i, j), plate_node(i + 1, j))
        for j in (0, 4, 8)
        for i in range(nx)
    ]
    across = [
        (3, plate_node(i, j), plate_node(i, j + 1)) for i in (4, 9) for j in range(ny)
    ]
    for k, (part, one, two) in enumerate([*along, *across], start=1001):
        cards.append(f"CBAR,{k},{part},{one},{two},0.,0.,1.")
    cards.append(f"PELAS,9,{4e4 * a[3]:.9e}")
    cards += [f"CELAS1,{2000 + j},9,{plate_node(nx, j)},3" for j in (0, ny)]
    return whole([*cards, f"SPC1,1,123456,1,THRU,{ny + 1}"])


def plate_node(i: int, j: int) -> int:
    """The node at station i along, j across."""
    return 1 + 9 * i + j


def frame(a: Float, density: float) -> str:
    """Three elements a member, masses at two corners of each floor."""
    plan = np.array([(0, 0), (1.6, 0), (1.6, 1.1), (0, 1.1)])
    at = {10 * s + q + 1: (*plan[q], 0.9 * s) for s in range(4) for q in range(4)}
    cards = materials(a, density)
    for storey in (1, 2, 3):
        cards += [f"PBARL,{storey},{storey},,BAR", ",.05,.04"]
        cards += [f"CONM2,{5000 + storey},{10 * storey + 1},,12."]
        cards += [f"CONM2,{5010 + storey},{10 * storey + 3},,{6 * storey}."]
    cards += ["PBARL,4,4,,BAR", ",.03,.06"]
    members = []
    for s in (1, 2, 3):
        for q in range(4):
            members.append((s, 10 * s - 9 + q, 10 * s + 1 + q, "1.,.3,0."))
            members.append((4, 10 * s + 1 + q, 10 * s + 1 + (q + 1) % 4, "0.,0.,1."))
    for m, (part, one, two, axis) in enumerate(members):
        nodes = [one, 1000 + 2 * m, 1001 + 2 * m, two]
        ends = np.array([at[one], at[two]])
        for node, share in zip(nodes[1:3], (1 / 3, 2 / 3), strict=True):
            x, y, z = (1 - share) * ends[0] + share * ends[1]
            cards.append(f"GRID,{node},,{x:.6f},{y:.6f},{z:.6f}")
        for k in range(3):
            cards.append(
                f"CBAR,{3 * m + k + 1},{part},{nodes[k]},{nodes[k + 1]},{axis}"
            )
    cards += [f"GRID,{n},,{x},{y},{z:.3f}" for n, (x, y, z) in at.items()]
    return whole([*cards, "SPC1,1,123456,1,THRU,4"])


def beam(a: Float, density: float) -> str:
    """30 elements; springs at 0, 2, 4 and 6 m."""
    cards = materials(a[:2], density)
    cards += [card for k in (1, 2) for card in (f"PBARL,{k},{k},,BAR", ",.05,.03")]
    cards += [f"PELAS,{5 + k},{2e5 * a[2 + k]:.9e}" for k in (0, 1)]
    cards += [f"GRID,{i + 1},,{0.2 * i:.1f},0.,0." for i in range(31)]
    cards += [f"CBAR,{i + 1},{1 + i // 15},{i + 1},{i + 2},0.,0.,1." for i in range(30)]
    springs = enumerate(((5, 11), (6, 21), (5, 1), (6, 31)))
    cards += [f"CELAS1,{101 + k},{part},{node},3" for k, (part, node) in springs]
    return whole([*cards, "SPC1,1,1246,1,THRU,31"])


STRUCTURES = (
    Structure(
        "plate",
        {
            "plate": "MAT1 1 E",
            "along": "MAT1 2 E",
            "across": "MAT1 3 E",
            "springs": "PELAS 9 K",
        },
        plate,
        tuple(f"{plate_node(i, j)}+Z" for i in (3, 6, 9, 12) for j in (0, 3, 6, 8)),
        (f"{plate_node(12, 0)}+Z",),
        8,
    ),
    Structure(
        "frame",
        {f"part {k}": f"MAT1 {k} E" for k in (1, 2, 3, 4)},
        frame,
        tuple(f"{10 * s + q}+{d}" for s in (1, 2, 3) for q in (1, 3) for d in "XY"),
        ("31+X", "31+Y"),
        9,
    ),
    Structure(
        "beam",
        {
            "left": "MAT1 1 E",
            "right": "MAT1 2 E",
            "outer": "PELAS 5 K",
            "inner": "PELAS 6 K",
        },
        beam,
        tuple(f"{i}+Z" for i in range(2, 31, 3)),
        ("5+Z", "29+Z"),
        7,
    ),
)
FAMILIES = (Family(0.01, 1.0), Family(0.003, 1.0), Family(0.003, 0.5))


def measure(
    s: Structure, family: Family, truth: Float, density: float, folder: Path, seed: int
) -> None:
    """Deck, modes, FRFs and study in a folder."""
    rng = np.random.default_rng([seed, 1])
    (folder / "deck.bdf").write_text(s.deck(np.ones(truth.size), 1.0), encoding="utf-8")
    (folder / "truth.bdf").write_text(s.deck(truth, density), encoding="utf-8")
    every = tuple(dict.fromkeys((*s.channels, *s.inputs)))
    with EmbeddedSolver().open(read_deck(folder / "truth.bdf")) as analysis:
        modes = analysis.modes(ModesRequest(SUMMED)).modes.rows(every)
    f = modes.frequencies
    shapes = np.asarray(modes.shapes.real)
    out = shapes[: len(s.channels)]
    count = round(family.identified * s.modes)
    size = np.abs(out[:, :count]).max(axis=0)
    seen = out[:, :count] + 0.02 * size * rng.standard_normal((len(out), count))
    measured = f[:count] * (1 + 1e-3 * rng.standard_normal(count))
    zeta = np.full(f.size, family.damping)
    write_modes(
        folder / "modes.json", ModeSet(measured, zeta[:count], seen, s.channels)
    )
    freqs = np.linspace(0.5 * f[0], 1.3 * f[s.modes - 1], LINES)
    h = frf(freqs, f, zeta, out, shapes[[every.index(i) for i in s.inputs]])
    noise = rng.standard_normal((2, *h.shape))
    floor = 1e-4 * np.sqrt(np.mean(np.abs(h) ** 2))
    h = h + (0.03 * np.abs(h) + floor) * (noise[0] + 1j * noise[1])
    outputs = tuple(Channel(c, "acceleration", "m/s^2") for c in s.channels)
    inputs = tuple(Channel(c, "force", "N") for c in s.inputs)
    write_frfs(folder / "frfs.uff", FrfSet(h, freqs, outputs, inputs))
    text = '[model]\ndeck = "deck.bdf"\n'
    text += '[update]\nresiduals = ["frequencies", "mac"]\ndiscrepancy = "assumed"\nwrite = "all"\n'
    for name, target in s.targets.items():
        text += f'[[candidate]]\nname = "{name}"\ntargets = ["{target}"]\n'
    text += f'[[residual]]\nkind = "frf"\nfile = "frfs.uff"\nerror = 0.1\nfmin = {0.8 * f[0]}\n'
    text += f"fmax = {1.2 * f[s.modes - 1]}\n"
    (folder / "study.toml").write_text(text, encoding="utf-8")


def case(s: Structure, family: Family, seed: int, density: float = 1.0) -> Case:
    """One draw."""
    rng = np.random.default_rng([seed, len(s.name)])
    count = len(s.targets)
    truth = 1 + rng.uniform(0.2, 0.6, count) * rng.choice([-1.0, 1.0], count)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        measure(s, family, truth, density, folder, seed)
        begin = time.process_time()
        found = update_study(
            folder / "study.toml", folder / "modes.json", UpdateRequest()
        )
        seconds = time.process_time() - begin
    stated = as_stated(found.problem, found.done)
    u = found.config.update
    at_truth = found.config.candidates().vector(truth)

    def optimised(problem: Problem, y: Float | None) -> tuple[Solution, Problem]:
        end = settled(problem, course_of(u), start=at_truth if y is None else y)
        return end.solution, end.problem

    best = solve_verified(stated, solved=optimised)
    both = as_stated(stated, best)
    at_once = settled(both, course_of(u), start=np.zeros(count)).solution
    costs = [
        whole_cost(both, both.evaluate(y))
        for y in (found.done.solution.x, best.solution.y, at_once.y)
    ]
    return Case(*costs, unfit=bool(not_fitted(stated, found.done)), seconds=seconds)


def row(s: Structure, family: Family, count: int, report: Report) -> list[Case]:
    """Draws of a structure."""
    cases = [case(s, family, seed) for seed in range(count)]
    wrong = [case(s, family, seed, HEAVY) for seed in range(2)]
    at_once = np.mean([c.at_once <= c.optimum + J_MOST for c in cases])
    checks: list[Check] = [
        at_most(
            "called unfit at the optimum", sum(c.unfit and c.reached for c in cases), 0
        ),
        at_least(
            "called unfit with a wrong density", sum(c.unfit for c in wrong), len(wrong)
        ),
    ]
    what = f"{s.name}: damping {100 * family.damping:g} %, "
    what += f"{100 * family.identified:g} % of the modes identified, {count} draws"
    cost = {
        "% at the optimum": 100 * float(np.mean([c.reached for c in cases])),
        "J above it at most": max(c.found - c.optimum for c in cases),
        "s at most": max(c.seconds for c in cases),
    }
    peers = [Peer("all data at once", {"% at the optimum": 100 * float(at_once)})]
    report.row(what, cost, checks, peers)
    return cases


def main() -> None:
    """Run and state."""
    options = arguments(__doc__).parse_args()
    report = Report(options)
    count = sized(options, 3, 12, 60)
    cases = [
        c
        for family in FAMILIES
        for s in STRUCTURES
        for c in row(s, family, count, report)
    ]
    report.row(f"all {len(cases)} updatings from the deck", {}, judged(cases))
    report.end()


def judged(cases: list[Case]) -> list[Check]:
    """How many end at the optimum, and that the others are not said to fit the data."""
    share = 100 * float(np.mean([c.reached for c in cases]))
    silent = sum(not c.reached and not c.unfit for c in cases)
    return [
        at_least("at the optimum", share, REACHED_LEAST, "%"),
        at_most("ends above it that are not called unfit", silent, 0),
    ]


if __name__ == "__main__":
    main()
