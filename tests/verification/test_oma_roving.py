"""Several setups of one structure identified together, and what tells them from one record."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import test_oma_setups as made

import ringtrue as rt
from ringtrue.api.measurements import TestModes
from ringtrue.cli.main import run
from ringtrue.core.arrays import Complex, Float
from ringtrue.core.choice import Choice, Pick, Reject
from ringtrue.core.modes import ModeSet, Uncertainty
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import DataError
from ringtrue.identification.ambient.pipeline import identify_stretches
from ringtrue.identification.ambient.setups import SetupsResult
from ringtrue.identification.ambient.shape_reading import with_joined_shapes
from ringtrue.identification.common.manual_selection import chosen_of_setups
from ringtrue.identification.common.merging import merge_modes
from ringtrue.io.campaign_tables import read_setup_table
from ringtrue.io.choices import read_choice, write_choice
from ringtrue.io.uff.datasets import scan
from ringtrue.io.uff.points import read_mode_sets
from ringtrue.shapes import mac

SHARED = Path(__file__).parents[3] / "shared" / "data" / "oma" / "l_building"
Capture = pytest.CaptureFixture[str]


def like_truth(test: TestModes) -> Float:
    """MAC of the shapes with the true ones, all channels."""
    phi = made.PHI[[int(c) for c in test.channels]].astype(complex)
    return np.diag(mac(phi, test.shapes))


@pytest.mark.parametrize(("merge", "least"), [("poser", 0.997), ("preger", 0.99)])
def test_setups_become_one_set_of_modes(merge: str, least: float) -> None:
    test = rt.identify_ambient_setups(made.recorded(1), merge=merge)  # type: ignore[arg-type]
    assert np.abs(test.frequencies / made.F - 1).max() < 0.004
    assert test.channels == tuple(map(str, range(11)))
    assert like_truth(test).min() > least
    assert isinstance(test.result, SetupsResult)
    assert np.nanstd(test.result.frequency, axis=0).max() < 0.02
    assert len(test.others) == 0


class Reader:
    """A record that shows the true shapes at three times their size."""

    def __init__(self, channels: tuple[str, ...], phi: Float = made.PHI) -> None:
        self.channels = channels
        self.phi = 3.0 * phi[[int(c) for c in channels]].astype(complex)

    def shapes(self, frequency: Float, damping: Float) -> tuple[Complex, Float]:
        return self.phi.copy(), np.full(self.phi.shape, 0.02)


def exact(at: list[int], name: str) -> tuple[ModeSet, Uncertainty, str]:
    shape = made.PHI[at] / np.abs(made.PHI[at]).max(axis=0)
    modes = ModeSet(made.F, made.Z, shape.astype(complex), tuple(map(str, at)))
    return (
        modes,
        Uncertainty.independent(1e-3 * made.F, 0.1 * made.Z, 0.01 + 0 * shape),
        name,
    )


def test_what_a_setup_did_not_find_is_read_there() -> None:
    records = [exact(at, f"s{k}") for k, at in enumerate(made.PLACES)]
    modes, std, name = records[1]
    records[1] = modes.take([0, 2, 3]), std.take([0, 2, 3]), name
    merged = merge_modes(records)
    assert np.isnan(merged.modes.shapes[:, 1]).sum() == 3
    readers = [Reader(m.channels) for m, _, _ in records]
    joined = with_joined_shapes(merged, records, readers, np.arange(4)).modes
    phi = made.PHI[[int(c) for c in joined.channels]].astype(complex)
    assert np.diag(mac(phi, joined.shapes)).min() > 1 - 1e-6


def test_shares_of_close_modes_are_taken_out_by_the_references() -> None:
    rng = np.random.default_rng(2)
    f = np.array([1.0, 1.015])
    phi = rng.standard_normal((20, 2)).astype(complex)
    records = []
    for k in range(8):
        at = [0, 1, *range(2 + 2 * k, 4 + 2 * k)]
        turn = np.eye(2) + 0.25 * np.array([[0, rng.normal()], [rng.normal(), 0]])
        shape = phi[at] @ turn
        shape /= np.abs(shape).max(axis=0)
        modes = ModeSet(f, np.full(2, 0.01), shape, tuple(map(str, at)))
        std = Uncertainty.independent(1e-3 * f, np.full(2, 1e-3), np.full((4, 2), 0.01))
        records.append((modes, std, f"s{k}"))
    merged = merge_modes(records)

    def worst(of: ModeSet) -> float:
        rows = [int(c) for c in of.channels]
        return float(1 - np.diag(mac(phi[rows], of.shapes)).min())

    readers = [Reader(m.channels, phi.real) for m, _, _ in records]
    joined = with_joined_shapes(merged, records, readers, np.arange(2))
    assert worst(joined.modes) < 0.3 * worst(merged.modes)


def of_one_name(records: list[TimeHistory]) -> list[TimeHistory]:
    """As files without names: the channels of the first."""
    return [replace(x, channels=records[0].channels) for x in records]


def test_files_of_moved_sensors_are_no_record() -> None:
    for seed in range(3):
        with pytest.raises(DataError, match=r"--setups table.csv.*\n?.*,1,101,\+Z,yes"):
            identify_stretches(of_one_name(made.recorded(seed)))


def test_files_of_one_installation_are_one_record() -> None:
    for seed in range(3):
        same = [made.recorded(10 * seed + k)[0] for k in range(3)]
        quiet = [
            replace(x, data=x.data * level)
            for x, level in zip(same, (1, 0.2, 4), strict=True)
        ]
        assert len(identify_stretches(quiet).modes) >= 3


def table_of(folder: Path) -> Path:
    """Three files of setups with their wiring table; one sensor of the third is upside down."""
    rows = ["File;Ch;Node;Dir;Ref"]
    for k, (x, at) in enumerate(zip(made.recorded(1), made.PLACES, strict=True)):
        data = x.data.copy()
        data[-1] *= -1 if k == 2 else 1
        np.save(folder / f"s{k}.npy", data.T)
        for i, c in enumerate(at):
            way = "-Z" if k == 2 and i == len(at) - 1 else "Z"
            rows.append(f"s{k}.npy;{i + 1};{c + 1};{way};{'x' if c < 2 else ''}")
    path = folder / "setups.csv"
    path.write_text("\n".join(rows))
    return path


def test_a_wiring_table_is_one_test(tmp_path: Path, capsys: Capture) -> None:
    table = table_of(tmp_path)
    points = "\n".join(f"{k + 1},{k},0,0,Z" for k in range(11))
    (tmp_path / "sensors.csv").write_text(f"point,x,y,z,direction\n{points}\n")
    to = tmp_path / "modes.json"
    words = ["--setups", table, "--rate", made.RATE, "--json", to]
    assert run(["oma", *map(str, words)]) == 0
    assert "3/3 setups" in capsys.readouterr().out
    test = rt.read_modes(to)
    phi = made.PHI[[int(c.split("+")[0]) - 1 for c in test.channels]].astype(complex)
    assert np.diag(mac(phi, test.shapes)).min() > 0.997
    assert '"setups"' in to.read_text()
    uff = tmp_path / "modes.uff"
    sheet = tmp_path / "sensors.csv"
    assert run(["convert", str(to), str(uff), "--sensors", str(sheet)]) == 0
    assert len(read_mode_sets(uff)) == 4
    assert {block.kind for block in scan(uff)} == {15, 55, 164}


def test_a_choice_is_of_the_modes_of_all_setups(tmp_path: Path) -> None:
    table = table_of(tmp_path)
    to = tmp_path / "choice.toml"
    words = ["--setups", table, "--rate", made.RATE, "--write-choice", to]
    assert run(["oma", *map(str, words)]) == 0
    choice = read_choice(to)
    assert choice.records == ("setups",)
    assert len(choice.picks) == 4
    three = replace(choice, picks=choice.picks[:2], rejects=(), automatic=False)
    json = tmp_path / "modes.json"
    write_choice(to, three)
    words = ["--setups", table, "--rate", made.RATE, "--choice", to, "--json", json]
    assert run(["oma", *map(str, words)]) == 0
    assert rt.read_modes(json).frequencies == pytest.approx(made.F[:2], rel=0.01)


@pytest.mark.parametrize("merge", ["poser", "preger"])
def test_the_diagram_has_the_poles_of_all_setups(merge: str, tmp_path: Path) -> None:
    page = tmp_path / "d.html"
    words = ["--setups", table_of(tmp_path), "--rate", made.RATE, "--merge", merge]
    assert run(["oma", *map(str, words), "--diagram", str(page)]) == 0
    assert "singular values" in page.read_text(encoding="utf-8")
    found = rt.identify_ambient_setups(
        tmp_path / "setups.csv", rate=made.RATE, merge=merge
    )
    poles = np.concatenate([d.poles.frequencies for d in found.diagram.diagrams])
    near = np.abs(poles[:, None] / made.F - 1) < 0.01
    assert (near.sum(axis=0) >= 4 * (3 if merge == "poser" else 1)).all()
    freqs, level = found.diagram.singular_value(0)
    assert np.isfinite(level).all()
    assert (np.diff(freqs) > 0).all()


def test_a_pick_takes_up_what_the_setups_doubt() -> None:
    f = np.array([1.1, 1.9, 2.3])
    natural = np.array([True, False, True])
    choice = Choice(
        (Pick(1.9, 40),), rejects=(Reject(2.3, "crane"),), source="choice.toml"
    )
    keep, said, notes = chosen_of_setups(f, 1e-3 * f, natural, choice)
    assert keep.tolist() == [True, True, False]
    assert said == ["", "taken up by hand", ""]
    assert notes == ["mode at 2.3 Hz rejected by hand: crane"]
    with pytest.raises(DataError, match=r"choice\.toml: pick at 3 Hz: no candidate"):
        chosen_of_setups(
            f, 1e-3 * f, natural, Choice((Pick(3.0),), source="choice.toml")
        )


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("s0.npy;3;1;Q;", "direction 'Q'"),
        ("s0.npy;3;a;Z;", "point 'a'"),
        ("s0.npy;3;1;Z;maybe", "reference 'maybe'"),
        ("s0.npy;1;99;Z;", "channel 1 "),
        (";3;1;Z;", "no file"),
    ],
)
def test_a_wrong_row_is_named(row: str, words: str, tmp_path: Path) -> None:
    table = table_of(tmp_path)
    table.write_text(table.read_text() + "\n" + row)
    with pytest.raises(DataError, match=words):
        read_setup_table(table)


def test_a_channel_that_a_file_lacks_is_named(tmp_path: Path) -> None:
    table = table_of(tmp_path)
    table.write_text(table.read_text() + "\ns0.npy;77;99;Z;")
    with pytest.raises(DataError, match="no channel '77'"):
        rt.identify_ambient_setups(table, rate=made.RATE)


def test_setups_without_a_common_channel_have_no_scale() -> None:
    a, b, _ = made.recorded(1)
    apart = [a, b.pick([c.id for c in b.channels[2:]])]
    with pytest.raises(DataError, match="at least one reference"):
        rt.identify_ambient_setups(apart)


@pytest.mark.skipif(not SHARED.is_dir(), reason="needs ../shared/data/oma/l_building")
def test_the_building_has_its_nine_modes() -> None:
    records = []
    for k in (1, 2, 3):
        y = np.load(SHARED / f"set{k}.npy").T
        names = [f"{c}+X" if c < 3 else f"{10 * k + c}+X" for c in range(10)]
        channels = tuple(rt.Channel(n, "acceleration", "m/s^2") for n in names)
        records.append(TimeHistory(y, 100.0, channels, f"set{k}"))
    test = rt.identify_ambient_setups(records)
    exact_hz = [
        2.63186,
        2.69173,
        3.43042,
        8.29742,
        8.42882,
        10.6272,
        14.0053,
        14.0930,
        17.5741,
    ]
    assert test.frequencies == pytest.approx(exact_hz, rel=0.01)
    assert np.isfinite(test.shapes).all()
