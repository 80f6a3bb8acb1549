# The public names of the package: this list is read when the package is imported, and by type checkers.

from . import batch as batch
from . import datasets as datasets
from . import evaluate as evaluate
from . import recipes as recipes
from . import simulate as simulate
from .classifiers.rvm import RelevanceVectorClassifier as RelevanceVectorClassifier
from .filter.imm.pedestrian_state import StepUpdate as StepUpdate
from .filter.step_length.person import Person as Person
from .io.files.errors import RecordingError as RecordingError
from .io.formats import read as read
from .maps.floor_plan import FloorPlan as FloorPlan
from .maps.radio.radio_map import RadioMap as RadioMap
from .offline.calibration.fit import calibrate as calibrate
from .offline.smoothing.smooth import smooth as smooth
from .offline.smoothing.smoothed import Smoothed as Smoothed
from .recipes.config import Config as Config
from .recipes.step_length_calibration import Calibration as Calibration
from .report import plot as plot
from .sensing.conditioning import merge_streams as merge_streams
from .sensing.device import Device as Device
from .tracking.extrapolation import Now as Now
from .tracking.online import OnlineFilter as OnlineFilter
from .tracking.track import Track as Track
from .tracking.walked_path import WalkedPath as WalkedPath
from .tracking.whole_recording import classify as classify
from .tracking.whole_recording import detect_steps as detect_steps
from .tracking.whole_recording import track as track
from .values.contexts import CONTEXTS as CONTEXTS
from .values.fixes import GridFix as GridFix
from .values.fixes import HeadingFix as HeadingFix
from .values.fixes import PositionFix as PositionFix
from .values.fixes import RangeFix as RangeFix
from .values.fixes import SpeedFix as SpeedFix
from .values.fixes import Standstill as Standstill
from .values.origin import Origin as Origin
from .values.plan_estimate import Cluster as Cluster
from .values.plan_estimate import OnPlan as OnPlan
from .values.recording import MissingSensorError as MissingSensorError
from .values.recording import Recording as Recording
from .values.samples import Samples as Samples
from .values.step import Step as Step
from .values.wifi import Wifi as Wifi
from .values.windows import Windows as Windows

__version__: str
