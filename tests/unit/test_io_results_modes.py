"""Results files of Nastran-like programs: recorded ones, made ones in each layout, and damaged
ones.
"""

from __future__ import annotations

import os
from pathlib import Path

import h5py
import numpy as np
import pytest
from op2_writer import Op2Writer

from ringtrue.cli.main import run
from ringtrue.core.dofs import DofSet
from ringtrue.core.modes import Norm
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.decks.nastran.results.modes import (
    read_nastran_deflections,
    read_nastran_modes,
    read_nastran_responses,
    read_recorded,
)
from ringtrue.decks.nastran.results.printed import fatal_messages, sturm_counts
from ringtrue.errors import DataError
from ringtrue.model.model import Model, Ragged, table
from ringtrue.shapes import mac

DATA = Path(__file__).parents[3] / "shared" / "data" / "fe"
SVANBERG = "msc2019/system_verification/002_svanberg_beam/nastran_runs/modes"
BEAM = (
    456.6603,
    456.6603,
    2674.588,
    2674.588,
    3554.923,
    4507.487,
    6626.104,
    6626.104,
    11111.59,
    11111.59,
)
PRINTED = 5e-7  # seven digits


def recorded(name: str) -> Path:
    if not (DATA / name).is_file():
        pytest.skip(f"reference data not found: {DATA / name}")
    return DATA / name


@pytest.mark.data
@pytest.mark.parametrize(
    "name", ["beam_modes.f06", "beam_modes_m1.op2", "beam_modes_m2.op2"]
)
def test_recorded_beam(name: str) -> None:
    modes = read_nastran_modes(recorded(f"beam_modes/{name}"))
    np.testing.assert_allclose(modes.frequencies, BEAM, rtol=PRINTED)
    assert modes.norm is Norm.MASS
    assert modes.channels[6:8] == ("2+X", "2+Y")


@pytest.mark.data
def test_formats_of_one_run_agree() -> None:
    """MSC 2019, one job: HDF5 in double precision, OP2 in single, F06 in seven digits."""
    deck = read_deck(recorded(f"{SVANBERG}.dat"))
    h5, f06, op2 = (
        read_nastran_modes(recorded(f"{SVANBERG}.{e}"), deck)
        for e in ("h5", "f06", "op2")
    )
    for other in (f06, op2):
        assert other.norm is Norm.MASS  # the OP2 holds no modal masses: EIGRL says MASS
        np.testing.assert_allclose(other.frequencies, h5.frequencies, rtol=PRINTED)
        np.testing.assert_allclose(
            other.shapes, h5.shapes, atol=1e-6 * np.abs(h5.shapes).max()
        )
    # with the EIGRL of its DYNAMICS
    alone = read_nastran_modes(recorded(f"{SVANBERG}.op2"))
    assert alone.norm is Norm.MASS
    np.testing.assert_array_equal(alone.shapes, op2.shapes)


@pytest.mark.data
def test_shapes_scaled_by_maximum_become_mass_normalised() -> None:
    """The deck asks for unit maximum: modal masses of 0.0088 and more."""
    deck = read_deck(recorded("beam_modes/beam_modes.dat"))
    raw = read_recorded(recorded("beam_modes/beam_modes_m1.op2"))
    assert np.abs(raw.motion).max(axis=(0, 1))[:4] == pytest.approx(
        np.ones(4), rel=1e-6
    )
    modes = read_nastran_modes(recorded("beam_modes/beam_modes_m1.op2"), deck)
    assert np.abs(modes.shapes).max() == pytest.approx(
        np.abs(raw.motion / np.sqrt(raw.modal_mass)).max()
    )


NODES, VALUES = np.array([7, 3, 12]), np.array([4.0, 900.0])


def made(seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(3, 6, 2))


def write_op2(
    path: Path,
    order: str = "<",
    word: int = 4,
    mass: float = 1.0,
    name: str = "OUGV1",
    cd: int = 0,
) -> np.ndarray:
    writer, motion = Op2Writer(order, word), made()
    writer.head()
    writer.table(
        "GEOM1",
        [
            [
                4501,
                45,
                1,
                *(x for n in NODES.tolist() for x in (n, 0, 0.0, 0.0, 0.0, cd, 0, 0)),
            ]
        ],
    )
    writer.modes(VALUES, NODES, motion, np.full(2, mass), name)
    writer.write(path)
    return motion


