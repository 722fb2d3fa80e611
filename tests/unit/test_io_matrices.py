"""Readers of matrices: every format gives back the same matrix; broken files say so."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy import io as scipy_io
from scipy import sparse

from ringtrue.errors import DataError
from ringtrue.io.matrices import read_matrices

A = np.array(
    [[4.0, -1.5, 0, 0], [-1.5, 3.25, 0, 1e-3], [0, 0, 7.0, 0], [0, 1e-3, 0, -2.5e10]]
)
SPARSE = sparse.csr_array(A)


def _same(path: Path, name: str, want: np.ndarray = A) -> None:
    got = read_matrices(path)[name]
    assert got.shape == want.shape
    assert np.allclose(got.toarray(), want, rtol=1e-12, atol=0)


def test_matlab_5(tmp_path: Path) -> None:
    path = tmp_path / "k.mat"
    scipy_io.savemat(path, {"K": sparse.csc_matrix(A), "M": A, "dofs": [1, 2, 5]})
    _same(path, "K")
    _same(path, "M")
    assert read_matrices(path).arrays["dofs"].ravel().tolist() == [1, 2, 5]


def test_matlab_73_and_hdf5(tmp_path: Path) -> None:
    c = sparse.csc_array(A + np.triu(A, 1))
    for path in (tmp_path / "k.mat", tmp_path / "k.h5"):
        with h5py.File(
            path, "w", userblock_size=512 if path.suffix == ".mat" else 0
        ) as f:
            g = f.create_group("K")
            g.attrs["MATLAB_sparse"] = np.uint64(4)
            g["data"], g["ir"], g["jc"] = (
                c.data,
                c.indices.astype("u8"),
                c.indptr.astype("u8"),
            )
            s = f.create_group("S")
            s.attrs["shape"] = (4, 4)
            s["data"], s["indices"], s["indptr"] = (
                SPARSE.data,
                SPARSE.indices,
                SPARSE.indptr,
            )
            f["dense"] = c.toarray().T if path.suffix == ".mat" else c.toarray()
            f["list"] = np.arange(3.0)
        if path.suffix == ".mat":
            with path.open("r+b") as block:
                block.write(b"MATLAB 7.3 MAT-file")
        _same(path, "K", c.toarray())
        _same(path, "S")
        _same(path, "dense", c.toarray())
        assert set(read_matrices(path).arrays) == {"list"}


def test_matrix_market_and_npz(tmp_path: Path) -> None:
    scipy_io.mmwrite(
        tmp_path / "k.mtx", sparse.coo_array(A), symmetry="symmetric", precision=16
    )
    sparse.save_npz(tmp_path / "k.npz", SPARSE)
    _same(tmp_path / "k.mtx", "k")
    _same(tmp_path / "k.npz", "k")


def test_abaqus(tmp_path: Path) -> None:
    lower = np.argwhere(np.tril(A))
    names = [(10, 1), (10, 6), (12, 2), (900, 3)]
    five = "".join(
        f"{names[i][0]},{names[i][1]}, {names[j][0]},{names[j][1]}, {A[i, j]:.15e}\n"
        for i, j in lower.tolist()
    )
    (tmp_path / "job_STIF1.mtx").write_text(five)
    _same(tmp_path / "job_STIF1.mtx", "job_STIF1")
    dofs = read_matrices(tmp_path / "job_STIF1.mtx").dofs
    assert dofs is not None
    assert dofs.labels() == ("10+X", "10+RZ", "12+Y", "900+Z")
    every = np.argwhere(A)
    (tmp_path / "c.mtx").write_text(
        "".join(f"{i + 1} {j + 1} {A[i, j]:.15e}\n" for i, j in every.tolist())
    )
    _same(tmp_path / "c.mtx", "c")


def _harwell(kind: str, a: sparse.csc_array) -> str:
    def lines(values: list[str], per: int) -> list[str]:
        return ["".join(values[i : i + per]) for i in range(0, len(values), per)]

    pointers = lines([f"{x + 1:8d}" for x in a.indptr], 10)
    indices = lines([f"{x + 1:8d}" for x in a.indices], 10)
    values = lines([f"{x:25.16E}".replace("E", "D") for x in a.data], 3)
    counts = [len(x) for x in (pointers, indices, values)]
    head = [
        f"{'stiffness':72s}KEY",
        "".join(f"{x:14d}" for x in (sum(counts), *counts, 0)),
        f"{kind:14s}" + "".join(f"{x:14d}" for x in (*a.shape, a.nnz, 0)),
        f"{'(10I8)':16s}{'(10I8)':16s}{'(1P,3D25.16)':20s}{'':20s}",
    ]
    return "\n".join([*head, *pointers, *indices, *values, ""])


def test_harwell_boeing(tmp_path: Path) -> None:
    (tmp_path / "s.hb").write_text(_harwell("RSA", sparse.csc_array(np.tril(A))))
    _same(tmp_path / "s.hb", "s")
    other = A + np.triu(A, 1)
    (tmp_path / "u.rua").write_text(_harwell("RUA", sparse.csc_array(other)))
    _same(tmp_path / "u.rua", "u", other)
    (tmp_path / "e.hb").write_text(_harwell("RSE", sparse.csc_array(A)))
    with pytest.raises(DataError, match="RSE"):
        read_matrices(tmp_path / "e.hb")


def _runs(column: np.ndarray) -> list[tuple[int, np.ndarray]]:
    at = np.flatnonzero(column)
    parts = np.split(at, np.flatnonzero(np.diff(at) > 1) + 1)
    return [(int(p[0]) + 1, column[p]) for p in parts if p.size]


def _op4_ascii(dense: bool, big: bool) -> str:
    lines = [f"{4:8d}{-4 if big else 4:8d}{6:8d}{2:8d}{'KAA':8s}1P,3E23.16"]
    for j in range(4):
        runs = _runs(A[:, j])
        if dense:
            first, last = runs[0][0], runs[-1][0] + runs[-1][1].size
            runs = [(first, A[first - 1 : last - 1, j])]
            lines.append(f"{j + 1:8d}{first:8d}{runs[0][1].size:8d}")
        else:
            words = sum(2 * v.size + (2 if big else 1) for _, v in runs)
            lines.append(f"{j + 1:8d}{0:8d}{words:8d}")
        for row, v in runs:
            if not dense:
                length = 2 * v.size + 1
                lines.append(
                    f"{length:8d}{row:8d}" if big else f"{row + (length << 16):12d}"
                )
            text = [f"{x:23.16E}" for x in v]
            lines += ["".join(text[i : i + 3]) for i in range(0, len(text), 3)]
    return "\n".join([*lines, f"{5:8d}{1:8d}{1:8d}", f"{1.0:23.16E}", ""])


def _op4_binary(dense: bool, big: bool, order: str, single: bool) -> bytes:
    kind, number, per = (1, f"{order}f4", 1) if single else (2, f"{order}f8", 2)

    def record(*parts: bytes) -> bytes:
        body = b"".join(parts)
        mark = np.array([len(body)], f"{order}i4").tobytes()
        return mark + body + mark

    def ints(*values: int) -> bytes:
        return np.array(values, f"{order}i4").tobytes()

    out = [record(ints(4, -4 if big else 4, 6, kind), b"KAA     ")]
    for j in range(4):
        runs = _runs(A[:, j])
        if dense:
            first, last = runs[0][0], runs[-1][0] + runs[-1][1].size
            v = A[first - 1 : last - 1, j]
            out.append(
                record(ints(j + 1, first, per * v.size), v.astype(number).tobytes())
            )
            continue
        body, words = b"", 0
        for row, v in runs:
            length = per * v.size + 1
            body += ints(length, row) if big else ints(row + (length << 16))
            body += v.astype(number).tobytes()
            words += per * v.size + (2 if big else 1)
        out.append(record(ints(j + 1, 0, words), body))
    return b"".join([*out, record(ints(5, 1, per), np.ones(1, number).tobytes())])


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("dense", [False, True])
def test_output4(tmp_path: Path, dense: bool, big: bool) -> None:
    path = tmp_path / "k.op4"
    path.write_text(_op4_ascii(dense, big) * 2)  # the second KAA follows at once
    _same(path, "KAA")
    for order in "<>":
        path.write_bytes(_op4_binary(dense, big, order, False))
        _same(path, "KAA")
    path.write_bytes(_op4_binary(dense, big, "<", True))
    # single precision
    assert np.allclose(read_matrices(path)["KAA"].toarray(), A, rtol=1e-7)


ROWS = 10_000_005  # more than fit into eight characters beside a sign


@pytest.mark.parametrize("big", [False, True])
def test_output4_of_ten_million_rows(tmp_path: Path, big: bool) -> None:
    """The head has numbers of sixteen characters; row numbers stand side by side with others."""
    value = f"{-2.5:23.16E}{3.5:23.16E}"
    row = ROWS - 1
    rows = -ROWS if big else ROWS
    lines = [f"{2:16d}{rows:16d}{2:8d}{2:8d}{'WIDE':8s}1P,3E23.16|I16"]
    if big:
        lines += [f"{2:8d}{0:8d}{6:8d}", f"{5:8d}{row:8d}", value]
    else:
        lines += [f"{2:8d}{row:8d}{2:8d}", value]
    (tmp_path / "k.op4").write_text(
        "\n".join([*lines, f"{3:8d}{1:8d}{1:8d}", " 1.0", ""])
    )
    found = read_matrices(tmp_path / "k.op4")["WIDE"]
    assert found.shape == (ROWS, 2)
    assert [found[row - 1, 1], found[row, 1], found.nnz] == [-2.5, 3.5, 2]


@pytest.mark.parametrize("order", "<>")
def test_output4_of_words_of_eight_bytes(tmp_path: Path, order: str) -> None:
    """Four characters of the name stand in each word."""

    def record(*parts: bytes) -> bytes:
        body = b"".join(parts)
        mark = np.array([len(body)], f"{order}i4").tobytes()
        return mark + body + mark

    def ints(*values: int) -> bytes:
        return np.array(values, f"{order}i8").tobytes()

    def reals(*values: float) -> bytes:
        return np.array(values, f"{order}f8").tobytes()

    records = [
        record(ints(1, 3, 2, 2), b"SE_S    TART    "),
        record(ints(1, 2, 2), reals(5, 6)),
    ]
    records.append(record(ints(2, 1, 1), reals(1)))
    (tmp_path / "k.op4").write_bytes(b"".join(records))
    found = read_matrices(tmp_path / "k.op4")
    assert found["SE_START"].toarray().ravel().tolist() == [0, 5, 6]


def test_broken_files(tmp_path: Path) -> None:
    for name, content in (
        ("k.op4", _op4_binary(False, False, "<", False)[:-40]),
        ("k.hb", b"nothing\nhere\n"),
        ("k.mtx", b"1 2\n"),
        (
            "k.mat",
            b"not a file of that kind at all, but long enough to be looked at" * 4,
        ),
        ("k.xyz", b"1 2 3\x00"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(DataError, match=name.replace(".", r"\.")):
            read_matrices(tmp_path / name)
    with pytest.raises(DataError, match="no such file"):
        read_matrices(tmp_path / "absent.mat")


def test_matrices_in_a_structure(tmp_path: Path) -> None:
    scipy_io.savemat(
        tmp_path / "m.mat", {"model": {"K": SPARSE, "part": {"M": A}, "name": "x"}}
    )
    _same(tmp_path / "m.mat", "model.K")
    _same(tmp_path / "m.mat", "model.part.M")
    scipy_io.savemat(tmp_path / "none.mat", {"text": "x"})
    with pytest.raises(DataError, match="no matrix in it"):
        read_matrices(tmp_path / "none.mat")


def test_formats_without_a_count(tmp_path: Path) -> None:
    one_a_line = _harwell("RUA", sparse.csc_array(A)).splitlines()[:3]
    a = sparse.csc_array(A)
    numbers = [f"{x + 1:14d}" for x in (*a.indptr, *a.indices)] + [
        f"{x:25.18E}" for x in a.data
    ]
    text = "\n".join(
        [*one_a_line, f"{'(I14)':16s}{'(1I14)':16s}{'(E25.18)':20s}", *numbers, ""]
    )
    (tmp_path / "a.matrix").write_text(text)
    _same(tmp_path / "a.matrix", "a")


def test_a_mass_without_its_massless_rows(tmp_path: Path) -> None:
    (tmp_path / "k.mtx").write_text("1,1,1,1,2.\n2,1,1,1,-1.\n2,1,2,1,1.\n")
    (tmp_path / "m.mtx").write_text("2,1,2,1,5.\n")
    k, m = read_matrices(tmp_path / "k.mtx"), read_matrices(tmp_path / "m.mtx")
    assert k.dofs is not None
    np.testing.assert_array_equal(m.over(k.dofs).toarray(), [[0, 0], [0, 5]])
    assert m.over(3).shape == (3, 3)
    assert m.dofs is not None
    with pytest.raises(DataError, match="1 of its 2 rows are not among the 1"):
        k.over(m.dofs)
