"""Measured data other than modes as residuals: FRFs, their zeros, static tests, a weighing."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from ringtrue.checks.materials import unconstrained
from ringtrue.core.arrays import Float, FrozenArrays, Int
from ringtrue.core.channels import POWER, match_channels
from ringtrue.core.modes import ModeSet
from ringtrue.core.parameters import ParameterSet
from ringtrue.core.signals import FrfSet
from ringtrue.core.units import UnitSystem
from ringtrue.errors import ConfigError, DataError, did_you_mean
from ringtrue.fem.assembly import assemble
from ringtrue.fem.parametrisation.derivatives import affine_terms
from ringtrue.fem.parametrisation.polynomials import AffineTerm
from ringtrue.io.campaign_tables import StaticTests, read_statics
from ringtrue.io.frfs import read_frfs
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
from ringtrue.updating.residuals.modal import ResidualBlock, Term
from ringtrue.updating.residuals.static import (
    MassPropertyDeviations,
    RigidMass,
    StaticDeflections,
)

# of the lowest and the highest mode of the test: where FRFs are compared if nothing is said
BAND = (0.8, 1.2)
WEIGHED = ("mass", "x", "y", "z", "Ixx", "Iyy", "Izz", "Ixy", "Iyz", "Izx")
WEIGHED_UNITS = ("kg", *("m",) * 3, *("kg m²",) * 6)


@dataclass(frozen=True, slots=True, eq=False)
class Data(FrozenArrays):
    """A kind of residuals besides those of the modes, and what is shown of it.

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

    def shown(self, block: ResidualBlock) -> Float:
        """Values (n,) of the model at a point."""
        if self.lines:
            return np.asarray(
                self.scale
                * np.sqrt(
                    np.mean(block.value.reshape(-1, self.scale.size) ** 2, axis=0)
                )
            )
        return self.measured - self.scale * block.value


@dataclass(frozen=True, slots=True)
class MeasuredModel:
    """The model that residuals are computed on.

    Attributes
    ----------
    at : mapping of str to int
        Positions of the channels among all of the model.
    units : UnitSystem
        Of the deck.
    rigid : callable
        The rigid-body mass of the deck, for a weighing.
    active : tuple of int
        The parameters that x stands for.
    """

    at: Mapping[str, int]
    units: UnitSystem
    rigid: Callable[[], RigidMass]
    active: tuple[int, ...]

    def rows(self, channels: Sequence[str]) -> Int:
        """Positions of channels."""
        return np.array([self.at[c] for c in channels], dtype=np.int64)


@dataclass(frozen=True, slots=True)
class Source:
    """What [[residual]]s are read from.

    Attributes
    ----------
    base : Path
        Folder that files are seen from.
    modes : ModeSet
        Elastic modes of the test: their band and damping serve FRFs that say nothing else.
    frfs : FrfSet, optional
        Of the test, for FRFs without a file.
    why : str
        Why there are none.
    """

    base: Path
    modes: ModeSet
    frfs: FrfSet | None = None
    why: str = "the test has no FRFs"


@dataclass(frozen=True, slots=True, eq=False)
class Measured(ABC):
    """One [[residual]] as read: a kind of residuals owns its reading, scaling and display.

    Attributes
    ----------
    name : str
        As given, else the kind.
    outputs, inputs : tuple of str
        Channels where it was measured and excited.
    """

    name: str
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]

    @property
    def static(self) -> bool:
        """Whether static deflections were measured."""
        return False

    @property
    def highest(self) -> float:
        """Highest frequency, Hz, that modes of the model are needed up to; 0 for none."""
        return 0.0

    @abstractmethod
    def data(self, on: MeasuredModel) -> Data:
        """The residuals on a model."""


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
        asked = np.array(section.lines)
        step = float(np.diff(freqs).max(initial=0.0))
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
        inside[
            np.linspace(0, inside.size - 1, min(section.count, inside.size))
            .round()
            .astype(int)
        ]
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
        f = f[:1]
        zeta = np.array([section.damping])
    elif good.any():
        f = f[good]
        zeta = zeta[good]
    else:
        raise ConfigError(
            f"[[residual]] {section.name or 'frf'}: the test modes have no damping; give damping "
            "= ..."
        )
    return Damping(f, zeta + decay / (2 * np.pi * f))


