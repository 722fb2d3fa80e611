"""PBEAM with stations between its ends: one element is a chain of tapered ones, condensed.

Sections vary linearly from station to station. Equilibrium alone gives the stiffness at the ends,
so that a beam of three parts must have, to rounding, the stiffness of three beams whose inner nodes
are condensed out.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fem_cases import cards, grid, model, ragged, spc, steel
from fem_slopes import matrix_derivatives

from ringtrue.core.arrays import Float
from ringtrue.core.parameters import CardField, Parameter, ParameterSet
from ringtrue.decks.nastran.editor import edit_fields
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.decks.nastran.writer import write_bulk
from ringtrue.errors import DeckError, InputError
from ringtrue.fem.assembly import assemble
from ringtrue.model.edit import FieldChange, apply_factors, field_changes
from ringtrue.model.model import Model

L, RHO = 2.0, 8000.0
PLACES = np.array([0.0, 0.3, 0.8, 1.0])
AREA = np.array([0.01, 0.03, 0.006, 0.01])
I1, I2, I12, J, NSM = (
    np.array(v) * AREA for v in (2e-3, 1e-3, 4e-4, 1.5e-3, [0, 300.0, 100.0, 500.0])
)
FIELDS = {"A": AREA, "I1": I1, "I2": I2, "I12": I12, "J": J, "NSM": NSM}
HEAD = "MAT1,1,2.+11,,.3,8000.\nGRID,1\nGRID,2,,2.\nCBEAM,1,1,1,2,0.,1.,0.\n"
EXACT = 1e-8  # sixteen points a part, in both; relative to the largest term


def section(first: int, last: int) -> dict[str, list[float]]:
    ends = {name: [float(v[first])] for name, v in FIELDS.items()}
    return (
        ends
        | {f"{name}B": [float(v[last])] for name, v in FIELDS.items()}
        | {"K1": [0.8], "K2": [0.6]}
    )


def single(**params: float) -> Model:
    between = {f"{name}X": ragged(v[1:3]) for name, v in FIELDS.items()}
    p = cards(
        "PBEAM", PID=[1], MID=1, **section(0, 3), X=ragged(PLACES[1:3]), **between
    )
    element = cards("CBEAM", EID=[1], PID=1, GA=1, GB=2, X2=1.0)
    return model(
        grid([[0, 0, 0], [L, 0, 0]]), element, p, steel(rho=RHO), AUTOSPC="NO", **params
    )


def chain() -> Model:
    x = np.zeros((4, 3))
    x[:, 0] = L * PLACES
    parts = [section(k, k + 1) for k in range(3)]
    p = cards(
        "PBEAM",
        PID=[1, 2, 3],
        MID=1,
        **{n: [part[n][0] for part in parts] for n in parts[0]},
    )
    ids = np.arange(1, 4)
    return model(
        grid(x),
        cards("CBEAM", EID=ids, PID=ids, GA=ids, GB=ids + 1, X2=1.0),
        p,
        steel(),
        AUTOSPC="NO",
    )


def condensed(K: Float) -> Float:
    ends, inner = np.r_[:6, 18:24], np.arange(6, 18)
    out = K[np.ix_(ends, ends)] - K[np.ix_(ends, inner)] @ np.linalg.solve(
        K[np.ix_(inner, inner)], K[np.ix_(inner, ends)]
    )
    return np.asarray(out)


def test_a_beam_with_stations_is_a_chain_of_tapered_beams() -> None:
    want = condensed(assemble(chain()).stiffness.toarray())
    got = assemble(single()).stiffness.toarray()
    size = np.sqrt(np.diag(want))
    np.testing.assert_allclose(
        got / np.outer(size, size), want / np.outer(size, size), atol=EXACT
    )


def test_a_stepped_bar_is_springs_in_series() -> None:
    """Two stations at one place make a step: 1/k = L (a/EA1 + (1 - a)/EA2)."""
    p = cards(
        "PBEAM",
        PID=[1],
        MID=1,
        A=[0.01],
        I1=2e-5,
        I2=1e-5,
        J=1e-5,
        AB=0.02,
        I1B=2e-5,
        I2B=1e-5,
        JB=1e-5,
    )
    step = {"X": ragged([0.25, 0.25]), "AX": ragged([0.01, 0.02])} | {
        f"{n}X": ragged([np.nan, np.nan]) for n in ("I1", "I2", "I12", "J", "NSM")
    }
    p = cards("PBEAM", **{**p.columns, **step})
    element = cards("CBEAM", EID=[1], PID=1, GA=1, GB=2, X2=1.0)
    m = model(
        grid([[0, 0, 0], [L, 0, 0]]), element, p, steel(2e11), spc([1], "123456"), spc=1
    )
    assert assemble(m).stiffness.toarray()[0, 0] == pytest.approx(
        1 / (L * (0.25 / 0.01 + 0.75 / 0.02) / 2e11), rel=1e-12
    )


@pytest.mark.parametrize("coupled", [-1, 1])
def test_mass_and_centre(coupled: int) -> None:
    """Trapezoids: ∫ m dx and ∫ m x dx of ρA + NSM, linear between the stations."""
    M = assemble(single(COUPMASS=coupled)).mass.toarray()
    x = np.linspace(0, 1, 100_001)
    m = np.interp(x, PLACES, RHO * AREA + NSM)
    total, moment = L * np.trapezoid(m, x), L**2 * np.trapezoid(m * x, x)
    y, turn = (
        np.tile([0, 1.0, 0, 0, 0, 0], 2),
        np.r_[np.zeros(6), 0, L, 0, 0, 0, 0] + np.tile([0, 0, 0, 0, 0, 1.0], 2),
    )
    along = np.tile([1.0, 0, 0, 0, 0, 0], 2)
    assert along @ M @ along == pytest.approx(total, rel=1e-9)
    assert y @ M @ y == pytest.approx(total, rel=1e-9)
    assert y @ M @ turn == pytest.approx(moment, rel=1e-9)


def test_stations_on_the_line_and_blank_ones_change_nothing(tmp_path: Path) -> None:
    ends = "PBEAM,1,1,.01,2.-5,1.-5,,1.-5,3.\n,\n{},YES,1.,.02,4.-5,2.-5,,2.-5,5.\n,\n,.8,.6\n"
    systems = []
    for between in ("", ",NO,.5,.015,3.-5,1.5-5,,1.5-5,4.\n", ",NO,.25\n,YESA,.5\n"):
        (tmp_path / "a.bdf").write_text(HEAD + ends.format(between))
        systems.append(assemble(read_deck(tmp_path / "a.bdf")))
    for other in systems[1:]:
        for name in ("stiffness", "mass"):
            a, b = (getattr(s, name).toarray() for s in (systems[0], other))
            np.testing.assert_allclose(b, a, atol=1e-9 * np.abs(a).max())


def test_beams_with_different_numbers_of_stations() -> None:
    """Side by side in one model each keeps its own."""
    one, many = single(), chain()
    p = cards(
        "PBEAM",
        PID=[1, 2],
        MID=1,
        **{n: [*section(0, 3)[n], *section(0, 1)[n]] for n in section(0, 1)},
        X=ragged(PLACES[2:0:-1], []),  # in any order
        **{f"{n}X": ragged(v[2:0:-1], []) for n, v in FIELDS.items()},
    )
    element = cards("CBEAM", EID=[1, 2], PID=[1, 2], GA=[1, 3], GB=[2, 4], X2=1.0)
    both = model(
        grid([[0, 0, 0], [L, 0, 0], [0, 5, 0], [0.3 * L, 5, 0]]),
        element,
        p,
        steel(rho=RHO),
        AUTOSPC="NO",
    )
    K = assemble(both).stiffness.toarray()
    np.testing.assert_allclose(
        K[:12, :12], assemble(one).stiffness.toarray(), rtol=1e-12, atol=1e-3
    )
    rod = assemble(many).stiffness.toarray()[
        :12, 6:12
    ]  # the first of the chain, alone in these columns but for node 2
    np.testing.assert_allclose(
        K[12:18, 18:], rod[:6], rtol=1e-6, atol=1e-6 * np.abs(rod).max()
    )


DECK = HEAD + (
    "PBEAM   1       1       .01     2.-5    1.-5            1.5-5   3.\n\n"
    "+       YES     .5      .02     3.-5                    2.-5    4.\n"
    "+       0.      0.      0.      0.      0.      0.      0.      0.\n"
    "+       NO      1.0                                             \n+       .9\n"
).replace(
    "3.\n\n", "3.\n+       1.      1.      0.      0.      0.      0.      0.      0.\n"
)


def test_reading_writing_and_editing(tmp_path: Path) -> None:
    (tmp_path / "a.bdf").write_text(DECK)
    read = read_deck(tmp_path / "a.bdf")
    t = read["PBEAM"]
    assert [t.ragged(n).row(0)[0] for n in ("X", "AX", "I1X", "JX", "NSMX")] == [
        0.5,
        0.02,
        3e-5,
        2e-5,
        4.0,
    ]
    assert np.isnan(t.ragged("I2X").row(0)).all()
    assert (t["AB"][0], t["K1"][0]) == (0.01, 0.9)
    (tmp_path / "b.bdf").write_text(write_bulk(read))
    again = read_deck(tmp_path / "b.bdf")["PBEAM"]
    for name in t.columns:
        left, right = (
            (x.ragged(name).values if name.endswith("X") else x[name])
            for x in (t, again)
        )
        np.testing.assert_array_equal(left, right)
    edit_fields(
        read,
        [FieldChange("PBEAM", 1, "AX1", 0.0123), FieldChange("PBEAM", 1, "I2X1", 7e-6)],
        tmp_path / "new",
    )
    old, new = DECK.splitlines(), (tmp_path / "new/a.bdf").read_text().splitlines()
    assert [
        i for i, pair in enumerate(zip(old, new, strict=True)) if pair[0] != pair[1]
    ] == [6]  # the station's line
    edited = read_deck(tmp_path / "new/a.bdf")["PBEAM"]
    assert [edited.ragged(n).row(0)[0] for n in ("AX", "I1X", "I2X", "JX")] == [
        0.0123,
        3e-5,
        7e-6,
        2e-5,
    ]
    edit_fields(read, [FieldChange("PBEAM", 1, "X1", 0.25)], tmp_path / "moved")
    assert read_deck(tmp_path / "moved/a.bdf")["PBEAM"].ragged("X").row(0)[0] == 0.25
    with pytest.raises(InputError, match="1 stations"):
        edit_fields(read, [FieldChange("PBEAM", 1, "AX2", 1.0)], tmp_path / "other")


def test_a_station_outside_the_beam_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.bdf").write_text(DECK.replace(".5      .02", "1.5     .02"))
    with pytest.raises(DeckError, match=r"station at 1\.5"):
        read_deck(tmp_path / "a.bdf")


def test_sections_of_a_pbeaml(tmp_path: Path) -> None:
    """A rod of radius 0.1, 0.2 and 0.1: its torsion constant is half π r⁴ at each station, and
    linear between.
    """
    (tmp_path / "a.bdf").write_text(
        HEAD + "PBEAML,1,1,,ROD\n,.1,0.,NO,.5,.2,0.,NO,1.\n,.1,0.\n"
    )
    read = read_deck(tmp_path / "a.bdf")
    np.testing.assert_allclose(read["PBEAM"].ragged("JX").row(0), np.pi / 2 * 0.2**4)
    K = assemble(read).stiffness.toarray()
    a, b = np.pi / 2 * 0.1**4, np.pi / 2 * 0.2**4
    # J 16:1
    assert K[9, 9] == pytest.approx(
        2e11 / 2.6 / (L * np.log(b / a) / (b - a)), rel=1e-6
    )


def test_a_uniform_beam_with_stations_stays_uniform(tmp_path: Path) -> None:
    """A factor on A holds for end B and the stations that have the same value, in the model and in
    its deck.
    """
    text = DECK.replace(".02     3.-5", ".01     3.-5")
    (tmp_path / "a.bdf").write_text(text)
    read = read_deck(tmp_path / "a.bdf")
    parameters = ParameterSet((Parameter("area", (CardField("PBEAM", 1, "A"),)),))
    changed = apply_factors(read, parameters, np.array([1.5]))
    edit_fields(
        read, field_changes(read, parameters, np.array([1.5])), tmp_path / "new"
    )
    for m in (changed, read_deck(tmp_path / "new/a.bdf")):
        t = m["PBEAM"]
        np.testing.assert_allclose(
            [t["A"][0], t["AB"][0], t.ragged("AX").row(0)[0]], 0.015, rtol=1e-15
        )


@pytest.mark.parametrize("field", ["AX1", "I1X2", "I12X1", "NSMX2", "JX1", "A"])
def test_derivatives(field: str) -> None:
    m = single()
    p = Parameter("p", (CardField("PBEAM", 1, field),))
    slopes = matrix_derivatives(m, p, assemble(m))
    h = 1e-5
    up, down = (
        assemble(apply_factors(m, ParameterSet((p,)), np.array([1 + s * h])))
        for s in (1, -1)
    )
    for slope, name in zip(slopes, ("stiffness", "mass"), strict=True):
        difference = (getattr(up, name) - getattr(down, name)).toarray() / (2 * h)
        size = np.abs(getattr(up, name).toarray()).max()
        np.testing.assert_allclose(slope.toarray(), difference, atol=1e-9 * size)
    assert max(np.abs(s.toarray()).max() for s in slopes) > 0
