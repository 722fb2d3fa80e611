"""A model opened in its solver: its modes, its reduced model over parameters, and its drawing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.spatial import KDTree

from ringtrue.checks.materials import mass_properties
from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.core.dofs import DofSet
from ringtrue.core.iterate import Progress, part
from ringtrue.core.modes import ModeSet, elastic
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.testmodel import Observation, TestModel
from ringtrue.correlation.sensor_mapping import Method, observe
from ringtrue.eigen.shift import low_shift
from ringtrue.errors import NotConverged
from ringtrue.fem.loads import FACES, SURFACES
from ringtrue.model.frames import diagonal, positions
from ringtrue.model.model import Model
from ringtrue.model.ports import Linearisation, ModalSolver, ModesRequest, ModesResult
from ringtrue.model.superelements import whole_mesh
from ringtrue.reduction.basis import observed_system
from ringtrue.reduction.matrix_model import MatricesAtPoint, matrices_at
from ringtrue.reduction.parametric import KnownModes, ReducedModel, reduced_model
from ringtrue.reduction.response import with_responses
from ringtrue.solvers.embedded import EmbeddedAnalysis, EmbeddedSolver
from ringtrue.study.results import Scene
from ringtrue.updating.residuals.modal import Whole
from ringtrue.updating.selection.candidates import Candidate, CandidateSettings
from ringtrue.updating.selection.generation import lumped, places

ROUNDING = 1e-6  # of the size of the structure: nodes closer than this are at one place


@dataclass(eq=False)
class Opened:
    """A model and its analysis, assembled and factored when first asked for.

    Attributes
    ----------
    model : Model
    length : float
        Metres a model unit.
    engine : ModalSolver, optional
        Finds the modes in place of the embedded solver; matrices are the embedded solver's in any
        case.
    """

    model: Model
    length: float
    engine: ModalSolver | None = None

    @cached_property
    def analysis(self) -> EmbeddedAnalysis:
        """The embedded solver's view, of the whole mesh."""
        return EmbeddedSolver().open(whole_mesh(self.model))

    @cached_property
    def _modes(self) -> dict[float, ModesResult]:
        return {}

    def extended(self, model: Model) -> Opened:
        """The same for a model with further cards that change no matrix; nothing is solved anew."""
        made = Opened(model, self.length, self.engine)
        made.__dict__ |= {"analysis": self.analysis, "_modes": self._modes}
        return made

    def modes(self, fmax: float, progress: Progress | None = None) -> ModesResult:
        """All modes below `fmax`, Hz (`ModesResult`), solved once."""
        if fmax not in self._modes:
            request = ModesRequest(band=(-1.0, fmax))
            own = self.engine is None
            self._modes[fmax] = (
                self.analysis.modes(request, progress) if own else self._outside(request)
            )
        return self._modes[fmax]

    def _outside(self, request: ModesRequest) -> ModesResult:
        """By another solver, at the degrees of freedom of the embedded one."""
        assert self.engine is not None
        with self.engine.open(whole_mesh(self.model)) as analysis:
            found = analysis.modes(request)
        labels = found.modes.labels
        dofs = self.analysis.dofs
        assert isinstance(labels, DofSet)
        at, sign = labels.align(dofs)
        shapes = found.modes.shapes[at] * sign[:, None]
        return replace(found, modes=replace(found.modes, shapes=shapes, labels=dofs))

    @cached_property
    def seats(self) -> tuple[Int, Float]:
        """Nodes that a sensor may sit on, (n,), and where they are, (n, 3), model unit.

        A spring of no length to the ground has two nodes at one place; a sensor there sits on the
        one that moves.
        """
        ids = self.model["GRID"].ids
        xyz = positions(self.model)
        moves = self.moves
        keep = moves.copy()
        if moves.any() and not moves.all():
            size = diagonal(xyz)
            keep[~moves] = KDTree(xyz[moves]).query(xyz[~moves])[0] > ROUNDING * size
        return (ids[keep], xyz[keep]) if keep.any() else (ids, xyz)

    @property
    def moves(self) -> Bool:
        """Whether any translation of a node is neither held nor without stiffness, (node,)."""
        system = self.analysis.system
        n = len(self.model["GRID"].ids)
        return np.asarray(
            (np.diff(system.transform.indptr)[: 6 * n].reshape(n, 6)[:, :3] > 0).any(axis=1)
        )

    def observation(
        self,
        test: TestModel,
        tolerance: float | None = None,
        method: Method = "nearest",
        *,
        dofs: DofSet | None = None,
    ) -> Observation:
        """The bridge to the channels of a test.

        Parameters
        ----------
        test : TestModel
        tolerance : float, m, optional
        method : str
            As in `correlate.observe`.
        dofs : DofSet, optional
            Rows of the shapes that it reads, those of the embedded solver if not given.
        """
        return observe(
            test,
            *self.seats,
            self.analysis.dofs if dofs is None else dofs,
            unit=self.length,
            tolerance=None if tolerance is None else tolerance / self.length,
            method=method,
        )


