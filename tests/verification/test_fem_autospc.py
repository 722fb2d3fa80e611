"""AUTOSPC holds what nothing stiffens, and nothing else.

A spring of stiffness k -> infinity on one component is a support of that component: the frequencies
are those of the model with an SPC there, and every other component moves as before. Structures are
clamped at x = 0; the spring stands at their tip. Components that no element stiffens (drilling of
flat shells, rod ends, planar frames) are held, with such a spring beside them as without one.
"""

from __future__ import annotations

import numpy as np
import pytest
from fem_cases import (
    cards,
    frequencies,
    grid,
    model,
    pshell,
    shells,
    spc,
    square,
    steel,
)
from solid_meshes import box, elements, psolid

from ringtrue.core.arrays import Float
from ringtrue.fem.assembly import System, assemble
from ringtrue.model.model import Table

# N/m and N m/rad: 1e9 times the bending of the beam, 1e4 times what EPZERO allows for one ratio
STIFF = 3e14
# of a frequency: 1e-16 of STIFF is 1e-3 of the beam's smallest bending stiffness
ROUNDED = 2e-3
UNITS = {
    "SI": (1.0, 1.0),
    "mm-t-s": (1e3, 1e-3),
}  # length and mass by those of SI; the second is the same
TURN = {"basic": 0, "skewed": 5}
SKEW = cards(
    "CORD2R",
    CID=[5],
    A1=0.0,
    A2=0.0,
    A3=0.0,
    B1=1.0,
    B2=2.0,
    B3=3.0,
    C1=1.0,
    C2=-1.0,
    C3=0.5,
)
Parts = tuple[
    Float, tuple[Table, ...], int, str
]  # nodes, the other cards, the node at the tip, what is clamped


def beam(length: float, E: float, rho: float) -> Parts:
    x = np.zeros((6, 3))
    x[:, 0] = np.linspace(0, length, 6)
    i = np.arange(1, 6)
    section = {
        "A": 1e-4 * length**2,
        "I1": 8e-10 * length**4,
        "I2": 6e-10 * length**4,
        "J": 1e-9 * length**4,
    }
    bars = cards("CBAR", EID=i, PID=1, GA=i, GB=i + 1, X2=1.0)
    return (
        x,
        (bars, cards("PBAR", PID=[1], MID=1, **section), steel(E, 0.3, rho)),
        6,
        "1",
    )


def plate(length: float, E: float, rho: float) -> Parts:
    xyz, quads = square(4, length, 0.5 * length, across=2)
    return (
        xyz,
        (shells(quads), pshell(0.01 * length), steel(E, 0.3, rho)),
        len(xyz),
        "123",
    )


def block(length: float, E: float, rho: float) -> Parts:
    xyz, hexas = box(4, 1, 1, (length, 0.2 * length, 0.2 * length))
    return xyz, (elements("CHEXA", hexas), psolid(), steel(E, 0.3, rho)), len(xyz), "1"


STRUCTURES = {"beam": (beam, 6), "plate": (plate, 6), "block": (block, 3)}


def clamped(parts: Parts, frame: int, *more: Table, also: str = "") -> System:
    """The structure with its nodes at x = 0 held, and components `also` of the tip."""
    xyz, tables, tip, _ = parts
    ids = np.flatnonzero(xyz[:, 0] == 0) + 1
    held = {
        "SID": [1] * (ids.size + 1),
        "G": [*ids.tolist(), tip],
        "C": ["123456"] * ids.size + [also or "0"],
    }
    spcs = (
        cards("SPC", **held)
        if also
        else cards("SPC", **{k: v[:-1] for k, v in held.items()})
    )
    return assemble(model(grid(xyz, CD=frame), SKEW, *tables, *more, spcs, spc=1))


