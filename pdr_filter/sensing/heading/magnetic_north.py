"""Which way is north in the attitude's frame, from the magnetic field along the way, with honest doubt.

In the attitude's frame (east, north, up, turned by an unknown angle) the field that the phone's magnetometer shows is

    f = m + R b + e,

m that of the Earth, R the rotation from the sensor to that frame, b what iron in the phone and a wrong calibration add
(hard iron), e the disturbances of the place. A linear regression over the way finds m and b together: who turns shows
b, and before he does the prior of b is the doubt of m. In a building e may turn single readings by a right angle, and
averages out all the same, because it is another one every few metres; how much is left follows from its scatter. So
nothing is gated by size or dip of the field, which hardly show which readings point north: in ms_indoor the headings
of single steps scatter by 11 to 13 degrees at any distance from the model of the Earth's field. The field counts where
somebody steps: all the samples in one place are one witness.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass

import numpy as np

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.values import FloatArray, Step, replace_unchecked
from pdr_filter.values.quaternions import rotation_matrix

# Mean readings are over half a second, about a step.
_READING_S = 0.5
# Columns of the samples that wait for a whole reading, and of readings that wait for their step.
_FIELD, _QUAT, _KNOWN, _SAMPLE_COLUMNS = slice(0, 3), slice(3, 7), 7, 8
_TIME, _SQUARES, _READING_COLUMNS = 0, slice(1, 50), 50
# Steps become known some seconds after their contact, behind a gate most of all; no result depends on more.
_MAX_LATENCY_S = 20.0
_M, _B, _F = slice(0, 3), slice(3, 6), 6
_DIAGONAL = np.diag_indices(_F)
_OF_M = 1e-9  # next to nothing is known of m
# North stays where it is in the attitude's frame: the regression is solved anew when there is a twentieth more.
_MORE = 0.05


@dataclass(frozen=True, eq=False)
class MagneticNorthState:
    """Readings that wait, and the sums of the regression."""

    samples: FloatArray  # (R, 8) since the last whole reading
    readings: FloatArray  # (W, 50) last time, and [X f]' [X f] of the mean rotation and the mean field
    n: float  # readings used, those of long ago counted less
    squares: FloatArray  # (7, 7) sum of [X f]' [X f], X = [1 R]
    variance_ut2: float  # of e on each axis
    used_s: float  # time of the last reading used
    n_fresh: int = 0  # readings used since the regression was solved
    north_rad: float = 0.0  # as it was solved
    north_std_rad: float = math.inf


@dataclass(frozen=True)
class MagneticNorth:
    """A causal stage: where north is, at each step; it needs a gyroscope and a magnetometer.

    Numbers were chosen on storeys B1 and F1 of ms_indoor; the other storeys and sets agree with them
    (tests/benchmarks/absolute_heading.py).

    Parameters
    ----------
    declination_rad, declination_std_rad : float
        By how much magnetic north is east of true north, and how well that is known.
    iron_std_ut : float
        Hard iron on each axis: its root mean square where people turned, up to 13; 0 to 3 in the other sets. The
        horizontal field of the Earth is 20 to 35.
    disturbance_ut, disturbance_readings : float
        What disturbances are on each axis before they are seen, and after how many independent readings what is seen
        has as much weight. Malls have 4, an office 6, a building of steel 15.
    correlation_readings : float
        Memory of disturbances: their correlation is 0.9 from one step to the next, 0.4 after five and 0.1 after ten.
    memory_s : float
        How long a reading counts: the attitude itself drifts by some 0.001 rad/s.
    """

    rate_hz: float = 100.0
    declination_rad: float = 0.0
    declination_std_rad: float = 0.0
    iron_std_ut: float = 7.0
    disturbance_ut: float = 8.0
    disturbance_readings: float = 4.0
    correlation_readings: float = 6.0
    memory_s: float = 100.0

    def init(self) -> MagneticNorthState:
        """State before the first sample."""
        return MagneticNorthState(
            samples=np.empty((0, _SAMPLE_COLUMNS)),
            readings=np.empty((0, _READING_COLUMNS)),
            n=0.0,
            squares=np.zeros((7, 7)),
            variance_ut2=self.disturbance_ut**2,
            used_s=-math.inf,
        )

    def update(
        self, state: MagneticNorthState, block: UniformBlock, attitude: AttitudeBlock, steps: list[tuple[int, Step]]
    ) -> tuple[MagneticNorthState, list[tuple[int, Step]]]:
        """New state, and the steps of a block with the heading of north."""
        is_sampled = block.magnetic_field_known & block.angular_rate_known
        samples = np.concatenate(
            [state.samples, np.column_stack([block.magnetic_field_ut, attitude.quat, is_sampled.astype(float)])]
        )
        size, n_waiting = round(_READING_S * self.rate_hz), len(state.samples)
        whole = samples[: len(samples) // size * size].reshape(-1, size, _SAMPLE_COLUMNS)
        ends_s = block.time_s[np.arange(1, len(whole) + 1) * size - 1 - n_waiting]
        is_known = whole[:, :, _KNOWN].all(axis=1)
        new_readings = _readings(whole[is_known], ends_s[is_known])
        samples = samples[len(samples) // size * size :]
        readings = np.concatenate([state.readings, new_readings])
        state = replace_unchecked(state, samples=samples, readings=readings)
        state, steps = self.finish(state, steps)
        recent = state.readings[:, _TIME] > block.time_s[-1] - _MAX_LATENCY_S
        return replace_unchecked(state, readings=state.readings[recent]), steps

    def finish(
        self, state: MagneticNorthState, steps: list[tuple[int, Step]]
    ) -> tuple[MagneticNorthState, list[tuple[int, Step]]]:
        """The same for steps that a gap or the end revealed."""
        result: list[tuple[int, Step]] = []
        times: list[float] = state.readings[:, _TIME].tolist()
        for number, step in steps:
            state = self._at_step(state, step, times)
            result.append(
                (number, replace_unchecked(step, north_rad=state.north_rad, north_std_rad=state.north_std_rad))
            )
        return state, result

    def _at_step(self, state: MagneticNorthState, step: Step, times: list[float]) -> MagneticNorthState:
        """State with the readings of a step, whose times are given."""
        if step.heading_unknown_s > 0:  # and with it what was north in the attitude's frame
            state = replace_unchecked(self.init(), samples=state.samples, readings=state.readings, used_s=state.used_s)
        first = bisect_right(times, max(step.time_s - step.duration_s, state.used_s))
        end = bisect_right(times, step.time_s)
        if end > first:
            state = self._with_readings(state, state.readings[first:end])
        return self._solved(state) if state.n_fresh > _MORE * state.n else state

    def _with_readings(self, state: MagneticNorthState, readings: FloatArray) -> MagneticNorthState:
        used_s = float(readings[-1, _TIME])
        weight = np.exp((readings[:, _TIME] - used_s) / self.memory_s)
        stay = math.exp((state.used_s - used_s) / self.memory_s)
        squares = stay * state.squares + (weight @ readings[:, _SQUARES]).reshape(7, 7)
        n, n_fresh = stay * state.n + float(weight.sum()), state.n_fresh + len(readings)
        return replace_unchecked(state, n=n, squares=squares, used_s=used_s, n_fresh=n_fresh)

    def _solved(self, state: MagneticNorthState) -> MagneticNorthState:
        """The regression with the variance of e so far, from whose residuals follows that of the next one.

        n correlated readings are worth n / c of independent ones, c = (1 + r) / (1 - r), r = e^(-1 / correlation). With
        x = (m, b): P^-1 = diag(0, 1 / iron^2) + sum X' X / (c v), P^-1 x = sum X' f / (c v); psi = atan2(m_e, m_n) has
        the variance u' P u / (m_e^2 + m_n^2), u = (cos psi, -sin psi, 0).
        """
        c, of_b = 1.0 / math.tanh(0.5 / self.correlation_readings), 1.0 / self.iron_std_ut**2
        weight = 1.0 / (c * state.variance_ut2)
        XX, Xf, ff = state.squares[:_F, :_F], state.squares[:_F, _F], float(state.squares[_F, _F])
        information = weight * XX
        information[_DIAGONAL] += _OF_M, _OF_M, _OF_M, of_b, of_b, of_b
        P = np.linalg.inv(information)
        x = weight * (P @ Xf)
        left_ut2 = ff - 2.0 * float(x @ Xf) + float(x @ XX @ x)
        prior_ut2 = self.disturbance_readings * self.disturbance_ut**2
        # one of the independent readings went into m
        seen, share = max(state.n / c - 1.0, 0.0), max(left_ut2, 0.0) / (3.0 * c)
        variance_ut2 = (prior_ut2 + share) / (self.disturbance_readings + seen)
        east, north = float(x[0]), float(x[1])
        psi = math.atan2(east, north)
        cosine, sine = math.cos(psi), math.sin(psi)
        (ee, en), (_, nn) = P[:2, :2].tolist()
        across_ut2 = cosine**2 * ee - 2.0 * cosine * sine * en + sine**2 * nn
        var = across_ut2 / max(east * east + north * north, 1e-6) + self.declination_std_rad**2
        north_rad, std_rad = psi - self.declination_rad, math.sqrt(var)
        return replace_unchecked(
            state, variance_ut2=variance_ut2, n_fresh=0, north_rad=north_rad, north_std_rad=std_rad
        )


def _readings(samples: FloatArray, time_s: FloatArray) -> FloatArray:
    """Time and [X f]' [X f] (R, 50) of whole samples (R, size, 8), X and f being their means."""
    to_frame = np.moveaxis(rotation_matrix(samples[:, :, _QUAT]), (-2, -1), (0, 1))
    Xf = np.empty((len(samples), 3, 7))
    Xf[:, :, _M], Xf[:, :, _B] = np.eye(3), np.moveaxis(to_frame.mean(axis=3), 2, 0)
    Xf[:, :, _F] = (to_frame * np.moveaxis(samples[:, :, _FIELD], 2, 0)).sum(axis=1).mean(axis=2).T
    return np.column_stack([time_s, (Xf.swapaxes(1, 2) @ Xf).reshape(-1, 49)])
