"""Beams in closed form: taper, shear, skew bending, offsets, neutral axis, releases, mass;
sections.

A cantilever of length L under a tip force P bends by ∫ P (L - x)²/EI dx + ∫ P/kGA dx, whatever its
taper; the element must give that exactly in one piece.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fem_cases import cards, grid, model, modes, spc, steel
from scipy.integrate import quad

from ringtrue.core.arrays import Any_, Float
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.errors import UnsupportedCard
from ringtrue.fem.assembly import System, assemble
from ringtrue.fem.element_cards import mesh
from ringtrue.fem.elements import bar
from ringtrue.model.model import Model, Table
from ringtrue.model.sections import SECTIONS

E, NU, RHO, L = 2e11, 0.3, 8000.0, 2.0
G = E / 2.6
QUADRATURE = 1e-9  # sixteen points on 1/I for I 4:1
EXACT = 1e-10
SECTION = {"A": 0.01, "I1": 2e-5, "I2": 1e-5, "J": 1.5e-5}
ENDS = {"AB": 0.005, "I1B": 5e-6, "I2B": 4e-6, "JB": 6e-6}
ALIKE = {"AB": 0.01, "I1B": 2e-5, "I2B": 1e-5, "JB": 1.5e-5}


def line(card: str = "CBEAM", **more: object) -> Table:
    return cards(card, EID=[1], PID=1, GA=1, GB=2, **({"X2": 1.0} | more))


def beam(
    section: dict[str, float],
    element: Table | None = None,
    xyz: Float | None = None,
    **params: object,
) -> Model:
    """A cantilever along x held at node 1."""
    nodes = np.array([[0, 0, 0], [L, 0, 0.0]]) if xyz is None else xyz
    element = line() if element is None else element
    name = "PBAR" if element.card == "CBAR" else "PBEAM"
    p = cards(name, PID=[1], MID=1, **section)
    return model(
        grid(nodes),
        element,
        p,
        steel(E, NU, RHO),
        spc([1], "123456"),
        spc=1,
        AUTOSPC="NO",
        **params,
    )


def tip(m: Model, *load: float) -> Float:
    """Motion of node 2 under a load on it."""
    s = assemble(m)
    f = np.zeros(12)
    f[6 : 6 + len(load)] = load
    return s.expand(np.linalg.solve(s.stiffness.toarray(), s.transform.T @ f))[6:]


def over(c: float, d: float, power: int = 0) -> float:
    """∫ (1 - ξ)^power / (c + (d - c) ξ) dξ."""
    return quad(
        lambda x: (1 - x) ** power / (c + (d - c) * x), 0, 1, epsabs=0, epsrel=1e-13
    )[0]


def test_tapered_cantilever() -> None:
    m = beam(SECTION | ENDS | {"K1": 0.8, "K2": 0.6})
    shear = L / G * over(0.01, 0.005)
    assert tip(m, 1.0)[0] == pytest.approx(L / E * np.log(2) / 0.005, rel=QUADRATURE)
    assert tip(m, 0, 1.0)[1] == pytest.approx(
        L**3 / E * over(2e-5, 5e-6, 2) + shear / 0.8, rel=QUADRATURE
    )
    assert tip(m, 0, 0, 1.0)[2] == pytest.approx(
        L**3 / E * over(1e-5, 4e-6, 2) + shear / 0.6, rel=QUADRATURE
    )
    assert tip(m, 0, 0, 0, 1.0)[3] == pytest.approx(
        L / G * over(1.5e-5, 6e-6), rel=QUADRATURE
    )
    assert tip(m, 0, 0, 0, 0, 1.0)[2] == pytest.approx(
        -(L**2) / E * over(1e-5, 4e-6, 1), rel=QUADRATURE
    )


@pytest.mark.parametrize(
    ("card", "section"), [("CBAR", SECTION), ("CBEAM", SECTION | ALIKE)]
)
def test_uniform_cantilever(card: str, section: dict[str, float]) -> None:
    m = beam(section | {"K1": 0.8, "K2": 0.6}, line(card))
    for load, at, I, k in (((0, 1.0), 1, 2e-5, 0.8), ((0, 0, 1.0), 2, 1e-5, 0.6)):
        assert tip(m, *load)[at] == pytest.approx(
            L**3 / (3 * E * I) + L / (k * G * 0.01), rel=EXACT
        )


def test_the_integral_is_the_closed_form_where_there_is_no_taper() -> None:
    m = beam(SECTION | ALIKE | {"K1": 0.8, "K2": 0.6})
    iso, s = bar.section(mesh(m).rows("CBEAM"))
    one = bar.uniform(np.array([L]), iso, s)
    np.testing.assert_allclose(
        bar.flexible(np.array([L]), iso.E, iso.G, s),
        one,
        atol=EXACT * np.abs(one).max(),
    )


def test_skew_bending_with_shear_is_that_of_the_turned_section() -> None:
    """A section turned by α: I12 = (I1 - I2)/2 sin 2α; equal shear areas, so that shear does not
    turn.
    """
    a = 0.4
    c, s = np.cos(a), np.sin(a)
    turned = {
        "I1": 2e-5 * c**2 + 1e-5 * s**2,
        "I2": 2e-5 * s**2 + 1e-5 * c**2,
        "I12": 1e-5 * s * c,
    }
    turned |= {f"{k}B": v for k, v in turned.items()} | {
        "A": 0.01,
        "J": 1.5e-5,
        "AB": 0.01,
        "JB": 1.5e-5,
    }
    principal = beam(SECTION | ALIKE | {"K1": 0.7, "K2": 0.7}, line(X2=c, X3=s))
    got = tip(beam(turned | {"K1": 0.7, "K2": 0.7}), 0, 1.0, 2.0, 0, 0.3, 0.4)
    np.testing.assert_allclose(
        got, tip(principal, 0, 1.0, 2.0, 0, 0.3, 0.4), rtol=1e-9, atol=1e-20
    )


def test_a_bar_with_i12_has_no_shear_flexibility() -> None:
    """PBAR ignores K1 and K2 where I12 is given (Quick Reference Guide)."""
    skew = SECTION | {"I12": 3e-6}
    np.testing.assert_allclose(
        tip(beam(skew | {"K1": 0.8, "K2": 0.6}, line("CBAR")), 0, 1.0),
        tip(beam(skew, line("CBAR")), 0, 1.0),
    )


@pytest.mark.parametrize("card", ["CBAR", "CBEAM"])
@pytest.mark.parametrize("offt", ["GGO", "GOG", "GOO", "BGO", "BOO"])
def test_offsets_in_the_frame_of_the_element(card: str, offt: str) -> None:
    """The same beam by OFFT O, where W stands in the element's axes, and by OFFT G, where it stands
    in basic.
    """
    section = SECTION if card == "CBAR" else SECTION | ENDS
    nodes = np.array([[0, 0, 0], [1.0, 2.0, 2.0]])
    x = nodes[1] / 3
    z = np.cross(x, [0, 1.0, 0])
    z /= np.linalg.norm(z)
    axes = np.stack([x, np.cross(z, x), z])
    w = np.array([[0.1, 0.2, -0.3], [0.0, 0.4, 0.1]])
    given = np.stack(
        [
            axes @ v if letter == "O" else v
            for v, letter in zip(w, offt[1:], strict=True)
        ]
    )
    names = ("W1A", "W2A", "W3A", "W1B", "W2B", "W3B")
    K = [
        assemble(
            beam(
                section,
                line(card, OFFT=o, **dict(zip(names, v.ravel(), strict=True))),
                nodes,
            )
        ).stiffness.toarray()
        for o, v in (("GGG", w), (offt, given))
    ]
    np.testing.assert_allclose(K[1], K[0], rtol=1e-9, atol=1e-9 * np.abs(K[0]).max())


def test_an_offset_frame_that_is_unknown_is_refused() -> None:
    with pytest.raises(UnsupportedCard, match="OFFT GXG"):
        assemble(beam(SECTION | ALIKE, line(OFFT="GXG", W1A=0.1)))


def test_an_axial_force_at_the_shear_centre_bends_about_the_neutral_axis() -> None:
    """M = N e: the tip turns by N e L/EI and moves along by N (L/EA + e² L/EI)."""
    m = beam(SECTION | ALIKE | {"N1A": 0.05, "N1B": 0.05, "K1": 0.0, "K2": 0.0})
    u = tip(m, 1.0)
    assert u[0] == pytest.approx(L / (E * 0.01) + 0.05**2 * L / (E * 2e-5), rel=EXACT)
    assert u[5] == pytest.approx(0.05 * L / (E * 2e-5), rel=EXACT)


SKEWED = (
    SECTION
    | ENDS
    | {"N1A": 0.05, "N2A": -0.02, "N1B": 0.01, "N2B": 0.03, "I12": 2e-6, "I12B": 1e-6}
)


def free(section: dict[str, float], card: str = "CBEAM", coupled: int = -1) -> System:
    name = "PBAR" if card == "CBAR" else "PBEAM"
    nodes = grid(np.array([[0, 0, 0], [1.0, 2.0, 2.0]]))
    p = cards(name, PID=[1], MID=1, **section)
    return assemble(
        model(nodes, line(card), p, steel(E, NU, RHO), AUTOSPC="NO", COUPMASS=coupled)
    )


def test_a_slanting_neutral_axis_leaves_rigid_motions_free() -> None:
    s = free(SKEWED)
    assert np.abs(s.stiffness @ s.rigid_body()).max() < 1e-9 * np.abs(s.stiffness).max()


def weight(s: System) -> tuple[float, Float]:
    """Mass, and its centre along the beam from the first node and across it (y, z)."""
    R = s.rigid_body()
    M = R.T @ (s.mass @ R)
    x, m = np.array([1, 2, 2]) / 3, M[0, 0]
    z = np.cross(x, [0, 1.0, 0])
    z /= np.linalg.norm(z)
    # M[3:, :3] is the skew matrix of m c
    centre = np.array([M[5, 1], M[3, 2], M[4, 0]]) / m
    return m, np.stack([x, np.cross(z, x), z]) @ centre


@pytest.mark.parametrize("coupled", [-1, 1])
def test_mass_of_a_tapered_beam(coupled: int) -> None:
    """Linear mass a + (b - a) ξ: total (a + b)/2 L, centre (a + 2b)/(3(a + b)) L; N and M place it
    across.
    """
    m, centre = weight(free(SECTION | ENDS, coupled=coupled))
    assert m == pytest.approx(RHO * 0.0075 * 3)
    assert centre[0] == pytest.approx((0.01 + 2 * 0.005) / (3 * 0.015) * 3)
    off = {"N1A": 0.05, "N1B": 0.05, "NSM": 20.0, "NSMB": 20.0, "M2A": 0.1, "M2B": 0.1}
    m, centre = weight(free(SECTION | ALIKE | off, coupled=coupled))
    assert m == pytest.approx(RHO * 0.01 * 3 + 60)
    np.testing.assert_allclose(centre[1:] * m, [0.05 * 240, 0.1 * 60], rtol=1e-9)


@pytest.mark.parametrize(("coupled", "share"), [(1, 1 / 3), (-1, 1 / 2)])
def test_inertia_about_an_end(coupled: int, share: float) -> None:
    """m L²/3 about an axis across it at its end; lumped mass has m L²/2."""
    s = free(SECTION | ALIKE, coupled=coupled)
    turn = s.rigid_body()[:, 3:] @ np.array([0, 1, -1]) / np.sqrt(2)
    assert turn @ (s.mass @ turn) == pytest.approx(share * RHO * 0.01 * 3 * 9)


@pytest.mark.parametrize("coupled", [-1, 1])
def test_inertia_about_the_axis(coupled: int) -> None:
    """ρ(I1 + I2) and NSI for CBEAM, none for CBAR."""
    x = np.array([1, 2, 2]) / 3
    spin = np.concatenate([np.zeros(3), x, np.zeros(3), x])
    polar = RHO * (0.5 * (2e-5 + 5e-6) + 0.5 * (1e-5 + 4e-6)) + 0.7
    s = free(SECTION | ENDS | {"NSIA": 0.6, "NSIB": 0.8}, coupled=coupled)
    assert spin @ (s.mass @ spin) == pytest.approx(3 * polar)
    s = free(SECTION, "CBAR", coupled)
    assert abs(spin @ (s.mass @ spin)) < 1e-12


def test_a_bar_with_hinges_is_a_rod_and_a_propped_one_is_soft() -> None:
    """Both ends released: no bending stiffness. The far one alone: 3 EI/L³."""
    K = assemble(beam(SECTION, line("CBAR", PA="56", PB="56"))).stiffness.toarray()
    np.testing.assert_allclose(
        np.diag(K)[:4], [E * 0.01 / L, 0, 0, G * 1.5e-5 / L], atol=1e-6
    )
    K = assemble(beam(SECTION, line("CBAR", PB="56"))).stiffness.toarray()
    assert K[1, 1] == pytest.approx(3 * E * 2e-5 / L**3)


def test_free_circular_ring() -> None:
    """Love's inextensible ring (1944, sections 293-295): in-plane n(n² - 1)/sqrt(n² + 1),
    out-of-plane with + ν.

    Targets 51.85, 53.38, 148.8, 151.0 Hz, in pairs. Stretch along the ring lowers in-plane modes by
    some (d/4R)² n².
    """
    n, R, d = 64, 1.0, 0.1
    t = 2 * np.pi * np.arange(n) / n
    i = np.arange(1, n + 1)
    section = SECTIONS["ROD"][1](d / 2) | {"K1": 0.0, "K2": 0.0}
    ring = cards("CBAR", EID=i, PID=1, GA=i, GB=i % n + 1, X3=1.0)
    nodes = grid(R * np.column_stack([np.cos(t), np.sin(t), 0 * t]))
    got = modes(
        model(
            nodes,
            ring,
            cards("PBAR", PID=[1], MID=1, **section),
            steel(E, NU, RHO),
            COUPMASS=1,
        ),
        14,
    )
    k = np.array([2, 3])
    scale = (
        np.sqrt(E * section["I1"] / (RHO * section["A"]))
        / (2 * np.pi * R**2)
        * k
        * (k**2 - 1)
    )
    love = np.sort(
        np.concatenate([scale / np.sqrt(k**2 + 1), scale / np.sqrt(k**2 + 1 + NU)])
    )
    np.testing.assert_allclose(love, [51.85, 53.38, 148.8, 151.0], rtol=4e-4)
    np.testing.assert_allclose(got[6:], np.repeat(love, 2), rtol=4e-3)
    np.testing.assert_allclose(got[6::2], got[7::2], rtol=1e-6)  # of a regular polygon


def _fields(card: str) -> list[str]:
    names = [*SECTION, "I12", "NSM", "K1", "K2"]
    return (
        names
        if card == "CBAR"
        else [*names, "AB", "I1B", "I12B", "JB", "N1A", "N2B", "M1A", "M2B", "NSIA"]
    )


@pytest.mark.parametrize(
    ("card", "field"), [(c, f) for c in ("CBAR", "CBEAM") for f in _fields(c)]
)
def test_a_complex_step_passes_through_every_property(card: str, field: str) -> None:
    """∂K/∂p and ∂M/∂p against central differences of a skewed beam."""
    section = (
        SECTION | {"NSM": 3.0}
        if card == "CBAR"
        else SKEWED | {"NSM": 3.0, "NSMB": 4.0, "M1A": 0.1, "NSIA": 0.2}
    )
    section = section | {"K1": 0.8, "K2": 0.6}
    base = beam(section, line(card))
    name = "PBAR" if card == "CBAR" else "PBEAM"
    p = section.get(field, 0.0)
    h = 1e-5 * (abs(p) or 0.01 if field[0] in "NM" else abs(p) or 1e-6)

    def matrices(value: complex) -> list[Any_]:
        column = (
            np.array([value])
            if np.iscomplexobj(value)
            else np.array([float(value.real)])
        )
        changed = Model(
            base.tables | {name: base[name].with_column(field, column)},
            {"COUPMASS": 1},
            base.case,
        )
        built = bar.build(mesh(changed).rows(card))
        return [built.stiffness, built.mass]

    if card == "CBAR" and field == "I12":
        p = 1e-6  # at 0 the shear factors begin to be ignored
    step = [A.imag / 1e-30 for A in matrices(p + 1e-30j)]
    for exact, up, down in zip(step, matrices(p + h), matrices(p - h), strict=True):
        np.testing.assert_allclose(
            exact,
            (up - down) / (2 * h),
            rtol=1e-5,
            atol=2e-7 * np.abs(exact).max() + 1e-4,
        )


# Sections
# -------------------------------------------------------------------------------------------------------

EQUAL = {  # one shape said in two ways
    "TUBE2": ((3.0, 1.0), "TUBE", (3.0, 2.0)),
    "BOX1": ((8.0, 6.0, 0.5, 0.5, 0.3, 0.3), "BOX", (8.0, 6.0, 0.5, 0.3)),
    "I1": ((4.0, 1.0, 6.0, 8.0), "I", (8.0, 5.0, 5.0, 1.0, 1.0, 1.0)),
    "CHAN1": ((4.0, 1.0, 6.0, 8.0), "CHAN", (5.0, 8.0, 1.0, 1.0)),
}


@pytest.mark.parametrize("kind", EQUAL)
def test_sections_that_are_one(kind: str) -> None:
    mine, other, its = EQUAL[kind]
    a, b = SECTIONS[kind][1](*mine), SECTIONS[other][1](*its)
    for name in a.keys() | b.keys():
        assert a.get(name, 0.0) == pytest.approx(
            b.get(name, 0.0), rel=1e-12, abs=1e-12
        ), name


TURNED = {  # a quarter turn: y to z
    "H": ((4.0, 2.0, 6.0, 0.5), "I1", (5.5, 0.5, 4.0, 6.0)),
    "T1": ((6.0, 4.0, 0.5, 0.4), "T", (6.0, 4.5, 0.5, 0.4)),
    "CHAN2": ((0.4, 0.5, 4.0, 6.0), "CHAN", (4.0, 6.0, 0.5, 0.4)),
}
QUARTER = {"A": "A", "I1": "I2", "I2": "I1", "N1": "N2", "N2": "N1", "J": "J"}


@pytest.mark.parametrize("kind", TURNED)
def test_sections_that_are_turned(kind: str) -> None:
    mine, other, its = TURNED[kind]
    a, b = SECTIONS[kind][1](*mine), SECTIONS[other][1](*its)
    for name, there in QUARTER.items():
        assert a[name] == pytest.approx(b[there], rel=1e-12, abs=1e-12), name


def polygon(points: Any_) -> tuple[float, float, float, float]:
    """A, ∫y², ∫z², ∫yz about the centroid of a polygon (z, y) by Green's theorem."""
    z, y = np.asarray(points, dtype=float).T
    z1, y1 = np.roll(z, -1), np.roll(y, -1)
    c = z * y1 - z1 * y
    A = c.sum() / 2
    zc, yc = ((z + z1) * c).sum() / 6 / A, ((y + y1) * c).sum() / 6 / A
    I1 = ((y**2 + y * y1 + y1**2) * c).sum() / 12 - A * yc**2
    I2 = ((z**2 + z * z1 + z1**2) * c).sum() / 12 - A * zc**2
    I12 = ((z * y1 + 2 * z * y + 2 * z1 * y1 + z1 * y) * c).sum() / 24 - A * yc * zc
    return abs(A), abs(I1), abs(I2), I12 * np.sign(A)


