"""From the DOFs of a model to the channels of a test: matching nodes, skewed sensors, arms."""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy import sparse
from scipy.spatial import KDTree

from ringtrue.core.arrays import Float, Int
from ringtrue.core.dofs import DofSet, parsed
from ringtrue.core.observation import Observation
from ringtrue.core.testmodel import TestModel
from ringtrue.errors import ConfigError, DataError, InputError, did_you_mean
from ringtrue.model.frames import diagonal

Method = Literal["nearest", "rigid"]
SAME = 1e-6  # of the tolerance: nodes that are as near
OF_SIZE = 0.03  # of the size of a model: as far a sensor may be from its node, if nothing is said
SOME = 2000  # nodes that tell how far nodes are apart
_OF_EXTENT = 0.25  # of the size of a test
UNLIKE = 10.0  # times another in size: in another unit


def observe(
    test: TestModel,
    node_ids: Int,
    xyz: Float,
    dofs: DofSet,
    *,
    tolerance: float | None = None,
    unit: float = 1.0,
    method: Method = "nearest",
    neighbours: int = 4,
) -> Observation:
    """Match the channels of a test with a model.

    Parameters
    ----------
    test : TestModel
        In metres.
    node_ids : (n,) int64
        Nodes that a sensor may sit on.
    xyz : (n, 3) float64, model unit, basic frame
    dofs : DofSet
        Rows of the model's shapes, basic frame.
    tolerance : float, model unit, optional
        A sensor farther than this from every node is an error. If not given `default_tolerance`,
        and no more than a quarter of the size of the test.
    unit : float
        Model length unit in metres (mm-t-s: 1e-3).
    method : {"nearest", "rigid"}
        "nearest" takes the translations of the nearest node, of several at one place that with the
        number of the sensor's point. "rigid" fits a rigid motion to the translations of the
        `neighbours` nearest nodes for sensors that are not on a node (exact for any rigid-body
        motion).
    neighbours : int
        Nodes of the rigid fit, 3 or more.

    Raises
    ------
    DataError
        If sensors are too far away (all are named with their distance) or a DOF they need is not in
        the model.
    ConfigError
        On an unknown method or too few neighbours.
    """
    if method not in ("nearest", "rigid"):
        raise ConfigError(
            f"no observation method {method!r}{did_you_mean(method, ('nearest', 'rigid'))}"
        )
    if method == "rigid" and neighbours < 3:
        raise ConfigError(
            f"{neighbours} neighbours cannot fix a rigid motion; allowed are 3 and more"
        )
    at = test.channel_xyz() / unit
    k = min(neighbours, len(node_ids)) if method == "rigid" else 1
    found = KDTree(xyz).query(at, k=[*range(1, k + 1)])
    distance, nearest = np.asarray(found[0], dtype=np.float64), np.asarray(found[1], dtype=np.int64)
    if tolerance is None:  # a test in another unit must not lie on one node
        tolerance = min(default_tolerance(xyz), _OF_EXTENT * diagonal(test.xyz) / unit or np.inf)
    if k == 1:
        nearest = _by_number(
            test.at, at, np.asarray(node_ids), xyz, (distance, nearest), SAME * tolerance
        )
    _refuse_far(test, distance[:, 0], tolerance, np.asarray(node_ids), xyz, nearest[:, 0], unit)
    weights = (
        _rigid_weights(at, xyz[nearest], distance, test.directions())
        if k > 1
        else test.directions()[:, None, :]
    )
    matrix = _matrix(weights, np.asarray(node_ids)[nearest], dofs, test.channels)
    return Observation(matrix, test.channels, dofs, unit, distance[:, 0])


def default_tolerance(xyz: Float) -> float:
    """How far a sensor may be from its node where nothing is said: 3 % of the size of a model, or a
    mesh width.

    Parameters
    ----------
    xyz : (n, 3) float64, model unit
        All nodes that a sensor may sit on; the size is the diagonal of the box about them, the mesh
        width the median distance of a node from its nearest neighbour. Nodes at one place tell no
        size: no sensor is too far from them.
    """
    some = np.unique(np.linspace(0, len(xyz) - 1, SOME).astype(np.int64))
    width = _spacing(xyz, some)
    return (
        max(OF_SIZE * diagonal(xyz), float(np.median(np.where(np.isfinite(width), width, 0.0))))
        or np.inf
    )


def _by_number(
    points: Int, at: Float, ids: Int, xyz: Float, found: tuple[Float, Int], same: float
) -> Int:
    """The nearest nodes (channel, 1): where the node that bears the number of the point is as near,
    that one.
    """
    distance, nearest = found
    order = np.argsort(ids, kind="stable")
    own = order[np.searchsorted(ids, points, sorter=order).clip(max=ids.size - 1)]
    near = np.linalg.norm(xyz[own] - at, axis=1) <= distance[:, 0] + same
    return np.where((ids[own] == points) & near, own, nearest[:, 0])[:, None]


