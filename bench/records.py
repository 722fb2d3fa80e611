"""Measured and published records with default settings: what is expected, found, missed and more.

    python bench/records.py [--quick | --full]

A reference mode is found where a natural mode lies within 1.5 % of it; it is missed otherwise.
Natural modes among the references (from 10 % below the lowest to 2 % above the highest) that are
none of them are extra; doubtful ones there are counted beside them. ringtrue takes each file as it
is, with default settings; pyoma-2 has block rows and orders set by hand, channels without motion
taken out, and its own clusters. Times are CPU seconds. The records lie beside the clone; their
README has the sources of the references. `--quick` leaves out the record of 90 minutes.
"""

from __future__ import annotations

import subprocess
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from outcome import (
    ROOT,
    Check,
    Peer,
    Report,
    arguments,
    at_least,
    at_most,
    peer_program,
)

import ringtrue as rt
from ringtrue.core.arrays import Float

DATA = ROOT.parent / "shared" / "data"
NEAR = 0.015  # relative to the frequency
BUILDING = np.array(  # exact, Hz
    [2.63186, 2.69173, 3.43042, 8.29742, 8.42882, 10.6272, 14.0053, 14.0930, 17.5741]
)
CLUSTERS = "pyoma-2 `cov` and its clusters, set by hand"
PYOMA = """
import logging, sys, time
import numpy as np
logging.disable(logging.CRITICAL)
from pyoma2.algorithms import SSI
from pyoma2.algorithms.data.run_params import Clustering
from pyoma2.setup import SingleSetup
y = np.load(sys.argv[1])
t = time.process_time()
setup = SingleSetup(y, fs=float(sys.argv[3]))
step = int(sys.argv[4])
if step > 1:
    setup.decimate_data(q=step)
ssi = SSI(name="a", method="cov", br=int(sys.argv[5]), ordmax=int(sys.argv[6]), step=2)
setup.add_algorithms(ssi)
setup.run_by_name("a")
ssi.add_clustering(Clustering(name="d", quick="Dederichs"))
ssi.run_clustering("d")
np.savez(sys.argv[2], f=ssi.result.clustering_results["d"].Fn, seconds=time.process_time() - t)
"""


@dataclass(frozen=True, slots=True)
class ByHand:
    """What a user of pyoma-2 sets: decimation, block rows, the highest order; channels (0 on)."""

    decimation: int
    rows: int
    order: int
    channels: int


@dataclass(frozen=True, slots=True, eq=False)
class Published:
    """A record and its reference modes.

    Attributes
    ----------
    name, file : str
    rate : float, Hz
    frequencies : (m,) float64, Hz
        Of the references.
    least : int
        Of them that must be found.
    most : int
        Extra modes.
    by_hand : ByHand
    """

    name: str
    file: str
    rate: float
    frequencies: Float
    least: int
    most: int
    by_hand: ByHand


@dataclass(frozen=True, slots=True)
class Counted:
    """Reference modes found and missed, modes that are extra, and doubtful ones beside them."""

    found: int
    missed: tuple[float, ...]
    extra: int
    doubtful: int

    @classmethod
    def of(cls, reference: Float, natural: Float, doubtful: Float) -> Counted:
        """Each reference mode has one natural mode at most, the nearest."""
        low = 0.9 * reference.min()
        high = 1.02 * reference.max()
        left = natural[(natural >= low) & (natural <= high)]
        beside = doubtful[(doubtful >= low) & (doubtful <= high)]
        missed = list[float]()
        for f in reference.tolist():
            apart = np.abs(left / f - 1)
            if apart.min(initial=1.0) < NEAR:
                left = np.delete(left, apart.argmin())
            else:
                missed.append(f)
        return cls(reference.size - len(missed), tuple(missed), left.size, beside.size)


def ambient_records() -> list[Published]:
    """Those with a published or exact answer."""
    mast = np.array(
        [
            2.7747,
            2.8174,
            13.538,
            16.009,
            16.335,
            30.94,
            39.65,
            40.94,
            42.50,
            66.84,
            69.71,
            72.12,
        ]
    )
    omega = np.sort(np.load(DATA / "oma/shear_frame/omega_n.npy").ravel())
    # frequencies of the average-acceleration method at 12 Hz, which made the record
    storeys = 12 / np.pi * np.arctan(omega / 24)
    out = [
        Published(
            "lattice mast LUMO, 61 s, other columns in the file",
            "oma/lumo/record.npy",
            1651.0,
            mast,
            least=11,
            most=1,
            by_hand=ByHand(8, 8, 80, 18),
        ),
        Published(
            "frame of five storeys, noise of 60 %",
            "oma/shear_frame/data_shearframe.npy",
            12.0,
            storeys,
            least=storeys.size,
            most=0,
            by_hand=ByHand(1, 20, 40, 5),
        ),
    ]
    for k in (1, 2, 3):
        out.append(
            Published(
                f"building with close pairs, setup {k} of 3",
                f"oma/l_building/set{k}.npy",
                100.0,
                BUILDING,
                least=9,
                most=0,
                by_hand=ByHand(2, 30, 60, 10),
            )
        )
    return out


