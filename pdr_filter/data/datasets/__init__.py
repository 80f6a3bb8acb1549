"""Public recordings, downloaded from the sites of their owners into a cache, with their licences.

`fetch("humolire")` downloads a data set and writes it as recordings in the format of this package, with person, labels
and ground truth. Title, licence and size are shown before anything is loaded. To use local recordings instead, set the
environment variable PDR_DATA to a folder that contains a folder with the name of the data set. Downloads need
`pip install "pdr_filter[datasets]"`.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import shutil
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

from pdr_filter.data.datasets import from_raw
from pdr_filter.data.datasets.ms_indoor_walks import WALKS
from pdr_filter.data.io.files.archive import open_members
from pdr_filter.data.io.folders import recordings_in
from pdr_filter.values.optional_packages import load_optional
from pdr_filter.values.recording import Recording
from pdr_filter.values.safe_files import whole_file, write_text

__all__ = ["DATASETS", "Dataset", "cache_folder", "fetch"]

_LOG = logging.getLogger(__package__)
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
        Address of the folder of the files. It contains a commit, so that the files cannot change.
    files : tuple of str
        Paths of the files below `home`.
    sha256 : tuple of str, default ()
        Checksums of `files` in the same order, or empty if they are unknown.
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
            else "checked: only the commit in the address, no sha256 is known yet, except from an earlier download"
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
        recordings=from_raw.motionsense,
    ),
    "difronzo": Dataset(
        "Di Fronzo: activities of four people in one recording each, phone in the trouser pocket",
        "MIT (Copyright (c) 2022 Andreas Lien)",
        "A. Lien, LSTM for Human Activity Recognition classification, github.com/DiFronzo",
        f"{_GITHUB}/DiFronzo/LSTM-for-Human-Activity-Recognition-classification/"
        "eddd71717d52b4de26f3e9f04f12c74ed3ea7989/raw data",
        ("labels.txt", *(f"{sensor}_{trial}.txt" for trial in from_raw.DIFRONZO for sensor in ("acc", "gyro"))),
        recordings=from_raw.difronzo,
    ),
    "ms_indoor": Dataset(
        "Indoor Location Competition 2.0: walks in a mall with points of the floor plan",
        "MIT (Copyright (c) 2017-2020 XYZ10, Inc. https://dangwu.com/)",
        "Indoor Location Competition 2.0, sample data (Microsoft Research and XYZ10, Inc.)",
        f"{_GITHUB}/location-competition/indoor-location-competition-20/2315bf92da0b91d82fb08c205857c5b83712642c/data/site1",
        tuple(f"{floor}/path_data_files/{name}.txt" for floor, names in WALKS.items() for name in names.split()),
        recordings=from_raw.ms_indoor,
    ),
    "oxford": Dataset(
        "Oxford step counter data set: walks of one person with the phone in seven places, accelerometer alone",
        "CC BY 4.0",
        "D. Salvi, C. Velardo, J. Brynes, L. Tarassenko, An optimised algorithm for accurate steps counting from "
        "smart-phone accelerometry, EMBC 2018, 4423-4427, doi:10.1109/EMBC.2018.8513319",
        f"{_GITHUB}/Oxford-step-counter/DataSet/c4121c5aa8d830a9f12de8f599043c234a4e192c/optimisation/data",
        tuple(
            f"Pixel_Jamie_Hard_{walk}/{file}.csv"
            for walk in from_raw.OXFORD
            for file in ("accelerometer", "stepcounter")
        ),
        recordings=from_raw.oxford,
    ),
    "tyrex": Dataset(
        "On Attitude Estimation with Smartphones: motions of one person with the phone in hands and pockets",
        "CeCILL 2.1",
        "T. Michel, H. Fourati, P. Geneves, N. Layaida, On Attitude Estimation with Smartphones, Tyrex team (LIG, "
        "Inria) and NeCS team (Gipsa-Lab, Inria), France, 2016",
        f"{_GITHUB}/tyrex-team/benchmarks-attitude-smartphones/7b070df5231ac78910ab076eeb026d2d8152a246/datasets/android",
        tuple(
            f"Thibaud_Nexus5_{trial}/{sensor}.txt"
            for trial in from_raw.TYREX
            for sensor in ("accelerometer", "gyroscope-calibrated")
        ),
        recordings=from_raw.tyrex,
    ),
}


def fetch(name: str, folder: str | Path | None = None, mirror: str | Path | None = None) -> list[Path]:
    """Return the paths of the recordings of a data set, and download missing ones.

    The recordings are zip files in the format of this package, in `folder / name`. They contain person, labels and
    ground truth as far as these are published. A floor plan, if there is one, is `folder / "maps" / "NAME.geojson"`.

    Parameters
    ----------
    name : str
        One of `DATASETS`, or the name of a folder in the folder that the environment variable PDR_DATA names.
    folder : str or Path, optional
        Folder of the data sets, with one folder for each. The default is `cache_folder()`.
    mirror : str or Path, optional
        Folder with copies of the published files, `mirror / name / file` for each of `DATASETS[name].files`. They are
        used instead of the network.

    Returns
    -------
    list of Path
        Files for `pdr_filter.read`, sorted.

    Raises
    ------
    ValueError
        If the name is unknown, if a checksum differs, or if `folder / name` is an unfinished data set.
    ImportError
        If the package for downloads is not installed.
    ConnectionError
        If the site cannot be reached, or a file of the mirror is missing.

    Notes
    -----
    `folder / name` appears when the data set is complete. Until then its files are in `folder / ".NAME.partial"`, where
    the next call continues. Downloaded files are kept in `.raw` next to the zip files. Their checksums are in
    `SHA256SUMS`, in the format of `sha256sum --check`. No public address could be reached when the table of data sets
    was written. The table therefore contains no checksums yet. The checksums of the first complete download are also
    kept in `folder / ".NAME.sha256"`. A later download from the same address is compared with them, also after the data
    set was deleted.

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
    to, partial, first = folder / name, folder / f".{name}.partial", folder / f".{name}.sha256"
    if not (to / _ATTRIBUTION).is_file():
        if to.exists():
            raise ValueError(
                f"{to} has no {_ATTRIBUTION}, so that it is not a complete data set: delete it, or give another folder"
            )
        source = dataset.home if mirror is None else Path(mirror) / name
        print(f"{dataset.about()}{_size(source, dataset.files)}", end="", file=sys.stderr)
        try:
            _load(name, dataset, source, partial / _RAW, _known_checksums(dataset, first))
        except BaseException:
            _remove_empty(partial)
            raise
        _write(name, dataset, partial, folder / "maps" / f"{name}.geojson")
        rows = (partial / _RAW / _CHECKSUMS).read_text(encoding="utf-8").splitlines(keepends=True)
        write_text(first, "".join(row.replace("  ", f"  {dataset.home}/", 1) for row in rows))
        partial.rename(to)
    return recordings_in(to)


