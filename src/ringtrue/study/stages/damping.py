"""Damping of the delivered deck: loss factors and dashpots by region from the damping of the identified modes.

The modes are the complex ones that the identification fitted to the FRFs around the resonances (and to the ambient
records). The FRFs themselves are the check: with shapes that are a few per cent off, a direct fit reads an error of
amplitude as damping.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ringtrue.core.arrays import Bool, Complex, Float, Int
from ringtrue.core.modes import ModeSet
from ringtrue.core.uncertainty import Uncertainty
from ringtrue.correlate.pairing import CorrelationTable
from ringtrue.eigen.damped import complex_modes, project
from ringtrue.fem.response import coupled
from ringtrue.io.nastran.edit import edit_fields
from ringtrue.study.evidence import MASS, on_sheet
from ringtrue.study.opened import Opened, Progress
from ringtrue.study.parametric import STILL
from ringtrue.study.results import CorrelateStage, DampedModes, DampedRegions, DampingStage, FinalStage
from ringtrue.study.stages.final import deliver, said
from ringtrue.study.workbench import Workbench
from ringtrue.update.damping import DampingFit, fit_poles, mode_damping
from ringtrue.update.damping_regions import Dampers, DampingRegion, dampers, default_regions

SPAN = 3.0  # half-power half-bandwidths around a resonance in which FRFs are compared
SILENT = 0.8  # standard deviation over that before the data: they said little
BEYOND = 2.0  # standard deviations from what was expected
MANY = 5  # cards or regions that are named


@dataclass(frozen=True, slots=True, eq=False)
class _Measured:
    """Damping ratios of test modes with a partner in the final model, (t,) each."""

    fe: Int
    names: tuple[str, ...]
    hertz: Float
    ratio: Float
    std: Float
    used: Bool
    elastic: Bool


def measured(found: CorrelateStage, final: FinalStage) -> _Measured:
    """The rigid-body modes of the ambient test and the elastic reference modes, those with damping above 0."""
    low = _partners("ambient", found.rigid, found.rigid_uncertainty, final.rigid)
    high = _partners("test", found.reference, found.reference_uncertainty, final.table)
    fe, hertz, ratio, std, used = (np.concatenate(p) for p in zip(low[1:], high[1:], strict=True))
    names = low[0] + high[0]
    good = np.flatnonzero((ratio > 0) & np.isfinite(std) & (final.observed.frequencies[fe] > 0))
    return _Measured(
        fe[good],
        tuple(names[i] for i in good.tolist()),
        hertz[good],
        ratio[good],
        std[good],
        used[good].astype(bool),
        good >= len(low[0]),
    )


def _partners(
    what: str, modes: ModeSet, std: Uncertainty, table: CorrelationTable
) -> tuple[list[str], Int, Float, Float, Float, Bool]:
    a, b = table.pairing.a, table.pairing.b
    names = [f"{what} mode {i + 1}" for i in a.tolist()]
    return names, b, modes.frequencies[a], modes.damping[a], std.damping[a], table.used


def nothing(why: str) -> DampingStage:
    """A stage that found nothing to do."""
    return DampingStage(why, None, None, 0.0, "", (), (), ())


def run(desk: Workbench, progress: Progress) -> DampingStage:
    """Fit the regions to the modes that the updating saw, predict those left out, compare the FRFs."""
    final: FinalStage = desk.get("final")
    test = measured(desk.get("correlate"), final)
    if not test.used.any():
        return nothing("no test mode with a damping ratio has a partner in the final model")
    opened = desk.delivered or deliver(desk)[0]
    progress(0.1, "modes of the delivered deck")
    shapes = opened.modes(desk.deck.fmax).modes
    f = shapes.frequencies
    moving = np.flatnonzero(f > STILL * f.max())
    at = np.searchsorted(moving, test.fe)
    values = (2 * np.pi * f[moving]) ** 2
    progress(0.5, "damping of the regions")
    phi = np.asarray(opened.analysis.system.local @ shapes.shapes[:, moving])
    total = project(phi, opened.analysis.system.viscous, opened.analysis.system.structural)
    common = float(np.median(test.ratio[test.used]))
    found = dampers(opened.model, regions(desk, opened), values, shapes.shapes[:, moving], total, common)
    if not found.regions:
        return nothing("no region takes part in any mode")
    std = np.hypot(test.std, desk.config.damping.error * test.ratio)
    use = test.used
    fit = fit_poles(values, found.mechanisms, test.ratio[use], std[use], at[use], base=found.base)
    after, after_std = mode_damping(values, found.mechanisms, fit, at)
    before, words = _before(values, total, common)
    progress(0.8, "FRFs around the resonances")
    errors = frf_errors(desk, test, moving, (before, (fit.viscous, fit.structural)))
    ratio = complex_modes(values, *before).damping[at]
    changes, files = _written(desk, opened, found, fit)
    return DampingStage(
        "",
        _regions(found, fit),
        DampedModes(
            test.fe, test.names, use, test.hertz, test.ratio, test.std, ratio, after, after_std, errors[0], errors[1]
        ),
        fit.misfit,
        words,
        flags(found, fit),
        files,
        changes,
    )


def regions(desk: Workbench, opened: Opened) -> tuple[DampingRegion, ...]:
    """As stated in the study; else one a material and one a group of springs."""
    stated = desk.config.damping.region
    if stated:
        return tuple(r.region() for r in stated)
    return default_regions(opened.model, desk.config.suspensions(), desk.deck.regions)


def _before(values: Float, total: tuple[Float, Float], common: float) -> tuple[tuple[Float, Float], str]:
    """ΦᵀDΦ and ΦᵀHΦ before: the deck's own damping, or one ratio for all modes where it has none."""
    if any(a.any() for a in total):
        return total, "the damping of the deck"
    viscous = np.diag(2 * common * np.sqrt(values))
    return (viscous, np.zeros_like(viscous)), f"{100 * common:.2f} % for all modes, the median of the test"


