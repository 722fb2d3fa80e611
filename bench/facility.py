"""The worked example over several seeds: its bars, its rigid-body damping and its proposal, against what was built.

    OMP_NUM_THREADS=1 python bench/facility.py [--seeds 0 1 2 ... --out FOLDER --json FILE]

Runs `ringtrue demo` for each seed into FOLDER/SEED and passes over those that are there already. The truth is opened
after the study has ended. A region's error counts by what it does: the largest and the rms shift of a test mode's
frequency by the logarithm of its true factor, with the sensitivities of the delivered deck.

Printed a seed: mean |df| and number of pairs of the first correlation; pairs, mean and largest |df|, mean MAC,
left-out deviations and unpaired test modes of the last; damping of the ambient modes below 2.6 Hz over that of the
twin, in stated standard deviations, and the rms error of the damping of each ambient record; wrong regions that shift
a mode by over 2 %, named by the proposal or missed, with the largest shift of a mode that the proposal may see.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from ringtrue.core.arrays import Float
from ringtrue.core.modes import ModeSet
from ringtrue.demos.lsf import truth, twin
from ringtrue.study.store import Store

RIGID = 2.6  # Hz, modes of the air springs end here
FRAME = ("columns", "girders", "cross beams")  # one candidate over three regions


def bars(folder: Path) -> dict[str, Any]:
    """What the study says of itself."""
    s = json.loads((folder / "summary.json").read_text())
    first, last = (np.array([abs(r["deviation_percent"]) for r in s[k]]) for k in ("initial", "final"))
    return {
        "first_pairs": len(first),
        "first_mean": round(first.mean(), 1),
        "pairs": len(last),
        "mean": round(last.mean(), 2),
        "largest": round(last.max(), 1),
        "mac": round(np.mean([r["mac_percent"] for r in s["final"]]), 1),
        "left_out": [round(r["deviation_percent"], 1) for r in s["left_out"]],
        "unpaired": sum(u["set"] == "test" for u in s["unpaired"]),
        "seconds": round(sum(s["timings_s"].values())),
    }


def damping(store: Store, seed: int) -> dict[str, Any]:
    """Ambient modes against the complex modes of the twin: merged below RIGID, and all of each record."""
    plan, found = store.load("plan"), store.load("identify")
    poles = twin.make_twin(seed, plan.test, plan.references).modal.poles
    f, zeta = np.abs(poles) / (2 * np.pi), -poles.real / np.abs(poles)

    def built(modes: ModeSet) -> Float:
        return np.asarray(zeta[np.abs(modes.frequencies[:, None] - f).argmin(axis=1)])

    low = found.ambient.frequencies < RIGID
    got, std = found.ambient.damping[low], found.ambient_uncertainty.damping[low]
    records = {}
    for r in found.ambient_records:
        error = 100 * (r.modes.damping / built(r.modes) - 1)
        below = int((r.modes.frequencies < RIGID).sum())
        records[r.record] = {
            "modes": len(r.modes),
            "low": below,
            "rms_percent": round(float(np.sqrt(np.mean(error**2))), 1),
        }
    true = built(found.ambient)[low]
    return {
        "damping_percent": np.round(100 * got, 2).tolist(),
        "built_percent": np.round(100 * true, 2).tolist(),
        "in_std": np.round((got - true) / std, 1).tolist(),
        "records": records,
    }


def proposal(store: Store, seed: int) -> dict[str, Any]:
    """Regions that are wrong, by what they do, and whether the proposal names them."""
    ratio, thick = truth.ratios(seed), truth.thicker(seed)
    ratio["frame members"] = float(np.mean([ratio[k] for k in FRAME]))
    sensitivity, members = store.load("sensitivity"), store.load("localise").proposal.members
    named = {n for m in members for n in (m.name, *m.alike, *m.rivals)}
    table = store.load("correlate").remodelled
    seen = np.isin(sensitivity.fe_modes, table.pairing.b[table.used])
    wrong = {}
    for name, slope in zip(sensitivity.names, sensitivity.d_frequency.T, strict=True):
        factor = ratio.get(name, 1.0) * thick.get(name, 1.0)
        shift = np.abs(100 * slope * np.log(factor))
        if shift.max() > 2:
            wrong[name] = {
                "factor": round(factor, 2),
                "largest_shift": round(shift.max(), 1),
                "largest_shift_seen": round(shift[seen].max(initial=0.0), 1),
                "rms_shift": round(float(np.sqrt(np.mean(shift**2))), 1),
                "named": name in named,
            }
    return {"wrong": wrong, "proposed": {m.name: round(m.factor, 2) for m in members}}


def one(seed: int, folder: Path) -> dict[str, Any]:
    """A seed's row; the example is run if its folder is not there."""
    if not (folder / "summary.json").exists():
        command = [sys.executable, "-m", "ringtrue", "demo", "--seed", str(seed), "--out", str(folder)]
        subprocess.run(command, check=False, stdout=subprocess.DEVNULL)  # status 1 says that a limit is missed
    store = Store(folder / "study.h5")
    return {"seed": seed, **bars(folder), **damping(store, seed), **proposal(store, seed)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="*", default=list(range(10)))
    parser.add_argument("--out", type=Path, default=Path("facility"))
    parser.add_argument("--json", type=Path)
    a = parser.parse_args()
    rows = []
    for seed in a.seeds:
        rows.append(one(seed, a.out / str(seed)))
        print(json.dumps(rows[-1]), flush=True)
    if a.json:
        a.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
