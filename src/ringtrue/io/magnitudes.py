"""Numbers of test files that no product of a few of them leaves within the range of doubles."""

from __future__ import annotations

import numpy as np

from ringtrue.core.arrays import Any_
from ringtrue.errors import DataError

LARGEST = 1e50  # of any unit: MAC has products of four, updating of six, which stay below 1.8e308


def refuse_large(values: Any_, what: str) -> None:
    """Refuse numbers above `LARGEST` in size; what is not a number passes.

    Parameters
    ----------
    values : (...) float64 or complex128
    what : str
        Names the numbers in the error.

    Raises
    ------
    DataError
    """
    size = np.abs(np.nan_to_num(values, nan=0.0, posinf=np.inf, neginf=-np.inf))
    if size.size and size.max() > LARGEST:
        raise DataError(
            f"{what}: {size.max():.3g} is no measured value; allowed are up to {LARGEST:g} in size"
        )
