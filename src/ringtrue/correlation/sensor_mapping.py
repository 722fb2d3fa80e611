"""From the DOFs of a model to the channels of a test: matching nodes, skewed sensors, arms.

The geometry of a test laid onto the model: best-fit rotation, shift and scale.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import permutations, product
from typing import Literal, get_args

import numpy as np
from scipy import sparse
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from ringtrue.core.arrays import Bool, Float, FrozenArrays, Int
from ringtrue.core.dofs import DofSet, parsed
from ringtrue.core.testmodel import Observation, TestModel
from ringtrue.errors import ConfigError, DataError, InputError, did_you_mean
from ringtrue.model.frames import diagonal


@dataclass(frozen=True, slots=True)
class AlignmentSearch:
    """How a placement is sought.

    Attributes
    ----------
    steps : int
        Steps from one start, at most.
    rounds : int
        Rounds of small turns out of shallow minima.
    keep : float
        Share of the points used at each step, the nearest; the rest may be gross errors (trimmed:
        Chetverikov and others, 2002).
    gross : float
        Times the rms of the nearest points: another that is farther off is set aside.
    exact : float
        Share of the size of the deck: places on a sheet are not better.
    rival : float
        A placement whose log-likelihood is within this of the best is as good.
    """

    steps: int = 100
    rounds: int = 6
    keep: float = 0.9
    gross: float = 3.0
    exact: float = 1e-3
    rival: float = 3.0


SEARCH = AlignmentSearch()

TURNS = np.deg2rad([8.0, -8.0, 20.0, -20.0])
_Motion = tuple[Float, Float]  # rotation and shift


@dataclass(frozen=True, slots=True, eq=False)
class Alignment(FrozenArrays):
    """x_target = scale · R x_source + shift.

    Attributes
    ----------
    rotation : (3, 3) float64
        Proper: no mirror image.
    shift : (3,) float64, unit of the target
    scale : float
    residual : (n,) float64, unit of the target
        Distance of each source point from its partner.
    used : (n,) bool
        False for the points set aside as gross errors.
    rivals : int
        Other placements, clearly different, that fit about as well (symmetric geometry); 0 for
        named points.
    """

    rotation: Float
    shift: Float
    scale: float
    residual: Float
    used: Bool
    rivals: int = 0

    @property
    def rms(self) -> float:
        """Root mean square of the residual of the points used."""
        used = self.residual[self.used]
        return float(np.sqrt((used**2).mean())) if used.size else float("nan")

    def __call__(self, xyz: Float) -> Float:
        """Source points (n, 3) in the target's frame and unit."""
        return self.scale * (np.asarray(xyz) @ self.rotation.T) + self.shift

    def turn(self, axes: Float) -> Float:
        """Directions (n, 3) in the target's frame."""
        return np.asarray(axes) @ self.rotation.T

    def move(self, test: TestModel) -> TestModel:
        """The test model in the frame of the target."""
        return replace(
            test,
            xyz=self(test.xyz),
            axes=self.turn(test.axes),
            force_axes=self.turn(test.force_axes),
        )


def _fit(
    source: Float, target: Float, weight: Float, scale: bool
) -> tuple[Float, Float, float]:
    """Least squares of Umeyama (1991), weighted."""
    w = weight / weight.sum()
    mean_s = w @ source
    mean_t = w @ target
    s = source - mean_s
    t = target - mean_t
    u, d, vh = np.linalg.svd((t * w[:, None]).T @ s)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vh)) or 1.0])
    rotation = (u * sign) @ vh
    spread = float(w @ (s**2).sum(axis=1))
    factor = float(d @ sign) / spread if scale and spread > 0 else 1.0
    return rotation, mean_t - factor * rotation @ mean_s, factor


def _distance(source: Float, target: Float, fit: tuple[Float, Float, float]) -> Float:
    rotation, shift, scale = fit
    return np.asarray(
        np.linalg.norm(scale * source @ rotation.T + shift - target, axis=1)
    )


