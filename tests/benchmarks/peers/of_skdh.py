"""scikit-digital-health: GaitLumbar, with the walk known or behind its own classifier of gait.

Built for a sensor on the lumbar spine. The vertical axis and the one ahead are given, not estimated; the rest is at its
defaults. Both of its event methods are run.
"""

from __future__ import annotations

import warnings
from functools import partial

import numpy as np
from scipy.signal import resample_poly

from pdr_filter.values import STANDARD_GRAVITY_MPS2

from .walks import RATE_HZ, FloatArray, Found, Method, Run, Walk

RIGHT, AHEAD, UP = range(3)


def _bouts(time_s: FloatArray, force_g: FloatArray) -> FloatArray:
    """First and last sample (B, 2) of what its classifier takes for gait.

    At 50 Hz, which it leaves as they are: samples of 100 Hz it thins to 50 Hz, and then applies a band-pass that it
    designed for 100 Hz. It finds more of the walks this way.
    """
    from skdh.context import PredictGaitLumbarLgbm

    half = resample_poly(force_g, 1, 2)
    bouts = PredictGaitLumbarLgbm().predict(time=time_s[::2], accel=half, fs=RATE_HZ / 2)
    return 2 * np.column_stack([bouts[f"Gait Bout {end} Index"] for end in ("Start", "Stop")])


def _gait(events: str, walk_known: bool) -> Run:
    from skdh.gait import GaitLumbar

    def run(walk: Walk) -> Found:
        gait = GaitLumbar(gait_event_method=events, day_window=None)
        force, rate = walk.body
        part = walk.inside if walk_known else slice(None)
        time_s, force_g, rate = walk.time_s[part], force[part] / STANDARD_GRAVITY_MPS2, rate[part]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            where = {"gait_pred": True}
            if not walk_known:
                where = {"gait_bouts": _bouts(time_s, force_g)}
            result = gait.predict(
                time=time_s,
                accel=force_g,
                gyro=rate,
                fs=RATE_HZ,
                height=walk.height_m,
                v_axis=UP,
                ap_axis=AHEAD,
                **where,
            )
        contact_s = np.asarray(result["IC Timestamp"], dtype=float)
        if "gait speed" not in result:
            return Found(np.sort(contact_s))
        stride_s, speed_mps = (np.asarray(result[k], dtype=float) for k in ("stride time", "gait speed"))
        known = np.isfinite(stride_s) & np.isfinite(speed_mps)
        return Found(np.sort(contact_s), contact_s[known], (contact_s + stride_s)[known], speed_mps[known])

    return run


METHODS = tuple(
    Method(f"skdh, {name}, {events}", "scikit-digital-health", partial(_gait, events, known), walk_known=known)
    for name, known in (("GaitLumbar", True), ("own bouts", False))
    for events in ("AP CWT", "Vertical CWT")
)
