"""mobgap (Mobilise-D): initial contacts, stride length, walking speed, and the pipeline for healthy people.

Built and validated for a sensor fixed to the lower back. Everything is at its defaults; contacts are looked for inside
the walk, which the detectors require, or in the gait sequences that the pipeline finds by itself.
"""

from __future__ import annotations

import warnings
from functools import partial
from typing import Any

import numpy as np

from .walks import RATE_HZ, Found, Method, Run, Walk

# Height of the lower back over that of the person, as in S. Del Din et al. 2016, doi:10.1109/JBHI.2015.2419317.
SENSOR_PER_HEIGHT = 0.53


def _frame(walk: Walk, columns: list[str]) -> Any:
    """Data frame of mobgap: up, right, ahead, in m/s2 and degrees a second."""
    import pandas as pd

    force, rate = walk.body
    order = [2, 0, 1]
    return pd.DataFrame(np.hstack([force[:, order], np.degrees(rate[:, order])]), columns=columns)


def _contacts(name: str, with_speed: bool) -> Run:
    from mobgap import initial_contacts
    from mobgap.cadence import CadFromIc
    from mobgap.consts import BF_SENSOR_COLS
    from mobgap.initial_contacts import refine_gs
    from mobgap.stride_length import SlZijlstra
    from mobgap.walking_speed import WsNaive

    detector = getattr(initial_contacts, name)()

    def run(walk: Walk) -> Found:
        data = _frame(walk, BF_SENSOR_COLS).iloc[walk.inside].reset_index(drop=True)
        contacts = detector.clone().detect(data, sampling_rate_hz=RATE_HZ).ic_list_
        time_s = walk.time_s[walk.inside][contacts["ic"].to_numpy(dtype=int).clip(0, len(data) - 1)]
        if len(contacts) < 2 or not with_speed:
            return Found(time_s)
        _, contacts = refine_gs(contacts)
        contacts = contacts.reset_index("r_gs_id", drop=True)
        first = round((time_s[0] - walk.time_s[walk.inside][0]) * RATE_HZ)
        part = data.iloc[first : first + int(contacts["ic"].iloc[-1]) + 1].reset_index(drop=True)
        known = {
            "initial_contacts": contacts,
            "sampling_rate_hz": RATE_HZ,
            "sensor_height_m": SENSOR_PER_HEIGHT * walk.height_m,
        }
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            cadence = CadFromIc().calculate(part, **known).cadence_per_sec_
            stride = SlZijlstra().calculate(part, **known).stride_length_per_sec_
            speed = WsNaive().calculate(part, cadence_per_sec=cadence, stride_length_per_sec=stride, **known)
        per_second = speed.walking_speed_per_sec_["walking_speed_mps"]
        middle_s = time_s[0] + per_second.index.to_numpy() / RATE_HZ
        return Found(time_s, middle_s - 0.5, middle_s + 0.5, per_second.to_numpy(dtype=float))

    return run


def _pipeline() -> Run:
    from mobgap.consts import SF_SENSOR_COLS
    from mobgap.data import GaitDatasetFromData
    from mobgap.pipeline import MobilisedPipelineHealthy

    def run(walk: Walk) -> Found:
        person = {"height_m": walk.height_m, "sensor_height_m": SENSOR_PER_HEIGHT * walk.height_m, "cohort": "HA"}
        dataset = GaitDatasetFromData(
            {"walk": {"LowerBack": _frame(walk, SF_SENSOR_COLS)}},
            RATE_HZ,
            {"walk": person},
            {"walk": {"measurement_condition": "laboratory"}},
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            result = MobilisedPipelineHealthy().run(dataset[0])
        strides = result.per_stride_parameters_
        first_s = walk.time_s[0]
        contacts = np.unique(result.raw_ic_list_["ic"].to_numpy(dtype=float))
        return Found(
            first_s + contacts / RATE_HZ,
            *(first_s + strides[c].to_numpy(dtype=float) / RATE_HZ for c in ("start", "end")),
            strides["walking_speed_mps"].to_numpy(dtype=float),
        )

    return run


_NAMES = ("IcdIonescu", "IcdShinImproved", "IcdHKLeeImproved")
DETECTORS, _WITH_SPEED = (
    tuple(Method(f"mobgap, {n}{what}", "mobgap", partial(_contacts, n, speed), walk_known=True) for n in _NAMES)
    for what, speed in ((", contacts only", False), ("", True))
)
METHODS = (*_WITH_SPEED, Method("mobgap, MobilisedPipelineHealthy", "mobgap", _pipeline))
