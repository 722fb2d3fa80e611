"""Pairing by one global assignment, its reasons, and the table."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ringtrue.core.modes import ModeSet, Norm
from ringtrue.correlation.assignment import Followed, Locks
from ringtrue.correlation.paired_shapes import paired_shapes, turning
from ringtrue.correlation.pairing import PairingSettings, pair_modes
from ringtrue.correlation.table import correlation_table
from ringtrue.errors import ConfigError, InputError

CHANNELS = tuple("abcdefghij")


def modes(f: list[float], shapes: np.ndarray, norm: Norm = Norm.UNSCALED) -> ModeSet:
    return ModeSet(
        np.array(f), np.full(len(f), 0.01), shapes, CHANNELS[: shapes.shape[0]], norm
    )


def sines(m: int, n: int = 10) -> np.ndarray:
    """Discrete sine shapes: exactly orthogonal."""
    return np.sin(np.pi * np.outer(np.arange(1, n + 1), np.arange(1, m + 1)) / (n + 1))


def mixed(phi: np.ndarray, first: int, angle: float) -> np.ndarray:
    """The shapes with `first` and the next one turned into each other."""
    c, s = np.cos(angle), np.sin(angle)
    out = phi.copy()
    out[:, first : first + 2] = phi[:, first : first + 2] @ np.array([[c, -s], [s, c]])
    return out


def test_pairs_do_not_depend_on_order_sign_scale_or_channel_order() -> None:
    rng = np.random.default_rng(0)
    phi = sines(6)
    a = modes([10, 20, 30, 41, 52, 63.0], phi + 0.02 * rng.standard_normal(phi.shape))
    b = modes([11, 19, 31, 40, 55, 60.0], phi)
    plain = pair_modes(a, b)
    assert plain.a.tolist() == plain.b.tolist() == list(range(6))
    mix, rows = rng.permutation(6), rng.permutation(10)
    turned = b.take(mix)
    turned = replace(turned, shapes=turned.shapes * rng.choice([-3.0, 0.2], 6))
    got = pair_modes(a, turned.rows([CHANNELS[i] for i in rows]))
    assert mix[got.b].tolist() == list(range(6))
    np.testing.assert_allclose(got.mac, plain.mac, rtol=1e-12)


@pytest.mark.parametrize("channels", [10, 0], ids=["shapes", "frequencies alone"])
def test_rigid_body_modes_at_exactly_0_hz_pair_with_each_other(channels: int) -> None:
    phi = sines(4)[:channels]
    a, b = modes([0, 0, 20, 30.0], phi), modes([0, 0, 21, 31.0], phi)
    p = pair_modes(a, b)
    assert sorted(p.b[:2].tolist()) == [0, 1]
    assert p.b[2:].tolist() == [2, 3]
    np.testing.assert_allclose(
        correlation_table(a, b, p).deviation_percent, [0, 0, 5, 10 / 3], rtol=1e-12
    )
    assert len(pair_modes(a, modes([1e-4, -1e-4, 21, 31.0], phi))) == 2


def test_gaps_in_shapes_are_refused_with_their_channels() -> None:
    phi = sines(3)
    phi[2, 1] = np.nan
    with pytest.raises(InputError, match="shapes of FE have gaps"):
        pair_modes(modes([10, 20, 30], sines(3)), modes([10, 20, 30], phi))


def test_two_poor_pairs_never_outvote_a_good_one() -> None:
    """A sum of MACs would pair across: 0.66 + 0.66 > 0.93."""
    e = np.eye(4)
    a = modes([10, 10.5], np.stack([e[0], 0.81 * e[0] + 0.58 * e[1]], axis=1))
    b = modes(
        [10, 10.5],
        np.stack([0.965 * e[0] + 0.26 * e[2], 0.81 * e[0] - 0.58 * e[3]], axis=1),
    )
    p = pair_modes(a, b, PairingSettings(close=0.0))
    assert (p.a.tolist(), p.b.tolist()) == ([0], [0])
    assert "already taken by test 1" in p.reasons_a[0]


def test_rotated_close_pair_is_a_subspace() -> None:
    phi = sines(4)
    a, b = (
        modes([10, 20, 20.1, 40], phi),
        modes([10, 21, 21.1, 40], mixed(phi, 1, np.pi / 4), Norm.MASS),
    )
    p = pair_modes(a, b)
    assert len(p) == 4
    assert p.subspace.tolist() == [False, True, True, False]
    assert p.mac.min() > 0.99
    assert len(pair_modes(a, b, PairingSettings(close=0.0))) == 2


def test_rotated_pair_beside_a_third_close_mode() -> None:
    """In the test the third mode is close to the pair, in the model it is not."""
    phi = sines(3)
    p = pair_modes(
        modes([20, 20.3, 20.6], phi),
        modes([20, 20.2, 21.5], mixed(phi, 0, np.pi / 4), Norm.MASS),
    )
    assert p.a.tolist() == p.b.tolist() == [0, 1, 2]
    assert p.subspace.tolist() == [True, True, False]
    np.testing.assert_allclose(p.mac, 1.0, rtol=1e-9)


def test_a_close_mode_that_belongs_elsewhere_takes_no_direction_of_a_group() -> None:
    """Of two close test modes one is the model's first, with a trace of its pair; the other is of
    that pair.
    """
    phi = sines(4)
    a = modes(
        [43.3, 43.4],
        np.stack([phi[:, 1] + phi[:, 2], phi[:, 0] + 0.4 * phi[:, 1]], axis=1),
    )
    p = pair_modes(a, modes([42.0, 43.9, 44.0, 60.0], phi))
    assert p.a.tolist() == [0, 1]
    assert p.b[1] == 0
    assert p.b[0] in (1, 2)
    np.testing.assert_allclose(p.mac, [1.0, 1 / 1.16])
    assert p.subspace.tolist() == [True, False]


def test_pair_that_is_close_in_the_test_alone() -> None:
    """The model has the two modes 4 % apart; the test has them 0.3 % apart, and mixed."""
    phi = sines(4)
    turned = mixed(phi, 1, np.pi / 5)
    a, b = (
        modes([10, 20, 20.06, 40], turned),
        modes([10, 19.5, 20.3, 40], phi, Norm.MASS),
    )
    p = pair_modes(a, b)
    assert p.a.tolist() == p.b.tolist() == [0, 1, 2, 3]
    assert p.subspace.tolist() == [False, True, True, False]
    np.testing.assert_allclose(p.mac, 1.0, rtol=1e-9)
    test, model = paired_shapes(a, b, p)
    np.testing.assert_allclose(test, model, atol=1e-9)
    turn = turning(a, b, p)
    np.testing.assert_allclose(turn.T @ turn, np.eye(4), atol=1e-12)
    assert not pair_modes(modes([10, 20, 24, 40], turned), b).subspace.any()
    assert not pair_modes(a, modes([10, 18, 22, 40], phi)).subspace.any()


def test_close_modes_that_match_one_to_one_are_not_rotated() -> None:
    phi = sines(3)
    p = pair_modes(modes([10, 20, 20.1], phi), modes([10, 20, 20.1], phi))
    assert not p.subspace.any()


def test_each_unpaired_mode_has_its_reason() -> None:
    phi = sines(6)
    mixed = phi[:, 2] + 1.1 * phi[:, 5]
    a = modes(
        [10, 20, 30, 300, 40],
        np.stack([phi[:, 0], phi[:, 1], mixed, phi[:, 4], phi[:, 3]], axis=1),
    )
    a = replace(a, confidence=np.array([1, 0.3, 1, 1, 1]))
    b = modes([10, 20, 30, 41, 1200], phi[:, :5], Norm.MASS)
    p = pair_modes(a, b)
    why = dict(zip(p.unpaired_a.tolist(), p.reasons_a, strict=True))
    assert why[1] == "confidence 0.30 < 0.50"
    assert why[2].startswith(
        "no FE mode within 40 % has MAC >= 60 %: best FE 3 with 45 %"
    )
    assert why[3] == "no FE mode within 40 %"
    other = dict(zip(p.unpaired_b.tolist(), p.reasons_b, strict=True))
    assert other[4].startswith("outside of the test band")
    assert set(p.unpaired_a) | set(p.a) == set(range(5))
    assert all(p.reasons_a)
    assert all(p.reasons_b)


def test_a_mac_just_below_the_gate_is_told_as_below_it() -> None:
    phi = sines(2)
    root = np.sqrt([0.5996, 0.4004])
    (why,) = pair_modes(
        modes([10], phi @ root[:, None]), modes([10], phi[:, :1], Norm.MASS)
    ).reasons_a
    assert why.endswith("best FE 1 with 59.96 %")


def test_a_mode_that_looks_alike_beyond_the_gate_is_told() -> None:
    phi = sines(4)
    a, b = modes([6, 20, 30, 40], phi), modes([9, 20, 30, 90], phi, Norm.MASS)
    first, last = pair_modes(a, b, PairingSettings(reach=1.0)).reasons_a
    assert (
        first
        == "no FE mode within 40 %; beyond the gate FE 1, +50 %, has 100 %: widen it "
        "(frequency_gate)"
    )
    # 125 %: another mode of the same look
    assert last.startswith("no FE mode within 40 % has MAC")
    assert "beyond" not in last
    assert len(pair_modes(a, b, PairingSettings(frequency_gate=0.6, reach=1.0))) == 3


def test_modes_alike_and_like_no_other_are_pairs_beyond_the_gate() -> None:
    """Springs four times too soft: the two lowest modes are at half their frequency."""
    phi = sines(4)
    a, b = modes([6, 9, 20, 30], phi), modes([3, 4.5, 20, 31], phi, Norm.MASS)
    p = pair_modes(a, b)
    assert p.b.tolist() == [0, 1, 2, 3]
    assert p.beyond.tolist() == [True, True, False, False]
    told = "paired beyond the frequency gate, as they look like no other mode: "
    assert p.far() == (told + "test 1 with FE 1 (-50 %), test 2 with FE 2 (-50 %)",)
    assert pair_modes(a, modes([1.9, 4.5, 20, 31], phi, Norm.MASS)).a.tolist() == [
        1,
        2,
        3,
    ]  # a third is out of reach
    assert 0 not in pair_modes(a, b, locks=Locks((), ((0, 0),))).a


@pytest.mark.parametrize(
    ("f", "beyond"),
    [(3.0, 2), (3.59, 1), (3.62, 0)],
    ids=["beyond", "across", "within"],
)
def test_close_modes_about_the_gate_are_one_subspace(f: float, beyond: int) -> None:
    phi = sines(4)
    a, b = (
        modes([6, 6.03, 20, 30], mixed(phi, 0, np.pi / 4)),
        modes([f, 1.005 * f, 20, 31], phi, Norm.MASS),
    )
    p = pair_modes(a, b)
    assert p.subspace.tolist() == [True, True, False, False]
    assert np.count_nonzero(p.beyond) == beyond
    np.testing.assert_allclose(p.mac, 1.0, rtol=1e-9)
    np.testing.assert_allclose(*paired_shapes(a, b, p), atol=1e-9)


@pytest.mark.parametrize("why", ["another", "one channel", "few channels"])
def test_no_pair_is_made_beyond_the_gate_where_shapes_leave_doubt(why: str) -> None:
    phi = sines(4)
    a, b = modes([6, 20, 30, 40], phi), modes([3, 20, 30, 40], phi, Norm.MASS)
    if why == "another":  # that looks much the same, and has no partner either
        like = 0.8 * phi[:, :1] + 0.6 * phi[:, 1:2]
        b = modes([3, 20, 30, 40, 1.5], np.concatenate([phi, like], axis=1), Norm.MASS)
    # carries both shapes: it reads all modes of its panel alike
    if why == "one channel":
        local = np.concatenate([np.eye(10)[:, :1], phi[:, 1:]], axis=1)
        a, b = replace(a, shapes=local), replace(b, shapes=local)
    if why == "few channels":
        a, b = (m.rows(CHANNELS[:3]).take(np.arange(2)) for m in (a, b))
    p = pair_modes(a, b)
    assert 0 not in p.a
    assert not p.beyond.any()


def test_faint_mode_is_not_observable() -> None:
    phi = sines(3)
    b = modes([10, 20, 30], phi * [1, 1e-4, 1], Norm.MASS)
    p = pair_modes(modes([10, 20, 30], phi), b)
    assert p.unpaired_b.tolist() == [1]
    assert "not observable" in p.reasons_b[0]
    assert p.reasons_a[0].startswith("FE 2 (MAC 100 %) is left out: not observable")


def test_no_modes_at_all() -> None:
    none = modes([], np.zeros((10, 0)))
    p = pair_modes(none, modes([1.0], sines(1)))
    assert len(p) == 0
    assert len(p.reasons_b) == 1


def test_channels_and_gates_are_checked() -> None:
    a = modes([10.0], sines(1))
    with pytest.raises(InputError, match="channels not in"):
        pair_modes(a, modes([10.0], sines(1, 9)))
    with pytest.raises(ConfigError, match="mac_gate"):
        PairingSettings(mac_gate=1.5)


def test_table_summary() -> None:
    phi = sines(3)
    a, b = modes([10, 20, 30], phi), modes([11, 19, 30], phi)
    t = correlation_table(
        a, b, pair_modes(a, b), std_hz=np.array([0.1, 0.5, np.nan]), left_out=[2]
    )
    np.testing.assert_allclose(t.deviation_percent, [10, -5, 0], atol=1e-12)
    np.testing.assert_allclose(t.significance, [10, 2, np.nan])
    assert t.mean_deviation() == pytest.approx(5)
    assert t.mean_deviation(t.used) == pytest.approx(7.5)
    assert t.max_deviation() == pytest.approx(10)
    assert t.mean_mac() == pytest.approx(100)
    row = t.rows()[1]
    assert (row.test, row.fe, row.used) == (2, 2, True)
    assert row.deviation_hz == pytest.approx(-1)


@pytest.mark.parametrize("norm", [Norm.MASS, Norm.UNSCALED])
def test_modes_that_do_not_move_the_channels_have_no_mac(norm: Norm) -> None:
    """More than half of the modes move across the sensors: what these read of them is rounding."""
    rng = np.random.default_rng(3)
    shapes = [
        sines(5) * np.where(np.isin(np.arange(5), [0, 2]), 1.0, 1e-16) for _ in range(2)
    ]
    shapes = [s + 1e-17 * rng.standard_normal(s.shape) for s in shapes]
    a = modes([10, 20, 30, 40, 50], shapes[0], norm)
    b = modes([11, 21, 31, 41, 51], shapes[1], norm)
    pairing = pair_modes(a, b)
    assert pairing.a.tolist() == pairing.b.tolist() == [0, 2]
    assert {w.split(":")[0] for w in (*pairing.reasons_a, *pairing.reasons_b)} == {
        "not observable"
    }
    table = correlation_table(a, b, pairing)
    assert not table.mac[[1, 3, 4]].any()
    assert not table.mac[:, [1, 3, 4]].any()


def test_the_table_has_the_mac_of_its_matrix_and_that_of_the_subspace() -> None:
    phi = sines(4)
    a = modes([10, 20, 20.1, 40], phi)
    b = modes([10, 21, 21.1, 40], mixed(phi, 1, np.pi / 4), Norm.MASS)
    t = correlation_table(a, b, pair_modes(a, b))
    np.testing.assert_allclose(t.mac_percent, [100, 50, 50, 100])
    np.testing.assert_allclose(t.mac_percent, 100 * t.mac[t.pairing.a, t.pairing.b])
    np.testing.assert_allclose(t.subspace_mac_percent, 100)
    assert t.mean_mac() == pytest.approx(75)
    assert t.mean_subspace_mac() == pytest.approx(100)
    assert [row.subspace for row in t.rows()] == [False, True, True, False]


def test_a_pair_that_the_user_decides_follows_its_shape_through_a_crossing() -> None:
    shapes = np.eye(4)[:, :3]
    known = Followed((0,), shapes[:, [1]], (2,), shapes[:, [2]])
    assert known.locks(shapes) == Locks(((0, 1),), ((2, 2),))
    assert known.locks(shapes[:, [1, 2, 0]]) == Locks(((0, 0),), ((2, 1),))
    assert known.locks(shapes[:, :0]) == Locks()


def alone(f: list[float]) -> ModeSet:
    return ModeSet(np.array(f), np.full(len(f), 0.01), np.zeros((0, len(f))), ())


def test_frequencies_alone_pair_about_what_the_model_is_off_as_a_whole() -> None:
    """A deck 14 % too stiff, one mode missed: the nearest frequencies belong to other modes."""
    deck = [10.0, 12.5, 19.0, 21.8, 25.0, 40.0, 52.0]
    scatter = np.array([1.0, 1.01, 0.99, 1.01, 1.0, 1.0, 0.99])
    test = (np.array(deck) / 1.14 * scatter)[[0, 1, 3, 4, 5, 6]]
    nearest = [int(np.abs(np.array(deck) - f).argmin()) for f in test]
    p = pair_modes(alone(test.tolist()), alone(deck))
    assert nearest != [0, 1, 3, 4, 5, 6] == p.b.tolist()
    assert not p.doubts()


def test_what_frequencies_alone_leave_in_doubt_is_told() -> None:
    p = pair_modes(alone([10.0, 20.1, 35.0]), alone([10.0, 19.9, 20.4, 35.0]))
    assert len(p) == 3
    assert p.doubts() == ("test 2 is taken for FE 2, and may as well be FE 3",)
    decided = pair_modes(
        alone([10.0, 20.1, 35.0]),
        alone([10.0, 19.9, 20.4, 35.0]),
        locks=Locks(((1, 2),)),
    )
    assert decided.b.tolist() == [0, 2, 3]
    assert not decided.doubts()


def test_a_gate_makes_no_pair_certain() -> None:
    """The right partner of the first mode lies beyond the gate: the other one is no more likely for
    that.
    """
    gates = PairingSettings(frequency_gate=0.1)
    p = pair_modes(alone([10.0, 20.0, 40.0]), alone([10.2, 11.1, 22.2, 44.4]), gates)
    assert p.doubts() == ("test 1 is taken for FE 1, and may as well be FE 2",)
