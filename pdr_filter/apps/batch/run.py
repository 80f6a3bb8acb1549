"""Tracking of many recordings on several processes or a Dask cluster, with a table that is kept if it is killed.

Each recording is tracked by one call of `pdr_filter.track` with `recipes.for_recording`. Results are therefore
bit-identical to tracking the recordings one by one, with the same machine and library versions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import cast

from pdr_filter.apps.batch.progress import Clock, Progress
from pdr_filter.apps.batch.result_table import Row, Task, failed_row, open_table, row_of, tables, write_rows_parquet
from pdr_filter.apps.batch.worker_process import reason_of
from pdr_filter.apps.batch.workers import each
from pdr_filter.data.io.folders import absolute_recordings_of, with_person_of_file
from pdr_filter.data.io.formats import known_format, read
from pdr_filter.filter.imm.weighting import WEIGHTINGS
from pdr_filter.recipes import check_name, contexts_of, for_recording
from pdr_filter.recipes.calibration import read_person
from pdr_filter.tracking import whole_recording as recording_run
from pdr_filter.values.georeference import GnssUse, check_gnss
from pdr_filter.values.recording import check_height
from pdr_filter.values.sanitise import printable


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
    """Track many recordings in parallel, and write one table.

    The table grows by one line when a recording finishes, and each line is written to disk at once. If the batch is
    started again with the same table, recordings in the table are not tracked again. An incomplete last line is
    removed. Only one process at a time can write a table.

    Parameters
    ----------
    paths : str, Path or iterable of these
        Recordings. A folder that is not a recording is replaced by all recordings in it.
    recipe : str, default "default"
        Name of a recipe, which is called for the person and the placement of each recording.
    weighting : {"imm", "wc", "hc"}, optional
        Weighting of the contexts. The default is the weighting of the recipe.
    out : str or Path
        CSV file whose columns are the fields of `Row`, with one column for each context of the recipe. With the suffix
        .parquet, the table grows in a CSV file with the same name, and is finally written as Parquet, which needs
        pandas and pyarrow.
    jobs : int, default 1
        Number of processes on this machine, or -1 for the number of cores. With 1, recordings are tracked in the
        calling process, which a recording that exhausts the memory ends.
    scheduler : str, optional
        Address of a Dask scheduler, such as "tcp://host:8786", instead of `jobs`. Its workers must see the same files
        under the same paths and have the same version of this package.
    progress : callable, optional
        Function that is called with a `Progress` at the start and after each recording.
    file_format : str, optional
        Format of the files. By default it is detected from their content.
    height_m : float, optional
        Height of all persons in m. By default the height in each recording is used.
    calibration : str or Path, optional
        File of a calibration or of a person, with step lengths. It is not changed.
    gnss : {"filter", "align", "off"}, optional
        Use of the locations in a recording, as in `pdr_filter.track`.
    retry_failed : bool, default False
        Whether recordings that failed in an earlier run are tracked again.

    Returns
    -------
    list of Row
        Rows in the order of the recordings.

    Raises
    ------
    ValueError
        If an option is invalid, or if `out` is another kind of file. Errors of recordings are in their rows.

    Examples
    --------
    >>> import tempfile
    >>> import pdr_filter as pdr
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=10.0)]).save(f"{folder}/walk.zip")
    ...     (row,) = pdr.batch.track([path], out=f"{folder}/tracks.csv")
    >>> row.name, row.failed
    ('simulated_walk', False)
    """
    # options that would fail for every recording fail here
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
    table, parquet = tables(out)
    where = "" if calibration is None else str(Path(calibration).resolve())
    options = Task("", recipe, weighting or "", file_format or "", height_m, where, gnss or "")
    found = [path for path in absolute_recordings_of(paths) if path != str(table.resolve())]
    # a row of the table is one line
    tasks = [replace(options, path=printable(path) if {"\n", "\r"} & {*path} else path) for path in found]
    contexts = contexts_of(recipe)
    with open_table(table, retry_failed, contexts) as (known, append):
        rows = {row.task: row for row in known}
        clock = None if progress is None else Clock(tasks, rows, progress)

        def add(row: Row) -> None:
            if row.task not in rows:
                append(row)
                rows[row.task] = row
                if clock is not None:
                    clock.after(row)

        for task, path in zip(tasks, found, strict=True):
            if task.path != path:
                add(failed_row(task, "its name has a line break, which the table cannot store: rename the file"))
        todo = [task for task in tasks if task not in rows]
        for i, result in each(track_one, todo, jobs=jobs, scheduler=scheduler):
            row = result if isinstance(result, Row) else failed_row(todo[i], result.reason)
            if not row.failed and tuple(row.context_s) != contexts:
                names = ", ".join(row.context_s)
                row = failed_row(todo[i], f"its contexts are {names}, not those of the recipe for an unknown person")
            add(row)
    result = [rows[task] for task in tasks]
    if parquet is not None:
        write_rows_parquet(result, parquet, contexts)
    return result


def track_one(task: Task) -> Row:
    """Track one recording and return its row. An error gives a row with its reason."""
    try:
        recording = with_person_of_file(read(task.path, task.file_format or None), task.path)
        if task.height_m is not None:
            recording = recording.of_height(task.height_m)
        config = for_recording(task.recipe, recording)
        result = recording_run.track(
            recording,
            config,
            weighting=task.weighting or None,
            person=task.calibration or None,
            gnss=cast(GnssUse, task.gnss) if task.gnss else None,
        )
    except Exception as error:  # an error of one file must not end the batch
        return failed_row(task, reason_of(error))
    return row_of(task, result, recording)
