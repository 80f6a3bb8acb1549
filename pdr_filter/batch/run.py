"""Many recordings: tracked on several processes or a Dask cluster, into a table that survives a kill.

Every recording is one call of `pdr_filter.track` with `recipes.for_recording`, on whatever process it runs: the numbers
are those of one by one, to the last bit on the same machine and library versions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import cast

from pdr_filter.batch.progress import Clock, Progress
from pdr_filter.batch.result_table import Row, Task, failed_row, opened, row_of, tables, write_parquet
from pdr_filter.batch.worker_process import reason_of
from pdr_filter.batch.workers import each
from pdr_filter.filter.imm.weighting import WEIGHTINGS
from pdr_filter.io.folders import recordings_of
from pdr_filter.io.formats import known_format, read
from pdr_filter.recipes import check_name, contexts_of, for_recording
from pdr_filter.recipes.step_length_calibration import read_person
from pdr_filter.tracking import whole_recording as recording_run
from pdr_filter.values.recording import check_height
from pdr_filter.values.track_placement import GnssUse, check_gnss


def track(
    paths: str | Path | Iterable[str | Path],
    recipe: str = "default",
    weighting: str | None = None,
    *,
    out: str | Path,
    jobs: int = 1,
    scheduler: str | None = None,
    progress: Callable[[Progress], None] | None = None,
    file_format: str | None = None,
    height_m: float | None = None,
    calibration: str | Path | None = None,
    gnss: GnssUse | None = None,
    retry_failed: bool = False,
) -> list[Row]:
    """Rows of the recordings in the order of the paths, after all of them are in the table at `out`.

    The table grows by one line for each recording that finishes, which is on the disk before the next is waited for.
    Started again with the same table, recordings that are in it are not tracked again; a line that a kill cut short is
    dropped. One process at a time can write a table.

    Parameters
    ----------
    paths
        Recordings; a folder that is not a recording stands for all recordings in it.
    recipe, weighting, file_format, height_m, calibration, gnss
        As in `pdr_filter.track`; a recipe is made for each recording's person and placement. `calibration` may also
        be the file of a person, and is not written.
    out : path
        CSV file whose columns are the fields of `Row`, with one column for each context of the recipe. With the suffix
        .parquet the rows grow in the CSV file beside it and are written as parquet in the end, which needs pandas and
        pyarrow.
    jobs : int
        Processes on this machine; -1 for as many as there are cores. With 1 the work is done in this one,
        where a recording that exhausts the memory takes the batch with it.
    scheduler : str, optional
        Address of a Dask scheduler, such as tcp://host:8786, instead of `jobs`. Its workers must see the same files
        under the same paths and have the same version of this package.
    progress : callable, optional
        Called with a `Progress` at the start and after every recording.
    retry_failed : bool
        Track those again that failed in an earlier run; their lines are taken out first.

    Raises
    ------
    ValueError
        If an option cannot be used, or the table is of something else. What is wrong with a recording is in its row.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> path = pdr.simulate.demo_walk().save("walk.zip")
    >>> (row,) = pdr.batch.track([path], out="tracks.csv")
    >>> row.name, row.failed
    ('demo_walk', False)
    """
    asked = _asked(recipe, weighting, file_format, height_m, calibration, gnss)
    table, parquet = tables(out)
    tasks = [replace(asked, path=path) for path in recordings_of(paths) if path != str(table.resolve())]
    for task in tasks:
        if "\n" in task.path or "\r" in task.path:
            raise ValueError(
                f"{task.path!r} has a line break in its name, which a line of a table cannot hold: rename it"
            )
    contexts = contexts_of(recipe)
    with opened(table, retry_failed, contexts) as (known, append):
        rows = {row.task: row for row in known}
        clock = None if progress is None else Clock(tasks, rows, progress)
        todo = [task for task in tasks if task not in rows]
        for i, result in each(track_one, todo, jobs=jobs, scheduler=scheduler):
            row = result if isinstance(result, Row) else failed_row(todo[i], result.reason)
            if not row.failed and tuple(row.context_s) != contexts:
                names = ", ".join(row.context_s)
                row = failed_row(todo[i], f"its contexts are {names}, not those of the recipe for an unknown person")
            if row.task not in rows:
                append(row)
                rows[row.task] = row
                if clock is not None:
                    clock.after(row)
    result = [rows[task] for task in tasks]
    if parquet is not None:
        write_parquet(result, parquet, contexts)
    return result


def track_one(task: Task) -> Row:
    """The row of one recording; a failure is a row with its reason."""
    try:
        recording = read(task.path, task.file_format or None)
        if task.height_m is not None:
            recording = recording.of_height(task.height_m)
        config = for_recording(task.recipe, recording)
        result = recording_run.track(
            recording,
            config,
            task.weighting or None,
            person=task.calibration or None,
            gnss=cast(GnssUse, task.gnss) if task.gnss else None,
        )
    except Exception as error:  # whatever a file provokes belongs beside the successes, not in place of them
        return failed_row(task, reason_of(error))
    return row_of(task, result)


def _asked(
    recipe: str,
    weighting: str | None,
    file_format: str | None,
    height_m: float | None,
    calibration: str | Path | None,
    gnss: str | None,
) -> Task:
    """Task without its path; ValueError for what would otherwise be the reason of every row."""
    check_name(recipe)
    if weighting is not None and weighting not in WEIGHTINGS:
        raise ValueError(f'weighting must be "imm", "wc" or "hc", got {weighting!r}')
    if file_format:
        known_format(file_format)
    if height_m is not None:
        check_height(height_m)
    check_gnss(gnss)
    if calibration is not None:
        read_person(calibration)
    where = "" if calibration is None else str(Path(calibration).resolve())
    return Task("", recipe, weighting or "", file_format or "", height_m, where, gnss or "")
