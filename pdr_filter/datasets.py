"""Public recordings for everybody: from the places where their owners published them, into a cache, with licences.

`fetch("humolire")` gives paths that `pdr_filter.read` takes. A folder of your own is used in place of the network if
the environment variable PDR_DATA names one with a folder of the data set's name. Downloads need
`pip install "pdr_filter[datasets]"`.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from pdr_filter.io.archive import open_members
from pdr_filter.io.files import whole_file, write_text
from pdr_filter.io.folders import recordings_in

_GITHUB = "https://raw.githubusercontent.com"


@dataclass(frozen=True, slots=True)
class Dataset:
    """What is public of a data set, and under which terms."""

    title: str
    licence: str
    attribution: str
    home: str  # address that its files lie under; with a commit in it, they cannot change
    files: tuple[str, ...]  # paths below it
    sha256: tuple[str, ...] = ()  # of the files, in the same order; none where it is not known

    def about(self) -> str:
        """Title, licence and attribution, as lines."""
        return f"{self.title}\nlicence: {self.licence}\nattribution: {self.attribution}\nfrom: {self.home}\n"


_SENSLOGS = ("accelerometer-calibrated.txt", "gyroscope-calibrated.txt", "record.properties")
_HUMOLIRE = (
    "straight",
    "straight_reversed",
    "forward",
    *(f"weinberg_sequences/{n}{way}" for n in "123" for way in "fr"),
)
_MS_INDOOR = {
    "F1": "5dd9e7aac5b77e0006b1732b 5dd9e7b29191710006b5705b 5dd9e7b7c5b77e0006b1732f 5dd9e7c4c5b77e0006b17335 "
    "5dd9e7c59191710006b57063 5dd9e7c59191710006b57065 5dd9e7c5c5b77e0006b17337 5dd9e7c99191710006b57069",
    "B1": "5dda14979191710006b5720e 5dda1499c5b77e0006b1752f 5dda149f9191710006b57212 5dda14a39191710006b57214",
}

DATASETS: dict[str, Dataset] = {
    "humolire": Dataset(
        "HuMoLIRe: loops through the corridors of a building, phone in the hand",
        "CC BY 4.0",
        "M. A. Ghaoui, B. Vincke, R. Reynaud, Human Motion Likelihood Representation Map-Aided PDR Particle Filter, "
        "IEEE Sensors Journal 23(1), 484-494, 2023, doi:10.1109/JSEN.2022.3222639",
        f"{_GITHUB}/anisghaoui/humolire/3b3ad92473399208849925a2c22cecfcd0fa868e/data/imus/1",
        tuple(f"{walk}/{file}" for walk in _HUMOLIRE for file in _SENSLOGS),
    ),
    "motionsense": Dataset(
        "MotionSense: 24 people, six activities, phone in the trouser pocket",
        "MIT (Copyright (c) 2018 Mohammad Malekzadeh)",
        "M. Malekzadeh, R. G. Clegg, A. Cavallaro, H. Haddadi, Mobile Sensor Data Anonymization, IoTDI 2019, "
        "doi:10.1145/3302505.3310068",
        f"{_GITHUB}/mmalekzadeh/motion-sense/master/data",  # no commit is known that holds this file
        ("A_DeviceMotion_data.zip",),
    ),
    "ms_indoor": Dataset(
        "Indoor Location Competition 2.0: walks in a mall with points of the floor plan",
        "MIT (Copyright (c) 2017-2020 XYZ10, Inc. https://dangwu.com/)",
        "Indoor Location Competition 2.0, sample data (Microsoft Research and XYZ10, Inc.)",
        f"{_GITHUB}/location-competition/indoor-location-competition-20/7658f524cba9aaf65db04e74721924daaebe32a0/data/site1",
        tuple(f"{floor}/path_data_files/{name}.txt" for floor, names in _MS_INDOOR.items() for name in names.split()),
    ),
}


def fetch(name: str, folder: str | Path | None = None) -> list[Path]:
    """Return the paths of the recordings of a data set, sorted; those that are not there yet are downloaded.

    Parameters
    ----------
    name : str
        One of `DATASETS`, or the name of a folder in PDR_DATA.
    folder : str or Path, optional
        Where the data sets are kept, one folder each; the user's cache if not given.

    Returns
    -------
    list of Path
        Files and folders for `pdr_filter.read`.

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
    to = (Path(folder) if folder is not None else _cache()) / name
    missing = [file for file in dataset.files if not (to / file).is_file()]
    if missing:
        print(dataset.about(), end="", file=sys.stderr)
        _download(name, dataset, missing, to)
        write_text(to / "ATTRIBUTION.txt", dataset.about())
    archives = list(to.rglob("*.zip"))
    for archive in archives:
        _unpack(archive)
    return [path for path in recordings_in(to) if not {path, *path.parents}.intersection(archives)]


def _cache() -> Path:
    """Where programs of the user keep what can be had again."""
    pooch = _pooch()
    return Path(pooch.os_cache("pdr_filter"))


def _download(name: str, dataset: Dataset, files: Iterable[str], to: Path) -> None:
    pooch = _pooch()
    pooch.get_logger().setLevel("WARNING")
    known = dict(zip(dataset.files, dataset.sha256, strict=False))
    for file in files:
        url, place = f"{dataset.home}/{file}", to / file
        try:
            pooch.retrieve(url, known.get(file), place.name, place.parent)
        except ValueError as error:  # the checksum
            raise ValueError(f"{name}: {url} is not what it was ({error}); tell us, and do not use it") from error
        except OSError as error:
            raise ConnectionError(
                f"{name}: {url} cannot be had ({type(error).__name__}: {str(error)[:200]}); connect to the network and "
                f"call it again, which goes on where it was, or copy the data set to a folder {name} in one that the "
                "environment variable PDR_DATA names"
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
