"""The track of a recording, with its plots, files and report."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pdr_filter.filter.step_length.person import Person
from pdr_filter.sensing.device import Device
from pdr_filter.tracking import trust_report as trust
from pdr_filter.values import Origin, TrackRows

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Track(TrackRows):
    """Where the pedestrian walked: a row for each of K steps, with covariance; plots, files and a report.

    What `pdr_filter.track` returns. C is the number of contexts, M that of the filter's modes. `context_prob` is what
    the classifier said of the window, `mode_prob` what the filter made of it over time; step lengths come from the
    latter. `about_frame` says where zero and north are. With `imm` position and walked distance are the best estimates
    at their step: when the evidence changes, earlier steps count differently, while `step_length_m` stays what was
    thought of a step when it was made.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> track = pdr.track(pdr.simulate.demo_walk())
    >>> east_m, north_m = track.end_position_m
    >>> std_m = track.position_std_m[-1]  # in the worst direction
    >>> sorted(name for name, seconds in track.context_seconds().items() if seconds > 5)
    ['downstairs', 'stationary', 'upstairs', 'walking']
    >>> track.to_csv("walk.csv").name
    'walk.csv'
    """

    device: Device | None = None  # what the recording taught of the phone, for its next one
    person: Person | None = None  # what its fixes taught of the person, with what was known before; None if nothing

    def report(self) -> str:
        """What the track is, how sure it is, and where not to trust it; see `pdr_filter.tracking.trust_report`."""
        return trust.report(self)

    def to_csv(self, path: str | Path, origin: Origin | tuple[float, float] | None = None) -> Path:
        """Write one line for each step and return the path; see `pdr_filter.io.files.track_writers.write_csv`."""
        from pdr_filter.io.files import track_writers as writers

        return writers.write_csv(self, path, origin)

    def to_pandas(self, origin: Origin | tuple[float, float] | None = None) -> Any:
        """Return a pandas DataFrame with the columns of `to_csv` and all digits; needs the extra `parquet`."""
        from pdr_filter.io.files import track_writers as writers

        return writers.track_frame(self, origin)

    def to_parquet(self, path: str | Path, origin: Origin | tuple[float, float] | None = None) -> Path:
        """Write the columns of `to_csv` with all digits and return the path; needs the extra `parquet`."""
        from pdr_filter.io.files import track_writers as writers

        return writers.write_parquet(self, path, origin)

    def to_geojson(self, path: str | Path, origin: Origin | tuple[float, float] | None = None) -> Path:
        """Write a GeoJSON line in WGS 84 and return the path; a track without `origin` needs (lat_deg, lon_deg)."""
        from pdr_filter.io.files import track_writers as writers

        return writers.write_geojson(self, path, origin)

    def to_local_geojson(self, path: str | Path) -> Path:
        """Write the shape of a track that has no `origin` and return the path, which ends in .local.geojson."""
        from pdr_filter.io.files import track_writers as writers

        return writers.write_local_geojson(self, path)

    def to_kml(self, path: str | Path, origin: Origin | tuple[float, float] | None = None) -> Path:
        """Write a KML document for Google Earth and return the path; a track without `origin` needs one."""
        from pdr_filter.io.files import track_writers as writers

        return writers.write_kml(self, path, origin)

    def to_gpx(
        self, path: str | Path, origin: Origin | tuple[float, float] | None = None, epoch_s: float = 0.0
    ) -> Path:
        """Write a GPX 1.1 track and return the path; `epoch_s` is the unix time of time zero."""
        from pdr_filter.io.files import track_writers as writers

        return writers.write_gpx(self, path, origin, epoch_s)

    def to_tum(self, path: str | Path) -> Path:
        """Write TUM lines (timestamp tx ty tz qx qy qz qw) and return the path."""
        from pdr_filter.io.files import track_writers as writers

        return writers.write_tum(self, path)

    def plot(self, path: str | Path | None = None) -> Figure:
        """Draw the track with covariance ellipses above its context probabilities; saved if a path is given."""
        from pdr_filter.report import plot

        return plot.track(self, path)
