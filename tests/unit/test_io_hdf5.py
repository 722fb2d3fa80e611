"""The codec: save ∘ load is the identity on what ringtrue stores, and nothing else is loaded."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy import sparse

from ringtrue.core.dofs import DofSet
from ringtrue.core.iterate import Outcome
from ringtrue.core.modes import ModeSet, Norm
from ringtrue.core.parameters import CardField, Parameter, ParameterSet
from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.core.testmodel import Observation
from ringtrue.errors import DataError
from ringtrue.io import hdf5
from ringtrue.io.files import atomic_write


def through(tmp_path: Path, obj: object) -> Any:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        hdf5.save(file.create_group("x"), obj)
    with h5py.File(tmp_path / "a.h5", "r") as file:
        return hdf5.load(file["x"])


def test_plain_values(tmp_path: Path) -> None:
    value = {
        "none": None,
        "tuple": (1, 2.5, "é", True, (3,)),
        "list": [1, [2]],
        "complex": 1 - 2j,
        "inf": float("-inf"),
        "enum": (Norm.MASS, Outcome.STALLED),
        5: {"deep": CardField("MAT1", 7, "E")},
        "numpy": np.float64(3.5),
    }
    got = through(tmp_path, value)
    assert got == value
    assert isinstance(got["list"], list)
    assert got["enum"][0] is Norm.MASS
    assert np.isnan(through(tmp_path, float("nan")))


@pytest.mark.parametrize(
    "array",
    [
        np.arange(6).reshape(2, 3),
        np.array([1 + 2j, np.nan]),
        np.array([True, False]),
        np.zeros((0, 4), dtype=np.float32),
        np.array(["a", "öß"]),
    ],
    ids=str,
)
def test_arrays(tmp_path: Path, array: np.ndarray[Any, Any]) -> None:
    got = through(tmp_path, (array, "beside it"))[0]
    np.testing.assert_array_equal(got, array)
    assert got.dtype == array.dtype


def test_dataclasses_with_arrays_inside_containers(tmp_path: Path) -> None:
    channels = (Channel("1+Z", "acceleration", "m/s^2"), Channel("F:1+Z", "force", "N"))
    record = TimeHistory(np.arange(8.0).reshape(2, 4), 100.0, channels, "r")
    modes = ModeSet(
        np.array([1.0]),
        np.array([0.01]),
        np.ones((2, 1)),
        DofSet.parse(["1+X", "2-RY"]),
        Norm.MASS,
    )
    got = through(tmp_path, {"records": (record, record), "modes": modes})
    assert got["records"][1].channels == channels
    assert got["modes"].labels.labels() == ("1+X", "2-RY")
    assert got["modes"].norm is Norm.MASS
    np.testing.assert_array_equal(got["records"][0].data, record.data)


def test_sparse_and_parameters(tmp_path: Path) -> None:
    matrix = sparse.csr_array(np.array([[0.0, 2.0], [0.0, 0.0]]))
    got = through(tmp_path, matrix)
    assert type(got) is type(matrix)
    np.testing.assert_array_equal(got.toarray(), matrix.toarray())
    one = ParameterSet((Parameter("k", (CardField("PBUSH", 1, "K3"),), upper=2.0),))
    assert through(tmp_path, one) == one
    assert Observation.__module__.startswith("ringtrue.")


def test_refuses_foreign_classes_and_filled_groups(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        with pytest.raises(DataError, match="cannot be stored"):
            hdf5.save(file.create_group("path"), Path("x"))
        group = file.create_group("x")
        hdf5.save(group, Channel("a"))
        with pytest.raises(DataError, match="not empty"):
            hdf5.save(group, 1)
        group.attrs["class"] = "subprocess:Popen"
        with pytest.raises(DataError, match="not a class of ringtrue"):
            hdf5.load(group)
        group.attrs["class"] = "ringtrue.core.signals:TimeHistory"
        with pytest.raises(DataError, match="another version"):
            hdf5.load(group)
        with pytest.raises(DataError, match="not an object stored"):
            hdf5.load(file.create_group("empty"))


def write_half(target: Path) -> None:
    with atomic_write(target) as part:
        part.write_text("half")
        raise ZeroDivisionError


def test_atomic_write_keeps_the_old_file_on_an_error(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")
    with pytest.raises(ZeroDivisionError):
        write_half(target)
    assert target.read_text() == "old"
    with atomic_write(target) as part:
        part.write_text("new")
    assert target.read_text() == "new"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]
