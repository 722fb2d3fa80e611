"""A member is left out of a deck, and found: a brace of a frame, a support of a plate, a link.

The test is the deck with the member: frequencies with errors of 0.1 %, shapes of 1 % of their
largest reading. Young's modulus is a parameter, and 5 % off.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import ringtrue as rt
from ringtrue.api.models import open_model
from ringtrue.core.parameters import ParameterSet
from ringtrue.model.model import Model
from ringtrue.solvers.observed import reduced
from ringtrue.study.placing import placed
from ringtrue.updating.problem import single
from ringtrue.updating.selection.missing_members import (
    FittedModel,
    MissingMember,
    member_cards,
    missing_members,
)
from ringtrue.updating.selection.selection_rules import short_update
from ringtrue.updating.target import Target, Weights

HEAD = "SOL 103\nCEND\nSPC=1\nBEGIN BULK\n"
MODES = 8
STEEL = ParameterSet([rt.parameter("steel", "MAT1 1 E")])
FRAME = """MAT1,1,2.1+11,,.3,7850.
PBAR,1,1,8.-3,8.-5,5.-5,1.-6
PBAR,2,1,6.-3,6.-5,3.-5,1.-6
PBAR,3,1,2.-3,1.-6,1.-6,1.-6
"""


def _read(tmp_path: Path, text: str, modulus: str = "2.1+11") -> Model:
    path = tmp_path / "deck.bdf"
    path.write_text(HEAD + text.replace("2.1+11", modulus) + "ENDDATA\n")
    return rt.read_deck(path, units="SI")


def _found(
    tmp_path: Path, lacking: str, member: str, channels: Sequence[str]
) -> tuple[Model, tuple[MissingMember, ...]]:
    """Members proposed for the deck `lacking`; the truth has the cards `member`, too."""
    true = rt.solve_modes(_read(tmp_path, lacking + member, "2.0+11"), count=MODES).at(
        channels
    )
    rng = np.random.default_rng(3)
    noise = (
        0.01 * np.abs(true.shapes).max(axis=0) * rng.standard_normal(true.shapes.shape)
    )
    aim = Target(
        frequencies=true.frequencies * (1 + 1e-3 * rng.standard_normal(MODES)),
        shapes=true.shapes + noise,
        std=np.full(MODES, 1e-3),
        used=np.ones(MODES, dtype=bool),
        weights=Weights(frequency=2e-3, mac=2e-3),
    )
    deck = _read(tmp_path, lacking)
    opened = open_model(deck)
    model = reduced(deck, STEEL, placed(opened, tuple(channels), None), 2 * MODES)
    best = short_update(single(model, aim), [0], np.zeros(1), 8)
    rows = np.arange(len(channels))
    fitted = FittedModel.of(opened.analysis.system, model, rows, best.x, aim)
    return deck, missing_members(deck, fitted)


def _grid(points: Sequence[tuple[float, float, float]], first: int = 1) -> str:
    return "".join(
        f"GRID,{first + i},,{x},{y},{z}\n" for i, (x, y, z) in enumerate(points)
    )


def _frame() -> str:
    """Three bays of 4 m, two storeys of 3 m, in one plane; node 100 i + k at column i, level k,
    k = 0, 1, ... 4 every 1.5 m; beams have their middle node at 100 i + 50 + k.
    """
    text = FRAME
    element = 0
    for i in range(4):
        text += _grid([(4.0 * i, 0.0, 1.5 * k) for k in range(5)], 100 * i + 1)
        for k in range(1, 5):
            element += 1
            text += f"CBAR,{element},1,{100 * i + k},{100 * i + k + 1},1.,0.,0.\n"
    for i in range(3):
        for k in (3, 5):
            a, b, c = 100 * i + k, 100 * i + 50 + k, 100 * i + 100 + k
            text += f"GRID,{b},,{4.0 * i + 2},0.,{1.5 * (k - 1)}\n"
            text += f"CBAR,{element + 1},2,{a},{b},0.,0.,1.\n"
            text += f"CBAR,{element + 2},2,{b},{c},0.,0.,1.\n"
            element += 2
    text += "SPC1,1,123456,1,101,201,301\n"
    return text + "SPC1,1,246,1,THRU,305\n"


def _brace(a: int, b: int) -> str:
    return f"CBAR,900,3,{a},{b},0.,1.,0.,,,\n,56,56\n"


@pytest.mark.parametrize(
    ("a", "b"), [(1, 103), (103, 205), (105, 203), (203, 301), (205, 303)]
)
def test_a_brace_that_was_left_out_is_among_the_first_three(
    tmp_path: Path, a: int, b: int
) -> None:
    channels = [f"{100 * i + k}+{d}" for i in range(4) for k in (3, 5) for d in "XZ"]
    channels += [f"{100 * i + 50 + k}+Z" for i in range(3) for k in (3, 5)]
    _, found = _found(tmp_path, _frame(), _brace(a, b), channels)
    pairs = [sorted(m.nodes[0]) for m in found[:3] if len(m.nodes) == 1]
    assert sorted((a, b)) in pairs
    assert found[0].worth > 0
    assert found[0].share > 0.2


def test_nothing_is_proposed_for_a_deck_that_lacks_nothing(tmp_path: Path) -> None:
    channels = [f"{100 * i + k}+{d}" for i in range(4) for k in (3, 5) for d in "XZ"]
    _, found = _found(tmp_path, _frame(), "", channels)
    assert all(m.worth <= 0 for m in found)


SUPPORTS = (1, 5, 9, 37, 45, 73, 77, 81)  # corners and middles of the sides


def _plate(supports: Sequence[int], n: int = 9) -> str:
    """A plate of 2 m x 1.5 m on vertical springs; nodes 1 to n², row by row."""
    text = "MAT1,1,2.1+11,,.3,7850.\nPSHELL,1,1,.02,1\nPBUSH,2,K,,,1.+6\nSPC1,1,126,1,THRU,81\n"
    text += _grid(
        [
            (2.0 * i / (n - 1), 1.5 * j / (n - 1), 0.0)
            for j in range(n)
            for i in range(n)
        ]
    )
    for j in range(n - 1):
        for i in range(n - 1):
            a = 1 + j * n + i
            text += f"CQUAD4,{a},1,{a},{a + 1},{a + n + 1},{a + n}\n"
    return text + "".join(map(_support, supports))


def _support(node: int) -> str:
    return f"CBUSH,{800 + node},2,{node},,,,,0\n"


@pytest.mark.parametrize("node", [1, 9, 37, 45, 73, 81])
def test_a_support_that_was_left_out_is_first(tmp_path: Path, node: int) -> None:
    channels = [f"{1 + 9 * j + i}+Z" for j in range(0, 9, 2) for i in range(0, 9, 2)]
    lacking = _plate([k for k in SUPPORTS if k != node])
    _, found = _found(tmp_path, lacking, _support(node), channels)
    first = found[0]
    assert first.form == "support"
    assert first.nodes == ((node, 0),)
    assert first.stiffness == pytest.approx(1e6, rel=0.1)
    assert first.worth > 0


def _two_beams() -> str:
    """A beam of 3 m above another, 0.2 m apart, both clamped, joined by bushes at two places."""
    text = FRAME + "PBUSH,4,K,4.+5,4.+5,4.+5,2.5+4,2.5+4,2.5+4\n"
    for first, z in ((1, 0.0), (101, 0.2)):
        text += _grid([(0.25 * i, 0.0, z) for i in range(13)], first)
        for i in range(12):
            text += f"CBAR,{first + i},1,{first + i},{first + i + 1},0.,0.,1.\n"
    text += "SPC1,1,123456,1,101\n"
    return text + "".join(f"CBUSH,{500 + i},4,{i},{100 + i},,,,0\n" for i in (4, 7))


def test_a_link_that_was_left_out_is_among_the_first_three(tmp_path: Path) -> None:
    channels = [
        f"{first + i}+{d}" for first in (1, 101) for i in range(0, 13, 2) for d in "XYZ"
    ]
    link = "CBUSH,513,4,13,113,,,,0\n"
    deck, found = _found(tmp_path, _two_beams(), link, channels)
    assert (13, 113) in [m.nodes[0] for m in found[:3] if m.form == "link"]
    # as cards it goes into the deck, and brings the frequencies nearer
    first = next(m for m in found if m.nodes == ((13, 113),))
    better = _read(tmp_path, _two_beams() + member_cards(deck, [first], "N/m"))
    true = rt.solve_modes(_read(tmp_path, _two_beams() + link), count=4).frequencies
    before = rt.solve_modes(deck, count=4).frequencies
    after = rt.solve_modes(better, count=4).frequencies
    assert np.abs(after / true - 1).max() < np.abs(before / true - 1).max() / 2


def test_a_brace_is_written_as_a_bar_of_its_stiffness(tmp_path: Path) -> None:
    channels = [f"{100 * i + k}+{d}" for i in range(4) for k in (3, 5) for d in "XZ"]
    deck, found = _found(tmp_path, _frame(), _brace(103, 205), channels)
    text = member_cards(deck, found, "N/m")
    with_brace = _read(tmp_path, _frame() + text)
    bar = with_brace["PBAR"]
    assert len(with_brace["CBAR"]) == len(deck["CBAR"]) + len(found[0].nodes)
    stiffness = 2.1e11 * float(bar["A"][-1]) / 5.0  # EA/L of a diagonal of 3 m x 4 m
    assert stiffness == pytest.approx(found[0].stiffness, rel=1e-3)
    assert f"$ 2. {found[1].name}" in text
    assert text.isascii()
