"""The other methods of `oma` and `ema`, on the systems of the method tests, from the command line
to the truth.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import test_ema_methods as hammer
import test_oma_methods as ambient

from ringtrue.cli.main import run
from ringtrue.core.signals import Channel, FrfSet
from ringtrue.errors import ConfigError, DataError
from ringtrue.identification.frf.pipeline import HammerModes
from ringtrue.identification.methods import AMBIENT_METHODS, identify_ambient_by, identify_frfs_by
from ringtrue.io.frfs import write_frfs
from ringtrue.io.records import write_history

PEAKS = ("fdd", "efdd", "fsdd", "random-decrement")


@pytest.mark.parametrize("method", AMBIENT_METHODS)
def test_ambient_methods_find_the_modes(method: str) -> None:
    """Four modes; peaks alone do not separate the pair at 5.0 and 5.12 Hz."""
    which = [0, 3] if method in PEAKS else [0, 1, 2, 3]
    for seed in range(2):
        found = identify_ambient_by(method, ambient.record(seed))
        at = ambient.near(found.modes, ambient.F[which], ambient.PHI[:, which])
        ambient.within(found.modes.frequencies[at], found.modes.damping[at], which, 8.0)
        stated = np.isfinite(found.uncertainty.frequency).all()
        assert stated == (method in ("ssi-data", "fdd", "fsdd"))
        assert stated != any("no standard deviations:" in n for n in found.notes)
        assert len(found.reasons) == len(found.modes) == len(which)
    with pytest.raises(ConfigError, match="did you mean 'efdd'"):
        identify_ambient_by("effd", ambient.record(0))


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
    assert (np.abs(np.mean(error, axis=0)) < 3.5 * 2 * ambient.FLOOR_Z / np.sqrt(len(error))).all()


@pytest.mark.parametrize("method", ["plscf", "era", "ssi-data"])
def test_bands_too_short_for_a_method_are_left_out_and_said(method: str) -> None:
    """Of two minutes the lowest band has samples enough for SSI-cov alone."""
    found = identify_ambient_by(
        method, ambient.wrap(ambient.record(0).data[:, : int(120 * ambient.RATE)])
    )
    assert np.abs(found.modes.frequencies / ambient.F[1] - 1).min() < 0.01
    assert any("too short for" in n for n in found.notes)


@pytest.mark.parametrize("method", ["cmif"])
def test_frf_methods_find_the_modes(method: str) -> None:
    m, k, c = hammer.chain()
    system = (m, k, c / 4)  # the peaks of the CMIF lie apart
    s = hammer.poles(*system)[0]
    data = hammer.frfs(system, np.random.default_rng(1), level=1e-3)
    found = identify_frfs_by(method, data, HammerModes(3.0, 35.0))
    assert len(found.modes) == s.size
    np.testing.assert_allclose(found.modes.frequencies, np.abs(s) / (2 * np.pi), rtol=2e-3)
    np.testing.assert_allclose(found.modes.damping, -s.real / np.abs(s), rtol=0.1)
    assert found.modes.norm == "mass"
    assert np.isnan(found.uncertainty.frequency).all()
    assert "no standard deviations" in found.notes[0]


@pytest.mark.parametrize("method", ["cmif"])
def test_frfs_of_noise_have_no_modes(method: str) -> None:
    for seed in range(4):
        rng, count = np.random.default_rng(seed), 1 + 3 * (seed % 2)
        h = rng.standard_normal((800, count, 1)) + 1j * rng.standard_normal((800, count, 1))
        outputs = tuple(Channel(f"{k + 1}+Z", "acceleration", "m/s^2") for k in range(count))
        noise = FrfSet(h, 0.5 * np.arange(1, 801), outputs, (Channel("1+Z", "force", "N"),))
        with pytest.raises(DataError, match="the FRFs are noise"):
            identify_frfs_by(method, noise)


def test_methods_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_history(tmp_path / "r.h5", ambient.record(0))
    write_frfs(tmp_path / "h.h5", hammer.frfs(hammer.chain(), np.random.default_rng(1)))
    words = ["oma", str(tmp_path / "r.h5"), "--method", "fdd", "--fmin", "8", "--fmax", "10"]
    assert run([*words, "--json", "-"]) == 0
    (mode,) = json.loads(capsys.readouterr().out)["modes"]
    assert abs(mode["frequency_hz"] - 9.0) < 5 * mode["std_frequency_hz"]
    assert (
        run(["ema", str(tmp_path / "h.h5"), "--method", "cmif", "--fmin", "3", "--fmax", "35"]) == 0
    )
    out = capsys.readouterr().out
    assert "6 modes" in out
    assert "no standard deviations: CMIF" in out
    for wrong in (
        ["oma", str(tmp_path / "r.h5"), "--method", "bayes"],
        ["oma", str(tmp_path / "r.h5"), "--method", "era", "--diagram", str(tmp_path / "d.html")],
        ["oma", str(tmp_path / "r.h5"), "--near", "5"],
    ):
        assert run(wrong) == 2