OUTLINES = {
    "L": ((5.0, 8.0, 1.0, 0.5), [(0, 0), (5, 0), (5, 1), (0.5, 1), (0.5, 8), (0, 8)]),
    "Z": (
        (3.0, 1.0, 6.0, 8.0),
        [(0, 0), (4, 0), (4, 1), (1, 1), (1, 8), (-3, 8), (-3, 7), (0, 7)],
    ),
    "T2": (
        (6.0, 5.0, 1.0, 0.5),
        [
            (-3, 0),
            (3, 0),
            (3, 1),
            (0.25, 1),
            (0.25, 5),
            (-0.25, 5),
            (-0.25, 1),
            (-3, 1),
        ],
    ),
    "CROSS": (
        (4.0, 1.0, 6.0, 0.5),
        [
            *(
                (-0.5, -3),
                (0.5, -3),
                (0.5, -0.25),
                (2.5, -0.25),
                (2.5, 0.25),
                (0.5, 0.25),
            ),
            *(
                (0.5, 3),
                (-0.5, 3),
                (-0.5, 0.25),
                (-2.5, 0.25),
                (-2.5, -0.25),
                (-0.5, -0.25),
            ),
        ],
    ),
    "HEXA": ((1.0, 6.0, 4.0), [(-3, 0), (-2, -2), (2, -2), (3, 0), (2, 2), (-2, 2)]),
    "HAT": (
        (5.0, 0.5, 4.0, 2.0),
        [
            *((-4, 0), (-1.5, 0), (-1.5, 4.5), (1.5, 4.5), (1.5, 0), (4, 0)),
            *((4, 0.5), (2, 0.5), (2, 5), (-2, 5), (-2, 0.5), (-4, 0.5)),
        ],
    ),
    "CHAN": (
        (5.0, 8.0, 0.5, 1.0),
        [(0, 0), (5, 0), (5, 1), (0.5, 1), (0.5, 7), (5, 7), (5, 8), (0, 8)],
    ),
}


