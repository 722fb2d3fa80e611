"""The deck that an OP2 holds: made files in each layout, and recorded ones against the deck beside
them.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from op2_writer import Op2Writer
from test_io_results_modes import DATA

from ringtrue.cli.main import run
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.decks.nastran.results.geometry import read_recorded_model
from ringtrue.decks.nastran.results.modes import read_nastran_modes
from ringtrue.errors import DataError
from ringtrue.model.cards import columns
from ringtrue.model.model import Model, Ragged

SINGLE = 3e-7  # seven digits of single precision
STEEL = [1, 210e9, 210e9 / 2.6, 0.3, 7850.0, 0.0, 0.0, 0.02, 0.0, 0.0, 0.0, 0]


def station(x: float, area: float) -> list[float]:
    return [0.0, x, area, 2.0, 3.0, 0.0, 4.0, 0.0, *[0.0] * 8]


def write_model(path: Path, order: str = "<", word: int = 4, post: int = -1) -> None:
    """Four nodes with a plate of two plies, a beam, a spring, rigid elements and all kinds of
    lists. POST 1 has qualifiers behind each name, POST -4 no header.
    """
    w = Op2Writer(order, word, enhanced=post == 1)
    if post != -4:
        w.head()
    w.table("PVT0", [[b"WTMA", b"SS  ", 2, 0.5, b"AUTO", b"SPC ", 3, b"YES ", b"    "]])
    w.table("CASECC", [[1, 7, 6, 9, 5, *[0] * 595]])
    nodes = [v for n in range(4) for v in (n + 1, 0, float(n % 2), n / 3, 0.1, 2, 0, 0)]
    frame = [2, 1, 2, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0]
    w.table("GEOM1", [[4501, 45, 1, *nodes], [2101, 21, 8, *frame]])
    plate = [1, 1, 1, 2, 4, 3, 512.0 * 3, 0.0, 0, 0, *[-1.0] * 4]
    beam = [2, 2, 1, 2, 0, 0, 4, 0.0, 0.0, 2, 0, 0, *[0.0] * 6]
    spring = [3, 1000.0, 1, 2, 1, 1, 0.0, 0.0]
    w.table(
        "GEOM2",
        [
            [2958, 51, 177, *plate],
            [5408, 54, 261, *beam],
            [701, 7, 74, *spring],
            [5201, 52, 11, 9, 1, 2],  # PLOTEL
        ],
    )
    loads = [9, 1.5, 2.0, 8, -1, -1]
    w.table(
        "GEOM3",
        [[4551, 61, 84, *loads], [4201, 42, 18, 8, 4, 0, 10.0, 0.0, 0.0, 1.0]],
    )
    w.table(
        "GEOM4",
        [
            [5481, 58, 12, 6, 123, 1, 1, 2, 6, 3, 0, 3, 4, -1],
            [4901, 49, 17, 7, 3, 1, 1.0, 4, 2, -0.5, -1, -1, -1],
            [6901, 69, 295, 11, 1, 123, 2, 3, -1, 0.0, 12, 2, 3, 4, -1, 0.0],
            [7101, 71, 187, 13, 3, 123, 0.5, 123, 1, 2, -1, 1.0, 12, 4, -1, -2, -3],
        ],
    )
    head = [1, 2, -0.5, 0.0, 0.0, 0, 0.0, 0.0]
    plies = [1, 0.25, 45.0, 1, 1, 0.75, 0.0, 0]
    stations = [
        *station(0.0, 1.0),
        *station(0.5, 0.5),
        *station(1.0, 0.25),
        *[0.0] * 16 * 8,
    ]
    tail = [1.0, 1.0, *[0.0] * 14]
    w.table(
        "EPT",
        [
            [2706, 27, 287, *head, *plies],
            [
                2302,
                23,
                283,
                1,
                100000001,
                1.0,
                200000001,
                1.0,
                0,
                1.0,
                0.0,
                -0.5,
                0.5,
                0,
            ],
            [5402, 54, 262, 2, 1, 3, 1, 1.0, *stations, *tail],
        ],
    )
    w.table("MPT", [[103, 1, 77, *STEEL]])
    modes = [5, 0.0, 100.0, 10, 0, 0, 0.0, -1, 1, b"MASS", *[0] * 17]
    w.table("DYNAMICS", [[308, 8, 348, *modes], [207, 2, 87, 1, 2, 3]])
    w.write(path)


@pytest.mark.parametrize("post", [-1, 1, -4])
@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("word", [4, 8])
def test_deck_of_made_file(tmp_path: Path, order: str, word: int, post: int) -> None:
    write_model(tmp_path / "m.op2", order, word, post)
    found = read_recorded_model(tmp_path / "m.op2")
    assert list(found.missing.values()) == [3, 3]
    assert [name.split(" (")[0] for name in found.missing] == [
        "GEOM2 PLOTEL",
        "DYNAMICS FREQ2",
    ]
    deck = tmp_path / "m.bdf"
    deck.write_text(found.deck())
    model = read_deck(deck)
    case = model.case
    assert (case.spc, case.mpc, case.method) == (6, 7, 5)
    assert model.params["WTMASS"] == 0.5
    assert model["GRID"]["X2"].tolist() == pytest.approx(
        [0, 1 / 3, 2 / 3, 1], rel=SINGLE
    )
    assert model["GRID"]["CD"].tolist() == [2] * 4
    assert model["CQUAD4"]["MCID"].tolist() == [2]
    assert np.isnan(model["CQUAD4"]["T1"]).all()
    assert model["CBEAM"]["G0"].tolist() == [4]
    assert [model["SPC1"].ragged("G").row(i).tolist() for i in (0, 1)] == [
        [3, 4],
        [1, 2],
    ]
    assert model["MPC"].ragged("A").row(0).tolist() == [1.0, -0.5]
    assert model["RBE2"].ragged("GM").row(0).tolist() == [2, 3]
    assert model["RBE3"].ragged("WT").row(0).tolist() == [0.5, 0.5, 1.0]
    assert model["PCOMP"].ragged("THETA").row(0).tolist() == [45.0, 0.0]
    assert "PSHELL" not in model  # made by Nastran of the PCOMP
    assert model["PBEAM"].ragged("X").row(0).tolist() == [0.5]
    assert model["PBEAM"]["AB"].tolist() == [0.25]
    assert np.isnan(model["MAT1"]["G"]).all()  # that of E and NU
    assert np.isnan(model["EIGRL"]["V1"]).all()
    assert model["EIGRL"]["V2"].tolist() == [100.0]
    text = deck.read_text()
    assert (
        "LOAD*                  9             1.5             2.0               8"
        in text
    )
    assert "$ GEOM2 PLOTEL (5201, 52, 11), 3 words" in text


def test_the_deck_is_found_by_inspect(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_model(tmp_path / "m.op2")
    assert run(["inspect", str(tmp_path / "m.op2")]) == 0
    said = capsys.readouterr().out
    assert "deck: 4 nodes, 3 elements" in said
    assert "convert" in said
    assert "model.bdf" in said


def test_convert_writes_the_deck_and_names_the_rest(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_model(tmp_path / "m.op2")
    words = ["convert", str(tmp_path / "m.op2"), str(tmp_path / "m.bdf")]
    assert run(words) == 0
    said = capsys.readouterr().out
    assert "4 GRID" in said
    assert "not rebuilt: GEOM2 PLOTEL (5201, 52, 11), 3 words" in said
    assert len(read_deck(tmp_path / "m.bdf")["CQUAD4"]) == 1
    other = str(tmp_path / "other.bdf")
    assert run([*words[:2], other, "--deck", str(tmp_path / "m.bdf")]) == 2
    assert "belong to modes" in capsys.readouterr().err


@pytest.mark.parametrize("rows", [1, 8, 11])
def test_coordinates_of_double_precision(tmp_path: Path, rows: int) -> None:
    """GRID of eleven words; with 8 rows the length is that of 11 rows of eight words, too."""
    place = np.arange(rows) / 7 + 0.1
    kinds = ["i4", "i4", "f8", "f8", "f8", "i4", "i4", "i4"]
    record = np.zeros(
        rows, np.dtype([(f"f{k}", f"<{kind}") for k, kind in enumerate(kinds)])
    )
    record["f0"] = np.arange(rows) + 1
    record["f2"] = record["f3"] = record["f4"] = place
    words = np.frombuffer(record.tobytes(), "<i4").tolist()
    w = Op2Writer()
    w.head()
    w.table("GEOM1", [[4501, 45, 1120001, *words]])
    w.write(tmp_path / "m.op2")
    grid = read_recorded_model(tmp_path / "m.op2").model["GRID"]
    np.testing.assert_array_equal(grid["X3"], place)


def test_words_of_another_form_are_named(tmp_path: Path) -> None:
    """Integers where reals stand, and a row cut short."""
    w = Op2Writer()
    w.head()
    w.table("GEOM1", [[4501, 45, 1, 1, 0, 0.0, 0.0, 0.0, 0, 0, 0]])
    w.table("EPT", [[902, 9, 29, 1, 1, 7, 8, 9, 10], [302, 3, 46, 1, 10.0, 0.0]])
    w.write(tmp_path / "m.op2")
    names = list(read_recorded_model(tmp_path / "m.op2").missing)
    assert names == ["EPT PROD (902, 9, 29)", "EPT PELAS (302, 3, 46)"]


def test_file_without_cards_is_refused_with_what_it_holds(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    w = Op2Writer()
    w.head()
    w.table("OUGV1", [[11, 1, 0, 1, 0, 0, 0, 0, 1, 8, *[0] * 136], [11, 1, *[0.0] * 6]])
    w.write(tmp_path / "m.op2")
    with pytest.raises(DataError, match="it holds OUGV1"):
        read_recorded_model(tmp_path / "m.op2")
    assert run(["convert", str(tmp_path / "m.op2"), str(tmp_path / "m.bdf")]) == 2
    assert "no cards of a deck" in capsys.readouterr().err
    with pytest.raises(DataError, match=r"OUGV1 \(displacements of statics\)"):
        read_nastran_modes(tmp_path / "m.op2")


def test_shapes_are_turned_by_the_frames_in_the_file(tmp_path: Path) -> None:
    w = Op2Writer()
    w.head()
    nodes = [v for n in (1, 2) for v in (n, 0, float(n), 0.0, 0.0, 5, 0, 0)]
    # its x is basic y
    turned = [5, 1, 2, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0]
    w.table("GEOM1", [[4501, 45, 1, *nodes], [2101, 21, 8, *turned]])
    motion = np.zeros((2, 6, 1))
    motion[:, 0, 0] = (0.5, 1.0)
    w.modes(np.array([4.0]), np.array([1, 2]), motion, np.ones(1))
    w.write(tmp_path / "m.op2")
    modes = read_nastran_modes(tmp_path / "m.op2")
    np.testing.assert_allclose(
        modes.rows(["1+Y", "2+Y"]).shapes[:, 0], [0.5, 1.0], atol=1e-7
    )
    np.testing.assert_allclose(modes.rows(["1+X", "2+X"]).shapes, 0, atol=1e-7)


@pytest.mark.parametrize("frame", [0, 4])
def test_nodes_of_bgpdt(tmp_path: Path, frame: int) -> None:
    """Without GEOM1: node 9 is the first inside, node 4 the second."""
    w = Op2Writer()
    w.head()
    w.table("BGPDTS", [[0, 9.0, 0.0, 0.0, frame, 4.0, 0.0, 0.0]])
    w.table("EQEXINS", [[4, 2, 9, 1], [4, 71, 9, 11]])
    w.modes(np.array([4.0]), np.array([4, 9]), np.ones((2, 6, 1)), np.ones(1))
    w.write(tmp_path / "m.op2")
    grid = read_recorded_model(tmp_path / "m.op2").model["GRID"]
    assert grid.stack("ID", "CD", "X1").tolist() == [[4, frame, 4], [9, 0, 9]]
    if frame:
        with pytest.raises(DataError, match="node 4 moves in displacement frame 4"):
            read_nastran_modes(tmp_path / "m.op2")
    else:
        assert read_nastran_modes(tmp_path / "m.op2").channels[0] == "4+X"


# What the deck beside a file has otherwise: PBEND is not rebuilt; extra points, node 70, frame 1000000 and OFFT
# were written into the decks later; a blank wall of a tube is half its diameter.
LATER = {
    "modes_elements": {"EPOINT", "GRID", "PBEND", "PTUBE"},
    "static_elements": {"EPOINT", "GRID", "PBEND", "PTUBE"},
    "modes_complex_elements": {"EPOINT", "PBEND", "PTUBE"},
    "static_solid_shell_bar": {"CORD2R"},
    "cbar_orientation": {"CBAR"},
}
RECORDED = [
    "beam_modes/beam_modes_m1.op2 beam_modes.dat",
    "beam_modes/beam_modes_m2.op2 beam_modes.dat",
    "corpus/complex/tet10/simple_example.op2 Simple_Example.bdf",
    "corpus/elements/modes_complex_elements.op2",
    "corpus/elements/modes_elements.op2",
    "corpus/elements/static_elements.op2",
    "corpus/nx/sol111_solid_stress/nx_sine.op2",
    "corpus/plate/plate.op2",
    "corpus/plate/plate_mixed.op2",
    "corpus/random/rms_tri_oesrmx1.op2",
    "corpus/sol_101_elements/static_solid_shell_bar.op2",
    "corpus/solid_bending/solid_bending.op2",
    "corpus/unit/bars/cbar_orientation.op2",
    "corpus/unit/bars/pbarl_bar_100.op2",
    "corpus/unit/cbush/cbush.op2 cbush.dat",
    "corpus/unit/pload4/chexa.op2",
    "corpus/unit/pload4/cpenta.op2",
    "corpus/unit/pload4/cquad4.op2",
    "corpus/unit/pload4/ctetra.op2",
    "corpus/unit/pload4/ctetra10.op2",
    "corpus/unit/pload4/ctria3.op2",
    "corpus/unit/pload4/pload1.op2",
    "msc2019/system_verification/002_svanberg_beam/nastran_runs/modes.op2 modes.dat",
    "msc2019/system_verification/002_svanberg_beam/nastran_runs/static.op2 static.dat",
    "naca_wing/0012_flutter.op2",
]
# Nastran fills in the default
COMPUTED = {"ZOFFS", "Z0", "TST", "NORM", "DIMB", "NSMB"}


@pytest.mark.parametrize(
    ("order", "word", "form"), [("<", 4, 14), ("<", 4, 4), (">", 8, 4)]
)
def test_frames_of_cstm(tmp_path: Path, order: str, word: int, form: int) -> None:
    """Points of BGPDT and frames of CSTM in the forms of older and newer versions: node 2 lies at 90
    degrees of cylinder 7, whose z axis is basic X and whose x axis is basic Y.
    """
    w = Op2Writer(order, word)
    rotation = [0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    if form == 14:
        w.table("BGPDT", [[0, 9.0, 0.0, 0.0, 7, 4.0, 0.0, 3.0]])
        w.table("CSTM", [[7, 2, 1.0, 0.0, 0.0, *rotation, 3, 1, *[0.0] * 3, *rotation]])
    else:
        first = [0, 1, 5, 61, 0, -1, *w.double(9.0, 0.0, 0.0)]
        second = [7, 7, 2, 61, 0, -2, *w.double(4.0, 0.0, 3.0)]
        w.table("BGPDTS", [[*first, *second], [1, 2]])
        frames = w.double(0.0, 0.0, 0.0, *rotation, 1.0, 0.0, 0.0, *rotation)
        w.table("CSTMS", [[3, 1, 0, 1, 7, 2, 0, 13], frames])
    w.table("EQEXINS", [[2, 2, 5, 1], [2, 21, 5, 11]])
    motion = np.random.default_rng(1).normal(size=(2, 6, 1))
    w.modes(np.array([4.0]), np.array([2, 5]), motion, np.ones(1))
    w.write(tmp_path / "m.op2")
    modes = read_nastran_modes(tmp_path / "m.op2")
    radial, tangential, axial = motion[0, :3, 0]
    basic = [axial, -tangential, radial]
    here = [modes.channels.index(f"2+{axis}") for axis in "XYZ"]
    np.testing.assert_allclose(modes.shapes[here, 0], basic, rtol=1e-6)
    text = read_recorded_model(tmp_path / "m.op2").deck()
    assert text.count("CORD2R") == text.count("CORD2C") == 1


@pytest.mark.data
@pytest.mark.parametrize(
    "names", RECORDED, ids=lambda n: n.split()[0].rpartition("/")[2]
)
def test_recorded_deck_is_the_deck_beside(tmp_path: Path, names: str) -> None:
    results, *beside = names.split()
    source = DATA / results
    if not source.is_file():
        pytest.skip(f"reference data not found: {source}")
    deck = source.parent / beside[0] if beside else source.with_suffix(".bdf")
    made = tmp_path / "made.bdf"
    made.write_text(read_recorded_model(source).deck())
    a, b = read_deck(deck), read_deck(made)
    assert (a.case.spc, a.case.method) == (b.case.spc, b.case.method)
    different = {c for c in set(a.tables) | set(b.tables) if not _same(a, b, c)}
    assert different == LATER.get(source.stem, set())


def _same(a: Model, b: Model, card: str) -> bool:
    if card not in a or card not in b or len(a[card]) != len(b[card]):
        return False
    rows = [sorted(_row(m, card, i) for i in range(len(m[card]))) for m in (a, b)]
    return all(_close(x, y) for x, y in zip(*rows, strict=True))


def _row(model: Model, card: str, i: int) -> tuple[tuple[object, ...], ...]:
    """Values by column; lists without their order; blanks (nan) as -1."""
    out: list[tuple[object, ...]] = []
    for spec in columns(card):
        column = model[card].columns.get(spec.name)
        if column is None or spec.name in COMPUTED:
            continue
        values = column.row(i) if isinstance(column, Ragged) else column[i : i + 1]
        if values.dtype.kind == "f":
            out.append(tuple(np.nan_to_num(values, nan=-1.0).tolist()))
        else:
            out.append(tuple(sorted(values.tolist())))
    return tuple(out)


def _close(
    x: tuple[tuple[object, ...], ...], y: tuple[tuple[object, ...], ...]
) -> bool:
    for a, b in zip(x, y, strict=True):
        if len(a) != len(b):
            return False
        for p, q in zip(a, b, strict=True):
            if (
                p != pytest.approx(q, rel=SINGLE, abs=0)
                if isinstance(p, float)
                else p != q
            ):
                return False
    return True
