"""What must hold of the worked example, and the best that six parameters could reach."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.correlation.assignment import PairingSettings
from ringtrue.demos.lsf.twin import Twin
from ringtrue.shapes.mac import mac
from ringtrue.study.acceptance import Check, improvement
from ringtrue.study.results import CompareStage, CorrelateStage, FinalStage, UpdateStage
from ringtrue.study.run import StudyRun
from ringtrue.study.session import Session
from ringtrue.updating.best import descend
from ringtrue.updating.choose import best_subset
from ringtrue.updating.objective import Target, Weights


def checks(r: Mapping[str, Any]) -> tuple[Check, ...]:
    """What must hold of a study of the facility with a test and an updated model."""
    out: list[Check] = []
    compare: CompareStage | None = r.get("compare")
    if compare is not None:
        t = compare.table
        good = (np.abs(t.deviation_percent) <= 0.6) & (t.subspace_mac_percent >= 80)
        out.append(
            Check(
                "ambient vs hammer: modes with |Δf| ≤ 0.6 % and subspace MAC ≥ 80 %",
                "≥ 7",
                str(int(good.sum())),
                bool(good.sum() >= 7),
            )
        )
    final: FinalStage | None = r.get("final")
    if final is None:
        return tuple(out)
    t = final.table
    n, spared = len(t), int((~t.used).sum())
    out += [
        Check("final: pairs", "≥ 18", str(n), n >= 18),
        Check("final: pairs left out of the updating", "≥ 4", str(spared), spared >= 4),
        _at_most("final: mean |Δf|", t.mean_deviation(), 2.0, "%"),
        _at_most("final: largest |Δf|", t.max_deviation(), 6.0, "%"),
        _at_least("final: mean subspace MAC", t.mean_subspace_mac(), 93.0, "%"),
        _unpaired_below(final, r["correlate"].reference.confidence),
        *improvement(r),
    ]
    rigid = final.rigid
    out.append(Check("rigid-body modes paired one to one", "6", str(len(rigid)), len(rigid) == 6))
    out.append(
        _at_most("rigid-body modes: largest |Δf| after tuning", rigid.max_deviation(), 3.0, "%")
    )
    return tuple(out)


def _at_most(name: str, got: float, most: float, unit: str) -> Check:
    return Check(name, f"≤ {most:g} {unit}", f"{got:.2f} {unit}", bool(got <= most))


def _at_least(name: str, got: float, least: float, unit: str) -> Check:
    return Check(name, f"≥ {least:g} {unit}", f"{got:.2f} {unit}", bool(got >= least))


def _unpaired_below(final: FinalStage, confidence: Float) -> Check:
    t = final.table
    top = float(t.test_hz.max(initial=0.0))
    unpaired = t.pairing.unpaired_a
    count = int(((t.all_test_hz[unpaired] < top) & (confidence[unpaired] >= CONFIDENT)).sum())
    return Check(
        "final: confident test modes below the last pair without a partner",
        "≤ 4",
        str(count),
        count <= 4,
    )


CONFIDENT = 0.5  # the confidence from which on the study pairs a test mode
TURNS = 12  # linear programmes from each start


def _silent(fraction: float, text: str) -> None:
    """No progress shown."""


def true_modes(run: StudyRun, twin: Twin) -> tuple[Int, Int]:
    """Test modes of the final pairs and the as-built mode that each is, by MAC among those within 3
    %.
    """
    final: FinalStage = run.results["final"]
    found: CorrelateStage = run.results["correlate"]
    test = final.table.pairing.a
    channels = found.reference.channels
    truth = twin.real_modes.rows(channels)
    like = mac(found.reference.shapes[:, test], truth.shapes)
    near = np.abs(truth.frequencies[None] / found.reference.frequencies[test][:, None] - 1) < 0.03
    return test, np.argmax(np.where(near, like, -1.0), axis=1)


def best_possible(run: StudyRun, twin: Twin, session: Session) -> float:
    """Smallest mean |Δf|, %, that the best six candidates can reach on the true frequencies of the
    final pairs.

    From the best subset of the least-squares search and from each set that the study updated, the
    mean absolute deviation itself is minimised by a sequence of linear programmes.
    """
    _, true = true_modes(run, twin)
    found: CorrelateStage = run.results["correlate"]
    updated: UpdateStage = run.results["update"]
    truth = twin.real_modes.rows(found.reference.channels).take(np.unique(true))
    m = len(truth)
    gates = PairingSettings(mac_gate=0.3)  # they are pairs already: none may count as lost
    aim = Target(
        frequencies=truth.frequencies,
        shapes=truth.shapes,
        std=np.zeros(m),
        used=np.ones(m, dtype=bool),
        weights=Weights(shape=0.02),
        pairing=gates,
    )
    model = session.delivered_models(_silent)[0]
    names = model.parameters.names
    choice = best_subset(model, aim, min(6, len(names)))
    starts = [(choice.members.tolist(), choice.x[choice.members])]
    for s in updated.sets:
        at = [names.index(n) for n in s.parameters]
        starts.append((at, model.parameters.take(at).vector(s.factor)))
    none = np.zeros(len(names))
    return 100 * min(descend(model.with_parameters(at, none), aim, x, TURNS)[1] for at, x in starts)
