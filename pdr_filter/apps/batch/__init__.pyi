from .batch_calibration import calibrate as calibrate
from .progress import Progress as Progress
from .result_table import Row as Row
from .result_table import Task as Task
from .result_table import read_table as read_table
from .run import track as track
from .workers import Failure as Failure
from .workers import each as each
