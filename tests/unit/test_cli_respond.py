"""`frf` and `static`: two masses of which all is known.

2 kg at node 5 hang on 800 N/m with a loss factor of 0.04 along X, 1 kg at node 6 on 100 N/m with
0.4 N s/m. Node 7 is held, 8 and 9 are joined to each other only.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import eigh

from ringtrue.cli.main import run
from ringtrue.io.campaign_tables import read_statics
from ringtrue.io.frfs import read_frfs, write_frfs

Capture = pytest.CaptureFixture[str]
MM_T_S = {"m": 1e-3, "k": 1e-3}  # tonnes and N/mm
FIRST, SECOND = 20 / (2 * np.pi), 10 / (2 * np.pi)  # Hz
IN_UNITS = [("SI", {}), ("mm-t-s", MM_T_S), ("mm-kg-s", {})]  # kg and mN/mm


def written(path: Path, *, m: float = 1.0, k: float = 1.0, damped: bool = True) -> Path:
    loss, dashpot = (",,,0.04", f"CDAMP2,3,{0.4 * k!r},6,1\n") if damped else ("", "")
    path.write_text(
        "BEGIN BULK\nGRID,5,,,,,,23456\nGRID,6,,10.,,,,23456\nGRID,7,,20.,,,,123456\n"
        "GRID,8,,30.,,,,23456\nGRID,9,,40.,,,,23456\n"
        f"CELAS2,1,{800 * k!r},5,1{loss}\nCELAS2,2,{100 * k!r},6,1\n{dashpot}"
        f"CONM2,11,5,,{2 * m!r}\nCONM2,12,6,,{m!r}\nCELAS2,4,{k!r},8,1,9,1\nCONM2,13,8,,{m!r}\n"
    )
    return path


def accelerance(f: Any) -> Any:
    """Of both masses, (line, 2)."""
    w = 2 * np.pi * f
    first, second = 800 * (1 + 0.04j) - 2 * w**2, 100 + 0.4j * w - w**2
    return np.stack([-(w**2) / first, -(w**2) / second], axis=1)


@pytest.mark.parametrize("more", [(), ("--direct",)])
def test_matrices_of_responses_act_on_them_and_not_on_modes(
    tmp_path: Path, more: tuple[str, ...], capsys: Capture
) -> None:
    """Half of 400 N/m, 1 kg and 2 N s/m more under node 6, by K2PP, M2PP and B2PP."""
    deck, target = written(tmp_path / "d.bdf"), tmp_path / "f.h5"
    terms = zip(("KP", "MP", "BP"), (400.0, 1.0, 2.0), strict=True)
    dmig = "".join(
        f"DMIG,{name},0,6,1\nDMIG,{name},6,1,,6,1,{value}\n" for name, value in terms
    )
    deck.write_text(
        f"CEND\nK2PP = 0.5*KP\nM2PP = MP\nB2PP = BP\n{deck.read_text()}{dmig}"
    )
    words = ["frf", str(deck), "--force", "6+X", "--fmin", "0.5", "--fmax", "5", *more]
    assert run([*words, "--out", str(target)]) == 0
    found = read_frfs(target)
    w = 2 * np.pi * found.freqs
    np.testing.assert_allclose(
        found.data[:, 0, 0], -(w**2) / (300 + 2.4j * w - 2 * w**2), rtol=1e-6
    )
    capsys.readouterr()
    assert run(["modes", str(deck), "--json", "-"]) == 0
    assert SECOND in [
        pytest.approx(m["frequency_hz"])
        for m in json.loads(capsys.readouterr().out)["modes"]
    ]


@pytest.mark.parametrize("more", [(), ("--direct",)])
@pytest.mark.parametrize(("units", "scale"), IN_UNITS)
def test_frfs_are_the_closed_form_in_si(
    tmp_path: Path, units: str, scale: dict[str, float], more: tuple[str, ...]
) -> None:
    deck, target = written(tmp_path / "d.bdf", **scale), tmp_path / "f.h5"
    words = [
        "frf",
        str(deck),
        "--force",
        "5+X",
        "--force",
        "6-X",
        "--at",
        "5+X,6+X",
        "--fmin",
        "0.5",
        "--fmax",
        "5",
    ]
    assert run([*words, "--units", units, "--out", str(target), *more]) == 0
    found = read_frfs(target)
    want = accelerance(found.freqs)
    assert found.freqs[[0, -1]].tolist() == [0.5, 5.0]
    np.testing.assert_allclose(found.data[:, 0, 0], want[:, 0], rtol=1e-6)
    np.testing.assert_allclose(found.data[:, 1, 1], -want[:, 1], rtol=1e-6)
    np.testing.assert_allclose(found.data[:, 0, 1], 0, atol=1e-9)
    assert found.sharp


def test_a_ratio_stands_in_place_of_the_damping_of_the_deck(
    tmp_path: Path, capsys: Capture
) -> None:
    deck = written(tmp_path / "d.bdf", damped=False)
    words = [
        "frf",
        str(deck),
        "--force",
        "5+X",
        "--fmax",
        "5",
        "--quantity",
        "displacement",
    ]
    assert run(words) == 2
    assert "give a damping ratio" in capsys.readouterr().err
    assert run([*words, "--direct"]) == 2
    assert "solve by modes" in capsys.readouterr().err
    assert run([*words, "--damping", "0.03", "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)
    w = 2 * np.pi * np.array(found["frequencies_hz"])
    (one,) = found["frfs"]
    want = 1 / (800 - 2 * w**2 + 2j * 0.03 * 20 * 2 * w)
    np.testing.assert_allclose(
        np.array(one["re"]) + 1j * np.array(one["im"]), want, rtol=1e-6
    )
    assert (one["response"], one["force"], found["unit"]) == ("5+X", "5+X", "(m)/N")


@pytest.mark.parametrize(
    ("table", "ratio"),
    [
        (
            "CRIT\n,1.,0.02,5.,0.06,ENDT",
            (0.02 + 0.01 * (FIRST - 1), 0.02 + 0.01 * (SECOND - 1)),
        ),
        ("G\n,0.,0.05,SKIP,SKIP,100.,0.05,ENDT", (0.025, 0.025)),
        (",1\n,2.,0.04,3.,0.06,ENDT", (0.03, 0.02)),
        ("Q\n,0.,10.,ENDT", (0.05, 0.05)),
    ],
)
@pytest.mark.parametrize("kdamp", [1, -1])
def test_modal_damping_of_the_deck(
    tmp_path: Path, table: str, ratio: tuple[float, float], kdamp: int
) -> None:
    """SDAMPING beside the loss factor and the dashpot; 800 N/m under 2 kg, 100 N/m under 1 kg."""
    deck, target = written(tmp_path / "d.bdf"), tmp_path / "f.h5"
    text = f"CEND\nSDAMPING = 7\n{deck.read_text()}PARAM,KDAMP,{kdamp}\nTABDMP1,7,{table}\n"
    deck.write_text(text)
    words = [
        "frf",
        str(deck),
        "--force",
        "5+X,6+X",
        "--fmin",
        "0.5",
        "--fmax",
        "5",
        "--quantity",
        "displacement",
    ]
    assert run([*words, "--out", str(target)]) == 0
    found = read_frfs(target)
    w = 2 * np.pi * found.freqs
    for i, (k, m, own) in enumerate([(800 * (1 + 0.04j), 2, 0 * w), (100, 1, 0.4 * w)]):
        w0 = np.sqrt(k.real / m)
        more = 2j * ratio[i] * m * w0 * (w if kdamp == 1 else w0)
        want = 1 / (k - m * w**2 + 1j * own + more)
        np.testing.assert_allclose(found.data[:, i, i], want, rtol=1e-6)


@pytest.mark.parametrize(
    ("table", "told"),
    [
        ("TABDMP1,8,CRIT\n,0.,1.,ENDT", "no such TABDMP1"),
        ("TABDMP1,7,X\n,0.,1.,ENDT", "allowed are G, CRIT and Q"),
        ("TABDMP1,7,CRIT\n,1.,.1,0.,.1,ENDT", "and rise"),
        ("TABDMP1,7,Q\n,1.,.1,2.,0.,ENDT", "above 0"),
    ],
)
def test_modal_damping_that_is_no_table(
    tmp_path: Path, table: str, told: str, capsys: Capture
) -> None:
    deck = written(tmp_path / "d.bdf")
    deck.write_text(f"CEND\nSDAMPING = 7\n{deck.read_text()}{table}\n")
    assert run(["frf", str(deck), "--force", "5+X", "--fmax", "5"]) == 2
    assert told in capsys.readouterr().err


@pytest.mark.parametrize("ending", ["uff", "csv", "h5"])
def test_frfs_are_written_so_that_modes_are_found_in_them(
    tmp_path: Path, ending: str, capsys: Capture
) -> None:
    deck, target, page = (
        written(tmp_path / "d.bdf"),
        tmp_path / f"f.{ending}",
        tmp_path / "f.html",
    )
    words = [
        "frf",
        str(deck),
        "--force",
        "5+X",
        "--fmax",
        "5",
        "--out",
        str(target),
        "--plot",
        str(page),
    ]
    assert run(words) == 0
    found = read_frfs(target)
    np.testing.assert_allclose(
        found.data[:, 0, 0], accelerance(found.freqs)[:, 0], rtol=1e-6
    )
    capsys.readouterr()
    assert run(["ema", str(target), "--json", "-"]) == 0
    modes = json.loads(capsys.readouterr().out)["modes"]
    assert [m["frequency_hz"] for m in modes] == pytest.approx(
        [20 / 2 / np.pi], rel=1e-3
    )
    assert [m["damping"] for m in modes] == pytest.approx([0.02], rel=1e-2)
    assert "Force at 5+X" in page.read_text("utf-8")


def test_tables_keep_coherence_and_transmissibilities(tmp_path: Path) -> None:
    table = tmp_path / "t.csv"
    cells = "1,2.5,-0.5,0.9\n2,3.5,-1.5,0.8\n3,1.5,-2.5,0.7\n"
    table.write_text(
        f"Frequency [Hz],1+Z/9+Z real [g/g],1+Z/9+Z imag [g/g],1+Z/9+Z coherence\n{cells}"
    )
    read = read_frfs(table)
    write_frfs(tmp_path / "u.csv", read)
    again = read_frfs(tmp_path / "u.csv")
    np.testing.assert_allclose(again.data, read.data)
    np.testing.assert_allclose(again.coherence, read.coherence)
    assert again.inputs == read.inputs


@pytest.mark.parametrize(("units", "scale"), IN_UNITS)
def test_static_deflections_are_force_over_stiffness(
    tmp_path: Path, units: str, scale: dict[str, float]
) -> None:
    deck, table = written(tmp_path / "d.bdf", **scale), tmp_path / "s.csv"
    deck.write_text(deck.read_text() + "CELAS2,9,1.0,8,1\n")
    words = [
        "static",
        str(deck),
        "--force",
        "5+X=4",
        "--force",
        "6-X",
        "--at",
        "5-X",
        "--at",
        "6+X",
    ]
    assert run([*words, "--units", units, "--csv", str(table)]) == 0
    tests = read_statics(table)
    assert (tests.cases, tests.channels) == (
        ("5+X", "6-X"),
        ("5+X", "5-X", "6+X", "6-X"),
    )
    np.testing.assert_allclose(tests.deflections[1], [-4 / 800, 0], atol=1e-12)
    np.testing.assert_allclose(tests.deflections[2], [0, -1 / 100], atol=1e-12)
    assert tests.loads[0, 0] == 4.0


BAR = """SOL 101
CEND
SPC = 1
SUBCASE 1
  LOAD = 5
