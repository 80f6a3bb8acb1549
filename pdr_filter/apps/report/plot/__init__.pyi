# The public names: this list is read when the package is imported, and by type checkers.

from .calibration_plots import calibration as calibration
from .calibration_plots import people as people
from .calibration_plots import residuals as residuals
from .consistency import nees as nees
from .consistency import reliability as reliability
from .figures import save as save
from .floor_plan_plots import draw_storey as draw_storey
from .floor_plan_plots import plan as plan
from .walk_plots import contexts as contexts
from .walk_plots import heights as heights
from .walk_plots import step_lengths as step_lengths
from .walk_plots import track as track
from .walk_plots import way as way
