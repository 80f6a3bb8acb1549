"""Figures for papers: functions that draw into axes that are given, or into a new figure.

Each returns its axes; `save` writes their figure, as PDF or SVG in vector form with its fonts. Figures belong to no
window and to no pyplot state, so nothing has to be closed.
"""

from pdr_filter.plot.consistency import nees as nees
from pdr_filter.plot.consistency import reliability as reliability
from pdr_filter.plot.figures import save as save
from pdr_filter.plot.people import calibration as calibration
from pdr_filter.plot.people import people as people
from pdr_filter.plot.people import residuals as residuals
from pdr_filter.plot.plans import draw_storey as draw_storey
from pdr_filter.plot.plans import plan as plan
from pdr_filter.plot.walks import contexts as contexts
from pdr_filter.plot.walks import heights as heights
from pdr_filter.plot.walks import step_lengths as step_lengths
from pdr_filter.plot.walks import track as track
from pdr_filter.plot.walks import way as way
