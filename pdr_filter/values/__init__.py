"""Value types that flow between the stages.

They are frozen, their arrays are read-only, and their names contain units.
"""

from pdr_filter.values.angles import circular_mean, heading_from_yaw, wrap_angle, yaw_from_heading
from pdr_filter.values.arrays import (
    BoolArray,
    ComplexArray,
    FloatArray,
    IntArray,
    Table,
    as_floats,
    check_columns,
    check_cov,
    check_transition_prob,
    make_read_only,
    median,
    read_only,
    reduction,
    table,
)
from pdr_filter.values.checks import (
    are_numbers,
    check_array,
    check_number,
    check_numbers,
    check_step_length,
    check_walked,
)
from pdr_filter.values.contexts import (
    CARRYING_MODES,
    CONTEXTS,
    DEFAULT_CONTEXTS,
    Context,
    ContextSet,
    Gait,
    check_name_of_context,
)
from pdr_filter.values.feature_set import (
    WINDOW_SIGNALS,
    FeatureFunction,
    FeatureSet,
    FunctionFeatures,
    JoinedFeatures,
    feature_set_of,
)
from pdr_filter.values.fix_error_correlation import (
    INDEPENDENT_SHARE,
    N_BEFORE,
    error_correlation,
    error_given_before,
    repeated_cov_m2,
)
from pdr_filter.values.fixes import (
    Fix,
    FixOutcome,
    FixResult,
    GridFix,
    HeadingFix,
    Measurement,
    PositionFix,
    RangeFix,
    SpeedFix,
    Standstill,
    all_fixes,
    check_fix,
    has_frame,
    has_position,
    measurement_of,
    range_log_densities,
    range_residuals,
    received_s,
    repetition,
    stated_fixes,
)
from pdr_filter.values.floor_passage import FloorPassage, HowClimbed
from pdr_filter.values.heading_drift import HeadingDrift
from pdr_filter.values.interpolation import interpolated_near, interpolated_rows
from pdr_filter.values.json_values import as_plain
from pdr_filter.values.mixtures import softmax
from pdr_filter.values.notes import Note, NoteSubject
from pdr_filter.values.origin import DECLINATION_STD_RAD, Origin
from pdr_filter.values.plan import Plan
from pdr_filter.values.plan_estimate import Cluster, OnPlan
from pdr_filter.values.plurals import how_many, how_often
from pdr_filter.values.replace import replace_unchecked
from pdr_filter.values.rigid_fit import rigid_fit
from pdr_filter.values.samples import STANDARD_GRAVITY_MPS2, ImuBlock, Samples
from pdr_filter.values.schema import check_declared, check_members, check_whole
from pdr_filter.values.step import HARDLY_AGREE, TRUSTED, Step, reference_headings, step_table, steps_of
from pdr_filter.values.track_rows import TrackRows
from pdr_filter.values.uncertainty import MAX_NORTH_STD_RAD, RADIUS_68, RADIUS_95
from pdr_filter.values.wifi import Wifi, WifiScan, address_text, loudness
from pdr_filter.values.windows import WindowContext, Windows, known_context

__all__ = [
    "CARRYING_MODES",
    "CONTEXTS",
    "DECLINATION_STD_RAD",
    "DEFAULT_CONTEXTS",
    "HARDLY_AGREE",
    "INDEPENDENT_SHARE",
    "MAX_NORTH_STD_RAD",
    "N_BEFORE",
    "RADIUS_68",
    "RADIUS_95",
    "STANDARD_GRAVITY_MPS2",
    "TRUSTED",
    "WINDOW_SIGNALS",
    "BoolArray",
    "Cluster",
    "ComplexArray",
    "Context",
    "ContextSet",
    "FeatureFunction",
    "FeatureSet",
    "Fix",
    "FixOutcome",
    "FixResult",
    "FloatArray",
    "FloorPassage",
    "FunctionFeatures",
    "Gait",
    "GridFix",
    "HeadingDrift",
    "HeadingFix",
    "HowClimbed",
    "ImuBlock",
    "IntArray",
    "JoinedFeatures",
    "Measurement",
    "Note",
    "NoteSubject",
    "OnPlan",
    "Origin",
    "Plan",
    "PositionFix",
    "RangeFix",
    "Samples",
    "SpeedFix",
    "Standstill",
    "Step",
    "Table",
    "TrackRows",
    "Wifi",
    "WifiScan",
    "WindowContext",
    "Windows",
    "address_text",
    "all_fixes",
    "are_numbers",
    "as_floats",
    "as_plain",
    "check_array",
    "check_columns",
    "check_cov",
    "check_declared",
    "check_fix",
    "check_members",
    "check_name_of_context",
    "check_number",
    "check_numbers",
    "check_step_length",
    "check_transition_prob",
    "check_walked",
    "check_whole",
    "circular_mean",
    "error_correlation",
    "error_given_before",
    "feature_set_of",
    "has_frame",
    "has_position",
    "heading_from_yaw",
    "how_many",
    "how_often",
    "interpolated_near",
    "interpolated_rows",
    "known_context",
    "loudness",
    "make_read_only",
    "measurement_of",
    "median",
    "range_log_densities",
    "range_residuals",
    "read_only",
    "received_s",
    "reduction",
    "reference_headings",
    "repeated_cov_m2",
    "repetition",
    "replace_unchecked",
    "rigid_fit",
    "softmax",
    "stated_fixes",
    "step_table",
    "steps_of",
    "table",
    "wrap_angle",
    "yaw_from_heading",
]