@dataclass(frozen=True, slots=True, eq=False)
class FrfMeasurement(Measured):
    """FRFs at the chosen lines and at all, with the damping of the model that they are compared
    with.
    """

    section: FrfResidual
    frfs: FrfSet
    record: FrfSet
    damping: Damping

    @classmethod
    def read(cls, section: FrfResidual, source: Source) -> FrfMeasurement:
        """Of a file, else those of the test."""
        name = section.name or section.kind
        found = read_frfs(source.base / section.file) if section.file else source.frfs
        where = section.file or "the test"
        if found is None:
            raise ConfigError(f"[[residual]] {name}: {source.why}; name a file of them")
        out = _picked(
            [c.id for c in found.outputs], section.outputs, f"{where}: output"
        )
        into = _picked([c.id for c in found.inputs], section.inputs, f"{where}: input")
        lines = _lines(section, found.freqs, source.modes.frequencies, where)
        whole = np.isfinite(found.data).all(axis=(1, 2)) & (found.freqs > 0)
        record = found.part(np.flatnonzero(whole), out, into)
        part = found.part(lines, out, into)
        if not np.abs(part.data).all():
            raise DataError(
                f"{where}: an FRF is zero at a chosen line; leave the channel or the line out"
            )
        outputs = tuple(c.id for c in part.outputs)
        inputs = tuple(c.id for c in part.inputs)
        damping = _damping(section, source.modes, found.window_decay)
        return cls(
            name,
            outputs,
            inputs,
            section=section,
            frfs=part,
            record=record,
            damping=damping,
        )

    @property
    def highest(self) -> float:
        """See `Measured`."""
        return float(self.frfs.freqs.max())

    def data(self, on: MeasuredModel) -> Data:
        """Deviations, root mean square over the lines."""
        s = self.section
        frfs = self.frfs
        term = Frf(
            freqs=frfs.freqs,
            measured=frfs.data * on.units.kilograms,
            outputs=on.rows(self.outputs),
            inputs=on.rows(self.inputs),
            damping=self.damping,
            order=POWER[frfs.kind],
            form=s.form,
            std=s.error,
            record=(self.record.freqs, self.record.data * on.units.kilograms),
        )
        labels = tuple(f"{o} / {i}" for o in self.outputs for i in self.inputs)
        n = len(labels)
        unit = "% rms"
        scale = 100 * np.sqrt(2)
        if s.form == "log":
            unit = "dB rms"
            scale = 20 / np.log(10)
        return Data(
            name=self.name,
            kind=s.kind,
            term=term,
            weight=s.weight / frfs.freqs.size,
            labels=labels,
            units=(unit,) * n,
            measured=np.full(n, np.nan),
            scale=np.full(n, s.error * scale),
            lines=frfs.freqs.size,
        )


@dataclass(frozen=True, slots=True, eq=False)
class ZeroMeasurement(Measured):
    """Zeros of an FRF."""

    section: AntiResonanceResidual

    @classmethod
    def read(cls, section: AntiResonanceResidual, source: Source) -> ZeroMeasurement:
        """As the section states them."""
        name = section.name or section.kind
        return cls(name, (section.output,), (section.input,), section)

    @property
    def highest(self) -> float:
        """See `Measured`."""
        return max(self.section.frequencies)

    def data(self, on: MeasuredModel) -> Data:
        """Frequencies of the zeros, Hz."""
        s = self.section
        f = np.array(s.frequencies)
        return Data(
            name=self.name,
            kind=s.kind,
            term=AntiResonances(on.at[s.output], on.at[s.input], f, s.error, s.gate),
            weight=s.weight,
            labels=tuple(
                f"{s.output} / {s.input}: zero {i + 1}" for i in range(f.size)
            ),
            units=("Hz",) * f.size,
            measured=f,
            scale=s.error * f,
        )


