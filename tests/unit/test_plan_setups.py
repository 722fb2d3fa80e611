"""Setups of a test with fewer sensors than points."""

import csv
from pathlib import Path

import numpy as np
import pytest

from ringtrue.core.testmodel import TestModel
from ringtrue.errors import InputError
from ringtrue.planning.plan_files import (
    PlannedExcitation,
    roving_setups,
    roving_shift,
    write_test_sheet,
)


def string(n: int, m: int) -> tuple[np.ndarray, np.ndarray]:
    """Modes of a taut string at n inner points: (n, 1, m) and positions (n, 3)."""
    s = np.arange(1, n + 1) / (n + 1)
    return np.sin(np.pi * np.outer(s, np.arange(1, m + 1)))[:, None, :], np.stack(
        [s, 0 * s, 0 * s], axis=1
    )


@pytest.mark.parametrize("at_hand", [2, 5, 8, 29])
def test_every_sensor_is_measured_and_no_setup_needs_more_than_are_at_hand(
    at_hand: int,
) -> None:
    shapes, xyz = string(30, 4)
    plan = roving_setups(shapes, xyz, at_hand)
    r = plan.references.size
    sizes = [plan.roving(k).size for k in range(plan.count)]
    assert sum(sizes) + r == 30
    assert r + max(sizes) <= at_hand
    assert plan.count == -(-(30 - r) // (at_hand - r))
    assert max(sizes) - min(sizes) <= 1
    for k in range(plan.count):  # neighbours: no other roving sensor lies between them
        part = plan.roving(k)
        between = np.setdiff1d(np.arange(part.min(), part.max() + 1), part)
        assert (plan.setup[between] < 0).all()


def test_references_see_every_mode_where_one_alone_could_not() -> None:
    shapes, xyz = string(9, 4)  # the middle is a node of the even modes
    plan = roving_setups(shapes, xyz, 5)
    assert plan.seen.min() >= 1 or plan.references.size == 2
    assert plan.seen.min() > 0.5
    square = shapes[:, 0] ** 2
    np.testing.assert_allclose(
        plan.seen**2, square[plan.references].mean(axis=0) / square.mean(axis=0)
    )
    kept = roving_setups(shapes, xyz, 5, np.array([4, 4]))
    assert 4 in kept.references


def test_a_mode_of_one_part_alone_has_a_reference_there() -> None:
    shapes, xyz = string(20, 2)
    local = np.zeros((20, 1, 1))
    local[16:18] = 1.0
    plan = roving_setups(np.concatenate([shapes, local], axis=2), xyz, 6)
    assert {16, 17} & set(plan.references.tolist())


def test_setups_need_fewer_sensors_at_hand_than_planned() -> None:
    shapes, xyz = string(6, 2)
    for at_hand in (1, 6):
        with pytest.raises(InputError, match="sensors at hand"):
            roving_setups(shapes, xyz, at_hand)


def test_moved_masses_shift_modes_by_their_difference() -> None:
    rng = np.random.default_rng(3)
    phi = np.linalg.qr(rng.standard_normal((6, 6)))[0]
    f = np.arange(1.0, 7.0)
    one = roving_shift(f, phi[:, None, :], 1e-6, np.array([0, 0, -1, 1, 1, -1]))
    square = phi**2
    np.testing.assert_allclose(
        one,
        0.5e-6 * np.abs(square[:2].sum(axis=0) - square[3:5].sum(axis=0)),
        rtol=1e-3,
    )


def test_the_sheet_of_setups_keeps_the_numbers_of_sensors_that_stay(
    tmp_path: Path,
) -> None:
    shapes, xyz = string(7, 2)
    plan = roving_setups(shapes, xyz, 4)
    points = np.arange(101, 108)
    names = tuple(f"{p}+{a}" for p in points for a in "YZ")
    axes = np.tile(np.eye(3)[1:], (7, 1))
    test = TestModel(
        points,
        xyz,
        names,
        np.repeat(points, 2),
        axes,
        np.zeros((0, 2), dtype=int),
        ("",) * 7,
    )
    files = write_test_sheet(
        tmp_path,
        test,
        PlannedExcitation(names[:1], np.array([1.0, 2.0]), np.ones((1, 2))),
        setups=plan,
    )
    with files[-1].open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {r["channels"] for r in rows} == {f"{p}+Y {p}+Z" for p in points}
    for k in range(plan.count):
        here = [r for r in rows if r["setup"] == str(k + 1)]
        assert [int(r["sensor"]) for r in here] == list(range(1, len(here) + 1))
        staying = [int(r["point"]) for r in here if r["stays"]]
        assert staying == points[plan.references].tolist()
