"""A structure whose modes are known, and records of it: what the benchmarks of identification
identify.

24 modes seen at 64 points (8 x 8 grid, unit mass matrix, smooth orthonormal shapes): 15 from 0.40
to 59 Hz, among them close pairs at 1.85 and 1.90 and at 11.8 and 12.0 Hz, and nine from 110 to 200
Hz that FRFs alone contain as residuals. Damping 0.5 to 3 %; two dashpots between points make the
modes complex where that is asked for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

Float = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]
Int = npt.NDArray[np.int64]

# of the modes in the band: Hz and damping ratio; those above it have 2 %
F = np.array(
    [
        0.40,
        0.62,
        1.10,
        1.85,
        1.90,
        3.2,
        5.1,
        7.9,
        11.8,
        12.0,
        18.5,
        26.0,
        36.0,
        47.0,
        59.0,
    ]
)
Z = (
    np.array(
        [2.0, 1.5, 1.2, 1.0, 1.3, 0.8, 0.9, 0.6, 0.7, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0]
    )
    / 100
)
F_ABOVE = np.array([110.0, 118, 127, 136, 147, 158, 171, 185, 200.0])
Z_ABOVE = np.full(9, 0.02)
BAND = F.size
DASHPOTS = ((3, 40, 0.6), (17, 60, 1.2))  # from point, to point, N s/m

FS = 200.0  # Hz, of ambient records
LEAD = 60  # s before an ambient record, until the motion is stationary
NOISE_AMBIENT = 0.1  # of each channel's RMS: 20 dB
SIXTEEN = np.array([0, 3, 5, 10, 13, 18, 23, 25, 30, 35, 37, 44, 47, 49, 54, 62])

FS_HAMMER = 256.0  # Hz
BLOCK = 64.0  # s
AVERAGES = 5
NOISE_HAMMER = 0.01  # of the RMS of all responses: 40 dB
NOISE_FORCE = 2e-4  # of the peak
WINDOW_END = 0.02  # the exponential window at the end of a block
FILTER = 115.0  # Hz, low-pass of the recorder
PULSE = 0.006  # s, length of an impact
FORCE_WINDOW = 0.25  # s
REFS = np.array([9, 29, 58])
RESP = np.setdiff1d(np.arange(64), (7, 20, 43, 56))


@dataclass(frozen=True, slots=True, eq=False)
class System:
    """Modes of the structure: M = I, forces at points, displacements at points.

    Attributes
    ----------
    poles : (mode,) complex128, rad/s
        Ascending in frequency, Im > 0.
    normal : (64, mode) float64
        Shapes of the undamped structure.
    turn : (mode, mode) complex128
        Modal displacements of the damped modes (columns) in those of the undamped ones.
    participation : (mode, mode) complex128
        Of undamped modal forces (columns) in each damped mode.
    """

    poles: Complex
    normal: Float
    turn: Complex
    participation: Complex

    @property
    def frequencies(self) -> Float:
        """(mode,) Hz."""
        return np.asarray(np.abs(self.poles) / 2 / np.pi)

    @property
    def damping(self) -> Float:
        """(mode,) damping ratios."""
        return np.asarray(-self.poles.real / np.abs(self.poles))

    @property
    def shapes(self) -> Complex:
        """(64, mode) shapes of the damped modes."""
        return np.asarray(self.normal @ self.turn)


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What an identification should give: (15,) Hz, (15,) damping ratios, (channel, 15) shapes."""

    frequencies: Float
    damping: Float
    shapes: Complex


@dataclass(frozen=True, slots=True, eq=False)
class HammerTest:
    """FRFs of an impact test.

    Attributes
    ----------
    f : (freq,) float64, Hz
    H : (freq, out, in) complex128, accelerance
    coherence : (freq, out, in) float64
    sigma : float, 1/s
        Decay of the exponential window, which adds `sigma` to the decay of each mode.
    responses, references : (out,), (in,) int64
        Points.
    """

    f: Float
    H: Complex
    coherence: Float
    sigma: float
    responses: Int
    references: Int


