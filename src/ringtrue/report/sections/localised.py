"""Where the model is wrong, and which parameters the data ask for."""

from __future__ import annotations

import numpy as np

from ringtrue.plots import updating as plots
from ringtrue.report.parts import (
    Block,
    Cell,
    Columns,
    Fold,
    Heading,
    Items,
    Plot,
    ReportTable,
    Scene3D,
    Section,
    Stages,
    Text,
    fixed,
    number,
    sentence,
)
from ringtrue.study.results import LocaliseStage
from ringtrue.updating.selection.proposal import Proposed

LEAD = (
    "The test shapes, expanded to the whole model by {0}, do not fulfil its equation of motion. "
    "Where the error "
    "gathers beyond its share of strain energy (above 1), stiffness or mass is likely wrong "
    "there, or nearby."
)
NO_SHAPES = (
    "No shapes were measured. Frequencies tell stiffness over mass, not on which of like parts "
    "of the structure, and "
    "fewer parameters than there are modes."
)
EXPANSIONS = {
    "hybrid": "a balance of readings and equation of motion",
    "serep": "SEREP",
}
SHOWN = 30  # names of candidates that were not looked at closely
FALLS = 10.0  # % of mean MAC, from which on a proposal is doubted
REGIONS = 6  # of a candidate that are named
LACKING = (
    " A mass that the deck lacks is in units of the deck; its factor in later tables is "
    "that of the structure's mass."
)
FEW = 14  # candidates that are not folded away


def section(data: Stages) -> Section | None:
    """Indicators by region, the proposal with its reasons, and what is known of each candidate."""
    s = data.localise
    if s is None:
        return None
    which = (
        f", the {plots.BARS} largest of {len(s.indicators.regions)}"
        if len(s.indicators.regions) > plots.BARS
        else ""
    )
    bars = Plot(
        plots.regions(s),
        f"Concentration of error by region{which}; dotted: an error that is spread evenly.",
    )
    if not s.indicators.modes.size:
        return Section(
            "localisation", "Where the model is wrong", [Text(NO_SHAPES, "lead"), *_proposal(s)]
        )
    blocks: list[Block] = [Text(LEAD.format(EXPANSIONS[s.indicators.expansion]), "lead"), bars]
    if data.model is not None:
        view = Scene3D(
            plots.view(data.model.scene, s),
            "The same on the model: amber to red is more than its share.",
            430,
        )
        blocks = [blocks[0], Columns([[bars], [view]])]
    blocks += [Fold("All indicators by region", [_regions(s)]), Heading("Proposal"), *_proposal(s)]
    return Section("localisation", "Where the model is wrong", blocks)


def _regions(s: LocaliseStage) -> ReportTable:
    heads = (
        "|Region",
        "Strain energy, %",
        "Constitutive error, %",
        "×",
        "Force residual, %",
        "Energy change, %",
        "×",
    )
    value = s.indicators.concentration
    rows = []
    for i in np.argsort(-np.nan_to_num(value), kind="stable").tolist():
        change = (
            s.indicators.energy[i] / s.indicators.strain[i] if np.isfinite(value[i]) else np.nan
        )
        described = (
            Cell(fixed(float(value[i]), 2), "warn") if value[i] > 1 else fixed(float(value[i]), 2)
        )
        shares = [
            fixed(100 * float(v[i]), 1)
            for v in (
                s.indicators.strain,
                s.indicators.constitutive,
                s.indicators.force,
                s.indicators.energy,
            )
        ]
        rows.append(
            [
                s.indicators.regions[i],
                shares[0],
                shares[1],
                described,
                shares[2],
                shares[3],
                fixed(float(change), 2),
            ]
        )
    text = (
        f"Shares of the regions in the expanded shapes of {s.indicators.modes.size} used "
        "modes; ×: over "
        "their share of strain "
        "energy. Error in constitutive relation (Ladevèze and Reynier 1989), force residual "
        "(shared by all that meet "
        "at a node), change of modal strain energy."
    )
    if s.indicators.misfit.size:
        text += (
            " The expanded shapes miss the readings by "
            f"{number(100 * float(s.indicators.misfit.max()), 2)} % at most."
        )
    return ReportTable(heads, rows, text, scroll=True)


