"""Cards of panels, gaps, joints and general elements: read, written, read again, and edited in
place.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from ringtrue.decks.nastran.editor import edit_fields
from ringtrue.decks.nastran.reader import read_deck, survey
from ringtrue.decks.nastran.writer import write_bulk
from ringtrue.errors import DeckError, UnsupportedCard
from ringtrue.model.edit import FieldChange
from ringtrue.model.model import Model, Ragged

NODES = "GRID,1\nGRID,2,,1.\nGRID,3,,1.,1.\nGRID,4,,,1.\nGRID,5,,2.\nGRID,6,,3.\nSPOINT,42\nMAT1,1,2.+11,,.3\n"
CARDS = """CSHEAR,22,8,1,2,3,4
PSHEAR,8,1,.1,2.,1.,.5
CBUSH1D,71,71,1,2
CBUSH1D,72,71,1,,0
PBUSH1D,71,3000.,200.,300.
,SHOCKA,TABLE,2.2,1.2,1.,,200
CGAP,73,74,1,2,,,,0
PGAP,74,.025,2.5,1.+6,,2.+4,.25,.25
RBAR1,80,1,2,12
RROD,81,1,2,,1
RJOINT,82,3,4,123
RTRPLT,83,1,2,3,1235,3,3
RTRPLT1,84,1,2,3,,1246
RSPLINE,85,.05,1,2,123456,5,,3
,123,4,123,6
GENEL,629,,1,1,2,4,42,0
,3,2
,UD,,4,2,5,1
,Z,1.,2.,3.,4.,5.,6.,7.
,8.,9.,10.
,S,1.5,2.5,3.5,4.5,5.5,6.5,7.5
,8.5
CBEND,90,91,1,2,0.,1.,0.,3
PBEND,91,1,.01,1.-5,2.-5,3.-5,1.5
,,,,,,,,
,.5,,4.,.1,.2,.03
CBEND,92,93,2,5,6,,,4
PBEND,93,1,1,.1,.02,,,30.
,,,4.,.1,.2
CQUAD4,100,101,1,2,3,4
PSHELL,101,1,.1
CWELD,94,95,5,GRIDID,,,QT
,1,2,3,4,,,,,
,5,6,3
CWELD,96,95,,ALIGN,5,6
CWELD,98,95,,PARTPAT
,101,101
,.5,.5,0.
CWELD,99,95,1,ELPAT
,100,100
CFAST,120,121,PROP,101,101,,,
,.5,.5,0.
CFAST,122,121,ELEM,100,100,1
PFAST,121,.02,20,1,1.+3,2.+3,3.+3
,,,.5,.01
CORD2R,20,,0.,0.,0.,0.,0.,1.
,1.,0.,0.
CWELD,97,95,1,ELEMID
,100,100
PWELD,95,1,.02,,,OFF
,.1
GENEL,630,,1,1,2,1
,K,1.,-1.,1.
"""


def read(folder: Path, text: str, name: str = "main.bdf") -> Model:
    folder.mkdir(exist_ok=True)
    (folder / name).write_text("BEGIN BULK\n" + text + "ENDDATA\n")
    return read_deck(folder / name)


def test_reading(tmp_path: Path) -> None:
    m = read(tmp_path, NODES + CARDS)
    assert [m["PSHEAR"][c][0] for c in ("T", "NSM", "F1", "F2")] == [0.1, 2.0, 1.0, 0.5]
    assert m["CBUSH1D"].stack("GA", "GB", "CID").tolist() == [[1, 2, -1], [1, 0, 0]]
    assert [m["PBUSH1D"][c][0] for c in "KCM"] == [3000.0, 200.0, 300.0]
    assert [m["PGAP"][c][0] for c in ("U0", "KA", "KT", "MU1")] == [
        0.025,
        1e6,
        2e4,
        0.25,
    ]
    assert (
        m["RBAR1"]["CB"][0],
        m["RROD"]["CMA"][0],
        m["RROD"]["CMB"][0],
        m["RTRPLT1"]["CMC"][0],
    ) == (
        "12",
        "",
        "1",
        "1246",
    )
    assert m["RSPLINE"].ragged("G").row(0).tolist() == [1, 2, 5, 3, 4, 6]
    assert m["RSPLINE"].ragged("C").row(0).tolist() == [
        "",
        "123456",
        "",
        "123",
        "123",
        "",
    ]
    p = m["PBEND"]
    assert [p[c].tolist() for c in ("FSI", "A", "RM", "T")] == [
        [0, 1],
        [0.01, 0],
        [0, 0.1],
        [0, 0.02],
    ]
    assert [p[c].tolist() for c in ("RB", "THETAB", "K1", "NSM", "ZC")] == [
        [1.5, 0],
        [0, 30],
        [0.5, 0],
        [4, 4],
        [0.2, 0.2],
    ]
    assert m["CBEND"].stack("G0", "X2", "GEOM").tolist() == [[0, 1, 3], [6, 0, 4]]
    w = m["CWELD"]
    assert w["TYPE"].tolist() == ["GRIDID", "ALIGN", "PARTPAT", "ELPAT", "ELEMID"]
    assert w.stack(
        "GA1", "GA4", "GB1", "GB3", "GB4", "GA", "SHIDB", "PIDA"
    ).tolist() == [
        [1, 4, 5, 3, 0, 0, 0, 0],
        [0, 0, 0, 0, 0, 5, 0, 0],
        [0, 0, 0, 0, 0, 0, 0, 101],
        [0, 0, 0, 0, 0, 0, 100, 0],
        [0, 0, 0, 0, 0, 0, 100, 0],
    ]
    assert w["YS"][2] == m["CFAST"]["YS"][0] == 0.5
    assert m["CFAST"]["TYPE"].tolist() == ["PROP", "ELEM"]
    assert [m["PFAST"][c][0] for c in ("D", "MCID", "MFLAG", "KT3", "MASS", "GE")] == [
        0.02,
        20,
        1,
        3000,
        0.5,
        0.01,
    ]
    assert [m["PWELD"][c][0] for c in ("D", "MSET", "LDMIN", "LDMAX")] == [
        0.02,
        "OFF",
        0.1,
        5.0,
    ]
    t = m["GENEL"]
    assert t["FORM"].tolist() == ["Z", "K"]
    assert [t.ragged(c).row(0).tolist() for c in ("UI", "CI", "UD", "CD")] == [
        [1, 2, 42, 3],
        [1, 4, 0, 2],
        [4, 5],
        [2, 1],
    ]
    assert t.ragged("KZ").row(0).tolist() == [float(i) for i in range(1, 11)]
    assert t.ragged("S").row(0).tolist() == [1.5, 2.5, 3.5, 4.5, 5.5, 6.5, 7.5, 8.5]
    assert (t.ragged("KZ").row(1).tolist(), t.ragged("UD").row(1).size) == (
        [1, -1, 1],
        0,
    )


def test_writing_and_reading_again(tmp_path: Path) -> None:
    m = read(tmp_path, NODES + CARDS)
    again = read(tmp_path / "again", write_bulk(m))
    assert set(again.tables) == set(m.tables)
    for card, t in m.tables.items():
        for name, column in t.columns.items():
            other = again[card].columns[name]
            if isinstance(column, Ragged) and isinstance(other, Ragged):
                assert column.values.tolist() == other.values.tolist(), (card, name)
                assert column.offsets.tolist() == other.offsets.tolist(), (card, name)
            else:
                assert str(column) == str(other), (card, name)


def test_editing_in_place(tmp_path: Path) -> None:
    m = read(tmp_path, NODES + CARDS)
    changes = (
        ("PSHEAR", 8, "T", 0.125),
        ("PBUSH1D", 71, "K", 3500.0),
        ("PGAP", 74, "KB", 12.5),
        ("PBEND", 91, "K1", 0.25),
        ("PBEND", 93, "T", 0.01),
        ("PWELD", 95, "D", 0.03),
    )
    (out,) = edit_fields(m, [FieldChange(*c) for c in changes], tmp_path / "new")
    for card, at, field, value in changes:
        t = read_deck(out)[card]
        assert t[field][t.find([at])[0]] == value
    before, after = (Path(f).read_text().splitlines() for f in (m.files[0], out))
    assert sum(a != b for a, b in zip(before, after, strict=True)) == 6


@pytest.mark.parametrize(
    ("card", "message"),
    [
        ("GENEL,1,,1,1\n", "GENEL.*one block K or Z"),
        ("GENEL,1,,1,1,2,1\n,K,1.,2.,3.,4.\n", "GENEL.*4 numbers, 3 are needed"),
        ("RSPLINE,1,,1,2,12,3,4\n", "RSPLINE.*last node is independent"),
        ("RBAR1,1,1,77\n", "RBAR1 1.*77"),
        ("CSHEAR,1,9,1,2,3,4\n", "CSHEAR 1.*PSHEAR 9"),
    ],
)
def test_errors_name_the_card(tmp_path: Path, card: str, message: str) -> None:
    with pytest.raises(DeckError, match=message):
        read(tmp_path, NODES + card)


@pytest.mark.parametrize(
    "pipe",
    ["PBEND,9,1,2,.1,.01,,1.", "PBEND,9,1,1,.1,.01,,1.,\n,.3", "PBEND,9,1,3,.1,.01"],
)
def test_pipes_with_flexibility_factors_stop(tmp_path: Path, pipe: str) -> None:
    with pytest.raises(
        UnsupportedCard, match=r"main.bdf:10: PBEND is not supported: of pipes FSI = 1"
    ):
        read(tmp_path, NODES + pipe + "\n")


def test_other_welds_stop(tmp_path: Path) -> None:
    with pytest.raises(
        UnsupportedCard,
        match=r"main.bdf:10: CWELD is not supported: type ALL; allowed are GRIDID",
    ):
        read(tmp_path, NODES + "CWELD,1,2,,ALL\n,3,4\n,5.,5.,0.\n")


@pytest.mark.parametrize(
    ("bush", "stiffness", "told"),
    [
        ("CBUSH,7,8,1,2", "1.,2.,3.", "not equal"),
        ("CBUSH,7,8,1,2", "1.,2.,2.,0.,4.,5.", "not equal"),
        ("CBUSH,7,8,1,2", "1.,2.,2.,3.,5.,5.", ""),
        ("CBUSH,7,8,1,2", "1.,,,3.", ""),
        ("CBUSH,7,8,1,2,,,,0", "1.,2.,3.", ""),
        ("CBUSH,7,8,1,2,0.,1.,0.", "1.,2.,3.", ""),
        ("CBUSH,7,8,1,2,5", "1.,2.,3.", ""),
        ("CBUSH,7,8,1", "1.,2.,3.", ""),
    ],
)
def test_a_bush_whose_axes_nothing_gives(
    tmp_path: Path, bush: str, stiffness: str, told: str
) -> None:
    """As in Nastran, springs across the line of the ends need an orientation; alike ones answer in
    any.
    """
    deck = tmp_path / "d.bdf"
    deck.write_text(f"BEGIN BULK\n{NODES}PBUSH,8,K,{stiffness}\n{bush}\n")
    if told:
        with pytest.raises(DeckError, match=f"d.bdf:11: CBUSH 7: .*{told}"):
            read_deck(deck)
        assert any(told in str(f) for f in survey(deck).faults)
    else:
        assert len(read_deck(deck)["CBUSH"]) == 1


@pytest.mark.parametrize(
    ("line", "lost"),
    [
        ("SPC1,1,123,1,2,3,4,5,6,77", "77"),
        ("SPC1,1,123,1,2,3,4,5,6,+A\n+A,5", ""),
        ("SPC1,1,123,1,2,3,4,5,6,9\n+9,5", ""),
        ("SPC1,1,123,1,2,3,4,5,6,CONT", ""),
        ("SPC1,1,123,1,2,3,4,5,6,", ""),
    ],
)
def test_a_number_in_the_place_of_a_continuation_name_is_told(
    tmp_path: Path, line: str, lost: str, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "d.bdf").write_text(f"BEGIN BULK\n{NODES}{line}\n")
    read_deck(tmp_path / "d.bdf")
    assert (
        f"d.bdf:10: '{lost}' stands behind the eight data fields" in caplog.text
    ) == bool(lost)