def write_f06(path: Path) -> np.ndarray:
    motion = made()
    text = (
        "1    TITLE                          PAGE 1\n\n                   R E A L   E I G E N "
        "V A L U E S\n"
    )
    text += (
        "   MODE    EXTRACTION      EIGENVALUE            RADIANS             CYCLES         "
        "   GENERALIZED\n"
    )
    for k, lam in enumerate(VALUES):
        w = np.sqrt(lam)
        text += (
            f"{k + 1:9d}{k + 1:10d}"
            + "".join(f"{v:20.6E}" for v in (lam, w, w / 2 / np.pi, 1.0, lam))
            + "\n"
        )
    for k, lam in enumerate(VALUES):
        for rows in (slice(0, 2), slice(2, 3)):  # over two pages
            text += (
                f"1    TITLE                          PAGE {k + 2}\n      EIGENVALUE = "
                f"{lam:13.6E}\n"
            )
            text += (
                "          CYCLES = 1.0         R E A L   E I G E N V E C T O R   N O .  "
                f"{k + 1:10d}\n\n"
            )
            text += "      POINT ID.   TYPE          T1             T2             T3             R1\n"
            for n, v in zip(NODES[rows].tolist(), motion[rows, :, k], strict=True):
                text += f" {n:13d}      G  " + "".join(f"{x:15.6E}" for x in v) + "\n"
    path.write_text(text)
    return motion


def write_punch(path: Path) -> np.ndarray:
    motion = made()
    lines = []
    for k, lam in enumerate(VALUES):
        lines += [
            "$TITLE   =",
            "$EIGENVECTOR",
            "$REAL OUTPUT",
            "$SUBCASE ID =           1",
        ]
        lines += [f"$EIGENVALUE = {lam:14.7E}  MODE = {k + 1:5d}"]
        for n, v in zip(NODES.tolist(), motion[:, :, k], strict=True):
            lines.append(f"{n:10d}       G" + "".join(f"{x:18.6E}" for x in v[:3]))
            lines.append("-CONT-".ljust(18) + "".join(f"{x:18.6E}" for x in v[3:]))
    path.write_text("".join(f"{line[:72]:72s}{i:8d}\n" for i, line in enumerate(lines)))
    return motion


def write_h5(path: Path) -> np.ndarray:
    motion = made()
    names = ("X", "Y", "Z", "RX", "RY", "RZ")
    shapes = np.zeros(
        6, dtype=[("ID", "i8"), *((n, "f8") for n in names), ("DOMAIN_ID", "i8")]
    )
    shapes["ID"], shapes["DOMAIN_ID"] = np.tile(NODES, 2), np.repeat([5, 9], 3)
    for c, name in enumerate(names):
        shapes[name] = motion[:, c].T.ravel()
    ints = ("ID", "SUBCASE", "ANALYSIS", "MODE", "SE")
    domains = np.zeros(3, dtype=[(n, "i8") for n in ints] + [("TIME_FREQ_EIGR", "f8")])
    domains["ID"], domains["SUBCASE"], domains["ANALYSIS"], domains["MODE"] = (
        (9, 5, 1),
        1,
        (2, 2, 1),
        (2, 1, 0),
    )
    domains["TIME_FREQ_EIGR"] = (900.0, 4.0, 0.0)
    table_ = np.zeros(2, dtype=[("MODE", "i8"), ("EIGEN", "f8"), ("MASS", "f8")])
    table_["MODE"], table_["EIGEN"], table_["MASS"] = (1, 2), VALUES, 1.0
    with h5py.File(path, "w") as file:
        file["NASTRAN/RESULT/NODAL/EIGENVECTOR"] = shapes
        file["NASTRAN/RESULT/DOMAINS"] = domains
        file["NASTRAN/RESULT/SUMMARY/EIGENVALUE"] = table_
    return motion


WRITERS = {
    "m.op2": write_op2,
    "m.f06": write_f06,
    "m.out": write_f06,
    "m.pch": write_punch,
    "m.h5": write_h5,
}


