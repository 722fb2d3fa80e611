"""Any frozen dataclass of ringtrue to an HDF5 group and back; no pickle.

An object becomes a group. Its attribute `kind` is one of `dataclass`, `tuple`, `list`, `dict`,
`sparse`, `value`. Arrays are data sets named after their fields, things that hold arrays are
groups, and all else is one JSON text, the data set `_plain`. A class is stored as `module:name` and
only loaded from `ringtrue.*`. Every data set that is not empty has HDF5's Fletcher-32 checksum.
Text has a fixed length: text of variable length is in a heap of the file that no checksum covers.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterable
from enum import Enum
from importlib import import_module
from typing import Any, cast

import h5py
import numpy as np
from scipy import sparse

from ringtrue.errors import DataError
from ringtrue.io.foreign.parsers import check_compressed, json_value

PLAIN = "_plain"
SCALAR = "scalar"  # marks an array without axes
# bytes from which on an array is compressed: a fifth of noise, most of meshes and tables
LARGE = 1 << 16
_SPARSE = {
    name: getattr(sparse, name)
    for name in ("csr_array", "csc_array", "csr_matrix", "csc_matrix")
}


def save(group: h5py.Group, obj: object) -> None:
    """Write `obj` into an empty group.

    Parameters
    ----------
    group : h5py.Group
        Empty.
    obj : object
        A dataclass, tuple, list, dict, array, sparse matrix, Enum, str, bool, number or None,
        nested at will.

    Raises
    ------
    DataError
        If the group is not empty or something has a type that cannot be stored; its place is named.
    """
    if len(group):
        raise DataError(f"{group.name}: the group is not empty; delete it first")
    kind, parts = _parts(obj, group.name or "/")
    group.attrs["kind"] = np.bytes_(kind)
    if kind == "dataclass":
        group.attrs["class"] = np.bytes_(_class_name(type(obj)))
    plain = {}
    for name, value in parts.items():
        where = f"{group.name}/{name}"
        if isinstance(value, np.ndarray):
            _put_array(group, name, value)
        elif _holds_arrays(value):
            save(group.create_group(name), value)
        else:
            plain[name] = _encode(value, where)
    _put_array(
        group,
        PLAIN,
        np.frombuffer(json.dumps(plain, allow_nan=False).encode(), dtype=np.uint8),
    )


def load(group: h5py.Group) -> Any:
    """Read what `save` wrote.

    Raises
    ------
    DataError
        If the group was not written by `save`, or names a class that is not a dataclass or Enum of
        ringtrue.
    """
    if "kind" not in group.attrs or PLAIN not in group:
        raise DataError(
            f"{group.file.filename}:{group.name}: not an object stored by ringtrue"
        )
    # files of earlier versions have it as a text of variable length
    item = group[PLAIN]
    text = h5py.check_string_dtype(item.dtype)
    plain = str(item.asstr()[()]) if text else bytes(item[()]).decode()
    parts = {k: _decode(v) for k, v in json_value(plain, group.file.filename).items()}
    for name, item in group.items():
        if name != PLAIN:
            parts[name] = (
                load(item) if isinstance(item, h5py.Group) else _get_array(item)
            )
    return _build(text_of(group.attrs["kind"]), parts, group)


def text_of(attribute: Any) -> str:
    """The text of an attribute, of fixed or of variable length."""
    return attribute.decode() if isinstance(attribute, bytes) else str(attribute)


def _fields(obj: object) -> dict[str, Any] | None:
    """What a dataclass is made of; None where it is none."""
    if not dataclasses.is_dataclass(obj) or isinstance(obj, type):
        return None
    return {f.name: getattr(obj, f.name) for f in dataclasses.fields(obj) if f.init}


def _parts(obj: object, where: str) -> tuple[str, dict[str, Any]]:
    if (fields := _fields(obj)) is not None:
        return "dataclass", fields
    if isinstance(obj, tuple | list):
        return "list" if type(obj) is list else "tuple", _numbered(obj)
    if isinstance(obj, dict):
        return "dict", {"keys": tuple(obj), **_numbered(obj.values())}
    if sparse.issparse(obj):
        matrix = cast(Any, obj)
        name = type(obj).__name__
        if name not in _SPARSE:
            raise DataError(
                f"{where}: {name} cannot be stored; allowed are {', '.join(_SPARSE)}"
            )
        shape = tuple(int(n) for n in matrix.shape)
        arrays = {part: getattr(matrix, part) for part in ("data", "indices", "indptr")}
        return "sparse", {"format": name, "shape": shape, **arrays}
    return "value", {"value": obj}


def _numbered(values: Iterable[Any]) -> dict[str, Any]:
    return {str(i): v for i, v in enumerate(values)}


def _build(kind: str, parts: dict[str, Any], group: h5py.Group) -> Any:
    if kind == "dataclass":
        return _make(_class(text_of(group.attrs["class"])), parts)
    if kind in ("tuple", "list"):
        values = [parts[str(i)] for i in range(len(parts))]
        return tuple(values) if kind == "tuple" else values
    if kind == "dict":
        return {k: parts[str(i)] for i, k in enumerate(parts["keys"])}
    if kind == "sparse":
        arrays = (parts["data"], parts["indices"], parts["indptr"])
        check_compressed(parts["format"][:3], *arrays, parts["shape"])
        return _SPARSE[parts["format"]](arrays, shape=parts["shape"])
    if kind == "value":
        return parts["value"]
    raise DataError(f"{group.file.filename}:{group.name}: unknown kind {kind!r}")


# what files of earlier versions call a class and a field
_MOVED = {
    "ringtrue.core.blows:Blows": "ringtrue.core.signals:Impacts",
    "ringtrue.updating.adequacy:Misfit": "ringtrue.updating.validation:Misfit",
}
_RENAMED = {("FrfSet", "blows"): "impacts"}


def _make(cls: type, parts: dict[str, Any]) -> Any:
    parts = {
        _RENAMED.get((cls.__name__, name), name): value for name, value in parts.items()
    }
    fields = {f.name: f for f in dataclasses.fields(cls) if f.init}
    none = dataclasses.MISSING
    for name, f in fields.items():
        if name not in parts and f.default is none and f.default_factory is none:
            raise DataError(
                f"{cls.__name__}: the store lacks {name}: stored by another version?"
            )
    if extra := sorted(set(parts) - set(fields)):
        raise DataError(
            f"{cls.__name__} has no field {', '.join(extra)}: stored by another version?"
        )
    return cls(**parts)


def _put_array(group: h5py.Group, name: str, a: np.ndarray[Any, Any]) -> None:
    if a.dtype.kind in "UO":
        if not all(isinstance(x, str) for x in a.ravel().tolist()):
            raise DataError(
                f"{group.name}/{name}: an array of objects that are not text cannot be stored"
            )
        text = np.char.encode(a.astype(np.str_), "utf-8")
        a = text.astype(h5py.string_dtype("utf-8", max(text.dtype.itemsize, 1)))
    if not a.size:  # a checksum needs an axis and at least one entry
        group.create_dataset(name, data=a)
        return
    packed = (
        {"compression": "gzip", "compression_opts": 1, "shuffle": True}
        if a.nbytes >= LARGE
        else {}
    )
    made = group.create_dataset(name, data=np.atleast_1d(a), fletcher32=True, **packed)
    if not a.ndim:
        made.attrs[SCALAR] = True


def _get_array(item: h5py.Dataset) -> np.ndarray[Any, Any]:
    text = h5py.check_string_dtype(item.dtype)
    a = np.asarray(item.asstr()[()], dtype=np.str_) if text else np.asarray(item[()])
    return a.reshape(()) if SCALAR in item.attrs else a


def _holds_arrays(value: object) -> bool:
    if isinstance(value, np.ndarray) or sparse.issparse(value):
        return True
    if isinstance(value, tuple | list):
        return any(map(_holds_arrays, value))
    parts = value if isinstance(value, dict) else _fields(value) or {}
    return any(map(_holds_arrays, parts.values()))


def _encode(value: object, where: str) -> Any:
    """A JSON form: scalars as they are, a tuple as a list, all else as an object with one `$`
    key.
    """
    if isinstance(value, Enum):
        return {"$enum": [_class_name(type(value)), value.name]}
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, np.generic):
        return _encode(value.item(), where)
    if isinstance(value, int):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else {"$float": repr(value)}
    if isinstance(value, complex):
        return {"$complex": [_encode(value.real, where), _encode(value.imag, where)]}
    if isinstance(value, tuple):
        return [_encode(v, where) for v in value]
    if isinstance(value, list):
        return {"$list": [_encode(v, where) for v in value]}
    if isinstance(value, dict):
        return {
            "$dict": [[_encode(k, where), _encode(v, where)] for k, v in value.items()]
        }
    if (fields := _fields(value)) is not None:
        return {
            "$class": _class_name(type(value)),
            "fields": {k: _encode(v, where) for k, v in fields.items()},
        }
    raise DataError(
        f"{where}: {type(value).__module__}.{type(value).__qualname__} cannot be stored"
    )


def _decode(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(_decode(v) for v in value)
    if not isinstance(value, dict):
        return value
    if "$class" in value:
        return _make(
            _class(value["$class"]), {k: _decode(v) for k, v in value["fields"].items()}
        )
    ((tag, inner),) = value.items()
    if tag == "$enum":
        return _class(inner[0])[inner[1]]
    if tag == "$float":
        return float(inner)
    if tag == "$complex":
        return complex(_decode(inner[0]), _decode(inner[1]))
    if tag == "$list":
        return [_decode(v) for v in inner]
    if tag == "$dict":
        return {_decode(k): _decode(v) for k, v in inner}
    raise DataError(f"unknown tag {tag!r} in a stored object")


def _class_name(cls: type) -> str:
    name = f"{cls.__module__}:{cls.__qualname__}"
    if not name.startswith("ringtrue."):
        raise DataError(f"{name} cannot be stored: only classes of ringtrue can")
    return name


def _class(name: str) -> Any:
    module, _, qualname = _MOVED.get(name, name).partition(":")
    if not module.startswith("ringtrue.") or not qualname.isidentifier():
        raise DataError(f"{name!r} is not a class of ringtrue; nothing else is loaded")
    try:
        cls = getattr(import_module(module), qualname)
    except (ImportError, AttributeError) as exc:
        raise DataError(
            f"the store holds a {name}, which this version does not have"
        ) from exc
    if not (
        isinstance(cls, type)
        and (dataclasses.is_dataclass(cls) or issubclass(cls, Enum))
    ):
        raise DataError(f"{name} is neither a dataclass nor an Enum")
    return cls
