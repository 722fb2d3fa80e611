"""What a correlation rests on: orthogonality, channels, close modes, tracks, FRFs, expansion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Complex, Float
from ringtrue.core.modes import ModeSet
from ringtrue.core.signals import FrfSet
from ringtrue.core.testmodel import Observation
from ringtrue.core.units import UnitSystem
from ringtrue.correlation.frf import compare_frfs, fdac
from ringtrue.correlation.measures import complete
from ringtrue.correlation.orthogonality import Gate, Lift, OrthogonalityTest
from ringtrue.correlation.pairing import Pairing, Tracks, track
from ringtrue.eigen.shift import low_shift
from ringtrue.errors import ConfigError, InputError, NumericalError
from ringtrue.fem.response import frf
from ringtrue.reduction.expansion import (
    Expanded,
    ShapeReadings,
    expand_hybrid,
    expand_serep,
)
from ringtrue.reduction.static import craig_bampton_coordinates, craig_bampton_of, tam
from ringtrue.shapes import auto_mac
from ringtrue.study.config import StudyConfig
from ringtrue.study.config_sections import CorrelateSection
from ringtrue.study.opened import Opened
from ringtrue.study.reference import settings
from ringtrue.study.results import (
    Evidence,
    FrfEvidence,
    IdentifyStage,
    ReferenceModes,
    Scene,
)
from ringtrue.study.scene import scene_modes
from ringtrue.updating.selection.localisation import EXPANSION_MISFIT

# entries of the transform of a test-analysis model that are built without being asked for
LARGEST = 100_000_000


def gate(config: CorrelateSection) -> Gate:
    """The limits of the cross-orthogonality."""
    own = config.accept_orthogonality
    off = config.accept_off_diagonal
    return Gate(own / 100, off / 100, f"{own:g} % / {off:g} %")


def at_channels(
    opened: Opened, observation: Observation, channels: tuple[str, ...]
) -> sparse.csr_array:
    """Readings of the channels by the free DOFs of a model, (channel, f)."""
    here = {c: i for i, c in enumerate(observation.channels)}
    rows = observation.matrix[[here[c] for c in channels]]
    return sparse.csr_array(rows @ opened.analysis.system.transform)


@dataclass(frozen=True, slots=True, eq=False)
class ChannelMass:
    """The mass of a deck at channels.

    Attributes
    ----------
    matrix : (n, n) float64, optional
    why : str
        Why there is none.
    lift : callable, optional
        Coordinates of shapes that it is over, where these are not the channels.
    """

    matrix: Float | None = None
    why: str = ""
    lift: Lift | None = None


NAMES = {"irs": "IRS", "guyan": "Guyan", "craig-bampton": "Craig-Bampton"}


def channel_mass(
    opened: Opened,
    observation: Observation,
    channels: tuple[str, ...],
    config: CorrelateSection,
    fmax: float,
) -> ChannelMass:
    """The deck's mass at the channels, by the test-analysis model of the study."""
    system = opened.analysis.system
    size = system.stiffness.shape[0]
    if config.tam == "serep":
        return ChannelMass()
    if size * len(channels) > LARGEST:
        return ChannelMass(
            why=f"no {config.tam} mass: {size} DOFs and {len(channels)} channels take too much "
            "memory"
        )
    observe = at_channels(opened, observation, channels)
    modes = opened.modes(fmax).modes
    matrices = (system.stiffness, system.mass, observe)
    try:
        # with the channels held as many modes reach beyond fmax
        if config.tam == "craig-bampton":
            held = craig_bampton_of(*matrices, len(modes))
            return ChannelMass(
                held.mass,
                lift=lambda m: craig_bampton_coordinates(held, m.shapes, m.frequencies),
            )
        shapes = system.local @ modes.shapes if config.tam == "hybrid" else None
        labels = opened.analysis.pencil.labels
        return ChannelMass(tam(*matrices, config.tam, modes=shapes, labels=labels).mass)
    # channels that read the same, or too few of them
    except (InputError, NumericalError) as e:
        return ChannelMass(why=f"no {config.tam} mass: {e}")