@pytest.mark.parametrize("name", WRITERS)
def test_formats(tmp_path: Path, name: str) -> None:
    motion = WRITERS[name](tmp_path / name)
    modes = read_nastran_modes(tmp_path / name, mass_normalised=True)
    np.testing.assert_allclose(modes.frequencies, [1 / np.pi, 15 / np.pi], rtol=1e-6)
    np.testing.assert_allclose(modes.shapes, motion.reshape(18, 2), rtol=1e-6)
    assert modes.labels.node[::6].tolist() == [7, 3, 12]
    assert modes.norm is Norm.MASS


@pytest.mark.parametrize("word", [4, 8])
@pytest.mark.parametrize("order", ["<", ">"])
def test_op2_byte_orders_and_word_sizes(tmp_path: Path, order: str, word: int) -> None:
    motion = write_op2(tmp_path / "m.op2", order, word, mass=4.0)
    modes = read_nastran_modes(tmp_path / "m.op2")
    np.testing.assert_allclose(
        modes.shapes, motion.reshape(18, 2) / 2, rtol=1e-6 if word == 4 else 1e-14
    )
    np.testing.assert_allclose(
        modes.frequencies, [1 / np.pi, 15 / np.pi], rtol=1e-6 if word == 4 else 1e-14
    )


@pytest.mark.parametrize("first", [True, False])
@pytest.mark.parametrize("other", ["ROUGV1", "BOPHIGF", "RADCONS"])
def test_op2_eigenvectors_of_something_else_are_no_shapes(
    tmp_path: Path, other: str, first: bool
) -> None:
    """NX writes the rigid-body motion of a moved base as ROUGV1; its codes are those of OUGV1."""
    writer, motion, rigid = Op2Writer(), made(), np.ones((3, 6, 2))
    names = [(other, rigid), ("OUGV1", motion)]
    for name, values in names if first else names[::-1]:
        writer.modes(VALUES, NODES, values, np.ones(2), name)
    writer.write(tmp_path / "m.op2")
    modes = read_nastran_modes(tmp_path / "m.op2")
    np.testing.assert_allclose(modes.shapes, motion.reshape(18, 2), rtol=1e-6)
    alone = Op2Writer()
    alone.modes(VALUES, NODES, rigid, np.ones(2), other)
    alone.write(tmp_path / "alone.op2")
    with pytest.raises(
        DataError, match=f"no real eigenvectors in a table .* but those of {other}"
    ):
        read_nastran_modes(tmp_path / "alone.op2")


@pytest.mark.parametrize("word", [4, 8])
def test_op2_in_sort2_is_read_as_in_sort1(tmp_path: Path, word: int) -> None:
    """DISPLACEMENT(SORT2): a record a node, its rows the modes, whose eigenvalues LAMA has."""
    motion = made()
    first = Op2Writer(word=word)
    first.modes(VALUES, NODES, motion, np.ones(2))
    first.write(tmp_path / "sort1.op2")
    second = Op2Writer(word=word)
    second.table(
        "LAMA", [[21, 6, *[0] * 144], [1, 1, 4.0, *[1.0] * 4, 2, 2, 900.0, *[1.0] * 4]]
    )
    second.motions("OUGV2", (2, 7), [1, 2], NODES, motion, sort2=True)
    second.write(tmp_path / "sort2.op2")
    one, two = (read_nastran_modes(tmp_path / f"sort{k}.op2") for k in (1, 2))
    np.testing.assert_array_equal(two.shapes, one.shapes)
    np.testing.assert_array_equal(two.frequencies, one.frequencies)
    assert two.channels == one.channels
    bare = Op2Writer()
    bare.motions("OUGV2", (2, 7), [1, 2], NODES, motion, sort2=True)
    bare.write(tmp_path / "bare.op2")
    with pytest.raises(DataError, match="no LAMA of these modes: ask for SORT1"):
        read_nastran_modes(tmp_path / "bare.op2")


@pytest.mark.parametrize("keys", [[11, 25], [11.0, 25.0]])
def test_deflections_of_an_op2_in_sort2(tmp_path: Path, keys: list[float]) -> None:
    """Rows are known by their load sets, which some versions write as reals."""
    writer = Op2Writer()
    writer.motions("OUGV2", (1, 1), keys, NODES, made(), sort2=True)
    writer.write(tmp_path / "m.op2")
    cases, dofs, moved = read_nastran_deflections(tmp_path / "m.op2")
    assert cases == ("subcase 11", "subcase 25")
    np.testing.assert_allclose(moved, made().reshape(18, 2).T, rtol=1e-6)
    assert dofs.labels()[:2] == ("7+X", "7+Y")


