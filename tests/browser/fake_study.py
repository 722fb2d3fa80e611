"""A made-up study with every stage in a realistic size, for the tests of the report only."""

from __future__ import annotations

from dataclasses import replace

import fake_localised
import numpy as np

from ringtrue.checks.materials import MassProperties
from ringtrue.core.dofs import DofSet
from ringtrue.core.iterate import Outcome
from ringtrue.core.modes import ModeSet, Norm, Uncertainty
from ringtrue.core.parameters import Parameter, ParameterSet
from ringtrue.core.signals import Channel, FrfSet
from ringtrue.core.testmodel import TestModel
from ringtrue.correlation.channel_faults import Suspect
from ringtrue.correlation.frf import compare_frfs, fdac
from ringtrue.correlation.measures import complete
from ringtrue.correlation.orthogonality import OrthogonalityTest
from ringtrue.correlation.pairing import Pairing, track
from ringtrue.correlation.table import CorrelationTable
from ringtrue.identification.common.stabilisation import PoleSet, StableDiagram
from ringtrue.signal.impacts import ImpactReport
from ringtrue.study import results as r
from ringtrue.updating.prediction import Bands, RunUp, Unbalance
from ringtrue.updating.uncertainty import Posterior

RNG = np.random.default_rng(7)
ELASTIC = np.array(
    [
        14.1,
        17.9,
        19.6,
        23.8,
        27.5,
        31.2,
        34.9,
        38.8,
        42.0,
        45.7,
        45.9,
        50.4,
        55.1,
        58.0,
        62.3,
        67.8,
        72.2,
        77.7,
        83.1,
        90.4,
    ]
)
RIGID = np.array([0.52, 0.535, 0.71, 1.12, 1.48, 1.95])
REGIONS = (
    "foundation block",
    "frame columns",
    "frame girders",
    "frame bracing",
    "vacuum vessel",
    "vessel mounts",
    "anchors",
    "air springs",
    "motor",
    "gearbox and shaft",
)
CANDIDATES = (
    "E concrete",
    "E columns",
    "E girders",
    "E bracing",
    "t vessel shell",
    "t vessel heads",
    "E vessel",
    "K mounts axial",
    "K mounts lateral",
    "K anchors axial",
    "K anchors lateral",
    "K air springs vertical",
    "E motor bed",
    "K gearbox feet",
    "E shaft",
    "E platform",
)


class _Mesh:
    """Collects nodes, triangles and lines by group."""

    def __init__(self) -> None:
        self.xyz: list[np.ndarray] = []
        self.tri: list[tuple[np.ndarray, int]] = []
        self.line: list[tuple[np.ndarray, int]] = []
        self.count = 0

    def nodes(self, xyz: np.ndarray) -> np.ndarray:
        at = np.arange(self.count, self.count + len(xyz))
        self.xyz.append(xyz)
        self.count += len(xyz)
        return at

    def patch(self, xyz: np.ndarray, group: int) -> None:
        """A structured surface, `xyz` (i, j, 3)."""
        at = self.nodes(xyz.reshape(-1, 3)).reshape(xyz.shape[:2])
        a, b, c, d = at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]
        tri = np.concatenate(
            [
                np.stack([a, b, c], -1).reshape(-1, 3),
                np.stack([a, c, d], -1).reshape(-1, 3),
            ]
        )
        self.tri.append((tri, group))

    def box(
        self,
        low: tuple[float, ...],
        high: tuple[float, ...],
        n: tuple[int, ...],
        group: int,
    ) -> None:
        grid = [np.linspace(l, h, k + 1) for l, h, k in zip(low, high, n, strict=True)]
        for axis in range(3):
            i, j = [k for k in range(3) if k != axis]
            u, v = np.meshgrid(grid[i], grid[j], indexing="ij")
            for side in (low[axis], high[axis]):
                xyz = np.empty((*u.shape, 3))
                xyz[..., i], xyz[..., j], xyz[..., axis] = u, v, side
                self.patch(xyz, group)

    def beam(
        self, a: tuple[float, ...], b: tuple[float, ...], n: int, group: int
    ) -> None:
        at = self.nodes(np.linspace(a, b, n + 1))
        self.line.append((np.stack([at[:-1], at[1:]], 1), group))


