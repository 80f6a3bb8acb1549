"""Public recordings, downloaded from the sites of their owners into a cache, with their licences.

`fetch("humolire")` downloads a data set and writes it as recordings in the format of this package, with person, labels
and ground truth. To use local files instead, set the environment variable PDR_DATA to a folder that contains a folder
with the name of the data set. Downloads need `pip install "pdr_filter[datasets]"`.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pdr_filter.data.datasets import from_raw
from pdr_filter.data.datasets.ms_indoor_walks import WALKS
from pdr_filter.data.io.files.archive import open_members
from pdr_filter.data.io.folders import recordings_in
from pdr_filter.values.recording import Recording
from pdr_filter.values.safe_files import whole_file, write_text

__all__ = ["DATASETS", "Dataset", "cache_folder", "fetch"]

_GITHUB = "https://raw.githubusercontent.com"
_RAW = ".raw"  # the readers skip names that begin with a dot
_ATTRIBUTION = "ATTRIBUTION.txt"
_CHECKSUMS = "SHA256SUMS"


def __dir__() -> list[str]:
    return __all__


@dataclass(frozen=True, slots=True)
class Dataset:
    """Source, licence and conversion of a public data set.

    Attributes
    ----------
    title, licence, attribution : str
        Title and short description, licence of the files, and publication or owner to cite.
    home : str
        Address of the folder of the files. It should contain a commit, so that the files cannot change.
    files : tuple of str
        Paths of the files below `home`.
    sha256 : tuple of str, default ()
        Checksums of `files` in the same order, or empty if they are unknown.
    or_home : str, default ""
        Address of the newest state of the same folder, for files that are missing in the commit.
    recordings : callable, optional
        Function from the folder of the raw files to recordings. The default reads all recordings that the readers find.
    plan : callable, optional
        Function from the folder of the raw files to the floor plan: GeoJSON in metres, in the frame of the ground
        truth.

    Examples
    --------
    >>> from pdr_filter.data.datasets import DATASETS
    >>> DATASETS["humolire"].licence
    'CC BY 4.0'
    """

    title: str
    licence: str
    attribution: str
    home: str
    files: tuple[str, ...]
    sha256: tuple[str, ...] = ()
    or_home: str = ""
    recordings: Callable[[Path], Iterable[Recording]] = from_raw.as_found
    plan: Callable[[Path], dict[str, Any]] | None = None

    def about(self) -> str:
        """Return title, licence, attribution, source and verification of the data set.

        Returns
        -------
        str
            Lines of text.
        """
        checked = (
            "checked: sha256 of each file"
            if len(self.sha256) == len(self.files)
            else f"checked: only the commit in the address, no sha256 is known yet; {_CHECKSUMS} has those received"
        )
        terms = f"licence: {self.licence}\nattribution: {self.attribution}"
        return f"{self.title}\n{terms}\nfrom: {self.home}\n{checked}\n"


_HUMOLIRE = (
    "straight",
    "straight_reversed",
    "forward",
    *(f"weinberg_sequences/{n}{way}" for n in "123" for way in "fr"),
)
_LANDMARKS = ("forward", "weinberg_sequences/1f", "weinberg_sequences/5r")  # one file for each route
_SENSLOGS = ("accelerometer-calibrated.txt", "gyroscope-calibrated.txt", "record.properties", "references.txt")
DATASETS: dict[str, Dataset] = {
    "humolire": Dataset(
        "HuMoLIRe: loops through the corridors of a building, phone in the hand",
        "CC BY 4.0",
        "M. A. Ghaoui, B. Vincke, R. Reynaud, Human Motion Likelihood Representation Map-Aided PDR Particle Filter, "
        "IEEE Sensors Journal 23(1), 484-494, 2023, doi:10.1109/JSEN.2022.3222639",
        f"{_GITHUB}/anisghaoui/humolire/3b3ad92473399208849925a2c22cecfcd0fa868e/data",
        (
            *(f"imus/1/{walk}/{file}" for walk in _HUMOLIRE for file in _SENSLOGS),
            *(f"imus/1/{walk}/keypoints.json" for walk in _LANDMARKS),
            "maps/map_data.json",
        ),
        or_home=f"{_GITHUB}/anisghaoui/humolire/HEAD/data",
        recordings=from_raw.humolire,
        plan=from_raw.humolire_plan,
    ),
    "motionsense": Dataset(
        "MotionSense: 24 people, six activities, phone in the trouser pocket",
        "MIT (Copyright (c) 2018 Mohammad Malekzadeh)",
        "M. Malekzadeh, R. G. Clegg, A. Cavallaro, H. Haddadi, Mobile Sensor Data Anonymization, IoTDI 2019, "
        "doi:10.1145/3302505.3310068",
        f"{_GITHUB}/mmalekzadeh/motion-sense/3ac0381db93ff62e1d54a002b90b23bb7179e99f/data",
        ("data_subjects_info.csv", "A_DeviceMotion_data.zip"),
        or_home=f"{_GITHUB}/mmalekzadeh/motion-sense/HEAD/data",
        recordings=from_raw.motionsense,
    ),
    "ms_indoor": Dataset(
        "Indoor Location Competition 2.0: walks in a mall with points of the floor plan",
        "MIT (Copyright (c) 2017-2020 XYZ10, Inc. https://dangwu.com/)",
        "Indoor Location Competition 2.0, sample data (Microsoft Research and XYZ10, Inc.)",
        f"{_GITHUB}/location-competition/indoor-location-competition-20/2315bf92da0b91d82fb08c205857c5b83712642c/data/site1",
        tuple(f"{floor}/path_data_files/{name}.txt" for floor, names in WALKS.items() for name in names.split()),
        or_home=f"{_GITHUB}/location-competition/indoor-location-competition-20/HEAD/data/site1",
        recordings=from_raw.ms_indoor,
    ),
}


def fetch(name: str, folder: str | Path | None = None) -> list[Path]:
    """Return the paths of the recordings of a data set, and download missing ones.

    The recordings are zip files in the format of this package, in `folder / name`. They contain person, labels and
    ground truth as far as these are published. A floor plan, if there is one, is `folder / "maps" / "NAME.geojson"`.

    Parameters
    ----------
    name : str
        One of `DATASETS`, or the name of a folder in the folder that the environment variable PDR_DATA names.
    folder : str or Path, optional
        Folder of the data sets, with one folder for each. The default is `cache_folder()`.

    Returns
    -------
    list of Path
        Files for `pdr_filter.read`, sorted.

    Raises
    ------
    ValueError
        If the name is unknown, if a checksum differs, or if the package for downloads is not installed.
    ConnectionError
        If the site cannot be reached.

    Notes
    -----
    Downloaded files are kept in `.raw` next to the zip files. Their checksums are in `SHA256SUMS`, in the format of
    `sha256sum --check`. No public address could be reached when the table of data sets was written. The table therefore
    contains no checksums to compare with yet.

    Examples
    --------
    A local data set, without a download:

    >>> import os
    >>> from unittest import mock
    >>> import pdr_filter as pdr
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("stationary", duration_s=2.0)])
    >>> os.makedirs("data/mine")
    >>> _ = walk.save("data/mine/walk.zip")
    >>> with mock.patch.dict(os.environ, {"PDR_DATA": "data"}):
    ...     [path.name for path in pdr.datasets.fetch("mine")]
    ['walk.zip']
    """
    local = os.environ.get("PDR_DATA")
    if local and (Path(local) / name).is_dir():
        return recordings_in(Path(local) / name)
    if name not in DATASETS:
        raise ValueError(
            f"data set {name!r} is unknown: give one of {', '.join(DATASETS)}, or the name of a folder in the folder "
            f"of the environment variable PDR_DATA ({local or 'not set'})"
        )
    dataset = DATASETS[name]
    folder = Path(folder) if folder is not None else cache_folder()
    to = folder / name
    if not (to / _ATTRIBUTION).is_file():  # this file is written last
        print(dataset.about(), end="", file=sys.stderr)
        _download(name, dataset, to / _RAW)
        _write(name, dataset, to, folder / "maps" / f"{name}.geojson")
    return recordings_in(to)


def cache_folder() -> Path:
    """Return the default folder of the data sets: the user's cache folder for reproducible files."""
    return Path(_pooch().os_cache("pdr_filter"))


