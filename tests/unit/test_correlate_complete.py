"""All measures of two sets at once, FRFs side by side, and the command."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ringtrue.cli.main import run
from ringtrue.core.modes import ModeSet, Norm, Uncertainty
from ringtrue.core.signals import Channel, FrfSet
from ringtrue.correlation.frf import (
    InputSummary,
    amplitude_correlation,
    band_levels,
    compare_frfs,
    shape_correlation,
)
from ringtrue.correlation.measures import complete, complete_json
from ringtrue.correlation.orthogonality import Gate, OrthogonalityTest
from ringtrue.correlation.paired_shapes import turning
from ringtrue.correlation.pairing import pair_modes
from ringtrue.errors import InputError
from ringtrue.io.modes import read_std, write_modes
from ringtrue.shapes import pseudo_inverse, read_orthogonality

CHANNELS = tuple(f"{i}+Z" for i in range(1, 41))


def model() -> ModeSet:
    """A string of 40 unit masses: shapes orthonormal over the unit mass; modes 3 and 4 are
    close.
    """
    i, k = np.arange(1, 41), np.arange(1, 7)
    phi = np.sin(np.pi * np.outer(i, k) / 41) * np.sqrt(2 / 41)
    return ModeSet(
        np.array([10.0, 20, 30, 30.2, 50, 60]), np.zeros(6), phi, CHANNELS, Norm.MASS
    )


def measured(b: ModeSet) -> ModeSet:
    """Modes 3 and 4 turned into each other, channel 5 reversed, the sixth mode a mixture with the
    second.
    """
    c, s = np.cos(0.8), np.sin(0.8)
    phi = b.shapes.copy()
    phi[:, 2:4] = phi[:, 2:4] @ np.array([[c, -s], [s, c]])
    phi[:, 5] += 0.3 * phi[:, 1]
    phi += 0.002 * np.random.default_rng(0).standard_normal(phi.shape)
    phi[4] *= -1
    return ModeSet(
        b.frequencies * [1, 1, 1, 1, 1, 1.05], np.full(6, 0.01), phi * 7, CHANNELS
    )


def test_each_measure_sees_its_own() -> None:
    b = model()
    a = measured(b)
    p = pair_modes(a, b)
    assert p.a.tolist() == p.b.tolist() == list(range(6))
    c = complete(a, b, p, std=(0.01 * a.frequencies, np.nan))
    assert [(s.channel, s.fault) for s in c.suspects] == [("5+Z", "reversed")]
    assert c.channels[c.by_channel.elimination.order[0]] == "5+Z"
    assert int(np.argmax(c.by_channel.ecomac)) == 4
    assert c.significance.significant.tolist() == [False] * 5 + [True]
    np.testing.assert_allclose(c.complexity.mpc, 1, atol=1e-12)
    assert [(s.a, s.b) for s in c.subspaces] == [((2, 3), (2, 3))]
    good = replace(a, shapes=np.where(np.arange(40)[:, None] == 4, -1, 1) * a.shapes)
    c = complete(good, b, p)
    assert max(c.subspaces[0].angles) < 0.03
    assert not c.suspects
    fit, own, cross = c.checks
    assert fit.verdict.passed
    assert [(f.a, f.b) for f in own.verdict.failures] in (
        [(1, 5), (5, 1)],
        [(5, 1), (1, 5)],
    )
    # modes 3 and 4 are one subspace: turned as they were paired, they are no failure
    assert {(f.a, f.b) for f in cross.verdict.failures} == {(5, 1)}
    assert min(cross.matrix[2, 2], cross.matrix[3, 3]) > 0.999
    np.testing.assert_allclose(np.abs(c.scale[[0, 1, 4]]), 7, rtol=0.01)
    assert "no standard deviation" in c.notes[0]


def test_mass_given_and_serep_agree_where_the_shapes_are_complete() -> None:
    b = model()
    a = replace(b, norm=Norm.UNSCALED)
    p = pair_modes(a, b)
    one, two = (
        complete(a, b, p, orthogonality=OrthogonalityTest(mass=np.eye(40))),
        complete(a, b, p),
    )
    model_check, *given = one.checks
    assert model_check.kind == "model"
    assert model_check.verdict.passed
    tested = [c for c in (*given, *two.checks) if c.kind != "model"]
    for left, right in zip(tested[:4], tested[2:], strict=True):
        assert left.kind == right.kind
        np.testing.assert_allclose(left.matrix, right.matrix, atol=1e-6)
        assert left.verdict.passed
    # a mass that cannot tell the model's own modes apart says so
    poor = complete(
        a,
        b,
        p,
        orthogonality=OrthogonalityTest(mass=np.diag(np.r_[np.ones(8), np.zeros(32)])),
    )
    assert not poor.checks[0].verdict.passed
    none = complete(a, a, p)
    assert not none.checks
    assert any("no mass given" in note for note in none.notes)


def test_turning_keeps_the_modes_of_the_model_orthonormal() -> None:
    """Three close modes of which two are paired: the third takes the direction that is left."""
    b = replace(model(), frequencies=np.array([10.0, 20, 30, 30.1, 30.2, 60]))
    turn = np.linalg.qr(np.random.default_rng(3).standard_normal((3, 3)))[0]
    phi = b.shapes.copy()
    phi[:, 2:5] = phi[:, 2:5] @ turn
    a = replace(b, shapes=phi, norm=Norm.UNSCALED).take(np.array([0, 1, 2, 3, 5]))
    p = pair_modes(a, b)
    u = turning(a, b, p)
    np.testing.assert_allclose(u.T @ u, np.eye(6), atol=1e-12)
    np.testing.assert_allclose(
        np.abs(a.shapes.T @ b.shapes @ u)[range(5), p.b], 1, atol=1e-9
    )


def test_a_partner_that_is_taken_is_named_by_its_number_in_the_whole_set() -> None:
    b = model()
    a = replace(b.take(np.array([4, 4])), frequencies=np.array([50.0, 51.0]))
    p = pair_modes(a, b, first_b=6)
    assert p.reasons_a == ("FE 11 (MAC 100 %) is already taken by test 1",)


def test_json_holds_no_nan_and_nothing_paired_is_no_error() -> None:
    b = model()
    a = replace(b, frequencies=b.frequencies * 9)
    p = pair_modes(a, b)
    assert not len(p)
    for lift in (None, lambda m: m.shapes):
        alone = complete(
            a,
            b,
            p,
            orthogonality=OrthogonalityTest(mass=np.eye(len(CHANNELS)), lift=lift),
        )
        text = json.dumps(complete_json(alone, p), allow_nan=False)
        assert "at least 3 are needed" in text
        assert "orthogonality not checked: no mode has a partner" in alone.notes
    full = complete_json(
        complete(measured(b), b, pair_modes(measured(b), b)), pair_modes(measured(b), b)
    )
    json.dumps(full, allow_nan=False)
    assert full["suspects"][0]["channel"] == "5+Z"


def frf_set(shift: float = 0.0, gain: float = 1.0) -> FrfSet:
    f = np.linspace(5, 500, 400)
    b = model()
    w0 = b.frequencies * (5 + shift)
    h = np.einsum(
        "ok,fk,k->fo",
        b.shapes,
        1 / (w0**2 - f[:, None] ** 2 + 2j * 0.02 * w0 * f[:, None]),
        b.shapes[0],
    )
    data = gain * h[:, :, None]
    outs = tuple(Channel(c, "acceleration", "m/s^2") for c in CHANNELS)
    return FrfSet(
        data,
        f,
        outs,
        (Channel("1+Z", "force", "N"),),
        np.full(data.shape, np.nan),
        np.array([np.nan]),
    )


def test_frfs_side_by_side() -> None:
    a = frf_set()
    same = compare_frfs(a, frf_set(gain=2.0))
    np.testing.assert_allclose(same.frac, 1, rtol=1e-10)
    np.testing.assert_allclose(same.deviation, 20 * np.log10(2), rtol=1e-10)
    np.testing.assert_allclose(same.shape, 1, rtol=1e-10)
    np.testing.assert_allclose(same.amplitude, 0.8, rtol=1e-10)  # 2·2/(1 + 4)
    np.testing.assert_allclose(same.levels.difference, 20 * np.log10(2), rtol=1e-10)
    (one,) = same.by_input()
    assert (one.name, one.frac, one.least_frac, one.shape) == (
        "1+Z",
        *[pytest.approx(1)] * 3,
    )
    assert one.amplitude == pytest.approx(0.8)
    wrong = frf_set()
    noise = np.random.default_rng(1).standard_normal(wrong.data[:, 7].shape)
    odd = replace(
        wrong, data=np.where(np.arange(40)[:, None] == 7, noise[:, None], wrong.data)
    )
    found = compare_frfs(a, odd)
    assert found.by_input()[0].worst_output == found.by_output()[0].name == "8+Z"
    moved = compare_frfs(a, frf_set(shift=0.3))
    assert moved.frac.max() < 0.9
    assert np.abs(moved.levels.difference).mean() > 0.1
    b = frf_set()
    with pytest.raises(InputError, match="0 lines, 40 outputs"):
        compare_frfs(a, replace(b, freqs=b.freqs + 0.3))
    with pytest.raises(InputError, match="convert one"):
        compare_frfs(a, replace(b, kind="receptance"))


def test_levels_fall_into_third_octaves() -> None:
    f = np.array([0.0, 1000.0, 1010.0, 2000.0])
    h = np.ones((4, 2, 1), dtype=complex)
    levels = band_levels(h, h * np.array([1, 10, 10, 1])[:, None, None], f)
    np.testing.assert_allclose(levels.centre, [1000, 2000])
    np.testing.assert_allclose(levels.difference[:, 0], [20, 0], atol=1e-12)
    assert shape_correlation(h, h * 1j).min() == pytest.approx(1)
    assert amplitude_correlation(h, 0 * h).max() == 0


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    b = model()
    a = measured(b)
    std = Uncertainty.independent(
        0.01 * a.frequencies, np.full(6, 0.01), np.zeros((40, 6))
    )
    write_modes(tmp_path / "a.json", a, std)
    write_modes(tmp_path / "a.h5", a, std)
    write_modes(tmp_path / "b.json", b)
    np.testing.assert_allclose(
        read_std(tmp_path / "a.h5"), (std.frequency, std.damping)
    )
    np.testing.assert_allclose(
        read_std(tmp_path / "a.json"), (std.frequency, std.damping)
    )
    assert np.isnan(read_std(tmp_path / "b.json")).all()
    files = ["correlate", str(tmp_path / "a.json"), str(tmp_path / "b.json")]
    assert run([*files, "--complete", "--json", str(tmp_path / "out.json")]) == 0
    shown = capsys.readouterr().out
    assert "channel 5+Z looks reversed" in shown
    assert "1 of 6 deviations are beyond their uncertainty" in shown
    found = json.loads((tmp_path / "out.json").read_text())["complete"]
    assert found["orthogonality"][1]["verdict"]["gate"] == "90 % / 10 %"
    assert run([*files, "--forbid", "1:1", "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["pairs"][0]["test_mode"] == 2
    assert run([*files, "--lock", "0:1"]) == 2
    assert "such as '3:7'" in capsys.readouterr().err


def test_a_mass_is_fit_where_ordinary_errors_leave_the_modes_apart() -> None:
    """What is foretold of readings with 2 % error is what many such readings show, root mean
    square.
    """
    rng = np.random.default_rng(4)
    shapes = rng.standard_normal((12, 3))
    # they look alike at the channels
    shapes[:, 2] = shapes[:, 1] + 0.05 * rng.standard_normal(12)
    back = pseudo_inverse(shapes)
    mass = back.T @ back
    error = 0.02 * np.sqrt((shapes**2).mean(axis=0))
    read = shapes[None] + error * rng.standard_normal((4000, 12, 3))
    cross = np.stack([shapes.T @ mass @ r for r in read])
    size = np.einsum("kij,il,klj->kj", read, mass, read).mean(axis=0)
    assert read_orthogonality(shapes, mass, error) == pytest.approx(
        np.sqrt((cross**2).mean(axis=0) / size), rel=0.03
    )
    # the same in modal coordinates
    one, back = np.eye(3), np.linalg.pinv(shapes)
    assert read_orthogonality(one, one, error, back) == pytest.approx(
        read_orthogonality(shapes, mass, error)
    )
    b = ModeSet(
        np.array([5.0, 8.0, 11.0]),
        np.zeros(3),
        shapes,
        tuple(map(str, range(12))),
        Norm.MASS,
    )
    noisy = replace(b, shapes=read[0])
    c = complete(noisy, b, pair_modes(noisy, b))
    assert not any(c.judges(k) for k in c.checks if k.kind != "model")
    fit = complete(
        noisy,
        b,
        pair_modes(noisy, b),
        orthogonality=OrthogonalityTest(Gate(0.5, 1.0, "wide"), np.eye(12) / 12),
    )
    assert fit.cross is not None
    assert fit.cross.mass == "given"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["a.json", "b.json", "--units", "SI"], "--units SI: no deck is given"),
        (
            ["a.json", "b.json", "--tolerance", "1"],
            "--tolerance 1.0: .* give --sensors",
        ),
        (["a.json", "b.bdf", "--match", "rigid"], "--match rigid: .* give --sensors"),
        (["a.bdf", "b.bdf", "--match", "rigid"], "--match rigid"),
        (
            ["a.json", "b.bdf", "--align", "nearest"],
            "--align nearest: .* give --sensors",
        ),
        (["a.json", "b.json", "--sensors", "s.csv"], "--sensors is for a deck"),
        (
            ["a.bdf", "b.json"],
            "a.bdf is a deck: name the modes of the test first, `b.json a.bdf`",
        ),
    ],
)
def test_options_that_would_change_nothing_are_refused(
    words: list[str],
    told: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("a", "b"):
        Path(f"{name}.json").write_text("{}")
        Path(f"{name}.bdf").write_text("GRID,1\n")
    assert run(["correlate", *words]) == 2
    assert re.search(told, " ".join(capsys.readouterr().err.split()))


def test_says_which_measures_of_an_excitation_point_are_worse() -> None:
    before = InputSummary("1+Z", 0.40, "9+X", 0.1, 8.0, 0.6, 0.7)
    better = replace(before, frac=0.5, deviation=4.0, shape=0.8, amplitude=0.8)
    assert better.worse_than(before) == ()
    assert before.worse_than(better) == ("FRAC", "level", "shape", "amplitude")
    assert replace(better, deviation=8.1).worse_than(before) == ("level",)
