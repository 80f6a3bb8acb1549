"""Size of saved filters, and time to save and load them, during real walks.

usage: python -m tests.benchmarks.saved_states [sizes] [--before TREE] [--seconds 120] [--every 7]

The first recording of each set by name, up to `--seconds`, with all its sensors. The filter is saved every `--every`
seconds. It is walking if it has reported a step since the last save. `--before` is another checkout of the project,
which is measured in turns. Times are of the processor, the least of three runs.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np

from tests.benchmarks.common import Tables, paths, run
from tests.benchmarks.throughput import in_tree, load, trees

SITES = ("ms_indoor", "oxiod", "ubicomp13", "tyrex", "oxford", "ipol", "motionsense", "ipin2023", "difronzo", "terrain")
# In another process, so that trees can be compared.
_OF_RECORDING = """
import json, sys, time
import pdr_filter as pdr

def best_ms(call):
    taken = []
    for _ in range(3):
        start = time.process_time()
        call()
        taken.append(1e3 * (time.process_time() - start))
    return min(taken)

recording, online, rows, n_before = pdr.read(sys.argv[1]), pdr.OnlineFilter(), [], 0
every_s, block = int(sys.argv[3]), pdr.merge_streams(recording)
pressure = recording.barometer
for second in range(int(min(recording.duration_s, float(sys.argv[2])))):
    lower = block.time_s[0] + second
    part = (block.time_s >= lower) & (block.time_s < lower + 1)
    samples = block.specific_force_mps2[part], block.angular_rate_radps[part], block.magnetic_field_ut[part]
    online.push(block.time_s[part], *samples)
    if pressure is not None:
        part = (pressure.time_s >= lower) & (pressure.time_s < lower + 1)
        online.push_pressure(pressure.time_s[part], pressure.values[part].ravel())
    if second % every_s == every_s - 1:
        n_steps, saved, small = online.now().n_steps, online.save(), online.save(path=False)
        times = [best_ms(call) for call in (lambda: online.save(path=False), online.save)]
        times.append(best_ms(lambda: pdr.OnlineFilter.load(small)))
        rows.append([n_steps > n_before, len(small) / 1e3, len(saved) / 1e3, *times])
        n_before = n_steps
print(json.dumps(rows))
"""


def sizes(tables: Tables, arguments: argparse.Namespace) -> None:
    """Kilobytes and milliseconds for each set and tree."""
    rows: list[list[object]] = []
    found: dict[str, list[list[float]]] = {name: [] for name in trees(arguments.before)}
    for site in SITES:
        path = str(paths(arguments.data, site)[0])
        for name, tree in trees(arguments.before).items():
            saved = in_tree(tree, _OF_RECORDING, path, str(arguments.seconds), str(arguments.every))
            found[name] += saved
            rows.append([site, name, *_cells(saved)])
    rows += [["all", name, *_cells(saved)] for name, saved in found.items()]
    columns = "set | tree | saves walking, other | kB walking | kB other | kB with path | "
    columns += "ms to save | ms with path | ms to load"
    about = "kB: median, largest, without the path if nothing else is said. ms: median, largest of one core"
    tables.write("saved_states", columns, rows, f"{about}, {load()}.")


def _cells(saved: Sequence[Sequence[float]]) -> list[str]:
    walking, small_kb, kb, *times_ms = np.array(saved, dtype=float).T
    is_walking = walking > 0

    def both(values: np.ndarray, digits: int = 0) -> str:
        return f"{np.median(values):.{digits}f}, {values.max():.{digits}f}" if len(values) else "-"

    numbers = f"{is_walking.sum()}, {(~is_walking).sum()}"
    of_sizes = both(small_kb[is_walking]), both(small_kb[~is_walking]), both(kb)
    return [numbers, *of_sizes, *(both(ms, 1) for ms in times_ms)]


if __name__ == "__main__":
    run(__doc__, sizes, before=None, seconds=120, every=7)
