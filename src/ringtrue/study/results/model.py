"""The deck, the planned test, and where all of it came from."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ringtrue.core.arrays import Bool, Float, Int
from ringtrue.core.modes import ModeSet
from ringtrue.core.testmodel import TestModel
from ringtrue.planning.setups import Setups
from ringtrue.planning.virtual_test import VirtualTest

MISSED = 0.1  # of the best driving-point residue: below, the references miss a mode


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """What is drawn of the model: skin triangles and lines, by group (property or region).

    Attributes
    ----------
    node : (n,) int64
    xyz : (n, 3) float64, m, basic
    triangles : (t, 3) int64, positions in `node`
    triangle_group : (t,) int64, positions in `groups`
    lines : (l, 2) int64
    line_group : (l,) int64
    groups : tuple of str
    """

    node: Int
    xyz: Float
    triangles: Int
    triangle_group: Int
    lines: Int
    line_group: Int
    groups: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class ModelStage:
    """The deck and its modes."""

    title: str
    files: tuple[str, ...]
    units: str
    cards: dict[str, int]
    findings: tuple[str, ...]
    nodes: int
    dof: int
    mass: float
    cg: Float
    inertia: Float
    modes: ModeSet  # at the scene's translations: labels node+X.. of the scene nodes
    residuals: Float
    proof: str
    scene: Scene


@dataclass(frozen=True, slots=True, eq=False)
class PlanStage:
    """The planned test."""

    candidates: int
    target_modes: Int  # positions in the deck's modes
    test: TestModel  # the planned channels
    ambient: tuple[str, ...]  # channels planned for the ambient tests
    references: tuple[str, ...]  # hammer points
    auto_mac: Float  # (target, target)
    worst_off_diagonal: float
    frequency_step: float  # Hz
    block: float  # s
    record_length: float  # s
    damping: float  # assumed ratio
    # positions in the deck's modes: rigid-body and first elastic ones, of the ambient tests
    expected_modes: Int
    expected_std_frequency: Float  # (expected,) relative, 1 sigma
    expected_std_damping: Float  # (expected,) relative
    rule: str  # the selection rule in words
    target_frequencies: Float = field(default_factory=lambda: np.zeros(0))  # (target,) Hz
    reasons: tuple[str, ...] = ()  # why each target mode is one
    reach: Float = field(
        default_factory=lambda: np.zeros(0)
    )  # (target,) share of the best driving-point residue
    reachable: Float = field(
        default_factory=lambda: np.zeros(0)
    )  # (target,) as reach, of all that can be struck
    shown: Float = field(
        default_factory=lambda: np.zeros(0)
    )  # (target,) MAC of the mode with its drawing
    left_by_loss: float = 1.0  # least share of information left when the worst points fail
    lost: int = 1  # so many points
    averages: int = 0  # blows at each reference for the wanted error of the FRFs
    segments: int = 0  # blocks of that length in the ambient record
    notes: tuple[str, ...] = ()  # what the plan asks for in vain
    loaded: Float = field(
        default_factory=lambda: np.zeros(0)
    )  # (target,) relative, by mass of sensors; NaN at 0 Hz
    suspension: tuple[int, ...] = ()  # nodes to hang from
    suspension_motion: float = (
        0.0  # their largest motion in a target mode, squared, over the largest of the mode
    )
    steady: bool = False  # the centre of gravity hangs between them
    rehearsal: VirtualTest | None = None  # the virtual test
    ambient_rehearsal: VirtualTest | None = None  # of the expected modes, by virtual ambient tests
    indicator: Float = field(
        default_factory=lambda: np.zeros(0)
    )  # (target,) least mode indicator of all references
    forces: Float = field(
        default_factory=lambda: np.zeros((0, 0))
    )  # (target, reference) real forces that reach it
    sets: tuple[
        tuple[str, ...], ...
    ] = ()  # references ranked by the mode that they excite worst, also fewer and more
    set_reach: Float = field(
        default_factory=lambda: np.zeros((0, 0))
    )  # (set, target) as reach, of each
    setups: Setups | None = None  # of the planned sensors, where fewer are at hand

    @property
    def missed(self) -> Bool:
        """Which target modes no reference excites well."""
        return np.asarray(self.reach < MISSED)

    @property
    def hopeless(self) -> Bool:
        """Which target modes no point that can be struck excites well; none of a plan stored before
        this was asked.
        """
        return (
            np.asarray(self.reachable < MISSED)
            if self.reachable.size
            else np.zeros_like(self.missed)
        )

    @property
    def least_reach(self) -> Float:
        """Reach, by each of `sets`, of the mode that it excites worst of those that a point can
        reach (all if none).
        """
        some = ~self.hopeless if not self.hopeless.all() else self.hopeless
        return np.asarray(self.set_reach[:, some].min(axis=1, initial=1.0))

    @property
    def missed_by_sets(self) -> list[list[int]]:
        """Positions of the target modes that each of `sets` misses."""
        return [np.flatnonzero(r < MISSED).tolist() for r in self.set_reach]

    def roving(self, setup: int) -> list[int]:
        """Points that are measured in one setup alone; in all with -1."""
        if self.setups is None:
            return []
        at = self.test.at.reshape(self.setups.setup.size, -1)[:, 0]
        return list(dict.fromkeys(at[self.setups.roving(setup)].tolist()))


@dataclass(frozen=True, slots=True, eq=False)
class Provenance:
    """Where everything came from."""

    version: str
    python: str
    packages: dict[str, str]
    platform: str
    seed: int
    started: str
    inputs: dict[str, str]  # file -> SHA-256
    settings: str  # the resolved study.toml
    timings: dict[str, float]  # stage -> s
    home: str = "."  # the folder of study.toml, seen from that of the store
