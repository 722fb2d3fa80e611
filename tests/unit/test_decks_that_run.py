"""Decks that Nastran runs: what is unusual in them stops neither the reading nor the solution."""

from __future__ import annotations

import json
import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ringtrue as rt
from ringtrue.checks.deck import check_deck
from ringtrue.cli.main import run
from ringtrue.decks.nastran.reader import read_deck, read_loaded_deck
from ringtrue.errors import DeckError, UnsupportedCard, UnsupportedError

BEAM = """GRID,1,,0.,0.,0.
GRID,2,,{l},0.,0.
GRID,3,,{ll},0.,0.
CBAR,1,1,1,2,0.,1.,0.
CBAR,2,1,2,3,0.,1.,0.
PBAR,1,1,{a},{i},{i},{i}
MAT1,1,{e},,.3,{rho}
"""
METRES = {"l": "1.", "ll": "2.", "a": "1.-4", "i": "1.-8", "e": "2.+11", "rho": "7800."}
MILLIMETRES = {
    "l": "1.+3",
    "ll": "2.+3",
    "a": "1.+2",
    "i": "1.+4",
    "e": "2.+5",
    "rho": "7.8-9",
}


def deck(folder: Path, case: str, bulk: str) -> Path:
    path = folder / "d.bdf"
    path.write_text(f"SOL 103\nCEND\n{case}\nBEGIN BULK\n{bulk}ENDDATA\n")
    return path


def test_a_matrix_on_an_extra_point_leaves_the_modes_alone_and_acts_on_responses(
    tmp_path: Path,
) -> None:
    """A spring 500 and a mass 2 on an extra point, as a spring and mass on a scalar point."""
    held = BEAM.format(**METRES) + "SPC1,1,123456,1\n"
    matrices = (
        "DMIG,KE,0,6,1,0\nDMIG,KE,100,,,100,,500.\n,2,2,-500.\nDMIG,KE,2,2,,2,2,500.\n"
        "DMIG,ME,0,6,1,0\nDMIG,ME,100,,,100,,2.\n"
    )
    springs = "CELAS2,9,500.,2,2,100\nCMASS2,10,2.,100\n"
    plain = rt.solve_modes(read_deck(deck(tmp_path, "SPC=1", held)), count=4)
    extra = deck(tmp_path, "SPC=1\nK2PP=KE\nM2PP=ME", f"{held}EPOINT,100\n{matrices}")
    modes = rt.solve_modes(read_deck(extra), count=4)
    np.testing.assert_allclose(modes.frequencies, plain.frequencies, rtol=1e-12)
    asked = {"forces": "3+Y", "damping": 0.01}
    found = rt.frf(extra, [2.0, 3.0, 12.0], **asked).data
    want = rt.frf(
        deck(tmp_path, "SPC=1", f"{held}SPOINT,100\n{springs}"),
        [2.0, 3.0, 12.0],
        **asked,
    )
    np.testing.assert_allclose(found, want.data, rtol=1e-9)


def test_an_extra_point_of_mass_alone_is_refused_for_responses(tmp_path: Path) -> None:
    mass = "EPOINT,100\nDMIG,ME,0,6,1,0\nDMIG,ME,100,,,100,,2.\n"
    path = deck(tmp_path, "M2PP=ME", BEAM.format(**METRES) + mass)
    with pytest.raises(UnsupportedError, match="EPOINT 100"):
        rt.frf(path, [2.0], forces="3+Y", damping=0.01)


@pytest.mark.parametrize("units", [METRES, MILLIMETRES], ids=["m", "mm"])
@pytest.mark.parametrize(
    "method", ["EIGRL,1,0.,10.", "EIGR,1,LAN,0.,10.", "EIGRL,1,,1."]
)
def test_a_band_that_holds_rigid_body_modes_alone(
    tmp_path: Path, units: dict[str, str], method: str
) -> None:
    path = deck(tmp_path, "METHOD=1", f"{method}\n{BEAM.format(**units)}")
    found = rt.solve_modes(read_deck(path))
    assert found.complete
    assert found.frequencies.size == 5  # a line of bars without torsional inertia
    assert np.abs(found.frequencies).max() < 1e-3