SUBCASE 7
  LOAD = 2
SUBCASE 8
  LOAD = 3
BEGIN BULK
PARAM,COUPMASS,1
GRID,1,,0.,0.,0.
GRID,2,,2.,0.,0.
CORD2R,4,,0.,0.,0.,0.,0.,1.
,0.,1.,0.
CBAR,1,1,1,2,0.,1.,0.
PBAR,1,1,.01,2.-6,3.-6,4.-6
MAT1,1,2.+11,,.25,8000.
SPC1,1,123456,1
FORCE,1,2,,10.,0.,0.,-2.
MOMENT,1,2,4,30.,1.,0.,0.
LOAD,5,2.,3.,1,1.,2
GRAV,2,4,9.81,0.,1.,0.
FORCE,3,2,4,100.,0.,2.,0.
ACCEL1,9,,3.,0.,0.,1.
,1
"""


def test_static_loads_of_the_deck(tmp_path: Path, capsys: Capture) -> None:
    """A cantilever of 2 m and 160 kg; X of frame 4 is Y of basic, its Y is -X. Set 5 is six times 1
    and twice 2.
    """
    deck, L, E, rho, A, I2 = tmp_path / "d.bdf", 2.0, 2e11, 8000, 0.01, 3e-6
    deck.write_text(BAR)
    assert run(["static", str(deck), "--at", "2+X", "--at", "2+Z", "--json", "-"]) == 0
    cases = {
        c["case"]: c["metre"] for c in json.loads(capsys.readouterr().out)["cases"]
    }
    bent = -20 * L**3 / (3 * E * I2) - 30 * L**2 / (
        2 * E * I2
    )  # a moment about Y turns Z of the tip down
    along = -9.81 * rho * L**2 / (2 * E)
    assert cases["SUBCASE 8"]["2+X"] == pytest.approx(-200 * L / (E * A), rel=1e-6)
    assert cases["SUBCASE 7"]["2+X"] == pytest.approx(along, rel=1e-6)
    assert cases["SUBCASE 7"]["2+Z"] == pytest.approx(0, abs=1e-12)
    assert cases["SUBCASE 1"]["2+X"] == pytest.approx(2 * along, rel=1e-6)
    assert cases["SUBCASE 1"]["2+Z"] == pytest.approx(6 * bent, rel=1e-6)


def cantilever(path: Path, length: float, mass: float) -> Path:
    """2 m, 160 kg, clamped at 1, bending in the plane XZ; in units of so many metres and
    kilograms.
    """
    e, rho, i = 2e11 * length / mass, 8000 * length**3 / mass, 2e-6 / length**4
    path.write_text(
        f"BEGIN BULK\nPARAM,COUPMASS,1\nGRID,1,,,,,,123456\nGRID,2,,{2 / length:.6g},,,,1246\n"
        f"CBAR,1,1,1,2,0.,0.,1.\nPBAR*,1,1,{0.01 / length**2:.9e},{i:.9e}\n*,{i:.9e},{2 * i:.9e}\n"
        f"MAT1*,1,{e:.9e},,0.25\n*,{rho:.9e}\n"
    )
    return path


@pytest.mark.parametrize(
    ("units", "length", "mass"),
    [("SI", 1, 1), ("mm-t-s", 1e-3, 1e3), ("mm-kg-s", 1e-3, 1)],
)
def test_moments_and_rotations_are_those_of_a_cantilever_in_si(
    tmp_path: Path, units: str, length: float, mass: float, capsys: Capture
) -> None:
    """(EI/L³) [[12, 6L], [6L, 4L²]] of a force along -Z and a moment about Y, and (m/420) [[156,
    22L], [22L, 4L²]].
    """
    deck, L, EI, m, target = (
        cantilever(tmp_path / "d.bdf", length, mass),
        2.0,
        4e5,
        160.0,
        tmp_path / "f.uff",
    )
    K = EI / L**3 * np.array([[12, -6 * L], [-6 * L, 4 * L**2]])
    M = m / 420 * np.array([[156, -22 * L], [-22 * L, 4 * L**2]])
    ends = ["--force", "2-Z", "--force", "2+RY", "--units", units]
    assert (
        run(["static", str(deck), *ends[:3], "2+RY=30", *ends[4:], "--json", "-"]) == 0
    )
    cases = json.loads(capsys.readouterr().out)["cases"]
    moved = [[c["metre"]["2-Z"], c["radian"]["2+RY"]] for c in cases]
    np.testing.assert_allclose(moved, np.linalg.inv(K) * [[1], [30]], rtol=1e-6)
    words = [
        "frf",
        str(deck),
        *ends,
        "--fmax",
        "200",
        "--lines",
        "20",
        "--damping",
        "0.01",
        "--quantity",
        "velocity",
    ]
    assert run([*words, "--out", str(target), "--json", "-"]) == 0
    units_told = [one["unit"] for one in json.loads(capsys.readouterr().out)["frfs"]]
    assert units_told == ["(m/s)/N", "(m/s)/(N*m)", "(rad/s)/N", "(rad/s)/(N*m)"]
    found = read_frfs(target)
    w = 2 * np.pi * found.freqs
    lam, phi = eigh(K, M)
    modal = lam - w[:, None] ** 2 + 2j * 0.01 * np.sqrt(lam) * w[:, None]
    want = 1j * w[:, None, None] * np.einsum("om,fm,im->foi", phi, 1 / modal, phi)
    np.testing.assert_allclose(found.data, want, rtol=1e-5)
    assert [
        (c.id, c.quantity, c.unit) for c in (found.outputs[1], found.inputs[1])
    ] == [
        ("2+RY", "angular velocity", "rad/s"),
        ("2+RY", "moment", "N*m"),
    ]
    write_frfs(tmp_path / "f.csv", found)
    again = read_frfs(tmp_path / "f.csv")
    assert (again.outputs, again.inputs) == (found.outputs, found.inputs)
    np.testing.assert_allclose(again.data, found.data, rtol=1e-7)


def test_rotations_by_modes_and_directly_agree(tmp_path: Path) -> None:
    deck = cantilever(tmp_path / "d.bdf", 1, 1)
    deck.write_text(deck.read_text() + "PARAM,G,0.02\n")
    words = [
        "frf",
        str(deck),
        "--force",
        "2+RY",
        "--at",
        "2+Z,2-RY",
        "--fmax",
        "300",
        "--lines",
        "30",
    ]
    assert run([*words, "--out", str(tmp_path / "a.h5")]) == run(
        [*words, "--direct", "--out", str(tmp_path / "b.h5")]
    )
    modal, direct = read_frfs(tmp_path / "a.h5"), read_frfs(tmp_path / "b.h5")
    np.testing.assert_allclose(modal.data, direct.data, rtol=1e-8)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (
            "LOAD = 3",
            "LOAD = 9",
            "ACCEL1 is not supported: of a static load, FORCE, MOMENT, GRAV",
        ),
        ("LOAD = 3", "LOAD = 3\n  SPC = 2", "SUBCASE 8 has other"),
        (
            "FORCE,3,2",
            "FORCE,3,22",
            "SUBCASE 8: FORCE names node 22, which is not in the deck",
        ),
        ("FORCE,3,2,4,100.", "FORCE,3,2,4,x", "'X' is not a real"),
        ("LOAD", "LAOD", "case control has no LOAD"),
    ],
)
def test_loads_that_cannot_be_taken(
    tmp_path: Path, old: str, new: str, told: str, capsys: Capture
) -> None:
    (tmp_path / "d.bdf").write_text(BAR.replace(old, new))
    assert run(["static", str(tmp_path / "d.bdf"), "--at", "2+Z"]) == 2
    assert told in capsys.readouterr().err


def test_displaced_supports_are_of_the_deck(tmp_path: Path, capsys: Capture) -> None:
    deck = tmp_path / "d.bdf"
    deck.write_text(
        BAR.replace("SPC1,1,123456,1", "SPC1,1,12456,1\nSPC,1,1,3,0.5").replace(
            "LOAD = 3", "LOAD = 2"
        )
    )
    assert run(["static", str(deck), "--force", "2+Z", "--at", "1+Z"]) == 2
    assert "displaces a support (D)" in capsys.readouterr().err
    assert run(["static", str(deck), "--at", "1+Z", "--json", "-"]) == 0
    told = capsys.readouterr()
    assert [c["metre"] for c in json.loads(told.out)["cases"]] == [{"1+Z": 0.5}] * 3
    assert "is held" not in told.err


@pytest.mark.parametrize(
    ("words", "status", "told"),
    [
        (
            ("frf", "--force", "5", "--fmax", "5"),
            2,
            "must be a node and a direction, such as 101+Z or 101+RZ",
        ),
        (("frf", "--force", "5+RX", "--fmax", "5"), 0, "warning: 5+RX is held"),
        (
            ("frf", "--force", "5+X", "--fmax", "5", "--fmin", "6"),
            2,
            "0 <= fmin < fmax",
        ),
        (
            ("frf", "--force", "5+X", "--fmax", "5", "--direct", "--damping", "0.1"),
            2,
            "damping is for modes",
        ),
        (
            ("frf", "--force", "5+X", "--fmax", "5", "--damping", "2"),
            2,
            "between 0 and 1",
        ),
        (("frf", "--force", "55+X", "--fmax", "5"), 2, "the deck has no 55+X"),
        (
            ("frf", "--force", "5+X", "--fmax", "5", "--units", "mm-kg-h"),
            2,
            "did you mean",
        ),
        (("frf", "--force", "7+X", "--fmax", "5"), 0, "warning: 7+X is held"),
        (("static", "--at", "5+X", "--units", "mm-kg-h"), 2, "did you mean"),
        (("static",), 2, "name the points"),
        (
            ("static", "--at", "5+X", "--csv", "s.csv"),
            2,
            "--csv: a static test has forces at points",
        ),
        (("static", "--force", "5+X=much"), 2, "the form is"),
        (
            ("static", "--force", "5+X", "--at", "6+X", "--at", "6-X"),
            2,
            "response: DOF 6+X occurs twice",
        ),
        (("static", "--force", "8+X"), 1, "singular"),
    ],
)
def test_what_cannot_be_is_told(
    tmp_path: Path, words: tuple[str, ...], status: int, told: str, capsys: Capture
) -> None:
    deck = written(tmp_path / "d.bdf")
    assert run([words[0], str(deck), *words[1:]]) == status
    assert told in capsys.readouterr().err
