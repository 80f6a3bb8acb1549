"""Training of all shipped models from public recordings, as `make models` does, and comparison with the shipped files.

Run it with `python -m models.training.make_models OUT_DIR [MIRROR_DIR]`. A data set comes from MIRROR_DIR / NAME, which
has recordings (.zip) or the published files, or else from the network (`pdr_filter.datasets.fetch`). Before the
training, each recording is compared with `recordings.sha256`, because only the same recordings give the same models.
Models that OUT_DIR already has are kept, so that an interrupted training resumes. The result is the table
`docs/tables/models_made.md`.
"""

from __future__ import annotations

import hashlib
import json
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from joblib import cpu_count

from models.training import context_training as contexts
from models.training.data_sets import DUPLICATES
from models.training.guo2018_training import DATASETS as POSE_DATASETS
from pdr_filter.data import datasets
from pdr_filter.data.io.formats import read
from pdr_filter.values.recording import Recording
from tests.benchmarks.common import FOLDER, Tables

MODELS = Path(__file__).resolve().parents[1]
CHECKSUMS = Path(__file__).with_name("recordings.sha256")
NAMES = tuple(sorted({*POSE_DATASETS, *(name for plan in contexts.PLANS for name in plan.datasets)}))
SECONDS = "seconds.json"  # time of each model, in the folder of the new models


def gathered(mirror: Path | None, folder: Path | None = None) -> list[Path]:
    """Return the paths of all recordings of the training, and download missing data sets.

    Licence and size of each data set are printed before it is used.
    """
    return [path for name in NAMES for path in _in_mirror(name, mirror) or _fetched(name, folder, mirror)]


def _in_mirror(name: str, mirror: Path | None) -> list[Path]:
    """Return the recordings of a data set in the mirror, and print their licence and size. Empty without recordings."""
    paths = [] if mirror is None else _without_duplicates(sorted((mirror / name).glob("*.zip")))
    if paths:
        n_bytes = sum(path.stat().st_size for path in paths)
        licence = read(paths[0]).meta.get("licence", "not stated")
        print(f"{name}: {len(paths)} recordings, {n_bytes / 1e6:.1f} MB, licence: {licence}", file=sys.stderr)
    return paths


def _fetched(name: str, folder: Path | None, mirror: Path | None) -> list[Path]:
    """Return the recordings of a data set from its published files, in the mirror if it has them."""
    has_files = mirror is not None and (mirror / name).is_dir()
    return _without_duplicates(datasets.fetch(name, folder, mirror if has_files else None))


def _without_duplicates(paths: Iterable[Path]) -> list[Path]:
    return [path for path in paths if path.stem not in DUPLICATES]


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


def model_names(folder: Path) -> list[str]:
    """Return the names of the models in a folder, sorted."""
    return sorted(path.stem for path in folder.glob("*.npz") if path.with_suffix(".json").is_file())


def are_equal(name: str, out_dir: Path, shipped: Path = MODELS) -> bool:
    """Return True if a new model has the same bytes as the shipped one, in both files."""
    files = [f"{name}.npz", f"{name}.json"]
    return all(
        (out_dir / file).is_file() and (out_dir / file).read_bytes() == (shipped / file).read_bytes() for file in files
    )


class Stopwatch:
    """Progress of a training that also measures the time of each model.

    The time of a model begins when the model before it is written. It is kept in the file `SECONDS`. With a single
    process it is processor time, which does not depend on other programs, otherwise elapsed time.
    """

    def __init__(self, out_dir: Path) -> None:
        self._out_dir, self._file = out_dir, out_dir / SECONDS
        self.seconds: dict[str, float] = json.loads(self._file.read_text()) if self._file.is_file() else {}
        self._clock, self.unit = (
            (time.process_time, "processor time of one process")
            if cpu_count() == 1
            else (time.monotonic, f"elapsed time with {cpu_count()} processes")
        )
        self._known, self._start_s = set(model_names(out_dir)), self._clock()

    def __call__(self, what: str, done: float) -> None:
        """Print the progress, and note the time of the models that are new since the last call."""
        print(f"{100 * done:5.1f} %  {what}", flush=True)
        if new := set(model_names(self._out_dir)) - self._known:
            self._known |= new
            now_s = self._clock()
            # models of one fit, such as the parts of a mixture, share its time
            self.seconds |= dict.fromkeys(new, round((now_s - self._start_s) / len(new), 1))
            self._start_s = now_s
            self._file.write_text(json.dumps(self.seconds, indent=1, sort_keys=True) + "\n", encoding="utf-8")


def table_rows(out_dir: Path, seconds: Mapping[str, float], shipped: Path = MODELS) -> list[Sequence[object]]:
    """Return the rows of the table: model, seconds, equal bytes or not, and the versions on the new card."""
    rows: list[Sequence[object]] = []
    trained = model_names(out_dir)
    for name in model_names(shipped):
        if name not in trained:
            rows.append([f"`{name}`", "", "not trained", ""])
            continue
        card = json.loads((out_dir / f"{name}.json").read_text(encoding="utf-8"))["card"]
        versions = ", ".join(f"{package} {version}" for package, version in card["versions"].items())
        equal = "yes" if are_equal(name, out_dir, shipped) else "**no**"
        rows.append([f"`{name}`", f"{seconds[name]:.0f}" if name in seconds else "", equal, versions])
    return rows


def main(out_dir: Path, mirror: Path | None = None, tables: Path = FOLDER) -> None:
    """Check the recordings, train the models that `out_dir` lacks, and write the table of comparisons."""
    from models.training import train_all  # by its name, because other processes cannot import __main__

    paths = gathered(mirror)
    if names := different(paths, known_checksums()):
        print(f"the models will differ, because {len(names)} recordings do: {', '.join(names[:5])}", file=sys.stderr)
    out_dir.mkdir(parents=True, exist_ok=True)
    kept = set(model_names(out_dir))
    if kept:
        print(f"kept, delete them to train them again: {', '.join(sorted(kept))}", file=sys.stderr)
    stopwatch = Stopwatch(out_dir)
    train_all.train_models(paths, out_dir, stopwatch, kept)
    stopwatch("done", 1.0)
    Tables("python -m models.training.make_models build/models MIRROR", tables).write(
        "models_made",
        "model | seconds | equal bytes | versions",
        table_rows(out_dir, stopwatch.seconds),
        f"Training of the shipped models from public recordings, and comparison with the shipped files. Seconds are "
        f"{stopwatch.unit}.",
    )


if __name__ == "__main__":
    from models.training import make_models  # by its name, as above

    make_models.main(*map(Path, filter(None, sys.argv[1:3])))
