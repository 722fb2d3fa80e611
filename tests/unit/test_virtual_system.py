"""A made-up structure for the virtual tests: 8 rigid-type and 25 elastic modes of a 1600 t block,
48 channels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ringtrue.core.modes import ModalModel
from ringtrue.core.signals import Channel
from ringtrue.core.testmodel import TestModel
from ringtrue.demos.lsf.campaign import CampaignPlan
from ringtrue.virtual.joints import SofteningJoints
from ringtrue.virtual.measurements import HammerPlan

MASS = 1.6e6  # kg


@dataclass(frozen=True)
class MadeUp:
    modal: ModalModel
    test: TestModel
    drop_points: tuple[str, ...] = ("900+Z", "901+Z")
    jump_points: tuple[str, ...] = ("902+Z", "903+Z", "904+Z")
    sledge_points: tuple[str, ...] = ("905+Z", "906+Z")
    machine_points: tuple[str, ...] = ("907+Z", "907+X")
    joints: SofteningJoints | None = None


def made_up(seed: int = 1, points: int = 16) -> MadeUp:
    rng = np.random.default_rng(seed)
    ids = np.arange(1, points + 1) + 100
    xyz = np.column_stack(
        [
            rng.uniform(0, 25, points),
            rng.uniform(0, 10, points),
            rng.uniform(0, 10, points),
        ]
    )
    channels = tuple(f"{p}+{a}" for p in ids for a in "XYZ")
    test = TestModel(
        ids,
        xyz,
        channels,
        np.repeat(ids, 3),
        np.tile(np.eye(3), (points, 1)),
        np.zeros((0, 2)),
    )
    f = np.concatenate(
        [rng.uniform(0.5, 2.5, 8), np.linspace(13, 95, 25) + rng.uniform(-1, 1, 25)]
    )
    zeta = np.concatenate([rng.uniform(0.02, 0.06, 8), rng.uniform(0.007, 0.03, 25)])
    extra = (
        "900+Z",
        "901+Z",
        "902+Z",
        "903+Z",
        "904+Z",
        "905+Z",
        "906+Z",
        "907+Z",
        "907+X",
    )
    ground = tuple(f"{g}+{a}" for g in ("ground", "groundv") for a in "XYZ")
    references = channels[2:12:3]
    phi = _shapes(
        rng,
        np.vstack([xyz.repeat(3, axis=0), rng.uniform(0, 10, (len(extra), 3))]),
        f.size,
    )
    out, load = (
        phi[: len(channels)],
        np.vstack([phi[[channels.index(r) for r in references]], phi[len(channels) :]]),
    )
    poles = 2 * np.pi * f * (-zeta + 1j * np.sqrt(1 - zeta**2))
    springs = rng.normal(size=(f.size, 3)) * np.sqrt(MASS)
    springs[8:] *= 0.1
    springs *= (2 * np.pi * 1.5) ** 2 / MASS
    participation = np.hstack([load.T, springs, 0.02 * springs]) / (
        2j * poles.imag[:, None]
    )
    names = (*references, *extra, *ground)
    none = np.zeros((len(channels), len(names)))
    upper = none.copy()
    upper[: len(names), : len(references)] = 1e-12
    modal = ModalModel(
        poles,
        out,
        participation,
        none,
        upper,
        tuple(Channel(c) for c in channels),
        tuple(Channel(c) for c in names),
        "receptance",
    )
    return MadeUp(modal, test)


def _shapes(rng: np.random.Generator, xyz: np.ndarray, modes: int) -> np.ndarray:
    """Smooth random mass-normalised shapes (row, mode) of size 1/√mass."""
    k = rng.normal(0, 0.15, (3, modes))
    return (
        np.sqrt(2 / MASS)
        * np.cos(xyz @ k + rng.uniform(0, 2 * np.pi, modes))
        * rng.choice([-1, 1], xyz.shape[:1])[:, None]
    )


def made_up_plan(twin: MadeUp, **changes: object) -> CampaignPlan:
    c = twin.test.channels
    settings: dict[str, object] = {
        "foundation": c[:24],
        "frame": c[:40],
        "setups": (c[:12], c[:3] + c[12:24], c[:3] + c[24:36]),
        "references": twin.modal.inputs and tuple(i.id for i in twin.modal.inputs[:3]),
        "hammer": HammerPlan(),
    }
    return CampaignPlan(**(settings | changes))  # type: ignore[arg-type]


def test_the_made_up_structure_has_its_modes() -> None:
    twin = made_up()
    assert (twin.modal.frequencies[:8] < 2.6).all()
    assert (twin.modal.frequencies[8:] > 11).all()
    assert twin.modal.shapes.shape == (48, 33)