def _check_points(xyz: Float, name: str) -> Float:
    xyz = np.asarray(xyz, dtype=np.float64)
    if xyz.ndim != 2 or xyz.shape[1] != 3 or not np.isfinite(xyz).all():
        raise InputError(f"{name} {xyz.shape}: must be finite (n, 3)")
    s = (
        np.linalg.svd(xyz - xyz.mean(axis=0), compute_uv=False)
        if xyz.shape[0] > 2
        else np.zeros(3)
    )
    if s[1] <= 1e-6 * s[0] or s[0] == 0:
        raise InputError(
            f"{xyz.shape[0]} {name} lie on a line or in a point: three others are needed for a "
            "rotation"
        )
    return xyz


def best_fit(source: Float, target: Float, *, scale: bool = False) -> Alignment:
    """The placement that brings named points onto their partners, robust against gross errors.

    Parameters
    ----------
    source, target : (n, 3) float64
        Row i of one belongs to row i of the other; n >= 3, not in line.
    scale : bool
        Fit a common scale too (unknown units).

    Notes
    -----
    Graduated non-convexity on truncated least squares (Yang, Antonante, Tzoumas and Carlone,
    2020): right with up to about half of the points wrong.

    Raises
    ------
    InputError
        If the points do not fix a placement.
    """
    source = _check_points(source, "source points")
    target = _check_points(target, "target points")
    if source.shape != target.shape:
        raise InputError(
            f"{source.shape[0]} source points for {target.shape[0]} target points"
        )
    weight = np.ones(source.shape[0])
    if source.shape[0] == 3:  # two cannot outvote the third
        fit = _fit(source, target, weight, scale)
        return Alignment(*fit, _distance(source, target, fit), weight > 0)
    size = float(np.sqrt(((target - target.mean(axis=0)) ** 2).sum(axis=1).mean()))
    for _ in range(SEARCH.steps):  # least absolute deviations by reweighting
        r = _distance(source, target, _fit(source, target, weight, scale))
        weight = 1 / np.maximum(r, 1e-9 * size)
        weight /= weight.max()
    # three robust standard deviations of the fit of least absolute deviations
    limit = max(3 * 1.4826 * float(np.median(r)), 1e-7 * size)
    weight = _truncated(source, target, weight, scale=scale, limit=limit)
    used = weight > 0.5
    if used.sum() < 3:
        raise InputError(
            f"only {int(used.sum())} points agree within {limit:.3g}: the names or units do not fit"
        )
    fit = _fit(source, target, used.astype(float), scale)
    return Alignment(*fit, _distance(source, target, fit), used)


def _truncated(
    source: Float, target: Float, weight: Float, scale: bool, limit: float
) -> Float:
    """Weights 0..1 of truncated least squares at `limit`."""
    r2 = _distance(source, target, _fit(source, target, weight, scale)) ** 2
    c2 = limit**2
    mu = max(c2 / max(2 * float(r2.max()) - c2, c2), 1e-12)
    for _ in range(SEARCH.steps):
        root = limit * np.sqrt(mu * (mu + 1)) / np.sqrt(np.maximum(r2, 1e-300)) - mu
        weight = np.where(
            r2 <= mu / (mu + 1) * c2,
            1.0,
            np.where(r2 >= (mu + 1) / mu * c2, 0.0, root.clip(0, 1)),
        )
        if np.count_nonzero(weight > 1e-9) < 3 or mu > 1e6:
            break
        r2 = _distance(source, target, _fit(source, target, weight, scale)) ** 2
        mu *= 1.4
    return weight


