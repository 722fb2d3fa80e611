"""Records: the own layout, foreign formats, and every refusal."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat

from ringtrue.errors import DataError
from ringtrue.io.record_table import RecordChannel
from ringtrue.io.records import read_record, record_blocks, record_info, write_record

DATA = Path(__file__).parents[2].parent / "shared/data"
data_here = pytest.mark.skipif(not DATA.is_dir(), reason=f"no reference data at {DATA}")
T = np.arange(200) / 100.0
VOLTS = np.stack([np.sin(7 * T), np.cos(9 * T)])
CHANNELS = (
    RecordChannel("1+Z", 1, "acceleration", "g", 0.1, 5.0, "A 12", "2026-03-01"),
    RecordChannel("F:1+Z", 1, "force", "N", -0.002, 10.0),
)


def test_own_layout(tmp_path: Path) -> None:
    path = tmp_path / "r.h5"
    write_record(
        path, (VOLTS[:, a : a + 64] for a in range(0, 200, 64)), 100.0, CHANNELS
    )
    info = record_info(path)
    assert info.channels == CHANNELS
    assert info.samples == 200
    assert info.full_scale()["1+Z"] == pytest.approx(5 / 0.1 * 9.80665)
    record = read_record(path)
    np.testing.assert_allclose(
        record.data[0], VOLTS[0] / 0.1 * 9.80665, rtol=1e-5, atol=1e-4
    )
    np.testing.assert_allclose(record.data[1], VOLTS[1] / -0.002, rtol=1e-5, atol=1e-2)
    assert [c.unit for c in record.channels] == ["m/s^2", "N"]
    some = read_record(path, channels=["F:1+Z", "1+Z"], start=10, stop=60)
    np.testing.assert_array_equal(some.data, record.data[::-1, 10:60])
    np.testing.assert_array_equal(
        np.hstack([b.data for b in record_blocks(path, 77)]), record.data
    )


def as_npy(path: Path) -> Path:
    np.save(path.with_suffix(".npy"), VOLTS.T)
    return path.with_suffix(".npy")


def as_mat(path: Path) -> Path:
    savemat(path.with_suffix(".mat"), {"y": VOLTS.T, "fs": 100.0, "note": "x"})
    return path.with_suffix(".mat")


def as_mat73(path: Path) -> Path:
    with h5py.File(path.with_suffix(".mat"), "w") as file:
        file["y"], file["fs"] = VOLTS, np.array([[100.0]])
    return path.with_suffix(".mat")


def as_h5(path: Path) -> Path:
    with h5py.File(path.with_suffix(".h5"), "w") as file:
        file["some/name"] = VOLTS.T
        file["some/name"].attrs["fs"] = 100.0
    return path.with_suffix(".h5")


def as_csv(path: Path) -> Path:
    rows = "\n".join(
        f"{t:.4f};{a:.9f};{b:.9f}".replace(".", ",")
        for t, a, b in zip(T, *VOLTS, strict=True)
    )
    path.with_suffix(".csv").write_text("time;1+Z [m/s^2];F [N]\n" + rows)
    return path.with_suffix(".csv")


@pytest.mark.parametrize("write", [as_npy, as_mat, as_mat73, as_h5, as_csv])
def test_foreign_formats(tmp_path: Path, write: Callable[[Path], Path]) -> None:
    record = read_record(write(tmp_path / "r"), 100.0)
    np.testing.assert_allclose(record.data, VOLTS, atol=1e-8)
    assert record.rate == pytest.approx(100.0)


def test_csv_header_gives_names_and_units(tmp_path: Path) -> None:
    record = read_record(as_csv(tmp_path / "r"))
    assert [(c.id, c.quantity) for c in record.channels] == [
        ("1+Z", "acceleration"),
        ("F", "force"),
    ]


@pytest.mark.parametrize(
    ("array", "rate", "words"),
    [
        (np.zeros((0, 2)), 100.0, "empty"),
        (np.where(T[:, None] == 1.0, np.nan, VOLTS.T), 100.0, "NaN"),
        (np.ones((200, 1)), 100.0, "constant"),
        (VOLTS.T, None, "no sampling rate"),
        (VOLTS.T, -5.0, "must be positive"),
        (VOLTS.T, float("nan"), "must be positive"),
        (np.array([["a", "b"]]), 100.0, "real"),
    ],
    ids=["empty", "nan", "constant", "no rate", "negative rate", "nan rate", "text"],
)
def test_refuses_bad_arrays(
    tmp_path: Path, array: np.ndarray, rate: float | None, words: str
) -> None:
    np.save(tmp_path / "r.npy", array)
    with pytest.raises(DataError, match=words):
        read_record(tmp_path / "r.npy", rate)


def test_missing_rows_and_samples_are_told_with_what_to_do(tmp_path: Path) -> None:
    rows = [f"{i / 100:.2f},{np.sin(i):.5f},{np.cos(i):.5f}" for i in range(2000)]
    head = "Time [s],a,b"
    path = tmp_path / "r.csv"
    path.write_text("\n".join([head, *rows[:400], *rows[650:900], *rows[903:]]))
    with pytest.raises(
        DataError,
        match=r"samples are missing: 2.51 s behind row 400, 0.04 s behind row 650, where",
    ):
        read_record(path)
    whole = read_record(path, gaps=True)
    there = np.r_[0:400, 650:900, 903:2000]
    assert (whole.rate, whole.data.shape) == (100.0, (2, 2000))
    assert np.array_equal(np.flatnonzero(np.isfinite(whole.data).all(axis=0)), there)
    assert whole.data[0, there] == pytest.approx(np.sin(there), abs=1e-5)
    path.write_text("\n".join([head, *rows[:7], "0.07,,1.0", *rows[8:]]))
    with pytest.raises(DataError, match=r"in a \(1\) of 2000 samples each; leave"):
        read_record(path)
    assert np.isnan(read_record(path, gaps=True).data).sum() == 1


@pytest.mark.parametrize(
    "form",
    [
        "clock",
        "array",
        "mat",
        "mat named",
        "hdf5",
        "hdf5 named",
        "vectors named",
        "tdms",
    ],
)
def test_rows_that_a_logger_dropped_have_their_place_on_the_grid(
    tmp_path: Path, form: str
) -> None:
    k = np.r_[0:3000, 6400:9000, 9001:10000]
    if form == "clock":
        start = np.datetime64("2026-03-01T23:59:00.000")
        stamps = [
            str(start + np.timedelta64(int(i * 8), "ms")).replace("T", " ") for i in k
        ]
        rows = [
            f"{s};{np.sin(i):.5f};{np.cos(i):.5f}"
            for s, i in zip(stamps, k, strict=True)
        ]
        path = tmp_path / "r.csv"
        path.write_text("\n".join(["Timestamp;a;b", *rows]))
    elif form.startswith("mat"):
        path = tmp_path / "r.mat"
        named = {"fs": 125.0} if "named" in form else {}
        savemat(
            path,
            {"t": k / 125.0, "y": np.stack([np.sin(k), np.cos(k)], axis=1), **named},
        )
    elif form.startswith(("hdf5", "vectors")):
        path = tmp_path / "r.h5"
        with h5py.File(path, "w") as file:
            file["time"] = k / 125.0
            file.update(
                {"a": np.sin(k), "b": np.cos(k)}
                if "vec" in form
                else {"y": np.stack([np.sin(k), np.cos(k)])}
            )
            file.attrs.update({"rate": 125.0} if "named" in form else {})
    elif form == "tdms":
        path = tmp_path / "r.tdms"
        with TdmsWriter(path) as writer:
            signals = {"Time": k / 125.0, "a": np.sin(k), "b": np.cos(k)}
            step = {"wf_increment": 1 / 125.0}
            writer.write_segment(
                [ChannelObject("g", n, x, step) for n, x in signals.items()]
            )
    else:
        path = tmp_path / "r.npy"
        np.save(path, np.stack([k / 125.0, np.sin(k), np.cos(k)], axis=1))
    h = read_record(path, gaps=True)
    assert h.rate == pytest.approx(125.0)
    assert np.array_equal(np.flatnonzero(np.isfinite(h.data).all(axis=0)), k)
    with pytest.raises(
        DataError, match=r"samples are missing: 27.2\d* s behind row 3000"
    ):
        read_record(path)


def test_times_in_other_units_leave_a_named_rate_alone(tmp_path: Path) -> None:
    k = np.r_[0:3000, 6400:9000]
    for t in (
        k / 125.0 / 86400,
        np.sort(np.random.default_rng(0).uniform(0, 50, k.size)),
    ):  # days, times of arrival
        savemat(
            tmp_path / "r.mat",
            {"fs": 125.0, "t": t, "y": np.stack([np.sin(k), np.cos(k)], axis=1)},
        )
        assert read_record(tmp_path / "r.mat", gaps=True).data.shape == (2, k.size)


def test_a_record_that_is_mostly_missing_is_refused(tmp_path: Path) -> None:
    k = np.r_[0:300, 5000:5300]
    path = tmp_path / "r.csv"
    path.write_text(
        "\n".join(["Time [s],a", *(f"{i / 100:.2f},{np.sin(i):.5f}" for i in k)])
    )
    with pytest.raises(DataError, match="samples are missing"):
        read_record(path, gaps=True)


@pytest.mark.parametrize("samples", [500, 4321, 8192])
def test_times_with_few_decimals_have_the_rate_of_the_recorder(
    tmp_path: Path, samples: int
) -> None:
    rows = [f"{i / 1024:.6f},{np.sin(i):.5f}" for i in range(samples)]
    (tmp_path / "r.csv").write_text("\n".join(["Time [s],a", *rows]))
    assert read_record(tmp_path / "r.csv").rate == 1024.0
    rows = [f"{i / 1023.9:.9f},{np.sin(i):.5f}" for i in range(samples)]
    (tmp_path / "r.csv").write_text("\n".join(["Time [s],a", *rows]))
    assert read_record(tmp_path / "r.csv").rate == pytest.approx(1023.9, rel=1e-9)


def test_refuses_rates_that_disagree(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="time column"):
        read_record(as_csv(tmp_path / "r"), 128.0)
    write_record(tmp_path / "r.h5", VOLTS, 100.0, CHANNELS)
    with pytest.raises(DataError, match="128 Hz was given"):
        read_record(tmp_path / "r.h5", 128.0)
    with h5py.File(tmp_path / "r.h5", "a") as file:
        file["record"].attrs["rate"] = 0.0
    with pytest.raises(DataError, match="attribute rate"):
        read_record(tmp_path / "r.h5")
    (tmp_path / "u.csv").write_text("time,a\n0,1\n1,2\n2.3,0\n5,0\n6,3\n")
    with pytest.raises(DataError, match="uneven"):
        read_record(tmp_path / "u.csv")


def test_refuses_what_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no such file"):
        read_record(tmp_path / "no.h5")
    (tmp_path / "r.xyz").write_bytes(b"1\x00")
    with pytest.raises(
        DataError, match="no binary format that is known; looked for: a Nastran"
    ):
        read_record(tmp_path / "r.xyz")
    (tmp_path / "r.h5").write_bytes(b"\x89HDF\r\n\x1a\n")
    with pytest.raises(DataError, match="not a readable HDF5"):
        read_record(tmp_path / "r.h5")
    with pytest.raises(DataError, match="did you mean 'acceleration'"):
        RecordChannel("a", quantity="aceleration")  # type: ignore[arg-type]


@data_here
def test_real_files() -> None:
    lvm = read_record(DATA / "ema/image_beam/acceleration.lvm")
    assert lvm.rate == pytest.approx(50e3)
    # N, as printed in the file
    assert lvm.data[1].max() == pytest.approx(195.605522, rel=1e-6)
    assert lvm.data[0, 0] == pytest.approx(-0.007387 * 9.80665, rel=1e-6)
    text, binary = (
        read_record(DATA / f"uff/Sample_UFF58{x}.uff") for x in ("_ascii", "b_bin")
    )
    np.testing.assert_allclose(text.data, binary.data, rtol=1e-5, atol=1e-5)
    assert read_record(DATA / "uff/BK_4_channels.uff").data.shape == (4, 288768)
