"""Tables of FRFs with the titles that analysers, controllers and spreadsheets give their
columns.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ringtrue.errors import DataError
from ringtrue.io.frfs import holds_frfs, read_frfs

F = np.arange(4.0, 12.0, 0.5)
W = 2 * np.pi * F[:, None]
H = (
    W**2
    / (np.array([40.0, 55.0]) ** 2 - W**2 + 2j * np.array([1.0, 2.0]) * W)
    * np.array([1.0, -2.0])
)
G = 9.80665
SIZE, LEVEL, ANGLE = np.abs(H), 20 * np.log10(np.abs(H)), np.angle(H)
MOBILITY = H / (1j * W)


def write(
    path: Path,
    head: str,
    one: np.ndarray,
    two: np.ndarray,
    *,
    lines: np.ndarray = F,
    units: str = "",
) -> Path:
    """Columns 1+Z one, 1+Z two, 2+Z one, 2+Z two; semicolons."""
    names = head.split(";")
    titles = [names[0], *(n.replace("$", p) for p in ("1+Z", "2+Z") for n in names[1:])]
    rows = np.column_stack([lines, *(c[:, k] for k in range(2) for c in (one, two))])
    body = "\n".join(";".join(f"{x:.9g}" for x in row) for row in rows.tolist())
    path.write_text(
        "\n".join([";".join(titles), *([units] if units else []), body]),
        encoding="utf-8",
    )
    return path


@pytest.mark.parametrize(
    ("head", "one", "two"),
    [
        ("Frequency (Hz);$ dB;$ deg", LEVEL, np.degrees(ANGLE)),
        ("f_Hz;$_real;$_imag", H.real, H.imag),
        (
            "Linear Frequency (Hz);$ Real ((m/s^2)/N);$ Imaginary ((m/s^2)/N)",
            H.real,
            H.imag,
        ),
        ("Frequenz in Hz;Realteil $;Imaginärteil $", H.real, H.imag),
        ("Frequenz [Hz];$ Betrag [m/s²/N];$ Phase [°]", SIZE, np.degrees(ANGLE)),
        ("Fréquence [Hz];partie réelle $;partie imaginaire $", H.real, H.imag),
        ("Frequency(Hz);$_mag_dB;$_phase_rad", LEVEL, ANGLE),
        (
            "Frequency (Hz);Amplitude ((m/s^2)/N) $;Phase (Degrees) $",
            SIZE,
            np.degrees(ANGLE),
        ),
        ("Frequency;$ Amplitude - dB;$ Phase", LEVEL, np.degrees(ANGLE)),
        ("Hz;|H| $;arg H $", SIZE, np.degrees(ANGLE)),
        ("Hz;Re(H $);Im(H $)", H.real, H.imag),
        ("Freq;$ real g/N;$ imag g/N", H.real / G, H.imag / G),
        ("Freq;$ mag dB re 1e-6 m/s^2/N;$ phase", LEVEL + 120, np.degrees(ANGLE)),
    ],
)
def test_titles(tmp_path: Path, head: str, one: np.ndarray, two: np.ndarray) -> None:
    path = write(tmp_path / "h.csv", head, one, two)
    assert holds_frfs(path)
    got = read_frfs(path)
    assert [c.id for c in got.outputs] == ["1+Z", "2+Z"]
    np.testing.assert_allclose(got.freqs, F)
    np.testing.assert_allclose(got.data[:, :, 0], H, rtol=1e-6)


@pytest.mark.parametrize(
    ("title", "factor"),
    [
        ("Frequency (kHz)", 1e-3),
        ("Frequency [rad/s]", 2 * np.pi),
        ("omega", 2 * np.pi),
        ("rpm", 60),
    ],
)
def test_the_unit_of_the_lines(tmp_path: Path, title: str, factor: float) -> None:
    head = f"{'f [rpm]' if title == 'rpm' else title};$ real;$ imag"
    got = read_frfs(write(tmp_path / "h.csv", head, H.real, H.imag, lines=F * factor))
    np.testing.assert_allclose(got.freqs, F, rtol=1e-7)


def test_a_row_of_units_counts_below_titles_with_brackets(tmp_path: Path) -> None:
    path = write(
        tmp_path / "h.csv",
        "Frequency;$ (Real);$ (Imag)",
        H.real / G,
        H.imag / G,
        units="Hz" + ";g/N" * 4,
    )
    np.testing.assert_allclose(read_frfs(path).data[:, :, 0], H, rtol=1e-6)


def test_motions_of_several_kinds_become_those_of_most(tmp_path: Path) -> None:
    path = write(tmp_path / "h.csv", "Frequency;$ real;$ imag", H.real, H.imag)
    text = (
        path.read_text()
        .replace("2+Z real", "2+Z real [mm/s/N]")
        .replace("2+Z imag", "2+Z imag [mm/s/N]")
    )
    rows = np.column_stack(
        [
            F,
            H[:, 0].real,
            H[:, 0].imag,
            1e3 * MOBILITY[:, 1].real,
            1e3 * MOBILITY[:, 1].imag,
        ]
    )
    head = text.partition("\n")[0]
    np.savetxt(path, rows, delimiter=";", header=head, comments="", fmt="%.9g")
    got = read_frfs(path)
    assert got.kind == "accelerance"
    np.testing.assert_allclose(got.data[:, :, 0], H, rtol=1e-6)


def test_lines_without_any_value_are_left_out_and_others_refused(
    tmp_path: Path,
) -> None:
    gap = H.copy()
    gap[3] = np.nan
    got = read_frfs(
        write(tmp_path / "h.csv", "Frequency;$ real;$ imag", gap.real, gap.imag)
    )
    np.testing.assert_allclose(got.freqs, np.delete(F, 3))
    gap[5, 1] = np.nan
    with pytest.raises(
        DataError, match=r"3 values are not finite, the first of 2\+Z/in1 at 6.5 Hz"
    ):
        read_frfs(
            write(tmp_path / "h.csv", "Frequency;$ real;$ imag", gap.real, gap.imag)
        )
    with pytest.raises(DataError, match="the same part"):
        read_frfs(write(tmp_path / "h.csv", "Frequency;real;imag", H.real, H.imag))


@pytest.mark.parametrize("unit", ["", " [dB]", " [m/s^2/N]"])
def test_what_no_unit_tells_is_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, unit: str
) -> None:
    head = f"f [Hz];$ magnitude{unit};$ phase [deg]"
    read_frfs(
        write(
            tmp_path / "f.csv", head, LEVEL if "dB" in unit else SIZE, np.degrees(ANGLE)
        )
    )
    assert ("quantity of the responses is unknown" in caplog.text) == (
        "m/s" not in unit
    )