@pytest.mark.parametrize("soft", ["1.-6", "1."])
def test_a_stiff_structure_with_many_soft_springs(tmp_path: Path, soft: str) -> None:
    """60 oscillators on a short free beam: the median of stiffness over mass says nothing of it."""
    stiff = METRES | {"l": ".001", "ll": ".002", "a": "1.-2", "i": "1.-5"}
    many = "".join(
        f"GRID,{i},,0.,0.,0.\nCELAS2,{i},{soft},1,2,{i},2\nCONM2,{i + 100},{i},,1.\n"
        for i in range(300, 360)
    )
    found = rt.solve_modes(
        read_deck(deck(tmp_path, "", BEAM.format(**stiff) + many)), count=60
    )
    own = np.sqrt(float(soft.replace("-", "e-"))) / (2 * np.pi)
    assert found.complete
    assert np.isclose(found.frequencies, own, rtol=1e-6).sum() >= 50


def test_a_blank_size_at_the_end_of_a_line_load_is_nothing(tmp_path: Path) -> None:
    """As MSC Nastran has it: the load falls to 0 at X2."""
    held = BEAM.format(**METRES) + "SPC1,1,123456,1\n"
    path = deck(tmp_path, "SPC=1\nLOAD=1", held + "PLOAD1,1,1,FY,FR,.5,10.,1.\n")
    blank = rt.static(path, responses=["3+Y"]).values
    path = deck(tmp_path, "SPC=1\nLOAD=1", held + "PLOAD1,1,1,FY,FR,.5,10.,1.,0.\n")
    np.testing.assert_allclose(
        blank, rt.static(path, responses=["3+Y"]).values, rtol=1e-12
    )
    assert abs(blank).max() > 0


