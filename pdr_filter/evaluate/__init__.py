"""Figures that say how good a step detector, a classifier, a distance, a track, a covariance is: functions on arrays.

`comparison` knows recordings and tracks; it makes tables for several tracks of one recording. Only `runs` runs the
filter.
"""

from pdr_filter.evaluate.classification import (
    accuracy,
    brier_score,
    calibration_error,
    class_table,
    confusion_matrix,
    kappa,
    log_loss,
    macro_recall,
    precision,
    recall,
)
from pdr_filter.evaluate.comparison import (
    comparison_table,
    in_truth_frame,
    second_over_first,
    straight_leg_error_percent,
)
from pdr_filter.evaluate.consistency import ellipse_coverage, mean_bounds, nees, nis
from pdr_filter.evaluate.distance import DistanceScores, distance_scores, distance_table, percent_error, walked_m
from pdr_filter.evaluate.runs import epoch_distances, threshold_sweep, weighting_tracks
from pdr_filter.evaluate.steps import (
    StepScores,
    best_offset_s,
    count_error_percent,
    f1_score,
    matched_steps,
    step_scores,
)
from pdr_filter.evaluate.tables import Markdown, markdown
from pdr_filter.evaluate.tracks import (
    aligned,
    axis_rmse_m,
    directions_rad,
    end_error_percent,
    first_of_path,
    fitted,
    heading_errors_rad,
    moved_m,
    path_m,
    position_errors_m,
    position_rmse_m,
    positions_at,
    relative_error_m,
    rigid_fit,
)

__all__ = [
    "DistanceScores",
    "Markdown",
    "StepScores",
    "accuracy",
    "aligned",
    "axis_rmse_m",
    "best_offset_s",
    "brier_score",
    "calibration_error",
    "class_table",
    "comparison_table",
    "confusion_matrix",
    "count_error_percent",
    "directions_rad",
    "distance_scores",
    "distance_table",
    "ellipse_coverage",
    "end_error_percent",
    "epoch_distances",
    "f1_score",
    "first_of_path",
    "fitted",
    "heading_errors_rad",
    "in_truth_frame",
    "kappa",
    "log_loss",
    "macro_recall",
    "markdown",
    "matched_steps",
    "mean_bounds",
    "moved_m",
    "nees",
    "nis",
    "path_m",
    "percent_error",
    "position_errors_m",
    "position_rmse_m",
    "positions_at",
    "precision",
    "recall",
    "relative_error_m",
    "rigid_fit",
    "second_over_first",
    "step_scores",
    "straight_leg_error_percent",
    "threshold_sweep",
    "walked_m",
    "weighting_tracks",
]
