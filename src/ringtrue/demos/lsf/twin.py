"""The as-built facility, drawn by seed, and as a modal model at its measuring, exciting and
supporting points. No stage of a study may import this.

The twin is versioned: a result names the twin it was made with, see `twin_hash`.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache
from pathlib import Path
from typing import TypeVar

import numpy as np

from ringtrue.checks.materials import mass_properties
from ringtrue.core.arrays import Any_, Complex, Float, Int
from ringtrue.core.dofs import DofSet
from ringtrue.core.iterate import Progress, quiet
from ringtrue.core.modes import ModalModel, ModeSet, Norm
from ringtrue.core.signals import Channel
from ringtrue.core.testmodel import TestModel
from ringtrue.correlation.sensor_mapping import observe
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.demos.lsf import facility
from ringtrue.demos.lsf import spec as S
from ringtrue.demos.lsf.spec import FOUNDATION, FRAME, Mesh3, Spec
from ringtrue.demos.lsf.study import write_facility
from ringtrue.eigen import damped
from ringtrue.fem.assembly import System
from ringtrue.model.frames import positions
from ringtrue.model.model import Model
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.embedded import EmbeddedSolver
from ringtrue.virtual.joints import SofteningJoints

AnySpec = TypeVar("AnySpec", bound=Spec)
VERSION = 1

FINE = Mesh3(
    nx=84,
    ny=28,
    nz_slab=5,
    nz_wall=6,
    ny_wall=3,
    around=60,
    along=(6, 10, 10, 10, 6),
    head=6,
    column=(5, 6),
    span=8,
    deck_x=9,
    deck_y=12,
)
_ANCHORS = ("anchors front", "anchors middle", "anchors rear")
_MOUNTS = (
    "vessel mounts front",
    "vessel mounts rear",
    "motor mounts",
    "gearbox mounts",
    "bearing mounts",
)


def ratios(seed: int) -> dict[str, float]:
    """Ratio of modulus or spring stiffness as built to as modelled for each region; drawn by
    seed.
    """
    rng = np.random.default_rng([seed, 325])

    def draw(regions: Iterable[str], low: float, high: float) -> dict[str, float]:
        return {region: float(rng.uniform(low, high)) for region in regions}

    out = draw(S.STEEL, 0.975, 1.030)  # 200 to 212 GPa
    # joints as stiff as the members (200 to 212 GPa) where the analyst took 170 GPa
    out |= draw(S.JOINTED, 1.176, 1.247)
    out |= draw(S.BUSHES, 0.95, 1.08)
    # uncracked, dynamic modulus (33 to 37 GPa) where the analyst took 17 GPa
    out |= draw(("slab", "long walls"), 1.98, 2.18)
    out |= draw(("end walls", "haunches"), 1.4, 1.8)  # cracked in places
    grouted = rng.choice(_ANCHORS, size=int(rng.integers(1, 4)), replace=False).tolist()
    for anchors in _ANCHORS:  # grouted over their length, or some of a group
        out |= draw([anchors], *((3.0, 4.0) if anchors in grouted else (2.2, 2.8)))
    shimmed = rng.choice(_MOUNTS, size=int(rng.integers(1, 3)), replace=False).tolist()
    out |= draw(shimmed, 1.2, 1.6)
    out |= draw(["air springs"], 1.10, 1.35)  # at their working pressure
    return out


def thicker(seed: int) -> dict[str, float]:
    """The region whose plates are thicker than drawn, and by how much; drawn by seed."""
    rng = np.random.default_rng([seed, 3])
    region = str(rng.choice(("brackets", "vessel rings", "braces", "deck beams")))
    return {region: float(rng.uniform(1.1, 1.25))}


def loss_factors(seed: int) -> dict[str, float]:
    """Structural loss factor of each region; joints differ most, by what slips in them."""
    rng = np.random.default_rng([seed, 2])
    loss = {region: float(rng.uniform(0.006, 0.016)) for region in S.CONCRETE}
    loss |= {region: float(rng.uniform(0.002, 0.004)) for region in S.STEEL}
    for region in S.BUSHES:
        if region != "air springs":
            loss[region] = float(np.exp(rng.uniform(*np.log((0.01, 0.12)))))
    return loss


def as_built(seed: int) -> Spec:
    """The facility as it stands."""
    return built_from(Spec(), ratios(seed), seed)


def built_from(deck: AnySpec, r: Mapping[str, float], seed: int) -> AnySpec:
    """A facility as it stands when it is modelled by `deck`: stiffness of each region times `r`, a
    finer mesh, and what the deck leaves out; drawn by seed.
    """
    return replace(
        deck,
        mesh=FINE,
        modulus={k: v * r[k] for k, v in deck.modulus.items()},
        density={
            k: v * (0.970 if k in S.CONCRETE else 1.0) for k, v in deck.density.items()
        },
        bush={k: tuple(x * r[k] for x in v) for k, v in deck.bush.items()},
        section=thicker(seed),
        loss=loss_factors(seed),
        dashpot=(1.2e4, 1.2e4, 2.2e4),
        scatter=0.03,
        bush_scatter=0.05,
        extra_braces=True,
        site=True,
        seed=seed,
    )


FMAX = 100.0  # Hz, modes kept; the rest is in the residual flexibility
AXES = ("X", "Y", "Z")
# where people jump and weights fall (on the slab), where machines shake: point numbers of their own
DROPS = {
    900001: (3.0, 3.0, FOUNDATION.slab),
    900002: (22.0, 7.0, FOUNDATION.slab),
    900003: (12.4, 2.2, FOUNDATION.slab),
}
JUMPS = {
    900011: (3.0, 2.4, FOUNDATION.slab),
    900012: (3.6, 7.0, FOUNDATION.slab),
    900013: (21.6, 3.2, FOUNDATION.slab),
}
SLEDGE = {
    900021: (1.5, 0.45, FOUNDATION.wall_top),
    900022: (23.5, 9.55, FOUNDATION.wall_top),
    900023: (12.5, 0.45, FOUNDATION.wall_top),
}
MACHINES = {
    900031: (12.5, 5.0, FRAME.top),
    900032: (23.0, 2.5, FOUNDATION.slab),
    900033: (2.0, 5.0, FOUNDATION.slab),
}


@cache
def twin_hash() -> str:
    """SHA-256 of what defines the twin, whatever the code that makes it looks like.

    The truth of the first seeds, the cards and nodes of the analyst's model and of the first seed
    as built, and the points of excitation; numbers to nine digits, as far as all processors agree.
    """
    parts: list[object] = [f"twin {VERSION}", DROPS, JUMPS, SLEDGE, MACHINES, FMAX]
    for seed in range(10):
        built = as_built(seed)
        parts += [(f.name, getattr(built, f.name)) for f in fields(built)]
    for built in (Spec(), as_built(0)):
        made = facility.build(built)
        parts += [made.cards, made.ids, made.xyz]
    return hashlib.sha256(_plain(parts).encode()).hexdigest()


def _plain(value: object) -> str:
    """Text of nested data; numbers to nine digits."""
    if isinstance(value, bool | int | str | None):
        return repr(value)
    if isinstance(value, float):
        return f"{round(value, 12) + 0.0:.9g}"
    if isinstance(value, dict):
        return _plain([(key, entry) for key, entry in value.items()])
    if isinstance(value, list | tuple):
        return "[" + ",".join(_plain(entry) for entry in value) + "]"
    if is_dataclass(value):
        return _plain([(f.name, getattr(value, f.name)) for f in fields(value)])
    raise TypeError(f"{type(value).__name__} has no plain text")


@dataclass(frozen=True, slots=True, eq=False)
class Twin:
    """The as-built facility seen from outside.

    Attributes
    ----------
    modal : ModalModel
        Complex modes below 100 Hz and the residual flexibility of the rest. Outputs are the
        channels of `test`; inputs are the hammer points, `DROPS`, `JUMPS`, `SLEDGE`, `MACHINES` and
        the ground (`ground+X` for a unit displacement, `groundv+X` for a unit velocity).
    test : TestModel
    dof : int
    mass : float, kg
    real_modes : ModeSet
        Undamped modes at the channels: the truth that tests and `best_possible_percent` refer to.
    joints : SofteningJoints, optional
        Seen by the inputs of `modal`; None where the structure is linear.
    """

    modal: ModalModel
    test: TestModel
    drop_points: tuple[str, ...]
    jump_points: tuple[str, ...]
    sledge_points: tuple[str, ...]
    machine_points: tuple[str, ...]
    dof: int
    mass: float
    real_modes: ModeSet
    joints: SofteningJoints | None = None


@dataclass(frozen=True, slots=True)
class SofteningRegion:
    """Bushes whose stiffness falls with amplitude.

    Attributes
    ----------
    region : str
    share : float
        Of the stiffness that is lost at large amplitudes.
    slip : float, m
        As `SofteningJoints` has it.
    """

    region: str
    share: float
    slip: float


def _extra_points() -> tuple[TestModel, dict[str, tuple[str, ...]]]:
    """Force points beyond the channels, as a test model with vertical and lateral directions."""
    groups = {"drop": DROPS, "jump": JUMPS, "sledge": SLEDGE, "machine": MACHINES}
    points = {n: p for g in groups.values() for n, p in g.items()}
    names = []
    at = []
    axes = []
    kinds: dict[str, tuple[str, ...]] = {}
    for kind, group in groups.items():
        mine = []
        for n in group:
            for i in (2,) if kind in ("drop", "jump") else (0, 1, 2):
                mine.append(f"{n}+{AXES[i]}")
                at.append(n)
                axes.append(np.eye(3)[i])
        kinds[kind] = tuple(mine)
        names += mine
    xyz = np.array(list(points.values()))
    model = TestModel(
        points=np.array(list(points)),
        xyz=xyz,
        channels=tuple(names),
        at=np.array(at),
        axes=np.array(axes),
        lines=np.zeros((0, 2), dtype=np.int64),
    )
    return model, kinds


def _ground(model: Model, dofs: DofSet) -> tuple[Int, Float, Float]:
    """Positions of the spring nodes' translations in `dofs` (s, 3), their stiffness (s, 3) and
    dashpots (s, 3).
    """
    bush = model["CBUSH"]
    prop = model["PBUSH"]
    grounded = bush["GB"] == 0
    row = prop.find(bush["PID"][grounded])
    node = bush["GA"][grounded]
    at = np.stack(
        [dofs.find(node, np.full(node.shape, i + 1)) for i in range(3)], axis=1
    )
    return at, prop.stack("K1", "K2", "K3")[row], prop.stack("B1", "B2", "B3")[row]


def _participation(
    shapes: Any_, model: Model, dofs: DofSet
) -> tuple[Complex, tuple[str, ...]]:
    """Modal forces (m, 6) of a unit ground displacement and velocity in X, Y, Z."""
    at, k, c = _ground(model, dofs)
    moved = shapes[at]  # (spring, axis, mode)
    force = np.concatenate(
        [np.einsum("sam,sa->ma", moved, k), np.einsum("sam,sa->ma", moved, c)], axis=1
    )
    return np.asarray(force, dtype=np.complex128), tuple(
        f"{g}+{a}" for g in ("ground", "groundv") for a in AXES
    )


def _damped(system: System, real: ModeSet) -> damped.ComplexModes:
    """Complex modes in the basis of the real ones: dashpots and the loss factors of materials and
    bushes.
    """
    phi = np.asarray(system.local @ real.shapes)
    viscous, structural = damped.project(phi, system.viscous, system.structural)
    return damped.complex_modes(
        (2 * np.pi * real.frequencies) ** 2, viscous, structural
    )


def _joint_rows(
    model: Model, dofs: DofSet, regions: Sequence[SofteningRegion]
) -> tuple[Float, Float, Float, tuple[str, ...]]:
    """Vertical extensions of bushes as rows (j, dof), what they lose (j,), N/m, their slip (j,), m,
    and names.
    """
    bush = model["CBUSH"]
    prop = model["PBUSH"]
    region = bush["PID"] // 100  # bushes of the twin have properties of their own
    at = np.flatnonzero(np.isin(region, [S.BUSHES[s.region] for s in regions]))
    of = {S.BUSHES[s.region]: s for s in regions}
    mine = [of[pid] for pid in region[at].tolist()]
    rows = np.zeros((at.size, len(dofs)))
    vertical = np.full(at.size, 3)
    rows[np.arange(at.size), dofs.find(bush["GA"][at], vertical)] = -1.0
    rows[np.arange(at.size), dofs.find(bush["GB"][at], vertical)] = 1.0
    share = np.array([s.share for s in mine])
    loss = share * prop["K3"][prop.find(bush["PID"][at])]
    names = tuple(f"joint {eid}" for eid in bush["EID"][at].tolist())
    return rows, loss, np.array([s.slip for s in mine]), names


@dataclass(frozen=True, slots=True, eq=False)
class _Solved:
    """The as-built model as its modes and static responses have it.

    Attributes
    ----------
    real : ModeSet
        Undamped, at all degrees of freedom.
    lossy : ComplexModes
        In their basis.
    load, static : (in, dof) and (dof, in) float64
        Unit forces and the motions under them.
    ground : (m, 6) complex128
        Modal forces of the ground.
    inputs : tuple of str
        Of the forces, then of the ground.
    """

    real: ModeSet
    lossy: damped.ComplexModes
    load: Float
    static: Float
    ground: Complex
    inputs: tuple[str, ...]

    def seen(self, look: Callable[[Any_], Any_], ids: Sequence[str]) -> ModalModel:
        """The modal model at outputs `ids` that `look` reads of motions (dof, k)."""
        shapes = self.real.shapes @ self.lossy.shapes
        squared = (2 * np.pi * self.real.frequencies[:, None]) ** 2
        low = (self.load @ self.real.shapes).T / squared
        flexibility = look(self.static) - look(self.real.shapes) @ low
        rigid = np.zeros((len(ids), self.ground.shape[1]))
        upper = np.concatenate([flexibility, rigid], axis=1)
        return ModalModel(
            poles=self.lossy.poles,
            shapes=look(shapes),
            participation=np.concatenate([(self.load @ shapes).T, self.ground], axis=1),
            lower=np.zeros(upper.shape, dtype=np.complex128),
            upper=upper.astype(np.complex128),
            outputs=tuple(Channel(c, "acceleration", "m/s^2") for c in ids),
            inputs=tuple(Channel(c, "force", "N") for c in self.inputs),
            kind="receptance",
            norm=Norm.MODAL_A,
        )


def make_twin(
    built: Spec,
    test: TestModel,
    references: Sequence[str],
    *,
    softening: Sequence[SofteningRegion] = (),
    progress: Progress = quiet,
) -> Twin:
    """Build the as-built model, solve it, and keep what can be seen at the channels.

    Parameters
    ----------
    built : Spec
        The facility as it stands.
    test : TestModel
        All channels of the campaign.
    references : sequence of str
        Channel ids that are hammer points as well.
    softening : sequence of SofteningRegion
        Bushes that are not linear.
    progress : callable (fraction, text)
    """
    progress(0.0, "as-built model")
    with tempfile.TemporaryDirectory() as folder:
        model = read_deck(
            write_facility(facility.build(built), Path(folder), "LSF as built")
        )
    # it was made with these shells, and stays as it is
    model = replace(model, params={**model.params, "RESBEND": "NO"})
    extra, kinds = _extra_points()
    at = model["GRID"].ids, positions(model)
    with EmbeddedSolver().open(model) as analysis:
        progress(0.2, "as-built modes")
        real = analysis.modes(ModesRequest(band=(-1.0, FMAX))).modes
        progress(0.7, "as-built damping")
        lossy = _damped(analysis.system, real)
        see = observe(test, *at, analysis.dofs, tolerance=0.6, method="rigid")
        push = observe(extra, *at, analysis.dofs, tolerance=0.6)
        hits = [test.channels.index(r) for r in references]
        stretch, loss, slip, names = _joint_rows(model, analysis.dofs, softening)
        load = np.concatenate(
            [see.matrix[hits].toarray(), push.matrix.toarray(), stretch]
        )
        static = analysis.static(load.T)
        ground, grounds = _participation(
            real.shapes @ lossy.shapes, model, analysis.dofs
        )
        dof = analysis.system.stiffness.shape[0]
        mass = mass_properties(analysis.system).mass
    inputs = (*references, *extra.channels, *names, *grounds)
    solved = _Solved(
        real=real, lossy=lossy, load=load, static=static, ground=ground, inputs=inputs
    )
    joints = None
    if names:
        forces = np.array([inputs.index(n) for n in names])
        joints = SofteningJoints(
            solved.seen(lambda x: stretch @ x, names), forces, loss, slip
        )
    return Twin(
        modal=solved.seen(see, test.channels),
        test=test,
        drop_points=kinds["drop"],
        jump_points=kinds["jump"],
        sledge_points=kinds["sledge"],
        machine_points=kinds["machine"],
        dof=int(dof),
        mass=float(mass),
        real_modes=ModeSet(
            frequencies=real.frequencies,
            damping=lossy.damping,
            shapes=see(real.shapes),
            labels=test.channels,
            norm=Norm.MASS,
            source="as built",
        ),
        joints=joints,
    )
