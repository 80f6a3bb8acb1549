"""Track of a recording, with its plots, files and text report."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pdr_filter.filter.pedestrian.person import Person
from pdr_filter.sensing.device import Device
from pdr_filter.tracking import trust_report as trust
from pdr_filter.values import Origin, TrackRows

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Track(TrackRows):
    """Track of one walk: one row for each of K detected steps, with covariances.

    `pdr_filter.track` and `pdr_filter.smooth` return it. `report`, `plot` and the `to_...` methods present and
    write it. C is the number of contexts and M the number of modes of the filter.

    Positions and headings are in one frame, named by the attribute `frame` and described by `about_frame`. While a few
    fixes leave the rotation of the track in their frame open, a position is the mean over all possible rotations. The
    covariance then includes the spread over them.

    Attributes
    ----------
    name : str
        Name of the recording.
    time_s : ndarray, shape (K,)
        Time of the foot contact that ends each step, s.
    position_m : ndarray, shape (K, 2)
        East and north after each step, m.
    position_cov_m2 : ndarray, shape (K, 2, 2)
        Covariance of `position_m`, m^2.
    step_length_m : ndarray, shape (K,)
        Length of each step, m, as estimated when the step was made.
    walked_m : ndarray, shape (K,)
        Walked distance up to each step, m. With the weighting "imm" it is not exactly the sum of `step_length_m`: see
        Notes.
    walking_heading_rad : ndarray, shape (K,)
        Walking direction, rad, clockwise from the north of the frame, in [-pi, pi).
    step_speed_mps, step_speed_std_mps : ndarray, shape (K,)
        Length of each step divided by its duration, and its standard deviation, m/s.
    smoothed_speed_mps, smoothed_speed_std_mps : ndarray, shape (K,)
        Speed averaged over the steps since the last pause, and its standard deviation, m/s.
    gap_before_s : ndarray, shape (K,)
        Time without samples between the previous step and this one, s.
    height_m, height_std_m : ndarray, shape (K,)
        Height above the start, and its standard deviation, m.
    floor : ndarray of int, shape (K,)
        Storey. The start is on storey 0, unless a fix names the storey.
    context_prob : ndarray, shape (K, C)
        Probability of each context in the window of the step, from the classifier alone. With "hc" and "wc" it is the
        mean of the windows around and after the step.
    contexts : tuple of str
        Names of the C contexts.
    mode_prob : ndarray, shape (K, M)
        Probability of each mode after the step, filtered over time. Step lengths are weighted by it.
    modes, mode_contexts : tuple of str
        Names of the M modes, and the context of each mode.
    steps : Table
        Rows of `Step`, one for each step.
    windows : Windows
        Context probabilities of all windows of the recording.
    start_time_s, duration_s : float
        Time of the first sample, and time from the first sample to the last, s.
    weighting : str
        Combination of the modes: "imm", "wc" or "hc".
    notes : tuple of str
        Warnings about the recording and the track: problem, likely cause and remedy.
    fixes : tuple of FixResult
        Outcome of each fix.
    floor_passages : tuple of FloorPassage
        Changes of storey, in order of time.
    start_position_m : ndarray, shape (2,)
        Position before the first step, m.
    frame : {"start", "heading fixes", "north", "fixes", "plan"}
        Frame of positions and headings. "start": the origin is the start of the walk, and north is the first heading
        of the phone. "heading fixes": the same frame, rotated to the north of the heading fixes. "north": the same
        frame, rotated to true north. "fixes": the frame of the position fixes. "plan": the frame of the floor plan.
    origin : Origin or None
        Geographic position of the origin of the frame. None if neither the caller nor a location defines it.
    plan : FloorPlan or None
        Floor plan that constrained the track.
    clusters : tuple of tuples of Cluster
        With a floor plan, the K sets of alternative positions after each step, most probable first. A set is empty
        before the particle filter starts. Without a plan the tuple is empty.
    is_smoothed : bool
        True if each row is estimated from the whole recording, False if only from earlier samples.
    effective_sample_size : ndarray, shape (K,)
        With a floor plan, effective number of particles, 1 / sum of squared weights. Empty without a plan.
    phone_n_steps : ndarray, shape (K,)
        Steps that the phone itself had counted at each step. NaN before its first report, and empty if the recording
        has no step counter.
    phone_heading_rad : ndarray, shape (K,)
        Latest heading that the phone itself had reported at each step, rad, clockwise from magnetic or true north, as
        the phone defines it, in [-pi, pi). It is the direction of the phone, and does not rotate with the frame of the
        track, as `walking_heading_rad` does. NaN before its first report, and empty if the recording has no headings.
    device : Device or None
        Gyroscope bias of the phone, as input for its next recording.
    person : Person or None
        Step length of the person from the fixes of this recording, if they determine it to 10 %, and from the person
        given to `track`. None if there is neither.

    Notes
    -----
    With the weighting "imm" position and walked distance are the best estimates at the time of each step. When the
    evidence changes from one context to another, the filter revises the length of the earlier steps. Position and
    walked distance then change by more or less than `step_length_m`, and the earlier rows stay unchanged.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> track = pdr.track(pdr.simulate.demo_walk())
    >>> east_m, north_m = track.end_position_m
    >>> std_m = track.position_std_m[-1]  # in the worst direction
    >>> sorted(name for name, seconds in track.context_seconds().items() if seconds > 5)
    ['downstairs', 'running', 'stationary', 'upstairs', 'walking']
    >>> track.to_csv("walk.csv").name
    'walk.csv'
    """

    device: Device | None = None
    person: Person | None = None

    def report(self) -> str:
        """Return a text summary of the track: distance, accuracy, contexts, and stretches not to trust.

        Returns
        -------
        str
            Several lines, without a line break at the end.
        """
        return trust.report(self)

    def to_csv(self, path: str | Path, origin: Origin | tuple[float, float] | None = None) -> Path:
        """Write a CSV file with one line for each step under a header with units.

        The columns are time, east, north, covariance, `position_std_m`, step length, walked distance, heading, speed,
        height, floor, and the probabilities of contexts and modes. Latitude and longitude columns are added if the
        track has an origin, and an altitude column if the origin has a height.

        Parameters
        ----------
        path : str or Path
            File to write. Missing folders are created.
        origin : Origin or (latitude_deg, longitude_deg), optional
            Geographic position of the origin of the track's frame. The default is `Track.origin`.

        Returns
        -------
        Path
            The written file.
        """
        from pdr_filter.data.io.files import track_writers as writers

        return writers.write_csv(self, path, origin)

    def to_pandas(self, origin: Origin | tuple[float, float] | None = None) -> Any:
        """Return a pandas DataFrame with the columns of `to_csv` and all digits; needs the extra `parquet`.

        Parameters
        ----------
        origin : Origin or (latitude_deg, longitude_deg), optional
            Geographic position of the origin of the track's frame. The default is `Track.origin`.

        Returns
        -------
        pandas.DataFrame
            One row for each step.
        """
        from pdr_filter.data.io.files import track_writers as writers

        return writers.track_frame(self, origin)

    def to_parquet(self, path: str | Path, origin: Origin | tuple[float, float] | None = None) -> Path:
        """Write a Parquet file with the columns of `to_csv` in full precision.

        Notes, frame and origin are stored as metadata, which pandas shows as `attrs` of the data frame.

        Parameters
        ----------
        path : str or Path
            File to write. Missing folders are created.
        origin : Origin or (latitude_deg, longitude_deg), optional
            Geographic position of the origin of the track's frame. The default is `Track.origin`.

        Returns
        -------
        Path
            The written file.

        Raises
        ------
        ValueError
            If pandas or pyarrow is not installed: they come with the extra `parquet`.
        """
        from pdr_filter.data.io.files import track_writers as writers

        return writers.write_parquet(self, path, origin)

    def to_geojson(self, path: str | Path, origin: Origin | tuple[float, float] | None = None) -> Path:
        """Write a GeoJSON line in WGS 84 coordinates, from the start of the walk through all steps.

        Each vertex has its time and covariance as properties. A track without steps is written as a point.

        Parameters
        ----------
        path : str or Path
            File to write. Missing folders are created.
        origin : Origin or (latitude_deg, longitude_deg), optional
            Geographic position of the origin of the track's frame. The default is `Track.origin`.

        Returns
        -------
        Path
            The written file.

        Raises
        ------
        ValueError
            If neither `origin` nor `Track.origin` is given.
        """
        from pdr_filter.data.io.files import track_writers as writers

        return writers.write_geojson(self, path, origin)

    def to_local_geojson(self, path: str | Path) -> Path:
        """Write the shape of a track without geographic position as GeoJSON.

        The line is drawn around latitude 0 and longitude 0, because GeoJSON requires degrees.

        Parameters
        ----------
        path : str or Path
            File to write. Its suffix becomes .local.geojson.

        Returns
        -------
        Path
            The written file.

        Raises
        ------
        ValueError
            If the track has an origin: use `to_geojson`.
        """
        from pdr_filter.data.io.files import track_writers as writers

        return writers.write_local_geojson(self, path)

    def to_kml(self, path: str | Path, origin: Origin | tuple[float, float] | None = None) -> Path:
        """Write a KML 2.2 document for Google Earth: the line of the walk, its start and its end.

        Parameters
        ----------
        path : str or Path
            File to write. Missing folders are created.
        origin : Origin or (latitude_deg, longitude_deg), optional
            Geographic position of the origin of the track's frame. The default is `Track.origin`.

        Returns
        -------
        Path
            The written file.

        Raises
        ------
        ValueError
            If neither `origin` nor `Track.origin` is given.
        """
        from pdr_filter.data.io.files import track_writers as writers

        return writers.write_kml(self, path, origin)

    def to_gpx(
        self, path: str | Path, origin: Origin | tuple[float, float] | None = None, epoch_s: float = 0.0
    ) -> Path:
        """Write a GPX 1.1 track from the start of the walk through all steps.

        Points have an elevation if the origin has a height.

        Parameters
        ----------
        path : str or Path
            File to write. Missing folders are created.
        origin : Origin or (latitude_deg, longitude_deg), optional
            Geographic position of the origin of the track's frame. The default is `Track.origin`.
        epoch_s : float, default 0.0
            Unix time of time zero of the recording, s: `Recording.epoch_s`, if it is known.

        Returns
        -------
        Path
            The written file.

        Raises
        ------
        ValueError
            If the track has no origin, or the times are not between the years 1970 and 9999.
        """
        from pdr_filter.data.io.files import track_writers as writers

        return writers.write_gpx(self, path, origin, epoch_s)

    def to_tum(self, path: str | Path) -> Path:
        """Write a trajectory in TUM format, with lines `timestamp tx ty tz qx qy qz qw`.

        The positions are east, north and zero. The quaternion rotates the x axis into the walking direction.

        Parameters
        ----------
        path : str or Path
            File to write. Missing folders are created.

        Returns
        -------
        Path
            The written file.
        """
        from pdr_filter.data.io.files import track_writers as writers

        return writers.write_tum(self, path)

    def plot(self, path: str | Path | None = None) -> Figure:
        """Draw the track with its 95 % uncertainty above its context probabilities over time.

        A wide band of the uncertainty is drawn in part. The legend then states its largest half width, such as "±11 m,
        cut off".

        Parameters
        ----------
        path : str or Path, optional
            Image file to write. Its suffix selects the format.

        Returns
        -------
        matplotlib.figure.Figure
            The figure.
        """
        from pdr_filter.apps.report import plot

        return plot.track(self, path)
