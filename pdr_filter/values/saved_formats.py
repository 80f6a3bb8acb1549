"""Earlier formats of saved filters, which are turned into the present one before they are decoded.

Version 0.2.0 saved format 6; formats 1 to 5 were never released. There is one function for each format: it takes a
dataclass of this format, as its name and the nodes of its fields, and returns the node of the next format.
`serialisation` describes the nodes. Filters of formats 7 to 11 continue as in the version that saved them,
but for the counts of the unit check, which may differ by one before format 11. In filters of
format 6, the detections of repeated fixes, of stuck sensors and of motion without steps begin again.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from pdr_filter.values.arrays import FloatArray

_Fields = dict[str, Any]
# Axes of an array, and their lengths, as in NumPy and in the largest file.
_MAX_AXES, _MAX_LENGTH = 32, 64 << 20
_MAX_KEPT = 256  # rows that the clock keeps
# Names in the next format, of classes or of fields. A field whose next name is empty is omitted.
_Names = Mapping[str, str]


def in_present_format(node: Any, number: int, arrays: bytes) -> Any:
    """Return the node of a value that was saved in format `number`, in the present format.

    `arrays` has the bytes of the arrays of format 10 or later.
    """
    for change in (*_CHANGES, partial(_from_10, arrays), _from_11)[number - EARLIER_FORMATS[0] :]:
        node = _changed(node, change)
    return node


def _changed(node: Any, change: Callable[[str, _Fields], Any]) -> Any:
    """Return a node whose dataclasses are changed, from the inside out."""
    if isinstance(node, list):
        return [_changed(part, change) for part in cast(list[Any], node)]
    if not isinstance(node, dict) or "array" in node or "shipped" in node:
        return cast(Any, node)
    node = cast(dict[str, Any], node)
    if "dict" in node:
        return {"dict": {key: _changed(part, change) for key, part in node["dict"].items()}}
    if "dataclass" in node:
        return change(node["dataclass"], {key: _changed(part, change) for key, part in node["fields"].items()})
    return {kind: _changed(parts, change) for kind, parts in node.items()}


def _node(name: str, fields: _Fields) -> dict[str, Any]:
    return {"dataclass": name, "fields": fields}


def _array(values: ArrayLike) -> dict[str, Any]:
    array = np.asarray(values, dtype="<f8")
    return {"array": base64.b64encode(array.tobytes()).decode(), "dtype": "<f8", "shape": list(array.shape)}


def n_values(shape: Sequence[Any]) -> int:
    """Return the number of values of an array. ValueError for large shapes, whose product would take hours."""
    if len(shape) > _MAX_AXES or not all(type(n) is int and 0 <= n <= _MAX_LENGTH for n in shape):
        raise ValueError(f"an array has the shape {str(shape)[:60]}")
    return math.prod(shape)


def _values(node: Mapping[str, Any], arrays: bytes = b"") -> FloatArray:
    """Return the values of an array, whose bytes are text before format 10."""
    position, shape = node["array"], node["shape"]
    if isinstance(position, str):
        arrays, position = base64.b64decode(position, validate=True), 0
    return np.frombuffer(arrays, "<f8", n_values(shape), position).reshape(shape)


def _next_name(name: str, classes: _Names) -> str:
    """Return the next name of a class. The table has classes without their module, and names without the package."""
    inside = name.removeprefix("pdr_filter.")
    cls = inside.partition(":")[2]
    return f"pdr_filter.{classes[cls]}" if inside != name and cls in classes else name


def _renamed(fields: _Fields, names: _Names) -> _Fields:
    return {names.get(key, key): value for key, value in fields.items() if names.get(key, key)}


# --- from format 6 to 7: names in plain English -----------------------------------------------------------------------

_CLASSES_6 = {
    "Doubt": "filter.fixes.relocation:RelocationEvidence",
    "OpenTurn": "filter.fixes.frame_rotation:RotationDensity",
    "Known": "filter.height.height_filter:HeightEstimate",
    "Second": "filter.height.height_filter:PressureSecond",
    "Back": "filter.imm.past_path:BackwardRelation",
    "Ride": "filter.fixes.rides:Ride",
    "Rides": "filter.fixes.rides:Rides",
    "Former": "sensing.heading.walking_heading:PreviousPlacement",
    "EvenSteps": "sensing.steps.contact_time_smoothing:ContactTimeSmoothing",
    "EvenStepsState": "sensing.steps.contact_time_smoothing:ContactTimeSmoothingState",
    "Rattle": "sensing.vehicle_vibration:VehicleVibration",
    "RattleState": "sensing.vehicle_vibration:VehicleVibrationState",
}
_FIELDS_6: Mapping[str, _Names] = {
    "FixHistory": {"doubt": "relocation", "seen": ""},
    "Frame": {"turn": "rotation"},
    "LocationState": {"n_nowhere": "n_without_place", "n_vague": "n_without_accuracy"},
    "Ride": {"way_m": "length_m"},
    "Back": {"left": "error_cov", "moved": "correction"},
    "ClockState": {"moving": "is_running", "n_deaf": "n_rejected_times"},
    "IntakeReport": {"n_deaf": "n_rejected_times"},
    "Sensing": {"even": "contact_smoothing"},
    "SensingState": {"even": "contact_smoothing", "rattle": "vibration"},
    "WalkingHeadingState": {
        "error_rad": "error_at_restart_rad",
        "error_of_bias_rad": "bias_error_at_restart_rad",
        "of_bias_rad": "bias_error_rad",
        "of_bias_var_rad2": "bias_error_var_rad2",
        "formers": "previous_places",
    },
    "RattleState": {"waiting_mps2": "", "run_s": ""},
    "ParticleState": {"way": "reckoned", "doubt": "lost_log_odds"},
    "State": {"n_length_fixes": ""},
    "StepCounts": {"quick_and_soft": ""},
    "WindowCounts": {"stairs_unknown": ""},
}


def _from_6(name: str, fields: _Fields) -> Any:
    cls = name.partition(":")[2]
    fields = _renamed(fields, _FIELDS_6.get(cls, {}))
    if cls == "Blend":
        fields = {"parts": {"tuple": [fields["linear"], fields["trees"]]}}
    elif cls == "Ride":
        fields["is_still"] = False
    elif cls == "PedestrianState" and fields["steps"]["fields"]["n_final"] > 0:
        fields["std_at_start_m"] = 1e6  # no limit, as in version 0.2.0; infinity is for the time before the first step
    elif cls == "WatchdogState":  # as before the first row
        low, high = _array(np.full(9, np.inf)), _array(np.full(9, -np.inf))
        fields = {"n_rows": 0, "low": low, "high": high, "last": _array(np.full(9, np.nan))}
        fields |= {"resolution": _array([np.inf, np.inf]), "turned_rad": _array(np.zeros(3))}
    return _node(_next_name(name, _CLASSES_6), fields)


# --- from format 7 to 8 -----------------------------------------------------------------------------------------------


def _from_7(name: str, fields: _Fields) -> Any:
    return _node(_next_name(name, {"WindowContext": "values.windows:WindowContext"}), fields)


# --- from format 8 to 9: the filter as a chain of handlers ------------------------------------------------------------


def _in(module: str, classes: str) -> Iterable[tuple[str, str]]:
    return ((cls, f"{module}:{cls}") for cls in classes.split())


_CLASSES_8 = {
    **dict(_in("filter.pedestrian.alignment", "Alignment")),
    **dict(_in("filter.pedestrian.fix_history", "FixHistory StandstillSteps UsedFix")),
    **dict(_in("filter.pedestrian.frame", "Frame")),
    **dict(_in("filter.pedestrian.frame_rotation", "Compass PairedPoint RotationDensity")),
    **dict(_in("filter.pedestrian.range_solutions", "PairedRange PriorPose")),
    **dict(_in("filter.pedestrian.relocation", "RelocationEvidence")),
    **dict(_in("filter.pedestrian.repeated_fixes", "FixMemory RecentFix")),
    **dict(_in("filter.pedestrian.past_path", "BackwardRelation PastPath PastSteps WalkedStep")),
    **dict(_in("filter.pedestrian.pedestrian_model", "PedestrianModel")),
    **dict(_in("filter.pedestrian.pedestrian_state", "PedestrianState Rival StepUpdate")),
    **dict(_in("filter.pedestrian.step_history", "StepHistory Walked")),
    **dict(_in("filter.pedestrian.walking_speed", "WalkingSpeed")),
    **dict(_in("filter.pedestrian.person", "LengthFixes Person Session")),
    **dict(_in("filter.imm.step_cycle", "HeadingZero")),
    **dict(_in("filter.chain.imm_tracker", "ImmState ImmTracker")),
    **dict(_in("filter.chain.weighted_tracker", "DetectedStepTracker WeightedState WeightedTracker")),
    **dict(_in("apps.maps.crossing_costs", "Ground Terrain")),
    **dict(_in("apps.maps.floor_plan", "FloorPlan")),
    **dict(_in("apps.maps.particle_filter", "ParticleFilter ParticleState PlanEvent")),
    **dict(_in("apps.maps.start_area", "Start")),
    **dict(_in("apps.maps.storey", "Feature Storey")),
    **dict(_in("values.events", "Climb Gap Stepless Undecided")),
    "Place": "filter.pedestrian.alignment:Pose",
    "SeenPlace": "filter.pedestrian.repeated_fixes:SeenPosition",
    "PlacedTrack": "filter.pedestrian.range_solutions:RangeSolution",
    "KnownPlace": "sensing.heading.walking_heading:KnownPlacement",
}
_FIELDS_8: Mapping[str, _Names] = {
    "LocationState": {"n_without_place": "n_not_on_earth"},
    "PriorPose": {"place_m": "position_m"},
    "RecentFix": {"place": "pose"},
    "Climbing": {"place": "position"},
    "PressureSecond": {"place": "position"},
    "PastSteps": {"place_m": "position_m"},
    "WalkingHeading": {"known_places": "known_placements"},
    "WalkingHeadingState": {"place": "placement", "previous_places": "previous_placements"},
}
_OF_STEPS = ("gate", "contact_smoothing", "heading", "north")


def _from_8(name: str, fields: _Fields) -> Any:
    cls = name.partition(":")[2]
    fields = _renamed(fields, _FIELDS_8.get(cls, {}))
    if cls.endswith("StepLength"):
        fields.pop("n_params", None)
    elif cls == "SensingState" and "of_steps" not in fields:
        stages = {stage: fields.pop(stage) for stage in _OF_STEPS}
        fields["of_steps"] = {"dict": {stage: state for stage, state in stages.items() if state is not None}}
    elif cls == "WalkingHeadingState" and "bias" not in fields:
        names = {"bias_error_rad": "error_rad", "bias_error_var_rad2": "var_rad2", "lost_var_rad2": "lost_var_rad2"}
        bias = {new: fields.pop(old) for old, new in names.items()}
        fields["bias"] = _node("pdr_filter.sensing.heading.walking_heading:BiasError", bias)
    elif cls == "State" and "tracker" in fields:
        fields = _chain_of(fields)
    return _node(_next_name(name, _CLASSES_8), fields)


def _chain_of(state: _Fields) -> _Fields:
    """Return the fields of a state whose tracker, height and particles are states of handlers."""
    chain, filtering = "pdr_filter.filter.chain", "pdr_filter.tracking.filtering"
    take = state.pop

    def with_path(tracker: dict[str, Any]) -> dict[str, Any]:
        path = tracker["fields"]["pedestrian"]["fields"].pop("path")
        return _node(f"{chain}.with_path:PathState", {"inner": tracker, "path": path})

    hypotheses: _Fields = {"inner": with_path(take("tracker"))}
    if (rival := take("rival")) is not None:
        hypotheses["rival"] = with_path(rival["fields"]["tracker"])
        hypotheses["rival_log_odds"] = rival["fields"]["log_odds"]
    if "conflict" in state:
        hypotheses["conflict"] = take("conflict")
    height = {"height": take("height"), "locations": take("places")}
    whole = _node(
        f"{chain}.with_height:HeightTrack",
        {"inner": _node(f"{chain}.two_hypotheses:Hypotheses", hypotheses), **height},
    )
    if (particles := take("particles")) is not None:
        whole = _node(f"{chain}.with_plan:PlanTrack", {"inner": whole, "particles": particles})
    climbs = {"barometer": take("barometer"), "climbs": take("climbs")}
    climbs |= {"n_used": take("n_climbs_used"), "n_lost": take("n_lost_climbs")}
    counts = ("seen", "walked", "rides", "length_fixes", "n_rejected_fixes")
    statistics = {name: take(name) for name in counts if name in state}
    last = {"window": take("window"), "fixes": take("last_fixes"), "update": take("last_update")}
    if "undecided_s" in state:
        last["undecided_s"] = take("undecided_s")
    state |= {"chain": whole, "waiting_climbs": _node(f"{filtering}:WaitingClimbs", climbs)}
    state |= {"statistics": _node(f"{filtering}:Statistics", statistics)}
    return state | {"last": _node(f"{filtering}:LastResults", last)}


# --- from format 9 to 10: arrays as bytes, and the buffer of the heading stage without times --------------------------


def _from_9(name: str, fields: _Fields) -> Any:
    if name.endswith(":WalkingHeadingState"):
        fields["signals"] = _array(_values(fields["signals"])[1:])
    return _node(name, fields)


# --- from format 10 to 11: one number instead of the specific force recognises rows that arrive again ----------------


def _from_10(arrays: bytes, name: str, fields: _Fields) -> Any:
    if name.endswith(":ClockState") and "kept" in fields:  # not in filters of earlier formats
        if n_values(fields["kept"]["shape"]) > 4 * _MAX_KEPT:  # copies of one large array would fill the memory
            raise ValueError("the clock keeps more rows than a filter does")
        time_s, x, y, z = _values(fields["kept"], arrays).T
        # as `sensing.clock.fingerprint`
        fields["kept"] = _array(np.column_stack([time_s, x + math.sqrt(2.0) * y + math.sqrt(3.0) * z]))
    return _node(name, fields)


# --- from format 11 to 12: strides of undecided steps instead of their samples ----------------------------------------


def _from_11(name: str, fields: _Fields) -> Any:
    if name.endswith(":WalkingHeadingState"):  # which has all samples
        fields |= {"saved_bias": _array(np.empty((0, 4))), "saved_strides": _array(np.empty((0, 41)))}
    return _node(name, fields)


_CHANGES = (_from_6, _from_7, _from_8, _from_9)
EARLIER_FORMATS = (6, 7, 8, 9, 10, 11)
