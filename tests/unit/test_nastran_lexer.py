"""Numbers and fields of bulk data lines."""

from __future__ import annotations

import numpy as np
import pytest

from ringtrue.decks.nastran.lexer import integers, real, reals, split_line


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("7.", 7.0),
        (".5", 0.5),
        ("-.5", -0.5),
        ("1.5-3", 1.5e-3),
        ("1.5+3", 1.5e3),
        ("-1.5-3", -1.5e-3),
        ("1.D+3", 1e3),
        ("1.d-3", 1e-3),
        ("2.1E11", 2.1e11),
        ("2.1+11", 2.1e11),
        ("+4.E-2", 4e-2),
        ("3", 3.0),
        ("0.12345678901234567", 0.12345678901234567),
        ("1.7976931348623157+308", 1.7976931348623157e308),
        ("4.9-324", 5e-324),
    ],
)
def test_reals_of_every_spelling(text: str, value: float) -> None:
    assert real(text) == value


@pytest.mark.parametrize(
    "text",
    [
        "",
        ".",
        "-",
        "1.2.3",
        "1.5E",
        "1E5.",
        "--1.",
        "1.-+3",
        "1. 5",
        "NAN",
        "INF",
        "1_0",
        "12A",
        "1E400",
        "-9.+308",
    ],
)
def test_malformed_reals_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match="not a number"):
        real(text)


def test_reals_of_many_digits_round_as_float_does() -> None:
    rng = np.random.default_rng(1)
    value = rng.normal(size=500) * 10.0 ** rng.integers(-30, 30, 500)
    got, good = reals(np.array([repr(float(v)).upper().encode() for v in value]))
    assert good.all()
    np.testing.assert_array_equal(got, value)


def test_integers() -> None:
    value, good = integers(
        np.array(
            [
                b"12",
                b"-3",
                b"+4",
                b"1.",
                b"-",
                b"99999999",
                b"1_0",
                b"1234567890123456789",
            ]
        )
    )
    np.testing.assert_array_equal(
        good, [True, True, True, False, False, True, False, False]
    )
    assert value[[0, 1, 2, 5]].tolist() == [12, -3, 4, 99999999]


@pytest.mark.parametrize(
    ("line", "style", "name", "fields"),
    [
        (b"GRID           1       0      1.", "small", "GRID", ["1", "0", "1."]),
        (
            b"GRID*                  1               0",
            "large",
            "GRID",
            ["1", "0", "", ""],
        ),
        (b"grid,1,,1.,2. $ here", "free", "GRID", ["1", "", "1.", "2."]),
        (b"GRID\t1\t\t1.\t2.", "small", "GRID", ["1", "", "1.", "2."]),
        (b"+A            1.", "small", "", ["1."]),
    ],
)
def test_fields_of_a_line(
    line: bytes, style: str, name: str, fields: list[str]
) -> None:
    got = split_line(line)
    assert (got.style, got.name) == (style, name)
    text = [line[a:b].strip().decode() for a, b in got.spans]
    assert text[: len(fields)] == fields
    assert not any(text[len(fields) :])
