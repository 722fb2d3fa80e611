"""The worked example under several kernels of OpenBLAS and MKL: how far its results agree.

    python bench/kernels.py [--quick | --full]

Kernels round differently: a sum over other blocks has other last digits. What a study concludes
must not hang on them. Runs `ringtrue demo` under each kernel that the processor has and compares
`summary.json` with that under AVX2's. Right is a summary with the same decisions (every text, count
and yes or no: pairs, parameters, reasons) and with frequencies, MAC and factors that agree to what
their conditioning allows: a factor is off by the rounding of a frequency times the condition number
of the updating, so that it is stated as a part of its own standard deviation.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from outcome import Check, Report, arguments, at_most, sized

KERNELS = {  # name: OPENBLAS_CORETYPE, MKL_CBWR, what the processor must have
    "AVX2": ("Haswell", "AVX2", "avx2"),
    "AVX512": ("SkylakeX", "AVX512", "avx512f"),
    "AVX": ("Sandybridge", "COMPATIBLE", "avx"),
}
REFERENCE = "AVX2"
PROCESSOR = Path("/proc/cpuinfo")
COSTS = "timings_s"  # the only part that differs from run to run
TABLES = ("initial", "final", "ambient_vs_hammer")
FREQUENCY_MOST = 1e-6  # of a frequency
MAC_MOST = 1e-3  # points
FACTOR_MOST = 1e-3  # of the factor's standard deviation


def run(seed: int, kernel: str, folder: Path) -> dict[str, Any]:
    """The summary of the worked example under a kernel."""
    blas, mkl, _ = KERNELS[kernel]
    environment = os.environ | {"OPENBLAS_CORETYPE": blas, "MKL_CBWR": mkl}
    command = [
        sys.executable,
        "-m",
        "ringtrue",
        "demo",
        "--seed",
        str(seed),
        "--out",
        str(folder),
    ]
    subprocess.run(command, check=False, stdout=subprocess.DEVNULL, env=environment)
    summary: dict[str, Any] = json.loads(
        (folder / "summary.json").read_text(encoding="utf-8")
    )
    return summary


def decisions(value: Any, place: str = "") -> Iterator[tuple[str, Any]]:
    """Every entry that is no measured number, with its place: texts, counts, yes or no, and how
    many there are.
    """
    if isinstance(value, dict):
        for key, entry in value.items():
            if place or key != COSTS:
                yield from decisions(entry, f"{place}/{key}")
    elif isinstance(value, list):
        yield f"{place}/count", len(value)
        for number, entry in enumerate(value):
            yield from decisions(entry, f"{place}/{number}")
    elif not isinstance(value, float):
        yield place, value


def compared(got: dict[str, Any], reference: dict[str, Any]) -> list[Check]:
    """Decisions, frequencies, MAC and factors of two summaries."""
    ours, theirs = dict(decisions(got)), dict(decisions(reference))
    other = [
        place
        for place in ours.keys() | theirs.keys()
        if ours.get(place) != theirs.get(place)
    ]
    for place in sorted(other):
        print(
            f"  {place}: {ours.get(place)!r}, under {REFERENCE} {theirs.get(place)!r}"
        )
    checks = [at_most("decisions that differ", len(other), 0)]
    if other:  # what is not there cannot be compared
        return checks
    frequency = mac = factor = 0.0
    for table in TABLES:
        for a, b in zip(got[table], reference[table], strict=True):
            for name in ("frequency_test_hz", "frequency_fe_hz"):
                frequency = max(frequency, abs(a[name] / b[name] - 1))
            mac = max(mac, abs(a["mac_percent"] - b["mac_percent"]))
    for a, b in zip(got["parameters"], reference["parameters"], strict=True):
        factor = max(factor, abs(a["updated"] - b["updated"]) / b["std"])
    return [
        *checks,
        at_most("frequencies apart by", frequency, FREQUENCY_MOST),
        at_most("MAC apart by", mac, MAC_MOST, "points"),
        at_most("factors apart by, in their standard deviations", factor, FACTOR_MOST),
    ]


def main() -> None:
    """Run and state."""
    options = arguments(__doc__).parse_args()
    report = Report(options)
    has = PROCESSOR.read_text(encoding="utf-8").split() if PROCESSOR.exists() else []
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(sized(options, 1, 1, 3)):
            reference = run(seed, REFERENCE, Path(folder) / f"{seed}-{REFERENCE}")
            for kernel, (_, _, needs) in KERNELS.items():
                if kernel == REFERENCE:
                    continue
                if needs not in has:
                    report.not_run(
                        f"the kernels of {kernel}", "the processor does not have them"
                    )
                    continue
                got = run(seed, kernel, Path(folder) / f"{seed}-{kernel}")
                what = f"worked example, seed {seed}: kernels of {kernel} beside those of {REFERENCE}"
                report.row(what, {}, compared(got, reference))
    report.end()


if __name__ == "__main__":
    main()
