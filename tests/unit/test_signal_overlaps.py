"""Files of one record that overlap: what both hold counts once, and nothing else is lost."""

import numpy as np
import pytest

from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.signal.channel_checks import remove_overlap

RATE = 10.0
WHOLE = np.round(
    3 * np.random.default_rng(3).standard_normal((2, 4000))
)  # coarse: many samples begin alike


def part(first: int, last: int, lost: int | None = None) -> TimeHistory:
    data = WHOLE[:, first:last].copy()
    if lost is not None:
        data[1, lost] = np.nan
    channels = tuple(Channel(x, "acceleration", "m/s^2") for x in ("1+Z", "2+Z"))
    return TimeHistory(data, RATE, channels, f"here/{first}.csv")


@pytest.mark.parametrize(
    ("before", "later", "twice"),
    [
        ((0, 2000), (2000, 4000), 0),
        ((0, 2000), (1500, 4000), 500),
        ((0, 2000), (0, 2000), 2000),
        ((0, 2000), (500, 900), 400),
    ],
)
def test_samples_of_two_files_count_once(before, later, twice):
    kept, said = remove_overlap(part(*before), part(*later))
    assert np.array_equal(kept.data, WHOLE[:, later[0] + twice : later[1]])
    assert said == (
        f"its first {twice / RATE:.4g} s are in {before[0]}.csv too: they count once"
        if twice
        else ""
    )


def test_missing_samples_hide_no_overlap():
    kept, _ = remove_overlap(part(0, 2000, lost=1700), part(1500, 4000, lost=200))
    assert kept.data.shape[1] == 2000


def test_the_first_file_and_records_of_nothing_stay():
    silent = TimeHistory(np.zeros((2, 500)), RATE, part(0, 9).channels)
    assert remove_overlap(None, part(0, 900))[0].data.shape[1] == 900
    assert remove_overlap(silent, silent) == (silent, "")