def scene() -> r.Scene:
    """Foundation, frame, vessel and drivetrain: about 3000 nodes."""
    m = _Mesh()
    m.box((-12.5, -5, -4), (12.5, 5, 0), (40, 16, 6), 0)
    for x in np.linspace(-8, 8, 5):
        for y in (-4.2, 4.2):
            m.beam((x, y, 0), (x, y, 6), 8, 1)
        m.beam((x, -4.2, 6), (x, 4.2, 6), 8, 2)
    for y in (-4.2, 4.2):
        m.beam((-8, y, 6), (8, y, 6), 24, 2)
        for x in (-8, 0):
            m.beam((x, y, 0), (x + 4, y, 6), 6, 3)
    t, x = np.meshgrid(
        np.linspace(0, 2 * np.pi, 33), np.linspace(-7, 7, 24), indexing="ij"
    )
    m.patch(np.stack([x, 2.8 * np.cos(t), 3.2 + 2.8 * np.sin(t)], -1), 4)
    for end in (-7.0, 7.0):
        t, rad = np.meshgrid(
            np.linspace(0, 2 * np.pi, 33), np.linspace(0.4, 2.8, 6), indexing="ij"
        )
        m.patch(
            np.stack(
                [np.full_like(t, end), rad * np.cos(t), 3.2 + rad * np.sin(t)], -1
            ),
            4,
        )
    for x0 in (-5.0, 5.0):
        for y in (-2.2, 2.2):
            m.beam((x0, y, 0), (x0, y, 1.4), 2, 5)
    for x0 in np.linspace(-8, 8, 5):
        m.beam((x0, 4.2, -0.3), (x0, 4.2, 0), 1, 6)
    for x0 in np.linspace(-11, 11, 8):
        for y in (-4, 0, 4):
            m.beam((x0, y, -4.8), (x0, y, -4), 1, 7)
    m.box((-2, -1, 6.2), (1, 1, 8), (5, 4, 3), 8)
    m.box((2, -0.8, 6.2), (4, 0.8, 7.6), (4, 4, 3), 9)
    m.beam((1, 0, 7), (2, 0, 7), 4, 9)
    xyz = np.concatenate(m.xyz)
    groups = [np.full(len(t), g) for t, g in m.tri]
    lines = [np.full(len(t), g) for t, g in m.line]
    return r.Scene(
        np.arange(1, len(xyz) + 1),
        xyz,
        np.concatenate([t for t, _ in m.tri]),
        np.concatenate(groups),
        np.concatenate([t for t, _ in m.line]),
        np.concatenate(lines),
        REGIONS,
    )


def field(xyz: np.ndarray, k: int, wrong: float = 0.0) -> np.ndarray:
    """A smooth displacement field (n, 3): rigid for k < 6, waves in x and sway in z beyond."""
    x, y, z = (xyz / 10).T
    o, one = np.zeros_like(x), np.ones_like(x)
    if k < 6:
        rigid = (
            (one, o, o),
            (o, one, o),
            (-y, x, o),
            (o, o, one),
            (o, -z, y),
            (z, o, -x),
        )
        return np.stack(rigid[k], 1)
    n = k - 4
    q = 0.9 * n * x + 0.3 * k + wrong * np.sin(3 * x + k)
    sway = np.where(z > 0, (1 + z) ** 2, 1.0)
    u = np.stack(
        [
            0.3 * np.sin(q) * z,
            np.cos(q) * sway * (k % 3 == 0),
            np.cos(q + y * (k % 2)) * (k % 3 != 0),
        ],
        1,
    )
    return (
        u
        + 0.15 * np.stack([o, np.sin(2 * y + k) * sway, np.cos(k * y)], 1)
        + wrong * 0.2 * np.cos(q + 1)[:, None]
    )


