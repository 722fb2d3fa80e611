"""Array types and the one way to freeze an array."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]
Int = NDArray[np.int64]
Bool = NDArray[np.bool_]
Any_ = NDArray[Any]


def frozen(a: ArrayLike, dtype: Any = None) -> NDArray[Any]:
    """A read-only view of `a` (a copy only where the type changes); the caller's array stays
    writable.
    """
    view = np.asarray(a, dtype=dtype).view()
    view.flags.writeable = False
    return view


def freeze_fields(obj: object, **dtypes: Any) -> None:
    """Replace the named fields of a frozen dataclass by read-only arrays of the given dtypes (None:
    as is).
    """
    for name, dtype in dtypes.items():
        object.__setattr__(obj, name, frozen(getattr(obj, name), dtype))


DTYPES = {
    "Float": np.float64,
    "Complex": np.complex128,
    "Int": np.int64,
    "Bool": np.bool_,
    "Any_": None,
}


def freeze_arrays(obj: Any) -> None:
    """Make the arrays of a frozen dataclass read-only, of the dtypes that its annotations name."""
    for f in fields(obj):
        if f.type in DTYPES:
            array = frozen(getattr(obj, f.name), DTYPES[f.type])
            object.__setattr__(obj, f.name, array)


class FrozenArrays:
    """The base of frozen dataclasses of which nothing but the arrays needs care."""

    __slots__ = ()

    def __post_init__(self) -> None:
        freeze_arrays(self)
