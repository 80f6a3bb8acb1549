"""Training of all shipped models from public recordings, as `make models` does, and comparison with the shipped files.

Run it with `python -m models.training.make_models OUT_DIR [MIRROR_DIR]`. A data set comes from MIRROR_DIR / NAME, which
has recordings (.zip) or the published files, or else from the network (`pdr_filter.datasets.fetch`). Before the
training, each recording is compared with `recordings.sha256`, because only the same recordings give the same models.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path

from models.training import context_training as contexts
from models.training.data_sets import DUPLICATES
from models.training.guo2018_training import DATASETS as POSE_DATASETS
from pdr_filter.data import datasets
from pdr_filter.data.io.formats import read
from pdr_filter.values.recording import Recording

MODELS = Path(__file__).resolve().parents[1]
CHECKSUMS = Path(__file__).with_name("recordings.sha256")
NAMES = tuple(sorted({*POSE_DATASETS, *(name for plan in contexts.PLANS for name in plan.datasets)}))
# Data sets that `fetch` does not know, because the addresses of their files could not be verified.
OWNERS = {
    "oxford": "Oxford step counter data set, CC BY 4.0, Salvi et al., EMBC 2018, doi:10.1109/EMBC.2018.8513319",
    "tyrex": "On Attitude Estimation with Smartphones, CeCILL 2.1, http://tyrex.inria.fr/mobile/benchmarks-attitude",
}


def gathered(mirror: Path | None, folder: Path | None = None) -> list[Path]:
    """Return the paths of all recordings of the training, and download missing data sets.

    Titles, licences and sizes are printed first. ValueError if a data set can neither be found nor downloaded.
    """
    here = {name: _recordings(mirror / name) for name in NAMES} if mirror is not None else dict[str, list[Path]]()
    absent = [f"{name} ({OWNERS[name]})" for name in OWNERS if not here.get(name)]
    if absent:
        raise ValueError(
            f"these data sets cannot be downloaded: {'; '.join(absent)}: ask their owners, convert them to recordings "
            "(docs/formats.md) in folders of these names, and give the folder above them, make models MIRROR=FOLDER"
        )
    for name, paths in here.items():
        if paths:
            n_bytes = sum(path.stat().st_size for path in paths)
            licence = read(paths[0]).meta.get("licence", "not stated")
            print(f"{name}: {len(paths)} recordings, {n_bytes / 1e6:.1f} MB, licence: {licence}", file=sys.stderr)
    return [path for name in NAMES for path in here.get(name) or _fetched(name, folder, mirror)]


def _fetched(name: str, folder: Path | None, mirror: Path | None) -> list[Path]:
    """Return the recordings of a data set from its published files, in the mirror if it has them."""
    has_files = mirror is not None and (mirror / name).is_dir()
    return _without_duplicates(datasets.fetch(name, folder, mirror if has_files else None))


def checksum(recording: Recording) -> str:
    """Return the SHA-256 of all that a training uses: samples of accelerometer and gyroscope, and labels."""
    content = hashlib.sha256()
    for samples in (recording.accelerometer, recording.gyroscope):
        if samples is not None:
            content.update(samples.time_s.tobytes() + samples.values.tobytes())
    content.update(repr(None if recording.truth.labels is None else recording.truth.labels.tolist()).encode())
    return content.hexdigest()


def different(paths: Iterable[Path], known: Mapping[str, str]) -> list[str]:
    """Return the names of recordings that are missing, unknown, or have another checksum."""
    found = {path.stem: checksum(read(path)) for path in paths}
    return sorted(name for name in found.keys() | known.keys() if found.get(name) != known.get(name))


def known_checksums() -> dict[str, str]:
    """Return the checksums of the recordings with which the shipped models are trained, by name."""
    rows = (line.split() for line in CHECKSUMS.read_text(encoding="utf-8").splitlines())
    return {name: value for value, name in rows}


def compared(out_dir: Path, shipped: Path = MODELS) -> dict[str, bool]:
    """Return for each shipped file whether the new file has the same bytes."""
    files = sorted(path.name for path in shipped.iterdir() if path.suffix in (".npz", ".json"))
    return {
        name: (out_dir / name).is_file() and (out_dir / name).read_bytes() == (shipped / name).read_bytes()
        for name in files
    }


def _recordings(folder: Path) -> list[Path]:
    return _without_duplicates(sorted(folder.glob("*.zip")))


def _without_duplicates(paths: Iterable[Path]) -> list[Path]:
    return [path for path in paths if path.stem not in DUPLICATES]


def main(out_dir: Path, mirror: Path | None = None) -> None:
    """Check the recordings, train the models, and print which files are equal to the shipped ones."""
    from models.training import train_all  # by its name, because other processes cannot import __main__

    paths = gathered(mirror)
    if names := different(paths, known_checksums()):
        print(f"the models will differ, because {len(names)} recordings do: {', '.join(names[:5])}", file=sys.stderr)
    out_dir.mkdir(parents=True, exist_ok=True)
    train_all.train_on(paths, out_dir, lambda what, done: print(f"{100 * done:5.1f} %  {what}", flush=True))
    for name, is_equal in compared(out_dir).items():
        print(f"{'equal' if is_equal else 'DIFFERENT':<10} {name}")


if __name__ == "__main__":
    main(*map(Path, filter(None, sys.argv[1:3])))