@dataclass(frozen=True, slots=True, eq=False)
class Score:
    """Modes against the truth: those within 3 % in frequency and over 0.8 in MAC are found, the
    rest is extra.

    Attributes
    ----------
    f, z : (15,) float64, %
        Errors of frequency and damping; NaN for a mode that is not found.
    mac : (15,) float64
        With the truth, likewise.
    extra : int
    """

    f: Float
    z: Float
    mac: Float
    extra: int

    @property
    def found(self) -> int:
        """How many modes of the truth are found."""
        return int(np.isfinite(self.f).sum())


def normal_shapes(points: int = 8, modes: int = 24, seed: int = 3) -> Float:
    """(points², mode) orthonormal shapes: products of cosines, made a little irregular."""
    rng = np.random.default_rng(seed)
    x = (np.arange(points) + 0.5) / points
    x, y = np.meshgrid(x, x, indexing="ij")
    waves = [(i, j) for i in range(6) for j in range(6)]
    waves = sorted(waves, key=lambda w: w[0] ** 2 + 1.3 * w[1] ** 2)[1 : modes + 1]
    shapes = np.stack(
        [(np.cos(np.pi * i * x) * np.cos(np.pi * j * y)).ravel() for i, j in waves],
        axis=1,
    )
    shapes += 0.15 * rng.standard_normal(shapes.shape) * shapes.std(axis=0)
    return np.linalg.qr(shapes)[0]


def system(complex_modes: bool = False, modes: int = BAND) -> System:
    """The structure with its lowest modes, with dashpots between points where `complex_modes`."""
    w = 2 * np.pi * np.r_[F, F_ABOVE][:modes]
    zeta = np.r_[Z, Z_ABOVE][:modes]
    normal = normal_shapes()[:, :modes]
    damping = np.diag(2 * zeta * w)
    for start, end, c in DASHPOTS if complex_modes else ():
        apart = normal[start] - normal[end]
        damping = damping + c * np.outer(apart, apart)
    state = np.block(
        [[np.zeros((modes, modes)), np.eye(modes)], [-np.diag(w**2), -damping]]
    )
    poles, right = np.linalg.eig(state)
    upper = np.flatnonzero(poles.imag > 0)
    upper = upper[np.argsort(np.abs(poles[upper]))]
    left = np.linalg.inv(right)
    return System(poles[upper], normal, right[:modes, upper], left[upper][:, modes:])


def points(channels: int) -> Int:
    """The points of 16 or 64 channels."""
    return {64: np.arange(64), 16: SIXTEEN}[channels]


def ambient(
    channels: int = 16, minutes: float = 60, seed: int = 0, complex_modes: bool = False
) -> Float:
    """(sample, channel) accelerations at 200 Hz under white forces that are held over a sample,
    noise 20 dB below.
    """
    rng = np.random.default_rng(seed)
    s = system(complex_modes)
    lead = int(LEAD * FS)
    force = rng.standard_normal((BAND, int(minutes * 60 * FS) + lead))
    step = np.exp(s.poles / FS)
    gain = (step - 1) / s.poles
    out = force.copy()
    for i in range(BAND):  # one recursive filter a mode
        z = lfilter([0, gain[i]], [1, -step[i]], s.participation[i] @ force)
        out += 2 * np.real(np.outer(s.turn[:, i] * s.poles[i] ** 2, z))
    # the force acts on the acceleration at once, too
    direct = 2 * np.real(np.einsum("mi,i,ik->mk", s.turn, s.poles, s.participation))
    out += (direct - np.eye(BAND)) @ force
    y = s.normal[points(channels)] @ out[:, lead:]
    y += rng.standard_normal(y.shape) * y.std(1, keepdims=True) * NOISE_AMBIENT
    return np.ascontiguousarray(y.T)


def accelerance(s: System, f: Float, responses: Int, references: Int) -> Complex:
    """(freq, out, in) acceleration over force of the structure, f in Hz."""
    jw = 2j * np.pi * f
    h = np.zeros((f.size, len(responses), len(references)), complex)
    for i, pole in enumerate(s.poles):
        residue = np.outer(s.shapes[:, i], s.participation[i] @ s.normal.T)[
            np.ix_(responses, references)
        ]
        response = (
            residue / (jw - pole)[:, None, None]
            + residue.conj() / (jw - pole.conj())[:, None, None]
        )
        h += -((2 * np.pi * f[:, None, None]) ** 2) * response
    return h


