"""Text exports of analysers: header rows of several kinds above columns of frequency and parts.

Each layout is made here as programs of its family write it, and read back to the values.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import ringtrue as rt
from ringtrue.errors import DataError
from ringtrue.io.frfs import holds_frfs, read_frfs

F = np.arange(2.0, 42.0, 0.5)
W = 2 * np.pi * F[:, None]
POLES = 2 * np.pi * np.array([12.0, 25.0])
# m/s^2/N, 1+Z and 2+Z
H = W**2 / (POLES**2 - W**2 + 0.02j * POLES * W) * np.array([0.02, -0.01])
G = 9.80665
REAL_IMAG = np.stack([H.real, H.imag])
SIZE_DEGREES = np.stack([np.abs(H), np.degrees(np.angle(H))])


def body(
    *columns: np.ndarray, sep: str = "\t", comma: bool = False, end: str = ""
) -> str:
    rows = np.column_stack(columns).tolist()
    lines = [sep.join(f"{x:.10e}" for x in row) + end for row in rows]
    text = "\n".join(lines) + "\n"
    return text.replace(".", ",") if comma else text


def both(parts: np.ndarray) -> list[np.ndarray]:
    """Columns of 1+Z, then those of 2+Z."""
    return [parts[0][:, 0], parts[1][:, 0], parts[0][:, 1], parts[1][:, 1]]


def groups_above(sep: str, comma: bool = False) -> str:
    """Names over groups of columns, the parts below them, units last."""
    head = [
        sep.join(["Project", "plate 7"]),
        sep.join(["Averages", "10"]),
        "",
        sep.join(["", "FRF 1+Z/3+Z", "", "FRF 2+Z/3+Z", ""]),
        sep.join(["Frequency", "Real", "Imaginary", "Real", "Imaginary"]),
        sep.join(["Hz", *["m/s^2/N"] * 4]),
    ]
    return "\n".join(head) + "\n" + body(F, *both(REAL_IMAG), sep=sep, comma=comma)


def smart_office() -> str:
    """m+p: keys above, names repeated, decimal commas and semicolons."""
    return groups_above(";", comma=True)


def siemens() -> str:
    """LMS/Siemens: names with their component, units in double brackets, tabs."""
    head = [
        "LMS Test.Lab export",
        "Original project\tplate.lms",
        "\tFRF 1:+Z/3:+Z\tFRF 1:+Z/3:+Z\tFRF 2:+Z/3:+Z\tFRF 2:+Z/3:+Z",
        "Linear Frequency\tReal\tImaginary\tReal\tImaginary",
        "(Hz)\t((m/s2)/N)\t((m/s2)/N)\t((m/s2)/N)\t((m/s2)/N)",
    ]
    return "\n".join(head) + "\n" + body(F, *both(REAL_IMAG))


def own_axes() -> str:
    """LMS/Siemens: each FRF with its own column of frequencies, names where its group begins."""
    head = [
        "FRF 1+Z/3+Z,,,FRF 2+Z/3+Z,,",
        "Frequency,Amplitude,Phase,Frequency,Amplitude,Phase",
        "Hz,g/N,°,Hz,g/N,°",
    ]
    a, p, b, q = both(SIZE_DEGREES)
    return "\n".join(head) + "\n" + body(F, a / G, p, F, b / G, q, sep=",")


def oros() -> str:
    """OROS: titles under units, blanks between columns."""
    head = [
        "NVGate 14.0",
        "FRF H1",
        "Hz        (m/s²)/N      (m/s²)/N      (m/s²)/N      (m/s²)/N",
        "Frequency   1+Z/3+Z Real   1+Z/3+Z Imag   2+Z/3+Z Real   2+Z/3+Z Imag",
    ]
    return "\n".join(head) + "\n" + body(F, *both(REAL_IMAG), sep="   ")


def dewesoft() -> str:
    """Dewesoft: levels and degrees with the units in the titles, commas in quotes."""
    head = [
        "Dewesoft X export",
        "Start time;28.11.2026 08:00:00",
        "Frequency (Hz);1+Z/3+Z Amplitude (dB);1+Z/3+Z Phase (deg);"
        "2+Z/3+Z Amplitude (dB);2+Z/3+Z Phase (deg)",
    ]
    a, p, b, q = both(SIZE_DEGREES)
    return (
        "\n".join(head)
        + "\n"
        + body(F, 20 * np.log10(a), p, 20 * np.log10(b), q, sep=";", comma=True)
    )


def national_instruments() -> str:
    """LabVIEW measurement text over a frequency."""
    head = [
        "LabVIEW Measurement\t",
        "Separator\tTab",
        "Decimal_Separator\t,",
        "X_Columns\tOne",
        "***End_of_Header***\t",
        "Channels\t4\t\t\t\t",
        "Samples\t80\t80\t80\t80",
        "Y_Unit_Label\tg/N\trad\tg/N\trad",
        "X_Dimension\tFrequency\tFrequency\tFrequency\tFrequency",
        "X0\t2,0\t2,0\t2,0\t2,0",
        "Delta_X\t0,5\t0,5\t0,5\t0,5",
        "***End_of_Header***\t\t\t\t\t",
        "X_Value\t1+Z/3+Z (Magnitude)\t1+Z/3+Z (Phase)\t2+Z/3+Z (Magnitude)\t2+Z/3+Z (Phase)\tComment",
    ]
    a, p, b, q = both(SIZE_DEGREES)
    rows = body(F, a / G, np.radians(p), b / G, np.radians(q), comma=True)
    return "\n".join(head) + "\n" + rows


@pytest.mark.parametrize(
    "layout",
    [smart_office, siemens, own_axes, oros, dewesoft, national_instruments],
    ids=lambda f: f.__name__,
)
def test_layouts_of_several_frfs(layout: Callable[[], str], tmp_path: Path) -> None:
    path = tmp_path / "export.dat"
    path.write_text(layout(), encoding="utf-8")
    assert holds_frfs(path)
    got = rt.read_frfs(path)
    assert [c.id.replace(":", "") for c in (*got.outputs, *got.inputs)] == [
        "1+Z",
        "2+Z",
        "3+Z",
    ]
    np.testing.assert_allclose(got.freqs, F)
    np.testing.assert_allclose(got.data[:, :, 0], H, rtol=1e-6)


@pytest.mark.parametrize("sep", ["\t", ";", ","])
def test_groups_with_each_separator(sep: str, tmp_path: Path) -> None:
    (tmp_path / "h.txt").write_text(groups_above(sep))
    np.testing.assert_allclose(
        read_frfs(tmp_path / "h.txt").data[:, :, 0], H, rtol=1e-6
    )


def pulse(*, counts: bool) -> str:
    """B&K Pulse: keys alone above the numbers, with or without a column of counts."""
    head = [
        '"Header size:"\t"9"',
        '"Title1:"\t"Frequency Response H1(Response,Force) - Input (Real, Imaginary)"',
        '"X-Axis size:"\t"80"',
        '"X-Axis unit:"\t"Hz"',
        '"Y-Axis unit:"\t"(m/s²)/N"',
        '"Response DOF:"\t"1+Z"',
        '"Reference DOF:"\t"3+Z"',
    ]
    first = [np.arange(1.0, 81.0)] if counts else []
    return "\n".join(head) + "\n" + body(*first, F, H[:, 0].real, H[:, 0].imag)


def one_below_keys() -> str:
    """Response and reference in keys, columns without names."""
    head = [
        "Response: 1+Z",
        "Reference: 3+Z",
        "Hz;(m/s^2)/N;(m/s^2)/N",
        "Frequency;Real;Imag",
    ]
    return (
        "\n".join(head)
        + "\n"
        + body(F, H[:, 0].real, H[:, 0].imag, sep=";", comma=True)
    )


def counted() -> str:
    head = "No.;Frequency [Hz];1+Z/3+Z Real [m/s^2/N];1+Z/3+Z Imag [m/s^2/N]\n"
    return head + body(np.arange(80.0), F, H[:, 0].real, H[:, 0].imag, sep=";")


def commented() -> str:
    head = "# saved by NumPy\n# Frequency [Hz],1+Z/3+Z real [m/s^2/N],1+Z/3+Z imag [m/s^2/N]\n"
    return head + body(F, H[:, 0].real, H[:, 0].imag, sep=",")


@pytest.mark.parametrize(
    "text",
    [pulse(counts=False), pulse(counts=True), one_below_keys(), counted(), commented()],
    ids=["pulse", "pulse with counts", "keys", "counted", "commented"],
)
def test_layouts_of_one_frf(text: str, tmp_path: Path) -> None:
    path = tmp_path / "export.csv"
    path.write_text(text, encoding="utf-8")
    assert holds_frfs(path)
    got = read_frfs(path)
    assert [c.id for c in (*got.outputs, *got.inputs)] == ["1+Z", "3+Z"]
    np.testing.assert_allclose(got.freqs, F)
    np.testing.assert_allclose(got.data[:, 0, 0], H[:, 0], rtol=1e-6)


def test_axes_that_differ_are_refused(tmp_path: Path) -> None:
    lines = own_axes().splitlines()
    changed = lines[-1].split(",")
    changed[3] = "43.0"
    (tmp_path / "h.csv").write_text(
        "\n".join([*lines[:-1], ",".join(changed)]), encoding="utf-8"
    )
    with pytest.raises(
        DataError, match=r"column 4, Frequency .* other frequencies than the first"
    ):
        read_frfs(tmp_path / "h.csv")


def test_records_are_no_frfs(tmp_path: Path) -> None:
    """A record with the same three columns, and a spectrum without a phase."""
    t = np.arange(80) / 200
    (tmp_path / "r.txt").write_text(
        "Time [s];a [g];b [g]\n" + body(t, t**2, t**3, sep=";")
    )
    (tmp_path / "s.txt").write_text("X axis unit: Hz\nAutospectrum\n" + body(F, F**2))
    assert not holds_frfs(tmp_path / "r.txt")
    assert not holds_frfs(tmp_path / "s.txt")
