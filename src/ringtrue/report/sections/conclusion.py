"""The conclusion, the first page: verdict, what speaks for it, what is open, and who signs."""

from __future__ import annotations

import math
from dataclasses import replace

from ringtrue.core.display import number, with_error
from ringtrue.report.parts import (
    Block,
    Cell,
    Checks,
    Columns,
    Fact,
    Facts,
    Heading,
    Items,
    ReportTable,
    Section,
    Stages,
    Text,
    fixed,
    sentence,
)
from ringtrue.study.acceptance import AcceptanceCheck
from ringtrue.study.conclusion import Change, Conclusion, Question, Unseen, Validation

DOUBTS = {
    "interval": "the bound limits its interval, not the test: widen the bound",
    "bound": "it ends at its bound: widen the bound or look for another cause",
    "prior": "a large change: look for its cause in drawings or on site",
    "silent": "the test says little about it",
    "form": "not proven: it may take up an error of the model's form",
}

# what is open, and the measurement that settles it
QUESTIONS = {
    "no mode unseen": (
        "No mode was kept from the updating: nothing shows how well the model predicts.",
        "Keep modes out ([update] left_out), or measure modes of another state.",
    ),
    "parameter not proven": (
        "“{name}” is not proven{trade}.",
        "Measure the part by itself: a static load on it, or more points on it{modes}.",
    ),
    "test modes unpaired": (
        "The model has no partner for test mode {modes}.",
        "Measure the shape at more points; then look for a part or joint that the deck lacks.",
    ),
    "FE modes unpaired": (
        "The test has not found FE mode {modes}.",
        "Excite where the model moves most in it{points}.",
    ),
    "not repeated": (
        "No second test shows how far frequencies repeat with day, temperature and level.",
        "Repeat one setup on another day and at another force level.",
    ),
    "channels suspected": (
        "The channels {channels} contradict the model or the other channels.",
        "Check their direction, cable and calibration, and measure them again.",
    ),
    "FRFs worse": (
        "At {count} of {total} excitation points FRFs of the final model are in part worse than "
        "those of the initial one: {points}.",
        "See Damping and response; look at joints and damping near these points.",
    ),
    "damping refused": (
        "Damping by region makes the FRFs around the resonances worse and is refused.",
        "Use the damping ratios of the test; state other regions ([[damping.region]]).",
    ),
    "beyond the band": (
        "No test has checked the model above {high} Hz.",
        "Test to the highest frequency of the use, with points for the shapes there.",
    ),
    "nowhere": (
        "The model does not hold the lowest mode of the test.",
        "Look at that pair first: supports, units, total mass.",
    ),
    "peaks beyond the band": (
        "{count} of {total} peaks of the run-up lie above the validated band, or may.",
        "Test to {high} Hz before they are used.",
    ),
}


def section(data: Stages) -> Section | None:
    """The first page of a study with a model and a test."""
    c = data.conclusion
    if c is None:
        return None
    blocks: list[Block] = [
        Text(_verdict(data, c), f"verdict {_tone(c)}"),
        Text(_what(data, c)),
    ]
    if c.unseen is not None:
        blocks.append(_unseen(c.unseen, c.level))
    blocks += _checks(c)
    failed = []
    for check in c.failed:
        borne = f" It is borne: {check.reason}" if check.reason else ""
        failed.append(sentence(f"{_failure(check)}{borne}"))
    if failed:
        blocks += [Heading("What failed"), Items(failed)]
    blocks += [Heading("What was changed, and why it is plausible"), *_changes(c)]
    heads = ("|Open", "|What settles it")
    rows = [_question(q) for q in c.questions]
    caption = "Open questions, each with the measurement that settles it."
    blocks += [Heading("What the test does not prove, and what to do next")]
    blocks += (
        [ReportTable(heads, rows, caption)] if rows else [Text("No question is open.")]
    )
    return Section("conclusion", "Conclusion", [*blocks, *_signatures(data)])


def _tone(c: Conclusion) -> str:
    tones = {
        Validation.VALIDATED: "good",
        Validation.NOT_VALIDATED: "bad",
        Validation.NOT_JUDGED: "warn",
    }
    return tones[c.verdict]


def _verdict(data: Stages, c: Conclusion) -> str:
    use = f" for {data.info.use}" if data.info.use else ""
    low, high = c.band
    if c.verdict is Validation.NOT_VALIDATED:
        count = sum(check.required for check in c.failed)
        plural = "requirements" if count > 1 else "requirement"
        return f"Not validated{use}: {count} {plural} failed."
    if c.verdict is Validation.NOT_JUDGED:
        return f"Not judged{use}: the study states no limit that the model must keep."
    if high <= 0:
        return f"The limits hold{use}, but the model does not hold the lowest mode of the test."
    return f"Validated{use}, from {number(low)} to {number(high)} Hz."


