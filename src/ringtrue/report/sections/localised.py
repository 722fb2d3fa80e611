"""Where the model is wrong, and which parameters the data ask for."""

from __future__ import annotations

import numpy as np

from ringtrue.core.notes import sentence as note_sentence
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
from ringtrue.study.results import LocaliseStage, ModelStage
from ringtrue.updating.selection.candidates import CandidateSettings
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
REDUCED_THERE = (
    "The solver {0} has reduced the deck and keeps its matrices. Local errors, missing members "
    'and causes of form need these and are left out; [model] solver = "embedded" has them.'
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
MEMBERS = "Members that the deck may lack, each judged by itself"
FEW = 14  # candidates that are not folded away


def section(data: Stages) -> Section | None:
    """Indicators by region, the proposal with its reasons, and what is known of each candidate."""
    s = data.localise
    if s is None:
        return None
    title = "Where the model is wrong"
    found = s.indicators
    if not found.modes.size:
        why = REDUCED_THERE.format(s.reduced_by) if s.reduced_by else NO_SHAPES
        return Section(
            "localisation",
            title,
            [Text(why, "lead"), *_form(s), *_proposal(s), *_members(s, data.model)],
        )
    count = len(found.regions)
    which = f", the {plots.BARS} largest of {count}" if count > plots.BARS else ""
    text = f"Concentration of error by region{which}; dotted: an error that is spread evenly."
    bars: Block = Plot(plots.regions(s), text)
    if data.model is not None:
        same = "The same on the model: amber to red is more than its share."
        bars = Columns([[bars], [Scene3D(plots.view(data.model.scene, s), same, 430)]])
    lead = Text(LEAD.format(EXPANSIONS[found.expansion]), "lead")
    every = Fold("All indicators by region", [_regions(s)])
    found_blocks = [Heading("Proposal"), *_proposal(s), *_members(s, data.model)]
    return Section("localisation", title, [lead, bars, every, *_form(s), *found_blocks])


def _form(s: LocaliseStage) -> list[Block]:
    """What the deviations follow: patterns that stand out, and what they were held against."""
    f = s.form
    if not f.patterns:
        return []
    rows = [
        (p.cause, str(p.unknowns), fixed(100 * p.explained, 0), fixed(p.evidence, 1))
        for p in f.patterns
    ]
    heads = ("|Cause", "Unknowns", "Explains, %", "Evidence")
    text = (
        f"Causes by what they would do to each of {f.modes} modes, each by itself. Explains: share "
        "of the weighted squared deviations of the frequencies (or of damping); evidence: fall of "
        "BIC against no cause, strong above 6."
    )
    table = ReportTable(heads, rows, text)
    said = [sentence(note_sentence(n)) for n in f.notes]
    blocks: list[Block] = [Heading("What the deviations follow")]
    if not said:
        why = (
            "No single cause stands out: the deviations are those of several "
            "parameters, or noise."
        )
        return [*blocks, Text(why), Fold("What was compared", [table])]
    return [*blocks, Items(said), table]


def _members(s: LocaliseStage, model: ModelStage | None) -> list[Block]:
    """Braces, joints and supports that the deck may lack, a sentence each."""
    if not s.members:
        return []
    unit = CandidateSettings(units="" if model is None else model.units).unit(
        "stiffness"
    )
    return [Items([sentence(m.text(unit)) for m in s.members], MEMBERS)]


def _regions(s: LocaliseStage) -> ReportTable:
    heads = ["|Region", "Strain energy, %", "Constitutive error, %", "×"]
    heads += ["Force residual, %", "Energy change, %", "×"]
    found = s.indicators
    value = found.concentration
    rows = []
    for i in np.argsort(-np.nan_to_num(value), kind="stable"):
        change = found.energy[i] / found.strain[i] if np.isfinite(value[i]) else np.nan
        row: list[str | Cell] = [
            found.regions[i],
            fixed(100 * found.strain[i], 1),
            fixed(100 * found.constitutive[i], 1),
            Cell(fixed(value[i], 2), "warn") if value[i] > 1 else fixed(value[i], 2),
            fixed(100 * found.force[i], 1),
            fixed(100 * found.energy[i], 1),
            fixed(change, 2),
        ]
        rows.append(row)
    text = (
        f"Shares of the regions in the expanded shapes of {found.modes.size} used modes; ×: over "
        "their share of strain energy. Error in constitutive relation (Ladevèze and Reynier "
        "1989), force residual (shared by all that meet at a node), change of modal strain energy."
    )
    if s.indicators.misfit.size:
        text += (
            " The expanded shapes miss the readings by "
            f"{number(100 * float(s.indicators.misfit.max()), 2)} % at most."
        )
    return ReportTable(heads, rows, text, scroll=True)


def _proposal(s: LocaliseStage) -> list[Block]:
    p = s.proposal
    origin = (
        f"{len(s.candidates.what)} candidates are given."
        if not s.pool.made
        else _made(s)
    )
    if s.proposal_basis:
        origin += f" The proposal rests on {s.proposal_basis}, too."
    if not p.members:
        return [
            Text(
                f"{origin} {sentence(f'no parameter is proposed: {p.unexplained()}')}"
            ),
            _candidates(s),
        ]
    before, after = (100 * x for x in p.mac)
    mac = ""
    if p.seen:
        way = "rises" if after >= before else "falls"
        mac = f", mean MAC {way} from {fixed(before, 1)} to {fixed(after, 1)} %"
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
    orders = [
        (rule, ", ".join(names[: len(p.members)])) for rule, names in p.orders.items()
    ]
    others = ReportTable(
        ("|Rule", "|First candidates"),
        orders,
        "As many candidates by simpler rules, one a cluster.",
    )
    blocks.append(Columns([[Plot(plots.sizes(s), price)], [others]]))
    return [*blocks, _candidates(s)]


def _made(s: LocaliseStage) -> str:
    text = (
        f"{s.pool.made} candidates are made from the deck; {len(s.candidates.what)} that explain "
        "most of the deviations, each in a way of its own, are looked at closely."
    )
    if lost := len(s.pool.dropped):
        text += (
            f" {_count(lost).capitalize()} change{'s' if lost == 1 else ''} no mode."
        )
    return text


def _count(n: int) -> str:
    words = ["no", "one", "two", "three", "four", "five", "six"]
    words += ["seven", "eight", "nine", "ten", "eleven", "twelve"]
    return words[n] if n < len(words) else str(n)


def _row(s: LocaliseStage, rank: int, m: Proposed) -> list[str | Cell]:
    own = s.candidates.parameters.take([m.index])
    low, high = (x[0] for x in own.bounds())
    x = own.vector(np.array([m.factor]))[0]
    factor, _ = m.digits()
    shown = (
        Cell(factor, "warn", "at its bound")
        if min(x - low, high - x) < 1e-6
        else factor
    )
    lost = ", ".join((*m.collinear, *m.rivals)) or "–"
    what = Cell(
        s.candidates.what[m.index], "muted", _few(s.candidates.elements[m.index])
    )
    where = [_few(s.candidates.elements[m.index])] if s.pool.made else []
    return [
        str(rank),
        m.name,
        *where,
        what,
        shown,
        number(100 * m.std, 2),
        fixed(m.worth, 1),
        lost,
    ]


def _few(regions: str) -> str:
    """The first of the regions that a candidate is in, where there are many."""
    names = regions.split(", ")
    if len(names) <= REGIONS:
        return regions
    return f"{', '.join(names[:REGIONS])} and {len(names) - REGIONS} more"


def _candidates(s: LocaliseStage) -> Block:
    p = s.proposal
    verdict: dict[str, str | Cell] = {}
    for m in p.members:
        verdict |= dict.fromkeys(m.collinear, f"same effect as {m.name}")
        verdict |= {
            n: f"as good in place of {m.name}" for n in m.rivals if n not in verdict
        }
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
    c = s.candidates
    for i in np.argsort(-c.effect, kind="stable"):
        name = c.parameters.names[i]
        row: list[str | Cell] = [
            name,
            Cell(c.what[i], "muted"),
            _few(c.elements[i]),
            number(c.effect[i], 3),
            fixed(100 * max(c.explains[i], 0.0), 0),
            fixed(c.others_known[i], 2),
            fixed(c.all_free[i], 2),
            verdict.get(name, ""),
        ]
        rows.append(row)
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
