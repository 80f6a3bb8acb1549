"""Many recordings, on several processes or a Dask cluster."""

from pdr_filter.batch.run import Failure, Progress, Row, Task, calibrate, each, read_table, track

__all__ = ["Failure", "Progress", "Row", "Task", "calibrate", "each", "read_table", "track"]
