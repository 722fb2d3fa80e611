"""Parameter sets, the updating, and the tuning of the suspension."""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.display import with_error
from ringtrue.plots import scene
from ringtrue.plots import updating as plots
from ringtrue.report.parts import (
    Block,
    Cell,
    Fold,
    Heading,
    Items,
    Plot,
    ReportTable,
    Scene3D,
    Section,
    Stages,
    Tabs,
    Text,
    fixed,
    number,
    plain,
    sentence,
)
from ringtrue.report.sections.correlation import pairs
from ringtrue.study.messages import discrepancy_sentence, held_sentences
from ringtrue.study.placing import seat_words
from ringtrue.study.results import DataResult, SetResult, UpdateStage

FEW = 6  # pairs of candidates that stand in the open


def choice(data: Stages) -> Section | None:
    """Heat maps of both sensitivities, sets with their rules, clusters."""
    s = data.sensitivity
    if s is None:
        return None
    if data.correlate is not None:
        f = data.correlate.fe_remodelled.frequencies[s.fe_modes]
    elif data.model is not None:
        f = data.model.modes.frequencies[s.fe_modes]
    else:
        return None
    one = plots.sensitivity(s, s.d_frequency, "∂ ln f / ∂x", f)
    caption = (
        "Sensitivity of the {} to the candidates; x = ln(factor) of logarithmic "
        "parameters, else factor − 1."
    )
    frequencies = Plot(one, caption.format("natural frequencies"))
    blocks: list[Block] = [frequencies]
    if s.d_mac.size:
        two = Plot(
            plots.sensitivity(s, s.d_mac, "∂ MAC / ∂x", f),
            caption.format("MAC with the paired test shape"),
        )
        blocks = [Tabs([("Frequencies", [frequencies]), ("Mode shapes", [two])])]
    rows = [
        (k, str(len(v)), ", ".join(v), sentence(s.rules.get(k, "")))
        for k, v in s.sets.items()
    ]
    blocks.append(
        ReportTable(
            ("|Set", "Size", "|Parameters", "|Rule"),
            rows,
            "Parameter sets and how each was chosen.",
        )
    )
    held = dict.fromkeys(
        line for found in s.held.values() for line in held_sentences(found)
    )
    if held:
        blocks.append(Items(tuple(held), "Held at the deck's values"))
    if s.clusters:
        title = "Candidates that the data cannot distinguish"
        listed = Items(s.clusters, title if len(s.clusters) <= FEW else "")
        many = f"{title} ({len(s.clusters)} pairs)"
        blocks.append(Fold(many, [listed]) if len(s.clusters) > FEW else listed)
    return Section("sensitivities", "Sensitivities and parameters", blocks)


def updating(data: Stages) -> Section | None:
    """The parameter sets compared, the chosen one in detail."""
    u = data.update
    if u is None:
        return None
    best = u.best
    blocks: list[Block] = [_compared(u), Text(sentence(u.why))]
    if u.runs:
        blocks.append(Text(_solver_text(data, u)))
    caption = (
        "Convergence of every parameter set. Modes are paired anew at each iteration: "
        "where a mode is gained or "
    )
    caption += "lost, J and the mean values jump."
    blocks.append(Plot(plots.convergence(u.sets, u.chosen), caption))
    std = best.std if data.uncertainty is None else data.uncertainty.posterior.relative
    blocks += [Heading(f"The chosen set: {best.name}"), _parameters(u, best, std)]
    text = f"Parameters of {best.name} by iteration; bars: one standard deviation of the result. "
    text += f"Outcome: {best.outcome}."
    text += (
        f" {sentence(line)}"
        if (line := discrepancy_sentence(best.discrepancy.tolist()))
        else ""
    )
    blocks.append(Plot(plots.path(best), text))
    blocks += [_measured(d) for d in u.data]
    if data.model is not None and u.regions:
        notes = {
            p: f"× {number(f, 3)}"
            for p, f in zip(best.parameters, best.factor, strict=True)
        }
        view = scene.regions(data.model.scene, u.regions, notes)
        blocks.append(
            Scene3D(
                view,
                "The updated regions, each with its factor updated / initial; springs are dots.",
                460,
            )
        )
    return Section("updating", "Updating", blocks)


def _solver_text(data: Stages, u: UpdateStage) -> str:
    """Which solver has done what."""
    text = (
        f"Modes of the decks and of the updating are by {u.solver}, found anew at each point in "
        f"{u.runs} runs. "
        "Localisation, choice of the sets, tuning of the suspension, uncertainty, damping and "
        "the run-up of a rotor "
        "rest on the matrices of the embedded solver."
    )
    if data.final is not None and data.uncertainty is None:
        text += (
            " No uncertainty is given: fewer than four modes were used, or its modes differ "
            f"from those of {u.solver}."
        )
    return text


