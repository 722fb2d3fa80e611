"""Measured data other than modes as residuals: FRFs, their zeros, static tests, a weighing."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import sparse

from ringtrue.checks.mass import unconstrained
from ringtrue.core.arrays import Float, Int, freeze_fields
from ringtrue.core.channels import match_channels
from ringtrue.core.modes import ModeSet
from ringtrue.core.motions import POWER
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.signals import FrfSet
from ringtrue.core.units import UNIT_SYSTEMS
from ringtrue.errors import ConfigError, DataError, did_you_mean
from ringtrue.fem.assembly import assemble
from ringtrue.fem.parametrisation.affine import affine_terms
from ringtrue.fem.parametrisation.polynomials import AffineTerm
from ringtrue.io.frfs import read_frfs
from ringtrue.io.statics import StaticTests, read_statics
from ringtrue.model.model import Model
from ringtrue.reduction.basis import AffineSystem
from ringtrue.reduction.parametric import ReducedModel
from ringtrue.reduction.response import with_responses
from ringtrue.study.config_update import (
    AntiResonanceResidual,
    DataResidual,
    FrfResidual,
    MassResidual,
    StaticResidual,
)
from ringtrue.updating.prediction import Damping
from ringtrue.updating.residuals.frf import AntiResonances, Frf
from ringtrue.updating.residuals.modal import Block, Term
from ringtrue.updating.residuals.static import MassProperties, RigidMass, StaticDeflections

DECIBEL = 20 / np.log(10)
NO_FRFS = "the test has no FRFs"
BAND = (
    0.8,
    1.2,
)  # of the lowest and the highest mode of the test: where FRFs are compared if nothing is said
WEIGHED = ("mass", "x", "y", "z", "Ixx", "Iyy", "Izz", "Ixy", "Iyz", "Izx")
WEIGHED_UNITS = ("kg", *("m",) * 3, *("kg m²",) * 6)


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """One [[residual]] as read.

    Attributes
    ----------
    section : DataResidual
    outputs, inputs : tuple of str
        Channels where it was measured and excited.
    frfs : FrfSet, optional
        At the chosen lines.
    statics : StaticTests, optional
    damping : Damping, optional
        For FRFs.
    """

    section: DataResidual
    outputs: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()
    frfs: FrfSet | None = None
    statics: StaticTests | None = None
    damping: Damping | None = None

    @property
    def name(self) -> str:
        """As given, else the kind."""
        return self.section.name or self.section.kind


@dataclass(frozen=True, slots=True, eq=False)
class Data:
    """A kind of residuals beside the modes, and what is shown of it.

    Attributes
    ----------
    name, kind : str
    term : Term
    weight : float
        On the squares of its rows.
    labels, units : tuple of str
        Of each shown value (n,).
    measured : (n,) float64
        NaN where a deviation is shown, not a value.
    scale : (n,) float64
        Shown value a unit of residual.
    lines : int
        Rows that are one shown value, by their root mean square; 0: each row is one, measured −
        scale · residual.
    """

    name: str
    kind: str
    term: Term
    weight: float
    labels: tuple[str, ...]
    units: tuple[str, ...]
    measured: Float
    scale: Float
    lines: int = 0

    def __post_init__(self) -> None:
        freeze_fields(self, measured=np.float64, scale=np.float64)

    def shown(self, block: Block) -> Float:
        """Values (n,) of the model at a point."""
        if self.lines:
            return np.asarray(
                self.scale * np.sqrt(np.mean(block.value.reshape(-1, self.scale.size) ** 2, axis=0))
            )
        return np.asarray(self.measured - self.scale * block.value)


def read_measured(
    section: DataResidual,
    base: Path,
    modes: ModeSet,
    frfs: FrfSet | None = None,
    why: str = NO_FRFS,
) -> Measured:
    """Read what a [[residual]] names.

    Parameters
    ----------
    section : DataResidual
    base : Path
        Folder that its file is seen from.
    modes : ModeSet
        Elastic modes of the test: their band and damping serve FRFs that say nothing else.
    frfs : FrfSet, optional
        Of the test, for FRFs without a file.
    why : str
        Why there are none.

    Raises
    ------
    ConfigError, DataError
        If there are no FRFs, or none of the lines or channels that are asked for.
    """
    if isinstance(section, FrfResidual):
        return _frfs(section, base, modes, frfs, why)
    if isinstance(section, AntiResonanceResidual):
        return Measured(section, (section.output,), (section.input,))
    if isinstance(section, StaticResidual):
        found = read_statics(base / section.file)
        loaded = tuple(c for c, f in zip(found.channels, found.loads, strict=True) if f.any())
        return Measured(section, found.channels, loaded, statics=found)
    return Measured(section)


def _frfs(
    section: FrfResidual, base: Path, modes: ModeSet, frfs: FrfSet | None, why: str
) -> Measured:
    found = read_frfs(base / section.file) if section.file else frfs
    where = section.file or "the test"
    if found is None:
        raise ConfigError(f"[[residual]] {section.name or 'frf'}: {why}; name a file of them")
    out = _picked([c.id for c in found.outputs], section.outputs, f"{where}: output")
    into = _picked([c.id for c in found.inputs], section.inputs, f"{where}: input")
    lines = _lines(section, found.freqs, modes.frequencies, where)
    at = np.ix_(lines, out, into)
    data = found.data[at]
    if not np.abs(data).all():
        raise DataError(
            f"{where}: an FRF is zero at a chosen line; leave the channel or the line out"
        )
    part = replace(
        found,
        data=data,
        freqs=found.freqs[lines],
        outputs=tuple(found.outputs[i] for i in out.tolist()),
        inputs=tuple(found.inputs[i] for i in into.tolist()),
        coherence=found.coherence[at],
        averages=found.averages[into],
    )
    names, sources = (tuple(c.id for c in side) for side in (part.outputs, part.inputs))
    return Measured(
        section, names, sources, frfs=part, damping=_damping(section, modes, found.window_decay)
    )


def _picked(have: Sequence[str], asked: Sequence[str], what: str) -> Int:
    """Positions of the channels that are asked for, by whatever sign; of all if none is."""
    if not asked:
        return np.arange(len(have))
    index, _ = match_channels(asked, have)
    if lost := [c for c, i in zip(asked, index.tolist(), strict=True) if i < 0]:
        raise DataError(f"{what} {lost[0]!r}{did_you_mean(lost[0], have)}")
    return index


def _lines(section: FrfResidual, freqs: Float, modes: Float, where: str) -> Int:
    """The measured lines nearest to those asked for, or evenly spread ones of the band."""
    if section.lines:
        asked, step = np.array(section.lines), float(np.diff(freqs).max(initial=0.0))
        at = np.abs(freqs[None, :] - asked[:, None]).argmin(axis=1)
        far = np.abs(freqs[at] - asked) > step
        if far.any():
            raise DataError(
                f"{where}: no line at {asked[far][0]:g} Hz; there are {freqs[0]:g} to "
                f"{freqs[-1]:g} Hz"
            )
        return np.unique(at)
    low = BAND[0] * modes.min() if section.fmin is None else section.fmin
    high = BAND[1] * modes.max() if section.fmax is None else section.fmax
    inside = np.flatnonzero((freqs >= low) & (freqs <= high) & (freqs > 0))
    if not inside.size:
        raise DataError(
            f"{where}: no line from {low:g} to {high:g} Hz; there are {freqs[0]:g} to "
            f"{freqs[-1]:g} Hz"
        )
    return np.unique(
        inside[np.linspace(0, inside.size - 1, min(section.count, inside.size)).round().astype(int)]
    )


def _damping(section: FrfResidual, modes: ModeSet, decay: float) -> Damping:
    """Over frequency, from the modes of the test unless it is given; an exponential window adds to
    it.
    """
    order = np.argsort(modes.frequencies, kind="stable")
    f, at = np.unique(modes.frequencies[order], return_index=True)
    zeta = modes.damping[order][at]
    good = np.isfinite(zeta) & (zeta > 0)
    if section.damping is not None:
        f, zeta = f[:1], np.array([section.damping])
    elif good.any():
        f, zeta = f[good], zeta[good]
    else:
        raise ConfigError(
            f"[[residual]] {section.name or 'frf'}: the test modes have no damping; give damping "
            "= ..."
        )
    return Damping(f, zeta + decay / (2 * np.pi * f))


def residual_data(
    found: Measured,
    at: Mapping[str, int],
    units: str,
    rigid: Callable[[], RigidMass],
    active: tuple[int, ...],
) -> Data:
    """The residuals on a model.

    Parameters
    ----------
    found : Measured
    at : mapping of str to int
        Positions of the channels among all of the model.
    units : str
        A name of `UNIT_SYSTEMS`.
        Of the deck.
    rigid : callable
        The rigid-body mass of the deck, for a weighing.
    active : tuple of int
        The parameters that x stands for.
    """
    s = found.section
    if isinstance(s, FrfResidual):
        return _frf_data(found, s, at, units)
    if isinstance(s, StaticResidual):
        return _static_data(found, s, at, units)
    if isinstance(s, MassResidual):
        return _mass_data(found, s, units, replace(rigid(), active=active))
    f = np.array(s.frequencies)
    term = AntiResonances(at[s.output], at[s.input], f, s.error, s.gate)
    labels = tuple(f"{s.output} / {s.input}: zero {i + 1}" for i in range(f.size))
    return Data(
        name=found.name,
        kind=s.kind,
        term=term,
        weight=s.weight,
        labels=labels,
        units=("Hz",) * f.size,
        measured=f,
        scale=s.error * f,
    )


def channels_of(found: Sequence[Measured]) -> tuple[str, ...]:
    """Channels that were measured or excited, each once."""
    return tuple(dict.fromkeys(c for m in found for c in (*m.outputs, *m.inputs)))


def excited(found: Sequence[Measured], at: Mapping[str, int]) -> Int:
    """Positions of the channels at which something was struck or pulled."""
    return np.array(
        [at[c] for c in dict.fromkeys(c for m in found for c in m.inputs)], dtype=np.int64
    )


def flexible(model: ReducedModel, found: Sequence[Measured], loaded: Int) -> ReducedModel:
    """With the static responses to what was struck or pulled; their derivatives where deflections
    were read.
    """
    if not loaded.size:
        return model
    static = any(m.statics is not None for m in found)
    return with_responses(model, loaded, np.zeros(len(model.parameters)), sensitivities=static)[0]


def check_moving(found: Sequence[Measured], at: Mapping[str, int], observe: Float) -> None:
    """Refuse channels that are held in the deck where a response or a load needs one that moves.

    Parameters
    ----------
    observe : (channel, r) float64
        Motion of the channels in a basis.

    Raises
    ------
    DataError
    """
    for m in found:
        need = m.inputs if m.statics is not None else (*m.outputs, *m.inputs)
        if still := [c for c in need if not observe[at[c]].any()]:
            raise DataError(
                f"[[residual]] {m.name}: channel {still[0]} is held in the deck, it cannot move"
            )


def _frf_data(found: Measured, s: FrfResidual, at: Mapping[str, int], units: str) -> Data:
    frfs = found.frfs
    assert frfs is not None
    assert found.damping is not None
    out, into = (np.array([at[c] for c in side]) for side in (found.outputs, found.inputs))
    h = frfs.data * UNIT_SYSTEMS[units].kilograms
    term = Frf(
        freqs=frfs.freqs,
        measured=h,
        outputs=out,
        inputs=into,
        damping=found.damping,
        order=POWER[frfs.kind],
        form=s.form,
        std=s.error,
    )
    labels = tuple(f"{o} / {i}" for o in found.outputs for i in found.inputs)
    n, log = len(labels), s.form == "log"
    scale = s.error * (DECIBEL if log else 100 * np.sqrt(2))
    unit = "dB rms" if log else "% rms"
    none = np.full(n, np.nan)
    return Data(
        name=found.name,
        kind=s.kind,
        term=term,
        weight=s.weight / frfs.freqs.size,
        labels=labels,
        units=(unit,) * n,
        measured=none,
        scale=np.full(n, scale),
        lines=frfs.freqs.size,
    )


def _static_data(found: Measured, s: StaticResidual, at: Mapping[str, int], units: str) -> Data:
    tests = found.statics
    assert tests is not None
    rows, length = np.array([at[c] for c in tests.channels]), UNIT_SYSTEMS[units].length
    loads, moved = (
        np.zeros((len(at), len(tests.cases))),
        np.full((len(at), len(tests.cases)), np.nan),
    )
    loads[rows], moved[rows] = tests.loads, tests.deflections / length
    seen = np.isfinite(moved)
    names = {i: c for c, i in at.items()}
    where = np.argwhere(seen).tolist()
    labels = tuple(f"{tests.cases[j]}: {names[i]}" for i, j in where)
    size = s.error * np.sqrt(np.nanmean(moved**2, axis=0)) * length
    scale = np.broadcast_to(size, seen.shape)[seen]
    term = StaticDeflections(loads, moved, s.error)
    return Data(
        name=found.name,
        kind=s.kind,
        term=term,
        weight=s.weight,
        labels=labels,
        units=("m",) * len(labels),
        measured=moved[seen] * length,
        scale=scale,
    )


def _mass_data(found: Measured, s: MassResidual, units: str, rigid: RigidMass) -> Data:
    kg, m = UNIT_SYSTEMS[units].kilograms, UNIT_SYSTEMS[units].length
    value, std = np.full(10, np.nan), np.ones(10)
    if s.mass is not None:
        value[0], std[0] = s.mass, s.mass_error * s.mass
    if s.center is not None:
        value[1:4], std[1:4] = s.center, s.center_error
    if s.inertia is not None:
        value[4:], std[4:] = s.inertia, s.inertia_error * np.nanmax(np.abs(s.inertia))
    unit = np.array([kg, m, m, m, *(kg * m**2,) * 6])
    seen = np.isfinite(value)
    if not seen.any():
        raise ConfigError(f"[[residual]] {found.name}: every value of the weighing is nan")
    at = np.flatnonzero(seen).tolist()
    labels, names = tuple(WEIGHED[i] for i in at), tuple(WEIGHED_UNITS[i] for i in at)
    term = MassProperties(rigid, value / unit, std / unit)
    return Data(
        name=found.name,
        kind=s.kind,
        term=term,
        weight=s.weight,
        labels=labels,
        units=names,
        measured=value[seen],
        scale=std[seen],
    )


def rigid_mass(model: Model, parameters: ParameterSet) -> RigidMass:
    """The rigid-body mass of a deck, held or not, as it depends on parameters."""
    free = unconstrained(model)
    system = assemble(free)
    r = system.rigid_body()
    none = sparse.csr_array((6, 6))

    def seen(mass: sparse.csr_array) -> sparse.csr_array:
        return sparse.csr_array(r.T @ (mass @ r))

    parts = tuple(
        AffineTerm(t.function, none, seen(t.mass)) for t in affine_terms(free, parameters, system)
    )
    affine = AffineSystem(none, seen(system.mass), parameters, parts, none)
    return RigidMass(affine, np.eye(6))
