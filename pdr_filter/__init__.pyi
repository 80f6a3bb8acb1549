# The public names of the package: this list is read when the package is imported, and by type checkers.

from . import batch as batch
from . import datasets as datasets
from . import evaluate as evaluate
from . import plot as plot
from . import recipes as recipes
from . import simulate as simulate
from .calibration import Calibration as Calibration
from .classifiers.rvm import RelevanceVectorClassifier as RelevanceVectorClassifier
from .config import Config as Config
from .filter.pedestrian import StepUpdate as StepUpdate
from .filter.person import Person as Person
from .io.errors import RecordingError as RecordingError
from .io.formats import read as read
from .io.recording import MissingSensorError as MissingSensorError
from .io.recording import Recording as Recording
from .maps.floor_plan import FloorPlan as FloorPlan
from .now import Now as Now
from .offline.calibration.fit import calibrate as calibrate
from .offline.smoothing.fixed_lag import FixedLagSmoother as FixedLagSmoother
from .offline.smoothing.smooth import Smoothed as Smoothed
from .offline.smoothing.smooth import smooth as smooth
from .online import OnlineFilter as OnlineFilter
from .radio.radio_map import RadioMap as RadioMap
from .recording_run import classify as classify
from .recording_run import detect_steps as detect_steps
from .recording_run import track as track
from .sensing.conditioning import merge_streams as merge_streams
from .sensing.device import Device as Device
from .tracks import Track as Track
from .values.contexts import CONTEXTS as CONTEXTS
from .values.fixes import GridFix as GridFix
from .values.fixes import HeadingFix as HeadingFix
from .values.fixes import PositionFix as PositionFix
from .values.fixes import SpeedFix as SpeedFix
from .values.fixes import Standstill as Standstill
from .values.on_plan import Cluster as Cluster
from .values.on_plan import OnPlan as OnPlan
from .values.origin import Origin as Origin
from .values.samples import Samples as Samples
from .values.step import Step as Step
from .values.wifi import Wifi as Wifi
from .values.windows import Windows as Windows

__version__: str
