"""Records of other programs: WAV, TDMS, LabVIEW, MATLAB, CSV of instruments; every reader takes
damage with a message.

The true samples are made here or written by another library (scipy, nptdms, h5py), and read back.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from nptdms import ChannelObject, TdmsWriter
from record_files import write_history
from scipy.io import savemat, wavfile

from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.errors import DataError
from ringtrue.identification.frf.data_checks import frf_notes
from ringtrue.io.frfs import holds_frfs, read_frfs
from ringtrue.io.matrices import read_matrices
from ringtrue.io.record_arrays import mat_values
from ringtrue.io.record_texts import read_lvm_segments
from ringtrue.io.records import read_record
from ringtrue.io.uff.points import read_shapes

DATA = Path(__file__).parents[2].parent / "shared/data"
data_here = pytest.mark.skipif(not DATA.is_dir(), reason=f"no reference data at {DATA}")
RATE = 200.0
T = np.arange(300) / RATE
Y = np.stack([0.4 * np.sin(7 * T), 0.5 * np.cos(9 * T)])


def history() -> TimeHistory:
    channels = (Channel("1+Z", "acceleration", "m/s^2"), Channel("7-X", "force", "N"))
    return TimeHistory(Y, RATE, channels, "made")


@pytest.mark.parametrize("kind", [np.uint8, np.int16, np.int32, np.float32, np.float64])
def test_wav_written_by_scipy(tmp_path: Path, kind: type) -> None:
    y = Y.T
    if np.issubdtype(kind, np.integer):
        bits = np.dtype(kind).itemsize * 8
        y = np.round(y * 2 ** (bits - 1)) + (128 if bits == 8 else 0)
    wavfile.write(tmp_path / "r.wav", 200, y.astype(kind))
    tolerance = (
        1e-6
        if np.issubdtype(kind, np.floating)
        else 0.51 / 2 ** (np.dtype(kind).itemsize * 8 - 1)
    )
    got = read_record(tmp_path / "r.wav")
    np.testing.assert_allclose(got.data, Y, atol=tolerance)
    assert got.rate == 200.0


def test_wav_of_24_bits_with_an_odd_chunk(tmp_path: Path) -> None:
    whole = np.ascontiguousarray(np.round(Y.T * 2**23), dtype="<i4")
    body = whole.view(np.uint8).reshape(-1, 4)[:, :3].tobytes()
    form = struct.pack("<HHIIHH", 1, 2, 200, 1200, 6, 24)
    chunks = (
        b"fmt "
        + struct.pack("<I", 16)
        + form
        + b"note"
        + struct.pack("<I", 3)
        + b"abc\0"
    )
    (tmp_path / "r.wav").write_bytes(
        b"RIFF\0\0\0\0WAVE" + chunks + b"data" + struct.pack("<I", len(body)) + body
    )
    np.testing.assert_allclose(
        read_record(tmp_path / "r.wav").data, Y, atol=0.51 / 2**23
    )


def as_tdms(path: Path, step: float = 1 / RATE, other: float = 1 / RATE) -> Path:
    with TdmsWriter(path) as file:
        for half in (slice(0, 100), slice(100, None)):  # two segments
            one = ChannelObject(
                "g", "1+Z", Y[0, half], {"wf_increment": step, "unit_string": "m/s^2"}
            )
            two = ChannelObject(
                "g",
                "7-X",
                Y[1, half],
                {"wf_increment": other, "unit_string": "furlong"},
            )
            file.write_segment([one, two])
    return path


def test_tdms_written_by_nptdms(tmp_path: Path) -> None:
    got = read_record(as_tdms(tmp_path / "r.tdms"))
    np.testing.assert_array_equal(got.data, Y)
    assert got.rate == pytest.approx(RATE)
    assert [(c.id, c.unit) for c in got.channels] == [("1+Z", "m/s^2"), ("7-X", "")]
    with pytest.raises(DataError, match="split"):
        read_record(as_tdms(tmp_path / "two.tdms", other=1 / 100))


def lvm(
    columns: str = "No", segments: int = 1, gap: float = 0.0, comma: bool = True
) -> str:
    head = f"LabVIEW Measurement\t\nSeparator\tTab\nDecimal_Separator\t{',' if comma else '.'}\nX_Columns\t{columns}\n"
    text = head + "***End_of_Header***\t\n\t\n"
    for k in range(segments):
        part = slice(k * 300 // segments, (k + 1) * 300 // segments)
        start = part.start / RATE + (gap if k else 0.0)
        rows = [
            {"No": f"\t{a:.9f}\t{b:.9f}", "One": f"{t:.6f}\t{a:.9f}\t{b:.9f}"}.get(
                columns, f"{t:.6f}\t{a:.9f}\t{t:.6f}\t{b:.9f}"
            )
            for t, a, b in zip(T[part], *Y[:, part], strict=True)
        ]
        names = (
            "X_Value\tacc\tX_Value\tforce"
            if columns == "Multi"
            else "X_Value\tacc\tforce"
        )
        special = (
            "***Start_of_Special***\nChannels\t77\n***End_of_Special***\n" if k else ""
        )
        next_ = "\t\t" if columns == "Multi" else "\t"
        text += (
            special
            + f"Channels\t2\nSamples\t300{next_}300\nTime\t10:00:{start:09.6f}\n"
        )
        text += f"Y_Unit_Label\tg{next_}Newtons\nX0\t0.0{next_}0.0\nDelta_X\t{1 / RATE:.6f}{next_}{1 / RATE:.6f}\n"
        text += f"***End_of_Header***\t\n{names}\tComment\n"
        text += "\n".join(rows) + "\n\n"
    return text.replace(".", ",") if comma else text


@pytest.mark.parametrize("columns", ["No", "One", "Multi"])
@pytest.mark.parametrize("comma", [True, False])
def test_lvm_with_its_columns_of_time(
    tmp_path: Path, columns: str, comma: bool
) -> None:
    (tmp_path / "r.lvm").write_text(lvm(columns, comma=comma))
    got = read_record(tmp_path / "r.lvm")
    np.testing.assert_allclose(got.data, Y * [[9.80665], [1.0]], atol=1e-8)
    assert got.rate == pytest.approx(RATE)
    assert [c.id for c in got.channels] == ["acc", "force"]


def test_lvm_segments_are_joined_only_without_a_gap(tmp_path: Path) -> None:
    (tmp_path / "r.lvm").write_text(lvm("One", segments=3))
    np.testing.assert_allclose(
        read_record(tmp_path / "r.lvm").data, Y * [[9.80665], [1.0]], atol=1e-8
    )
    (tmp_path / "gap.lvm").write_text(lvm("One", segments=3, gap=0.2))
    with pytest.raises(DataError, match="3 segments"):
        read_record(tmp_path / "gap.lvm")
    starts = [s for s, _ in read_lvm_segments(tmp_path / "gap.lvm")]
    np.testing.assert_allclose(np.diff(starts), [0.7, 0.5], atol=1e-6)


def test_matlab_structures_and_names(tmp_path: Path) -> None:
    cells = np.array(["a", "b"], dtype=object)
    savemat(
        tmp_path / "r.mat",
        {
            "rec": {
                "y": Y.T,
                "fs": RATE,
                "names": cells,
                "units": np.array(["g", "V"], object),
            }
        },
    )
    got = read_record(tmp_path / "r.mat")
    assert got.rate == RATE
    assert [(c.id, c.unit) for c in got.channels] == [("a", "m/s^2"), ("b", "V")]
    np.testing.assert_allclose(got.data[0], Y[0] * 9.80665)


@pytest.mark.parametrize("form", ["4", "5"])
@pytest.mark.parametrize("compressed", [True, False])
@pytest.mark.parametrize("kind", [np.float64, np.float32, np.int16, np.uint8])
def test_matlab_types_written_by_scipy(
    tmp_path: Path, form: str, compressed: bool, kind: type
) -> None:
    y = np.arange(40).reshape(20, 2).astype(kind)
    savemat(
        tmp_path / "r.mat",
        {"a": 1.0, "y": y, "text": "abc"},
        format=form,
        do_compression=compressed,
    )
    np.testing.assert_array_equal(read_record(tmp_path / "r.mat", RATE).data, y.T)


def test_matlab_variables_of_every_class(tmp_path: Path) -> None:
    cells = np.array([1.5, "two", np.eye(2)], dtype=object)
    content = {
        "c": cells,
        "s": {"t": {"u": 3.0}, "z": 1 + 2j},
        "text": "long text",
        "b": np.array([[True, False]]),
    }
    savemat(tmp_path / "r.mat", content)
    found = mat_values(tmp_path / "r.mat")
    assert found["text"] == "long text"
    assert found["s.t.u"].item() == 3.0
    assert found["s.z"].item() == 1 + 2j
    assert found["c"].ravel()[1] == "two"
    np.testing.assert_array_equal(found["c"].ravel()[2], np.eye(2))
    np.testing.assert_array_equal(found["b"], [[1, 0]])


def test_text_of_instruments(tmp_path: Path) -> None:
    (tmp_path / "r.csv").write_bytes(
        "zeit;Kraft [N];Weg [µm]\n0,0;1,5;2,0\n0,1;1,6;2,5\n0,2;1,2;3,5\n".encode(
            "latin-1"
        )
    )
    got = read_record(tmp_path / "r.csv")
    np.testing.assert_allclose(got.data, [[1.5, 1.6, 1.2], [2e-6, 2.5e-6, 3.5e-6]])
    (tmp_path / "u.csv").write_text("time,a\n0,1\n1,2\n2,0\n", encoding="utf-16")
    assert read_record(tmp_path / "u.csv").rate == 1.0


def test_faulty_channels_stay_on_request(tmp_path: Path) -> None:
    np.save(tmp_path / "r.npy", np.stack([Y[0], np.full(300, 2.0)], axis=1))
    with pytest.raises(DataError, match="constant"):
        read_record(tmp_path / "r.npy", RATE)
    assert read_record(tmp_path / "r.npy", RATE, check=False).data.shape == (2, 300)


def test_hdf5_that_announces_more_than_it_holds(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "r.h5", "w") as file:
        file.create_dataset("y", (8, 1 << 40), np.float64, chunks=(1, 4096))
    with pytest.raises(DataError, match="announces"):
        read_record(tmp_path / "r.h5", RATE)


def test_hdf5_is_measured_by_its_numbers_in_memory(tmp_path: Path) -> None:
    """67 million one-byte values in 1,400 bytes of a file: 2 GB as a sparse matrix."""
    with h5py.File(tmp_path / "k.h5", "w") as file:
        file.create_dataset("K", (8191, 8191), np.int8, chunks=(64, 64), fillvalue=1)
    with pytest.raises(DataError, match="announces"):
        read_matrices(tmp_path / "k.h5")


def samples(path: Path) -> dict[str, bytes]:
    """A small intact file of every format."""
    np.save(path / "a.npy", Y.T)
    wavfile.write(path / "a.wav", 200, (Y.T * 2**15).astype(np.int16))
    as_tdms(path / "a.tdms")
    (path / "a.lvm").write_text(lvm("One"))
    savemat(path / "a.mat", {"y": Y.T, "fs": RATE}, do_compression=True)
    for ext in (".csv", ".uff", ".h5"):
        write_history(path / f"a{ext}", history())
    return {
        x: (path / f"a{x}").read_bytes()
        for x in (".npy", ".wav", ".tdms", ".lvm", ".mat", ".csv", ".uff", ".h5")
    }


def takes(call: Callable[[], object]) -> None:
    """Either a result or a message for the user: nothing else."""
    try:
        call()
    except DataError:
        return


# NumPy's, on absurd numbers of damaged files
@pytest.mark.filterwarnings("ignore::Warning")
@pytest.mark.parametrize(
    "ext", [".npy", ".wav", ".tdms", ".lvm", ".mat", ".csv", ".uff", ".h5"]
)
def test_cut_files(tmp_path: Path, ext: str) -> None:
    whole = samples(tmp_path)[ext]
    path = tmp_path / f"cut{ext}"
    for size in np.unique(
        np.r_[0:64:7, np.linspace(0, len(whole) - 1, 60).astype(int)]
    ).tolist():
        path.write_bytes(whole[:size])
        takes(lambda: read_record(path, RATE))


@pytest.mark.filterwarnings("ignore::Warning")
@pytest.mark.parametrize(
    "ext", [".npy", ".wav", ".tdms", ".lvm", ".mat", ".csv", ".uff"]
)
@given(st.integers(0, 2**32 - 1))
@settings(
    max_examples=60,
    deadline=2000,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
def test_damaged_files(tmp_path: Path, ext: str, seed: int) -> None:
    """Bytes overwritten, mostly in the header."""
    kept = tmp_path / f"kept{ext}"
    if not kept.exists():
        kept.write_bytes(samples(tmp_path)[ext])
    raw = bytearray(kept.read_bytes())
    rng = np.random.default_rng(seed)
    for _ in range(rng.integers(1, 6)):
        reach = min(len(raw), 400) if rng.random() < 0.7 else len(raw)
        raw[int(rng.integers(reach))] = int(rng.integers(256))
    path = tmp_path / f"bad{ext}"
    path.write_bytes(bytes(raw))
    takes(lambda: read_record(path, RATE))


@data_here
@pytest.mark.filterwarnings("ignore::Warning")
@pytest.mark.parametrize(
    "name",
    [
        "1858.uff",
        "TestLab 161 164 18 15 82.uff",
        "uff55_translation.uff",
        "2411 and 2414.uff",
    ],
)
def test_damaged_universal_files(tmp_path: Path, name: str) -> None:
    whole = (DATA / "uff" / name).read_bytes()[:60000]
    rng = np.random.default_rng(1)
    path = tmp_path / "bad.uff"
    for _ in range(60):
        raw = bytearray(
            whole[: int(rng.integers(len(whole)))] if rng.random() < 0.5 else whole
        )
        for at in rng.integers(0, max(len(raw), 1), 5).tolist():
            if raw:
                raw[at] = int(rng.integers(32, 127))
        path.write_bytes(bytes(raw))
        for read in (read_shapes, read_frfs):
            takes(lambda read=read: read(path))


def test_frfs_with_gaps_are_told(tmp_path: Path) -> None:
    freqs = np.arange(1, 101) * 0.5
    h = np.ones((1, 2, 100)) + 0j
    keep = np.r_[0:40, 55:100]
    np.savez(tmp_path / "gap.npz", freq=freqs[keep], H1=h[:, :, keep])
    told = frf_notes(read_frfs(tmp_path / "gap.npz"), ())
    assert any(
        "uneven lines: spacing 0.5 to 8 Hz, widest between 20 and 28 Hz" in x
        for x in told
    )
    h[0, 1, 30:33] = np.nan
    np.savez(tmp_path / "nan.npz", freq=freqs, H1=h)
    with pytest.raises(DataError, match="3 values are not finite"):
        read_frfs(tmp_path / "nan.npz")


@pytest.mark.filterwarnings("ignore::Warning")
@pytest.mark.parametrize("form", ["4", "5"])
def test_damaged_matlab_files_do_not_end_the_process(tmp_path: Path, form: str) -> None:
    """Not compressed, so that the damage reaches the elements: scipy 1.17 dies of some of these in
    its v5 reader.
    """
    content = {"y": Y.T[:40], "fs": RATE} | (
        {"s": {"n": "text"}} if form == "5" else {}
    )
    savemat(tmp_path / "a.mat", content, format=form)
    whole = (tmp_path / "a.mat").read_bytes()
    rng = np.random.default_rng(4)
    for _ in range(300):
        raw = bytearray(whole)
        for at in rng.integers(0, min(len(raw), 500), 4).tolist():
            raw[at] = int(rng.integers(256))
        (tmp_path / "bad.mat").write_bytes(bytes(raw))
        takes(lambda: read_record(tmp_path / "bad.mat", RATE))


@pytest.mark.filterwarnings("ignore::Warning")
def test_damaged_archives_of_frfs(tmp_path: Path) -> None:
    np.savez_compressed(
        tmp_path / "a.npz", freq=np.arange(1, 65) * 0.5, H1=np.ones((1, 2, 64)) + 0j
    )
    whole = (tmp_path / "a.npz").read_bytes()
    rng = np.random.default_rng(3)
    for _ in range(150):
        raw = bytearray(
            whole[: int(rng.integers(len(whole)))] if rng.random() < 0.3 else whole
        )
        for at in rng.integers(0, max(len(raw), 1), 3).tolist():
            if raw:
                raw[at] = int(rng.integers(256))
        (tmp_path / "bad.npz").write_bytes(bytes(raw))
        takes(lambda: read_frfs(tmp_path / "bad.npz"))


# (channel, sample), at 256 Hz
SIGNAL = np.random.default_rng(7).standard_normal((3, 500))
TIMES = np.arange(500) / 256


def _is_the_signal(got):
    assert [c.id for c in got.channels] == ["a", "b", "c"]
    assert got.rate == pytest.approx(256, rel=1e-3)
    np.testing.assert_allclose(got.data, SIGNAL, rtol=1e-8)


def _rows(times, delimiter=",", ending=""):
    cells = (
        [t, *(f"{v:.9e}" for v in row)] for t, row in zip(times, SIGNAL.T, strict=True)
    )
    return "".join(delimiter.join(c) + ending + "\n" for c in cells)


@pytest.mark.parametrize(
    ("head", "body"),
    [
        (
            "Recorder 7\nRate;256\nTime;a;b;c\ns;m/s2;m/s²;m/s^2\n",
            _rows([f"{t:.9f}" for t in TIMES], ";"),
        ),
        ("time;a;b;c;\n", _rows([f"{t:.9f}" for t in TIMES], ";", ";")),
        ("Time (ms),a,b,c\n", _rows([f"{1e3 * t:.6f}" for t in TIMES])),
        (
            "time,a,b,c\n",
            _rows([f"{t:.3f}" for t in TIMES]),
        ),  # milliseconds: uneven by rounding only
        (
            "time (ms),a,b,c\n",
            _rows([f"{1e3 * t:.3g}" for t in TIMES]),
        ),  # 996, 1e+03, 1e+03, 1.01e+03
        (
            "Timestamp,a,b,c\n",
            _rows([str(np.datetime64(round(t * 1e6), "us")) for t in TIMES]),
        ),
        (
            "Timestamp,a,b,c\n",
            _rows(
                [
                    str(np.datetime64(round(t * 1e3), "ms")).replace("T", " ")
                    for t in TIMES
                ]
            ),
        ),
    ],
    ids=[
        "preamble-units",
        "ends-in-delimiter",
        "milliseconds",
        "rounded",
        "three-digits",
        "dates",
        "dates-rounded",
    ],
)
def test_csv_of_loggers(tmp_path, head, body):
    path = tmp_path / "r.csv"
    path.write_text(head + body, encoding="utf-8")
    _is_the_signal(read_record(path))


def test_a_clock_that_goes_back_is_refused(tmp_path):
    rows = _rows(_stamps("%Y-%m-%d %H:%M:%S.")).splitlines()
    path = tmp_path / "r.csv"
    path.write_text("\n".join(["time,a,b,c", *rows[:100], *rows[50:]]))
    with pytest.raises(
        DataError, match=r"goes back by .* behind row 100, 1 times in all"
    ):
        read_record(path)


def test_times_that_jitter_are_stamps_of_even_samples(tmp_path, caplog):
    path, rng = tmp_path / "r.csv", np.random.default_rng(0)
    step = TIMES[1] - TIMES[0]
    stamps = TIMES + 0.3 * step * rng.uniform(-1, 1, TIMES.size)
    path.write_text("time,a,b,c\n" + _rows([f"{t:.9f}" for t in stamps]))
    _is_the_signal(read_record(path))
    assert "jitter by up to 0.32 of a step" in caplog.text
    walk = np.cumsum(
        step * (1 + 0.3 * rng.uniform(-1, 1, TIMES.size))
    )  # sampled when there was time
    path.write_text("time,a,b,c\n" + _rows([f"{t:.9f}" for t in walk]))
    with pytest.raises(DataError, match="uneven steps"):
        read_record(path)


def test_a_dead_first_channel_is_no_time(tmp_path):
    np.save(tmp_path / "r.npy", np.vstack([np.zeros_like(TIMES), SIGNAL]).T)
    with pytest.raises(DataError, match="ch1 is constant"):
        read_record(tmp_path / "r.npy", 256.0)
    assert read_record(tmp_path / "r.npy", 256.0, check=False).data.shape == (
        4,
        TIMES.size,
    )


def test_csv_with_a_short_or_wrong_line_is_refused(tmp_path):
    path = tmp_path / "r.csv"
    for bad in (
        "a,b\n1,2\n3\n4,5\n",
        "a,b\n1,x\n3,4\n",
        ",\n,\n",
        "a;b;c\n1,5;2,5\n1;2;3\n",
    ):
        path.write_text(bad)
        with pytest.raises(DataError):
            read_record(path, 10.0)


def _german(x):
    return f"{x:.9e}".replace(".", ",")


def _stamps(form, ms=True):
    t = [datetime(2024, 5, 1, 11, 59, 59) + timedelta(seconds=float(k)) for k in TIMES]
    return [
        x.strftime(form) + (f"{x.microsecond // 1000:03d}" if ms else "") for x in t
    ]


TOA5 = (
    '"TOA5","CR6","CR6","1234","CPU:x.CR6"\n"TIMESTAMP","RECORD","a","b","c"\n'
    '"TS","RN","m/s^2","m/s^2","m/s^2"\n"","","Smp","Smp","Smp"\n'
)


def _campbell(first: int, last: int) -> list[str]:
    stamps = _stamps("%Y-%m-%d %H:%M:%S.")
    return [
        f'"{stamps[k]}",{77 + k - first},{",".join(map(str, SIGNAL[:, k]))}'
        for k in range(first, last)
    ]


LOGGERS = {
    "german": (
        "Zeit;a [m/s²];b;c\n",
        [
            ";".join([t, *map(_german, y)])
            for t, y in zip(_stamps("%d.%m.%Y %H:%M:%S,"), SIGNAL.T, strict=True)
        ],
    ),
    "date and time apart": (
        "Datum;Uhrzeit;a;b;c\n",
        [
            ";".join([d, t, *map(_german, y)])
            for d, t, y in zip(
                _stamps("%d.%m.%Y", False), _stamps("%H:%M:%S,"), SIGNAL.T, strict=True
            )
        ],
    ),
    "american": (
        "Time,a,b,c\n",
        [
            ",".join([t, *map(str, y)])
            for t, y in zip(_stamps("%m/%d/%Y %H:%M:%S."), SIGNAL.T, strict=True)
        ],
    ),
    "quoted": (
        '"time","a","b","c"\n',
        [
            ",".join(f'"{_german(x)}"' for x in [t, *y])
            for t, y in zip(TIMES, SIGNAL.T, strict=True)
        ],
    ),
    "rate above, counts": (
        "Sampling rate: 256 Hz\nsample;a;b;c\n",
        [";".join([str(k), *map(str, y)]) for k, y in enumerate(SIGNAL.T)],
    ),
    "rate in a comment, words below": (
        "# sampling interval 3.90625 ms\na b c\n",
        [*(" ".join(map(str, y)) for y in SIGNAL.T), "end of data"],
    ),
    "milliseconds since 1970": (
        "timestamp,a,b,c\n",
        [
            ",".join([f"{1.7145648e12 + 1e3 * t:.3f}", *map(str, y)])
            for t, y in zip(TIMES, SIGNAL.T, strict=True)
        ],
    ),
    "Campbell TOA5, started anew": (
        TOA5,
        [
            *_campbell(0, 200),
            *TOA5.splitlines(),
            *_campbell(200, 500),
            '"2024-05-01 12:0',
        ],
    ),
    "days of a spreadsheet": (
        "Time,a,b,c\n",
        [
            ",".join([f"{45381.5 + t / 86400:.10f}", *map(str, y)])
            for t, y in zip(TIMES, SIGNAL.T, strict=True)
        ],
    ),
    "a time for each, D": (
        "X1;a;X2;b;X3;c\n",
        [
            ";".join(f"{t:.9e};{x:.9e}" for x in y).replace("e", "D")
            for t, y in zip(TIMES, SIGNAL.T, strict=True)
        ],
    ),
    "an empty first column": (
        "fs,256\nChannel,a,b,c\nUnit,m/s^2,m/s^2,m/s^2\n",
        [",".join(["", *map(str, y)]) for y in SIGNAL.T],
    ),
}


LACKING = ["NA", "#N/A", "OVERFLOW", "--", "null", '"NAN"', "####", ""]


@pytest.mark.parametrize(
    ("word", "d"),
    [*((w, ",") for w in LACKING), *((w, ";") for w in LACKING), ("OVL", " ")],
)
def test_words_for_values_that_are_lacking(tmp_path, word, d):
    """They are not numbers, in any column but that of times, also in the first row; a column of
    words is left out.
    """
    cells = [
        [f"{t:.8f}", *map(str, y), "OK" if k % 7 else "ERR"]
        for k, (t, y) in enumerate(zip(T, Y.T, strict=True))
    ]
    for row, column in ((0, 1), (50, 2), (51, 2), (52, 1), (52, 2)):
        cells[row][column] = word
    path = tmp_path / "r.csv"
    path.write_text("\n".join(d.join(x) for x in [["time", "a", "b", "state"], *cells]))
    got = read_record(path, gaps=True)
    lost = np.zeros(Y.shape, dtype=bool)
    lost[0, [0, 52]] = lost[1, [50, 51, 52]] = True
    assert [c.id for c in got.channels] == ["a", "b"]
    np.testing.assert_array_equal(np.isnan(got.data), lost)
    np.testing.assert_array_equal(got.data[~lost], Y[~lost])


@pytest.mark.parametrize("name", LOGGERS)
def test_csv_as_loggers_write_it(tmp_path, name):
    head, rows = LOGGERS[name]
    path = tmp_path / "r.csv"
    path.write_text(head + "\n".join(rows), encoding="utf-8")
    _is_the_signal(read_record(path))


def test_times_too_coarse_for_a_rate_want_one(tmp_path):
    path = tmp_path / "r.csv"
    rows = [
        ";".join([t, *map(str, y)])
        for t, y in zip(_stamps("%d.%m.%Y %H:%M:%S", False), SIGNAL.T, strict=True)
    ]
    path.write_text("Zeit;a;b;c (left)\n" + "\n".join(rows), encoding="utf-8")
    with pytest.raises(DataError, match="give it in Hz"):
        read_record(path)
    got = read_record(path, 256.0)
    assert [c.id for c in got.channels] == ["a", "b", "c (left)"]
    np.testing.assert_allclose(got.data, SIGNAL)


@pytest.mark.parametrize(
    "name", ["vectors", "time", "days", "column", "column-and-rate"]
)
def test_matlab_files_of_others(tmp_path, name):
    vectors = {"acc1": SIGNAL[0], "acc2": SIGNAL[1], "acc3": SIGNAL[2]}
    columns = np.vstack([TIMES, SIGNAL]).T
    content = {
        "vectors": {"t": TIMES, **vectors},
        "time": {"x": SIGNAL.T, "time": TIMES[:, None]},
        "days": {"x": SIGNAL.T, "time": 739341.5 + TIMES / 86400},
        "column": {"x": columns},
        "column-and-rate": {"x": columns, "Fs": 256.0},
    }[name]
    savemat(tmp_path / "r.mat", content)
    got = read_record(tmp_path / "r.mat")
    assert got.rate == pytest.approx(256)
    np.testing.assert_allclose(got.data, SIGNAL)
    if name == "vectors":
        assert [c.id for c in got.channels] == list(vectors)


def test_times_beside_or_within_an_array(tmp_path):
    np.save(tmp_path / "r.npy", np.vstack([TIMES, SIGNAL]).T)
    with h5py.File(tmp_path / "r.h5", "w") as file:
        file["acc"], file["time"] = SIGNAL.T, TIMES
    for name in ("r.npy", "r.h5"):
        got = read_record(tmp_path / name)
        assert got.rate == pytest.approx(256)
        np.testing.assert_allclose(got.data, SIGNAL)


def test_a_vector_a_channel_in_hdf5_and_tdms(tmp_path):
    with h5py.File(tmp_path / "r.h5", "w") as file:
        file["time"] = TIMES
        for name, y in zip("abc", SIGNAL, strict=True):
            file[name] = y
    with TdmsWriter(str(tmp_path / "r.tdms")) as file:
        file.write_segment(
            [
                ChannelObject("g", n, y)
                for n, y in zip(["Time", *"abc"], [TIMES, *SIGNAL], strict=True)
            ]
        )
    savemat(
        tmp_path / "r.mat",
        {"Data1_time_a": TIMES, **dict(zip("abc", SIGNAL, strict=True))},
    )
    for ending in ("h5", "tdms", "mat"):
        got = read_record(tmp_path / f"r.{ending}")
        assert [c.id for c in got.channels] == ["a", "b", "c"]
        assert got.rate == pytest.approx(256)
        np.testing.assert_allclose(got.data, SIGNAL)


def test_groups_of_other_rates_are_no_one_record(tmp_path):
    path = tmp_path / "runs.h5"
    with h5py.File(path, "w") as file:
        for name, rate in (("one", 512.0), ("two", 256.0)):
            file.create_group(name).attrs["fs"] = rate
            file[name].create_dataset("101+Z", data=SIGNAL[0])
    with pytest.raises(DataError, match="256 to 512 Hz: choose one of the groups"):
        read_record(path)
    assert read_record(path, group="two").rate == 256


@pytest.mark.parametrize(
    "unit",
    ["g", b"g", np.array([b"g"]), "counts of 24 bits"],
    ids=["text", "bytes", "array", "free"],
)
def test_vectors_of_one_group_have_their_own_names_units_and_rate(tmp_path, unit):
    with h5py.File(tmp_path / "r.h5", "w") as file:
        file.create_group("Acquisition").attrs["sample_rate"] = 256.0
        for name, y in zip("abc", SIGNAL, strict=True):
            file[f"Acquisition/{name}"] = y
            file[f"Acquisition/{name}"].attrs["Unit"] = unit
    got = read_record(tmp_path / "r.h5")
    assert [c.id for c in got.channels] == ["a", "b", "c"]
    known = not isinstance(unit, str) or unit == "g"
    assert {c.quantity for c in got.channels} == {
        "acceleration" if known else "unknown"
    }
    np.testing.assert_allclose(got.data, SIGNAL * (9.80665 if known else 1.0))
    with h5py.File(tmp_path / "r.h5", "a") as file:
        file["Wind/a"] = SIGNAL[0]
    assert [c.id for c in read_record(tmp_path / "r.h5").channels][-2:] == [
        "Acquisition.c",
        "Wind.a",
    ]


def test_an_array_of_channels_by_samples(tmp_path):
    np.save(tmp_path / "r.npy", SIGNAL)
    np.testing.assert_array_equal(read_record(tmp_path / "r.npy", 256.0).data, SIGNAL)


def test_lvm_without_headers(tmp_path):
    (tmp_path / "r.lvm").write_text(
        _rows([f"{t:.9e}" for t in TIMES], "\t").replace(".", ",")
    )
    got = read_record(tmp_path / "r.lvm")
    assert got.rate == pytest.approx(256)
    np.testing.assert_allclose(got.data, SIGNAL)


@pytest.mark.parametrize(
    ("delimiter", "cell"),
    [
        (",", "{re:.6f}{im:+.6f}j"),
        (",", "({re:.6f}{im:+.6f}j)"),
        (";", "{re:.6f} {sign} {size:.6f}i"),
        ("\t", "{re:.4e}{im:+.4e}*i"),
        (" ", "({re:.6f}{im:+.6f}j)"),
    ],
)
@pytest.mark.parametrize("comma", [False, True])
def test_complex_cells(tmp_path: Path, delimiter: str, cell: str, comma: bool) -> None:
    """As NumPy, pandas, MATLAB and spreadsheets write complex numbers; decimal commas where these
    do not separate.
    """
    if comma and delimiter in ", ":
        return
    rng = np.random.default_rng(2)
    h, f = (
        rng.standard_normal((6, 2)) + 1j * rng.standard_normal((6, 2)),
        np.arange(1, 7) * 0.5,
    )
    rows = [
        [f"{x:g}"]
        + [
            cell.format(
                re=z.real, im=z.imag, sign="+-"[int(z.imag < 0)], size=abs(z.imag)
            )
            for z in row.tolist()
        ]
        for x, row in zip(f.tolist(), h, strict=True)
    ]
    text = "\n".join(delimiter.join(r) for r in rows)
    head = delimiter.join(["Frequency", "1+Z/3+Z", "2+Z/3+Z"])
    (tmp_path / "h.csv").write_text(
        f"{head}\n{text.replace('.', ',') if comma else text}\n"
    )
    assert holds_frfs(tmp_path / "h.csv")
    got = read_frfs(tmp_path / "h.csv")
    assert ([c.id for c in got.outputs], [c.id for c in got.inputs]) == (
        ["1+Z", "2+Z"],
        ["3+Z"],
    )
    np.testing.assert_allclose(got.freqs, f)
    np.testing.assert_allclose(got.data[:, :, 0], h, atol=1e-3)


@pytest.mark.parametrize("pause", [0.0, 1.0])
def test_hourly_groups_of_tdms_are_one_ambient_record(
    tmp_path: Path, pause: float
) -> None:
    """Groups with the same channels and successive starts; two that ran at the same time are other
    channels.
    """
    path, start = tmp_path / "r.tdms", np.datetime64("2026-03-01T23:59:58.000000", "us")
    with TdmsWriter(path) as writer:
        for k, name in enumerate(("23h", "0h")):
            begin = start + np.timedelta64(round(k * (150 / RATE + pause) * 1e6), "us")
            told = {"wf_increment": 1 / RATE, "wf_start_time": begin}
            part = slice(150 * k, 150 * (k + 1))
            writer.write_segment(
                [
                    ChannelObject(name, c, y[part], told)
                    for c, y in zip("ab", Y, strict=True)
                ]
            )
    got = read_record(path, gaps=True)
    lost = round(pause * RATE)
    assert [c.id for c in got.channels] == ["a", "b"]
    np.testing.assert_array_equal(
        np.delete(got.data, np.s_[150 : 150 + lost], axis=1), Y[:, :300]
    )
    assert np.isnan(got.data).sum() == 2 * lost
    assert len(read_record(path).channels) == 4


def test_segments_of_lvm_with_pauses_are_one_ambient_record(tmp_path: Path) -> None:
    (tmp_path / "r.lvm").write_text(lvm(segments=2, gap=0.5))
    got = read_record(tmp_path / "r.lvm", gaps=True)
    lost = round(0.5 * RATE)
    np.testing.assert_allclose(
        np.delete(got.data, np.s_[150 : 150 + lost], axis=1),
        Y * [[9.80665], [1.0]],
        atol=1e-8,
    )
    assert np.isnan(got.data[:, 150 : 150 + lost]).all()