def evidence(
    reference: ReferenceModes,
    fe: ModeSet,
    pairing: Pairing,
    config: StudyConfig,
    mass: ChannelMass | None = None,
) -> Evidence:
    """All measures of the elastic test modes against a model.

    Parameters
    ----------
    reference : ReferenceModes
    fe : ModeSet
        At the channels of the sheet, mass-normalised.
    pairing : Pairing
        Of `reference.elastic` with all of `fe`.
    config : StudyConfig
    mass : ChannelMass, optional
        Of `channel_mass`, at the channels of the reference.
    """
    test = reference.elastic
    c = config.correlate
    mass = mass or ChannelMass()
    measures = complete(
        test,
        fe,
        pairing,
        orthogonality=OrthogonalityTest(
            gate(c), mass.matrix, NAMES.get(c.tam, c.tam), mass.lift
        ),
        std=(reference.elastic_std.frequency, float("nan")),
        settings=settings(config),
    )
    if mass.why:
        measures = replace(measures, notes=(*measures.notes, mass.why))
    return Evidence(measures, auto_mac(test.shapes))


def followed(sets: Sequence[ModeSet], count: int) -> Tracks | None:
    """The lowest `count` modes of the first set, of the final model, found again, by shape at the
    channels, in those of what it came from.
    """
    count = min(count, *(len(s) for s in sets))
    if not count:
        return None
    return track([s.frequencies for s in sets], [s.shapes for s in sets], count=count)


@dataclass(frozen=True, slots=True, eq=False)
class ModelModes:
    """A deck with its modes at all channels, mass-normalised, and their damping ratios (m,)."""

    opened: Opened
    modes: ModeSet
    damping: Float


def synthesised(
    model: ModelModes,
    observation: Observation,
    measured: FrfSet,
    units: UnitSystem,
    fmax: float,
) -> FrfSet:
    """FRFs of a model where and as those of the test are: its modes, and the flexibility of the
    modes above, which is exact near 0 Hz.

    Parameters
    ----------
    model : ModelModes
    observation : Observation
    measured : FrfSet
        Of `on_sheet`.
    units : UnitSystem
        Of the deck.
    fmax : float, Hz
        Up to which the model holds all modes.
    """
    fe = model.modes
    outputs = tuple(c.id for c in measured.outputs)
    inputs = tuple(c.id for c in measured.inputs)
    at = {c: i for i, c in enumerate(fe.channels)}
    out, into = (fe.shapes[[at[c] for c in side]] for side in (outputs, inputs))
    w = 2 * np.pi * fe.frequencies
    lam = w * np.abs(w)
    pencil = model.opened.analysis.pencil
    # that of the modes, whose factor is often there still
    shift = low_shift(pencil, fmax)
    load = at_channels(model.opened, observation, inputs).T.toarray()
    moved = pencil.at(shift).solve(load)
    whole = at_channels(model.opened, observation, outputs) @ moved
    rest = whole.reshape(len(outputs), -1) - (out / (lam - shift)) @ into.T
    return like_measured(
        measured, replace(fe, damping=model.damping), (out, into), rest, units
    )


def like_measured(
    measured: FrfSet,
    modes: ModeSet,
    seen: tuple[Float, Float],
    rest: Float,
    units: UnitSystem,
) -> FrfSet:
    """FRFs of modes and of the flexibility of those above, as measured ones are.

    Parameters
    ----------
    measured : FrfSet
    modes : ModeSet
        Frequencies and damping ratios.
    seen : ((out, m), (in, m)) float64
        Mass-normalised shapes at the outputs and inputs.
    rest : (out, in) float64
        Flexibility, per unit force.
    units : UnitSystem
        Of the deck.
    """
    out, into = seen
    w = 2 * np.pi * np.abs(modes.frequencies)
    # an exponential window on the responses of the test damps them: s = iω + σ
    window = measured.window_decay / np.maximum(w, 2 * np.pi * measured.freqs[0])
    h: Complex = frf(
        measured.freqs,
        modes.frequencies,
        damping=modes.damping + window,
        phi_out=out,
        phi_in=into,
        kind=measured.kind,
        residual=rest,
    )
    h = h / units.kilograms
    return replace(measured, data=h, coherence=np.full(h.shape, np.nan))