def cache_folder() -> Path:
    """Return the default folder of the data sets: the user's cache folder for reproducible files."""
    return Path(load_optional("pooch").os_cache("pdr_filter"))


def _write(name: str, dataset: Dataset, to: Path, plan: Path) -> None:
    """Convert the downloaded files of a data set. Write its recordings to `to` and its floor plan to `plan`.

    Their metadata have the licence.
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


def _known_checksums(dataset: Dataset, first: Path) -> dict[str, str]:
    """Return the checksums by file: those of the table, or else those of the first download from the same address."""
    rows = first.read_text(encoding="utf-8").splitlines() if first.is_file() else []
    received = {where: checksum for checksum, _, where in (row.partition("  ") for row in rows)}
    known = {file: received[where] for file in dataset.files if (where := f"{dataset.home}/{file}") in received}
    return known | dict(zip(dataset.files, dataset.sha256, strict=False))


def _load(name: str, dataset: Dataset, source: str | Path, raw: Path, known: Mapping[str, str]) -> None:
    """Copy the missing files of a data set to a folder, from an address or from the folder of a mirror.

    Each file is written under another name, and renamed when it is complete and its checksum is right. ValueError if a
    file has another checksum, ConnectionError if it cannot be loaded.
    """
    for file in dataset.files:
        if (raw / file).is_file():
            continue
        where = f"{source}/{file}"
        try:
            with whole_file(raw / file) as content:
                if isinstance(source, Path):
                    with (source / file).open("rb") as copy:
                        shutil.copyfileobj(copy, content)
                else:
                    load_optional("pooch").HTTPDownloader()(quote(where, ":/"), content, None)
                content.flush()
                with Path(content.name).open("rb") as written:
                    received = hashlib.file_digest(written, "sha256").hexdigest()
                if known.get(file, received) != received:
                    raise ValueError(
                        f"{name}: {where} has changed since its checksum was recorded, in the table of data sets or, "
                        f"at the first download, in .{name}.sha256: do not use the file, and report this to the "
                        "maintainers of pdr_filter"
                    )
        except OSError as error:  # some errors of requests are also ValueError
            raise ConnectionError(
                f"{name}: {where} cannot be downloaded ({type(error).__name__}: {str(error)[:200]}); connect to the "
                "network and call fetch again, which resumes the download, or copy the data set to a folder "
                f"{name} in the folder of the environment variable PDR_DATA"
            ) from error
        _LOG.info("%s: received %s", name, where)


def _size(source: str | Path, files: Sequence[str]) -> str:
    """Return the number and size of the files as a line of text. The size is unknown if the site does not state it."""
    try:
        if isinstance(source, Path):
            n_bytes = sum((source / file).stat().st_size for file in files)
        else:
            with load_optional("requests").Session() as session:
                heads = [session.head(quote(f"{source}/{file}", ":/"), timeout=10) for file in files]
            n_bytes = sum(int(head.headers["Content-Length"]) for head in heads if head.ok)
        return f"size: {n_bytes / 1e6:.1f} MB in {len(files)} files\n"
    except (OSError, KeyError):
        return f"size: {len(files)} files, unknown number of bytes\n"


def _remove_empty(folder: Path) -> None:
    """Remove a folder and its subfolders if they have no files."""
    below = [path for path in folder.rglob("*") if path.is_dir()]
    for path in (*sorted(below, reverse=True), folder):
        with suppress(OSError):  # not empty
            path.rmdir()


def _unpack(archive: Path) -> None:
    """Extract the .csv and .txt files of a zip file to a folder of the same name, within the limits of the readers."""
    with open_members(archive) as members:
        for name in members.names:
            place = archive.with_suffix("") / name
            if not place.is_file() and name.lower().endswith((".csv", ".txt")):
                with whole_file(place) as file:
                    file.writelines(members.parts(name))