def nearest_fit(source: Float, nodes: Float) -> Alignment:
    """The placement that brings points onto their nearest nodes (iterative closest points, Besl and
    McKay, 1992).

    From the given place, from the 24 ways of laying the axes given, and the principal axes, onto
    each other, and from the best turned a little, to leave shallow minima, and about the middle of
    the nodes, for symmetric structures.

    Parameters
    ----------
    source : (n, 3) float64
        Test points, any frame.
    nodes : (k, 3) float64
        Nodes of the model where sensors can be, not fewer than the points.

    Notes
    -----
    A local method: it needs points spread over the structure as the nodes are. With `rivals`
    > 0 the geometry is symmetric and named points must decide.
    """
    source = _check_points(source, "test points")
    nodes = _check_points(nodes, "nodes")
    reached = partial(_icp, source, nodes, KDTree(nodes))
    found = [reached(start) for start in _starts(source, nodes)]
    win = min(found, key=lambda f: f.rms)
    for _ in range(SEARCH.rounds):  # out of shallow minima, until no turn helps
        best = min(map(reached, _turned(win, source)), key=lambda f: f.rms)
        if best.rms > 0.99 * win.rms:
            break
        win = best
    reach = diagonal(nodes)
    found += [win, *map(reached, _about(win, _middle(nodes)))]
    scale = max(win.rms, SEARCH.exact * reach)
    # minus the log-likelihood of the distances of all points, Cauchy: a gross error counts, but
    # not alone
    cost = np.array([np.log1p((f.residual / scale) ** 2).sum() for f in found])
    win = found[int(np.argmin(cost))]
    near = [
        f for f, c in zip(found, cost, strict=True) if c <= cost.min() + SEARCH.rival
    ]
    used = win.residual <= max(SEARCH.gross * win.rms, 1e-9 * reach)
    rivals = _distinct([f(source) for f in near], win(source), 0.02 * reach)
    return replace(win, used=used, rivals=rivals)


def _distinct(places: list[Float], first: Float, tolerance: float) -> int:
    """Number of placements that differ from `first` and from each other."""
    seen = [first]
    for p in places:
        if all(np.linalg.norm(p - q, axis=1).max() > tolerance for q in seen):
            seen.append(p)
    return len(seen) - 1


def _about(fit: Alignment, middle: Float) -> list[_Motion]:
    """The placement turned about the middle of the nodes in the 23 ways that lay the axes onto each
    other.
    """
    turns = [q for q in axis_turns() if not np.array_equal(q, np.eye(3))]
    return [(q @ fit.rotation, middle + q @ (fit.shift - middle)) for q in turns]


def _turned(fit: Alignment, source: Float) -> list[_Motion]:
    """The placement turned a little about the middle of the points."""
    middle = _middle(source)
    out = []
    pivot = fit(middle[None])[0]
    for vector in np.concatenate([s * np.eye(3) for s in TURNS]):
        turn = Rotation.from_rotvec(vector).as_matrix() @ fit.rotation
        out.append((turn, pivot - turn @ middle))
    return out


def _middle(xyz: Float) -> Float:
    """Of the box that holds nearly all points; not the mean: a mesh is finer in places."""
    low, high = np.quantile(xyz, (0.05, 0.95), axis=0)
    return np.asarray((low + high) / 2)


def _starts(source: Float, nodes: Float) -> list[_Motion]:
    out = [(np.eye(3), np.zeros(3))]
    cs = _middle(source)
    cn = _middle(nodes)
    us, un = (
        np.linalg.svd(x - x.mean(axis=0), full_matrices=False)[2]
        for x in (source, nodes)
    )
    for flip in axis_turns():
        # of the axes given, and of the principal ones
        for rotation in (flip, _proper(un).T @ flip @ _proper(us)):
            out.append((rotation, cn - rotation @ cs))
    return out


def axis_turns() -> list[Float]:
    """The 24 rotations that lay the axes onto each other."""
    every = [
        np.eye(3)[list(order)] * np.array(signs)[:, None]
        for order, signs in product(
            permutations(range(3)), product((1.0, -1.0), repeat=3)
        )
    ]
    return [q for q in every if np.linalg.det(q) > 0]


def _proper(axes: Float) -> Float:
    """Rows made a right-handed set."""
    return np.asarray(axes * np.array([[1.0], [1.0], [np.sign(np.linalg.det(axes))]]))