def hammer(seed: int = 1, complex_modes: bool = False) -> HammerTest:
    """An impact test: 60 responses, 3 references, 8193 lines, H1 of five averages, noise 40 dB
    below.
    """
    rng = np.random.default_rng(seed)
    samples = int(BLOCK * FS_HAMMER)
    lines = samples // 2 + 1
    long = 4 * samples  # an impact rings beyond its block
    f = np.fft.rfftfreq(long, 1 / FS_HAMMER)
    w = 2 * np.pi * f
    low_pass = 1 / np.sqrt(1 + (f / FILTER) ** 40)
    exact = accelerance(system(complex_modes, 24), f, RESP, REFS)
    t = np.arange(samples) / FS_HAMMER
    sigma = -np.log(WINDOW_END) / BLOCK
    window = np.exp(-sigma * t)
    force_window = np.where(t < FORCE_WINDOW, 1.0, 0.0) * window
    h = np.zeros((lines, RESP.size, REFS.size), complex)
    coherence = np.zeros(h.shape)
    for j in range(REFS.size):
        of_force = np.zeros(lines)
        of_both = np.zeros((lines, RESP.size), complex)
        of_response = np.zeros((lines, RESP.size))
        for _ in range(AVERAGES):
            begin = 0.05 + 0.01 * rng.random()
            length = PULSE * (1 + 0.1 * rng.standard_normal())
            peak = 1 + 0.3 * rng.random()
            w0 = np.pi / length
            half_sine = (
                peak * w0 * (1 + np.exp(-1j * w * length)) / (w0**2 - w**2 + 1e-9)
            )
            impact = half_sine * np.exp(-1j * w * begin) * low_pass * FS_HAMMER
            force = np.fft.irfft(impact, long)[:samples]
            y = np.fft.irfft(exact[:, :, j] * impact[:, None], long, axis=0)[:samples]
            force = (
                force + rng.standard_normal(samples) * np.abs(force).max() * NOISE_FORCE
            )
            y = y + rng.standard_normal(y.shape) * y.std() * NOISE_HAMMER
            force_lines = np.fft.rfft(force * force_window)
            response_lines = np.fft.rfft(y * window[:, None], axis=0)
            of_force += np.abs(force_lines) ** 2
            of_both += response_lines * force_lines.conj()[:, None]
            of_response += np.abs(response_lines) ** 2
        h[:, :, j] = of_both / of_force[:, None]
        coherence[:, :, j] = np.abs(of_both) ** 2 / of_force[:, None] / of_response
    return HammerTest(
        np.fft.rfftfreq(samples, 1 / FS_HAMMER), h, coherence, sigma, RESP, REFS
    )


def truth(at: Int, complex_modes: bool = False) -> Truth:
    """The modes of the band at some points."""
    s = system(complex_modes)
    return Truth(s.frequencies, s.damping, s.shapes[at])


def mac(a: Complex, b: Complex) -> Float:
    """(column of a, column of b)."""
    norms = np.outer((np.abs(a) ** 2).sum(axis=0), (np.abs(b) ** 2).sum(axis=0))
    return np.asarray(np.abs(a.conj().T @ b) ** 2 / norms)


def score(
    frequencies: Float, damping: Float, shapes: Complex | Float, true: Truth
) -> Score:
    """Each mode of the truth takes the mode of best MAC within 3 % of its frequency."""
    f_error, z_error, values = (
        np.full(true.frequencies.size, np.nan) for _ in range(3)
    )
    for i, f in enumerate(true.frequencies):
        near = np.flatnonzero(np.abs(frequencies / f - 1) < 0.03)
        if not near.size:
            continue
        like = mac(true.shapes[:, [i]], np.asarray(shapes[:, near], complex))[0]
        best = int(np.argmax(like))
        if like[best] > 0.8:
            k = near[best]
            f_error[i] = 100 * (frequencies[k] / f - 1)
            z_error[i] = 100 * (damping[k] / true.damping[i] - 1)
            values[i] = like[best]
    return Score(
        f_error, z_error, values, len(frequencies) - int(np.isfinite(values).sum())
    )


def rms(errors: Float) -> float:
    """Root mean square of what was found; NaN where nothing was."""
    there = np.isfinite(errors)
    return float(np.sqrt(np.mean(errors[there] ** 2))) if there.any() else float("nan")
