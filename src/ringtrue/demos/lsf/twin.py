"""The as-built facility as a modal model at its measuring, exciting and supporting points."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ringtrue.checks.mass import mass_properties
from ringtrue.core.arrays import Any_, Complex, Float, Int
from ringtrue.core.dofs import DofSet
from ringtrue.core.modal import ModalModel
from ringtrue.core.modes import ModeSet, Norm
from ringtrue.core.signals import Channel
from ringtrue.core.testmodel import TestModel
from ringtrue.correlation.sensor_mapping import observe
from ringtrue.decks.nastran.reader import read_deck
from ringtrue.demos.lsf import deck, facility
from ringtrue.demos.lsf import spec as S
from ringtrue.demos.lsf.truth import as_built
from ringtrue.eigen import damped
from ringtrue.fem.assembly import System
from ringtrue.model.frames import positions
from ringtrue.model.model import Model
from ringtrue.model.ports import ModesRequest
from ringtrue.solvers.embedded import EmbeddedSolver

FMAX = 100.0  # Hz, modes kept; the rest is in the residual flexibility
AXES = ("X", "Y", "Z")
# where people jump and weights fall (on the slab), where machines shake: point numbers of their own
DROPS = {900001: (3.0, 3.0, S.SLAB), 900002: (22.0, 7.0, S.SLAB), 900003: (12.4, 2.2, S.SLAB)}
JUMPS = {900011: (3.0, 2.4, S.SLAB), 900012: (3.6, 7.0, S.SLAB), 900013: (21.6, 3.2, S.SLAB)}
SLEDGE = {
    900021: (1.5, 0.45, S.WALL_TOP),
    900022: (23.5, 9.55, S.WALL_TOP),
    900023: (12.5, 0.45, S.WALL_TOP),
}
MACHINES = {900031: (12.5, 5.0, S.TOP), 900032: (23.0, 2.5, S.SLAB), 900033: (2.0, 5.0, S.SLAB)}


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


def _extra_points() -> tuple[TestModel, dict[str, tuple[str, ...]]]:
    """Force points beyond the channels, as a test model with vertical and lateral directions."""
    groups = {"drop": DROPS, "jump": JUMPS, "sledge": SLEDGE, "machine": MACHINES}
    points = {n: p for g in groups.values() for n, p in g.items()}
    names, at, axes = [], [], []
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
    bush, prop = model["CBUSH"], model["PBUSH"]
    grounded = bush["GB"] == 0
    row = prop.find(bush["PID"][grounded])
    node = bush["GA"][grounded]
    at = np.stack([dofs.find(node, np.full(node.shape, i + 1)) for i in range(3)], axis=1)
    return at, prop.stack("K1", "K2", "K3")[row], prop.stack("B1", "B2", "B3")[row]


def _participation(shapes: Any_, model: Model, dofs: DofSet) -> tuple[Complex, tuple[str, ...]]:
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
    return damped.complex_modes((2 * np.pi * real.frequencies) ** 2, viscous, structural)


def make_twin(
    seed: int,
    test: TestModel,
    references: Sequence[str],
    progress: Callable[[float, str], None] | None = None,
) -> Twin:
    """Build the as-built model, solve it, and keep what can be seen at the channels.

    Parameters
    ----------
    seed : int
    test : TestModel
        All channels of the campaign.
    references : sequence of str
        Channel ids that are hammer points as well.
    """
    tell = progress or (lambda fraction, text: None)
    tell(0.0, "as-built model")
    with tempfile.TemporaryDirectory() as folder:
        model = read_deck(deck.write(facility.build(as_built(seed)), Path(folder), "LSF as built"))
    extra, kinds = _extra_points()
    grid = model["GRID"].ids
    xyz = positions(model)
    with EmbeddedSolver().open(model) as analysis:
        tell(0.2, "as-built modes")
        real = analysis.modes(ModesRequest(band=(-1.0, FMAX))).modes
        tell(0.7, "as-built damping")
        lossy = _damped(analysis.system, real)
        see = observe(test, grid, xyz, analysis.dofs, tolerance=0.6, method="rigid")
        push = observe(extra, grid, xyz, analysis.dofs, tolerance=0.6)
        hits = [test.channels.index(r) for r in references]
        load = np.concatenate([see.matrix[hits].toarray(), push.matrix.toarray()])
        static = analysis.static(load.T)  # (dof, in)
        dof, mass = analysis.system.stiffness.shape[0], mass_properties(analysis.system).mass
    shapes = real.shapes @ lossy.shapes
    outputs, inputs = see(shapes), load @ shapes
    ground, ground_names = _participation(shapes, model, analysis.dofs)
    flexibility = see(static) - see(real.shapes) @ (
        (load @ real.shapes).T / (2 * np.pi * real.frequencies[:, None]) ** 2
    )
    names = (*references, *extra.channels, *ground_names)
    upper = np.concatenate([flexibility, np.zeros((len(test.channels), len(ground_names)))], axis=1)
    modal = ModalModel(
        poles=lossy.poles,
        shapes=outputs,
        participation=np.concatenate([inputs.T, ground], axis=1),
        lower=np.zeros(upper.shape, dtype=np.complex128),
        upper=upper.astype(np.complex128),
        outputs=tuple(Channel(c, "acceleration", "m/s^2") for c in test.channels),
        inputs=tuple(Channel(c, "force", "N") for c in names),
        kind="receptance",
        norm=Norm.MODAL_A,
    )
    seen = ModeSet(
        frequencies=real.frequencies,
        damping=lossy.damping,
        shapes=see(real.shapes),
        labels=test.channels,
        norm=Norm.MASS,
        source="as built",
    )
    return Twin(
        modal=modal,
        test=test,
        drop_points=kinds["drop"],
        jump_points=kinds["jump"],
        sledge_points=kinds["sledge"],
        machine_points=kinds["machine"],
        dof=int(dof),
        mass=float(mass),
        real_modes=seen,
    )
