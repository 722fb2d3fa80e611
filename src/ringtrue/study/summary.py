"""summary.json: the numbers of a study, and whether what must hold does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from ringtrue.core.units import UNIT_SYSTEMS
from ringtrue.correlation.measures import complete_json
from ringtrue.correlation.sensor_mounting import mendings_json
from ringtrue.correlation.table import CorrelationTable, table_significance
from ringtrue.planning.exciters import ambient_std
from ringtrue.study.acceptance import limits, missed_words
from ringtrue.study.conclusion import findings_json, repeats
from ringtrue.study.placing import seats_json
from ringtrue.study.results import (
    CompareStage,
    ConfigurationsStage,
    ConfiguredStage,
    CorrelateStage,
    DampingStage,
    Evidence,
    FinalStage,
    IdentifyStage,
    LocaliseStage,
    ModelStage,
    PlanStage,
    PredictStage,
    SensorPlacement,
    SetResult,
    TuneStage,
    UncertaintyStage,
    UpdateStage,
)
from ringtrue.study.run import StudyRun


def pairs(
    table: CorrelationTable, repeats: float = float("nan")
) -> list[dict[str, Any]]:
    """The pairs of a table as plain values; `deviation_std` is the deviation in standard deviations
    of the test, which knows no frequency better than it `repeats` it.
    """
    significance = table_significance(table, repeats)
    return [
        {
            "test_mode": r.test,
            "fe_mode": r.fe,
            "frequency_test_hz": r.test_hz,
            "frequency_fe_hz": r.fe_hz,
            "deviation_percent": r.deviation_percent,
            "deviation_hz": r.deviation_hz,
            "mac_percent": finite(r.mac_percent),
            "subspace_mac_percent": finite(r.subspace_mac_percent),
            "used": r.used,
            "subspace": r.subspace,
            "beyond_gate": r.beyond,
            "deviation_std": finite(z),
            "within_scatter": not beyond if np.isfinite(z) else None,
        }
        for r, z, beyond in zip(
            table.rows(),
            significance.z.tolist(),
            significance.significant.tolist(),
            strict=True,
        )
    ]


def unpaired(table: CorrelationTable) -> list[dict[str, Any]]:
    """Modes without a partner, with the reason."""
    p = table.pairing
    sets = (
        (table.names[0], p.unpaired_a, table.all_test_hz, p.reasons_a),
        (table.names[1], p.unpaired_b, table.all_fe_hz, p.reasons_b),
    )
    return [
        {"set": name, "mode": i + 1, "frequency_hz": float(f[i]), "reason": why}
        for name, lone, f, reasons in sets
        for i, why in zip(lone.tolist(), reasons, strict=True)
    ]


def precision(plan: PlanStage, found: IdentifyStage) -> list[dict[str, float]]:
    """Relative standard deviations of the ambient modes, %: as planned at their frequency, and as
    found.
    """
    modes = found.ambient.modes
    std = found.ambient.uncertainty
    timing = plan.acquisition
    planned = ambient_std(modes.frequencies, timing.damping, timing.record_length)
    columns = {
        "frequency_hz": modes.frequencies,
        "planned_frequency": 100 * planned[0],
        "found_frequency": 100 * std.frequency / modes.frequencies,
        "planned_damping": 100 * planned[1],
        "found_damping": 100 * std.damping / modes.damping,
    }
    rows = np.stack(list(columns.values()), axis=1).tolist()
    return [dict(zip(columns, row, strict=True)) for row in rows]


def setups_json(plan: PlanStage) -> dict[str, Any]:
    """Points that are measured in all setups, and those of each."""
    sensors = plan.sensors
    count = sensors.setups.count if sensors.setups is not None else 0
    return {
        "stay": sensors.roving(-1),
        "rove": [sensors.roving(k) for k in range(count)],
    }


def plan_json(plan: PlanStage) -> dict[str, Any]:
    """What is measured and excited, and how well the target modes are reached."""
    modes = zip(
        (plan.target_modes + 1).tolist(),
        plan.target_frequencies.tolist(),
        plan.excitation.reach.tolist(),
        strict=True,
    )
    out: dict[str, Any] = {
        "rule": plan.rule,
        "channels": len(plan.sensors.test.channels),
        "references": list(plan.excitation.references),
        "worst_auto_mac": plan.sensors.worst_auto_mac,
        "modes": [
            dict(zip(("mode", "frequency_hz", "reach"), m, strict=True)) for m in modes
        ],
    }
    if plan.sensors.setups is not None:
        out["setups"] = setups_json(plan)
    return out


def correlation_json(table: CorrelationTable) -> dict[str, Any]:
    """A table with its unpaired modes and mean values."""
    return {
        "pairs": pairs(table),
        "unpaired": unpaired(table),
        "mean_deviation_percent": finite(table.mean_deviation()),
        "max_deviation_percent": finite(table.max_deviation()),
        "mean_mac_percent": finite(table.mean_mac()),
        "mean_subspace_mac_percent": finite(table.mean_subspace_mac()),
    }


def finite(value: Any) -> Any:
    """Plain values with None for every number that JSON cannot hold."""
    if isinstance(value, Mapping):
        return {k: finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [finite(v) for v in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def summarise(run: StudyRun) -> dict[str, Any]:
    """The summary of a run; parts that were not run are absent."""
    r = run.results
    out: dict[str, Any] = {
        "title": run.config.study.title,
        "seed": run.config.study.seed,
    }
    repeats = _repeats(r)
    model: ModelStage | None = r.get("model")
    if model is not None:
        out |= {
            "mass_t": model.mass.mass * UNIT_SYSTEMS[model.units].kilograms / 1e3,
            "dof": model.dof,
        }
    plan = r.get("plan")
    identify = r.get("identify")
    if plan is not None:
        out["plan"] = plan_json(plan)
    if plan is not None and identify is not None:
        out["std_percent"] = precision(plan, identify)
    compare: CompareStage | None = r.get("compare")
    if compare is not None:
        out["ambient_vs_hammer"] = pairs(compare.table)
        out["ambient_vs_hammer_unpaired"] = unpaired(compare.table)
    correlate: CorrelateStage | None = r.get("correlate")
    if correlate is not None:
        out["initial"] = pairs(correlate.initial, repeats)
        out["remodelled"] = pairs(correlate.remodelled, repeats)
        out["rigid_body"] = {
            "before": pairs(correlate.rigid_initial, repeats),
            "after": [],
        }
        out["rigid_body_unpaired"] = unpaired(correlate.rigid_initial)
        if correlate.sensors.alignment:
            out["alignment"] = correlate.sensors.alignment
        out |= _sensors(correlate.sensors)
        if (e := correlate.expanded) is not None:
            out["expansion"] = {
                "method": e.method,
                "misfit_percent": (100 * e.misfit).tolist(),
            }
        if correlate.remodelling is not None:
            out["remodelling"] = [asdict(s) for s in correlate.remodelling.history]
    out |= _localised(r) | _updated(r) | _known(r) | _used(r)
    out |= _configured(r)
    if found := findings_json(r):
        out["findings"] = found
    out["evidence"] = _all_evidence(r)
    out["acceptance"] = {
        "limits": [
            {"what": c.name, "wanted": c.wanted, "got": c.got, "held": c.held}
            for c in limits(run.config, r)
        ],
        "missed": list(missed_words(run.config, r)),
    }
    out["timings_s"] = dict(run.timings)
    return out


def _repeats(r: Mapping[str, Any]) -> float:
    """How far one test repeats the frequencies of another, relative; NaN where there is one."""
    return repeats(r.get("compare"), r.get("conditions"))


def _sensors(placement: SensorPlacement) -> dict[str, Any]:
    """Where the sensors are read, and mountings that explain the test better."""
    out: dict[str, Any] = {}
    if placement.seats:
        out["sensors"] = seats_json(placement.seats)
    if placement.mendings:
        out["mendings"] = mendings_json(placement.mendings)
    return out


BRIEF = (
    "auto_mac_worst",
    "worst_comac",
    "subspaces",
    "suspects",
    "notes",
)  # the rest is in study.h5


def _all_evidence(r: Mapping[str, Any]) -> dict[str, Any]:
    """What each correlation rests on, without the values of single channels and whole matrices."""
    compare = r.get("compare")
    correlate = r.get("correlate")
    final = r.get("final")
    found: dict[str, tuple[Evidence | None, CorrelationTable]] = {}
    if compare is not None:
        found["ambient_vs_hammer"] = compare.evidence, compare.table
    if correlate is not None:
        found["initial"] = correlate.evidence_initial, correlate.initial
        found["remodelled"] = correlate.evidence, correlate.remodelled
    if final is not None:
        found["final"] = final.evidence, final.table
    return {
        name: _evidence(e, table) for name, (e, table) in found.items() if e is not None
    }


def _evidence(e: Evidence, table: CorrelationTable) -> dict[str, Any]:
    full = complete_json(e.measures, table.pairing)
    out = {k: full[k] for k in BRIEF}
    out["orthogonality"] = [
        {k: v for k, v in c.items() if k != "matrix"} for c in full["orthogonality"]
    ]
    if e.frfs is not None:
        sides = (("initial", e.frfs.initial), ("final", e.frfs.final))
        out["frfs"] = {
            name: [asdict(x) for x in side.by_input()] for name, side in sides
        }
    return out


def _configured(r: Mapping[str, Any]) -> dict[str, Any]:
    """Each other configuration before and after the updating."""
    before: ConfigurationsStage | None = r.get("configurations")
    if before is None:
        return {}
    done: ConfiguredStage | None = r.get("configured")
    after = {c.name: c for c in done.items} if done else {}
    return {
        "configurations": [
            {"name": c.name, "test": c.source, "notes": list(c.notes)}
            # candidates made from the deck are not known yet
            | ({"carries": list(c.carried)} if c.carried else {})
            | _sensors(c.sensors)
            | {"initial": correlation_json(c.initial)}
            | (
                {"final": correlation_json(f.table), "changes": list(f.changes)}
                if (f := after.get(c.name))
                else {}
            )
            for c in before.items
        ]
    }


def _localised(r: Mapping[str, Any]) -> dict[str, Any]:
    """Where errors gather, and what is proposed."""
    found: LocaliseStage | None = r.get("localise")
    if found is None:
        return {}
    gathered = zip(
        found.indicators.regions, found.indicators.concentration.tolist(), strict=True
    )
    proposed = [
        {
            "name": m.name,
            "factor": m.factor,
            "std": m.std,
            "worth": m.worth,
            "not_told_from": [*m.collinear, *m.rivals],
        }
        | ({"added": m.added} if m.lump else {})
        for m in found.proposal.members
    ]
    rests = {"proposed_by": found.proposal_basis} if found.proposal_basis else {}
    if found.reduced_by:  # then there are no local errors and no missing members
        rests["reduced_by"] = found.reduced_by
    return {
        "error_concentration": {n: finite(x) for n, x in gathered},
        "proposed": proposed,
        "missing_members": [asdict(m) for m in found.members],
        **rests,
    }


def _known(r: Mapping[str, Any]) -> dict[str, Any]:
    """Intervals of the parameters, and how many measured frequencies the bands hold."""
    found: UncertaintyStage | None = r.get("uncertainty")
    if found is None:
        return {}
    out = np.isfinite(found.bands.predicted) & ~found.bands.used
    held = found.held.in_turn
    return {
        "uncertainty": {
            "level": found.level,
            "discrepancy_percent": (100 * found.discrepancy).tolist(),
            "intervals": dict(
                zip(
                    found.posterior.parameters.names,
                    found.posterior.interval.tolist(),
                    strict=True,
                )
            ),
            "unproven": [
                n
                for n, open_ in zip(
                    found.posterior.parameters.names, found.unproven, strict=True
                )
                if open_
            ],
            "flags": [flag.text for flag in found.flags],
            "left_out_inside": [int((found.bands.inside & out).sum()), int(out.sum())],
            "folds_inside": [
                int((found.held.inside(found.level) & held).sum()),
                int(held.sum()),
            ],
        }
    }


def _measured(update: UpdateStage) -> dict[str, Any]:
    """What was measured besides the modes, by the model before and after the updating."""
    if not update.data:
        return {}
    heads = ("label", "unit", "measured", "before", "after", "error")
    return {
        "measured": [
            {
                "name": d.name,
                "kind": d.kind,
                "configuration": d.configuration or None,
                "values": [
                    dict(
                        zip(
                            heads,
                            (label, unit, *(finite(float(v)) for v in row)),
                            strict=True,
                        )
                    )
                    for label, unit, *row in zip(
                        d.labels,
                        d.units,
                        d.measured,
                        d.before,
                        d.after,
                        d.error,
                        strict=True,
                    )
                ],
            }
            | ({"sensors": seats_json(d.seats)} if d.seats else {})
            for d in update.data
        ]
    }


def _updated(r: Mapping[str, Any]) -> dict[str, Any]:
    """What the updating, the tuning of the suspension and the delivered model have reached."""
    out: dict[str, Any] = {}
    update: UpdateStage | None = r.get("update")
    tune: TuneStage | None = r.get("tune")
    final: FinalStage | None = r.get("final")
    if update is not None:
        out |= _parameters(update, r.get("uncertainty"))
    if tune is not None:
        out |= _suspension(tune)
    if final is not None:
        repeats = _repeats(r)
        out["final"] = pairs(final.table, repeats)
        out["left_out"] = [p for p in out["final"] if not p["used"]]
        out["unpaired"] = unpaired(final.table)
        out["rigid_body"] = {
            "before": pairs(r["correlate"].rigid_initial, repeats),
            "after": pairs(final.rigid, repeats),
        }
        out["rigid_body_unpaired"] = unpaired(final.rigid)
    return out


def _parameters(update: UpdateStage, known: UncertaintyStage | None) -> dict[str, Any]:
    """The chosen parameters with their standard deviations, after `known` where it was made, and
    all sets.
    """
    best = update.best
    std = best.std if known is None else known.posterior.relative
    runs = {"solver": {"name": update.solver, "runs": update.runs}}
    return {
        **(runs if update.runs else {}),
        "parameter_set": {"name": best.name, "why": update.why},
        "parameters": [
            {
                "name": n,
                "initial": update.initial_values[n],
                "updated": update.updated_values[n],
                "factor": float(a),
                "std": float(s) * update.updated_values[n],
            }
            for n, a, s in zip(best.parameters, best.factor, std, strict=True)
        ],
        "sets": [_set(s) for s in update.sets],
        **_measured(update),
    }


def _set(updated: SetResult) -> dict[str, Any]:
    """A set of parameters, and where it ends."""
    fit = updated.fit
    frequency, mac = map(finite, 100 * updated.discrepancy)
    return {
        "name": updated.name,
        "parameters": list(updated.parameters),
        "mean_deviation_percent": fit.mean_deviation,
        "max_deviation_percent": fit.max_deviation,
        "mean_subspace_mac_percent": fit.mean_subspace_mac,
        "mean_deviation_left_out_percent": finite(fit.mean_deviation_left_out),
        "condition": fit.condition,
        "aicc": fit.criterion,
        "outcome": updated.outcome.value,
        "discrepancy_percent": {"frequency": frequency, "mac": mac},
        **({"settings": updated.settings} if updated.settings else {}),
    }


def _suspension(tune: TuneStage) -> dict[str, Any]:
    """The factors of the suspension, and what is to be said of them."""
    notes = [*tune.ambiguity, *tune.flags]
    others = [
        {"name": o.name, "before": pairs(o.before), "after": pairs(o.after)}
        for o in tune.others
    ]
    return {
        "suspension": [
            {"name": n, "factor": a, "std": tune.std[n] * a}
            for n, a in tune.factors.items()
        ],
        **({"suspension_notes": notes} if notes else {}),
        **({"suspension_configurations": others} if others else {}),
    }


def _used(r: Mapping[str, Any]) -> dict[str, Any]:
    """Damping by region and the run-up of the rotor."""
    out: dict[str, Any] = {}
    damping: DampingStage | None = r.get("damping")
    if (
        damping is not None
        and damping.regions is not None
        and damping.modes is not None
    ):
        d = damping.regions
        values = zip(
            d.names,
            d.natures,
            d.targets,
            d.coefficients.tolist(),
            d.std.tolist(),
            strict=True,
        )
        out["damping"] = {
            "regions": [
                dict(zip(("name", "nature", "targets", "value", "std"), v, strict=True))
                for v in values
            ],
            "deviation_percent": [100 * x for x in damping.modes.spread(True)],
            "deviation_left_out_percent": [
                finite(100 * x) for x in damping.modes.spread(False)
            ],
            "flags": list(damping.flags),
            "refused": damping.why,
        }
        if damping.others:
            out["damping"]["configurations"] = [
                {
                    "name": o.name,
                    "deviation_percent": [
                        finite(100 * x) for x in o.modes.spread(True)
                    ],
                }
                for o in damping.others
            ]
    predicted: PredictStage | None = r.get("predict")
    if predicted is not None:
        u = predicted.run_up
        out["prediction"] = {
            "validated_hz": list(u.validated),
            "level": u.peak.level,
            "peaks": [
                {
                    "name": name,
                    "unit": unit,
                    "band": [
                        float(b[i]) for b in (u.peak.low, u.peak.median, u.peak.high)
                    ],
                }
                for i, (name, unit) in enumerate(zip(u.names, u.units, strict=True))
            ],
        }
    return out