def on_sheet(found: IdentifyStage, low: float, high: float) -> FrfSet | None:
    """The measured FRFs between two frequencies, Hz, at the outputs and inputs on the sheet; None
    where none is.
    """
    frfs = found.frfs
    if frfs is None:
        return None
    known = set(found.test.channels)
    out = np.flatnonzero([c.id in known for c in frfs.outputs])
    into = np.flatnonzero([c.id in known for c in frfs.inputs])
    line = np.flatnonzero((frfs.freqs > low) & (frfs.freqs < high))
    if not (line.size and out.size and into.size):
        return None
    return frfs.part(line, out, into)


def frf_band(found: IdentifyStage, config: StudyConfig) -> tuple[float, float] | None:
    """Where FRFs are compared: the band of the identified modes, Hz; None without modes."""
    if found.hammer is None or not len(found.hammer):
        return None
    f = found.hammer.modes.frequencies
    low = config.identify.hammer_fmin or 0.9 * float(f.min())
    high = config.identify.hammer_fmax or 1.1 * float(f.max())
    return low, high


def frf_evidence(
    found: IdentifyStage,
    measured: FrfSet,
    initial: FrfSet,
    final: FrfSet,
    config: StudyConfig,
) -> FrfEvidence | None:
    """The FRFs in the band of the identified modes, by channel, by line, and line against line;
    None for few lines.
    """
    band = frf_band(found, config)
    if band is None:
        return None
    line = np.flatnonzero((measured.freqs >= band[0]) & (measured.freqs <= band[1]))
    if line.size < 2:
        return None
    every = np.arange(len(measured.outputs)), np.arange(len(measured.inputs))
    test, before, after = (x.part(line, *every) for x in (measured, initial, final))
    # of the FDAC: as many as a drawing shows
    thin = slice(None, None, -(-line.size // 90))
    rows = [x.data[thin].reshape(len(x.data[thin]), -1) for x in (test, before, after)]
    return FrfEvidence(
        initial=compare_frfs(test, before),
        final=compare_frfs(test, after),
        lines=test.freqs[thin],
        fdac_initial=fdac(rows[0], rows[1]),
        fdac_final=fdac(rows[0], rows[2]),
    )


def expanded(
    method: str, opened: Opened, look: Observation, test: ModeSet, fmax: float
) -> Expanded:
    """Test shapes on the free degrees of freedom of a deck.

    Parameters
    ----------
    method : {"hybrid", "serep"}
    look : Observation
        From the deck to the channels of the test and maybe more.
    test : ModeSet
        Real shapes.
    fmax : float, Hz
        The modes of the deck up to here span what "serep" and, with the static shapes, "hybrid" can
        give.

    Raises
    ------
    ConfigError
        If the channels do not allow it.
    """
    system = opened.analysis.system
    observe = at_channels(opened, look, test.channels)
    y = np.asarray(test.shapes.real, dtype=np.float64)
    try:
        modes = np.asarray(system.local @ opened.modes(fmax).modes.shapes)
        if method == "hybrid":
            readings = ShapeReadings(observe, y, test.frequencies, EXPANSION_MISFIT)
            return expand_hybrid(
                system.stiffness,
                system.mass,
                readings,
                modes,
                labels=opened.analysis.pencil.labels,
            )
        # half as many as channels: with more of them noise is fitted
        return expand_serep(modes[:, : max(1, len(test.channels) // 2)], observe, y)
    except (InputError, NumericalError) as e:
        raise ConfigError(
            f"correlate.expand {method!r}: {e}; try hybrid or serep"
        ) from e


def on_scene(found: Expanded, opened: Opened, test: ModeSet, scene: Scene) -> ModeSet:
    """Expanded test shapes at the scene's translations."""
    labels = opened.analysis.dofs
    shapes: Float = np.asarray(opened.analysis.system.transform @ found.shapes)
    return scene_modes(replace(test, shapes=shapes, labels=labels), scene)