@pytest.mark.parametrize("kind", OUTLINES)
def test_sections_by_their_outline(kind: str) -> None:
    dims, outline = OUTLINES[kind]
    values = SECTIONS[kind][1](*dims)
    got = [values[n] for n in ("A", "I1", "I2")] + [values.get("I12", 0.0)]
    np.testing.assert_allclose(got, polygon(outline), rtol=1e-12, atol=1e-12)


def test_shear_centres() -> None:
    """Thin walls: a channel's is 3b²/(6b + h) outside its web; a hat without brim is that channel,
    turned.
    """
    b, h, t = 4.0, 6.0, 1e-3
    out = 3 * b**2 / (6 * b + h)
    centroid = b**2 / (2 * b + h)
    assert SECTIONS["CHAN"][1](b, h, t, t)["N2"] == pytest.approx(
        centroid + out, rel=1e-3
    )
    hat = SECTIONS["HAT"][1](b, t, h, 1e-9)  # legs down: the centre is above the top
    assert hat["N1"] == pytest.approx(-centroid - out, rel=2e-3)
    even = SECTIONS["I"][1](8.0, 5.0, 5.0, 1.0, 1.0, 1.0)
    assert even["N1"] == pytest.approx(0.0, abs=1e-12)
    uneven = SECTIONS["I"][1](
        8.0, 5.0, 1e-6, 1e-3, 1e-3, 1e-3
    )  # nearly an inverted T: at the flange
    flat = SECTIONS["T2"][1](5.0, 8.0, 1e-3, 1e-3)
    assert uneven["N1"] == pytest.approx(flat["N1"], rel=1e-3)


