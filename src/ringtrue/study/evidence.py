"""What a correlation rests on: orthogonality, channels, close modes, tracks, FRFs, expansion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from ringtrue.core.arrays import Complex, Float
from ringtrue.core.dofs import DofSet
from ringtrue.core.modes import ModeSet
from ringtrue.core.progress import Progress
from ringtrue.core.signals import FrfSet
from ringtrue.core.testmodel import Observation
from ringtrue.core.units import UNIT_SYSTEMS
from ringtrue.correlation.frf import compare_frfs, fdac
from ringtrue.correlation.measures import complete
from ringtrue.correlation.orthogonality import Gate, Lift
from ringtrue.correlation.pairing import Pairing
from ringtrue.correlation.tracking import Tracks, track
from ringtrue.eigen.modes import low_shift
from ringtrue.errors import ConfigError, InputError, NumericalError
from ringtrue.fem.response import frf
from ringtrue.reduction.expansion import (
    Expanded,
    expand_dynamic,
    expand_hybrid,
    expand_serep,
    expand_static,
)
from ringtrue.reduction.static import craig_bampton_coordinates, craig_bampton_of, tam
from ringtrue.shapes.mac import auto_mac
from ringtrue.study.config import StudyConfig
from ringtrue.study.config_sections import CorrelateSection
from ringtrue.study.opened import Opened, scene_modes
from ringtrue.study.reference import Reference, settings
from ringtrue.study.results import Evidence, FrfEvidence, IdentifyStage, Scene
from ringtrue.updating.selection.localisation import NOISE

# entries of the transform of a test-analysis model that are built without being asked for
LARGEST = 100_000_000
LINES = 90  # of the FDAC: what can be told apart in a drawing


def gate(config: CorrelateSection) -> Gate:
    """The limits of the cross-orthogonality."""
    own, off = config.accept_orthogonality, config.accept_off_diagonal
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
    shapes = system.local @ opened.modes(fmax).modes.shapes if config.tam == "hybrid" else None
    try:
        if config.tam == "craig-bampton":  # with the channels held as many modes reach beyond fmax
            held = craig_bampton_of(
                system.stiffness, system.mass, observe, len(opened.modes(fmax).modes)
            )
            return ChannelMass(
                held.mass, lift=lambda m: craig_bampton_coordinates(held, m.shapes, m.frequencies)
            )
        labels = opened.analysis.pencil.labels
        return ChannelMass(
            tam(
                system.stiffness, system.mass, observe, config.tam, modes=shapes, labels=labels
            ).mass
        )
    except (InputError, NumericalError) as e:  # channels that read the same, or too few of them
        return ChannelMass(why=f"no {config.tam} mass: {e}")


def evidence(
    reference: Reference,
    fe: ModeSet,
    pairing: Pairing,
    config: StudyConfig,
    mass: ChannelMass | None = None,
) -> Evidence:
    """All measures of the elastic test modes against a model.

    Parameters
    ----------
    reference : Reference
    fe : ModeSet
        At the channels of the sheet, mass-normalised.
    pairing : Pairing
        Of `reference.elastic` with all of `fe`.
    config : StudyConfig
    mass : ChannelMass, optional
        Of `channel_mass`, at the channels of the reference.
    """
    test, c, mass = reference.elastic, config.correlate, mass or ChannelMass()
    measures = complete(
        test,
        fe,
        pairing,
        mass=mass.matrix,
        mass_name=NAMES.get(c.tam, c.tam),
        lift=mass.lift,
        gate=gate(c),
        std_a=reference.elastic_std.frequency,
        settings=settings(config),
    )
    if mass.why:
        measures = replace(measures, notes=(*measures.notes, mass.why))
    return Evidence(measures, auto_mac(test.shapes))


def followed(final: ModeSet, remodelled: ModeSet, initial: ModeSet, count: int) -> Tracks | None:
    """The lowest `count` modes of the final model found again, by shape at the channels, in what it
    came from.
    """
    sets = (final, remodelled, initial)
    count = min(count, *(len(s) for s in sets))
    if not count:
        return None
    return track([s.frequencies for s in sets], [s.shapes for s in sets], count=count)


def synthesised(
    opened: Opened,
    observation: Observation,
    fe: ModeSet,
    zeta: Float,
    measured: FrfSet,
    units: str,
    *,
    fmax: float,
) -> FrfSet:
    """FRFs of a model where and as those of the test are: its modes with the damping `zeta`, and
    the modes above.

    The flexibility of the modes that were not computed is exact near 0 Hz.

    Parameters
    ----------
    opened : Opened
    observation : Observation
    fe : ModeSet
        Modes of the model at all channels, mass-normalised.
    zeta : (m,) float64
    measured : FrfSet
        Of `on_sheet`.
    units : str
        Of the deck, a name of `UNIT_SYSTEMS`.
    fmax : float, Hz
        Up to which `fe` holds all modes.
    """
    outputs, inputs = (tuple(c.id for c in side) for side in (measured.outputs, measured.inputs))
    at = {c: i for i, c in enumerate(fe.channels)}
    out, into = (fe.shapes[[at[c] for c in side]] for side in (outputs, inputs))
    w = 2 * np.pi * fe.frequencies
    lam = w * np.abs(w)
    shift = low_shift(fmax)  # that of the modes, whose factor is often there still
    load = at_channels(opened, observation, inputs).T.toarray()
    flexible = at_channels(opened, observation, outputs) @ opened.analysis.pencil.at(shift).solve(
        load
    )
    rest = flexible.reshape(len(outputs), -1) - (out / (lam - shift)) @ into.T
    # an exponential window on the responses of the test damps them: s = iω + σ
    zeta = zeta + measured.window_decay / np.maximum(np.abs(w), 2 * np.pi * measured.freqs[0])
    h: Complex = frf(
        measured.freqs,
        fe.frequencies,
        damping=zeta,
        phi_out=out,
        phi_in=into,
        kind=measured.kind,
        residual=rest,
    )
    h = h / UNIT_SYSTEMS[units].kilograms
    return replace(measured, data=h, coherence=np.full(h.shape, np.nan))


def on_sheet(found: IdentifyStage, low: float, high: float) -> FrfSet | None:
    """The measured FRFs between two frequencies, Hz, at the outputs and inputs on the sheet; None
    where none is.
    """
    frfs, known = found.frfs, set(found.test.channels)
    if frfs is None:
        return None
    out, into = (
        np.flatnonzero([c.id in known for c in side]) for side in (frfs.outputs, frfs.inputs)
    )
    line = np.flatnonzero((frfs.freqs > low) & (frfs.freqs < high))
    if not (line.size and out.size and into.size):
        return None
    at = np.ix_(line, out, into)
    return replace(
        frfs,
        data=frfs.data[at],
        freqs=frfs.freqs[line],
        outputs=tuple(frfs.outputs[i] for i in out.tolist()),
        inputs=tuple(frfs.inputs[i] for i in into.tolist()),
        coherence=frfs.coherence[at],
        averages=frfs.averages[into],
    )


def _between(frfs: FrfSet, low: float, high: float) -> FrfSet:
    line = np.flatnonzero((frfs.freqs >= low) & (frfs.freqs <= high))
    return replace(
        frfs, data=frfs.data[line], freqs=frfs.freqs[line], coherence=frfs.coherence[line]
    )


def frf_evidence(
    found: IdentifyStage, measured: FrfSet, initial: FrfSet, final: FrfSet, config: StudyConfig
) -> FrfEvidence | None:
    """The FRFs in the band of the identified modes, by channel, by line, and line against line;
    None for few lines.
    """
    if found.hammer is None or not len(found.hammer):
        return None
    f = found.hammer.frequencies
    low, high = (
        config.identify.hammer_fmin or 0.9 * f.min(),
        config.identify.hammer_fmax or 1.1 * f.max(),
    )
    test, before, after = (_between(x, float(low), float(high)) for x in (measured, initial, final))
    if test.freqs.size < 2:
        return None
    thin = slice(None, None, -(-test.freqs.size // LINES))
    rows = [x.data[thin].reshape(x.data[thin].shape[0], -1) for x in (test, before, after)]
    return FrfEvidence(
        compare_frfs(test, before),
        compare_frfs(test, after),
        test.freqs[thin],
        fdac(rows[0], rows[1]),
        fdac(rows[0], rows[2]),
    )


def expanded(
    method: str, opened: Opened, look: Observation, test: ModeSet, fmax: float, progress: Progress
) -> Expanded:
    """Test shapes on the free degrees of freedom of a deck.

    Parameters
    ----------
    method : {"hybrid", "serep", "guyan", "dynamic"}
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
    y, f = np.asarray(test.shapes.real, dtype=np.float64), test.frequencies
    k, m, labels = system.stiffness, system.mass, opened.analysis.pencil.labels
    try:
        if method == "guyan":
            return expand_static(k, observe, y, labels=labels)
        if method == "dynamic":
            return expand_dynamic(k, m, observe, y, f, labels=labels, progress=progress)
        modes = np.asarray(system.local @ opened.modes(fmax).modes.shapes)
        if method == "hybrid":
            return expand_hybrid(
                k,
                m,
                observe=observe,
                shapes=y,
                frequencies=f,
                modes=modes,
                noise=NOISE,
                labels=labels,
            )
        # half as many as channels: with more of them noise is fitted
        return expand_serep(modes[:, : max(1, len(test.channels) // 2)], observe, y)
    except (InputError, NumericalError) as e:
        raise ConfigError(
            f"correlate.expand {method!r}: {e}; try another of hybrid, serep, guyan, dynamic"
        ) from e


def on_scene(found: Expanded, opened: Opened, test: ModeSet, scene: Scene) -> ModeSet:
    """Expanded test shapes at the scene's translations."""
    labels = opened.analysis.dofs
    assert isinstance(labels, DofSet)
    shapes: Float = np.asarray(opened.analysis.system.transform @ found.shapes)
    return scene_modes(
        ModeSet(
            frequencies=test.frequencies,
            damping=test.damping,
            shapes=shapes,
            labels=labels,
            norm=test.norm,
            source=test.source,
        ),
        scene,
    )
