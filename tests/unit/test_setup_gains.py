"""Two driving points and others in four setups; one channel has another gain or sign in one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import ringtrue as rt
from ringtrue.core.channels import channel
from ringtrue.core.signals import FrfSet
from ringtrue.io.frfs import write_frfs
from ringtrue.signal.frf_sets import join_frfs, setup_gains, without_gains

FREQS = np.linspace(5.0, 40.0, 200)
REFERENCES = ("1+Z", "2+Z", "3+X")


def setups(count: int = 4, gain: float = 1.0, seed: int = 0) -> list[FrfSet]:
    """FRFs with calibrations to 1 %, noise of 1 %, and 1+Z times `gain` in the last setup."""
    rng = np.random.default_rng(seed)
    pole = 2 * np.pi * np.array([9.0, 17.0, 28.0]) * (-0.01 + 1j)
    shapes = rng.normal(size=(3 + 2 * count, 3))
    s = 2j * np.pi * FREQS[:, None]
    modes = 1 / (s - pole) - 1 / (s - pole.conj())
    whole = np.einsum("om,im,fm->foi", shapes, shapes[:3], 1j * modes)
    out = []
    for k in range(count):
        rows = [0, 1, 2, 3 + 2 * k, 4 + 2 * k]
        factor = rng.uniform(0.99, 1.01, 5)
        factor[0] *= gain if k == count - 1 else 1.0
        noise = rng.normal(size=(2, FREQS.size, 5, 3))
        data = whole[:, rows] * factor[:, None]
        data = data + 0.01 * np.abs(data).mean(axis=0) * (noise[0] + 1j * noise[1])
        names = [*REFERENCES, f"{10 + k}+Z", f"{20 + k}+Z"]
        outputs = tuple(channel(n, "acceleration") for n in names)
        inputs = tuple(channel(n, "force") for n in REFERENCES)
        out.append(FrfSet(data, FREQS, outputs, inputs))
    return out


@pytest.mark.parametrize("gain", [0.5, 2.0, -1.0, 1.25])
def test_the_channel_and_the_setup_are_named_with_the_factor(gain: float) -> None:
    measured = setups(gain=gain)
    (found,) = setup_gains(measured)
    assert (found.channel, found.setup, found.others) == ("1+Z", 3, 3)
    assert found.factor == pytest.approx(gain, rel=0.03)  # calibrations of two setups
    right = join_frfs(setups())
    undone = join_frfs([without_gains(s, (found,), measured) for s in measured])
    np.testing.assert_allclose(
        undone.data[:, 0], right.data[:, 0], rtol=0.02, atol=0.02
    )


def test_files_of_setups_are_joined_without_the_gain_and_it_is_said(
    tmp_path: Path,
) -> None:
    files = [tmp_path / f"setup{k}.h5" for k in range(4)]
    for file, frfs in zip(files, setups(gain=2.0), strict=True):
        write_frfs(file, frfs)
    found = rt.estimate_frfs(files)
    (said,) = found.notes
    assert "channel 1+Z: reads 2" in said
    assert "in setup 4 " in said
    right = join_frfs(setups())
    np.testing.assert_allclose(
        found.frfs.data[:, 0], right.data[:, 0], rtol=0.02, atol=0.02
    )
    assert rt.estimate_frfs(files[:2]).notes == ()


def test_nothing_is_named_where_all_agree_or_two_setups_differ() -> None:
    assert [setup_gains(setups(seed=k)) for k in range(20)] == [()] * 20
    assert setup_gains(setups(count=2, gain=2.0)) == ()
    other = setups()
    other[1] = replace(other[1], data=np.roll(other[1].data, 60, axis=0))
    assert [g.setup for g in setup_gains(other)] == []  # another structure is no gain