@pytest.mark.parametrize("kind", SECTIONS)
def test_dimensions_that_make_no_section_are_refused(kind: str) -> None:
    count, section = SECTIONS[kind]
    with pytest.raises(ValueError, match="do not make a section"):
        section(*([0.0] * count))


DECK = """SOL 103
CEND
BEGIN BULK
GRID,1,,0.,0.,0.
GRID,2,,2.,0.,0.
MAT1,1,2.+11,,.3,8000.
CBEAM,1,1,1,2,0.,1.,0.
PBEAML,1,1,,CHAN
,.05,.08,.005,.01
CBAR,2,2,1,2,0.,1.,0.
PBARL,2,1,,CHAN
,.05,.08,.005,.01
ENDDATA
"""


def test_a_pbeaml_has_its_neutral_axis_off_the_shear_centre_and_a_pbarl_has_not(
    tmp_path: Path,
) -> None:
    (tmp_path / "a.bdf").write_text(DECK)
    m = read_deck(tmp_path / "a.bdf")
    want = SECTIONS["CHAN"][1](0.05, 0.08, 0.005, 0.01)
    p = m["PBEAM"]
    np.testing.assert_allclose(
        [p["N2A"][0], p["N2B"][0], p["N1A"][0]],
        [want["N2"], want["N2"], 0.0],
        atol=1e-15,
    )
    assert want["N2"] > 0.01
    assert m["PBAR"]["A"][0] == p["A"][0]
