"""The other methods of `oma`, on the systems of the method tests, from the command line to the truth."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import test_oma_methods as ambient
from record_files import write_history

from ringtrue.cli.main import run
from ringtrue.errors import ConfigError
from ringtrue.identification.methods import AMBIENT_METHODS, identify_ambient_by


@pytest.mark.parametrize("method", AMBIENT_METHODS)
def test_ambient_methods_find_the_modes(method: str) -> None:
    """Four modes; peaks alone do not separate the pair at 5.0 and 5.12 Hz."""
    which = [0, 3] if method == "fdd" else [0, 1, 2, 3]
    for seed in range(2):
        found = identify_ambient_by(method, ambient.record(seed))
        at = ambient.near(found.modes, ambient.F[which], ambient.PHI[:, which])
        ambient.within(found.modes.frequencies[at], found.modes.damping[at], which, 8.0)
        stated = np.isfinite(found.uncertainty.frequency).all()
        assert stated == (method in ("ssi-data", "fdd"))
        assert stated != any("no standard deviations:" in n for n in found.notes)
        assert len(found.reasons) == len(found.modes) == len(which)
    with pytest.raises(ConfigError, match="did you mean 'fdd'"):
        identify_ambient_by("fd", ambient.record(0))


@pytest.mark.parametrize("method", ["plscf", "era"])
def test_noise_has_no_modes(method: str) -> None:
    """Poles of noise are stable over the orders: the halves of the record tell."""
    for seed in range(3):
        noise = np.random.default_rng(seed).standard_normal((2 + 2 * seed, 30_000))
        assert not len(identify_ambient_by(method, ambient.wrap(noise)).modes)


def test_refined_half_spectra_are_unbiased_in_damping() -> None:
    """The mean error of eight records is within 3.5 of its deviation, were each at twice the
    floor.
    """
    error = []
    for seed in range(8):
        modes = identify_ambient_by("plscf", ambient.record(seed)).modes
        error.append(modes.damping[ambient.near(modes)] / ambient.Z - 1)
    assert (
        np.abs(np.mean(error, axis=0)) < 3.5 * 2 * ambient.FLOOR_Z / np.sqrt(len(error))
    ).all()


@pytest.mark.parametrize("method", ["plscf", "era", "ssi-data"])
def test_bands_too_short_for_a_method_are_left_out_and_said(method: str) -> None:
    """Of two minutes the lowest band has samples enough for SSI-cov alone."""
    found = identify_ambient_by(
        method, ambient.wrap(ambient.record(0).data[:, : int(120 * ambient.RATE)])
    )
    assert np.abs(found.modes.frequencies / ambient.F[1] - 1).min() < 0.01
    assert any("too short for" in n for n in found.notes)


def test_methods_from_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_history(tmp_path / "r.h5", ambient.record(0))
    words = [
        "oma",
        str(tmp_path / "r.h5"),
        "--method",
        "fdd",
        "--fmin",
        "8",
        "--fmax",
        "10",
    ]
    assert run([*words, "--json", "-"]) == 0
    (mode,) = json.loads(capsys.readouterr().out)["modes"]
    assert abs(mode["frequency_hz"] - 9.0) < 5 * mode["std_frequency_hz"]
    for wrong in (
        ["oma", str(tmp_path / "r.h5"), "--method", "bayes"],
        [
            "oma",
            str(tmp_path / "r.h5"),
            "--method",
            "era",
            "--diagram",
            str(tmp_path / "d.html"),
        ],
        ["oma", str(tmp_path / "r.h5"), "--near", "5"],
    ):
        assert run(wrong) == 2
