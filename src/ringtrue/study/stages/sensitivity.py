"""Sensitivities of all candidates, and the parameter sets worth comparing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ringtrue.core.arrays import Float, Int
from ringtrue.core.progress import Progress, part
from ringtrue.model.ports import Linearisation
from ringtrue.shapes.mac import unit
from ringtrue.study.config_update import UpdateSection
from ringtrue.study.objective import problem_of
from ringtrue.study.parametric import AtChannels
from ringtrue.study.reference import followed, settings, used_mask
from ringtrue.study.results import ConfiguredTest, CorrelateStage, LocaliseStage, SensitivityStage
from ringtrue.study.workbench import Workbench
from ringtrue.updating.identifiability import stood_for
from ringtrue.updating.selection import selection_rules
from ringtrue.updating.target import Target, Weights, match

RULES = selection_rules.RULES | {
    "proposal": "the ranked proposal of the localisation: from all candidates at once the least "
    "useful are left out, "
    "the rest exchanged while J falls; as many as AICc supports"
}

ALL = "; of the tests of all configurations"


def target(desk: Workbench, u: UpdateSection | None = None) -> Target:
    """The elastic modes of the test as the updating sees them: those left out are marked."""
    found: CorrelateStage = desk.get("correlate")
    return _target(desk, found, u or desk.config.update)


def targets(desk: Workbench, u: UpdateSection | None = None) -> tuple[Target, ...]:
    """The same of all configurations, the study's own first."""
    u = u or desk.config.update
    others: tuple[ConfiguredTest, ...] = (
        desk.get("configurations").items if desk.config.configuration else ()
    )
    return (target(desk, u), *(_target(desk, c, u) for c in others))


def _target(desk: Workbench, found: CorrelateStage | ConfiguredTest, u: UpdateSection) -> Target:
    sure = found.reference.confidence >= desk.config.identify.confidence
    used = used_mask(len(found.reference), found.left_out) & sure
    std = np.nan_to_num(
        found.reference_uncertainty.frequency / found.reference.frequencies, nan=0.0
    )
    weights = Weights(u.frequency_error, u.mac_error, u.shape_weight)
    known = (
        followed(found.reference, found.fe_initial, desk.config)
        if isinstance(found, CorrelateStage)
        else None
    )
    return Target(
        found.reference.frequencies,
        found.reference.shapes,
        std,
        used,
        weights,
        settings(desk.config),
        followed=known,
        lent=found.reference.lent,
    )


def _sets(desk: Workbench, model: AtChannels, progress: Progress) -> tuple[dict[str, Int], Float]:
    """Parameter sets by their rule, and the weighted sensitivities (r, p) that the simple ones come
    from.
    """
    names, count = model.parameters.names, min(desk.config.update.choose, len(model.parameters))
    several = None
    if desk.config.joint:
        several = problem_of(
            desk, (model, *desk.others(progress)), targets(desk), desk.config.update
        )
    if several is None:
        weighted = selection_rules.weighted_sensitivities(model, target(desk))
    else:
        weighted = several.evaluate(np.zeros(len(names))).slope * several.parameters.std()
    out: dict[str, Int] = {}
    if desk.config.propose:
        out["proposal"] = np.array([names.index(n) for n in proposed(desk)], dtype=np.int64)
    if not len(
        desk.config.candidates()
    ):  # those made from the deck may scale the same field: the proposal knows
        return out, weighted
    orthogonal, largest = (
        selection_rules.orthogonal(weighted, count),
        selection_rules.largest(weighted, count),
    )
    progress(0.0, "choosing parameters")
    if several is None:
        out["best subset"] = selection_rules.best_subset(
            model, target(desk), count, progress
        ).members
    else:
        out["best subset"] = selection_rules.joint_subset(
            several, count, (orthogonal, largest), progress
        ).members
    out |= {"orthogonal sensitivities": orthogonal, "largest sensitivities": largest}
    named = {
        s.name: np.array([names.index(n) for n in s.candidates or names]) for s in desk.config.set
    }
    return out | named, weighted


def _not_told_apart(
    desk: Workbench, weighted: Float, names: Sequence[str], members: Int
) -> dict[str, tuple[str, ...]]:
    """Members of a set that are held at the deck's values, with those that stand for them.

    Those of the proposal stand for others, then those of the largest effect.
    """
    found: LocaliseStage | None = desk.get("localise")
    first = [m.name for m in found.proposal.members] if found is not None else []
    return stood_for(weighted[:, members], [names[i] for i in members.tolist()], first)


def _rules(desk: Workbench, sets: Mapping[str, Int]) -> dict[str, str]:
    """How each set was chosen, in words."""
    several = desk.config.configuration
    out = {
        s.name: "named in the study" + (f"; {s.words()}" if s.own() else "")
        for s in desk.config.set
    }
    made = {rule: RULES[rule] + (ALL if several else "") for rule in sets if rule not in out}
    return made | out


def mac_slope(psi: Float, point: Linearisation, fe: int) -> Float:
    """∂MAC/∂x of a test shape psi (channel,) with FE mode `fe`, (p,)."""
    phi, d = point.shapes[:, fe], point.d_shapes[:, fe]
    a = unit(psi[:, None])[:, 0]
    size = phi @ phi
    cross = float(a @ phi)
    return np.asarray(2 * cross * (a @ d) / size - 2 * cross**2 * (phi @ d) / size**2)


def proposed(desk: Workbench) -> tuple[str, ...]:
    """Names of the proposed parameters; none where no change pays, and the deck stays as it is."""
    found: LocaliseStage = desk.get("localise")
    return tuple(m.name for m in found.proposal.members)


def _known(desk: Workbench) -> tuple[str, ...]:
    """All candidates; also those made from the deck that the data do not ask for, which stay at
    nominal.
    """
    names = desk.parameters.names
    if len(desk.config.candidates()) or not desk.config.propose:
        return names
    found: LocaliseStage = desk.get("localise")
    return (*names, *found.screened, *found.dropped, *found.held)


def run(desk: Workbench, progress: Progress) -> SensitivityStage:
    """Linearise at the remodelled deck and choose sets by three rules.

    Raises
    ------
    ConfigError
        If [update] stages or a [[constraint]] names what is no candidate that was made from the
        deck.
    """
    desk.config.check_names(_known(desk))
    aim = target(desk)
    model = desk.candidates(part(progress, 0.0, 0.6))
    names = model.parameters.names
    point = model.linearise(np.zeros(len(names)))
    pairs, _, _ = match(aim, point)
    fe = pairs[:, 1]
    lam = (2 * np.pi * point.frequencies[fe]) ** 2
    d_mac = np.array(
        [mac_slope(aim.shapes[:, t], point, f) for t, f in pairs.tolist() if not aim.lent]
    )
    members, weighted = _sets(desk, model, part(progress, 0.6, 1.0))
    held = {rule: _not_told_apart(desk, weighted, names, at) for rule, at in members.items()}
    members = {
        rule: at[[names[i] not in held[rule] for i in at.tolist()]] for rule, at in members.items()
    }
    return SensitivityStage(
        names,
        0.5 * point.d_lambda[fe] / lam[:, None],
        d_mac.reshape(-1, len(names)),
        fe,
        {rule: tuple(names[i] for i in at.tolist()) for rule, at in members.items()},
        _rules(desk, members),
        selection_rules.alike(weighted, names),
        {rule: found for rule, found in held.items() if found},
    )