def joined_building(report: Report) -> None:
    """The three setups of the building as one test: the first three channels stay in place."""
    records = []
    for k in (1, 2, 3):
        record = rt.read_record(DATA / f"oma/l_building/set{k}.npy", rate=100.0)
        names = [f"{c + 1}+X" if c < 3 else f"{10 * k + c + 1}+X" for c in range(10)]
        channels = tuple(map(rt.Channel, names))
        records.append(replace(record, channels=channels, source=f"setup {k}"))
    start = time.process_time()
    test = rt.identify_ambient_setups(records)
    seconds = time.process_time() - start
    counted = Counted.of(BUILDING, test.frequencies, test.others.modes.frequencies)
    what = f"the three setups of the building as one test: {BUILDING.size} modes"
    row(report, what, seconds, counted, (9, 0), [])


def timber_building() -> Published:
    """The record of 90 minutes; only modes below 3 Hz are published."""
    return Published(
        "timber building Palisaden, 90 min, to 3 Hz",
        "oma/palisaden/Palisaden_dataset.npy",
        100.0,
        np.array([1.882, 2.422, 2.687]),
        least=3,
        most=0,
        by_hand=ByHand(5, 40, 40, 6),
    )


def by_peer(published: Published, python: str | None) -> tuple[Peer | None, str]:
    """pyoma-2 on the record, or why there is no answer."""
    if python is None:
        return None, "not installed"
    by_hand = published.by_hand
    with tempfile.TemporaryDirectory() as folder:
        signals = Path(folder) / "y.npy"
        answer = Path(folder) / "answer.npz"
        np.save(signals, np.load(DATA / published.file)[:, : by_hand.channels])
        settings = [published.rate, by_hand.decimation, by_hand.rows, by_hand.order]
        command = [python, "-c", PYOMA, str(signals), str(answer), *map(str, settings)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            return None, (done.stderr.strip().splitlines() or ["no answer"])[-1]
        with np.load(answer) as arrays:
            frequencies = np.asarray(arrays["f"], dtype=np.float64)
            seconds = float(arrays["seconds"])
    counted = Counted.of(published.frequencies, frequencies, np.empty(0))
    return Peer(
        CLUSTERS, {"s": seconds, "found": counted.found, "extra": counted.extra}
    ), ""


def ambient(report: Report, published: Published, python: str | None) -> None:
    """One record by ringtrue, as `ringtrue oma FILE --rate HZ` reads it, and by the peer."""
    start = time.process_time()
    record = rt.read_record(DATA / published.file, rate=published.rate)
    result = rt.identify_ambient(record)
    seconds = time.process_time() - start
    counted = Counted.of(
        published.frequencies, result.modes.frequencies, result.others.modes.frequencies
    )
    peer, why = by_peer(published, python)
    if peer is None:
        report.not_run(f"pyoma-2, {published.name}", why)
    row(
        report,
        f"{published.name}: {published.frequencies.size} modes",
        seconds,
        counted,
        (published.least, published.most),
        [peer] if peer else [],
    )


def checks(counted: Counted, limits: tuple[int, int]) -> list[Check]:
    """What is right of a record; `limits` are the least found and the most extra modes."""
    return [
        at_least("found", counted.found, limits[0]),
        at_most("extra", counted.extra, limits[1]),
    ]


def row(
    report: Report,
    what: str,
    seconds: float,
    counted: Counted,
    limits: tuple[int, int],
    peers: list[Peer],
) -> None:
    """What is found of a record, within `limits`."""
    missed = ", ".join(f"{f:.4g}" for f in counted.missed)
    said = f"; missed: {missed} Hz" if missed else ""
    cost = {"s": seconds, "found": counted.found, "extra": counted.extra}
    report.row(
        f"{what}{said}",
        {**cost, "doubtful": counted.doubtful},
        checks(counted, limits),
        peers,
    )


def free_beam(report: Report) -> None:
    """Hammer FRFs of a steel beam; hits off the centre line excite torsion, too, near 1.38 kHz."""
    published = np.array([177.0, 477.4, 933.1, 1535.5, 2286.9, 3162.4, 4181.2])
    start = time.process_time()
    result = rt.identify_frfs(
        rt.read_frfs(DATA / "ema/free_beam/frf.npz"), fmin=100.0, fmax=4500.0
    )
    seconds = time.process_time() - start
    counted = Counted.of(published, result.modes.frequencies, np.empty(0))
    what = "free steel beam by hammer: 7 bending modes (torsion is extra)"
    row(report, what, seconds, counted, (7, 2), [])


def main() -> None:
    """All records that are here."""
    options = arguments(__doc__).parse_args()
    report = Report(options)
    if not DATA.exists():
        report.not_run("all records", f"no folder {DATA.name} beside the repository")
        report.end()
    python = peer_program("pyoma-2")
    records = ambient_records()
    if not options.quick:
        records.append(timber_building())
    for published in records:
        ambient(report, published, python)
    joined_building(report)
    free_beam(report)
    report.end()


if __name__ == "__main__":
    main()