CLOSE = 2e-3  # largest relative error of a frequency of the reduced model that is accepted
ROUNDS = 4


@dataclass(frozen=True, slots=True, eq=False)
class AtChannels:
    """A reduced model at some rows of its channels.

    Attributes
    ----------
    model : ReducedModel
    rows : (channel,) int64
        Those that test modes are compared at.
    loaded : (l,) int64
        Those whose static responses the basis holds at every point where the full model is solved.
    """

    model: ReducedModel
    rows: Int
    loaded: Int = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    @property
    def parameters(self) -> ParameterSet:
        """The active parameters."""
        return self.model.parameters

    def with_parameters(self, active: Sequence[int], base: Float | None = None) -> AtChannels:
        """The same with other active parameters, by position among all; a short `base` is filled up
        with zeros.
        """
        if base is not None:
            base = np.concatenate([base, np.zeros(len(self.model.system.parameters) - base.size)])
        return replace(self, model=self.model.with_parameters(active, base))

    def whole(self) -> Whole:
        """All modes of the basis at all channels."""
        every = replace(
            self, model=self.model.whole(), rows=np.arange(self.model.basis.observe.shape[0])
        )
        return Whole(every, self.rows, self.model.count)

    def matrices(self, x: Float) -> MatricesAtPoint:
        """Small matrices at x, at all channels."""
        return matrices_at(self.model, x)

    def enrich(self, x: Float, *, sensitivities: bool = False) -> tuple[AtChannels, Linearisation]:
        """The model with its full modes at x, and these; static responses of the loaded channels,
        too.
        """
        better, truth = self.model.enrich(x, sensitivities=sensitivities)
        if self.loaded.size:
            better, _ = with_responses(better, self.loaded, x)
        return replace(self, model=better), self._pick(truth)

    def _pick(self, point: Linearisation) -> Linearisation:
        return replace(point, shapes=point.shapes[self.rows], d_shapes=point.d_shapes[self.rows])

    def linearise(self, x: Float) -> Linearisation:
        """Modes and sensitivities at x."""
        return self._pick(self.model.linearise(x))

    def modes(self, x: Float) -> Linearisation:
        """Modes at x."""
        return self._pick(self.model.modes(x))


def build(
    opened: Opened,
    parameters: ParameterSet,
    observation: Observation,
    fmax: float,
    progress: Progress,
) -> ReducedModel:
    """Assemble, differentiate and project: all modes below `fmax` with every parameter."""
    system = opened.analysis.system
    early = part(progress, 0.0, 0.4)
    affine = observed_system(opened.model, system, parameters, observation, progress=early)
    count = len(opened.modes(fmax).modes)
    late = part(progress, 0.4, 1.0)
    pencil = opened.analysis.pencil
    known = KnownModes(pencil, shift=low_shift(pencil, fmax))
    return reduced_model(affine, count, known=known, progress=late)


def verified(model: AtChannels, x: Float) -> tuple[AtChannels, float]:
    """The model enriched by a full solution at x, and the largest relative error it had there.

    Of a frequency, or of the flexibility between the loaded channels.
    """
    before = model.model.modes(x)
    better, truth = model.model.enrich(x)
    error = frequency_error(before.frequencies, truth.frequencies)
    soft = 0.0
    if model.loaded.size:
        better, soft = with_responses(better, model.loaded, x)
    return replace(model, model=better), max(error, soft)


def frequency_error(found: Float, truth: Float) -> float:
    """Largest relative error of the elastic frequencies that a reduced and a full model have in
    common.
    """
    n = min(found.size, truth.size)
    moving = elastic(truth)[:n]
    return float(np.abs(found[:n][moving] / truth[:n][moving] - 1).max(initial=0.0))


def not_verified(error: float) -> NotConverged:
    """The error of a reduced model that does not follow the full one."""
    return NotConverged(
        f"the reduced model is off by {100 * error:.2g} % after {ROUNDS} enrichments (allowed "
        f"{100 * CLOSE:.2g} %): "
        "tighten the bounds of the parameters"
    )


_SURFACES = {card: ((0, 1, 2),) if "TRIA" in card else ((0, 1, 2, 3),) for card in SURFACES}
_LINES = {
    "CBAR": ("GA", "GB"),
    "CBEAM": ("GA", "GB"),
    "CBEND": ("GA", "GB"),
    "CROD": ("G1", "G2"),
    "CONROD": ("G1", "G2"),
    "CTUBE": ("G1", "G2"),
}
_JOINTS = {
    "CBUSH": ("GA", "GB"),
    "CBUSH1D": ("GA", "GB"),
    "CGAP": ("GA", "GB"),
    "CELAS1": ("G1", "G2"),
    "CELAS2": ("G1", "G2"),
    "CVISC": ("G1", "G2"),
}


