"""Files as measuring systems and MATLAB toolboxes write them, by their structure."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from nptdms import ChannelObject, RootObject, TdmsWriter
from scipy.io import savemat

from ringtrue.io.frfs import holds_frfs, read_frfs
from ringtrue.io.records import read_record
from ringtrue.io.times import to_si

# (channel, sample), at 256 Hz
SIGNAL = np.random.default_rng(7).standard_normal((3, 500))
TIMES = np.arange(500) / 256


@pytest.mark.parametrize("name", ["one", "each", "headers"])
def test_matlab_structures_of_measuring_systems(tmp_path: Path, name: str) -> None:
    """Testlab's signals with x_values and y_values, all in one or one each; catman's data beside
    headers.
    """
    x = {"start_value": 0.0, "increment": 1 / 256, "quantity": {"label": "s"}}

    def signal(values: np.ndarray, names: object) -> dict[str, object]:
        return {
            "x_values": x,
            "y_values": {"values": values, "quantity": {"label": "g"}},
            "function_record": {"name": names},
        }

    titles = ["a", "b", "c"]
    content = {
        "one": {"Signal": signal(SIGNAL.T, np.array(titles, dtype=object))},
        "each": {
            f"Signal_{k}": signal(SIGNAL[k][:, None], t) for k, t in enumerate(titles)
        },
        "headers": {f"Ch_{k}_Data": SIGNAL[k][:, None] for k in range(3)}
        | {
            f"Ch_{k}_Header": {"SignalName": t, "Unit": "g", "SampleFrequency": 256.0}
            for k, t in enumerate(titles)
        },
    }[name]
    savemat(tmp_path / "r.mat", content)
    got = read_record(tmp_path / "r.mat")
    assert (got.rate, [c.id for c in got.channels], got.channels[2].unit) == (
        pytest.approx(256),
        titles,
        "m/s^2",
    )
    np.testing.assert_allclose(got.data, 9.80665 * SIGNAL)


@pytest.mark.parametrize("name", ["f-out-in", "out-in-f", "omega", "h5"])
def test_frfs_as_arrays_beside_frequencies(tmp_path: Path, name: str) -> None:
    rng, f = np.random.default_rng(0), np.arange(1, 41) * 0.5
    h = rng.standard_normal((40, 3, 2)) + 1j * rng.standard_normal((40, 3, 2))
    content = {
        "f-out-in": {
            "freq": f,
            "Mobility": h,
            "outputs": np.array(["1+Z", "2+Z", "3+Z"], dtype=object),
        },
        "out-in-f": {"results": {"frequency": f, "H": h.transpose(1, 2, 0)}},
        "omega": {"omega": 2 * np.pi * f, "H": h[:, :, 0]},
        "h5": {"f": f, "frf": h},
    }[name]
    path = tmp_path / ("r.h5" if name == "h5" else "r.mat")
    if name == "h5":
        with h5py.File(path, "w") as file:
            file["f"], file["frf"] = f, h
    else:
        savemat(path, content)
    assert holds_frfs(path)
    got = read_frfs(path)
    np.testing.assert_allclose(got.data, h[:, :, :1] if name == "omega" else h)
    np.testing.assert_allclose(got.freqs, f)
    assert got.kind == ("mobility" if name == "f-out-in" else "accelerance")
    ids = [c.id for c in got.outputs], [c.id for c in got.inputs]
    assert name != "f-out-in" or ids == (["1+Z", "2+Z", "3+Z"], ["in1", "in2"])


def test_names_in_cells_of_matlab_7_3(tmp_path: Path) -> None:
    path = tmp_path / "r.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["data"], file["fs"] = SIGNAL, np.array([[256.0]])
        texts = [
            file.create_dataset(
                f"#refs#/{t}", data=np.array([[ord(t)]], dtype=np.uint16)
            )
            for t in "abc"
        ]
        for t in texts:
            t.attrs["MATLAB_class"] = np.bytes_("char")
        file.create_dataset(
            "channels", data=np.array([[t.ref for t in texts]], dtype=h5py.ref_dtype)
        )
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    got = read_record(path)
    assert [c.id for c in got.channels] == ["a", "b", "c"]
    np.testing.assert_allclose(got.data, SIGNAL)


def test_empty_rows_of_a_spreadsheet_end_a_csv(tmp_path: Path) -> None:
    rows = "\n".join(
        ";".join(f"{v:.9g}".replace(".", ",") for v in r)
        for r in np.vstack([TIMES, SIGNAL]).T
    )
    (tmp_path / "r.csv").write_text(f"Time;a;b;c\n{rows}\n;;;\n")
    np.testing.assert_allclose(
        read_record(tmp_path / "r.csv").data, SIGNAL, rtol=1e-6, atol=1e-8
    )


def _csv(columns: np.ndarray) -> str:
    return "\n".join(",".join(f"{v:.9g}" for v in r) for r in columns.T) + "\n"


@pytest.mark.parametrize(
    ("name", "text"),
    [
        (
            "index and time, as pandas writes them",
            ",time,a,b,c\n" + _csv(np.vstack([np.arange(500), TIMES, SIGNAL])),
        ),
        (
            "names in a comment, as NumPy writes them",
            "# t,a,b,c\n" + _csv(np.vstack([TIMES, SIGNAL])),
        ),
        ("a comment of MATLAB", "% fs: 256\na,b,c\n" + _csv(SIGNAL)),
        (
            "a column of words",
            "t,a,b,c,state\n" + _csv(np.vstack([TIMES, SIGNAL])).replace("\n", ",OK\n"),
        ),
    ],
)
def test_text_of_programs(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / "r.csv").write_text(text)
    got = read_record(tmp_path / "r.csv")
    assert ([c.id for c in got.channels], got.rate) == (
        ["a", "b", "c"],
        pytest.approx(256),
    )
    np.testing.assert_allclose(got.data, SIGNAL, rtol=1e-8)


@pytest.mark.parametrize("form", ["v5", "v7.3"])
def test_arrays_of_structures_in_matlab_files(tmp_path: Path, form: str) -> None:
    path = tmp_path / "r.mat"
    if form == "v5":
        rows = [(x[:, None], t, 1 / 256) for x, t in zip(SIGNAL, "abc", strict=True)]
        savemat(
            path,
            {"ch": np.array(rows, dtype=[("data", "O"), ("name", "O"), ("dt", "O")])},
        )
    else:
        with h5py.File(path, "w", userblock_size=512) as file:
            data = [
                file.create_dataset(f"#refs#/{i}", data=x[None])
                for i, x in enumerate(SIGNAL)
            ]
            texts = [
                file.create_dataset(
                    f"#refs#/{t}", data=np.array([[ord(t)]], dtype=np.uint16)
                )
                for t in "abc"
            ]
            for t in texts:
                t.attrs["MATLAB_class"] = np.bytes_("char")
            for field, cells in (("data", data), ("name", texts)):
                file.create_dataset(
                    f"ch/{field}",
                    data=np.array([[c.ref for c in cells]], dtype=h5py.ref_dtype),
                )
            file["Sampling_Frequency_Hz"] = np.array([[256.0]])
        with path.open("r+b") as raw:
            raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    got = read_record(path)
    assert ([c.id for c in got.channels], got.rate) == (["a", "b", "c"], 256.0)
    np.testing.assert_allclose(got.data, SIGNAL)


def test_the_rate_of_a_tdms_may_stand_at_its_root(tmp_path: Path) -> None:
    with TdmsWriter(tmp_path / "r.tdms") as file:
        root = RootObject(properties={"SampleRate": 256.0})
        file.write_segment(
            [
                root,
                *(ChannelObject("g", t, x) for t, x in zip("abc", SIGNAL, strict=True)),
            ]
        )
    assert read_record(tmp_path / "r.tdms").rate == 256.0


def test_a_step_of_three_digits_in_lvm_gives_way_to_its_column_of_times(
    tmp_path: Path,
) -> None:
    """LabVIEW writes 1/4096 s as 0.000244, which is 4098.4 Hz."""
    head = [
        "LabVIEW Measurement",
        "Separator\tTab",
        "Decimal_Separator\t.",
        "X_Columns\tOne",
        "***End_of_Header***",
        "",
    ]
    head += [
        "Channels\t1",
        "Samples\t500",
        "X0\t0.0",
        "Delta_X\t0.000244",
        "***End_of_Header***",
        "X_Value\ta\tComment",
    ]
    rows = [f"{k / 4096:.6f}\t{x:.6f}" for k, x in enumerate(SIGNAL[0])]
    (tmp_path / "r.lvm").write_text("\n".join([*head, *rows]) + "\n")
    assert read_record(tmp_path / "r.lvm").rate == pytest.approx(4096, rel=1e-5)


@pytest.mark.parametrize(
    ("unit", "factor", "quantity"),
    [("µm/m", 1e-6, "strain"), ("µε", 1e-6, "strain"), ("m/s/s", 1.0, "acceleration"), ("mm/sec", 1e-3, "velocity"),
     ("deg/s", np.pi / 180, "angular velocity"), ("rad/s²", 1.0, "angular acceleration"), ("Nm", 1.0, "moment"),
     ("N m", 1.0, "moment"), ("N-m", 1.0, "moment"), ("kNm", 1e3, "moment"), ("NM", 1.0, "moment"),
     ("ft-lb", 4.4482216152605 * 12 * 0.0254, "moment"), ("lbf in", 4.4482216152605 * 0.0254, "moment"),
     ("nm", 1e-9, "displacement"), ("N·mm", 1e-3, "moment"), ("mrad", 1e-3, "rotation")],
)  # fmt: skip
def test_units_as_laboratories_write_them(
    unit: str, factor: float, quantity: str
) -> None:
    assert to_si(unit)[:2] == (quantity, factor)
