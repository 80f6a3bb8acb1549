"""Public recordings for everybody: from the places where their owners published them, into a cache, with licences.

`fetch("humolire")` downloads what its owners published and writes it as recordings in the project's own format, with
person, labels and truth; a folder of your own is used in place of the network if the environment variable PDR_DATA
names one with a folder of the data set's name. Downloads need `pip install "pdr_filter[datasets]"`.
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

from pdr_filter.datasets import from_raw
from pdr_filter.datasets.ms_indoor_walks import WALKS
from pdr_filter.io.files.archive import open_members
from pdr_filter.io.files.safe_files import whole_file, write_text
from pdr_filter.io.folders import recordings_in
from pdr_filter.values.recording import Recording

_GITHUB = "https://raw.githubusercontent.com"
_RAW = ".raw"  # in a folder of recordings what begins with a point is no recording
_ATTRIBUTION = "ATTRIBUTION.txt"
_CHECKSUMS = "SHA256SUMS"


@dataclass(frozen=True, slots=True)
class Dataset:
    """What is public of a data set, and under which terms."""

    title: str
    licence: str
    attribution: str
    home: str  # address that its files lie under; with a commit in it, they cannot change
    files: tuple[str, ...]  # paths below it
    sha256: tuple[str, ...] = ()  # of the files, in the same order; none where it is not known
    or_home: str = ""  # the newest state of the same place, for a file that is not in the commit
    recordings: Callable[[Path], Iterable[Recording]] = from_raw.as_found  # from the folder of the raw files
    plan: Callable[[Path], dict[str, Any]] | None = None  # its floor plan, GeoJSON in metres of its truth

    def about(self) -> str:
        """Title, licence, attribution and how far what comes is checked, as lines."""
        checked = (
            "checked: sha256 of each file"
            if len(self.sha256) == len(self.files)
            else f"checked: no sha256 is known yet, only the commit in the address; {_CHECKSUMS} has those of what came"
        )
        terms = f"licence: {self.licence}\nattribution: {self.attribution}"
        return f"{self.title}\n{terms}\nfrom: {self.home}\n{checked}\n"


_HUMOLIRE = (
    "straight",
    "straight_reversed",
    "forward",
    *(f"weinberg_sequences/{n}{way}" for n in "123" for way in "fr"),
)
_LANDMARKS = ("forward", "weinberg_sequences/1f", "weinberg_sequences/5r")  # of each way
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
    """Return the paths of the recordings of a data set, sorted; those that are not there yet are downloaded.

    They are zips in the project's own format, with person, labels and truth as far as these are published, in
    `folder / name`; a floor plan, where there is one, is `maps/NAME.geojson` in the same folder. What was downloaded
    is kept in `.raw` beside the zips, with its checksums in `SHA256SUMS`, as `sha256sum --check` reads them: no public
    address could be reached when the table of data sets was written, so that there are none to compare with yet.

    Parameters
    ----------
    name : str
        One of `DATASETS`, or the name of a folder in PDR_DATA.
    folder : str or Path, optional
        Where the data sets are kept, one folder each; `cache_folder` if not given.

    Returns
    -------
    list of Path
        Files for `pdr_filter.read`.

    Raises
    ------
    ValueError
        For a name that is not known, a checksum that differs, or without the package for downloads.
    ConnectionError
        If its home cannot be reached; the message says what else can be done.
    """
    local = os.environ.get("PDR_DATA")
    if local and (Path(local) / name).is_dir():
        return recordings_in(Path(local) / name)
    if name not in DATASETS:
        raise ValueError(
            f"name is {name!r}; known are {', '.join(DATASETS)}, and the folders in the one that PDR_DATA names "
            f"({local or 'not set'})"
        )
    dataset = DATASETS[name]
    folder = Path(folder) if folder is not None else cache_folder()
    to = folder / name
    if not (to / _ATTRIBUTION).is_file():  # written last
        print(dataset.about(), end="", file=sys.stderr)
        _download(name, dataset, to / _RAW)
        _write(name, dataset, to, folder / "maps" / f"{name}.geojson")
    return recordings_in(to)


def cache_folder() -> Path:
    """Where data sets are kept if no folder is given: where programs of the user keep what can be had again."""
    return Path(_pooch().os_cache("pdr_filter"))


def _write(name: str, dataset: Dataset, to: Path, plan: Path) -> None:
    """The recordings and the floor plan, from what was downloaded."""
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
            except ValueError as error:  # the checksum
                raise ValueError(f"{name}: {url} is not what it was ({error}); tell us, and do not use it") from error
            except OSError as error:
                if "404" in str(error) and dataset.or_home and home != dataset.or_home:
                    print(f"{file} is not in that commit: its newest state is taken", file=sys.stderr)
                    continue
                raise ConnectionError(
                    f"{name}: {url} cannot be had ({type(error).__name__}: {str(error)[:200]}); connect to the network "
                    "and call it again, which goes on where it was, or copy the data set to a folder "
                    f"{name} in one that the environment variable PDR_DATA names"
                ) from error


def _unpack(archive: Path) -> None:
    """The texts of a zip, beside it, within the bounds of the readers; once."""
    with open_members(archive) as members:
        for name in members.names:
            place = archive.with_suffix("") / name
            if not place.is_file() and name.lower().endswith((".csv", ".txt")):
                with whole_file(place) as file:
                    file.writelines(members.parts(name))


def _pooch():
    try:
        import pooch
    except ImportError as error:
        raise ValueError('downloads need one more package: pip install "pdr_filter[datasets]"') from error
    return pooch
