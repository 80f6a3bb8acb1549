"""Evaluation measures for step detectors, classifiers, distances, tracks and covariances.

Most functions take arrays. `comparison` makes tables for several tracks of one recording, and `study` for several
recordings. Only `runs` and `conformance` run the filter.
"""

from pdr_filter.evaluate.classification import accuracy as accuracy
from pdr_filter.evaluate.classification import brier_score as brier_score
from pdr_filter.evaluate.classification import calibration_error as calibration_error
from pdr_filter.evaluate.classification import class_table as class_table
from pdr_filter.evaluate.classification import confusion_matrix as confusion_matrix
from pdr_filter.evaluate.classification import kappa as kappa
from pdr_filter.evaluate.classification import log_loss as log_loss
from pdr_filter.evaluate.classification import macro_recall as macro_recall
from pdr_filter.evaluate.classification import precision as precision
from pdr_filter.evaluate.classification import recall as recall
from pdr_filter.evaluate.comparison import comparison_table as comparison_table
from pdr_filter.evaluate.comparison import in_truth_frame as in_truth_frame
from pdr_filter.evaluate.comparison import leg_error_percent as leg_error_percent
from pdr_filter.evaluate.comparison import second_over_first as second_over_first
from pdr_filter.evaluate.consistency import ellipse_coverage as ellipse_coverage
from pdr_filter.evaluate.consistency import mean_bounds as mean_bounds
from pdr_filter.evaluate.consistency import nees as nees
from pdr_filter.evaluate.consistency import nis as nis
from pdr_filter.evaluate.distance import DistanceScores as DistanceScores
from pdr_filter.evaluate.distance import distance_scores as distance_scores
from pdr_filter.evaluate.distance import distance_table as distance_table
from pdr_filter.evaluate.distance import percent_error as percent_error
from pdr_filter.evaluate.distance import walked_m as walked_m
from pdr_filter.evaluate.runs import epoch_distances as epoch_distances
from pdr_filter.evaluate.runs import threshold_sweep as threshold_sweep
from pdr_filter.evaluate.runs import weighting_errors as weighting_errors
from pdr_filter.evaluate.runs import weighting_tracks as weighting_tracks
from pdr_filter.evaluate.steps import StepScores as StepScores
from pdr_filter.evaluate.steps import best_offset_s as best_offset_s
from pdr_filter.evaluate.steps import count_error_percent as count_error_percent
from pdr_filter.evaluate.steps import f1_score as f1_score
from pdr_filter.evaluate.steps import matched_steps as matched_steps
from pdr_filter.evaluate.steps import step_scores as step_scores
from pdr_filter.evaluate.study import context_errors as context_errors
from pdr_filter.evaluate.study import study_rows as study_rows
from pdr_filter.evaluate.study import study_table as study_table
from pdr_filter.evaluate.tables import Markdown as Markdown
from pdr_filter.evaluate.tables import latex as latex
from pdr_filter.evaluate.tables import markdown as markdown
from pdr_filter.evaluate.tables import write_tables as write_tables
from pdr_filter.evaluate.tracks import aligned as aligned
from pdr_filter.evaluate.tracks import axis_rmse_m as axis_rmse_m
from pdr_filter.evaluate.tracks import directions_rad as directions_rad
from pdr_filter.evaluate.tracks import end_error_percent as end_error_percent
from pdr_filter.evaluate.tracks import first_of_path as first_of_path
from pdr_filter.evaluate.tracks import fitted as fitted
from pdr_filter.evaluate.tracks import heading_errors_rad as heading_errors_rad
from pdr_filter.evaluate.tracks import moved_m as moved_m
from pdr_filter.evaluate.tracks import path_m as path_m
from pdr_filter.evaluate.tracks import position_errors_m as position_errors_m
from pdr_filter.evaluate.tracks import position_rmse_m as position_rmse_m
from pdr_filter.evaluate.tracks import positions_at as positions_at
from pdr_filter.evaluate.tracks import relative_error_m as relative_error_m
from pdr_filter.values import rigid_fit as rigid_fit
