"""What must hold of the worked example: pairs, deviations and MAC of the delivered model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.study.acceptance import Check, improvement
from ringtrue.study.results import CompareStage, FinalStage

CONFIDENT = 0.5  # the confidence from which on the study pairs a test mode


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