def _fe_modes(s: r.Scene, f: np.ndarray, wrong: float) -> ModeSet:
    shapes = np.stack([field(s.xyz, k, wrong).ravel() for k in range(f.size)], 1) / 1e3
    labels = DofSet(np.repeat(s.node, 3), np.tile([1, 2, 3], s.node.size))
    return ModeSet(f, np.zeros(f.size), shapes, labels, Norm.MASS, "made up")


def test_model() -> TestModel:
    """52 points, 150 channels, wireframe."""
    base = [
        (x, y, z) for x in np.linspace(-12, 12, 7) for y in (-5, 5) for z in (-4, 0)
    ]
    frame = [
        (x, y, z) for x in np.linspace(-8, 8, 5) for y in (-4.2, 4.2) for z in (3, 6)
    ]
    top = [(-2, 0, 8), (1, 0, 8), (3, 0, 7.6), (2, 0.8, 7)]
    xyz = np.array([*base, *frame, *top], dtype=float)
    number = np.arange(101, 101 + len(xyz))
    near = np.linalg.norm(xyz[:, None] - xyz, axis=2)
    i, j = np.nonzero(np.triu((near < 4.6) & (near > 0)))
    pick = [(p, d) for p in range(len(xyz)) for d in range(3)][:150]
    at = number[[p for p, _ in pick]]
    channels = [f"{a}+{'XYZ'[d]}" for a, (_, d) in zip(at, pick, strict=True)]
    part = (
        ["foundation"] * len(base) + ["frame"] * len(frame) + ["drivetrain"] * len(top)
    )
    axes = np.eye(3)[[d for _, d in pick]]
    return TestModel(
        number,
        xyz,
        tuple(channels),
        at,
        axes,
        np.stack([number[i], number[j]], 1),
        tuple(part),
    )


def _seen(
    test: TestModel,
    f: np.ndarray,
    wrong: float,
    noise: float,
    first: int = 0,
    damping: float = 0.0,
) -> ModeSet:
    xyz = test.channel_xyz()
    shapes = np.stack(
        [(field(xyz, k + first, wrong) * test.axes).sum(1) for k in range(f.size)], 1
    ).astype(complex)
    shapes = shapes / 1e3
    shapes += (
        1e-3
        * noise
        * (RNG.normal(size=shapes.shape) + 1j * RNG.normal(size=shapes.shape))
    )
    zeta = np.full(f.size, damping) * RNG.uniform(0.6, 1.6, f.size)
    confidence = RNG.uniform(0.45, 1, f.size)
    return ModeSet(
        f,
        zeta,
        shapes if noise else shapes.real,
        test.channels,
        Norm.UNSCALED,
        "made up",
        confidence,
    )


def _mac(a: ModeSet, b: ModeSet) -> np.ndarray:
    top = np.abs(a.shapes.conj().T @ b.shapes) ** 2
    return top / np.outer(
        (np.abs(a.shapes) ** 2).sum(0), (np.abs(b.shapes) ** 2).sum(0)
    )


def correlation(
    a: ModeSet, b: ModeSet, first: int = 0, left_out: tuple[int, ...] = ()
) -> CorrelationTable:
    """Pairs mode k + first of `a` with k of `b`; the last mode of `a` stays alone."""
    n = min(len(a) - first - 1, len(b))
    one, two, mac = np.arange(n) + first, np.arange(n), _mac(a, b)
    f, g = a.frequencies, b.frequencies
    lone = np.setdiff1d(np.arange(len(a)), one), np.setdiff1d(np.arange(len(b)), two)
    why = [
        ("no FE mode within 30 % has MAC >= 60 %: best FE 20 with 31 %",) * x.size
        for x in lone
    ]
    close = np.isin(two, (16, 17))
    error = (g[two] - f[one]) / f[one]
    pairing = Pairing(
        one, two, mac[one, two], error, close, lone[0], why[0], lone[1], why[1]
    )
    return CorrelationTable(
        pairing, f[one], g[two], 2e-4 * f[one], ~np.isin(one, left_out), mac, f, g
    )