def _nearest(tree: KDTree, xyz: Float) -> tuple[Float, Int]:
    distance, index = tree.query(xyz)
    return np.asarray(distance), np.asarray(index)


def _icp(source: Float, nodes: Float, tree: KDTree, fit: _Motion) -> Alignment:
    count = max(4, int(np.ceil(SEARCH.keep * len(source))))
    count = min(count, len(source))
    before = np.inf
    for _ in range(SEARCH.steps):  # each step rests on the last
        rotation, shift = fit
        distance, partner = _nearest(tree, source @ rotation.T + shift)
        used = np.zeros(len(source), dtype=np.bool_)
        used[np.argsort(distance, kind="stable")[:count]] = True
        error = float((distance[used] ** 2).mean())
        if error >= before * (1 - 1e-6):
            break
        before = error
        fit = _fit(source, nodes[partner], used.astype(float), scale=False)[:2]
    rotation, shift = fit
    distance, _ = _nearest(tree, source @ rotation.T + shift)
    return Alignment(
        rotation,
        shift,
        scale=1.0,
        residual=distance,
        used=used,
    )


Method = Literal["nearest", "rigid"]


@dataclass(frozen=True, slots=True)
class SensorDistance:
    """How far a sensor may be from its node.

    Attributes
    ----------
    same : float
        Share of the tolerance: nodes that are as near.
    size : float
        Share of the size of a model, if nothing is said.
    nodes : int
        Nodes whose distances give the mesh width.
    neighbours : int
        Nodes of a rigid fit.
    extent : float
        Share of the size of a test.
    unit : float
        Times another in size: in another unit.
    """

    same: float = 1e-6
    size: float = 0.03
    nodes: int = 2000
    neighbours: int = 4
    extent: float = 0.25
    unit: float = 10.0


DISTANCE = SensorDistance()