@pytest.mark.parametrize("units", UNITS)
@pytest.mark.parametrize("frame", TURN)
@pytest.mark.parametrize(
    ("name", "component"),
    [
        (n, c)
        for n, (_, components) in STRUCTURES.items()
        for c in range(1, components + 1)
    ],
)
def test_a_stiff_spring_is_a_support_of_its_component_alone(
    name: str, component: int, frame: str, units: str
) -> None:
    length, mass = UNITS[units]
    parts = STRUCTURES[name][0](length, 2e11 * mass / length, 8000.0 * mass / length**3)
    stiffness = STIFF * mass * (length**2 if component > 3 else 1.0)
    spring = cards("CELAS2", EID=[99], K=[stiffness], G1=[parts[2]], C1=[component])
    without = clamped(parts, TURN[frame])
    sprung = clamped(parts, TURN[frame], spring)
    supported = clamped(parts, TURN[frame], also=str(component))
    assert sprung.autospc.labels() == without.autospc.labels()
    np.testing.assert_allclose(
        frequencies(sprung, 4), frequencies(supported, 4), rtol=ROUNDED
    )


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (1, 1, 0), (1, 2, 3)])
def test_a_stiff_bush_in_a_skewed_direction(axis: Float) -> None:
    """A CBUSH whose one stiffness is along `axis`: the reference holds that component of the same
    frame.
    """
    parts = beam(1.0, 2e11, 8000.0)
    a = np.array(axis) / np.linalg.norm(axis)
    across = np.linalg.qr(np.column_stack([a, np.eye(3)]))[0][:, 1]
    ends = {f"B{i + 1}": v for i, v in enumerate(across)} | {
        f"C{i + 1}": v for i, v in enumerate(a)
    }
    frame = cards("CORD2R", CID=[7], A1=0.0, A2=0.0, A3=0.0, **ends)
    bush = cards("CBUSH", EID=[99], PID=9, GA=6, CID=7)
    xyz, tables, _, _ = parts
    cd = np.where(np.arange(1, 7) == 6, 7, 0)
    found = []
    for more, held in (((bush, cards("PBUSH", PID=[9], K1=STIFF)), "0"), ((), "1")):
        spcs = cards("SPC", SID=[1, 1], G=[1, 6], C=["123456", held])
        found.append(
            assemble(model(grid(xyz, CD=cd), frame, *tables, *more, spcs, spc=1))
        )
    assert not len(found[0].autospc)
    np.testing.assert_allclose(*(frequencies(s, 4) for s in found), rtol=ROUNDED)


def test_the_springs_of_one_bush_are_judged_apart() -> None:
    """A point mass on one CBUSH, rigid along x and soft along y and z: f = sqrt(k / m) / 2 pi."""
    bush = (
        cards("CBUSH", EID=[1], PID=1, GA=1, CID=0),
        cards("PBUSH", PID=[1], K1=1e13, K2=1e3, K3=4e3),
    )
    s = assemble(
        model(
            grid(np.zeros((1, 3)), PS="456"),
            *bush,
            cards("CONM2", EID=[2], G=1, M=10.0),
        )
    )
    assert s.free.labels() == ("1+X", "1+Y", "1+Z")
    np.testing.assert_allclose(
        frequencies(s, 2), np.sqrt(np.array([1e3, 4e3]) / 10) / 2 / np.pi, rtol=1e-9
    )


def test_a_beam_at_a_rigid_link_of_bars() -> None:
    """A bar 1e9 times as stiff as the beam that it ends, as decks of old build their rigid
    links.
    """
    xyz = np.array([[0.0, 0, 0], [0.5, 0, 0], [1, 0, 0], [1, 0, 0.1]])
    bars = cards(
        "CBAR", EID=[1, 2, 3], PID=[1, 1, 2], GA=[1, 2, 3], GB=[2, 3, 4], X2=1.0
    )
    section = {
        "A": [1e-4, 1e5],
        "I1": [8e-10, 1e1],
        "I2": [6e-10, 1e1],
        "J": [1e-9, 1e1],
    }
    tables = (bars, cards("PBAR", PID=[1, 2], MID=[1, 2], **section))
    steels = cards("MAT1", MID=[1, 2], E=2e11, NU=0.3, RHO=[8000.0, 0.0])
    s = assemble(model(grid(xyz), *tables, steels, spc([1], "123456"), spc=1))
    assert not len(s.autospc)


