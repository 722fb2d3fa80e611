"""The test sheet: files that a crew takes on site.

Supports and setups: where to hang a structure, what masses do to its frequencies, and which
sensors rove where there are fewer than points.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import comb
from pathlib import Path

import numpy as np
from scipy import linalg

from ringtrue.core.arrays import Bool, Float, FrozenArrays, Int
from ringtrue.core.testmodel import TestModel
from ringtrue.errors import InputError
from ringtrue.io.files import atomic_write
from ringtrue.io.uff.functions import write_test_model
from ringtrue.virtual.measurements import direction, write_lines, write_sheet
from ringtrue.virtual.sensors import Sensor

_MOST_SETS = 100_000
SEEN = 1.0  # rms of a mode at the references, over that at all points, which is enough


@dataclass(frozen=True, slots=True, eq=False)
class Suspension(FrozenArrays):
    """Points to hang from.

    Attributes
    ----------
    points : (k,) int64
        Positions in the candidates, ascending.
    motion : float, 0..1
        Largest mean motion at the points in any target mode, over the largest at any candidate.
    steady : bool
        The vertical through the centre of gravity passes between the points.
    """

    points: Int
    motion: float
    steady: bool


def quiet(shapes: Float) -> Float:
    """Motion (n,) of each point in the mode that moves it most, squared, over the mode's largest:
    0..1.

    Parameters
    ----------
    shapes : (n, d, m) float64
        Along the directions of the suspension.
    """
    return np.asarray(_motion(shapes).max(axis=1))


def _motion(shapes: Float) -> Float:
    """(n, m) squared motion over the largest of the mode."""
    square = (np.asarray(shapes, dtype=np.float64) ** 2).sum(axis=1)
    return np.asarray(square / np.maximum(square.max(axis=0), 1e-300))


def suspension_points(
    shapes: Float, xyz: Float, count: int, cg: Float, *, min_distance: float = 0.0
) -> Suspension:
    """Points where the target modes move least, with the centre of gravity between them where
    possible.

    The quietest candidates are combined fully; a set is judged by the mode that moves its points
    most.

    Parameters
    ----------
    shapes : (n, d, m) float64
        Target modes along the directions of the suspension.
    xyz : (n, 3) float64, m
    count : int
        2 or more; with two the centre of gravity must lie on their line and the set is not steady.
    cg : (3,) float64, m
        Gravity acts along Z.
    min_distance : float, m

    Raises
    ------
    InputError
        If no set of candidates has that distance.
    """
    n = len(shapes)
    if not 1 <= count <= n:
        raise InputError(
            f"{count} suspension points of {n} candidates: must be 1 to {n}"
        )
    pool = _quiet_pool(quiet(shapes), xyz, count, min_distance)
    sets = np.array(list(combinations(pool.tolist(), count)), dtype=np.int64).reshape(
        -1, count
    )
    gap = (
        np.linalg.norm(xyz[sets][:, :, None] - xyz[sets][:, None], axis=3)
        + np.eye(count) * 1e300
    )
    sets = sets[gap.min(axis=(1, 2)) >= min_distance]
    if not sets.size:
        raise InputError(
            f"no {count} of the quietest points keep a distance of {min_distance:g} m: "
            "lower min_distance"
        )
    motion = _motion(shapes)[sets].mean(axis=1).max(axis=1)
    held = _between(xyz[sets][..., :2], np.asarray(cg, dtype=np.float64)[:2])
    best = int(np.lexsort((motion, ~held))[0])
    return Suspension(np.sort(sets[best]), float(motion[best]), bool(held[best]))


def _quiet_pool(motion: Float, xyz: Float, count: int, distance: float) -> Int:
    """The quietest points, neighbours thinned, as many as can be combined fully."""
    size = count
    while size < motion.size and comb(size + 1, count) <= _MOST_SETS:
        size += 1
    kept: list[int] = []
    # greedy by nature, stops at tens
    for i in np.argsort(motion, kind="stable").tolist():
        if (
            not kept
            or np.linalg.norm(xyz[kept] - xyz[i], axis=1).min() >= 0.5 * distance
        ):
            kept.append(i)
        if len(kept) >= size:
            break
    return np.array(kept, dtype=np.int64)


def _between(plan: Float, point: Float) -> Bool:
    """Whether `point` (2,) lies in the hull of each set of points (s, k, 2): in one of its
    triangles.
    """
    k = plan.shape[1]
    inside = np.zeros(len(plan), dtype=np.bool_)
    for tri in combinations(range(k), 3):  # a handful of points
        a, b, c = (plan[:, i] - point for i in tri)
        turns = np.stack([_cross(a, b), _cross(b, c), _cross(c, a)])
        area = np.abs(turns.sum(axis=0))
        tiny = 1e-9 * area
        inside |= ((turns >= -tiny).all(axis=0) | (turns <= tiny).all(axis=0)) & (
            area > 0
        )
    return inside


def _cross(a: Float, b: Float) -> Float:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def loaded_frequencies(frequencies: Float, shapes: Float, mass: Float) -> Float:
    """Frequencies (m,) with masses and springs added at points, Hz, by Rayleigh-Ritz on the given
    modes.

    (Λ + ΦᵀkΦ)q = λ(I + ΦᵀmΦ)q: an upper bound that the number of modes drives down; with one mode
    it is √((λ + Σkφ²)/(1 + Σmφ²)). Close modes mix, which the first-order shift -½Σmφ² of each
    alone misses.

    Parameters
    ----------
    frequencies : (m,) float64, Hz
    shapes : (n, d, m) float64, mass-normalised in SI
    mass : (n,) float64, kg
        Sensor, block and the moved part of its cable, at each point.

    Raises
    ------
    InputError
        If masses do not match the points or are negative.
    """
    added = np.asarray(mass, dtype=np.float64)
    if added.shape != (len(shapes),) or (added < 0).any():
        raise InputError(
            f"mass {added.shape}: one number >= 0 for each of {len(shapes)} points"
        )
    lam = (2 * np.pi * np.asarray(frequencies, dtype=np.float64)) ** 2
    M = np.eye(lam.size) + np.einsum("ndi,n,ndj->ij", shapes, added, shapes)
    values = linalg.eigh(np.diag(lam), M, eigvals_only=True)
    return np.sqrt(np.maximum(values, 0)) / (2 * np.pi)


@dataclass(frozen=True, slots=True, eq=False)
class Setups(FrozenArrays):
    """Which sensor is where in which setup.

    Attributes
    ----------
    setup : (n,) int64
        Of each planned sensor, 0 to count - 1; -1 where one stays as reference.
    seen : (m,) float64
        Rms of each mode at the references over that at all planned sensors.
    shift : (m,) float64
        Largest relative difference of the loaded frequency between setups; 0 without a mass of the
        sensors.
    """

    setup: Int
    seen: Float
    shift: Float

    @property
    def count(self) -> int:
        """Number of setups."""
        return int(self.setup.max(initial=0)) + 1

    @property
    def references(self) -> Int:
        """Sensors that stay, (r,)."""
        return np.flatnonzero(self.setup < 0)

    def roving(self, setup: int) -> Int:
        """Sensors that are there in this setup alone."""
        return np.flatnonzero(self.setup == setup)


def roving_setups(
    shapes: Float, xyz: Float, at_hand: int, stay: Int | None = None
) -> Setups:
    """References that see every mode, and neighbours together in each setup, as many as are at
    hand.

    References are added one at a time, each by the sum over the modes of the logarithm of what the
    references see of it, cut where that is as much as the typical point does; until all modes are
    seen so, or half of the sensors at hand stay. The others are parted along their longest axis
    until each part can be measured at once.

    Parameters
    ----------
    shapes : (n, d, m) float64
        Modes at the planned sensors, d directions each.
    xyz : (n, 3) float64, m
    at_hand : int
        Sensors that can be recorded at once, 2 to n - 1.
    stay : (k,) int64, optional
        Sensors that are references in any case, as far as half of those at hand go: at the points
        struck, so that each setup has driving points of its own.

    Raises
    ------
    InputError
        If there are not more planned sensors than at hand, or fewer than two at hand.
    """
    n = len(shapes)
    if not 2 <= at_hand < n:
        raise InputError(
            f"{at_hand} sensors at hand for {n} planned ones: setups need 2 to {n - 1}"
        )
    square = (np.asarray(shapes, dtype=np.float64) ** 2).sum(axis=1)
    share = square / np.maximum(square.mean(axis=0), 1e-300)
    most = max(1, int(0.5 * at_hand))  # of the sensors at hand, that stay at most
    chosen = [] if stay is None else list(dict.fromkeys(stay.tolist()))[:most]
    while not chosen or (
        share[chosen].mean(axis=0).min() < SEEN**2 and len(chosen) < most
    ):
        trial = (share[chosen].sum(axis=0) + share) / (len(chosen) + 1)
        gain = np.log(np.clip(trial, 1e-6, SEEN**2)).sum(axis=1)
        gain[chosen] = -np.inf
        chosen.append(int(gain.argmax()))
    setup = np.full(n, -1, dtype=np.int64)
    rest = np.setdiff1d(np.arange(n), chosen)
    room = at_hand - len(chosen)
    for k, part in enumerate(
        _parts(rest, np.asarray(xyz, dtype=np.float64), -(-rest.size // room))
    ):
        setup[part] = k
    return Setups(setup, np.sqrt(share[chosen].mean(axis=0)), np.zeros(share.shape[1]))


def _parts(at: Int, xyz: Float, count: int) -> list[Int]:
    """Sensors `at` in so many parts of as many neighbours, (each) int64."""
    if count <= 1:
        return [at]
    here = xyz[at] - xyz[at].mean(axis=0)
    axis = np.linalg.svd(here, full_matrices=False)[2][0]
    order = at[np.argsort(here @ axis, kind="stable")]
    sizes = np.full(count, at.size // count) + (np.arange(count) < at.size % count)
    left = count // 2
    cut = int(sizes[:left].sum())
    return _parts(order[:cut], xyz, left) + _parts(order[cut:], xyz, count - left)


def roving_shift(frequencies: Float, shapes: Float, mass: float, setup: Int) -> Float:
    """Largest difference of each loaded frequency between setups of moved sensors, relative, (m,).

    Parameters
    ----------
    frequencies : (m,) float64, Hz
    shapes : (n, d, m) float64, mass-normalised in SI
        All translations at each sensor.
    mass : float, kg
        Of one sensor.
    setup : (n,) int64
        The setup in which each sensor is there; -1 in all.
    """
    f = np.asarray(frequencies, dtype=np.float64)
    there = [(setup == s) | (setup < 0) for s in np.unique(setup[setup >= 0])]
    each = np.stack([loaded_frequencies(f, shapes, mass * here) for here in there])
    return np.asarray(np.ptp(each, axis=0) / np.where(f > 0, f, np.inf))


NAMES = (
    "sensors.csv",
    "lines.csv",
    "excitation.csv",
    "modes.csv",
    "geometry.uff",
    "setups.csv",
)  # of a test sheet


@dataclass(frozen=True, slots=True, eq=False)
class PlannedExcitation:
    """Where a test is struck, and what that excites.

    Attributes
    ----------
    references : tuple of str
        Channels that are struck.
    frequencies : (m,) float64, Hz
        Target modes.
    reach : (r, m) float64, 0..1
        Driving-point residue of each reference over the best of all channels.
    """

    references: tuple[str, ...]
    frequencies: Float
    reach: Float

    def __post_init__(self) -> None:
        wanted = len(self.references), self.frequencies.size
        if self.reach.shape != wanted:
            raise InputError(
                f"reach {self.reach.shape}: must be (reference, mode) = {wanted}"
            )


def write_test_sheet(
    folder: Path,
    test: TestModel,
    struck_at: PlannedExcitation,
    *,
    sensor: Sensor | None = None,
    setups: Setups | None = None,
) -> tuple[Path, ...]:
    """Write the plan of a test.

    `sensors.csv` (points, directions, channels: what `study.toml` and `read_sensor_sheet` take,
    with columns for the crew to fill in), `lines.csv`, `excitation.csv` (where to strike and in
    which direction), `modes.csv` (targets and how well they are excited) and `geometry.uff`; with
    setups, `setups.csv` (which sensor is where in each).

    Parameters
    ----------
    folder : Path
        Made if it is not there.
    test : TestModel
    struck_at : PlannedExcitation
        References are channels of `test`.
    sensor : Sensor, optional
        Planned type.
    setups : Setups, optional

    Returns
    -------
    tuple of Path
        The files.

    Raises
    ------
    InputError
        If a reference is not a channel.
    """
    references = struck_at.references
    frequencies = struck_at.frequencies
    reach = struck_at.reach
    struck = test.pick(references)
    folder.mkdir(parents=True, exist_ok=True)
    sensors, lines, excitation, modes, geometry, roving = (folder / n for n in NAMES)
    write_sheet(
        sensors, test, test.channels, [sensor] * len(test.channels) if sensor else None
    )
    write_lines(lines, test)
    _table(
        excitation,
        ("order", "reference", "point", "x", "y", "z", "direction", "best_for_hz"),
        _blows(struck, frequencies, reach),
    )
    best = reach.max(axis=0, initial=0.0)
    owner = [references[i] for i in reach.argmax(axis=0).tolist()]
    rows = zip(
        range(1, best.size + 1), frequencies.tolist(), best.tolist(), owner, strict=True
    )
    _table(
        modes,
        ("target", "frequency_hz", "reach", "best_reference"),
        [(k, f"{f:.6g}", f"{b:.3f}", o) for k, f, b, o in rows],
    )
    write_test_model(geometry, test)
    files = sensors, lines, excitation, modes, geometry
    if setups is None:
        return files
    _table(
        roving, ("setup", "sensor", "point", "channels", "stays"), _places(test, setups)
    )
    return *files, roving


def _places(test: TestModel, setups: Setups) -> list[tuple[object, ...]]:
    """A row for each sensor in each setup; those that stay come first and keep their numbers."""
    each = len(test.channels) // setups.setup.size
    out: list[tuple[object, ...]] = []
    for k in range(setups.count):
        there = [
            *((s, "yes") for s in setups.references.tolist()),
            *((s, "") for s in setups.roving(k).tolist()),
        ]
        for number, (s, stays) in enumerate(there, start=1):
            channels = " ".join(test.channels[s * each : (s + 1) * each])
            out.append((k + 1, number, int(test.at[s * each]), channels, stays))
    return out


def _blows(
    struck: TestModel, frequencies: Float, reach: Float
) -> list[tuple[object, ...]]:
    """A row for each reference: where it is, and the target modes it excites best."""
    owner = reach.argmax(axis=0)
    place = zip(
        struck.channels,
        struck.at.tolist(),
        struck.channel_xyz().tolist(),
        struck.axes,
        strict=True,
    )
    return [
        (
            k + 1,
            name,
            point,
            *(f"{v:.6g}" for v in xyz),
            direction(axis),
            " ".join(f"{f:.4g}" for f in frequencies[owner == k].tolist()),
        )
        for k, (name, point, xyz, axis) in enumerate(place)
    ]


def _table(path: Path, head: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    with (
        atomic_write(path) as part,
        part.open("w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(head)
        writer.writerows(rows)


def reach_of(shapes: Float, rows: Sequence[int]) -> Float:
    """Driving-point residue of each reference over the best of all channels, (r, m).

    Parameters
    ----------
    shapes : (channel, m) float64, mass-normalised
    rows : sequence of int
        Channels that are struck.
    """
    square = shapes**2
    return np.asarray(square[list(rows)] / np.maximum(square.max(axis=0), 1e-300))