def evidence(a: ModeSet, b: ModeSet, table: CorrelationTable) -> r.Evidence:
    """All measures over a unit mass, and a channel that looks reversed."""
    found = complete(
        a,
        b,
        table.pairing,
        orthogonality=OrthogonalityTest(mass=np.eye(len(a.channels)), name="IRS"),
        std=(2e-4 * a.frequencies, float("nan")),
    )
    said = (
        "reads with the opposite sign in all modes; turned: mean MAC 91.2 % -> 93.0 %"
    )
    suspect = Suspect("103+Y", "reversed", said, "", -1.0, 0.912, 0.93)
    return r.Evidence(replace(found, suspects=(suspect,)), _mac(a, a))


def _compared(frfs: FrfSet) -> r.FrfEvidence:
    one, two = (replace(frfs, data=frfs.data[::step] * 1.05) for step in (-1, 1))
    rows = [x.data[::20].reshape(80, -1) for x in (frfs, one, two)]
    maps = [fdac(rows[0], x) for x in rows[1:]]
    return r.FrfEvidence(
        compare_frfs(frfs, one), compare_frfs(frfs, two), frfs.freqs[::20], *maps
    )


def _unsure(modes: ModeSet) -> Uncertainty:
    f, m = modes.frequencies, len(modes)
    return Uncertainty.independent(
        2e-4 * f, 0.04 * modes.damping, np.full((len(modes.channels), m), 0.01)
    )