@dataclass(frozen=True, slots=True, eq=False)
class StaticMeasurement(Measured):
    """Static deflections."""

    section: StaticResidual
    tests: StaticTests

    @classmethod
    def read(cls, section: StaticResidual, source: Source) -> StaticMeasurement:
        """Of a file."""
        tests = read_statics(source.base / section.file)
        loaded = tuple(
            c for c, f in zip(tests.channels, tests.loads, strict=True) if f.any()
        )
        return cls(section.name or section.kind, tests.channels, loaded, section, tests)

    @property
    def static(self) -> bool:
        """Whether static deflections were measured."""
        return True

    def data(self, on: MeasuredModel) -> Data:
        """Deflections, m."""
        s = self.section
        tests = self.tests
        rows = on.rows(tests.channels)
        length = on.units.length
        shape = len(on.at), len(tests.cases)
        loads = np.zeros(shape)
        moved = np.full(shape, np.nan)
        loads[rows], moved[rows] = tests.loads, tests.deflections / length
        seen = np.isfinite(moved)
        names = {i: c for c, i in on.at.items()}
        labels = tuple(
            f"{tests.cases[j]}: {names[i]}" for i, j in np.argwhere(seen).tolist()
        )
        size = s.error * np.sqrt(np.nanmean(moved**2, axis=0)) * length
        return Data(
            name=self.name,
            kind=s.kind,
            term=StaticDeflections(loads, moved, s.error),
            weight=s.weight,
            labels=labels,
            units=("m",) * len(labels),
            measured=moved[seen] * length,
            scale=np.broadcast_to(size, seen.shape)[seen],
        )


@dataclass(frozen=True, slots=True, eq=False)
class MassMeasurement(Measured):
    """A weighing."""

    section: MassResidual

    @classmethod
    def read(cls, section: MassResidual, source: Source) -> MassMeasurement:
        """As the section states it."""
        return cls(section.name or section.kind, (), (), section)

    def data(self, on: MeasuredModel) -> Data:
        """Mass, centre of gravity and moments of inertia that were measured."""
        s = self.section
        value = np.full(10, np.nan)
        std = np.ones(10)
        if s.mass is not None:
            value[0], std[0] = s.mass, s.mass_error * s.mass
        if s.center is not None:
            value[1:4], std[1:4] = s.center, s.center_error
        if s.inertia is not None:
            value[4:], std[4:] = (
                s.inertia,
                s.inertia_error * np.nanmax(np.abs(s.inertia)),
            )
        kg = on.units.kilograms
        m = on.units.length
        unit = np.array([kg, m, m, m, *(kg * m**2,) * 6])
        seen = np.isfinite(value)
        if not seen.any():
            raise ConfigError(
                f"[[residual]] {self.name}: every value of the weighing is nan"
            )
        at = np.flatnonzero(seen).tolist()
        rigid = replace(on.rigid(), active=on.active)
        return Data(
            name=self.name,
            kind=s.kind,
            term=MassPropertyDeviations(rigid, value / unit, std / unit),
            weight=s.weight,
            labels=tuple(WEIGHED[i] for i in at),
            units=tuple(WEIGHED_UNITS[i] for i in at),
            measured=value[seen],
            scale=std[seen],
        )


READERS: dict[type, Callable[[Any, Source], Measured]] = {
    FrfResidual: FrfMeasurement.read,
    AntiResonanceResidual: ZeroMeasurement.read,
    StaticResidual: StaticMeasurement.read,
    MassResidual: MassMeasurement.read,
}


def read_measured(section: DataResidual, source: Source) -> Measured:
    """Read what a [[residual]] names.

    Raises
    ------
    ConfigError, DataError
        If there are no FRFs, or none of the lines or channels that are asked for.
    """
    return READERS[type(section)](section, source)


def channels_of(found: Sequence[Measured]) -> tuple[str, ...]:
    """Channels that were measured or excited, each once."""
    return tuple(dict.fromkeys(c for m in found for c in (*m.outputs, *m.inputs)))


def excited(found: Sequence[Measured], at: Mapping[str, int]) -> Int:
    """Positions of the channels at which something was struck or pulled."""
    return np.array(
        [at[c] for c in dict.fromkeys(c for m in found for c in m.inputs)],
        dtype=np.int64,
    )


def flexible(
    model: ReducedModel, found: Sequence[Measured], loaded: Int
) -> ReducedModel:
    """With the static responses to what was struck or pulled; their derivatives where deflections
    were read.
    """
    if not loaded.size:
        return model
    static = any(m.static for m in found)
    return with_responses(
        model, loaded, np.zeros(len(model.parameters)), sensitivities=static
    )[0]


def check_moving(
    found: Sequence[Measured], at: Mapping[str, int], observe: Float
) -> None:
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
        need = m.inputs if m.static else (*m.outputs, *m.inputs)
        if still := [c for c in need if not observe[at[c]].any()]:
            raise DataError(
                f"[[residual]] {m.name}: channel {still[0]} is held in the deck, it cannot move"
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
        AffineTerm(t.function, none, seen(t.mass))
        for t in affine_terms(free, parameters, system)
    )
    affine = AffineSystem(none, seen(system.mass), parameters, parts, none)
    return RigidMass(affine, np.eye(6))
