"""Materials that would have negative strain energy, those with blanks that stand for 0, and sizes
below 0.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ringtrue.checks.findings import Finding, Severity, at_rows
from ringtrue.core.arrays import Float
from ringtrue.fem.negative_stiffness import (
    asks_for_negative_stiffness,
    negative_springs,
    negative_stiffness,
)
from ringtrue.model.model import Model, Table

_FIT = 0.01  # of E / (2 (1 + NU) G)
_DENSITIES = ("MAT1", "MAT2", "MAT8", "MAT9")


def check_materials(model: Model) -> list[Finding]:
    """Poisson's ratio of MAT1, E1, E2 and NU12 of MAT8, the matrices of MAT2 and MAT9, shells that
    do not bend, and moduli, densities and sizes of sections below 0.
    """
    doubtful = [*_poisson(model), *_orthotropic(model), *_membranes(model), *_straight(model)]
    return [*doubtful, *_negative(model)]


def _negative(model: Model) -> Iterator[Finding]:
    severity: Severity = "warning" if asks_for_negative_stiffness(model) else "error"
    for found in negative_stiffness(model):
        yield at_rows(model, found.table.card, found.rows, severity, found.text)
    for found in negative_springs(model):
        yield at_rows(
            model,
            found.table.card,
            found.rows,
            "warning",
            f"{found.text}: taken as a negative stiffness",
        )
    for card in (c for c in _DENSITIES if c in model):
        if (rows := np.flatnonzero(model[card]["RHO"] < 0)).size:
            yield at_rows(
                model, card, rows, "warning", f"RHO is {model[card]['RHO'][rows[0]]:g}, below 0"
            )


def _membranes(model: Model) -> list[Finding]:
    rows = (
        np.flatnonzero(model["PSHELL"]["MID2"] == 0)
        if "PSHELL" in model
        else np.empty(0, dtype=np.int64)
    )
    what = "MID2 is blank: a membrane, without stiffness in bending"
    return [at_rows(model, "PSHELL", rows, "info", what)] if rows.size else []


def _straight(model: Model) -> list[Finding]:
    if "PBAR" not in model:
        return []
    rows = np.flatnonzero(~model["PBAR"].stack("I1", "I2").any(axis=1))
    return (
        [at_rows(model, "PBAR", rows, "info", "I1 and I2 are 0: no stiffness in bending")]
        if rows.size
        else []
    )


def _poisson(model: Model) -> list[Finding]:
    """Poisson's ratio, given or from E and G, must lie between -1 and 0.5."""
    if "MAT1" not in model:
        return []
    table = model["MAT1"]
    with np.errstate(divide="ignore", invalid="ignore"):  # a blank or zero G gives no ratio
        implied = table["E"] / (2 * table["G"]) - 1
    ratio = np.where(np.isnan(table["NU"]), implied, table["NU"])
    rows = np.flatnonzero((ratio <= -1) | (ratio > 0.5))
    found = (
        [at_rows(model, "MAT1", rows, "error", f"Poisson's ratio {ratio[rows[0]]:g}")]
        if rows.size
        else []
    )
    alone = np.flatnonzero(np.isnan(table["NU"]) & (np.isnan(table["E"]) ^ np.isnan(table["G"])))
    if alone.size:
        what = "NU and one of E and G are blank: both are 0 then, as in Nastran"
        found.append(at_rows(model, "MAT1", alone, "info", what))
    return found + _three_moduli(table, implied, model)


def _three_moduli(table: Table, implied: Float, model: Model) -> list[Finding]:
    """MAT1 whose E, G and NU are given and do not fit (the limit of Nastran's warning)."""
    with np.errstate(divide="ignore", invalid="ignore"):  # NU = -1 is told above
        fit = (1 + implied) / (1 + table["NU"])
    rows = np.flatnonzero(np.abs(fit - 1) > _FIT)  # never where one is blank
    if not rows.size:
        return []
    what = (
        f"E / (2 (1 + NU) G) is {fit[rows[0]]:.3g}, not 1: "
        "solids and the membrane and bending of shells take E and NU, torsion and transverse "
        "shear take G"
    )
    return [at_rows(model, "MAT1", rows, "warning", what)]


def _orthotropic(model: Model) -> list[Finding]:
    """E1, E2 > 0 and NU12² < E1 / E2 (Jones, Mechanics of Composite Materials, eq. 2.46)."""
    if "MAT8" not in model:
        return []
    t = model["MAT8"]
    soft = np.flatnonzero((t["E1"] == 0) | (t["E2"] == 0))
    wrong = np.flatnonzero((t["E1"] > 0) & (t["E2"] > 0) & (t["NU12"] ** 2 * t["E2"] >= t["E1"]))
    found = [at_rows(model, "MAT8", soft, "error", "E1 and E2 must not be 0")] if soft.size else []
    if wrong.size:
        limit = np.sqrt(t["E1"][wrong[0]] / t["E2"][wrong[0]])
        what = f"NU12 {t['NU12'][wrong[0]]:g} is not below sqrt(E1/E2) = {limit:g}"
        found.append(at_rows(model, "MAT8", wrong, "error", what))
    return found
