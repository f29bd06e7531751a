"""How actuation, stiffness and contact are related in an episode: frequencies, lags, and what precedes an impact.

The EvoGymCM paper reports two things of policies that set stiffness: the stiffness of leg voxels rises just before they
hit the ground, and a voxel's stiffness has the frequency of its actuation, at a constant shift of phase.

Spectra are means over windows of 128 env-steps that overlap by half, the mean of each removed, weighted by Hann's
function (Welch's method). Frequencies count cycles per second of simulated time, lags whole env-steps.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evogymcm.algos.analysis.recording import Recording
from evogymcm.algos.analysis.statistics import bootstrap
from evogymcm.sim.constants import SUBSTEPS, Physics

Array = NDArray[np.float64]

STEP_SECONDS = SUBSTEPS * Physics().substep  # an env-step in simulated time, whose unit is taken as a second
_WINDOW = 128  # env-steps
_FINENESS = 8  # frequencies per cycle in a window: windows are padded with zeros
_SHORTEST = 16  # env-steps; no frequency is told of shorter episodes
_STILL = 1e-3  # a signal whose standard deviation is smaller counts as constant
_MANY = 3  # windows at least: with one, coherence is 1 for any two signals
AROUND = 10  # env-steps before and after an impact
QUIET = 3  # env-steps without contact that make the next contact an impact
FEWEST = 10  # impacts from which it is told whether a policy anticipates them


@dataclass(frozen=True, eq=False)
class VoxelSignals:
    """Signals of one voxel; None where there are none, or where one of the two does not vary.

    Attributes:
        row: row in the body's array.
        column: column in the body's array.
        is_actuator: whether the policy drives it.
        actuation: (T,) target lengths, None for other voxels.
        stiffness: (T,)
        contact: (T,) bool.
        frequency_actuation: strongest frequency of the actuation.
        frequency_stiffness: strongest frequency of the stiffness.
        phase_lag: radians in (-pi, pi] by which stiffness follows actuation, at the actuation's frequency.
        coherence: in [0, 1] at that frequency, 1 where the lag is the same in all windows; None in short episodes.
        lag_steps: env-steps by which stiffness follows actuation where their correlation is largest, within half a
            period either way.
        correlation: correlation of stiffness and actuation at that lag.
    """

    row: int
    column: int
    is_actuator: bool
    actuation: Array | None
    stiffness: Array
    contact: NDArray[np.bool_]
    frequency_actuation: float | None
    frequency_stiffness: float | None
    phase_lag: float | None
    coherence: float | None
    lag_steps: int | None
    correlation: float | None


@dataclass(frozen=True, eq=False)
class Spectra:
    """Power densities at F frequencies, means over the actuators; their integrals are the mean variances."""

    frequency: Array
    actuation: Array
    stiffness: Array


@dataclass(frozen=True, eq=False)
class TouchDown:
    """Stiffness around impacts, a mean over impacts; an impact is contact after QUIET env-steps without any.

    The stiffness of lag 0 acted in the env-step in which the voxel came down and was chosen before it, so that no
    stiffness up to lag 0 can answer to the impact.

    Attributes:
        lags: (21,) env-steps after the impact, from -10.
        stiffness: (21,) mean stiffness of the touching voxels, NaN without impacts.
        n_impacts: number of impacts of all voxels; those within 10 env-steps of the episode's ends are left out.
        rise_before_impact: mean of lags -1 and 0, minus mean of lags -10 to -6; None without impacts.
        rise_interval: 95 % bootstrap interval of that rise. Voxels that land in the same env-step are resampled
            together; None with fewer than two such env-steps.
        rise_rank: share of all shifts of the stiffness in time for which the rise would be smaller: 0.5 is chance,
            1 says that no other moment of the episode shows a larger rise.
    """

    lags: NDArray[np.int64]
    stiffness: Array
    n_impacts: int
    rise_before_impact: float | None
    rise_interval: tuple[float, float] | None
    rise_rank: float | None


@dataclass(frozen=True, eq=False)
class Signals:
    """Signals of an episode, voxel by voxel, and their common properties."""

    task: str
    score: float
    step_seconds: float
    voxels: tuple[VoxelSignals, ...]
    spectra: Spectra
    contact: TouchDown

    def summary(self) -> dict[str, Any]:
        """Returns the numbers for a table: medians over the actuators whose actuation and stiffness both vary.

        `same_frequency` is the share of them whose two frequencies are less than one cycle in a window apart. All of a
        gait's signals have its frequency; that the lag is constant shows in the coherence.
        """
        both = [voxel for voxel in self.voxels if voxel.phase_lag is not None]
        resolution = 1 / (_window_length(len(self.voxels[0].stiffness)) * self.step_seconds)
        same = [_gap(voxel) <= resolution for voxel in both]
        return {
            "score": self.score,
            "actuators": sum(voxel.is_actuator for voxel in self.voxels),
            "varying": len(both),
            "same_frequency": sum(same) / len(same) if same else None,
            "frequency": _median([voxel.frequency_actuation for voxel in both]),
            "phase_lag": _median_angle([voxel.phase_lag for voxel in both]),
            "coherence": _median([voxel.coherence for voxel in both]),
            "correlation": _median([voxel.correlation for voxel in both]),
            "n_impacts": self.contact.n_impacts,
            "rise_before_impact": self.contact.rise_before_impact,
            "rise_interval": self.contact.rise_interval,
            "rise_rank": self.contact.rise_rank,
        }

    def record(self) -> dict[str, Any]:
        """Returns everything as JSON types, numbers with five significant digits."""
        plain = _plain(asdict(self))
        for voxel, row in zip(self.voxels, plain["voxels"], strict=True):
            row["contact"] = voxel.contact.astype(int).tolist()
        return plain | {"summary": _plain(self.summary())}


def anticipation(summary: Mapping[str, Any]) -> int | None:
    """Returns whether a policy stiffens voxels before they hit the ground: 1 for a rise, -1 for a fall, 0 for neither.

    There is a rise where the whole 95 % interval of the stiffness's rise before impact is above zero, see `TouchDown`,
    and a fall where it is below, both by more than rounding (0.001). By chance one policy in forty would show a rise,
    and one in forty a fall: the share that falls is a measure for the share that rises. None where an episode has fewer
    than 10 impacts, or all in the same env-step.

    Args:
        summary: of `Signals.summary`.
    """
    if summary["n_impacts"] < FEWEST or summary["rise_interval"] is None:
        return None
    low, high = summary["rise_interval"]
    return int(low > _STILL) - int(high < -_STILL)


def analyse_signals(recording: Recording) -> Signals:
    """Returns the signals of an episode and what they show."""
    r = recording
    steps, n = r.stiffness.shape
    frequency, stiffness_windows = _fourier(r.stiffness)
    actuation_windows = _fourier(np.where(r.is_actuator, r.actuation, 0.0))[1]
    lowest = _FINENESS if steps >= _SHORTEST else len(frequency)  # one cycle in a window
    peaks = [
        [_peak(windows[:, :, i], series[:, i], lowest) for i in range(n)]
        for windows, series in ((actuation_windows, r.actuation), (stiffness_windows, r.stiffness))
    ]

    def voxel(i: int) -> VoxelSignals:
        of_actuation, of_stiffness = peaks[0][i], peaks[1][i]
        phase = coherence = lag = correlation = None
        if of_actuation is not None and of_stiffness is not None:
            windows = actuation_windows[:, of_actuation, i], stiffness_windows[:, of_actuation, i]
            phase, coherence = _phase_lag(*windows)
            half_period = max(1, round(0.5 / (STEP_SECONDS * frequency[of_actuation])))
            lag, correlation = _best_lag(r.actuation[:, i], r.stiffness[:, i], half_period)
        return VoxelSignals(
            row=int(r.cells[i, 0]),
            column=int(r.cells[i, 1]),
            is_actuator=bool(r.is_actuator[i]),
            actuation=r.actuation[:, i] if r.is_actuator[i] else None,
            stiffness=r.stiffness[:, i],
            contact=r.contact[:, i],
            frequency_actuation=None if of_actuation is None else float(frequency[of_actuation]),
            frequency_stiffness=None if of_stiffness is None else float(frequency[of_stiffness]),
            phase_lag=phase,
            coherence=coherence,
            lag_steps=lag,
            correlation=correlation,
        )

    spectra = Spectra(
        frequency,
        _power(actuation_windows[:, :, r.is_actuator], steps),
        _power(stiffness_windows[:, :, r.is_actuator], steps),
    )
    voxels = tuple(voxel(i) for i in range(n))
    return Signals(r.task, r.score, STEP_SECONDS, voxels, spectra, _touch_down(r.stiffness, r.contact))


def _window_length(steps: int) -> int:
    return min(_WINDOW, steps)


def _fourier(series: Array) -> tuple[Array, NDArray[np.complex128]]:
    """Returns (F,) frequencies and (K, F, n) transforms of the K windows of (T, n) series."""
    length = _window_length(len(series))
    starts = range(0, len(series) - length + 1, max(1, length // 2))
    windows = np.stack([series[start : start + length] for start in starts])
    windows = (windows - windows.mean(1, keepdims=True)) * np.hanning(length)[:, None]
    padded = _FINENESS * length
    return np.arange(padded // 2 + 1) / (padded * STEP_SECONDS), np.fft.rfft(windows, padded, axis=1)


def _power(windows: NDArray[np.complex128], steps: int) -> Array:
    """Returns (F,) the one-sided power density, a mean over windows and voxels."""
    if not windows.shape[2]:
        return np.zeros(windows.shape[1])
    weight = np.square(np.hanning(_window_length(steps))).sum()
    return 2 * STEP_SECONDS * np.square(np.abs(windows)).mean((0, 2)) / max(weight, 1e-12)


def _peak(windows: NDArray[np.complex128], series: Array, lowest: int) -> int | None:
    """Returns the index, `lowest` or more, of the strongest frequency of (K, F) windows; None of a constant series."""
    power = np.square(np.abs(windows)).mean(0)[lowest:]
    if not (len(power) and series.std() >= _STILL):  # False for NaN
        return None
    return lowest + int(power.argmax())


def _phase_lag(first: NDArray[np.complex128], second: NDArray[np.complex128]) -> tuple[float, float | None]:
    """Returns the phase by which the second of two (K,) components follows the first, and their coherence."""
    cross = (first * second.conj()).mean()
    powers = np.square(np.abs(first)).mean() * np.square(np.abs(second)).mean()
    is_known = len(first) >= _MANY and powers > 0
    return float(np.angle(cross)), float(np.square(np.abs(cross)) / powers) if is_known else None


def _best_lag(first: Array, second: Array, furthest: int) -> tuple[int, float]:
    """Returns by how many steps the second series follows the first where they correlate most, and how much."""
    furthest = min(furthest, len(first) // 2)
    lags = sorted(range(-furthest, furthest + 1), key=abs)  # of equals the nearest
    values = [
        _correlation(first[max(0, -k) : len(first) - max(0, k)], second[max(0, k) :][: len(first) - abs(k)])
        for k in lags
    ]
    best = int(np.argmax(values))
    return lags[best], values[best]


def _correlation(first: Array, second: Array) -> float:
    """Returns Pearson's correlation, 0 where one of the two is constant."""
    first, second = first - first.mean(), second - second.mean()
    scale = np.sqrt(np.square(first).sum() * np.square(second).sum())
    return float((first * second).sum() / scale) if scale > 0 else 0.0