@pytest.mark.parametrize("sort2", [False, True])
@pytest.mark.parametrize("polar", [False, True])
def test_frequency_responses_of_an_op2(
    tmp_path: Path, sort2: bool, polar: bool
) -> None:
    motion = made() + 1j * made(2)
    writer = Op2Writer()
    name = "OAG2" if sort2 else "OAG1"
    writer.motions(name, (5, 11), [0.3, 20.0], NODES, motion, polar=polar, sort2=sort2)
    writer.write(tmp_path / "m.op2")
    (found,) = read_nastran_responses(tmp_path / "m.op2")
    assert (found.case, found.quantity) == ("subcase 1", "accelerations")
    assert found.frequencies.tolist() == [0.3, 20.0]
    np.testing.assert_allclose(found.values, motion.reshape(18, 2).T, rtol=1e-6)
    assert run(["convert", str(tmp_path / "m.op2"), str(tmp_path / "m.csv")]) == 0
    lines = (tmp_path / "m.csv").read_text().splitlines()
    assert len(lines) == 1 + 2 * 18
    assert lines[1].startswith("subcase 1,accelerations,0.3,7+X,")


def test_op2_in_sort2_that_is_damaged(tmp_path: Path) -> None:
    """Two blocks of one subcase, of other frequencies."""
    writer = Op2Writer()
    records = []
    for node, frequency in ((7, 1.0), (3, 2.0)):
        ident = [51, 3001, 0, 1, 10 * node + 1, 0.0, 0.0, 0, 2, 14]
        records += [ident + [0] * 136, [frequency, 1, *[0.5] * 12]]
    writer.table("OUGV2", records)
    writer.write(tmp_path / "m.op2")
    with pytest.raises(DataError, match="nodes are not all given at the same rows"):
        read_nastran_responses(tmp_path / "m.op2")


def test_op2_eigenvalues_of_a_fluid_are_not_those_of_the_structure(
    tmp_path: Path,
) -> None:
    writer, motion = Op2Writer(), made()
    writer.table(
        "LAMAF",
        [
            [21, 6, *[0] * 144],
            [1, 1, 1e6, 1e3, 159.0, 4.0, 4e6, 2, 2, 4e6, 2e3, 318.0, 4.0, 16e6],
        ],
    )
    writer.modes(VALUES, NODES, motion, np.ones(2))
    writer.write(tmp_path / "m.op2")
    np.testing.assert_allclose(
        read_nastran_modes(tmp_path / "m.op2").frequencies,
        [1 / np.pi, 15 / np.pi],
        rtol=1e-6,
    )


@pytest.mark.parametrize("word", [4, 8])
def test_op2_in_the_enhanced_format_of_msc(tmp_path: Path, word: int) -> None:
    """PARAM,POST,1: six words follow the label and the name of each table."""
    writer, motion = Op2Writer(word=word, enhanced=True), made()
    writer.head()
    writer.table(
        "GEOM1",
        [
            [
                4501,
                45,
                1,
                *(x for n in NODES.tolist() for x in (n, 0, 0.0, 0.0, 0.0, 0, 0, 0)),
            ]
        ],
    )
    writer.modes(VALUES, NODES, motion, np.ones(2))
    writer.write(tmp_path / "m.op2")
    modes = read_nastran_modes(tmp_path / "m.op2")
    np.testing.assert_allclose(modes.shapes, motion.reshape(18, 2), rtol=1e-6)
    np.testing.assert_allclose(modes.frequencies, [1 / np.pi, 15 / np.pi], rtol=1e-6)


def deck(cd: int = 0) -> Model:
    grid = {
        "ID": [3, 7, 12],
        "CP": [0] * 3,
        "X1": [0.0, 1.0, 0.0],
        "X2": [1.0, 0.0, 0.0],
        "X3": [0.0, 0.0, 5.0],
    }
    cylinder = {"CID": [4], "RID": [0]} | {
        f"{p}{i}": [float(v)]
        for p, v3 in FRAME.items()
        for i, v in zip("123", v3, strict=True)
    }
    zero = {"CD": [cd, cd, 0], "PS": [""] * 3, "SEID": [0] * 3}
    return Model(
        {"GRID": table("GRID", **grid, **zero), "CORD2C": table("CORD2C", **cylinder)}
    )


