"""The best that six parameters of the deck could reach against the truth; known to nobody in the
study.
"""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Int
from ringtrue.correlation.assignment import PairingSettings
from ringtrue.demos.lsf.twin import Twin
from ringtrue.shapes.mac import mac
from ringtrue.study.results import CorrelateStage, FinalStage, UpdateStage
from ringtrue.study.run import StudyRun
from ringtrue.study.workbench import Workbench
from ringtrue.updating.best import descend
from ringtrue.updating.choose import best_subset
from ringtrue.updating.objective import Target, Weights

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


def best_possible(run: StudyRun, twin: Twin, desk: Workbench) -> float:
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
        truth.frequencies,
        truth.shapes,
        np.zeros(m),
        np.ones(m, dtype=bool),
        Weights(shape=0.02),
        gates,
    )
    model = desk.delivered_models(_silent)[0]
    names = model.parameters.names
    choice = best_subset(model, aim, min(6, len(names)))
    starts = [(choice.members.tolist(), choice.x[choice.members])]
    for s in updated.sets:
        at = [names.index(n) for n in s.parameters]
        starts.append((at, model.parameters.take(at).vector(s.factor)))
    none = np.zeros(len(names))
    return 100 * min(descend(model.with_parameters(at, none), aim, x, TURNS)[1] for at, x in starts)