def _what(data: Stages, c: Conclusion) -> str:
    """What was validated, and against what."""
    model = data.model
    what = "The model"
    if model is not None:
        name = model.files[0].replace("\\", "/").rpartition("/")[2]
        freedoms = f"{model.dof:,}".replace(",", "\u202f")
        what = f"The deck {name} ({freedoms} degrees of freedom)"
    reference = data.reference
    count = len(reference) if reference is not None else 0
    text = f"{what} was held against {count} measured modes"
    if reference is not None and count:
        f = reference.frequencies
        text += f" from {number(float(f.min()))} to {number(float(f.max()))} Hz"
    rigid = len(data.final.rigid) if data.final is not None else 0
    text += f" and {rigid} rigid-body modes." if rigid else "."
    if not data.info.use:
        text += " The study does not say what the model is for ([study] use)."
    if c.verdict is Validation.NOT_JUDGED:
        text += (
            " Limits are set under [correlate]: accept_percent, accept_mac and others."
        )
    return text


def _unseen(u: Unseen, level: float) -> Facts:
    kinds = {
        "all": "all modes, none fitted",
        "left out": "modes left out",
        "in turn": "modes left out in turn",
    }
    kind = kinds[u.kind]
    before = number(u.before, 2) if math.isfinite(u.before) else ""
    facts = [
        Fact(f"Mean |Δf|, {kind}", number(u.mean, 2), "%", before),
        Fact(f"Largest |Δf|, {kind}", number(u.largest, 2), "%"),
        Fact(kind.capitalize(), str(u.count)),
    ]
    if u.inside is not None:
        facts.append(
            Fact(f"In their {100 * level:g} % bands", f"{u.inside} of {u.count}")
        )
    return Facts(facts)


def _checks(c: Conclusion) -> list[Block]:
    """Required ones, then those that inform."""
    columns: list[list[Block]] = []
    for title, required in (("Required", True), ("For information", False)):
        if found := [check for check in c.checks if check.required is required]:
            named = [replace(x, name=x.name[:1].upper() + x.name[1:]) for x in found]
            columns.append([Heading(title), Checks(named)])
    return (
        [Columns(columns)]
        if len(columns) > 1
        else [b for column in columns for b in column]
    )


def _failure(check: AcceptanceCheck) -> str:
    if check.code == "change":
        return f"{check.name} {check.got}: the updating made it worse, the fit may be of noise."
    if check.code == "outcome" and check.required:
        return f"The updating did not converge ({check.got}): its result is no optimum."
    if check.code == "outcome":
        return f"The updating ended as {check.got}; the limits judge its model."
    return f"{check.name}: {check.got}, wanted {check.wanted}."


def _changes(c: Conclusion) -> list[Block]:
    out: list[Block] = []
    if c.remodelled is not None:
        reason = c.remodelled or "No reason is stated ([remodel] reason)."
        out.append(Text(f"The deck was remodelled before the updating. {reason}"))
    if not c.changes:
        return out or [Text("Nothing was changed.")]
    interval = f"{100 * c.level:g} % interval" if math.isfinite(c.level) else "Interval"
    heads = ("|Parameter", "Factor", "±", interval, "|Why it is plausible, or not")
    rows = [_change(x) for x in c.changes]
    return [
        *out,
        ReportTable(
            heads, rows, "The factors, updated over initial; ±: one standard deviation."
        ),
    ]


def _change(x: Change) -> list[str | Cell]:
    factor, std = with_error(x.factor, x.std)
    within = "–"
    if x.interval is not None:
        within = " to ".join(with_error(end, x.std)[0] for end in x.interval)
    if x.rigid:
        reason: str | Cell = "tuned to the rigid-body modes"
    elif x.doubts:
        reason = Cell("; ".join(DOUBTS[d] for d in x.doubts), "doubt")
    elif math.isfinite(x.kept):
        kept = number(100 * x.kept, 2)
        share = "all of it" if kept == "100" else f"at least {kept} % of it"
        reason = f"excludes 1; {share} stays with modes left out"
    elif x.interval is None:
        reason = "no interval is known"
    else:
        reason = "a slight change, inside what is expected"
    return [x.name, factor, std, within, reason]


def _question(q: Question) -> tuple[str, str]:
    v = dict(q.values)
    code = q.code
    if code == "parameter not proven":
        share = fixed(float(v["correlation"]), 2, sign=True)
        trade = f": it trades with “{v['other']}” (correlation {share})"
        v["trade"] = trade if v["other"] else ""
        v["modes"] = f"; FE modes {v['modes']} depend on it most" if v["modes"] else ""
    elif code == "FE modes unpaired":
        v["points"] = f": at {v['points']}" if v["points"] else ""
    elif code == "beyond the band" and float(v["high"]) <= 0:
        code = "nowhere"
    if "high" in v:
        v["high"] = number(float(v["high"]))
    what, settles = QUESTIONS[code]
    return what.format(**v), settles.format(**v)


def _signatures(data: Stages) -> list[Block]:
    info = data.info
    signed = (
        ("Author", info.author),
        ("Checked", info.checked_by),
        ("Approved", info.approved_by),
    )
    if not any(name for _, name in signed):
        return []
    rows = [(role, name, Cell("", "signature")) for role, name in signed]
    return [ReportTable(("|Role", "|Name", "|Date and signature"), rows, "Sign-off.")]
