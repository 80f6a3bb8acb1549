"""Steps and context windows in, track rows out: the three weightings over the same modes and the same motion.

`imm` runs one Kalman filter for each mode and mixes them by probability. `hc` and `wc` run one filter whose step
length is the highest context's or the probability-weighted one, each step weighted by the two windows that contain it:
the provisional and the final distance of Martinelli et al. 2018, Algorithms 1 and 2.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import import_module
from types import ModuleType

import numpy as np

from pdr_filter.filter import imm
from pdr_filter.filter.alignment import Alignment, Anchor, align, moved, with_anchor
from pdr_filter.filter.motion import (
    EAST,
    HEADING_OFFSET,
    LOG_SCALE,
    N_STATES,
    NORTH,
    Directions,
    Mode,
    MotionNoise,
    advance,
    bound_heading_variance,
    expect_first_direction,
    grow_over_gap,
    initial_estimate,
    learn_heading,
    linearise,
    second_order_errors,
)
from pdr_filter.filter.speed import WalkingSpeed, after_step
from pdr_filter.filter.step_length import StepLengths
from pdr_filter.filter.weighting import HC, WEIGHTINGS, ModeEvidence, context_weights
from pdr_filter.sensing.contexts.stage import WindowContext
from pdr_filter.values.angles import wrap_angle
from pdr_filter.values.arrays import FloatArray, read_only
from pdr_filter.values.contexts import CONTEXTS
from pdr_filter.values.fixes import Fix, HeadingFix, PositionFix, SpeedFix, Standstill
from pdr_filter.values.step import Step

# Final steps that are remembered for late fixes: half a minute of walking.
TRAIL_STEPS = 64
# Windows are remembered so long: a gate may hold the first steps of a bout for some seconds.
_WINDOW_MEMORY_S = 12.0
_BACKENDS = {
    "numpy": "pdr_filter.filter.imm",
    "filterpy": "pdr_filter.filter.imm_filterpy",
    "numba": "pdr_filter.imm_compiled",
}
_FRAMES = ("start", "world")
MAX_STANDSTILLS = 16
# Evidence of a known standstill against every mode that moves: a hundred thousand to one, because a window that is sure
# of walking says a hundred to one for it (`evidence_floor`), and the step itself seven to one.
_STANDSTILL_LOG_EVIDENCE = 12.0


@dataclass(frozen=True, slots=True, eq=False)
class StepUpdate:
    """The track after one step.

    With `hc` and `wc` a step is first reported provisionally and again, with the same `index`, when the context window
    that follows it is known; `imm` reports each step once.
    """

    index: int  # number of the step in the track, from 0
    step: Step
    is_final: bool
    position_m: FloatArray  # (2,) east, north
    position_cov_m2: FloatArray  # (2, 2)
    step_length_m: float
    walking_heading_rad: float  # clockwise, not wrapped
    speed: WalkingSpeed
    context_prob: FloatArray  # (C,)
    mode_prob: FloatArray  # (M,)


@dataclass(frozen=True, slots=True, eq=False)
class StepPrediction:
    """Modes before a step with all that is known until then, mixed, and where the step leads them."""

    mean: FloatArray  # (M, 4) before the step, its walking direction learnt
    cov: FloatArray  # (M, 4, 4)
    mixed: FloatArray  # (M, 4)
    mixed_cov: FloatArray  # (M, 4, 4)
    mode_prob: FloatArray  # (M,) predicted
    predicted: FloatArray  # (M, 4)
    F: FloatArray  # (M, 4, 4)
    Q: FloatArray  # (M, 4, 4)
    length_m: FloatArray  # (M,) without the person's scale
    length_var_m2: FloatArray  # (M,) parameters and residual
    parameter_std_m: FloatArray  # (M,) the parameters' part: in Q is the residual's alone


@dataclass(frozen=True, slots=True, eq=False)
class TrackerState:
    """Estimates of all modes (one for `hc` and `wc`), recent windows, and steps that wait for theirs."""

    mean: FloatArray  # (M, 4) or (1, 4)
    cov: FloatArray  # (M, 4, 4) or (1, 4, 4)
    mode_prob: FloatArray  # (M,)
    windows: tuple[WindowContext, ...]  # the last ones of this segment, oldest first
    used: WindowContext | None  # the last window that was used as evidence
    shared_m: FloatArray  # (2 + M, 2) sums of the errors that steps share and no state has, see `_with_shared`
    last_step_s: float  # contact of the last final step; NaN before the first
    speed: WalkingSpeed | None  # after the last final step; None before the first of a segment
    frame_rad: float  # heading offset that counts as zero: the first that was known
    frame_since_s: float  # contact of the step that it was known from; infinite before
    trail: FloatArray  # (R, 4) time, east, north, device heading of the last final steps: where a late fix belongs
    anchors: tuple[Anchor, ...]  # fixes that wait for the alignment with the world
    alignment: Alignment | None  # how the frame of the start became that of the world
    knows_north: bool  # that a heading fix has turned the frame
    standstills: tuple[tuple[float, float], ...]  # the last ones
    pending: tuple[Step, ...]  # hc, wc: steps not yet final
    n_final: int
    rejected_fixes: int


@dataclass(frozen=True, eq=False)
class Tracker:
    """Turns steps and context probabilities into positions with covariance.

    Parameters
    ----------
    modes : tuple of Mode
        Motion models; `hc` and `wc` need exactly one for each context.
    transition_prob : (M, M)
        Probability from mode i to mode j between two steps; rows sum to one.
    weighting : {"imm", "wc", "hc"}
        How context probabilities become step lengths.
    wc_threshold : float
        Second-highest over highest probability from which `wc` weights (Algorithm 2: 0.8).
    evidence_exponent : float
        Tempering of the evidence of one window. Hop over window length (0.5) would let no second of overlapping windows
        vote twice; with 1 the mode probabilities of people left out are nearer to the truth (docs/benchmarks.md).
    prior_exponent : float
        How far the classifier's training prior is divided out. All of it makes stairs of other people's flat walking,
        none of it walking of their stairs (docs/benchmarks.md).
    evidence_floor : float
        Probability below which a context is not pushed by one window.
    step_log_odds_stationary : float
        Log evidence of a detected step for a mode that stands still against one that moves. Handling a phone makes
        about 16 false detections a minute, walking 110 true ones: log(16 / 110).
    window_hop_s : float
        Time from one window end to the next.
    noise : MotionNoise
        Of the slow states.
    fix_gate_nis : float
        Fixes with a larger normalised innovation squared in every mode are rejected: chi-square with two degrees
        of freedom keeps 99.9 % of good ones below 13.8.
    scalar_gate_nis : float
        The same for headings and speeds, one degree of freedom.
    frame : {"start", "world"}
        Where fixes are: in the frame of the track, which starts at the origin, or in another one whose origin and north
        are not known to the track before some fixes have shown them.
    backend : {"numpy", "filterpy", "numba"}
        Whose arithmetic the `imm` weighting uses; all give the same track. filterpy's is many times slower; compiled by
        numba (extra `fast`) it is for cohorts (`pdr_filter.imm_compiled`), one track gains nothing.
    """

    modes: tuple[Mode, ...]
    transition_prob: FloatArray
    weighting: str = "imm"
    wc_threshold: float = 0.8
    evidence_exponent: float = 1.0
    prior_exponent: float = 0.2
    evidence_floor: float = 0.01
    step_log_odds_stationary: float = -1.9
    window_hop_s: float = 1.0
    noise: MotionNoise = field(default_factory=MotionNoise)
    fix_gate_nis: float = 13.8
    scalar_gate_nis: float = 10.8
    frame: str = "start"
    backend: str = "numpy"

    def __post_init__(self) -> None:
        if self.weighting not in WEIGHTINGS:
            raise ValueError(f"weighting must be one of {WEIGHTINGS}, got {self.weighting!r}")
        if self.frame not in _FRAMES:
            raise ValueError(f"frame must be one of {_FRAMES}, got {self.frame!r}")
        if self.backend not in _BACKENDS:
            raise ValueError(f"backend must be one of {tuple(_BACKENDS)}, got {self.backend!r}")
        self._check_numbers()
        names = [m.name for m in self.modes]
        if len(set(names)) < len(names):
            raise ValueError(f"mode names must be distinct, got {names}")
        imm.check_transition_prob(self.transition_prob, len(self.modes))
        contexts = [m.context for m in self.modes]
        if self.weighting != "imm" and sorted(contexts) != sorted(CONTEXTS):
            raise ValueError(
                f"weighting {self.weighting!r} needs exactly one mode for each of {CONTEXTS}, got {contexts}; "
                'use weighting="imm" for other modes'
            )

    def _check_numbers(self) -> None:
        if not self.modes:
            raise ValueError("modes must hold one mode at least, got none")
        for name in ("evidence_exponent", "prior_exponent", "wc_threshold", "fix_gate_nis", "scalar_gate_nis"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name} must be 0 or more, got {getattr(self, name)}")
        if not 0 <= self.evidence_floor < 1:
            raise ValueError(f"evidence_floor must be at least 0 and below 1, got {self.evidence_floor}")
        if not 0 < self.window_hop_s < np.inf:
            raise ValueError(f"window_hop_s must be positive, got {self.window_hop_s}")
        if not np.isfinite(self.step_log_odds_stationary):
            raise ValueError(f"step_log_odds_stationary must be finite, got {self.step_log_odds_stationary}")

    @cached_property
    def _imm(self) -> ModuleType:
        # filterpy takes a second to import, numba another one: only where they are asked for
        return import_module(_BACKENDS[self.backend])

    @cached_property
    def _lengths(self) -> StepLengths:
        return StepLengths(tuple(m.step_length for m in self.modes))

    @cached_property
    def _residual_var_m2(self) -> FloatArray:
        return np.array([m.step_length.residual_std_m**2 for m in self.modes])

    @cached_property
    def _directions(self) -> Directions:
        return Directions.of(self.modes)

    @cached_property
    def _offset_vectors(self) -> FloatArray:
        offset_rad = self._directions.heading_offset_rad
        return np.column_stack([np.sin(offset_rad), np.cos(offset_rad)])

    @cached_property
    def _moves(self) -> FloatArray:
        return np.array([float(m.moves) for m in self.modes])

    @cached_property
    def _stands(self) -> FloatArray:
        # Irregular modes are not among them: a phone in somebody's fingers makes steps as often as walking does.
        return np.array([float(m.context == "stationary") for m in self.modes])

    @cached_property
    def _evidence(self) -> ModeEvidence:
        return ModeEvidence(
            tuple(m.context for m in self.modes),
            tuple(m.carrying_mode for m in self.modes),
            self.evidence_exponent,
            self.prior_exponent,
            self.evidence_floor,
            self.window_hop_s,
        )

    def init(self) -> TrackerState:
        """State at the origin; modes as probable as the transitions make them in the long run."""
        n_filters = len(self.modes) if self.weighting == "imm" else 1
        mean, cov = initial_estimate(self.noise)
        return TrackerState(
            mean=np.tile(mean, (n_filters, 1)),
            cov=np.tile(cov, (n_filters, 1, 1)),
            # from an even start: a chain that cannot mix keeps what it started with
            mode_prob=np.linalg.matrix_power(self.transition_prob, 1024).mean(axis=0),
            windows=(),
            used=None,
            shared_m=np.zeros((2 + len(self.modes), 2)),
            last_step_s=np.nan,
            speed=None,
            frame_rad=0.0,
            frame_since_s=np.inf,
            trail=np.empty((0, 4)),
            anchors=(),
            alignment=None,
            knows_north=False,
            standstills=(),
            pending=(),
            n_final=0,
            rejected_fixes=0,
        )

    def on_window(self, state: TrackerState, window: WindowContext) -> tuple[TrackerState, list[StepUpdate]]:
        """New state, and the steps that this window made final."""
        if not np.isfinite(window.prob).all():
            return self._settle(state, force=False)  # it says nothing
        kept = (w for w in state.windows if w.time_s > window.time_s - _WINDOW_MEMORY_S)
        state = replace(state, windows=(*kept, window))
        return self._settle(state, force=False)

    def on_step(self, state: TrackerState, step: Step) -> tuple[TrackerState, list[StepUpdate]]:
        """New state and the updates of this step (and of earlier ones that it made final)."""
        if np.isinf(state.frame_since_s) and np.isfinite(step.walking_direction_std_rad):
            first_rad = float(wrap_angle(step.walking_direction_rad - step.device_heading_rad))
            cov = expect_first_direction(state.cov, step.walking_direction_std_rad)
            state = replace(state, frame_rad=first_rad, frame_since_s=step.time_s, cov=cov)
        if self.weighting == "imm":
            return self._imm_step(state, step)
        state, final = self._settle(replace(state, pending=(*state.pending, step)), force=False)
        return state, [*final, *self._provisional(state)[-1:]]

    def on_gap(self, state: TrackerState, gap_s: float) -> tuple[TrackerState, list[StepUpdate]]:
        """New state after a time without samples: windows start afresh, positions and headings are less known."""
        state, updates = self._settle(state, force=True)
        # The gap's own growth stands for the time since the last step.
        cov = grow_over_gap(state.cov, gap_s, self.noise)
        # For the carrying mode the gap was no time: what lasts over it was not followed through it.
        used = replace(state.used, time_s=state.used.time_s + gap_s) if state.used else None
        return replace(state, cov=cov, windows=(), used=used, last_step_s=np.nan, speed=None), updates

    def on_fix(self, state: TrackerState, fix: Fix) -> tuple[TrackerState, float]:
        """New state after a fix, and its normalised innovation squared in the mode that explains it best.

        A fix that no mode can explain, or that is older than the remembered steps, is rejected and counted. In the
        frame "world" the first position fixes are kept until they show where the track is and which way is north.
        """
        if isinstance(fix, Standstill):
            return replace(state, standstills=(*state.standstills, (fix.time_s, fix.end_s))[-MAX_STANDSTILLS:]), np.nan
        if isinstance(fix, SpeedFix):
            return self._on_speed(state, fix)
        if isinstance(fix, HeadingFix):
            return self._on_heading(state, fix)
        if self.frame == "world" and state.alignment is None:
            return self._on_anchor(state, fix), np.nan
        return self._on_position(state, fix)

    def _on_position(self, state: TrackerState, fix: PositionFix) -> tuple[TrackerState, float]:
        """The fix is compared with where the track was at the fix's own time, and corrects the present by it.

        An approximation: the heading's part in what was walked since is not corrected anew.
        """
        then = self._then(state, fix.time_s)
        if then is None:
            return _rejected(state), np.inf
        since_m = state.trail[-1, 1:3] - then[:2] if len(state.trail) else np.zeros(2)
        # what was walked since is known as well as a person's step length is
        R = fix.cov_m2 + (self.noise.log_scale_std**2 * float(since_m @ since_m)) * np.eye(2)
        cov = state.cov.copy()
        cov[:, :2, :2] += _shared_cov(state)
        return self._update(state, cov, fix.position_m + since_m, np.eye(2, N_STATES), R, self.fix_gate_nis)

    def _on_heading(self, state: TrackerState, fix: HeadingFix) -> tuple[TrackerState, float]:
        """Z = device heading then + heading offset + the mode's own; where no north is known yet, it defines it."""
        then = self._then(state, fix.time_s)
        if then is None:
            return _rejected(state), np.inf
        if len(state.trail) == 0:
            return state, np.nan
        prob = state.mode_prob if self.weighting == "imm" else np.ones(1)
        innovation = fix.walking_heading_rad - then[2] - state.mean[:, HEADING_OFFSET]
        if self.weighting == "imm":
            innovation = innovation - self._directions.heading_offset_rad
        innovation = wrap_angle(innovation)
        if self.frame == "world" and state.alignment is None and not state.knows_north:
            angle_rad = float(np.arctan2(prob @ np.sin(innovation), prob @ np.cos(innovation)))
            turn = Alignment(angle_rad, fix.std_rad**2, np.zeros(2), np.zeros(2), 0.0, state.n_final)
            return replace(_moved(state, turn), knows_north=True), np.nan
        z = state.mean[:, HEADING_OFFSET] + innovation
        H = np.eye(N_STATES)[[HEADING_OFFSET]]
        return self._update_each(state, z, H, fix.std_rad**2)

    def _on_speed(self, state: TrackerState, fix: SpeedFix) -> tuple[TrackerState, float]:
        """Log z - log v = error of the log scale, v the smoothed speed of the present bout, to first order."""
        if state.speed is None or state.speed.smoothed_mps <= 0:
            return state, np.nan
        v = state.speed.smoothed_mps
        variance = (fix.std_mps / v) ** 2 + state.speed.level_var_m2ps2 / v**2
        z = state.mean[:, LOG_SCALE] + np.log(fix.speed_mps / v)
        return self._update_each(state, z, np.eye(N_STATES)[[LOG_SCALE]], variance)

    def _update_each(
        self, state: TrackerState, z: FloatArray, H: FloatArray, variance: float
    ) -> tuple[TrackerState, float]:
        """State after a measurement of one number whose value z (M,) is another one for each mode."""
        results = [
            self._imm.update(state.mean[k : k + 1], state.cov[k : k + 1], z[k : k + 1], H, np.array([[variance]]))
            for k in range(len(z))
        ]
        mean, cov, log_likelihood, nis = (np.concatenate([r[i] for r in results]) for i in range(4))
        return self._taken(state, mean, cov, log_likelihood, nis, self.scalar_gate_nis)

    def _update(
        self, state: TrackerState, cov: FloatArray, z: FloatArray, H: FloatArray, R: FloatArray, gate_nis: float
    ) -> tuple[TrackerState, float]:
        mean, cov, log_likelihood, nis = self._imm.update(state.mean, cov, z, H, R)
        state, best = self._taken(state, mean, cov, log_likelihood, nis, gate_nis)
        return (state if best > gate_nis else replace(state, shared_m=np.zeros_like(state.shared_m))), best

    def _taken(
        self,
        state: TrackerState,
        mean: FloatArray,
        cov: FloatArray,
        log_likelihood: FloatArray,
        nis: FloatArray,
        gate_nis: float,
    ) -> tuple[TrackerState, float]:
        """State after an update, or without it if no mode explains the measurement."""
        best = float(nis.min())
        if not best <= gate_nis:
            return _rejected(state), best
        prob = state.mode_prob
        if self.weighting == "imm":
            prob = self._imm.update_mode_prob(prob, log_likelihood)
        before_m, _ = present_position(state)
        state = replace(state, mean=mean, cov=cov, mode_prob=prob)
        trail = state.trail.copy()
        trail[:, 1:3] += present_position(state)[0] - before_m
        return replace(state, trail=trail), best

    def _on_anchor(self, state: TrackerState, fix: PositionFix) -> TrackerState:
        """State with one more fix to align with, or aligned."""
        then = self._then(state, fix.time_s)
        if then is None:
            return _rejected(state)
        anchor = Anchor(read_only(then[:2]), fix.position_m, 0.5 * float(np.trace(fix.cov_m2)))
        anchors = with_anchor(state.anchors, anchor)
        alignment = align(anchors, state.n_final)
        if alignment is None:
            return replace(state, anchors=anchors)
        return replace(_moved(state, alignment), anchors=(), alignment=alignment)

    def _then(self, state: TrackerState, time_s: float) -> FloatArray | None:
        """East, north and device heading (3,) at a time; None if the time is no longer remembered."""
        if len(state.trail) == 0:
            return np.zeros(3)
        if time_s < state.trail[0, 0] and len(state.trail) == TRAIL_STEPS:
            return None
        return np.array([np.interp(time_s, state.trail[:, 0], state.trail[:, k]) for k in (1, 2, 3)])

    @property
    def fix_delay_s(self) -> float:
        """Time after a step's detection until it is final: two windows with `hc` and `wc`, none with `imm`."""
        return 0.0 if self.weighting == "imm" else 2 * self.window_hop_s

    def finish(self, state: TrackerState) -> tuple[TrackerState, list[StepUpdate]]:
        """New state with every waiting step final: no further window will come."""
        return self._settle(state, force=True)

    # --- IMM ---------------------------------------------------------------------------------------------------

    def prediction(self, state: TrackerState, step: Step) -> StepPrediction:
        """What a step does to the modes of the `imm`, before evidence."""
        known, known_cov = _learn_heading(state, step)
        mean, cov, prob = self._imm.mix(known, known_cov, state.mode_prob, self.transition_prob)
        length, variance, parameter_std = self._predicted_lengths(step)
        predicted, F, Q = linearise(
            mean, step, length, self._residual_var_m2, self._directions, self.noise, _elapsed_s(state, step)
        )
        return StepPrediction(known, known_cov, mean, cov, prob, predicted, F, Q, length, variance, parameter_std)

    def _predicted_lengths(self, step: Step) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Lengths, their variances, and the standard deviations that the parameters alone make of them, (M,) each.

        Modes that move nobody have length zero.
        """
        length, variance = self._lengths.predict(step)
        parameter_var = self._moves * np.maximum(variance - self._residual_var_m2, 0.0)
        return self._moves * length, self._residual_var_m2 + parameter_var, np.sqrt(parameter_var)

    def _imm_step(self, state: TrackerState, step: Step) -> tuple[TrackerState, list[StepUpdate]]:
        ahead = self.prediction(state, step)
        mean, prob, length, variance = ahead.predicted, ahead.mode_prob, ahead.length_m, ahead.length_var_m2
        cov = bound_heading_variance(ahead.F @ ahead.mixed_cov @ ahead.F.transpose(0, 2, 1) + ahead.Q)
        window = self._window_of(state, step)
        evidence = self.step_log_odds_stationary * self._stands
        if window is not None and (state.used is None or window.time_s > state.used.time_s):
            evidence = evidence + self._evidence.of(window, state.used)
        if _known_to_stand(state, step):
            evidence = evidence - _STANDSTILL_LOG_EVIDENCE * self._moves
        prob = self._imm.update_mode_prob(prob, evidence)
        state = replace(
            state,
            mean=mean,
            cov=cov,
            mode_prob=prob,
            used=window or state.used,
            n_final=state.n_final + 1,
        )
        x, P = self._imm.combine(mean, cov, prob)
        # The length and direction of the step itself; evidence also moves the combined position, which is no walking.
        scale = np.exp(ahead.mixed[:, LOG_SCALE])  # the person's at this step, before it is forgotten a little
        length_m = float(prob @ (length * scale))
        heading_rad = step.device_heading_rad + float(x[HEADING_OFFSET] + self._mean_offset(prob))
        length_var_m2 = max(float(prob @ (variance + length**2)) - float(prob @ length) ** 2, 0.0)
        speed = _speed(state, step, length_m, length_var_m2, float(P[LOG_SCALE, LOG_SCALE]))
        state = _remember(replace(state, speed=speed), step, x)
        own_rad = step.device_heading_rad + mean[:, HEADING_OFFSET] + self._directions.heading_offset_rad
        parameter_m = prob * ahead.parameter_std_m * scale
        state = _with_shared(state, P, length_m, heading_rad, parameter_m, own_rad)
        update = StepUpdate(
            index=state.n_final - 1,
            step=step,
            is_final=True,
            position_m=read_only(x[:2]),
            position_cov_m2=_position_cov(P, state),
            step_length_m=length_m,
            walking_heading_rad=heading_rad,
            speed=speed,
            context_prob=read_only(window.prob if window else self._latest_context(state)),
            mode_prob=read_only(prob),
        )
        return state, [update]

    def _window_of(self, state: TrackerState, step: Step) -> WindowContext | None:
        """The last window that has the step's contact in it or before it: later ones belong to later steps."""
        return next((w for w in reversed(state.windows) if w.time_s <= step.time_s + self.window_hop_s), None)

    def _mean_offset(self, prob: FloatArray) -> float:
        sine, cosine = prob @ self._offset_vectors
        return float(np.arctan2(sine, cosine)) if sine * sine + cosine * cosine > 1e-18 else 0.0

    def _latest_context(self, state: TrackerState) -> FloatArray:
        if state.windows:
            return state.windows[-1].prob
        # before the first window: what the modes say, summed over those of one context
        prob = [sum(p for m, p in zip(self.modes, state.mode_prob, strict=True) if m.context == c) for c in CONTEXTS]
        total = sum(prob)  # less than one beside irregular modes
        return np.array(prob) / total if total > 0 else np.full(len(CONTEXTS), 1 / len(CONTEXTS))

    # --- HC and WC ---------------------------------------------------------------------------------------------

    def _settle(self, state: TrackerState, force: bool) -> tuple[TrackerState, list[StepUpdate]]:
        """Make steps final, in order, whose own window is known (or all, if no further window will come)."""
        updates: list[StepUpdate] = []
        while state.pending:
            step = state.pending[0]
            own = self._window_at(state, step.time_s + self.window_hop_s)
            # where windows do not come, steps wait no longer than windows are remembered
            waits = state.pending[-1].time_s - step.time_s <= _WINDOW_MEMORY_S
            if own is None and waits and not force:
                break
            state, update = self._weighted_step(state, step, is_final=True)
            updates.append(update)
        return state, updates

    def _provisional(self, state: TrackerState) -> list[StepUpdate]:
        """Updates of the waiting steps, one after the other, with what is known now."""
        updates: list[StepUpdate] = []
        while state.pending:
            state, update = self._weighted_step(state, state.pending[0], is_final=False)
            updates.append(update)
        return updates

    def _weighted_step(self, state: TrackerState, step: Step, is_final: bool) -> tuple[TrackerState, StepUpdate]:
        """The waiting step with the mean of its provisional and final weights: the (d + pd) / 2 of the algorithms."""
        provisional = self._context_at(state, step.time_s)
        final = self._context_at(state, step.time_s + self.window_hop_s) if is_final else provisional
        threshold = HC if self.weighting == "hc" else self.wc_threshold
        weights = 0.5 * (context_weights(provisional, threshold) + context_weights(final, threshold))
        weights = weights[[CONTEXTS.index(m.context) for m in self.modes]]
        if _known_to_stand(state, step):
            weights = 1.0 - self._moves
        length, variance, parameter_std = self._predicted_lengths(step)
        mean_length = float(weights @ length)
        mixture_var = max(float(weights @ (variance + length**2)) - mean_length**2, 0.0)
        own_var = max(mixture_var - float(weights @ parameter_std**2), 0.0)
        directions = self._directions.weighted(weights)
        mean, cov = _learn_heading(state, step)
        scale = float(np.exp(mean[0, LOG_SCALE]))
        mean, cov = advance(
            mean,
            cov,
            step,
            np.array([mean_length]),
            np.array([own_var]),
            directions,
            self.noise,
            _elapsed_s(state, step),
        )
        length_m = mean_length * scale
        heading_rad = step.device_heading_rad + float(mean[0, HEADING_OFFSET] + directions.heading_offset_rad[0])
        speed = _speed(state, step, length_m, mixture_var, float(cov[0, LOG_SCALE, LOG_SCALE]))
        state = replace(state, mean=mean, cov=cov, pending=state.pending[1:], n_final=state.n_final + 1, speed=speed)
        state = _remember(state, step, mean[0])
        own_rad = np.full(len(self.modes), heading_rad)
        state = _with_shared(state, cov[0], length_m, heading_rad, weights * parameter_std * scale, own_rad)
        update = StepUpdate(
            index=state.n_final - 1,
            step=step,
            is_final=is_final,
            position_m=read_only(mean[0, :2]),
            position_cov_m2=_position_cov(cov[0], state),
            step_length_m=length_m,
            walking_heading_rad=heading_rad,
            speed=speed,
            context_prob=read_only(0.5 * (provisional + final)),
            mode_prob=read_only(weights),
        )
        return replace(state, mode_prob=weights) if is_final else state, update

    def _window_at(self, state: TrackerState, time_s: float) -> WindowContext | None:
        """The first window that ends at or after a time, if it is known."""
        return next((w for w in state.windows if w.time_s >= time_s), None)

    def _context_at(self, state: TrackerState, time_s: float) -> FloatArray:
        """Probabilities of the first window that ends at or after a time; else of the latest; else those so far."""
        window = self._window_at(state, time_s)
        return window.prob if window is not None else self._latest_context(state)