def test_a_wire_bends() -> None:
    """The share of bending in stretching, 3 r²/L², is 1.9e-9 for a wire: below EPZERO, and no
    zero.
    """
    r, length = 0.5e-3, 20.0
    i = np.pi / 4 * r**4
    tables = (
        cards("CBAR", EID=[1], PID=1, GA=1, GB=2, X2=1.0),
        cards("PBAR", PID=[1], MID=1, A=np.pi * r**2, I1=i, I2=i, J=2 * i),
    )
    assert not len(
        assemble(
            model(
                grid([[0, 0, 0], [length, 0, 0]]),
                *tables,
                steel(),
                spc([1], "123456"),
                spc=1,
            )
        ).autospc
    )


SPRINGS = {
    "none": (),
    "stiff": (cards("CELAS2", EID=[900, 901], K=STIFF, G1=1, C1=[3, 4]),),
}


@pytest.mark.parametrize("spring", SPRINGS)
@pytest.mark.parametrize("frame", TURN)
def test_drilling_of_a_flat_shell_is_held(frame: str, spring: str) -> None:
    """In a plane that is askew of all frames, with coordinates of seven digits as in small
    fields.
    """
    xyz, quads = square(3, 1.0, 0.7)
    R = np.linalg.qr(np.array([[1.0, 2, 3], [4, 5, 7], [2, -1, 1]]))[0]
    x = np.round(xyz @ R.T, 6)
    tables = (shells(quads), pshell(0.02), steel(), *SPRINGS[spring])
    s = assemble(model(grid(x, CD=TURN[frame]), SKEW, *tables, K6ROT=0.0))
    first = (
        2 if spring == "stiff" else 1
    )  # the turn that the spring resists has a share about the normal
    assert s.autospc.node.tolist() == list(range(first, len(x) + 1))  # one each
    assert (s.autospc.direction > 3).all()


@pytest.mark.parametrize("spring", SPRINGS)
@pytest.mark.parametrize("frame", TURN)
def test_rod_ends_are_held_across(frame: str, spring: str) -> None:
    """A chain of rods on a skew line; a rod has stiffness along itself and about itself alone."""
    line = np.round(np.linspace(0, 1, 5)[:, None] * np.array([0.37, 0.41, -0.73]), 6)
    i = np.arange(1, 5)
    rods = (
        cards("CROD", EID=i, PID=1, G1=i, G2=i + 1),
        cards("PROD", PID=[1], MID=1, A=1e-4, J=1e-9),
    )
    s = assemble(
        model(grid(line, CD=TURN[frame]), SKEW, *rods, steel(), *SPRINGS[spring])
    )
    count = np.bincount(s.autospc.node, minlength=6)[1:]
    assert count[1:].tolist() == [4] * 4
    assert count[0] == (
        4 if spring == "none" else 2
    )  # the springs hold one component across, and one turn


@pytest.mark.parametrize("spring", SPRINGS)
def test_planar_frames_are_held_out_of_their_plane(spring: str) -> None:
    """Bars of no I2 and no J, as frames of textbooks are given, in the x-y plane: z, RX and RY have
    nothing.
    """
    xyz = np.array([[0.0, 0, 0], [0, 1, 0], [1, 1.3, 0], [2, 1, 0], [2, 0, 0]])
    i = np.arange(1, 5)
    bars = cards("CBAR", EID=i, PID=1, GA=i, GB=i + 1, X1=-1.0, X2=1.0)
    section = cards("PBAR", PID=[1], MID=1, A=1e-2, I1=8e-6)
    s = assemble(model(grid(xyz), bars, section, steel(), *SPRINGS[spring]))
    loose = ["Z", "RX", "RY"]
    want = [f"{n}+{c}" for n in range(1, 6) for c in loose]
    if spring == "stiff":
        want = [w for w in want if w not in ("1+Z", "1+RX")]
    assert list(s.autospc.labels()) == want


def test_nothing_is_held_where_the_case_control_or_the_deck_says_no() -> None:
    xyz, quads = square(1, 1.0, 1.0)
    tables = (grid(xyz), shells(quads), pshell(0.1), steel())
    assert not len(assemble(model(*tables, K6ROT=0.0, AUTOSPC="NO")).autospc)
    assert len(assemble(model(*tables, K6ROT=0.0)).autospc) == 4
