"""Figures of tracks and calibrations. Functions draw into given axes or into a new figure, and return the axes.

`save` writes the figure of the axes to a file. PDF and SVG files are vector graphics with embedded fonts. Figures
belong to no window and to no pyplot state, so that they need not be closed.
"""
# ruff: noqa: E402 - the next call must come before the modules, which import matplotlib

from pdr_filter.values.optional_packages import load_optional

load_optional("matplotlib")

from pdr_filter.apps.report.plot.calibration_plots import calibration as calibration
from pdr_filter.apps.report.plot.calibration_plots import people as people
from pdr_filter.apps.report.plot.calibration_plots import residuals as residuals
from pdr_filter.apps.report.plot.consistency import nees as nees
from pdr_filter.apps.report.plot.consistency import reliability as reliability
from pdr_filter.apps.report.plot.figures import save as save
from pdr_filter.apps.report.plot.floor_plan_plots import draw_storey as draw_storey
from pdr_filter.apps.report.plot.floor_plan_plots import plan as plan
from pdr_filter.apps.report.plot.walk_plots import contexts as contexts
from pdr_filter.apps.report.plot.walk_plots import heights as heights
from pdr_filter.apps.report.plot.walk_plots import step_lengths as step_lengths
from pdr_filter.apps.report.plot.walk_plots import track as track
from pdr_filter.apps.report.plot.walk_plots import way as way
