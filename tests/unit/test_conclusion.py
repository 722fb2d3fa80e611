"""The first page of the report: the verdict, what failed, what was changed, what is open, who
signs.
"""

from __future__ import annotations

import pytest

from ringtrue.report.parts import Checks, Facts, Items, ReportTable, Stages, Text
from ringtrue.report.sections.conclusion import QUESTIONS, section
from ringtrue.study.acceptance import Acceptance, AcceptanceCheck
from ringtrue.study.conclusion import Change, Conclusion, Question, Unseen, Validation
from ringtrue.study.config_sections import StudyInfo

PAIRS = AcceptanceCheck("final model: pairs", "≥ 18", "21", True)
MEAN = AcceptanceCheck("final model: mean |Δf|", "≤ 2 %", "2.51 %", False)
ROSE = AcceptanceCheck(
    "left-out modes: mean |Δf|",
    "",
    "rose from 1.1 to 1.6 %",
    False,
    "change",
    required=False,
)
STALLED = AcceptanceCheck(
    "updating", "converged", "stalled", False, "outcome", required=False
)
UNSEEN = Unseen("left out", 4, 1.38, 2.32, 17.9, 4)
CHANGES = (
    Change("slab", 2.1507, 0.178, (1.81, 2.555), 0.959),
    Change("walls", 1.398, 0.142, (1.132, 1.727), 0.494, ("form",)),
    Change("springs", 1.1861, 0.0086, rigid=True),
)


def conclusion(
    *checks: AcceptanceCheck, questions: tuple[Question, ...] = ()
) -> Conclusion:
    return Conclusion(
        checks=checks,
        band=(0.5748, 41.05),
        level=0.9,
        unseen=UNSEEN,
        remodelled="Braces were found on site.",
        changes=CHANGES,
        questions=questions,
    )


def page(found: Conclusion, info: StudyInfo | None = None) -> list[object]:
    made = section(Stages(info or StudyInfo(), Acceptance(), found))
    assert made is not None
    blocks: list[object] = []
    for block in made.blocks:
        columns = getattr(block, "columns", None)
        blocks += [b for column in columns for b in column] if columns else [block]
    return blocks


def lead(found: Conclusion, use: str = "") -> Text:
    first = page(found, StudyInfo(use=use))[0]
    assert isinstance(first, Text)
    return first


def test_a_failed_requirement_is_the_verdict_however_many_others_hold() -> None:
    assert conclusion(PAIRS).verdict is Validation.VALIDATED
    assert conclusion(PAIRS, PAIRS, PAIRS, MEAN).verdict is Validation.NOT_VALIDATED
    assert conclusion(PAIRS, ROSE, STALLED).verdict is Validation.VALIDATED
    assert conclusion(ROSE).verdict is Validation.NOT_JUDGED
    assert lead(conclusion(PAIRS), "the run-up").text == (
        "Validated for the run-up, from 0.575 to 41.0 Hz."
    )
    assert lead(conclusion(PAIRS, MEAN)).text == "Not validated: 1 requirement failed."
    assert lead(conclusion(PAIRS, MEAN)).tone == "verdict bad"
    assert lead(conclusion(ROSE)).text.startswith(
        "Not judged: the study states no limit"
    )


def test_each_failed_check_has_a_sentence_and_required_ones_stand_apart() -> None:
    blocks = page(conclusion(ROSE, STALLED, PAIRS, MEAN))
    required, informative = (b for b in blocks if isinstance(b, Checks))
    assert [c.required for c in required.checks] == [True, True]
    assert [c.required for c in informative.checks] == [False, False]
    (failed,) = (b for b in blocks if isinstance(b, Items))
    assert failed.items[0] == "Final model: mean |Δf|: 2.51 %, wanted ≤ 2 %."
    assert failed.items[1].startswith(
        "Left-out modes: mean |Δf| rose from 1.1 to 1.6 %"
    )
    assert (
        failed.items[2] == "The updating ended as stalled; the limits judge its model."
    )
    assert not [b for b in page(conclusion(PAIRS)) if isinstance(b, Items)]


def test_modes_left_out_are_the_headline_and_changes_carry_their_reasons() -> None:
    blocks = page(conclusion(PAIRS))
    (facts,) = (b for b in blocks if isinstance(b, Facts))
    assert [(f.value, f.before) for f in facts.facts] == [
        ("1.4", "18"),
        ("2.3", ""),
        ("4", ""),
        ("4 of 4", ""),
    ]
    tables = [b for b in blocks if isinstance(b, ReportTable)]
    slab, walls, springs = tables[0].rows
    assert slab[1:4] == ["2.15", "0.18", "1.81 to 2.56"]
    assert "96 % of it stays" in str(slab[4])
    assert "not proven" in str(walls[4])
    assert springs[1:4] == ["1.1861", "0.0086", "–"]
    assert "rigid-body" in str(springs[4])


@pytest.mark.parametrize("code", list(QUESTIONS))
def test_each_question_names_what_settles_it(code: str) -> None:
    values = {
        "name": "walls",
        "other": "slab",
        "correlation": -0.71,
        "modes": "9, 12",
        "points": "101+Z",
        "channels": "7+X",
        "high": 41.05,
        "count": 5,
        "total": 13,
    }
    blocks = page(conclusion(PAIRS, questions=(Question(code, values),)))
    rows = [b for b in blocks if isinstance(b, ReportTable)][-1].rows
    ((what, settles),) = rows
    assert str(what).endswith(".")
    assert str(settles).endswith(".")
    assert "{" not in f"{what}{settles}"


def test_a_band_that_ends_at_once_is_not_given_as_a_limit() -> None:
    blocks = page(
        conclusion(PAIRS, questions=(Question("beyond the band", {"high": 0.0}),))
    )
    ((what, _),) = [b for b in blocks if isinstance(b, ReportTable)][-1].rows
    assert what == "The model does not hold the lowest mode of the test."


def test_who_signs_stands_below_and_nobody_where_nobody_is_named() -> None:
    blocks = page(
        conclusion(PAIRS), StudyInfo(author="A. Author", checked_by="C. Checker")
    )
    signed = blocks[-1]
    assert isinstance(signed, ReportTable)
    assert [row[:2] for row in signed.rows] == [
        ("Author", "A. Author"),
        ("Checked", "C. Checker"),
        ("Approved", ""),
    ]
    assert all(
        "Sign-off" not in getattr(b, "caption", "") for b in page(conclusion(PAIRS))
    )
