"""Corners of the sensors of a record, by the data sheets of the crew's log."""

from __future__ import annotations

import numpy as np

from ringtrue.core.signals import Channel, TimeHistory
from ringtrue.signal.spectra import Geophone
from ringtrue.study.log import SensorType
from ringtrue.study.stages.identify import corrected

RATE, LINES = 64.0, 2**15
SHEETS = {
    "4.5 Hz": SensorType(quantity="velocity", corner_hz=4.5, damping=0.6),
    "2 Hz": SensorType(quantity="velocity", corner_hz=2.0, damping=0.7),
    "ICP": SensorType(quantity="acceleration", corner_hz=0.5),
}


def test_each_geophone_is_corrected_by_its_own_sheet_and_no_other_sensor() -> None:
    rng = np.random.default_rng(3)
    motion = np.fft.rfft(rng.standard_normal(LINES))
    freqs = np.fft.rfftfreq(LINES, 1 / RATE)
    sensors = ("4.5 Hz", "ICP", "2 Hz")
    response = [
        Geophone(4.5, 0.6).response(freqs),
        np.ones(freqs.size),
        Geophone(2.0, 0.7).response(freqs),
    ]
    data = np.array([np.fft.irfft(motion * h) for h in response])
    units = {"velocity": "m/s", "acceleration": "m/s^2"}
    channels = tuple(
        Channel(f"{k}+Z", SHEETS[s].quantity, units[SHEETS[s].quantity], s)  # type: ignore[arg-type]
        for k, s in enumerate(sensors)
    )
    history = TimeHistory(data, RATE, channels)
    found, low, note = corrected(history, SHEETS)
    assert low == 0.6 * 4.5
    assert note == "2 and 4.5 Hz corner corrected from 2.70 Hz on"
    assert found.channels == channels
    np.testing.assert_array_equal(found.data[1], data[1])
    inside = (freqs > 1.1 * low) & (freqs < 0.4 * RATE)
    for k in (0, 2):
        spectrum = np.fft.rfft(found.data[k])[inside]
        assert np.linalg.norm(spectrum - motion[inside]) < 0.02 * np.linalg.norm(
            motion[inside]
        )
    again, low, note = corrected(history.pick(["1+Z"]), SHEETS)
    assert (again.channels, low, note) == (channels[1:2], 0.0, "")