def _touch_down(stiffness: Array, contact: NDArray[np.bool_]) -> TouchDown:
    """Returns the (T, n) stiffness around the impacts in (T, n) contact."""
    lags = np.arange(-AROUND, AROUND + 1)
    none = TouchDown(lags, np.full(len(lags), np.nan), 0, None, None, None)
    if len(contact) < len(lags):
        return none
    quiet = np.stack([~contact[QUIET - k : len(contact) - k] for k in range(1, QUIET + 1)]).all(0)
    at, voxel = np.nonzero(contact[QUIET:] & quiet)
    at = at + QUIET
    is_inside = (at >= AROUND) & (at + AROUND < len(contact))
    at, voxel = at[is_inside], voxel[is_inside]
    if not len(at):
        return none
    around = stiffness[at[:, None] + lags, voxel[:, None]]  # (impacts, lags)
    rises = around[:, [AROUND - 1, AROUND]].mean(1) - around[:, :5].mean(1)

    interval = None
    if len(np.unique(at)) > 1:
        low, high = bootstrap(rises, clusters=at)
        interval = (float(low), float(high))

    ends = stiffness[AROUND:]  # rise of every voxel at every moment
    everywhere = (ends + stiffness[AROUND - 1 : -1]) / 2
    everywhere = everywhere - sum(stiffness[k : len(stiffness) - AROUND + k] for k in range(5)) / 5
    shifts = np.arange(1, len(everywhere))[:, None]
    shifted = everywhere[(at - AROUND + shifts) % len(everywhere), voxel].mean(1)
    rank = float(((shifted < rises.mean()).mean() + (shifted <= rises.mean()).mean()) / 2)  # ties count half
    return TouchDown(lags, around.mean(0), len(at), float(rises.mean()), interval, rank)


def _gap(voxel: VoxelSignals) -> float:
    """Returns how far the two frequencies of a voxel that has both are apart."""
    assert voxel.frequency_actuation is not None
    assert voxel.frequency_stiffness is not None
    return abs(voxel.frequency_actuation - voxel.frequency_stiffness)


def _median(values: list[Any]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else None


def _median_angle(angles: list[Any]) -> float | None:
    """Returns the median of angles, cut open opposite their mean direction."""
    if not angles:
        return None
    middle = float(np.angle(np.exp(1j * np.array(angles)).mean()))
    return float(np.angle(np.exp(1j * (middle + np.median(np.angle(np.exp(1j * (np.array(angles) - middle))))))))


def _plain(value: Any) -> Any:
    """Returns nested values as JSON types; NaN becomes None."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, float):
        return float(f"{value:.5g}") if np.isfinite(value) else None
    return value