def _faces(model: Model) -> tuple[Int, Int]:
    """Quads (q, 4) of node numbers and their property numbers, inner faces of solids left out."""
    solid: list[Int] = []
    shell: list[Int] = []
    for card, faces in (FACES | _SURFACES).items():
        if card not in model:
            continue
        t = model[card]
        g = t.stack(*(f"G{i + 1}" for i in range(1 + max(max(f) for f in faces))))
        quads = np.concatenate([np.column_stack([g[:, (*f, f[-1])[:4]], t["PID"]]) for f in faces])
        (shell if len(faces) == 1 else solid).append(quads)
    kept = shell
    if solid:
        q = np.concatenate(solid)
        key = np.sort(
            np.where(q[:, 3:4] == q[:, 2:3], q[:, [0, 1, 2, 4]] * [1, 1, 1, 0], q[:, :4]), axis=1
        )
        _, first, count = np.unique(key, axis=0, return_index=True, return_counts=True)
        kept = [q[np.sort(first[count == 1])], *shell]
    every = np.concatenate(kept) if kept else np.zeros((0, 5), dtype=np.int64)
    return every[:, :4], every[:, 4]


def _ends(model: Model, cards: Mapping[str, tuple[str, str]]) -> Int:
    """Ends and property number (l, 3); 0 for what has no property."""
    tables = [(model[c], names) for c, names in cards.items() if c in model]
    rows = [
        np.column_stack([t.stack(*names), t["PID"] if "PID" in t.columns else 0 * t.ids])
        for t, names in tables
    ]
    return np.concatenate(rows) if rows else np.zeros((0, 3), dtype=np.int64)


def _lines(model: Model) -> tuple[Int, Int]:
    """Lines (l, 2) and property numbers; of a joint of no length or to the ground its ends, as
    points.
    """
    lines = _ends(model, _LINES)
    joints = _ends(model, _JOINTS)
    xyz = positions(model)
    at = model["GRID"].find(joints[:, :2])
    length = np.linalg.norm(xyz[at[:, 0]] - xyz[at[:, 1]], axis=1)
    # 1e-9: of the size of the model: ends of a joint that are as near are at one place
    drawn = (at >= 0).all(axis=1) & (length > 1e-9 * diagonal(xyz))
    points = [joints[~drawn & (at[:, k] >= 0)][:, [k, k, 2]] for k in (0, 1)]
    every = np.concatenate([lines, joints[drawn], np.unique(np.concatenate(points), axis=0)])
    return every[:, :2], every[:, 2]


def make_scene(model: Model, regions: Mapping[str, Sequence[int]], length: float = 1.0) -> Scene:
    """The drawing of a model; `regions` names property numbers, `length` turns its unit to
    metres.
    """
    quads, quad_pid = _faces(model)
    lines, line_pid = _lines(model)
    named = {pid: name for name, members in regions.items() for pid in members}
    pids = np.concatenate([quad_pid, line_pid]).tolist()
    labels = [named.get(p, f"property {p}" if p else "no property") for p in pids]
    names = tuple(dict.fromkeys([*regions, *labels]))
    at = {n: i for i, n in enumerate(names)}
    group = np.array([at[x] for x in labels], dtype=np.int64)
    triangle = quads[:, 2] == quads[:, 3]
    tris = np.concatenate([quads[:, [0, 1, 2]], quads[~triangle][:, [0, 2, 3]]])
    tri_group = np.concatenate([group[: len(quads)], group[: len(quads)][~triangle]])
    node = np.unique(np.concatenate([tris.ravel(), lines.ravel()]))
    grid = model["GRID"]
    return Scene(
        node=node,
        xyz=positions(model)[grid.find(node)] * length,
        triangles=np.searchsorted(node, tris),
        triangle_group=tri_group,
        lines=np.searchsorted(node, lines),
        line_group=group[len(quads) :],
        groups=names,
    )


def scene_modes(modes: ModeSet, scene: Scene) -> ModeSet:
    """The translations of the scene's nodes, rows ordered node by node, X Y Z; single precision is
    enough to draw.
    """
    labels = DofSet(
        np.repeat(scene.node, 3), np.tile(np.array([1, 2, 3], dtype=np.int8), scene.node.size)
    )
    assert isinstance(modes.labels, DofSet)
    at, sign = modes.labels.align(labels)
    shapes: Float = (
        np.asarray(modes.shapes[at] * sign[:, None]).astype(np.float32).astype(np.float64)
    )
    return replace(modes, shapes=shapes, labels=labels)


def with_lumps(
    opened: Opened, nodes: Int, settings: CandidateSettings
) -> tuple[Model, tuple[Candidate, ...]]:
    """The deck with places for masses that it may lack at nodes (k,), and these as candidates."""
    mass = mass_properties(opened.analysis.system).mass
    return lumped(
        opened.model, nodes, mass / opened.model.param("WTMASS", 1.0), settings.of(opened.model)
    )


def lump_places(opened: Opened, bridge: Observation) -> Int:
    """Nodes that cover the structure, those of the channels among them, ids (k,) int64."""
    seen = opened.analysis.dofs.node[np.unique(sparse.coo_array(bridge.matrix).col)]
    return places(opened.model, opened.moves, seen)