def observe(
    test: TestModel,
    node_ids: Int,
    xyz: Float,
    dofs: DofSet,
    *,
    tolerance: float | None = None,
    unit: float = 1.0,
    method: Method = "nearest",
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
        number of the sensor's point. "rigid" fits a rigid motion to the translations of the four
        nearest nodes for sensors that are not on a node (exact for any rigid-body motion).

    Raises
    ------
    DataError
        If sensors are too far away (all are named with their distance) or a DOF they need is not in
        the model.
    ConfigError
        On an unknown method.
    """
    if method not in (known := get_args(Method)):
        raise ConfigError(
            f"no observation method {method!r}{did_you_mean(method, known)}"
        )
    at = test.channel_xyz() / unit
    k = min(DISTANCE.neighbours, len(node_ids)) if method == "rigid" else 1
    found = KDTree(xyz).query(at, k=[*range(1, k + 1)])
    distance = np.asarray(found[0], dtype=np.float64)
    nearest = np.asarray(found[1], dtype=np.int64)
    if tolerance is None:  # a test in another unit must not lie on one node
        tolerance = min(
            default_tolerance(xyz),
            DISTANCE.extent * diagonal(test.xyz) / unit or np.inf,
        )
    if k == 1:
        nearest = _by_number(
            test.at,
            at,
            np.asarray(node_ids),
            xyz=xyz,
            found=(distance, nearest),
            same=DISTANCE.same * tolerance,
        )
    if not (distance[:, 0] <= tolerance).all():
        far = _Distances(np.asarray(node_ids), xyz, nearest[:, 0], distance[:, 0])
        raise _too_far(test, far, tolerance, unit)
    weights = test.axes[:, None, :]
    if k > 1:
        weights = _rigid_weights(at, xyz[nearest], distance, test.axes)
    matrix = _matrix(weights, np.asarray(node_ids)[nearest], dofs, test.channels)
    return Observation(
        matrix=matrix,
        channels=test.channels,
        dofs=dofs,
        unit=unit,
        distance=distance[:, 0],
    )


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
    some = np.unique(np.linspace(0, len(xyz) - 1, DISTANCE.nodes).astype(np.int64))
    width = _spacing(xyz, some)
    usual = float(np.median(np.where(np.isfinite(width), width, 0.0)))
    return max(DISTANCE.size * diagonal(xyz), usual) or np.inf


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


@dataclass(frozen=True, slots=True, eq=False)
class _Distances:
    """The nodes, and of each channel which is nearest and how far."""

    ids: Int
    xyz: Float
    nearest: Int
    distance: Float


def _too_far(
    test: TestModel, found: _Distances, tolerance: float, unit: float
) -> DataError:
    """What to say of channels that are farther than the tolerance from every node."""
    ids, xyz, nearest, distance = found.ids, found.xyz, found.nearest, found.distance
    far = np.flatnonzero(~(distance <= tolerance))
    shown = "; ".join(
        f"{test.channels[i]} is {distance[i]:.4g} from node {ids[nearest[i]]}"
        for i in far[:8]
    )
    # of another unit it is far less than a distance
    extent = np.linalg.norm(np.ptp(test.channel_xyz(), axis=0)) / unit
    times = float(extent / (diagonal(xyz) or np.inf))
    mesh_width = np.minimum(_spacing(xyz, nearest[far]), DISTANCE.extent * extent)
    do = (
        f"Check the unit factor ({unit:g} m) and the origin and axes of the test model, or "
        "raise the tolerance"
    )
    if times > DISTANCE.unit or 0 < times < 1 / DISTANCE.unit**2:
        do = (
            f"The test is {times:.4g} times the model in size: places of a test are in m, the "
            f"unit of length of the model is taken for {unit:g} m (--units, [model] units)"
        )
    elif (distance[far] <= mesh_width).all():
        do = (
            "They stand between nodes of a coarse mesh: raise the tolerance (--tolerance, "
            f"[correlate] tolerance) to {1.1 * unit * distance[far].max():.2g} m; with match = "
            "rigid they read the motion of the nodes around them"
        )
    return DataError(
        f"{far.size} of {distance.size} channels are farther than {tolerance:g} (model unit) "
        f"from every node: {shown}. {do}"
    )


def _spacing(xyz: Float, nodes: Int) -> Float:
    """How far the nearest other place of a node is from each of some (n,)."""
    distance = np.reshape(
        KDTree(xyz).query(xyz[nodes], k=min(8, len(xyz)))[0], (nodes.size, -1)
    )
    return np.asarray(np.where(distance > 0, distance, np.inf).min(axis=1))


def _rigid_weights(at: Float, nodes: Float, distance: Float, axes: Float) -> Float:
    """Weights (channel, k, 3) on the nodes' translations: the rigid motion that fits them, read at
    the sensor.

    The fit is weighted by 1/distance², so a sensor on a node reads that node alone.
    """
    reach = distance[:, -1:].clip(min=np.finfo(float).tiny)
    arm = (nodes - at[:, None, :]) / reach[:, :, None]  # rotations scaled by the reach
    x = arm[..., 0]
    y = arm[..., 1]
    z = arm[..., 2]
    o = np.zeros_like(x)
    skew = np.stack(
        [np.stack([o, z, -y], -1), np.stack([-z, o, x], -1), np.stack([y, -x, o], -1)],
        -2,
    )
    # (channel, k, 3, 6)
    motion = np.concatenate([np.broadcast_to(np.eye(3), skew.shape), skew], axis=-1)
    w = 1.0 / np.maximum(distance / reach, 1e-6)  # square root of 1/distance²
    n, k = distance.shape
    fit = np.linalg.pinv(
        (motion * w[:, :, None, None]).reshape(n, 3 * k, 6), rcond=1e-9
    )
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
        raise DataError(
            f"channels of the test must be DOFs of the deck, such as 101+Z: {e}"
        ) from e
    sign = sign * dofs.per_length(unit)[index]
    pick = sparse.csr_array(
        (sign, (np.arange(index.size), index)), shape=(index.size, len(dofs))
    )
    return Observation(
        matrix=pick,
        channels=channels,
        dofs=dofs,
        unit=1.0,
        distance=np.zeros(index.size),
    )
