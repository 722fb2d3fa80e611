"""Array types and the one way to freeze an array."""

from __future__ import annotations

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