def _proposal(s: LocaliseStage) -> list[Block]:
    p = s.proposal
    origin = f"{len(s.candidates.what)} candidates are given." if not s.pool.made else _made(s)
    if s.proposal_basis:
        origin += f" The proposal rests on {s.proposal_basis}, too."
    if not p.members:
        return [
            Text(f"{origin} {sentence(f'no parameter is proposed: {p.unexplained()}')}"),
            _candidates(s),
        ]
    before, after = (100 * float(x) for x in p.mac[:2])
    mac = (
        f", mean MAC {'rises' if after >= before else 'falls'} from {fixed(before, 1)} to "
        f"{fixed(after, 1)} %"
    )
    mac = mac if p.seen else ""
    gain = (
        f"With {_count(len(p.members))} of them mean |Δf| of the used modes "
        f"{'falls' if p.after <= p.before else 'rises'} from {fixed(100 * p.before, 2)} to "
        f"{fixed(100 * p.after, 2)} %{mac}, and {p.paired[1]} modes have a partner "
        f"({p.paired[0]} before)."
    )
    if after < before - FALLS:
        gain += (
            " The frequencies are reached with partners that look otherwise: check the pairs "
            "before it is used."
        )
    where = ("|Region",) if s.pool.made else ()  # those that are given have names
    heads = (
        "#",
        "|Parameter",
        *where,
        "|Changes",
        "Factor",
        "σ, %",
        "Worth, AICc",
        "|Not distinguishable",
    )
    rows = [_row(s, i, m) for i, m in enumerate(p.members, start=1)]
    caption = (
        "Proposed parameters, ranked by their worth: the rise of AICc if one is left out and the "
        "others are updated "
        "again. Not distinguishable: same effect on the data, or as good in its place."
        + (LACKING if any(m.lump for m in p.members) else "")
    )
    reasons = [
        f"{m.name}: {sentence(m.because.removeprefix(f'{s.candidates.what[m.index]}; '))}"
        for m in p.members
    ]
    price = (
        "AICc of the best set of each size, with the price of the search (the logarithm of "
        "the number of sets)."
    )
    blocks: list[Block] = [
        Text(f"{origin} {gain}"),
        ReportTable(heads, rows, caption),
        Items(reasons, "Why"),
    ]
    orders = [(rule, ", ".join(names[: len(p.members)])) for rule, names in p.orders.items()]
    others = ReportTable(
        ("|Rule", "|First candidates"),
        orders,
        "As many candidates by simpler rules, one a cluster.",
    )
    blocks.append(Columns([[Plot(plots.sizes(s), price)], [others]]))
    return [*blocks, _candidates(s)]


def _made(s: LocaliseStage) -> str:
    text = (
        f"{s.pool.made} candidates are made from the deck; {len(s.candidates.what)} that "
        "explain most of the "
        "deviations, each in a way "
    )
    text += "of its own, are looked at closely."
    lost = (
        f" {_count(len(s.pool.dropped)).capitalize()} "
        f"change{'s' if len(s.pool.dropped) == 1 else ''} "
        "no mode."
    )
    return text + (lost if s.pool.dropped else "")


def _count(n: int) -> str:
    words = [
        "no",
        "one",
        "two",
        "three",
        "four",
        "five",
        "six",
        "seven",
        "eight",
        "nine",
        "ten",
        "eleven",
        "twelve",
    ]
    return words[n] if n < len(words) else str(n)


def _row(s: LocaliseStage, rank: int, m: Proposed) -> list[str | Cell]:
    low, high = (float(x[0]) for x in s.candidates.parameters.take([m.index]).bounds())
    x = float(s.candidates.parameters.take([m.index]).vector(np.array([m.factor]))[0])
    factor = f"+ {number(m.added, 3)}" if m.lump else fixed(m.factor, 3)
    shown = Cell(factor, "warn", "at its bound") if min(x - low, high - x) < 1e-6 else factor
    lost = ", ".join((*m.collinear, *m.rivals)) or "–"
    what = Cell(s.candidates.what[m.index], "muted", _few(s.candidates.elements[m.index]))
    where = [_few(s.candidates.elements[m.index])] if s.pool.made else []
    return [str(rank), m.name, *where, what, shown, number(100 * m.std, 2), fixed(m.worth, 1), lost]


def _few(regions: str) -> str:
    """The first of the regions that a candidate is in, where there are many."""
    names = regions.split(", ")
    return (
        regions
        if len(names) <= REGIONS
        else f"{', '.join(names[:REGIONS])} and {len(names) - REGIONS} more"
    )


def _candidates(s: LocaliseStage) -> Block:
    p = s.proposal
    verdict: dict[str, str | Cell] = {}
    for m in p.members:
        verdict |= dict.fromkeys(m.collinear, f"same effect as {m.name}")
        verdict |= {n: f"as good in place of {m.name}" for n in m.rivals if n not in verdict}
    verdict |= {m.name: Cell("proposed", "good") for m in p.members}
    verdict |= {n: Cell("no effect on the data", "muted") for n in p.insensitive}
    heads = (
        "|Candidate",
        "|Changes",
        "|Region",
        "Effect",
        "Explains alone, %",
        "Known alone",
        "Known, all free",
        "|",
    )
    rows = []
    for i in np.argsort(-s.candidates.effect, kind="stable").tolist():
        name = s.candidates.parameters.names[i]
        known = [
            fixed(float(s.candidates.others_known[i]), 2),
            fixed(float(s.candidates.all_free[i]), 2),
        ]
        explains = fixed(100 * max(float(s.candidates.explains[i]), 0.0), 0)
        rows.append(
            [
                name,
                Cell(s.candidates.what[i], "muted"),
                _few(s.candidates.elements[i]),
                number(float(s.candidates.effect[i]), 3),
                explains,
                *known,
                verdict.get(name, ""),
            ]
        )
    text = (
        "All candidates. Effect: of one prior standard deviation, in standard deviations of the "
        "residuals. Explains "
        "alone: share of the squared frequency errors. Known: posterior over prior standard "
        "deviation at the proposed "
        "point, the others known or all free; 1 means that the data say nothing."
    )
    blocks: list[Block] = [ReportTable(heads, rows, text, scroll=len(rows) > FEW)]
    for names, what in (
        (s.pool.screened, "Not looked at closely"),
        (s.pool.held, "Tuned as the suspension, not proposed"),
    ):
        if names:
            more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
            blocks.append(Text(f"{what}: {', '.join(names[:SHOWN])}{more}.", "note"))
    return Fold(f"All {len(rows)} candidates", blocks)
