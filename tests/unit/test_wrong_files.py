"""Files of the wrong kind: a command says what they hold, and which command takes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from record_files import write_history
from test_bad_signals import made, wrap
from test_cli import Capture, call, frf, refused

from ringtrue.io.frfs import read_frfs, write_frfs

__all__ = ("frf",)  # a fixture

CORPUS = Path(__file__).parents[1] / "corpus"
UFF = Path(__file__).parents[2].parent / "shared/data/uff"
EMA = "`ringtrue ema` takes FRFs"


@pytest.mark.parametrize("ending", ["h5", "csv", "npz"])
def test_frfs_given_as_a_record(
    ending: str, frf, tmp_path: Path, capsys: Capture
) -> None:
    path = frf()
    if ending != "npz":
        path = tmp_path / f"frf.{ending}"
        write_frfs(path, read_frfs(frf()))
    assert EMA in refused(capsys, "oma", path, "--rate", 64)


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        (
            "beam.csv",
            "SOL 103\nCEND\n",
            "no record: a deck; `ringtrue check` takes decks",
        ),
        (
            "beam.txt",
            "1  M Y S T R A N\n   R E A L   E I G E N V A L U E S\n",
            "`ringtrue convert`",
        ),
        ("modes.csv", '{"modes": []}\n', "`ringtrue correlate` takes modes"),
        ("study.txt", '[study]\ntitle = "x"\n', "`ringtrue run` takes studies"),
    ],
)
@pytest.mark.parametrize("command", ["oma", "ema"])
def test_other_files_given_as_a_record(
    command: str, name: str, text: str, told: str, tmp_path: Path, capsys: Capture
) -> None:
    (tmp_path / name).write_text(text)
    assert told in refused(capsys, command, tmp_path / name)


def test_a_record_without_a_force_goes_to_oma(tmp_path: Path, capsys: Capture) -> None:
    write_history(tmp_path / "r.csv", wrap(made()[:, :4000]))
    assert "`ringtrue oma` takes records without a force" in refused(
        capsys, "ema", tmp_path / "r.csv"
    )


@pytest.mark.skipif(not UFF.is_dir(), reason=f"needs {UFF}")
@pytest.mark.parametrize(
    ("command", "name", "told"),
    [
        (
            "oma",
            "beam.uff",
            "no time records; it holds 3 FRFs; `ringtrue oma` takes records, `ringtrue ema`",
        ),
        (
            "oma",
            "uff55_translation.uff",
            "it holds mode shapes or other data at nodes (55); `ringtrue oma` takes records",
        ),
        (
            "ema",
            "mesh_test_uff2412_mixed.uff",
            "nodes (15), coordinate systems (18), elements (2412)",
        ),
        ("oma", "1858.uff", "it holds attributes of functions (1858)"),
    ],
)
def test_universal_files_say_what_they_hold(
    command: str, name: str, told: str, capsys: Capture
) -> None:
    assert told in refused(capsys, command, UFF / name)


@pytest.mark.parametrize(
    "name", ["frf_units_in_brackets.csv", "frf_units_with_brackets_inside.txt"]
)
def test_frfs_with_a_line_of_units_below_the_titles(name: str, capsys: Capture) -> None:
    """Text exports of analysers, the units in the last line above the numbers; they were read as
    time records.
    """
    frfs = read_frfs(CORPUS / name)
    assert (frfs.kind, frfs.data.shape) == ("accelerance", (40, 1, 1))
    assert frfs.freqs[0] == 0.5
    assert EMA in refused(capsys, "oma", CORPUS / name)


def test_units_of_frfs_that_are_none_are_refused(tmp_path: Path) -> None:
    lines = "\n".join(f"{0.5 * k},{k},{-k}" for k in range(1, 40))
    (tmp_path / "f.csv").write_text(f"Frequency,Real,Imaginary\nHz,EU,EU\n{lines}\n")
    with pytest.raises(ValueError, match="unit 'EU': an FRF is a motion over a force"):
        read_frfs(tmp_path / "f.csv")


def test_files_of_moved_sensors_are_not_one_record(
    tmp_path: Path, capsys: Capture
) -> None:
    """Two of six sensors stay; with all in place the two halves are one record."""
    y, half = made(), made().shape[1] // 2
    other = np.linalg.qr(np.random.default_rng(8).standard_normal((6, 6)))[0] @ y
    other[:2] = y[:2]
    for name, data in (
        ("a", y[:, :half]),
        ("b", y[:, half:]),
        ("moved", other[:, half:]),
    ):
        write_history(tmp_path / f"{name}.h5", wrap(data))
    status, _, _ = call(
        capsys, "oma", tmp_path / "a.h5", tmp_path / "b.h5", "--fmin", 1
    )
    assert status == 0
    told = refused(capsys, "oma", tmp_path / "a.h5", tmp_path / "moved.h5", "--fmin", 1)
    assert "`ringtrue oma --setups table.csv`" in told


def test_a_force_that_is_cut_off_is_said_to_be(tmp_path: Path, capsys: Capture) -> None:
    """An amplifier in overload: the force stands at one end of its range or at the other in nearly
    all samples.
    """
    rng = np.random.default_rng(0)
    force = np.clip(400 * rng.standard_normal(14_000), -5, 5)
    response = 0.1 * rng.standard_normal(force.size)
    rows = np.column_stack([np.arange(force.size) / 1000.0, force, response])
    path = tmp_path / "r.csv"
    np.savetxt(
        path,
        rows,
        delimiter=",",
        header="time,1+Z [N],2+Z [m/s^2]",
        comments="",
        fmt="%.9g",
    )
    told = refused(capsys, "ema", path, "--struck", "1+Z")
    assert "1+Z: clipped at 5 N in 13,8" in told
    assert "of 14,000 samples" in told