FRAME = {"A": (0, 0, 0), "B": (0, 0, 1), "C": (1, 0, 0)}


def test_displacement_frames_are_turned_to_basic(tmp_path: Path) -> None:
    """Node 3 stands at 90 degrees of a cylindrical frame: its radial motion is basic Y, its
    tangential one -X.
    """
    motion = write_op2(tmp_path / "m.op2", cd=4)
    modes = read_nastran_modes(tmp_path / "m.op2", deck(cd=4))
    assert modes.labels.node[::6].tolist() == [3, 7, 12]  # as in the deck
    three, seven, twelve = modes.shapes.reshape(3, 6, 2)
    np.testing.assert_allclose(
        three[[1, 0, 2, 4, 3, 5]],
        motion[1] * [[1], [-1], [1], [1], [-1], [1]],
        atol=1e-6,
    )
    np.testing.assert_allclose(seven, motion[0], atol=1e-6)
    np.testing.assert_allclose(twelve, motion[2], atol=1e-6)


def test_a_file_in_displacement_frames_wants_the_deck(tmp_path: Path) -> None:
    write_op2(tmp_path / "m.op2", cd=4)
    with pytest.raises(DataError, match="name the deck"):
        read_nastran_modes(tmp_path / "m.op2")
    write_op2(
        tmp_path / "b.op2", name="BOUGV1"
    )  # PARAM,OUGCORD,BASIC: nothing is turned, whatever the deck says
    np.testing.assert_allclose(
        read_nastran_modes(tmp_path / "b.op2", deck(cd=4)).shapes,
        read_nastran_modes(tmp_path / "b.op2", deck(cd=0)).shapes,
    )


def test_results_of_another_model(tmp_path: Path) -> None:
    write_op2(tmp_path / "m.op2")
    other = Model({"GRID": deck()["GRID"].with_column("ID", np.array([3, 7, 13]))})
    with pytest.raises(DataError, match="node 12 is not in the deck"):
        read_nastran_modes(tmp_path / "m.op2", other)


def test_scalar_points(tmp_path: Path) -> None:
    motion = made()
    text = (write_f06(tmp_path / "m.f06"), (tmp_path / "m.f06").read_text())[1]
    text = text.replace("           12      G", "           12      S")
    (tmp_path / "s.f06").write_text(text)
    found = read_recorded(
        tmp_path / "s.f06"
    )  # a row of an S line holds six points one after the other
    assert found.nodes.tolist() == [7, 3, 12, 13, 14, 15, 16, 17]
    model = Model(
        {
            **deck().tables,
            "SPOINT": table("SPOINT", ID=Ragged(np.arange(12, 18), np.array([0, 6]))),
        }
    )
    model = Model({**model.tables, "GRID": read_rows(model, 2)})
    modes = read_nastran_modes(tmp_path / "s.f06", model)
    assert modes.channels[-2:] == ("16", "17")
    np.testing.assert_allclose(modes.shapes[-6:], motion[2], rtol=1e-6)
    assert isinstance(modes.labels, DofSet)


def read_rows(model: Model, n: int):
    grid = model["GRID"]
    return table("GRID", **{k: grid[k][:n] for k in grid.columns})


def test_mystran_prints_marks_and_one_table_a_mode(tmp_path: Path) -> None:
    text = """
                                            R E A L   E I G E N V A L U E S
    MODE  EXTRACTION      EIGENVALUE           RADIANS              CYCLES            GENERALIZED         GENERALIZED
   NUMBER   ORDER                                                                        MASS              STIFFNESS

        1       1       -4.000000E+00*       2.000000E+00        3.183099E-01        1.000000E+00       -4.000000E+00

 OUTPUT FOR EIGENVECTOR        1

                                                         E I G E N V E C T O R
                                              (in global coordinate system at each grid)
           GRID     COORD      T1            T2            T3            R1            R2            R3
                     SYS
              1        0  0.0           0.0           0.0           0.0           0.0           1.500000E+00
              2       40  3.063430-103  2.715120E-06 -5.494715E-03 -1.191070E-03  3.290515E-02 -3.969230E-03
"""
    (tmp_path / "m.f06").write_text(text)
    modes = read_nastran_modes(tmp_path / "m.f06")
    assert modes.frequencies == pytest.approx([-1 / np.pi])
    assert modes.shapes[:, 0] == pytest.approx(
        [0, 0, 0, 0, 0, 1.5, 3.06343e-103, 2.71512e-6, *LAST]
    )


