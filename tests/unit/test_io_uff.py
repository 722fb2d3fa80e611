"""Universal files: every case of data set 58, geometry, shapes, and the odd forms that vendors
write.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from record_files import write_function, write_history

from ringtrue.core.signals import Channel, FrfSet, TimeHistory
from ringtrue.errors import DataError
from ringtrue.identification.frf.residues import driving_pairs
from ringtrue.io.frfs import frf_ids, holds_frfs, read_frfs, write_frfs
from ringtrue.io.modes import read_modes
from ringtrue.io.records import read_record
from ringtrue.io.uff.datasets import scan
from ringtrue.io.uff.functions import read_functions
from ringtrue.io.uff.points import read_shapes

DATA = Path(__file__).parents[2].parent / "shared/data/uff"
data_here = pytest.mark.skipif(not DATA.is_dir(), reason=f"no reference data at {DATA}")
X = np.arange(7) * 0.25
Y = np.array([1.5, -2.25, 3e-7, -4.0, 5e10, -6.0, 7.0])


def function58(
    body: str, ordinate: int, even: int, kind: int = 1, count: int = 7
) -> str:
    """A data set 58 of `count` points, its body given."""
    place = f"{kind:5d}{0:10d}{0:5d}{0:10d} {'NONE':<10}{3:10d}{-2:4d} {'NONE':<10}{4:10d}{1:4d}"
    axes = [
        f"{c:10d}{0:5d}{0:5d}{0:5d} {'NONE':<20} {'NONE':<20}" for c in (17, 12, 0, 0)
    ]
    form = f"{ordinate:10d}{count:10d}{even:10d}{0.0:13.5E}{0.25:13.5E}{0.0:13.5E}"
    return "\n".join(
        ["    -1", "    58", *("text",) * 5, place, form, *axes, body, "    -1", ""]
    )


def lines(values: np.ndarray, widths: tuple[int, ...]) -> str:
    """Fortran columns without blanks between them where a number fills its column."""
    out = []
    for at in range(0, values.size, len(widths)):
        part = zip(widths, values[at : at + len(widths)].tolist(), strict=False)
        out.append("".join(f"{v:{w}.{5 if w == 13 else 12}E}" for w, v in part))
    return "\n".join(out)


PAIRS = np.column_stack([Y, Y[::-1]]).ravel()
WITH_X = np.column_stack([X, Y]).ravel()
TRIPLES = np.column_stack([X, Y, Y[::-1]]).ravel()
CASES = {
    "real single even": (2, 1, lines(Y, (13,) * 6), Y),
    "real single uneven": (2, 0, lines(WITH_X, (13,) * 6), Y),
    "complex single even": (5, 1, lines(PAIRS, (13,) * 6), Y + 1j * Y[::-1]),
    "complex single uneven": (5, 0, lines(TRIPLES, (13,) * 6), Y + 1j * Y[::-1]),
    "real double even": (4, 1, lines(Y, (20,) * 4), Y),
    "real double uneven": (4, 0, lines(WITH_X, (13, 20) * 2), Y),
    "complex double even": (6, 1, lines(PAIRS, (20,) * 4), Y + 1j * Y[::-1]),
    "complex double uneven": (6, 0, lines(TRIPLES, (13, 20, 20)), Y + 1j * Y[::-1]),
}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("ends", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("letter", ["E", "D", "e"])
def test_every_case_of_58(tmp_path: Path, name: str, ends: str, letter: str) -> None:
    ordinate, even, body, want = CASES[name]
    text = function58(body.replace("E", letter), ordinate, even)
    (tmp_path / "f.uff").write_bytes(text.replace("\n", ends).encode())
    (found,) = read_functions(tmp_path / "f.uff")
    np.testing.assert_allclose(found.x, X)
    np.testing.assert_allclose(found.y, want, rtol=1e-5)
    assert (found.response, found.reference) == ((3, -2), (4, 1))
    assert found.axes[1].data_type == 12


def test_columns_without_blanks_and_exponents_of_three_digits(tmp_path: Path) -> None:
    values = np.array([-1.25, -2.5, -3.75, -4.5, -5.5, -6.5, -7.5])
    # 12 columns each: no blanks, no columns
    touching = lines(values, (13,) * 6).replace(" ", "")
    (tmp_path / "a.uff").write_text(function58(touching, 2, 1))
    np.testing.assert_allclose(read_functions(tmp_path / "a.uff")[0].y, values)
    full = "-1.000000-101-2.000000E+00-3.00000D+001"  # fields of 13
    (tmp_path / "b.uff").write_text(function58(full, 2, 1, count=3))
    np.testing.assert_allclose(
        read_functions(tmp_path / "b.uff")[0].y, [-1e-101, -2.0, -30.0]
    )


def test_a_cut_body_is_told(tmp_path: Path) -> None:
    (tmp_path / "a.uff").write_text(function58(lines(Y[:5], (13,) * 6), 2, 1))
    with pytest.raises(DataError, match=r"a\.uff: 5 numbers where 7"):
        read_functions(tmp_path / "a.uff")
    (tmp_path / "b.uff").write_text(
        function58(lines(Y, (13,) * 6).replace("5", "x"), 2, 1)
    )
    with pytest.raises(DataError, match="not a number"):
        read_functions(tmp_path / "b.uff")
    (tmp_path / "c.uff").write_text("text\nmore text\n")
    with pytest.raises(DataError, match="universal file"):
        scan(tmp_path / "c.uff")


@pytest.mark.parametrize("damage", ["none", "count", "no count", "line end"])
def test_binary_with_marks_inside_and_wrong_counts(tmp_path: Path, damage: str) -> None:
    """A sample whose bytes look like a closing mark must not end the set; vendors write wrong
    counts of bytes.
    """
    y = np.concatenate([Y, np.frombuffer(b"\n    -1\n" * 2, "<f8")])
    codes = (17, 12, 0)
    raw = write_function(
        1, np.arange(y.size) * 0.5, y, (1, 3), (0, 0), codes=codes, binary=True
    )
    count = f"{y.size * 8:12d}".encode()
    wrong = {
        "none": count,
        "line end": count,
        "count": f"{y.size * 8 + 4:12d}".encode(),
        "no count": b" " * 11 + b"0",
    }
    raw = raw.replace(count, wrong[damage], 1)
    if damage == "line end":
        raw = raw.replace(b"\n    -1\n    58", b"\r\n    -1\r\n    58")
    (tmp_path / "f.uff").write_bytes(raw + raw)
    found = read_functions(tmp_path / "f.uff")
    assert len(found) == 2
    for f in found:
        np.testing.assert_array_equal(f.y, y)


def test_big_endian_and_mixed_precision(tmp_path: Path) -> None:
    raw = write_function(1, X, Y, (1, 3), (0, 0), codes=(17, 12, 0), binary=True)
    at = raw.index(Y.tobytes())
    big = (raw[:at] + Y.astype(">f8").tobytes() + raw[at + Y.nbytes :]).replace(
        b"58b     1", b"58b     2"
    )
    (tmp_path / "big.uff").write_bytes(big)
    np.testing.assert_array_equal(read_functions(tmp_path / "big.uff")[0].y, Y)
    table = np.zeros(7, dtype=[("x", "<f4"), ("y", "<f8")])
    table["x"], table["y"] = X, Y
    mixed = raw[:at] + table.tobytes() + raw[at + Y.nbytes :]
    mixed = mixed.replace(f"{Y.nbytes:12d}".encode(), f"{table.nbytes:12d}".encode())
    mixed = mixed.replace(f"{7:10d}{1:10d}".encode(), f"{7:10d}{0:10d}".encode())
    (tmp_path / "mixed.uff").write_bytes(mixed)
    found = read_functions(tmp_path / "mixed.uff")[0]
    np.testing.assert_array_equal(found.x, X)
    np.testing.assert_array_equal(found.y, Y)


def test_frfs_and_records_go_round(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    h = rng.standard_normal((9, 2, 1)) + 1j * rng.standard_normal((9, 2, 1))
    out = (Channel("1+Z", "velocity", "m/s"), Channel("2-X", "velocity", "m/s"))
    frfs = FrfSet(
        h,
        np.arange(9) * 0.5,
        out,
        (Channel("2-X", "force", "N"),),
        np.abs(h) / 9,
        np.array([3.0]),
    )
    write_frfs(tmp_path / "f.uff", frfs)
    got = read_frfs(tmp_path / "f.uff")
    np.testing.assert_allclose(got.data, h, rtol=1e-12)
    np.testing.assert_allclose(got.coherence, np.abs(h) / 9, rtol=1e-12)
    assert got.kind == "mobility"
    skewed = Channel("2+Ys", "velocity", "m/s")
    record = TimeHistory(
        rng.standard_normal((4, 50)),
        128.0,
        (Channel("F:2-X", "force", "N"), *out, skewed),
    )
    write_history(tmp_path / "t.uff", record)
    again = read_record(tmp_path / "t.uff")
    np.testing.assert_allclose(again.data, record.data, rtol=1e-12)
    assert [c.id for c in again.channels] == ["F:2-X", "1+Z", "2-X", "2+Ys"]


def test_units_of_the_file_become_si(tmp_path: Path) -> None:
    """Data set 164 of a file in mm and mN: 1000 units of each per SI unit."""
    units = (
        "    -1\n   164\n         5mm (milli-newton)        2\n"
        + "  1.0000D+03" * 3
        + "\n  2.7315D+02\n    -1\n"
    )
    (tmp_path / "f.uff").write_text(units + function58(lines(Y, (13,) * 6), 2, 1))
    np.testing.assert_allclose(
        read_record(tmp_path / "f.uff").data[0], Y / 1000, rtol=1e-5
    )


def test_rotations_and_moments_of_a_file_in_millimetres(tmp_path: Path) -> None:
    """Directions 4 to 6: radians stay, moments are in mN mm, strain in none."""
    units = (
        b"    -1\n   164\n         5mm (milli-newton)        2\n"
        + b"  1.0000D+03" * 3
        + b"\n  2.7315D+02\n    -1\n"
    )
    f, h = np.arange(1.0, 20.0), np.exp(-0.2j * np.arange(1.0, 20.0))
    ends = [((1, 3), (1, 3)), ((1, -5), (1, 3)), ((1, 3), (1, 5)), ((1, -5), (1, 5))]
    sets = [write_function(4, f, h, out, ref, codes=(18, 12, 13)) for out, ref in ends]
    (tmp_path / "f.uff").write_bytes(units + b"".join(sets))
    found = read_frfs(tmp_path / "f.uff")
    np.testing.assert_allclose(found.data[0], h[0] * np.array([[1, 1e3], [1e3, 1e6]]))
    assert [(c.id, c.unit) for c in (*found.outputs, *found.inputs)] == [
        ("1+Z", "m/s^2"),
        ("1-RY", "rad/s^2"),
        ("1+Z", "N"),
        ("1+RY", "N*m"),
    ]
    signals = [
        write_function(1, f, h.real, (k, 6), (0, 0), codes=(17, code, 0))
        for k, code in ((1, 11), (2, 3))
    ]
    (tmp_path / "t.uff").write_bytes(units + b"".join(signals))
    record = read_record(tmp_path / "t.uff")
    np.testing.assert_allclose(record.data, [h.real, h.real])
    assert [c.quantity for c in record.channels] == ["angular velocity", "strain"]


@data_here
def test_shapes_of_vendors() -> None:
    shapes = read_shapes(DATA / "2411 and 2414.uff")
    assert len(shapes) == 10
    assert [round(s.frequency, 4) for s in shapes[:3]] == [0.9564, 2.3416, 5.8807]
    assert shapes[0].values.shape == (441, 6)
    assert read_modes(DATA / "2411 and 2414.uff").shapes.shape == (2646, 10)


def test_frfs_of_several_kinds_and_units_are_one_kind_in_si(tmp_path: Path) -> None:
    """An accelerometer in g, one in in/s^2 and a laser in mm/s over lbf on one point of one
    oscillator.
    """
    f = np.arange(20) * 0.5
    h = -((2 * np.pi * f) ** 2) / (
        30.0**2 - (2 * np.pi * f) ** 2 + 2j * 0.05 * 30 * 2 * np.pi * f
    )
    velocity = np.divide(h, 2j * np.pi * f, out=np.zeros_like(h), where=f > 0)
    rows = [
        (h / 9.80665, 12, "g/lbf"),
        (h / 0.0254, 12, "(in/s^2)"),
        (velocity * 1e3, 11, "mm/s/lbf"),
    ]
    parts = []
    for node, (y, code, unit) in enumerate(rows):
        block = write_function(
            4, f, y * 4.4482216152605, (node + 1, 3), (1, 3), codes=(18, code, 13)
        ).decode()
        mark = f"{code:10d}    0    0    0 NONE                 NONE"
        under = f"{13:10d}    0    0    0 NONE                 NONE"
        assert mark in block
        assert under in block
        block = block.replace(mark, mark[:-4] + unit)
        parts.append(
            block if "lbf" in unit else block.replace(under, under[:-4] + "lbf")
        )
    (tmp_path / "f.uff").write_text("".join(parts))
    frfs = read_frfs(tmp_path / "f.uff")
    assert frfs.kind == "accelerance"
    assert {(c.quantity, c.unit) for c in frfs.outputs} == {("acceleration", "m/s^2")}
    np.testing.assert_allclose(
        frfs.data[:, :, 0], np.repeat(h[:, None], 3, axis=1), rtol=1e-10, atol=1e-12
    )


@pytest.mark.parametrize(
    ("code", "kind"), [(0, "accelerance"), (12, "accelerance"), (3, "receptance")]
)
def test_an_unknown_response_is_taken_as_an_acceleration_and_strain_as_no_motion(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, code: int, kind: str
) -> None:
    f = np.arange(1, 20) * 0.5
    h = 1 / (30.0**2 - (2 * np.pi * f) ** 2 + 2j * 0.05 * 30 * 2 * np.pi * f)
    (tmp_path / "f.uff").write_bytes(
        write_function(4, f, h, (2, 3), (1, 3), codes=(18, code, 13))
    )
    frfs = read_frfs(tmp_path / "f.uff")
    assert frfs.kind == kind
    np.testing.assert_allclose(frfs.data[:, 0, 0], h, rtol=1e-10)
    assert ("quantity of the responses is unknown" in caplog.text) == (code == 0)


@pytest.mark.parametrize("kind", [4, 5])
def test_a_motion_over_that_of_the_base_is_read_as_an_acceleration(
    tmp_path: Path, kind: int
) -> None:
    f, h = np.arange(1, 9) * 0.5, np.arange(1, 9) * (1 + 1j)
    (tmp_path / "f.uff").write_bytes(
        write_function(kind, f, h, (1, 3), (2, 3), codes=(18, 12, 12))
    )
    frfs = read_frfs(tmp_path / "f.uff")
    assert (frfs.kind, frfs.inputs[0].id, frfs.inputs[0].quantity) == (
        "accelerance",
        "base 2+Z",
        "acceleration",
    )
    assert holds_frfs(tmp_path / "f.uff")
    np.testing.assert_allclose(frfs.data[:, 0, 0], h, rtol=1e-6)
    table = tmp_path / "f.csv"
    rows = [f"{a},{b.real},{b.imag}" for a, b in zip(f, h, strict=True)]
    table.write_text(
        "\n".join(
            ["Frequency [Hz],1+Z/2+Z real [m/s^2/g],1+Z/2+Z imag [m/s^2/g]", *rows]
        )
    )
    np.testing.assert_allclose(read_frfs(table).data[:, 0, 0], h / 9.80665, rtol=1e-9)


def test_the_control_channel_on_the_base_is_no_driving_point(tmp_path: Path) -> None:
    rows = [f"{f},{3 * f},1,1,0" for f in range(1, 9)]
    head = "Frequency [Hz],1+Z/2+Z real [g/g],1+Z/2+Z imag [g/g],2+Z/2+Z real [g/g],2+Z/2+Z imag [g/g]"
    (tmp_path / "f.csv").write_text("\n".join([head, *rows]))
    frfs = read_frfs(tmp_path / "f.csv")
    assert [c.id for c in frfs.outputs] == ["1+Z", "2+Z"]
    assert len(driving_pairs(frfs)) == 0


def test_a_force_over_a_motion_is_no_frf(tmp_path: Path) -> None:
    f = np.arange(1, 9) * 0.5
    (tmp_path / "f.uff").write_bytes(
        write_function(4, f, f + 1j, (1, 3), (2, 3), codes=(18, 13, 12))
    )
    with pytest.raises(
        DataError, match=r"response 1\+Z is a force; an FRF here is motion over force"
    ):
        read_frfs(tmp_path / "f.uff")


def test_repeated_functions_are_averaged_and_the_line_at_0_may_be_missing(
    tmp_path: Path,
) -> None:
    freqs, h = np.arange(9) * 0.5, np.arange(9) + 1j
    h[0] = np.nan
    again = [
        write_function(4, freqs, h * k, (1, 3), (2, 3), codes=(18, 12, 13))
        for k in (1.0, 2.0, 6.0)
    ]
    (tmp_path / "f.uff").write_bytes(b"".join(again))
    got = read_frfs(tmp_path / "f.uff")
    np.testing.assert_allclose(got.data[:, 0, 0], 3 * h[1:])
    assert got.freqs[0] == 0.5
    (tmp_path / "f.uff").write_bytes(
        write_function(9, freqs, freqs, (1, 3), (2, 3), codes=(18, 12, 13))
    )
    with pytest.raises(DataError, match="no time records; it holds 1 spectra"):
        read_record(tmp_path / "f.uff")


def _grid(
    path: Path, absent: Iterable[tuple[int, int]], *, outputs: int = 6, inputs: int = 2
) -> None:
    """Functions of value 10 o + i from reference 100 + i to response o, without some."""
    freqs, gone = np.arange(1, 9) * 0.5, set(absent)
    pairs = [
        (o, i)
        for o in range(1, outputs + 1)
        for i in range(1, inputs + 1)
        if (o, i) not in gone
    ]
    path.write_bytes(
        b"".join(
            write_function(
                4,
                freqs,
                np.full(8, 10 * o + i + 0j),
                (o, 3),
                (100 + i, 3),
                codes=(18, 12, 13),
            )
            for o, i in pairs
        )
    )


def test_what_lacks_a_pair_is_left_out_and_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    # one response was not measured from the second shaker
    _grid(tmp_path / "f.uff", [(4, 2)])
    got = read_frfs(tmp_path / "f.uff")
    assert [c.id for c in got.outputs] == ["1+Z", "2+Z", "3+Z", "5+Z", "6+Z"]
    np.testing.assert_allclose(
        got.data[0].real, 10 * np.array([1, 2, 3, 5, 6])[:, None] + [1, 2]
    )
    assert (
        "no values from 102+Z to 4+Z (1 pairs are absent); left out: response 4+Z"
        in caplog.text
    )
    _grid(
        tmp_path / "g.uff", [(o, 3) for o in range(2, 7)], inputs=3
    )  # a single function from a third reference
    got = read_frfs(tmp_path / "g.uff")
    assert ([c.id for c in got.inputs], len(got.outputs)) == (["101+Z", "102+Z"], 6)
    assert "left out: reference 103+Z" in caplog.text
    _grid(tmp_path / "h.uff", [(o, 1 + o % 2) for o in range(1, 7)])
    with pytest.raises(DataError, match=r"6 pairs are absent\); without gaps"):
        read_frfs(tmp_path / "h.uff")


def test_what_is_left_out_may_be_at_fault(tmp_path: Path) -> None:
    """A response with a value that is not finite, and one of other lines."""
    freqs, path = np.arange(1, 9) * 0.5, tmp_path / "f.uff"
    _grid(path, [], outputs=2, inputs=1)
    bad = write_function(
        4,
        freqs,
        np.where(freqs == 2, np.inf, freqs + 0j),
        (3, 3),
        (101, 3),
        codes=(18, 12, 13),
    )
    other = write_function(
        4, 2 * freqs, freqs + 0j, (4, 3), (101, 3), codes=(18, 12, 13)
    )
    sound = path.read_bytes()
    path.write_bytes(sound + bad)
    with pytest.raises(
        DataError, match=r"1 values are not finite, the first of 3\+Z/101\+Z at 2 Hz"
    ):
        read_frfs(path)
    path.write_bytes(sound + bad + other)
    assert frf_ids(path) == ("1+Z", "101+Z", "2+Z", "3+Z", "4+Z")
    with pytest.raises(DataError, match="other frequency lines"):
        read_frfs(path)
    assert [c.id for c in read_frfs(path, ["3+Z", "4+Z", "9+Z"]).outputs] == [
        "1+Z",
        "2+Z",
    ]
    with pytest.raises(DataError, match="no function is left"):
        read_frfs(path, ["101+Z"])


def test_references_without_a_point_are_told_apart_by_their_direction(
    tmp_path: Path,
) -> None:
    freqs, path = np.arange(1, 9) * 0.5, tmp_path / "f.uff"
    path.write_bytes(
        b"".join(
            write_function(
                4,
                freqs,
                np.full(8, 10 * o + i + 0j),
                (o, 3),
                (0, i),
                codes=(18, 12, 13),
            )
            for o in (1, 2)
            for i in (1, 3)
        )
    )
    got = read_frfs(path)
    assert [c.id for c in got.inputs] == ["in1+X", "in1+Z"]
    np.testing.assert_allclose(got.data[0], [[11, 13], [21, 23]])


@pytest.mark.parametrize("rate", [5120.0, 51200.0, 44100.0, 1000.0, 16384.0, 300.0])
def test_the_rate_is_not_rounded_by_the_six_digits_of_its_step(
    tmp_path: Path, rate: float
) -> None:
    """1.953125E-04 s is written 1.95313E-04, and would be 5119.987 Hz."""
    text = function58(lines(Y, (13,) * 6), 2, 1).replace(
        f"{0.25:13.5E}", f"{1 / rate:13.5E}"
    )
    (tmp_path / "r.uff").write_text(text)
    assert read_record(tmp_path / "r.uff").rate == rate


def _plain(
    kind: int, codes: str, title: str, body: str, even: int = 1, unit: str = "NONE"
) -> str:
    """A function without points, its axis and the unit of its abscissa named."""
    text = function58(body, 5 if kind in (4, 6) else 2, even, kind).replace(
        f"{3:10d}{-2:4d}", f"{0:10d}{0:4d}"
    )
    text = text.replace(f"{4:10d}{1:4d}", f"{0:10d}{0:4d}").replace(
        "    17    ", f"    {codes}    ", 1
    )
    text = text.replace(
        "NONE                 NONE", f"NONE                 {unit:<4}", 1
    )
    return text.replace(
        f"{12:10d}{0:5d}{0:5d}{0:5d} {'NONE':<20}",
        f"{12:10d}{0:5d}{0:5d}{0:5d} {title:<20}",
    )


def test_channels_without_points_have_the_names_of_their_axes(tmp_path: Path) -> None:
    """As catman writes them; of function type 0 too, where the abscissa is a time."""
    body = lines(Y, (13,) * 6)
    (tmp_path / "t.uff").write_text(
        _plain(1, "17", "Acc left", body) + _plain(0, "17", "Acc right", body)
    )
    assert [c.id for c in read_record(tmp_path / "t.uff").channels] == [
        "Acc left",
        "Acc right",
    ]
    pairs = lines(PAIRS, (13,) * 6)
    (tmp_path / "f.uff").write_text(
        _plain(4, "18", "Acc left", pairs) + _plain(4, "18", "Acc right", pairs)
    )
    frfs = read_frfs(tmp_path / "f.uff")
    assert ([c.id for c in frfs.outputs], [c.id for c in frfs.inputs]) == (
        ["Acc left", "Acc right"],
        ["in1"],
    )
    (tmp_path / "f.uff").write_text(_plain(4, "18", "Acc", pairs) * 2)
    with pytest.raises(DataError, match="name no reference point"):
        read_frfs(tmp_path / "f.uff")


@pytest.mark.parametrize(
    ("unit", "factor"),
    [("rad/s", 0.5 / np.pi), ("RPM", 1 / 60), ("kHz", 1e3), ("Hz", 1.0)],
)
def test_the_unit_of_the_abscissa_counts(
    tmp_path: Path, unit: str, factor: float
) -> None:
    text = function58(lines(PAIRS, (13,) * 6), 5, 1, 4).replace(
        f"{17:10d}{0:5d}{0:5d}{0:5d} {'NONE':<20} {'NONE':<20}",
        f"{18:10d}{0:5d}{0:5d}{0:5d} {'Freq':<20} {unit:<20}",
    )
    (tmp_path / "f.uff").write_text(text)
    np.testing.assert_allclose(read_frfs(tmp_path / "f.uff").freqs, X * factor)


def test_a_form_that_is_not_finite_is_damage(tmp_path: Path) -> None:
    (tmp_path / "t.uff").write_text(
        function58(lines(Y, (13,) * 6), 2, 1).replace(f"{7:10d}", f"{'nan':>10}", 1)
    )
    with pytest.raises(DataError, match="not finite"):
        read_record(tmp_path / "t.uff")


def test_coherence_on_other_lines_is_left_out(tmp_path: Path) -> None:
    f, h = np.arange(1, 9) * 0.5, np.arange(1, 9) * (1 + 1j)
    parts = [write_function(4, f, h, (1, 3), (2, 3), codes=(18, 12, 13))]
    parts.append(
        write_function(6, 2 * f, np.full(8, 0.9), (1, 3), (2, 3), codes=(18, 0, 0))
    )
    (tmp_path / "f.uff").write_bytes(b"".join(parts))
    assert np.isnan(read_frfs(tmp_path / "f.uff").coherence).all()


def test_the_rate_of_times_that_stand_beside_the_samples(tmp_path: Path) -> None:
    """Of six digits each; the median step of a long record would be off by their rounding."""
    t = np.arange(2000) / 512
    text = function58(
        lines(np.column_stack([t, np.sin(t)]).ravel(), (13,) * 6), 2, 0, count=t.size
    )
    (tmp_path / "t.uff").write_text(text)
    assert read_record(tmp_path / "t.uff").rate == pytest.approx(512, rel=5e-6)


def frf58(x: np.ndarray, y: np.ndarray, point: int, code: int = 12) -> bytes:
    return write_function(4, x, y, (point, 3), (1, 3), codes=(18, code, 13))


def test_functions_on_other_lines_are_read_at_those_they_share(tmp_path: Path) -> None:
    x = np.arange(1.0, 60.5, 0.5)
    y = x + 1j
    parts = [frf58(x, y, 1), frf58(x[1::2], y[1::2], 2), frf58(x[:100], y[:100], 3)]
    (tmp_path / "f.uff").write_bytes(b"".join(parts))
    got = read_frfs(tmp_path / "f.uff")
    np.testing.assert_allclose(got.freqs, np.arange(1.5, 51.0))
    np.testing.assert_allclose(
        got.data[:, :, 0], np.repeat((got.freqs + 1j)[:, None], 3, axis=1)
    )
    (tmp_path / "f.uff").write_bytes(b"".join([*parts, frf58(x[:20], y[:20], 4)]))
    with pytest.raises(DataError, match=r"4\+Z/1\+Z has other frequency lines"):
        read_frfs(tmp_path / "f.uff")


def test_lines_without_values_are_left_out_and_functions_without_any(
    tmp_path: Path,
) -> None:
    x = np.arange(1.0, 31.0)
    y = np.array(x + 1j)
    y[4] = np.nan
    (tmp_path / "f.uff").write_bytes(
        b"".join(frf58(x, y, k) for k in (1, 2, 3)) + frf58(x, y * np.nan, 4)
    )
    got = read_frfs(tmp_path / "f.uff")
    np.testing.assert_allclose(got.freqs, np.delete(x, 4))
    assert [c.id for c in got.outputs] == ["1+Z", "2+Z", "3+Z"]
    (tmp_path / "f.uff").write_bytes(frf58(x, y, 1) + frf58(x, x + 1j, 2))
    with pytest.raises(
        DataError, match=r"1 values are not finite, the first of 1\+Z/1\+Z at 5 Hz"
    ):
        read_frfs(tmp_path / "f.uff")


def test_a_response_measured_by_an_accelerometer_and_a_laser(tmp_path: Path) -> None:
    """The same pair as accelerance and as mobility: one mean, of the kind of most."""
    x = np.arange(1.0, 31.0)
    y = x + 1j
    parts = [frf58(x, y, 1), frf58(x, y, 2), frf58(x, y / (2j * np.pi * x), 2, code=11)]
    (tmp_path / "f.uff").write_bytes(b"".join(parts))
    got = read_frfs(tmp_path / "f.uff")
    assert got.kind == "accelerance"
    np.testing.assert_allclose(got.data[:, :, 0], np.repeat(y[:, None], 2, axis=1))
