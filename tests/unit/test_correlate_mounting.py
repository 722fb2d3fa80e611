"""Sensors turned, reversed or swapped in tests of five structures are named; sound tests accuse
nobody.

A cantilever with unlike bending stiffness, a frame of three storeys, a plate held at one edge and
read along Z alone, a tower of square section (its bending modes are pairs) and a bent pipe. The
test is on a copy whose moduli are off by up to 30 % part by part, read with noise; the model is as
it stands.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import small_study

from ringtrue.core.modes import ModeSet
from ringtrue.core.testmodel import TestModel
from ringtrue.correlation.sensor_mounting import Mending, Readings, find_mendings
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.model.ports import ModesRequest
from ringtrue.study.opened import Opened

Array = np.ndarray
# the counts: pytest -o log_cli=true --log-cli-level=INFO
log = logging.getLogger(__name__)
MODES = 8
SEEDS = 6  # tests of each structure and fault
HITS = 0.9  # least share of faults that are named
TRIAXIAL = np.eye(3)


def beams(places: Array, section: str, free: int = 0) -> tuple[str, Array, Array]:
    """A line of CBAR between places (n, 3), the first held; the modulus of each third is a
    parameter.
    """
    n = len(places)
    lines = [
        f"GRID,{k + 1},,{x:.4f},{y:.4f},{z:.4f}"
        for k, (x, y, z) in enumerate(places.tolist())
    ]
    lines += [
        f"CBAR,{k},{1 + 3 * (k - 1) // (n - 1)},{k},{k + 1},.3,.5,.8"
        for k in range(1, n)
    ]
    for part in (1, 2, 3):
        lines += [f"MAT1,{part},{{{part}}},,.3,7850.", f"PBAR,{part},{part},{section}"]
    return (
        "\n".join(["BEGIN BULK", *lines, "SPC1,1,123456,1", "ENDDATA", ""]),
        np.arange(2, n + 1),
        places[1:],
    )


def column() -> tuple[str, Array, Array, Array]:
    text, points, xyz = beams(
        np.linspace([0, 0, 0], [0, 0, 4], 13), "2.-3,5.-6,2.-6,4.-6"
    )
    return text, points, xyz, TRIAXIAL[:2]


def tower() -> tuple[str, Array, Array, Array]:
    text, points, xyz = beams(
        np.linspace([0, 0, 0], [0, 0, 4], 13), "2.-3,3.-6,3.-6,4.-6"
    )
    return text, points, xyz, TRIAXIAL[:2]


def pipe() -> tuple[str, Array, Array, Array]:
    legs = [
        np.linspace([0, 0, 0], [0, 0, 2], 7),
        np.linspace([0.3, 0, 2], [1.8, 0, 2], 6),
    ]
    text, points, xyz = beams(
        np.vstack([*legs, np.linspace([1.8, 0.3, 2], [1.8, 1.2, 2.4], 4)]),
        "2.-3,4.-6,4.-6,8.-6",
    )
    return text, points, xyz, TRIAXIAL


def plate() -> tuple[str, Array, Array, Array]:
    x, y = np.meshgrid(np.linspace(0, 1.5, 7), np.linspace(0, 1.0, 5), indexing="ij")
    place = np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()])
    lines = [
        f"GRID,{k + 1},,{a:.4f},{b:.4f},0."
        for k, (a, b, _) in enumerate(place.tolist())
    ]
    for i in range(6):
        for j in range(4):
            k = 5 * i + j + 1
            lines.append(f"CQUAD4,{k},{1 + i // 2},{k},{k + 5},{k + 6},{k + 1}")
    for part in (1, 2, 3):
        lines += [
            f"MAT1,{part},{{{part}}},,.3,7850.",
            f"PSHELL,{part},{part},.01,{part}",
        ]
    held = ",".join(map(str, range(1, 6)))
    text = "\n".join(["BEGIN BULK", *lines, f"SPC1,1,123456,{held}", "ENDDATA", ""])
    return text, np.arange(6, 36), place[5:], TRIAXIAL[2:]


def frame() -> tuple[str, Array, Array, Array]:
    test = small_study.test_model()
    text = (
        small_study.deck()
        .replace("2.0000000E+11", "{1}", 1)
        .replace("2.0000000E+11", "{2}", 1)
    )
    return text.replace("2.0000000E+11", "{3}", 1), test.points, test.xyz, TRIAXIAL[:2]


STRUCTURES: dict[str, Callable[[], tuple[str, Array, Array, Array]]] = {
    f.__name__: f for f in (column, tower, pipe, plate, frame)
}


@cache
def opened(structure: str, factors: tuple[float, ...]) -> tuple[Opened, ModeSet]:
    text = STRUCTURES[structure]()[0]
    values = {
        str(k): f"{2e11 * f:.5E}" for k, f in zip((1, 2, 3), factors, strict=True)
    }
    for k, value in values.items():
        text = text.replace("{" + k + "}", value)
    with TemporaryDirectory() as folder:
        (Path(folder) / "deck.bdf").write_text(text)
        deck = Opened(read_deck(Path(folder) / "deck.bdf"), 1.0)
    return deck, deck.analysis.modes(ModesRequest(2 * MODES)).modes


def sheet_of(structure: str) -> TestModel:
    """Sensors at all points along the axes of the structure; the upper half of the points is a
    group of its own.
    """
    _, points, xyz, axes = STRUCTURES[structure]()
    names = tuple(
        f"{p}+{'XYZ'[int(a.argmax())]}" for p in points.tolist() for a in axes
    )
    groups = tuple(
        "far" if 2 * k >= points.size else "near" for k in range(points.size)
    )
    at, every = np.repeat(points, len(axes)), np.tile(axes, (points.size, 1))
    return TestModel(
        points, xyz, names, at, every, np.zeros((0, 2), dtype=np.int64), groups
    )


def measured(
    structure: str,
    axes: Array,
    rng: np.random.Generator,
    off: float = 1.3,
    count: int = MODES,
) -> ModeSet:
    """A test by sensors with these axes (n, 3), which the sheet does not know; modes that they see,
    with noise.
    """
    factors = np.exp(rng.uniform(-np.log(off), np.log(off), 3))
    deck, modes = opened(structure, tuple(factors.round(2).tolist()))
    sheet = sheet_of(structure)
    seen = deck.observation(replace(sheet, axes=axes), 0.01)(modes.shapes)
    kept = np.flatnonzero(np.abs(seen).max(axis=0) > 0.05 * np.abs(seen).max())[:count]
    shapes = seen[:, kept]
    noise = 0.03 * np.sqrt((shapes**2).mean(axis=0)) * rng.standard_normal(shapes.shape)
    scale = rng.uniform(0.2, 5.0, kept.size) * rng.choice([-1.0, 1.0], kept.size)
    f = modes.frequencies[kept] * (1 + 0.002 * rng.standard_normal(kept.size))
    return ModeSet(
        f, np.full(kept.size, 0.01), (shapes + noise) * scale, sheet.channels
    )


def judged(
    structure: str, test: ModeSet, axes: Array | None = None
) -> tuple[Mending, ...]:
    """By the nominal deck, with the axes (n, 3) that the sheet says."""
    deck, modes = opened(structure, (1.0, 1.0, 1.0))
    sheet = sheet_of(structure)
    sheet = sheet if axes is None else replace(sheet, axes=axes)
    three = deck.observation(sheet.threefold(), 0.01)(modes.shapes)
    motion = three.reshape(3, len(sheet.channels), -1)
    return find_mendings(
        Readings(test, modes.frequencies, motion, sheet.axes, sheet.group_of_channels())
    )


def turned(
    way: str, axes: Array, groups: tuple[str, ...], rng: np.random.Generator
) -> Array | None:
    """The axes (n, 3) that the sensors really have; None where that changes nothing but the sign of
    all.
    """
    far = np.array([g == "far" for g in groups])[:, None]
    along = np.unique(np.abs(axes).argmax(axis=1))
    if (
        way == "axes onto each other"
    ):  # one is taken for another that the structure moves along, too
        cycle = (
            np.eye(3)[[1, 2, 0]]
            if along.size == 3
            else np.eye(3)[[1, 0, 2]]
            if along.size == 2
            else None
        )
        return None if cycle is None else axes @ cycle.T
    if way == "one axis reversed":
        return (
            np.where(np.abs(axes[:, [along[-1]]]) > 0.5, -axes, axes)
            if along.size > 1
            else None
        )
    if way == "a group reversed":
        return np.where(far, -axes, axes)
    if way == "a group turned":
        return (
            np.where(far, axes @ np.eye(3)[[1, 0, 2]].T, axes)
            if along.size > 1
            else None
        )
    assert way == "signs at random"
    some = rng.choice(len(axes), int(0.45 * len(axes)), replace=False)
    out = np.array(axes)
    out[some] *= -1
    return out


def explains(found: Mending, way: str, structure: str, truth: Array) -> bool:
    """Whether the first mending, or a rival of it, is what was done."""
    sheet = sheet_of(structure)
    if way == "signs at random":
        wrong = (sheet.axes * truth).sum(axis=1) < 0
        differs = np.isin(sheet.channels, found.channels) != wrong
        # the mirror image of a structure has its modes: the sign of all X, or of all Y, says nothing
        along = (
            np.abs(sheet.axes).argmax(axis=1)
            if structure in MIRRORED
            else np.zeros(len(wrong))
        )
        missed = [
            min(d.sum(), d.size - d.sum())
            for d in (differs[along == k] for k in range(3))
        ]
        return found.kind == "signs" and sum(missed) <= 0.15 * len(wrong)
    if way.startswith("a group"):  # of two groups nobody can tell which is reversed
        return (
            found.kind == "axes"
            and found.mac[1] > 0.8
            and found.group in ("near", "far")
        )
    if way == "one axis reversed":
        return (
            found.kind == "axes"
            and not found.group
            and all(y == f"-{x}" for x, y in found.axes)
        )
    return found.kind == "axes" and found.mac[1] > 0.8 and not found.group


WAYS = (
    "axes onto each other",
    "one axis reversed",
    "a group reversed",
    "a group turned",
    "signs at random",
)
MIRRORED = ("column", "tower")  # about both planes
SYMMETRIC = WAYS[:2]  # nobody can tell these of a square section
LABELS = {
    "+X for +Z": [2, 1, 0],
    "+Y for +Z": [0, 2, 1],
    "X, Y, Z for Y, Z, X": [1, 2, 0],
}


@pytest.mark.parametrize("structure", STRUCTURES)
def test_sound_tests_accuse_nobody(structure: str) -> None:
    rng = np.random.default_rng(11)
    sheet = sheet_of(structure)
    alarms = [
        m
        for _ in range(30)
        for m in judged(structure, measured(structure, sheet.axes, rng))
    ]
    log.info("sound, %s: %s alarms in 30 tests", structure, len(alarms))
    assert not alarms


@pytest.mark.parametrize(("off", "count"), [(1.3, 3), (3.0, 8), (3.0, 4)])
def test_few_modes_and_models_that_are_wrong_accuse_nobody(
    off: float, count: int
) -> None:
    """Moduli off by up to a factor: the model is to be mended, not the sensors."""
    rng = np.random.default_rng(16)
    alarms = []
    for structure in STRUCTURES:
        axes = sheet_of(structure).axes
        alarms += [
            m.text
            for _ in range(20)
            for m in judged(structure, measured(structure, axes, rng, off, count))
        ]
    log.info(
        "sound, moduli off by %s, %s modes: %s alarms in 100 tests",
        off,
        count,
        len(alarms),
    )
    assert len(alarms) <= 1, "\n".join(alarms)


@pytest.mark.parametrize("way", WAYS)
def test_what_was_turned_is_named(way: str) -> None:
    rng = np.random.default_rng(12)
    hits, cases, lost = 0, 0, list[str]()
    for structure in STRUCTURES:
        sheet = sheet_of(structure)
        for _ in range(SEEDS):
            truth = turned(way, sheet.axes, sheet.group_of_channels(), rng)
            if truth is None or (structure == "tower" and way in SYMMETRIC):
                continue
            found = judged(structure, measured(structure, truth, rng))
            cases += 1
            good = bool(found) and explains(found[0], way, structure, truth)
            hits += good
            lost += (
                []
                if good
                else [f"{structure}: {found[0].text if found else 'nothing'}"]
            )
    log.info("%s: %s of %s named", way, hits, cases)
    assert cases >= SEEDS
    assert hits >= HITS * cases, "\n".join([f"{hits} of {cases}", *lost])


@pytest.mark.parametrize("label", LABELS)
def test_a_sheet_with_other_axes_is_named(label: str) -> None:
    """All sensors are right, and the sheet calls their axes by other letters."""
    rng = np.random.default_rng(13)
    hits, cases, lost = 0, 0, list[str]()
    for structure in STRUCTURES:
        sheet = sheet_of(structure)
        wrong = sheet.axes @ np.eye(3)[LABELS[label]].T
        if np.array_equal(wrong, sheet.axes):
            continue
        for _ in range(SEEDS):
            found = judged(structure, measured(structure, sheet.axes, rng), wrong)
            cases += 1
            good = (
                bool(found)
                and found[0].kind == "axes"
                and not found[0].group
                and found[0].mac[1] > 0.8
            )
            hits += good
            lost += (
                []
                if good
                else [f"{structure}: {found[0].text if found else 'nothing'}"]
            )
    log.info("%s: %s of %s named", label, hits, cases)
    assert hits >= HITS * cases, "\n".join([f"{hits} of {cases}", *lost])


def test_cables_that_are_swapped_are_named_with_the_mac() -> None:
    """Three pairs of cables of sensors that move unlike, far too many for the pairs that are
    left.
    """
    rng = np.random.default_rng(15)
    named, cases = 0, 0
    for structure in ("column", "pipe", "plate"):
        sheet = sheet_of(structure)
        for _ in range(SEEDS):
            test = measured(structure, sheet.axes, rng)
            size = np.linalg.norm(
                test.shapes / np.linalg.norm(test.shapes, axis=0), axis=1
            )
            large = np.argsort(-size)[:8]
            swapped = rng.permutation(large)[:4].reshape(2, 2)
            shapes = np.array(test.shapes)
            for i, j in swapped.tolist():
                shapes[[i, j]] = shapes[[j, i]]
            found = judged(structure, replace(test, shapes=shapes))
            wrong = {sheet.channels[i] for i in swapped.ravel()}
            told = {c for m in found for c in m.channels}
            cases += 1
            named += bool(told) and told <= wrong
            assert not told - wrong
            assert all(m.mac[1] > m.mac[0] for m in found)
    log.info("swapped cables: %s of %s named", named, cases)
    assert named >= 0.6 * cases


@pytest.mark.parametrize("way", SYMMETRIC)
def test_a_symmetric_structure_that_cannot_tell_says_nothing(way: str) -> None:
    rng = np.random.default_rng(14)
    sheet = sheet_of("tower")
    truth = turned(way, sheet.axes, sheet.group_of_channels(), rng)
    assert truth is not None
    assert not any(judged("tower", measured("tower", truth, rng)) for _ in range(10))