def _refuse_far(
    test: TestModel,
    distance: Float,
    tolerance: float,
    ids: Int,
    xyz: Float,
    nearest: Int,
    unit: float,
) -> None:
    far = np.flatnonzero(~(distance <= tolerance))
    if not far.size:
        return
    shown = "; ".join(
        f"{test.channels[i]} is {distance[i]:.4g} from node {ids[nearest[i]]}"
        for i in far[:8].tolist()
    )
    extent = (
        np.linalg.norm(np.ptp(test.channel_xyz(), axis=0)) / unit
    )  # of another unit it is far less than a distance
    times = float(extent / (diagonal(xyz) or np.inf))
    between = bool(
        (distance[far] <= np.minimum(_spacing(xyz, nearest[far]), _OF_EXTENT * extent)).all()
    )
    do = (
        "They stand between nodes of a coarse mesh: raise the tolerance (--tolerance, "
        "[correlate] tolerance) to "
        f"{1.1 * unit * distance[far].max():.2g} m; with match = rigid they read the motion of "
        "the nodes around them"
        if between
        else f"Check the unit factor ({unit:g} m) and the origin and axes of the test model, or "
        "raise the tolerance"
    )
    if times > UNLIKE or 0 < times < 1 / UNLIKE**2:
        do = (
            f"The test is {times:.4g} times the model in size: places of a test are in m, the "
            "unit of length of "
            f"the model is taken for {unit:g} m (--units, [model] units)"
        )
    raise DataError(
        f"{far.size} of {distance.size} channels are farther than {tolerance:g} (model unit) "
        f"from every node: {shown}. "
        f"{do}"
    )


def _spacing(xyz: Float, nodes: Int) -> Float:
    """How far the nearest other place of a node is from each of some (n,)."""
    apart = np.reshape(KDTree(xyz).query(xyz[nodes], k=min(8, len(xyz)))[0], (nodes.size, -1))
    return np.asarray(np.where(apart > 0, apart, np.inf).min(axis=1))


def _rigid_weights(at: Float, nodes: Float, distance: Float, axes: Float) -> Float:
    """Weights (channel, k, 3) on the nodes' translations: the rigid motion that fits them, read at
    the sensor.

    The fit is weighted by 1/distance², so a sensor on a node reads that node alone.
    """
    reach = distance[:, -1:].clip(min=np.finfo(float).tiny)
    arm = (nodes - at[:, None, :]) / reach[:, :, None]  # rotations scaled by the reach
    x, y, z = arm[..., 0], arm[..., 1], arm[..., 2]
    o = np.zeros_like(x)
    skew = np.stack(
        [np.stack([o, z, -y], -1), np.stack([-z, o, x], -1), np.stack([y, -x, o], -1)], -2
    )
    motion = np.concatenate(
        [np.broadcast_to(np.eye(3), skew.shape), skew], axis=-1
    )  # (channel, k, 3, 6)
    w = 1.0 / np.maximum(distance / reach, 1e-6)  # square root of 1/distance²
    n, k = distance.shape
    fit = np.linalg.pinv((motion * w[:, :, None, None]).reshape(n, 3 * k, 6), rcond=1e-9)
    read = np.einsum("ca,cak->ck", axes, fit[:, :3]).reshape(n, k, 3)
    return np.asarray(read * w[:, :, None])


def _matrix(
    weights: Float, nodes: Int, dofs: DofSet, channels: tuple[str, ...]
) -> sparse.csr_array:
    channel, _, axis = (np.asarray(i) for i in np.indices(weights.shape))
    node = np.broadcast_to(nodes[:, :, None], weights.shape)
    keep = np.abs(weights) > 1e-14
    column = dofs.find(node[keep], axis[keep] + 1)
    lost = np.flatnonzero(column < 0)
    if lost.size:
        i = int(lost[0])
        name = f"{int(node[keep][i])}+{'XYZ'[int(axis[keep][i])]}"
        raise DataError(
            f"channel {channels[int(channel[keep][i])]} needs DOF {name}, "
            f"which is not in the model's shapes ({lost.size} such DOFs)"
        )
    sign = np.where(dofs.direction[column] < 0, -1.0, 1.0)
    entries = (weights[keep] * sign, (channel[keep], column))
    return sparse.csr_array(sparse.coo_array(entries, shape=(len(channels), len(dofs))))


def at_dofs(channels: tuple[str, ...], dofs: DofSet, unit: float = 1.0) -> Observation:
    """The observation of channels whose names are DOFs, such as 101+Z; 101+Z and 101-Z may both be
    among them.

    Rotations, 101+RX, are those of shapes in metres: by `unit`, metres a model unit, they compare
    with translations.

    Raises
    ------
    DataError
        If a name is no DOF of the model.
    """
    try:
        index, sign = dofs.signed(*parsed(channels))
    except InputError as e:
        raise DataError(f"channels of the test must be DOFs of the deck, such as 101+Z: {e}") from e
    sign = sign * dofs.per_length(unit)[index]
    pick = sparse.csr_array((sign, (np.arange(index.size), index)), shape=(index.size, len(dofs)))
    return Observation(pick, channels, dofs, 1.0, np.zeros(index.size))
