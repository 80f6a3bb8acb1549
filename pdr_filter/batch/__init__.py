"""Many recordings, on several processes or a Dask cluster."""

from pdr_filter.batch.batch_calibration import calibrate
from pdr_filter.batch.progress import Progress
from pdr_filter.batch.result_table import Row, Task, read_table
from pdr_filter.batch.run import track
from pdr_filter.batch.workers import Failure, each

__all__ = ["Failure", "Progress", "Row", "Task", "calibrate", "each", "read_table", "track"]