def _write(name: str, dataset: Dataset, to: Path, plan: Path) -> None:
    """Convert the downloaded files of a data set. Write its recordings to `to` and its floor plan to `plan`.

    Their metadata have the licence. The attribution is written last.
    """
    raw = to / _RAW
    for archive in raw.rglob("*.zip"):
        _unpack(archive)
    terms = {"dataset": name, "licence": dataset.licence, "attribution": dataset.attribution}
    for recording in dataset.recordings(raw):
        replace(recording, meta={**recording.meta, **terms}).save(to / f"{recording.name}.zip")
    if dataset.plan is not None:
        content = dataset.plan(raw)
        content["properties"] |= terms
        write_text(plan, json.dumps(content))
    sums = (f"{hashlib.sha256((raw / file).read_bytes()).hexdigest()}  {file}\n" for file in dataset.files)
    write_text(raw / _CHECKSUMS, "".join(sums))
    write_text(to / _ATTRIBUTION, dataset.about())


def _download(name: str, dataset: Dataset, raw: Path) -> None:
    """Download the missing files of a data set to a folder, from the commit or else from the newest state.

    ValueError if a file has another checksum, ConnectionError if it cannot be downloaded.
    """
    pooch = _pooch()
    pooch.get_logger().setLevel("WARNING")
    known = dict(zip(dataset.files, dataset.sha256, strict=False))
    for file in dataset.files:
        place = raw / file
        if place.is_file():
            continue
        for home in filter(None, (dataset.home, dataset.or_home)):
            url = f"{home}/{file}"
            try:
                pooch.retrieve(url, known.get(file), place.name, place.parent)
                break
            except OSError as error:  # before ValueError, because some errors of requests are both
                if "404" in str(error) and dataset.or_home and home != dataset.or_home:
                    print(f"{file} is missing in the recorded commit: downloading its newest state", file=sys.stderr)
                    continue
                raise ConnectionError(
                    f"{name}: {url} cannot be downloaded ({type(error).__name__}: {str(error)[:200]}); connect to the "
                    "network and call fetch again, which resumes the download, or copy the data set to a folder "
                    f"{name} in the folder of the environment variable PDR_DATA"
                ) from error
            except ValueError as error:  # wrong checksum
                raise ValueError(
                    f"{name}: {url} has changed since its checksum was recorded ({error}): do not use the file, and "
                    "report this to the maintainers of pdr_filter"
                ) from error


def _unpack(archive: Path) -> None:
    """Extract the .csv and .txt files of a zip file to a folder of the same name, within the limits of the readers."""
    with open_members(archive) as members:
        for name in members.names:
            place = archive.with_suffix("") / name
            if not place.is_file() and name.lower().endswith((".csv", ".txt")):
                with whole_file(place) as file:
                    file.writelines(members.parts(name))


def _pooch():
    """Return the module pooch. ValueError, which says how to install it, if it is missing."""
    try:
        import pooch
    except ImportError as error:
        raise ValueError('downloads need the package pooch: pip install "pdr_filter[datasets]"') from error
    return pooch