def _diagram(modes: ModeSet, low: float, high: float) -> StableDiagram:
    f = modes.frequencies
    f = f[(f > low) & (f < high)]
    order, freq, which = [], [], []
    for n in range(4, 82, 2):
        for k, x in enumerate(f):
            if RNG.random() < 0.25 + 0.75 * n / 80:
                (
                    order.append(n),
                    freq.append(x * (1 + 2e-3 * RNG.normal())),
                    which.append(k),
                )
        for x in RNG.uniform(low, high, n // 4):
            (
                order.append(n),
                freq.append(x),
                which.append(-1 if RNG.random() < 0.8 else -2),
            )
    cluster = np.array(which)
    pole = 2 * np.pi * np.array(freq) * (-0.012 + 1j)
    nan = np.full(pole.size, np.nan)
    poles = PoleSet(np.array(order), pole, np.ones((3, pole.size), complex), nan, nan)
    grid = np.linspace(low, high, 1200)
    level = 10 * np.log10(
        1e-3 + (1 / ((grid[:, None] / f - 1) ** 2 + 1e-4)).sum(1)
    ) + RNG.normal(size=1200)
    return StableDiagram(
        poles,
        cluster != -1,
        np.maximum(cluster, -1),
        grid,
        level - np.array([[0], [8], [15]]),
    )


def _record(
    name: str, test: str, excitation: str, channels: int, rate: float, duration: float
) -> r.RecordSummary:
    t = np.linspace(0, 60, 1800)
    hit = np.exp(-0.25 * (t % 20)) * np.sin(2 * np.pi * 3.1 * t)
    f = np.geomspace(0.1, 100, 700)
    lines = np.concatenate([RIGID, ELASTIC])
    psd = (
        1e-12
        * (1 / f + (1 / ((f[:, None] / lines - 1) ** 2 + 5e-4)).sum(1))
        * RNG.chisquare(8, 700)
        / 8
    )
    preview = 1e-4 * (hit + 0.1 * RNG.normal(size=(3, t.size)))
    return r.RecordSummary(
        name,
        test,
        excitation,
        f"{name}.h5",
        channels,
        rate,
        duration,
        ("mains hum at 50 Hz", "machine harmonic at 24.7 Hz removed"),
        preview=r.RecordPreview(
            ("101+X", "103+Y", "105+Z"),
            "m/s^2",
            t,
            preview,
            f,
            psd * np.array([[1], [0.4], [2.5]]),
        ),
    )


def _frfs(test: TestModel, modes: ModeSet, inputs: list[int]) -> FrfSet:
    f = np.arange(1, 1601) / 16
    s = 2j * np.pi * f
    w = 2 * np.pi * modes.frequencies
    phi = modes.shapes.real
    poly = (s**2)[:, None] / ((s**2)[:, None] + 2 * 0.015 * w * s[:, None] + w**2)
    data = np.einsum("fm,om,im->foi", poly, phi, phi[inputs], optimize=True)
    data = data + 2e-8 * (
        RNG.normal(size=data.shape) + 1j * RNG.normal(size=data.shape)
    )
    outs = tuple(Channel(c, "acceleration", "m/s^2") for c in test.channels)
    ins = tuple(Channel(test.channels[i], "force", "N") for i in inputs)
    return FrfSet(
        data, f, outs, ins, np.full(data.shape, 0.98), np.full(len(inputs), 5.0)
    )


def _model_stage(s: r.Scene, modes: ModeSet) -> r.ModelStage:
    cards = {
        "GRID": 9214,
        "CHEXA": 5120,
        "CPENTA": 96,
        "CQUAD4": 2310,
        "CTRIA3": 140,
        "CBEAM": 380,
        "CBAR": 122,
    }
    cards |= {
        "CBUSH": 74,
        "CONM2": 12,
        "RBE2": 18,
        "RBE3": 6,
        "CORD2R": 3,
        "MAT1": 9,
        "PSHELL": 7,
        "EIGRL": 1,
    }
    findings = (
        "PSHELL 12 is not used",
        "CONM2 9003 stands 0.41 m from its node: offset kept",
    )
    return r.ModelStage(
        "Large spinning facility, as designed",
        ("lsf.bdf", "foundation.bdf", "frame.bdf", "vessel.bdf"),
        "SI",
        cards,
        findings,
        9214,
        41872,
        MassProperties(
            1.604e6,
            np.full(3, 1.604e6),
            np.array([0.12, -0.03, -1.61]),
            np.diag([1.31e7, 8.2e7, 8.9e7]),
        ),
        modes,
        np.full(len(modes), 3.1e-10),
        "Sturm count: 26 modes below 95 Hz, 26 found.",
        s,
    )


def _set(name: str, names: tuple[str, ...], best: float) -> r.SetResult:
    p, it = len(names), np.arange(9)
    goal = RNG.uniform(0.4, 2.6, p)
    fall = 1 - np.exp(-0.9 * it)
    path = np.exp(np.outer(fall, np.log(goal)))
    deviation = best + (18.2 - best) * np.exp(-0.9 * it)
    return r.SetResult(
        name,
        names,
        goal,
        RNG.uniform(0.01, 0.12, p),
        np.tile([0.25, 4.0], (p, 1)),
        RNG.uniform(0.05, 0.8, p),
        r.SetFit(
            mean_deviation=best,
            max_deviation=3.4 * best,
            mean_subspace_mac=96 - best,
            mean_deviation_left_out=1.3 * best,
            condition=40 * p**1.7,
            criterion=-220 + 8 * p + 30 * best,
        ),
        Outcome.CONVERGED,
        r.UpdateHistory(
            objective=1e3 * np.exp(-1.6 * it) + 4,
            step=np.exp(-it * 1.0),
            deviation=deviation,
            subspace_mac=95 - 0.4 * deviation,
            path=path,
            gradient=3e-7,
        ),
    )


def damped() -> r.DampingStage:
    """Two materials, a joint that the test says nothing about, a dashpot; 26 modes, five left
    out.
    """
    natures = ("material", "material", "joint", "dashpot")
    regions = r.DampedRegions(
        ("concrete", "steel", "vessel mounts", "air springs, vertical"),
        (
            "MAT1 1 GE",
            "MAT1 11 GE; MAT1 12 GE; MAT1 13 GE; 4 more",
            "PBUSH 54 GE",
            "PBUSH 60 B3",
        ),
        natures,
        np.array([0.012, 0.003, 0.0, 2.0e4]),
        np.diag([0.003, 0.001, 0.068, 2.7e3]) ** 2,
        np.array([0.014, 0.014, 0.041, 5e3]),
        np.array([0.014, 0.014, 0.068, 2.7e4]),
    )
    hertz = np.concatenate([RIGID, ELASTIC])
    ratio = 0.006 + 0.02 * (hertz < 5) + 0.002 * np.sin(hertz)
    error = np.where(np.arange(26) < 6, np.nan, 0.3)
    modes = r.DampedModes(
        np.arange(26),
        tuple(f"{'ambient' if i < 6 else 'test'} mode {i + 1}" for i in range(26)),
        ~np.isin(np.arange(26), (9, 13, 17, 20, 23)),
        hertz,
        ratio,
        0.03 * ratio,
        np.full(26, 0.0065),
        ratio * (1 + 0.1 * np.cos(hertz)),
        0.1 * ratio,
        error,
        0.7 * error,
    )
    told = (
        "the test says little about vessel mounts: their values are those expected, or zero",
    )
    return r.DampingStage(
        "",
        regions,
        modes,
        1.2,
        "0.65 % for all modes, the median of the test",
        told,
        (),
        (),
    )


def predicted() -> r.PredictStage:
    """A rotor and one group of springs, two resonances."""
    freqs = np.linspace(1, 200, 400)
    lines = (38.0, 61.0)
    curve = np.array(
        [
            freqs**2 / sum(np.abs(f**2 - freqs**2 + 0.02j * f * freqs) for f in lines)
            for _ in range(3)
        ]
    )
    curve *= np.array([[1e-4], [1e4], [3e3]])
    names = (
        "rotor, node 9001",
        "bearings, largest in one of 2",
        "bearings, sum along X",
    )
    peak = curve.max(axis=1)
    at = np.full(3, 38.0)
    run = RunUp(
        freqs,
        names,
        ("m", "N", "N"),
        curve,
        Bands(0.7 * curve, curve, 1.6 * curve, 0.9),
        Bands(0.7 * peak, peak, 1.6 * peak, 0.9),
        Bands(at - 1, at, at + 1.5, 0.9),
        (0.6, 41.0),
    )
    known = Posterior(
        ParameterSet((Parameter("k"),)), np.zeros(1), np.eye(1), np.eye(1), np.ones(1)
    )
    return r.PredictStage(
        9001,
        "X",
        Unbalance(2500.0, 2.5, 50.0),
        run,
        known,
        0.02,
        "by region",
        0.01,
        ("k: a flag",),
    )


def study() -> dict[str, object]:
    """All stages by name."""
    s, test = scene(), test_model()
    f_test = np.concatenate([RIGID, ELASTIC])
    f_fe = f_test * np.concatenate(
        [[0.9, 0.91, 0.95, 0.93, 0.96, 0.9], np.linspace(0.69, 0.92, 20)]
    )
    f_mid = f_test * np.concatenate(
        [[0.9, 0.91, 0.95, 0.93, 0.96, 0.9], np.linspace(0.76, 0.94, 20)]
    )
    f_end = f_test * (
        1 + np.concatenate([0.008 * RNG.normal(size=6), 0.013 * RNG.normal(size=20)])
    )
    fe, end = _fe_modes(s, f_fe, 0.4), _fe_modes(s, f_end, 0.05)
    rigid = _seen(test, RIGID, 0.0, 0.01, damping=0.04)
    elastic = _seen(test, np.append(ELASTIC, 93.7), 0.0, 0.06, first=6, damping=0.015)
    ambient = _seen(test, np.concatenate([RIGID, ELASTIC[:9]]), 0.0, 0.08, damping=0.02)
    hammer = replace(elastic, frequencies=elastic.frequencies * 1.0012)
    both = np.concatenate([rigid.shapes, elastic.shapes], 1)
    freqs, damping = (
        np.concatenate([getattr(m, n) for m in (rigid, elastic)])
        for n in ("frequencies", "damping")
    )
    reference = ModeSet(freqs, damping, both, test.channels, source="made up")
    seen = [
        _seen(test, f, w, 0.0) for f, w in ((f_fe, 0.4), (f_mid, 0.25), (f_end, 0.05))
    ]
    left_out = (9, 13, 17, 20, 23)
    tables = [correlation(reference, m, left_out=left_out) for m in seen]
    refs = [2, 40, 90]
    frfs = _frfs(test, hammer, refs)
    records = (
        _record("a1", "(a) ambient, foundation", "ambient only", 24, 100, 1800),
        _record("a2", "(a) ambient, foundation", "three people jumping", 24, 100, 900),
        _record(
            "b1", "(b) ambient, foundation and frame", "ambient only", 48, 200, 1200
        ),
        _record(
            "b2",
            "(b) ambient, foundation and frame",
            "30 kg weight from 1.5 m",
            48,
            200,
            900,
        ),
        _record("c1", "(c) hammer, all parts", "5.4 kg sledge", 52, 512, 2400),
    )
    found = [
        r.IdentifiedRecord(
            ambient,
            _unsure(ambient),
            ("poles of 30 orders",) * len(ambient),
            (_diagram(ambient, 0.2, 3), _diagram(ambient, 2, 40)),
            record=x.name,
        )
        for x in records[:4]
    ]
    identify = r.IdentifyStage(
        test,
        r.IdentifiedModes(
            ambient, _unsure(ambient), ("found in 4 of 4 records",) * len(ambient)
        ),
        r.IdentifiedModes(
            hammer,
            _unsure(hammer),
            ("cluster of 34 poles, MPC 0.98",) * len(hammer),
            (_diagram(hammer, 8, 50), _diagram(hammer, 45, 96)),
        ),
        records=records,
        ambient_records=tuple(found),
        frfs=frfs,
        hits=(
            ImpactReport(
                "point 112+Z",
                "112+Z",
                41.0,
                880.0,
                4e-3,
                False,
                ("double hit at 0.18 s",),
            ),
            ImpactReport(
                "point 131+X", "131+X", 8.0, 910.0, 4e-3, False, ("overload on 141+Y",)
            ),
        ),
        synthesis_error=RNG.uniform(0.03, 0.2, (150, 3)),
    )
    sets = (
        _set("six by QR", CANDIDATES[:6], 1.2),
        _set("four by sensitivity", CANDIDATES[6:10], 3.6),
        _set("ten", CANDIDATES[:10], 0.9),
    )
    curve = frfs.data[:, [2, 40, 90], [0, 1, 2]]
    path = track([m.frequencies for m in seen[::-1]], [m.shapes for m in seen[::-1]])
    told = [evidence(reference, m, t) for m, t in zip(seen, tables, strict=True)]
    last = replace(told[2], tracks=path, frfs=_compared(frfs))
    pair = replace(correlation(ambient, hammer, first=6), names=("ambient", "hammer"))
    diff = (
        "--- frame.bdf\n+++ frame.bdf\n@@ -812,3 +812,5 @@\n $ bracing of bay 3\n"
        "-CBAR    4401    31      2101    2109    0.      1.      0.\n"
        "+CBAR    4401    33      2101    2109    0.      1.      0.\n"
        "+CBAR    4402    33      2105    2113    0.      1.      0.\n ENDDATA\n"
    )
    rigid_rows = [correlation(rigid, m.take(np.arange(6))) for m in (seen[0], seen[2])]
    zeta = np.concatenate([rigid.damping, elastic.damping[:20]])
    target = np.arange(6, 18)
    auto = _mac(seen[0].take(target), seen[0].take(target))
    return {
        "model": _model_stage(s, fe),
        "plan": r.PlanStage(
            target,
            seen[0].frequencies[target],
            ("6 to 18 Hz",) * target.size,
            r.SensorPlan(612, test, test.channels[:48], auto),
            r.ExcitationPlan(
                tuple(test.channels[i] for i in refs),
                np.linspace(0.4, 1.0, target.size),
                np.ones(target.size),
                (),
                np.zeros((0, target.size)),
            ),
            r.AcquisitionPlan(
                damping=0.01,
                frequency_step=0.0625,
                block=16.0,
                averages=5,
                record_length=1800.0,
                segments=112,
                modes=target,
                std_frequency=1e-4 * np.linspace(4, 1, 12),
                std_damping=1e-2 * np.linspace(9, 3, 12),
            ),
            "Effective independence over 12 target modes.",
        ),
        "identify": identify,
        "compare": r.CompareStage(pair, evidence(ambient, hammer, pair)),
        "correlate": r.CorrelateStage(
            r.ReferenceModes(
                reference, _unsure(reference), rigid, _unsure(rigid), np.array(left_out)
            ),
            tables[0],
            tables[1],
            rigid_rows[0],
            seen[0],
            seen[1],
            told[0],
            told[1],
            r.Remodelling(
                "A diagonal brace in bay 3 was missing; two bars added.", diff, ()
            ),
        ),
        "localise": fake_localised.localise(REGIONS, CANDIDATES),
        "uncertainty": fake_localised.uncertainty(
            reference.frequencies[6:], sets[0].parameters, (3, 7, 11, 14)
        ),
        "sensitivity": r.SensitivityStage(
            CANDIDATES,
            RNG.normal(size=(20, 16)) ** 3 * 0.05,
            RNG.normal(size=(20, 16)) ** 3 * 0.1,
            np.arange(6, 26),
            {x.name: x.parameters for x in sets},
            {x.name: "Pivoted QR of the weighted sensitivities." for x in sets},
            ("E vessel and t vessel shell: correlation 0.998",),
        ),
        "update": r.UpdateStage(
            sets,
            0,
            "The set of six has the lowest criterion that keeps every identifiability below 0.9.",
            dict.fromkeys(sets[0].parameters, 2.1e11),
            dict(zip(sets[0].parameters, 2.1e11 * sets[0].factor, strict=True)),
            {
                name: (k,)
                for name, k in zip(sets[0].parameters, (0, 1, 2, 3, 4, 5), strict=True)
            },
        ),
        "tune": r.TuneStage(
            *rigid_rows,
            {"vertical": 1.21, "lateral": 1.17},
            {"vertical": 0.01, "lateral": 0.014},
        ),
        "final": r.FinalStage(
            ("lsf.bdf", "frame.bdf"),
            tuple(
                f"frame.bdf:{12 + k} PBUSH {31 + k} K3 1.2e9 -> 2.9e9"
                for k in range(24)
            ),
            tables[2],
            rigid_rows[1],
            end,
            seen[2],
            zeta,
            tuple(f"test mode {k + 1}" for k in range(26)),
            last,
            r.ComparedFrfs(
                frfs.freqs,
                ("103+X / 101+Z", "114+Y / 114+Y", "131+X / 131+X"),
                curve,
                curve[::-1] * 0.5 + 1e-9,
                curve * 1.05,
            ),
        ),
        "damping": damped(),
        "predict": predicted(),
        "provenance": r.Provenance(
            "0.1.0",
            "3.11.2",
            {"numpy": np.__version__, "scipy": "1.17.0"},
            "Linux x86_64, 2 cores",
            1,
            "2024-05-02 10:15",
            {
                f"{n}.bdf": f"{k:x}" * 64
                for k, n in enumerate(("lsf", "foundation", "frame"))
            },
            "[study]\nseed = 1\n",
            {
                "model": 12.1,
                "plan": 2.2,
                "identify": 61.0,
                "correlate": 14.0,
                "update": 92.5,
                "final": 11.9,
            },
        ),
    }
