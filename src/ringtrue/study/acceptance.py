"""The user's own limits: which pairs miss them, and whether the model that the study delivers is
accepted.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from ringtrue.core.arrays import Bool
from ringtrue.core.display import number
from ringtrue.core.iterate import Outcome
from ringtrue.correlation.table import CorrelationRow, CorrelationTable
from ringtrue.study.config import StudyConfig
from ringtrue.study.config_sections import CorrelateSection
from ringtrue.study.results import (
    ConfigurationsStage,
    ConfiguredStage,
    CorrelateStage,
    Evidence,
    FinalStage,
    UpdateStage,
)

PER_PAIR = {"accept_percent", "accept_hz", "accept_mac"}
ORTHOGONALITY = {"accept_orthogonality", "accept_off_diagonal"}


@dataclass(frozen=True, slots=True)
class AcceptanceCheck:
    """One thing that must hold, or that informs.

    Attributes
    ----------
    name : str
        What is judged, in words.
    wanted, got : str
        The limit and the value in words; a limit of "" is in `got`.
    held : bool
    code : {"limit", "outcome", "change"}
        A limit, how the updating ended, or what it has changed.
    required : bool
        One that is not informs: the model may be accepted without it.
    reason : str
        Why it is borne where it does not hold, as the study says it.
    """

    name: str
    wanted: str
    got: str
    held: bool
    code: Literal["limit", "outcome", "change"] = "limit"
    required: bool = True
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Acceptance:
    """When a mode is accepted; a limit of None is not asked for.

    Attributes
    ----------
    percent : float or None
        Largest |frequency deviation|, %.
    hz : float or None
        Largest |frequency deviation|, Hz; with `percent` given too, one of the two is enough.
    mac : float or None
        Smallest subspace MAC, %: close modes are compared as subspaces, all others one to one.
    """

    percent: float | None = 5.0
    hz: float | None = None
    mac: float | None = 80.0

    @classmethod
    def of(cls, config: CorrelateSection) -> Acceptance:
        """As the study asks for it."""
        return cls(config.accept_percent, config.accept_hz, config.accept_mac)

    def holds(
        self, deviation_percent: float, deviation_hz: float, subspace_mac_percent: float
    ) -> bool:
        """Whether a pair is accepted."""
        limits = [
            abs(value) <= limit
            for value, limit in (
                (deviation_percent, self.percent),
                (deviation_hz, self.hz),
            )
            if limit is not None
        ]
        return (any(limits) if limits else True) and (
            self.mac is None or subspace_mac_percent >= self.mac
        )

    def missed(self, table: CorrelationTable) -> tuple[CorrelationRow, ...]:
        """The pairs of a table that are not accepted."""
        return tuple(
            r
            for r in table.rows()
            if not self.holds(
                r.deviation_percent, r.deviation_hz, r.subspace_mac_percent
            )
        )

    def words(self) -> str:
        """The rule in words."""
        limit = " or ".join(
            f"|Δf| ≤ {value:.4g} {unit}"
            for value, unit in ((self.percent, "%"), (self.hz, "Hz"))
            if value is not None
        )
        mac = f"subspace MAC ≥ {self.mac:.4g} %" if self.mac is not None else ""
        return " and ".join(x for x in (limit, mac) if x) or "every pair"


@dataclass(frozen=True, slots=True)
class Judged:
    """The model that a study delivers, as far as it was run: its tables (those of other
    configurations last) and what they rest on.
    """

    name: str
    tables: tuple[tuple[str, CorrelationTable], ...]
    evidence: Evidence | None


def judged(config: StudyConfig, results: Mapping[str, Any]) -> Judged | None:
    """The delivered deck, its rigid-body modes too where they were tuned; without anything to
    update the deck itself.

    None where the study was not run so far.
    """
    final: FinalStage | None = results.get("final")
    if final is not None:
        rigid = (("rigid-body ", final.rigid),) if config.suspension else ()
        done: ConfiguredStage | None = results.get("configured")
        others = tuple((f"{c.name}: ", c.table) for c in done.items) if done else ()
        return Judged(
            "final model", (("", final.table), *rigid, *others), final.evidence
        )
    correlate: CorrelateStage | None = results.get("correlate")
    if correlate is None or config.candidate or config.suspension or config.propose:
        return None
    return Judged("model", (("", correlate.remodelled),), correlate.evidence)


def missed_words(config: StudyConfig, results: Mapping[str, Any]) -> tuple[str, ...]:
    """A sentence for each pair outside of limits that the study states; none where it states
    none.
    """
    model = judged(config, results)
    if model is None or not PER_PAIR & config.correlate.model_fields_set:
        return ()
    rule = Acceptance.of(config.correlate)
    return tuple(
        f"{kind}test mode {r.test} ({r.test_hz:.4g} Hz) and FE mode {r.fe} ({r.fe_hz:.4g} Hz): "
        f"Δf {round(r.deviation_percent, 2) + 0.0:+.2f} % ({r.deviation_hz:+.3g} Hz), "
        f"MAC {r.mac_percent:.1f} %, subspace MAC {r.subspace_mac_percent:.1f} %"
        for kind, table in model.tables
        for r in rule.missed(table)
    )


def limits(
    config: StudyConfig, results: Mapping[str, Any]
) -> tuple[AcceptanceCheck, ...]:
    """Whether the delivered model keeps the limits that the study states; empty where it states
    none.
    """
    model = judged(config, results)
    c = config.correlate
    if model is None:
        return ()
    out = []
    table = model.tables[0][1]
    if PER_PAIR & c.model_fields_set:
        rule = Acceptance.of(c)
        count = sum(len(t) for _, t in model.tables)
        good = count - sum(len(rule.missed(t)) for _, t in model.tables)
        name = f"{model.name}: pairs with {rule.words()}"
        out.append(AcceptanceCheck(name, f"all {count}", str(good), good == count > 0))
    if c.accept_pairs is not None:
        n = len(table)
        out.append(
            AcceptanceCheck(
                f"{model.name}: pairs",
                f"≥ {c.accept_pairs}",
                str(n),
                n >= c.accept_pairs,
            )
        )
    if c.accept_mean_percent is not None:
        mean = table.mean_deviation()
        most = c.accept_mean_percent
        out.append(
            AcceptanceCheck(
                f"{model.name}: mean |Δf|",
                f"≤ {most:g} %",
                f"{mean:.2f} %",
                bool(mean <= most),
            )
        )
    if c.accept_mean_mac is not None:
        mac = table.mean_subspace_mac()
        least = c.accept_mean_mac
        out.append(
            AcceptanceCheck(
                f"{model.name}: mean subspace MAC",
                f"≥ {least:g} %",
                f"{mac:.2f} %",
                bool(mac >= least),
            )
        )
    if ORTHOGONALITY & c.model_fields_set:
        out.append(_orthogonal(model, c))
    return tuple(out)


def _orthogonal(model: Judged, c: CorrelateSection) -> AcceptanceCheck:
    """The cross-orthogonality over the best mass at hand."""
    wanted = (
        f"pairs ≥ {c.accept_orthogonality:g} %, others ≤ {c.accept_off_diagonal:g} %"
    )
    cross = model.evidence.measures.cross if model.evidence else None
    name = f"{model.name}: cross-orthogonality"
    if cross is None:
        return AcceptanceCheck(name, wanted, "not known", False)
    v = cross.verdict
    got = f"≥ {100 * v.least_diagonal:.1f} %, ≤ {100 * v.largest_off_diagonal:.1f} %"
    return AcceptanceCheck(f"{name}, {cross.mass} mass", wanted, got, v.passed)


def convergence(results: Mapping[str, Any]) -> tuple[AcceptanceCheck, ...]:
    """Whether the chosen updating converged; empty without one."""
    update: UpdateStage | None = results.get("update")
    if update is None:
        return ()
    outcome = update.best.outcome
    return (
        AcceptanceCheck(
            "updating", "converged", outcome.verdict, outcome.ok, "outcome"
        ),
    )


def adequacy(
    results: Mapping[str, Any], *, required: bool
) -> tuple[AcceptanceCheck, ...]:
    """The kinds of residuals that the chosen updating does not fit; empty if it fits all.

    Limits that the study states judge its model; without any these are required.
    """
    update: UpdateStage | None = results.get("update")
    found = update.best.fit.misfits if update is not None else ()
    return tuple(
        AcceptanceCheck(
            f"updating: deviation of {m.kind} over the stated error",
            f"≤ {np.sqrt(m.limit / m.freedom):.2g}",
            f"{m.ratio:.2g}",
            held=False,
            required=required,
        )
        for m in found
    )


def settles(outcome: Outcome | None, stated: tuple[AcceptanceCheck, ...]) -> bool:
    """Whether the end of an updating leaves it to the limits of the study whether its model is
    good.

    Where no step lowers the objective any more the end is as good as it gets, and stated limits
    judge it; one that was cut short is no result.
    """
    return (
        outcome is None or outcome.ok or (outcome is Outcome.STALLED and bool(stated))
    )


def improvement(results: Mapping[str, Any]) -> tuple[AcceptanceCheck, ...]:
    """Whether the final model is nearer to the test than the initial one, in modes used and left
    out.

    Judged by the modes with a partner in both: one that the updating wins a partner for is no worse
    for it.
    """
    final: FinalStage | None = results.get("final")
    before: CorrelateStage | None = results.get("correlate")
    if final is None or before is None:
        return ()
    out = []
    for name, used in (("used", True), ("left-out", False)):
        out += _improved(f"{name} modes", before.initial, final.table, used=used)
    others: ConfigurationsStage | None = results.get("configurations")
    done: ConfiguredStage | None = results.get("configured")
    if others is not None and done is not None:  # over all modes
        for c, d in zip(others.items, done.items, strict=True):
            out += _improved(c.name, c.initial, d.table)
    return tuple(out)


def in_both(*tables: CorrelationTable, used: bool | None = None) -> tuple[Bool, ...]:
    """Which pairs of each table, (k,), are of test modes with a partner in the first and in the
    last of them.

    Of the modes that the updating has used, of those left out, or of all.
    """
    a, b = (
        t.pairing.a if used is None else t.pairing.a[t.used == used]
        for t in (tables[0], tables[-1])
    )
    both = np.intersect1d(a, b)
    return tuple(np.isin(t.pairing.a, both) for t in tables)


def _improved(
    name: str, *tables: CorrelationTable, used: bool | None = None
) -> list[AcceptanceCheck]:
    a, b = (
        t.mean_deviation(which)
        for t, which in zip(tables, in_both(*tables, used=used), strict=True)
    )
    if not np.isfinite(a):
        return []
    way = "fell" if b < a else "rose"
    got = f"{way} from {number(a, 2)} to {number(b, 2)} %"
    return [
        AcceptanceCheck(
            f"{name}: mean |Δf|", "", got, bool(b < a), "change", required=False
        )
    ]


def verdict(
    config: StudyConfig, results: Mapping[str, Any]
) -> tuple[AcceptanceCheck, ...]:
    """What must hold of any study, and what this one states."""
    stated = limits(config, results)
    update: UpdateStage | None = results.get("update")
    ended = convergence(results)
    if update is not None and settles(update.best.outcome, stated):
        # one that stalled is judged by the limits
        ended = tuple(replace(c, required=c.held) for c in ended)
    fitted = adequacy(results, required=not stated)
    every = (*ended, *fitted, *stated, *improvement(results))
    reasons = config.report.reasons
    return tuple(replace(c, reason=reasons.get(c.name, "")) for c in every)
