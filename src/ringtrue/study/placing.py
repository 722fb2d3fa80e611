"""How the sensors of a test are laid onto a deck, and which of its nodes they are read at."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from ringtrue.core.arrays import Float
from ringtrue.core.channels import other_names
from ringtrue.core.dofs import DofSet
from ringtrue.core.modes import ModeSet
from ringtrue.core.testmodel import Observation, TestModel
from ringtrue.correlation.sensor_mapping import (
    Alignment,
    Method,
    at_dofs,
    best_fit,
    default_tolerance,
    nearest_fit,
)
from ringtrue.correlation.sensor_mounting import Readings
from ringtrue.errors import DataError, InputError, about
from ringtrue.io.sheets import SensorSheet, read_sensor_sheet
from ringtrue.model.frames import diagonal, positions
from ringtrue.study.opened import ROUNDING, Opened
from ringtrue.study.results import Seat
from ringtrue.study.scene import make_scene


@dataclass(frozen=True, slots=True)
class PlacingLimits:
    """When the places of a test are questioned.

    Attributes
    ----------
    equal : float
        Share of the largest motion: nodes at one place that differ by less are the same to a
        sensor.
    bad : float
        Share of the size of the deck: a fit that is looked into.
    better : float
        Share of its error that an explanation must reach.
    off : float
        Share of the size of the deck: sensors farther from their node read another motion.
    larger : float
        Times the deck: a test that cannot lie on it.
    shared : float
        Share of the nodes of a deck: with fewer near another it is not of the same structure.
    unit : float
        Times another in size: in another unit.
    """

    equal: float = 0.05
    bad: float = 0.01
    better: float = 0.2
    off: float = 0.01
    larger: float = 1.5
    shared: float = 0.1
    unit: float = 10.0


LIMITS = PlacingLimits()

MOST_NAMED = 12  # points in a line
MESHED = 400  # points of a deck that is held against another
MIRROR = np.array([1.0, 1.0, -1.0])


def alignment(test: TestModel, opened: Opened, how: str) -> Alignment:
    """The best placement of the points of a test on the nodes of a deck, m.

    Parameters
    ----------
    how : {"points", "nearest"}
        By points that have the number of their node, or by the nearest nodes.

    Raises
    ------
    DataError
        If the points do not decide: too few have the number of a node, or the geometry is
        symmetric; or if they have another unit of length, or left-handed axes.
    """
    nodes = positions(opened.model) * opened.length
    ids = opened.model["GRID"].ids
    if how == "nearest":
        # most points, those nearest to their median: a wrong place says nothing of the unit
        distance = np.linalg.norm(test.xyz - np.median(test.xyz, axis=0), axis=1)
        most = np.argsort(distance, kind="stable")[: int(np.ceil(0.9 * len(test.xyz)))]
        times = diagonal(test.xyz[most]) / diagonal(nodes)
        if times > LIMITS.larger:
            raise DataError(f"correlate.align nearest: {_other_size(times)}")
        found = nearest_fit(test.xyz, nodes)
        off = _off(found)
        if off >= LIMITS.bad * diagonal(nodes):
            mirrored = _off(nearest_fit(test.xyz * MIRROR, nodes))
            if mirrored < LIMITS.better * off:
                raise DataError(f"correlate.align nearest: {_mirrored(off, mirrored)}")
        if found.rivals:
            raise DataError(
                f"correlate.align nearest: {found.rivals} other placements fit as well, the "
                "geometry is symmetric; "
                'number three points or more by their nodes and use align = "points"'
            )
        return found
    same, of_test, of_deck = np.intersect1d(test.points, ids, return_indices=True)
    if same.size < 3:
        raise DataError(
            f"correlate.align points: {same.size} points have the number of a node; three or "
            "more decide"
        )
    found = best_fit(test.xyz[of_test], nodes[of_deck])
    _look_into(found, test.xyz[of_test], nodes[of_deck])
    return found


def _look_into(found: Alignment, points: Float, nodes: Float) -> None:
    """Refuse a poor fit that another unit or a mirror image explains."""
    off = _off(found)
    if off < LIMITS.bad * diagonal(nodes):
        return
    try:
        sized = best_fit(points, nodes, scale=True)
        mirrored = best_fit(points * MIRROR, nodes)
    except InputError:  # neither fits
        return
    if _off(sized) < LIMITS.better * off:
        raise DataError(f"correlate.align points: {_other_size(1 / sized.scale)}")
    if _off(mirrored) < LIMITS.better * off:
        raise DataError(f"correlate.align points: {_mirrored(off, _off(mirrored))}")


def _mirrored(off: float, mirrored: float) -> str:
    return (
        f"the points are a mirror image of their nodes ({1e3 * off:.3g} mm off, "
        f"{1e3 * mirrored:.3g} mm when "
        "mirrored): the axes of the test are left-handed, turn one of them and the directions "
        "along it"
    )


def _off(fit: Alignment) -> float:
    """Root mean square distance of all points, those set aside, too."""
    return float(np.sqrt((fit.residual**2).mean()))


def _other_size(times: float) -> str:
    return (
        f"the points of the test span {times:.4g} times the nodes of the deck: "
        "places on a sensor sheet "
        "are in m, those of the deck in the unit that [model] units names"
    )


def alignment_text(found: Alignment) -> str:
    """The placement in alignment_text."""
    angle = round(
        float(
            np.degrees(
                np.arccos(np.clip((np.trace(found.rotation) - 1) / 2, -1.0, 1.0))
            )
        ),
        3,
    )
    x, y, z = (np.round(found.shift, 6) + 0.0).tolist()  # to the micrometre
    lost = int((~found.used).sum())
    return (
        f"the points of the test were turned by {angle:.3g}° and moved by ({x:.4g}, {y:.4g}, "
        f"{z:.4g}) m onto the deck; "
        f"{int(found.used.sum())} of them fit within {round(1e3 * found.rms, 3):.3g} mm"
        + (f", {lost} do not and were set aside" if lost else "")
    )


def shared_places(opened: Opened, test: TestModel, modes: ModeSet) -> tuple[str, ...]:
    """A note on points at whose place the deck has several nodes that do not move as one, as at
    a joint.

    Points that have the number of one of them are read there.

    Parameters
    ----------
    opened : Opened
    test : TestModel
        In the frame of the deck, m.
    modes : ModeSet
        Shapes at the degrees of freedom of the embedded solver.
    """
    ids, xyz = opened.seats
    points, first = np.unique(test.at, return_index=True)
    place = test.channel_xyz()[first] / opened.length
    tree = KDTree(xyz)
    nearest = xyz[tree.query(place)[1]]
    shared = [
        (point, some)
        for point, at in zip(
            points.tolist(),
            tree.query_ball_point(nearest, ROUNDING * diagonal(xyz)),
            strict=True,
        )
        if point not in (some := sorted(ids[at].tolist()))
        and _apart(opened.dofs, some, modes.shapes)
    ]
    if not shared:
        return ()
    named = " ".join(str(point) for point, _ in shared[:MOST_NAMED]) + (
        " ..." if len(shared) > MOST_NAMED else ""
    )
    point, some = shared[0]
    return (
        f"point {named}: nodes that do not move together are at the place "
        f"({' and '.join(map(str, some))} at point "
        f"{point}), and one of them is read; give the point the number of its node, or a place "
        "near the joint",
    )


def between_nodes(opened: Opened, seen: Observation, match: Method) -> tuple[str, ...]:
    """A note on sensors that stand between the nodes, where the nearest one is read for each."""
    if match != "nearest":
        return ()
    far = seen.distance > LIMITS.off * diagonal(opened.seats[1])
    if not far.any():
        return ()
    return (
        f"{far.sum()} of {far.size} channels are read at a node up to "
        f"{opened.length * seen.distance.max():.2g} m from "
        "their sensor, which lowers the MAC of shapes with short waves: with match = rigid "
        "([correlate] match, "
        "--match) they read the motion of the nodes around them",
    )


def _apart(dofs: DofSet, nodes: Sequence[int], shapes: Float) -> bool:
    """Whether in any mode (dof, mode) nodes at one place move differently by a share of its largest
    translation.
    """
    row = dofs.find(np.repeat(nodes, 3), np.tile([1, 2, 3], len(nodes)))
    motion = np.where(row[:, None] < 0, 0.0, shapes[row]).reshape(len(nodes), 3, -1)
    largest = np.abs(shapes[np.abs(dofs.direction) <= 3]).max(axis=0, initial=0.0)
    return bool((np.ptp(motion, axis=0) > LIMITS.equal * largest).any())


def placed(
    opened: Opened,
    channels: Sequence[str],
    sheet: Path | SensorSheet | TestModel | None,
    *,
    tolerance: float | None = None,
    method: Method = "nearest",
    dofs: DofSet | None = None,
) -> Observation:
    """The channels of a test on a deck: by their places on a sensor sheet, or as DOFs of the deck
    without one.

    The one resolver of channel names. On a sheet `4-X` is the sensor `4+X` read the other way, and
    a name that the sheet does not have is refused: point numbers of a test are not those of nodes.

    Parameters
    ----------
    opened : Opened
    channels : sequence of str
    sheet : Path, SensorSheet or TestModel, optional
    tolerance : float, m, optional
        Largest distance of a sensor from its node; `default_tolerance` if not given.
    method : str
        As in `correlate.observe`.
    dofs : DofSet, optional
        Rows of the shapes that it reads, those of the embedded solver if not given.

    Raises
    ------
    DataError
        If a channel is neither on the sheet nor a DOF of the deck, or is too far from it.
    """
    if sheet is None:
        try:
            return at_dofs(
                tuple(channels), opened.dofs if dofs is None else dofs, opened.length
            )
        except DataError as e:
            raise DataError(
                f"{e}; where points have numbers of their own give --sensors, or [test] sheet of "
                "a study"
            ) from e
    with about(sheet) if isinstance(sheet, Path) else nullcontext():
        test = sheet if isinstance(sheet, TestModel) else _motions(sheet, channels)
        here = test.pick(tuple(channels))
    return opened.observation(here, tolerance, method, dofs=dofs)


def readings(
    test: ModeSet,
    modes: ModeSet,
    sheet: TestModel,
    seen: Callable[[TestModel], Observation],
) -> Readings:
    """Test modes and those of a deck, with what the deck does along all axes of the sheet at
    each sensor.

    Parameters
    ----------
    test : ModeSet
        At channels of the sheet.
    modes : ModeSet
        Of the deck, at the degrees of freedom of the embedded solver.
    sheet : TestModel
        In its own frame.
    seen : callable
        The bridge from the deck to channels in the frame of the sheet.
    """
    here = sheet.pick(test.channels)
    motion = seen(here.threefold())(modes.shapes).reshape(3, len(here.channels), -1)
    return Readings(
        test, modes.frequencies, motion, here.axes, here.group_of_channels()
    )


def _motions(sheet: Path | SensorSheet, channels: Sequence[str]) -> TestModel:
    """The test model of a sheet, none of whose `channels` measures strain."""
    found = read_sensor_sheet(sheet) if isinstance(sheet, Path) else sheet
    names = found.model.named(channels)[0]
    if strain := [
        c for c, name in zip(channels, names, strict=True) if name in found.strain
    ]:
        raise DataError(
            f"channel {' '.join(strain[:8])} measures strain: take it out of the modes of the test"
        )
    return found.model


def node_points(opened: Opened, channels: Sequence[str]) -> TestModel:
    """Channels that are translations of nodes (`101+Z`) as points with a direction each."""
    dofs = DofSet.parse(channels)
    along = np.abs(dofs.direction)
    kept = np.flatnonzero((along >= 1) & (along <= 3))
    node = dofs.node[kept]
    points = np.unique(node)
    grid = opened.model["GRID"]
    return TestModel(
        points=points,
        xyz=positions(opened.model)[grid.find(points)] * opened.length,
        channels=tuple(channels[k] for k in kept.tolist()),
        at=node,
        axes=np.eye(3)[along[kept] - 1] * np.sign(dofs.direction[kept])[:, None],
        lines=np.zeros((0, 2), dtype=np.int64),
    )


def mesh_points(opened: Opened) -> TestModel:
    """Nodes that are drawn of a deck and move, `MESHED` at most all over it, as points with three
    directions each.
    """
    scene = make_scene(opened.model, {}, opened.length)
    drawn = np.flatnonzero(np.isin(scene.node, opened.model["GRID"].ids[opened.moves]))
    at = drawn[
        np.unique(
            np.linspace(0, drawn.size - 1, min(MESHED, drawn.size)).astype(np.int64)
        )
    ]
    node = scene.node[at]
    axes = np.tile(np.eye(3), (at.size, 1))
    channels = tuple(f"{n}+{a}" for n in node.tolist() for a in "XYZ")
    return TestModel(
        points=node,
        xyz=scene.xyz[at],
        channels=channels,
        at=np.repeat(node, 3),
        axes=axes,
        lines=np.zeros((0, 2), dtype=np.int64),
    )


def near_mesh(
    test: TestModel, opened: Opened, tolerance: float | None
) -> tuple[TestModel, float]:
    """The channels of a test that are near a node of a deck, and what is near, m: `tolerance` or
    the default one.
    """
    xyz = opened.seats[1] * opened.length
    one = diagonal(test.xyz)
    other = diagonal(xyz)
    if min(one, other) > 0 and max(one, other) > LIMITS.unit * min(one, other):
        raise DataError(
            f"the one deck is {one:.3g} m in size, the other {other:.3g} m: check --units"
        )
    tree = KDTree(xyz)
    reach = default_tolerance(xyz) if tolerance is None else tolerance
    near = np.asarray(tree.query(test.channel_xyz())[0] <= reach)
    if near.mean() < LIMITS.shared:
        raise DataError(
            f"{100 * near.mean():.0f} % of the nodes of the one deck are within {reach:.3g} m of "
            "a node of the other: "
            "check their origins; of a whole and its part name the part first"
        )
    return test.pick(
        tuple(c for c, yes in zip(test.channels, near.tolist(), strict=True) if yes)
    ), reach


def seats(seen: Observation, sheet: TestModel) -> tuple[Seat, ...]:
    """Where each channel of a test is read.

    Parameters
    ----------
    seen : Observation
        Of the channels on a deck.
    sheet : TestModel
        Where they are found.
    """
    index, sign = sheet.find(seen.channels)
    names = (*sheet.channels, *sheet.forces)
    points = np.concatenate([sheet.at, sheet.force_at])[index].tolist()
    out = []
    for k, channel in enumerate(seen.channels):  # hundreds
        columns = seen.matrix.indices[seen.matrix.indptr[k] : seen.matrix.indptr[k + 1]]
        nodes = tuple(np.unique(seen.dofs.node[columns]).tolist())
        far = float(seen.distance[k] * seen.unit)
        out.append(
            Seat(
                channel=channel,
                sensor=names[index[k]],
                sign=int(sign[k]),
                point=points[k],
                nodes=nodes,
                distance=far,
            )
        )
    return tuple(out)


def seats_json(found: Sequence[Seat]) -> list[dict[str, Any]]:
    """Plain values."""
    return [
        {
            "channel": s.channel,
            "sensor": s.sensor,
            "sign": s.sign,
            "point": s.point,
            "nodes": list(s.nodes),
            "distance_m": s.distance,
        }
        for s in found
    ]


def seat_words(found: Sequence[Seat]) -> tuple[str, ...]:
    """The map from points to nodes, and channels that the sheet has by another name, a line
    each.
    """
    if not found:
        return ()
    at = {s.point: s for s in found}
    other = [s for s in at.values() if s.nodes != (s.point,)]
    line = f"{len(at) - len(other)} of {len(at)} points are read at the node of their number"
    if other:
        pairs = [
            f"{s.point} -> {'+'.join(map(str, s.nodes))}" for s in other[:MOST_NAMED]
        ]
        line += "; point -> node: " + ", ".join(pairs)
    if len(other) > MOST_NAMED:
        line += f" and {len(other) - MOST_NAMED} more (--json, summary.json)"
    line += f"; at most {max(s.distance for s in found):.2g} m away"
    names = [s.channel for s in found], [s.sensor for s in found]
    return line, *other_names(*names, [s.sign for s in found])