def frf_errors(desk: Workbench, test: _Measured, moving: Int, damped: tuple[tuple[Float, Float], ...]) -> list[Float]:
    """‖H − H_test‖/‖H_test‖ over all FRFs around each test mode, (t,) for each damping; NaN where there is no FRF.

    Paired modes stand at the frequency of the test: what is compared is damping and shape.
    """
    final: FinalStage = desk.get("final")
    frfs = on_sheet(desk.get("identify"), 0.0, desk.deck.fmax)
    if frfs is None:
        return [np.full(test.hertz.size, np.nan) for _ in damped]
    at = {c: i for i, c in enumerate(final.observed.channels)}
    phi_out, phi_in = (
        final.observed.shapes[[at[c.id] for c in side]][:, moving] for side in (frfs.outputs, frfs.inputs)
    )
    hertz = final.observed.frequencies.copy()
    hertz[test.fe] = test.hertz
    values = (2 * np.pi * hertz[moving]) ** 2
    near = np.abs(frfs.freqs[:, None] - test.hertz) <= SPAN * test.ratio * test.hertz  # (line, mode)
    near[:, ~test.elastic] = False  # rigid-body modes are seen by the ambient test, not by the hammer
    lines = np.flatnonzero(near.any(axis=1))
    data = frfs.data[lines] * MASS[desk.deck.units]
    window = 2 * frfs.window_decay * np.eye(moving.size)  # an exponential window damps every mode alike
    return [
        _relative(coupled(frfs.freqs[lines], values, d + window, h, phi_out, phi_in, kind=frfs.kind), data, near[lines])
        for d, h in damped
    ]


def _relative(model: Complex, data: Complex, near: Bool) -> Float:
    """Norm of the difference over that of the data, (t,), over the lines near (l, t) each mode."""
    wrong, size = ((np.abs(x) ** 2).sum(axis=(1, 2)) @ near for x in (model - data, data))
    return np.asarray(np.sqrt(np.divide(wrong, size, out=np.full(size.shape, np.nan), where=size > 0)))


def _regions(found: Dampers, fit: DampingFit) -> DampedRegions:
    expected, spread = np.array([(m.prior, m.std) for m in found.mechanisms]).T
    shrink = np.minimum(spread / fit.std, 1.0)  # a model that misfits takes nothing away from what was known
    return DampedRegions(
        fit.names,
        tuple(_words(r) for r in found.regions),
        tuple(r.nature for r in found.regions),
        fit.coefficients,
        fit.covariance * np.outer(shrink, shrink),
        expected,
        spread,
    )


def _words(region: DampingRegion) -> str:
    """The targets as study.toml has them, fields of one card together."""
    cards: dict[str, list[str]] = {}
    for t in region.targets:
        cards.setdefault(f"{t.card} {t.id}", []).append(t.field)
    text = [f"{card} {','.join(fields)}" for card, fields in cards.items()]
    return "; ".join(text if len(text) <= MANY else [*text[:MANY], f"{len(text) - MANY} more"])


def flags(found: Dampers, fit: DampingFit) -> tuple[str, ...]:
    """What an engineer should look at: upper bounds reached, and coefficients far from what was expected."""
    out = []
    for m, c, at in zip(found.mechanisms, fit.coefficients.tolist(), fit.at_bound.tolist(), strict=True):
        away = (c - m.prior) / m.std
        if at and c > (m.lower + m.upper) / 2:
            out.append(f"{m.name}: {c:.3g} is at its upper bound; dissipation that no region has may be lumped here")
        elif away > BEYOND:
            out.append(f"{m.name}: {c:.3g} is {away:.1f} standard deviations above the expected {m.prior:.2g}")
    lost = [m.name for m, s in zip(found.mechanisms, fit.std.tolist(), strict=True) if s > SILENT * m.std]
    if lost:
        more = f" and {len(lost) - MANY} more" if len(lost) > MANY + 1 else ""
        named = ", ".join(lost[:MANY] if more else lost) + more
        out.append(f"the test says little about {named}: their values are those expected, or zero")
    return tuple(out)


def _written(
    desk: Workbench, opened: Opened, found: Dampers, fit: DampingFit
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The changed fields, and the files of a copy of the delivered deck with them; none unless asked for."""
    if not desk.config.damping.write:
        return (), ()
    changes = [c for r, v in zip(found.regions, fit.coefficients.tolist(), strict=True) for c in r.changes(v)]
    files = edit_fields(opened.model, changes, desk.out / "damped")
    return tuple(said(opened.model, c) for c in changes), tuple(str(f) for f in files)