def even_transitions(n_modes: int, stay_prob: float) -> FloatArray:
    """Transition matrix (M, M) that stays with one probability and leaves for every other mode alike."""
    if not 0 <= stay_prob <= 1:
        raise ValueError(f"stay_prob must be in [0, 1], got {stay_prob}")
    if n_modes == 1:
        return np.ones((1, 1))
    leave = (1 - stay_prob) / (n_modes - 1)
    return np.full((n_modes, n_modes), leave) + (stay_prob - leave) * np.eye(n_modes)


def present_position(state: TrackerState) -> tuple[FloatArray, FloatArray]:
    """Position (2,) and covariance (2, 2) of the final estimate."""
    prob = state.mode_prob if len(state.mean) > 1 else np.ones(1)
    x, P = imm.combine(state.mean, state.cov, prob)
    return x[[EAST, NORTH]], _position_cov(P, state)


def _position_cov(P: FloatArray, state: TrackerState) -> FloatArray:
    cov = P[:2, :2] + _shared_cov(state)
    return read_only(0.5 * (cov + cov.T))


def _shared_cov(state: TrackerState) -> FloatArray:
    """What the errors that all steps share add to the position's covariance, (2, 2)."""
    return state.shared_m.T @ state.shared_m


def _elapsed_s(state: TrackerState, step: Step) -> float:
    """Time since the step before, or the step's own duration for the first of a segment."""
    return step.duration_s if np.isnan(state.last_step_s) else step.time_s - state.last_step_s