def test_a_load_set_that_is_not_there_leaves_the_other_subcases(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    case = "SPC=1\nSUBCASE 1\nLOAD=1\nSUBCASE 2\nLOAD=7\nSUBCASE 3\nLOAD=3"
    held = BEAM.format(**METRES) + "SPC1,1,123456,1\n"
    path = deck(tmp_path, case, held + "FORCE,1,3,,1.,0.,1.\nFORCE,3,3,,2.,0.,1.\n")
    with caplog.at_level(logging.WARNING):
        found = rt.static(path, responses=["3+Y"])
    assert found.cases == ("SUBCASE 1", "SUBCASE 3")
    assert found.values[1] == pytest.approx(2 * found.values[0])
    assert "SUBCASE 2 is left out" in caplog.text
    with pytest.raises(DeckError, match="load set 1 is not in the deck"):
        read_loaded_deck(deck(tmp_path, case, held))


def test_warping_points_of_a_section_without_warping_stiffness(tmp_path: Path) -> None:
    """SA and SB do nothing where CW is 0; where it is not the beam is refused."""
    text = (
        "SPOINT,11,12\nGRID,1,,0.,0.,0.,,123456\nGRID,2,,1.,0.,0.\nMAT1,1,2.+11,,.3,7800.\n"
        "CBEAM,1,1,1,2,0.,1.,0.\n,,,,,,,,\n,{points}\nPBEAM,1,1,1.-4,1.-8,2.-8,,1.-8\n"
        ",NO,1.\n,,,,,,,{cw}\n"
    )
    plain = rt.solve_modes(read_deck(deck(tmp_path, "", text.format(points="", cw=""))))
    path = deck(tmp_path, "", text.format(points="11,12", cw=""))
    found = rt.solve_modes(read_deck(path))
    np.testing.assert_allclose(found.frequencies, plain.frequencies, rtol=1e-12)
    path = deck(tmp_path, "", text.format(points="11,12", cw="1.-12"))
    model = read_deck(path)
    assert model["PBEAM"]["CWA"].tolist() == [1e-12]
    with pytest.raises(UnsupportedCard, match="resists warping"):
        rt.solve_modes(model)


@pytest.mark.parametrize("ratio", ["2.+11,,.7", "2.+11,1.+9"])
def test_poissons_ratio_that_nothing_takes_is_no_error(
    tmp_path: Path, ratio: str
) -> None:
    """Of a material that nothing is of, and of bars, which take E and G as they are given."""
    bulk = BEAM.format(**METRES).replace("2.+11,,.3", ratio)
    told = [
        f
        for f in check_deck(read_deck(deck(tmp_path, "", bulk))).findings
        if "Poiss" in f.text
    ]
    assert [f.severity for f in told] == ["warning"]
    used = bulk + "GRID,4,,0.,1.,0.\nCTRIA3,9,9,1,2,4\nPSHELL,9,1,.01,1\n"
    told = [
        f
        for f in check_deck(read_deck(deck(tmp_path, "", used))).findings
        if "Poiss" in f.text
    ]
    assert [f.severity for f in told] == ["error"]


def failing_check(path: Path) -> dict[str, Any]:
    """What `check` writes of a deck that does not pass it."""
    target = path.with_name("check.json")
    assert run(["check", str(path), "--json", str(target)]) == 1
    found: dict[str, Any] = json.loads(target.read_text())
    return found


def test_check_shows_what_is_read_beside_cards_that_are_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The mass of the bars, a finding, and a line for each card that is not read."""
    unread = (
        "CBUSH2D,77,1,1,2\nCQUADX,78,2,1,2,3,1\nRSSCON,79,GRID,1,2,3\nCBAR,80,80,1,2,0.,1.,0.\n"
        "PBMSECT,80,1,OP\nRFORCE,3,1\nMAT1,9,2.+11,,.7,7800.\n"
    )
    path = deck(tmp_path, "", BEAM.format(**METRES) + unread)
    found = failing_check(path)
    assert found["mass"] == pytest.approx(2 * 1e-4 * 7800)
    assert found["centre_of_gravity"] == pytest.approx([1, 0, 0])
    assert found["missing"] == {
        "CBUSH2D": ["stiffness"],
        "CQUADX": ["mass", "stiffness"],
        "RSSCON": ["constraints"],
        "PBMSECT": ["mass", "stiffness"],
    }
    text = capsys.readouterr().out
    assert "mass of what is read 1.56" in text
    assert "Poisson's ratio 0.7" in text
    assert "RFORCE: loads that are not read: ringtrue static" in text
    lines = [
        line for line in text.splitlines() if line.startswith("unsupported CBUSH2D")
    ]
    assert len(lines) == 1
    assert lines[0].endswith("missing without it: stiffness")


def test_check_goes_on_where_assembly_refuses_a_card(tmp_path: Path) -> None:
    """A beam with warping stiffness is left out of the mass, and named."""
    beam = (
        "CBEAM,5,5,2,3,0.,1.,0.\n,,,,,,,,\n,11,12\nPBEAM,5,1,1.-4,1.-8,2.-8,,1.-8\n,NO,1.\n"
        ",,,,,,,1.-12\nSPOINT,11,12\n"
    )
    path = deck(tmp_path, "", BEAM.format(**METRES) + beam)
    found = failing_check(path)
    assert found["mass"] == pytest.approx(2 * 1e-4 * 7800)
    assert "resists warping" in found["unsupported"]["CBEAM"]


def test_a_free_point_that_is_displaced_is_held_in_its_own_subcase(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A cantilever of length 2 whose tip is moved by 1 mm bends by x²(3L - x)/2L³ of it."""
    held = BEAM.format(**METRES) + "SPC1,1,123456,1\n"
    case = "SPC=1\nSUBCASE 1\nLOAD=1\nSUBCASE 2\nLOAD=2"
    path = deck(tmp_path, case, held + "SPCD,1,3,2,.001\nFORCE,2,3,,6.,0.,1.\n")
    found = rt.static(path, responses=["2+Y", "3+Y"])
    np.testing.assert_allclose(found.values[0], [0.001 * 5 / 16, 0.001], rtol=1e-9)
    np.testing.assert_allclose(
        found.values[1, 1], 6 * 2**3 / (3 * 2e11 * 1e-8), rtol=1e-9
    )
    assert found.held == ()
    assert "node 3 component 2, which no SPC holds" in caplog.text
