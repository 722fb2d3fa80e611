"""Read after write is the identity, for numbers, cards and edits."""

from __future__ import annotations

import tempfile
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ringtrue.decks.nastran.editor import edit_fields
from ringtrue.decks.nastran.lexer import integers, real
from ringtrue.decks.nastran.reader import read_deck, survey
from ringtrue.decks.nastran.writer import format_card, format_field, format_real
from ringtrue.errors import RingtrueError
from ringtrue.model.cards import columns
from ringtrue.model.edit import FieldChange

# the characters left for digits when sign, point and a two-digit exponent are written: -1.23-45,
# three and eleven
EIGHT, WIDE = 5e-3, 5e-11
finite = st.floats(min_value=-1e99, max_value=1e99, allow_nan=False).map(
    lambda x: x if abs(x) > 1e-90 else 0.0
)
plain = st.floats(min_value=-1e9, max_value=1e9, allow_nan=False).map(
    lambda x: x if abs(x) > 1e-9 else 0.0
)
ids = st.integers(min_value=1, max_value=99_999_999)


@given(finite)
def test_sixteen_characters_hold_eleven_digits(x: float) -> None:
    text = format_real(x, 16)
    assert len(text) <= 16
    assert real(text) == pytest.approx(x, rel=WIDE)


@given(finite)
def test_eight_characters_are_the_nearest_of_their_form(x: float) -> None:
    text = format_real(x, 8)
    assert len(text) <= 8
    assert real(text) == pytest.approx(x, rel=EIGHT)
    assert format_real(real(text), 8) == text


@given(st.floats(1e-3, 9e4), st.sampled_from([8, 16]), st.sampled_from([1, -1]))
def test_usual_reals_keep_all_digits_that_fit(
    size: float, width: int, sign: int
) -> None:
    """No decimal number of as many characters is nearer."""
    x = sign * size
    text = format_real(x, width)
    whole = len(str(int(size))) if size >= 1 else 0
    decimals = width - (sign < 0) - 1 - whole
    assert len(text) <= width
    assert abs(float(text) - x) <= 0.5 * 10.0**-decimals * (1 + 1e-9) + 2 * np.spacing(
        size
    )


@given(st.integers(-(10**7) + 1, 10**8 - 1))
def test_integers_are_exact(i: int) -> None:
    value, good = integers(np.array([format_field(i).encode()]))
    assert good[0]
    assert value[0] == i


@given(
    st.decimals(
        allow_nan=False, allow_infinity=False, places=5, min_value=-9999, max_value=9999
    )
)
def test_short_decimals_are_exact(x: object) -> None:
    assert real(format_real(float(str(x)), 16)) == float(str(x))


@settings(max_examples=30, deadline=None)
@given(
    st.lists(
        st.tuples(ids, plain, plain, plain),
        min_size=1,
        max_size=20,
        unique_by=lambda r: r[0],
    ),
    st.booleans(),
)
def test_cards_read_back_as_written(
    rows: list[tuple[int, float, float, float]], large: bool
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.bdf"
        path.write_text(
            "".join(
                format_card("GRID", [i, None, x, y, z], large=large)
                for i, x, y, z in rows
            )
        )
        grid = read_deck(path)["GRID"]
    np.testing.assert_array_equal(grid.ids, [r[0] for r in rows])
    width = 16 if large else 8
    want = [[real(format_real(v, width)) for v in r[1:]] for r in rows]
    np.testing.assert_array_equal(grid.stack("X1", "X2", "X3"), want)


FIELDS = [s.name for s in columns("PBAR") if s.kind == "f"]
CARD = {
    "small": format_card("PBAR", [1, 1, *[None] * 14, 0.5, 0.5]),
    "large": format_card("PBAR", [1, 1, *[None] * 14, 0.5, 0.5], large=True),
    "free": "PBAR,1,1\n,\n,.5,.5\n",
    "short": "PBAR,1,1\n",
    "tabs": "PBAR\t1\t1\t\t\t1.\n\t\t2.\n",
}


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from(sorted(CARD)),
    st.dictionaries(st.sampled_from(FIELDS), plain, min_size=1, max_size=6),
)
def test_edits_read_back_and_leave_the_rest(
    style: str, values: dict[str, float]
) -> None:
    before, after = "$ head, $ $\nMAT1,1,2.+11,,.3\n", "$ tail\nFORCE,1,1,,1.,1.\n"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.bdf"
        path.write_text(before + CARD[style] + after)
        old = read_deck(path)
        written = edit_fields(
            old,
            [FieldChange("PBAR", 1, f, v) for f, v in values.items()],
            Path(folder) / "new",
        )
        text, new = written[0].read_text(), read_deck(written[0])
    assert text.startswith(before)
    assert text.endswith(after)
    width = 16 if style == "large" else 8
    for name in FIELDS:
        want = (
            real(format_real(values[name], width))
            if name in values
            else old["PBAR"][name][0]
        )
        np.testing.assert_array_equal(
            new["PBAR"][name][0], want, err_msg=f"{name} in {text}"
        )


SEED = (
    "SOL 103\nCEND\nMETHOD=1\nK2GG=KA\nBEGIN "
    "BULK\nEIGRL,1,,,5\nGRDSET,,,,,,,6\nGRID,1,,0.,0.,0.\n=,*(1),=,*(.5),==\n"
    "=(2)\nCORD2R  5               0.      0.      0.      0.      0.      1.      +A\n+A      "
    "1.      0.      0.\n"
    "CQUAD4,1,1,1,2,3,4\nPCOMP,1,-.2,,,,,,SYM\n,8,.1,45.,YES,,,-45.\nMAT8,8,1.+11,9.+9,.3,5.+9\n"
    "MAT1*   1               2.1+11                          .3              *\n*       7850.\n"
    "PBEAM,1,1,4.,1.,2.\n,\n,NO,1.,3.\nCBAR,2,1,1,2,0.,1.,0.\nPBARL,1,1,,ROD\n,2.\nBAROR,,1\n"
    "RBE3,10,,4,123,1.,123,1,2\nRBE1,11,1,123456\n,UM,3,123\nSPC1,1,123,1,THRU,4\nMPC,1,1,1,1.,2,1,-1.\n"
    "DMIG,KA,0,6,1\nDMIG,KA,1,1,,1,1,2.\nCELAS4,4,5.,11,12\nPELAS,1,5.\nPARAM,WTMASS,.5\nENDDATA\n"
)
MUTATION = st.tuples(
    st.floats(0, 1),
    st.integers(0, 12),
    st.sampled_from(["", "=", "*(2)", ",", "\t", "*", "+", "$", "-1", ".", "\n", "\r"])
    | st.text(st.characters(max_codepoint=255), max_size=6),
)  # where, how many characters go, what comes instead


@settings(max_examples=150, deadline=None)
@given(st.lists(MUTATION, min_size=1, max_size=6))
def test_a_mangled_deck_is_read_or_refused(
    changes: list[tuple[float, int, str]],
) -> None:
    text = SEED
    for where, gone, new in changes:
        at = int(where * len(text))
        text = text[:at] + new + text[at + gone :]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.bdf"
        path.write_bytes(text.encode("latin-1"))
        for read in (read_deck, survey):
            with suppress(RingtrueError):  # any other error fails the test
                read(path)


def test_the_deck_that_is_mangled_is_sound() -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.bdf"
        path.write_text(SEED)
        assert len(read_deck(path)["GRID"]) == 4