def _rejected(state: TrackerState) -> TrackerState:
    return replace(state, rejected_fixes=state.rejected_fixes + 1)


def _known_to_stand(state: TrackerState, step: Step) -> bool:
    """Whether the person is known to have stood at a step's contact."""
    return any(begin_s <= step.time_s <= end_s for begin_s, end_s in state.standstills)


def _moved(state: TrackerState, alignment: Alignment) -> TrackerState:
    """State in another frame."""
    mean, cov = moved(state.mean, state.cov, alignment)
    trail = state.trail.copy()
    trail[:, 1:3] = alignment.positions(state.trail[:, 1:3])
    return replace(
        state,
        mean=mean,
        cov=cov,
        trail=trail,
        frame_rad=state.frame_rad - alignment.angle_rad,
        shared_m=state.shared_m @ alignment.rotation.T,
        anchors=tuple(replace(a, track_m=read_only(alignment.positions(a.track_m))) for a in state.anchors),
    )


def _learn_heading(state: TrackerState, step: Step) -> tuple[FloatArray, FloatArray]:
    """Means and covariances with the walking direction of a step; that of the first one is in the frame already."""
    if step.time_s <= state.frame_since_s:
        step = replace(step, walking_direction_std_rad=np.inf)
    return learn_heading(state.mean, state.cov, step, state.frame_rad)