LAST = (-5.494715e-3, -1.19107e-3, 3.290515e-2, -3.96923e-3)


@pytest.mark.data
def test_sturm_counts_and_fatal_messages(tmp_path: Path) -> None:
    counts = sturm_counts(recorded("beam_modes/beam_modes.f06"))
    assert counts == ((1484.403, 2), (12359.90, 10))
    assert fatal_messages(recorded("beam_modes/beam_modes.f06")) == ()
    (tmp_path / "a.f06").write_text(
        " 0*** USER FATAL MESSAGE 9050 (SEKRRS)\n     RUN TERMINATED: EXCESSIVE PIVOTS\n"
    )
    assert fatal_messages(tmp_path / "a.f06") == (
        "0*** USER FATAL MESSAGE 9050 (SEKRRS)\nRUN TERMINATED: EXCESSIVE PIVOTS",
    )


@pytest.mark.parametrize("name", WRITERS)
def test_damaged_files_give_one_clear_error(tmp_path: Path, name: str) -> None:
    """Cut off anywhere, or with bytes changed: modes or a DataError that names the file, nothing
    else.
    """
    WRITERS[name](tmp_path / name)
    whole = (tmp_path / name).read_bytes()
    rng = np.random.default_rng(0)
    refused = 0
    for k in range(60):
        data = bytearray(whole[: rng.integers(0, len(whole))] if k % 2 else whole)
        for at in rng.integers(0, max(len(data), 1), 0 if k % 2 else 6):
            data[at] = rng.integers(0, 256)
        bad = tmp_path / f"bad{k}{os.path.splitext(name)[1]}"
        bad.write_bytes(data)
        message = ""
        try:
            with np.errstate(all="ignore"):  # a changed number may be any number
                read_nastran_modes(bad)
        except DataError as e:
            message = str(e)
        refused += bool(message)
        assert not message or (str(bad) in message and len(message) < 2000)
    assert refused >= 25  # every cut but those in the last lines


@pytest.mark.parametrize("ext", [".op2", ".f06", ".pch", ".h5"])
def test_empty_foreign_and_missing_files(tmp_path: Path, ext: str) -> None:
    path = tmp_path / f"x{ext}"
    with pytest.raises(DataError, match="no such file"):
        read_nastran_modes(path)
    for data in (b"", b"hello\n" * 9):
        path.write_bytes(data)
        with pytest.raises(DataError, match=f"x{ext}"):
            read_nastran_modes(path)
    (tmp_path / "x.json").write_text("{}")
    with pytest.raises(
        DataError, match=r"no results of a solver: .* allowed are OP2 of Nastran"
    ):
        read_nastran_modes(tmp_path / "x.json")


@pytest.mark.data
def test_superelements_are_left_to_the_residual_structure() -> None:
    """Each superelement has a subcase of its own in front of that of the residual structure."""
    folder = "msc2019/superelements/cantilever_bar/part_super_cb"
    h5 = read_recorded(recorded(f"{folder}/cbSuper2Modes.h5"))
    f06 = read_recorded(recorded(f"{folder}/cbsuper2modes.f06"))
    assert h5.nodes.tolist() == f06.nodes.tolist()
    np.testing.assert_allclose(
        h5.motion, f06.motion, atol=1e-6 * np.abs(h5.motion).max()
    )


@pytest.mark.data
def test_reduced_runs_keep_their_shapes() -> None:
    """Craig-Bampton with enough modes is near the full model: the same lowest shapes in both HDF5
    files.
    """
    folder = "msc2019/superelements/cantilever_bar/no_super"
    full, reduced = (
        read_nastran_modes(recorded(f"{folder}/{n}.h5"))
        for n in ("noReduction", "dynamicReduction")
    )
    same = [c for c in full.channels if c in reduced.channels]
    likeness = mac(full.rows(same).shapes[:, :2], reduced.rows(same).shapes[:, :2])
    assert np.diag(likeness) == pytest.approx(np.ones(2), abs=1e-3)
