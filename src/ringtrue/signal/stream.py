"""Records larger than the memory: filters and decimation from block to block, with nothing lost at
the joints.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from ringtrue.core.arrays import Any_, Float
from ringtrue.core.signals import TimeHistory
from ringtrue.errors import ConfigError, DataError

_STOP = 90.0  # dB


@dataclass(frozen=True, slots=True, eq=False)
class Fir:
    """A symmetric filter and the samples that it is decimated by; its delay is taken out.

    Attributes
    ----------
    taps : (2 k + 1,) float64
    factor : int
    """

    taps: Float
    factor: int = 1

    def __post_init__(self) -> None:
        if (
            self.taps.size % 2 == 0
            or self.factor < 1
            or np.abs(self.taps - self.taps[::-1]).max() > 1e-12
        ):
            raise ConfigError(
                f"{self.taps.size} taps and factor {self.factor}: odd, symmetric and 1 or more "
                "are needed"
            )


def decimator(factor: int) -> Fir:
    """Flat to 0.4 of the new rate, 90 dB down from 0.5 of it."""
    if factor < 2:
        raise ConfigError(f"decimation by {factor}: must be 2 or more")
    return Fir(_low_pass(0.4 / factor, 0.5 / factor), factor)


def high_passer(corner: float, rate: float) -> Fir:
    """Gain 1 from `corner` Hz, 90 dB down below half of it."""
    if not 0 < corner < rate / 4:
        raise ConfigError(
            f"high-pass at {corner} Hz: must be > 0 and below a quarter of the rate {rate} Hz"
        )
    taps = -_low_pass(0.5 * corner / rate, corner / rate)
    taps[taps.size // 2] += 1.0
    return Fir(taps)


def _low_pass(start: float, stop: float) -> Float:
    """Taps of a low-pass with its edge from `start` to `stop`, in cycles per sample."""
    from scipy.signal import firwin, kaiserord  # slow to import, and few commands need it

    count, beta = kaiserord(_STOP, 2 * (stop - start))
    taps = firwin(count | 1, start + stop, window=("kaiser", beta), scale=True)
    return np.asarray(taps, dtype=np.float64)


def filtered(blocks: Iterable[TimeHistory], fir: Fir) -> Iterator[TimeHistory]:
    """The filtered record, block by block, as if it were filtered whole with zeros around it.

    Parameters
    ----------
    blocks : iterable of TimeHistory
        The parts of one record, one after the other, of any length: `io.records.record_blocks`.
    fir : Fir

    Yields
    ------
    TimeHistory
        float64. Together they have a sample for each `factor` samples of the record, the first for
        the first.

    Raises
    ------
    DataError
        If the blocks have different channels or rates.
    """
    half = fir.taps.size // 2
    last: TimeHistory | None = None
    held: Any_ = np.zeros((0, 0))
    begin = 0  # sample of the record at which `held` begins
    wanted = 0  # next sample of the record to give out
    for block in blocks:
        if last is None:
            held, begin = np.zeros((len(block.channels), half)), -half
        elif block.channels != last.channels or block.rate != last.rate:
            raise DataError(
                f"{block.source}: a block has other channels or another rate than the one before"
            )
        last = block
        held = np.concatenate([held, block.data], axis=1)
        part, wanted = _given(held, begin, wanted, fir)
        keep = max(wanted - half - begin, 0)
        held, begin = held[:, keep:], begin + keep
        if part.shape[1]:
            yield replace(block, data=part, rate=block.rate / fir.factor)
    if last is not None:
        part, _ = _given(
            np.concatenate([held, np.zeros((held.shape[0], half))], axis=1), begin, wanted, fir
        )
        if part.shape[1]:
            yield replace(last, data=part, rate=last.rate / fir.factor)


def _given(held: Any_, begin: int, wanted: int, fir: Fir) -> tuple[Float, int]:
    """The outputs whose inputs are all there, and the next sample of the record to give out."""
    from scipy.signal import oaconvolve  # slow to import, and few commands need it

    half = fir.taps.size // 2
    end = begin + held.shape[1] - half  # outputs before this one are complete
    if end <= wanted:
        return np.zeros((held.shape[0], 0)), wanted
    start = wanted - half - begin
    whole = oaconvolve(held[:, start:], fir.taps[None], mode="valid", axes=1)
    part = np.ascontiguousarray(whole[:, : end - wanted : fir.factor])
    return part, wanted + part.shape[1] * fir.factor