def _speed(
    state: TrackerState, step: Step, length_m: float, length_var_m2: float, log_scale_var: float
) -> WalkingSpeed:
    """Speed after a step; a pause before it starts the smoothed speed afresh."""
    pause = np.isnan(state.last_step_s) or step.time_s - state.last_step_s > 1.5 * step.duration_s
    return after_step(None if pause else state.speed, length_m, length_var_m2, step.duration_s, log_scale_var)


def _remember(state: TrackerState, step: Step, x: FloatArray) -> TrackerState:
    """State after a step that led to mean x (4,): its time and its place."""
    place = np.array([[step.time_s, x[EAST], x[NORTH], step.device_heading_rad]])
    return replace(state, last_step_s=step.time_s, trail=np.concatenate([state.trail, place])[-TRAIL_STEPS:])


def _with_shared(
    state: TrackerState,
    P: FloatArray,
    length_m: float,
    heading_rad: float,
    parameter_m: FloatArray,
    own_heading_rad: FloatArray,
) -> TrackerState:
    """State with a step's part of the errors that all steps share: they add up as vectors, not as variances.

    Rows: what the linear covariance P (4, 4) does not know along and across the step, of length and direction given
    (`motion.second_order_errors`); then for each mode what the parameters of its length model make of the step
    (`parameter_m` (M,), weighted by the mode's probability), in the mode's own direction. The parameters are off once a
    person: taken anew at each step, as if they were noise, a run of 300 steps would be ten times too sure.
    """
    along_m, across_m = second_order_errors(float(P[HEADING_OFFSET, HEADING_OFFSET]), float(P[LOG_SCALE, LOG_SCALE]))
    sine, cosine = np.sin(heading_rad), np.cos(heading_rad)
    shared_m = state.shared_m.copy()
    shared_m[0] += length_m * along_m * np.array([sine, cosine])
    shared_m[1] += length_m * across_m * np.array([cosine, -sine])
    shared_m[2:] += parameter_m[:, None] * np.column_stack([np.sin(own_heading_rad), np.cos(own_heading_rad)])
    return replace(state, shared_m=shared_m)