def _measured(d: DataResult) -> ReportTable:
    """Values, or deviations where no value is shown, of the model before and after."""
    where = f", measured on {d.configuration}" if d.configuration else ""
    columns = (d.measured, d.before, d.after, d.error)
    rows = [
        [label, unit, *(number(v, 4) for v in row)]
        for label, unit, *row in zip(d.labels, d.units, *columns, strict=True)
    ]
    text = (
        f"{d.name}: {d.kind}{where}; the model before and after the updating, with the error "
        "(1 σ) that is allowed."
    )
    if np.isnan(d.measured).any():
        text += " Before and after are deviations from the measured curve."
    text += "".join(f" {sentence(line)}" for line in seat_words(d.seats))
    return ReportTable(
        ("|What", "|Unit", "Measured", "Before", "After", "Error"), rows, text
    )


def _compared(u: UpdateStage) -> ReportTable:
    quality = (
        "Mean |Δf|, %",
        "Max |Δf|, %",
        "Mean subspace MAC, %",
        "Left out: mean |Δf|, %",
    )
    heads = (
        "|Set",
        "Parameters",
        *quality,
        "Condition",
        "AICc",
        "Iterations",
        "|Outcome",
    )
    rows = []
    for i, s in enumerate(u.sets):
        name = Cell(s.name, "chosen", "chosen") if i == u.chosen else s.name
        row = [
            name,
            str(len(s.parameters)),
            fixed(s.fit.mean_deviation, 2),
            fixed(s.fit.max_deviation, 2),
            fixed(s.fit.mean_subspace_mac, 1),
            fixed(s.fit.mean_deviation_left_out, 2),
            number(s.fit.condition, 3),
            fixed(s.fit.criterion, 1),
            str(max(len(s.history.objective) - 1, 0)),
            Cell(s.outcome.verdict, "", s.outcome),
        ]
        rows.append(row)
    text = "Parameter sets updated and compared; the chosen one is marked."
    other = [sentence(f"{s.name}: {s.settings}") for s in u.sets if s.settings]
    return ReportTable(heads, rows, " ".join([text, *other])).without_blank("MAC")


def _parameters(u: UpdateStage, s: SetResult, std: Float) -> ReportTable:
    heads = (
        "|Parameter",
        "Initial",
        "Updated",
        "Factor",
        "σ, %",
        "Bounds",
        "σ after / before",
    )
    rows = []
    for j, name in enumerate(s.parameters):
        low, high = (float(x) for x in s.bounds[j])
        factor = float(s.factor[j])
        at_bound = min(abs(factor / low - 1), abs(factor / high - 1)) < 0.01
        shown, _ = with_error(factor, factor * std[j])
        value = u.updated_values.get(name, np.nan)
        updated_value, _ = with_error(value, abs(value) * std[j])
        row = [
            name,
            number(u.initial_values.get(name), 4),
            updated_value,
            Cell(shown, "warn", "at its bound") if at_bound else shown,
            number(100 * std[j], 2),
            f"{plain(low)} to {plain(high)}",
            number(s.identifiability[j], 2),
        ]
        rows.append(row)
    text = (
        "The updated parameters, deck units. σ after / before, with the errors that the "
        "updating assumed, near 1: the data say nothing about it."
    )
    return ReportTable(heads, rows, text)


def suspension(data: Stages) -> Section | None:
    """Rigid-body modes before and after tuning."""
    t = data.tune
    if t is None:
        return None
    blocks: list[Block] = [
        pairs(t.before, data, "Rigid-body modes before tuning.", updating=False),
        pairs(t.after, data, "Rigid-body modes after tuning.", updating=False),
    ]
    for o in t.others:
        blocks += [
            pairs(
                table,
                data,
                f"{o.name}: rigid-body modes {when} tuning.",
                updating=False,
            )
            for table, when in ((o.before, "before"), (o.after, "after"))
        ]
    heads = ("|Suspension parameter", "Factor", "σ, %")
    known = {k: t.std.get(k, np.nan) for k in t.factors}
    rows = [
        (k, with_error(v, v * known[k])[0], number(100 * known[k], 2))
        for k, v in t.factors.items()
    ]
    blocks.append(ReportTable(heads, rows, "Tuned stiffnesses of the suspension."))
    blocks += [Text(f"The pairing is not certain. {v}.") for v in t.ambiguity]
    blocks += [Text(sentence(v)) for v in t.flags]
    return Section("suspension", "Rigid-body tuning", blocks)
