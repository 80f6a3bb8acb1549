"""Two servers do not write to one folder."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from pdr_filter.apps.cli.app import app
from pdr_filter.apps.live.folder_lock import folder_lock

HOLD = """
import sys, time
from pathlib import Path
from pdr_filter.apps.live.folder_lock import folder_lock
with folder_lock(Path(sys.argv[1]), "pdr-filter live at http://127.0.0.1:8000"):
    print("held", flush=True)
    time.sleep(60)
"""


def test_a_second_process_is_refused_with_the_name_of_the_first_until_that_is_killed(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", HOLD, str(tmp_path)], stdout=subprocess.PIPE) as first:
        assert first.stdout is not None
        assert first.stdout.readline().strip() == b"held"
        words = rf"live at http://127\.0\.0\.1:8000 \(process {first.pid} on .*give another folder"
        with pytest.raises(ValueError, match=words), folder_lock(tmp_path, "another"):
            pass
        first.send_signal(signal.SIGKILL)
        first.wait(10)
    with folder_lock(tmp_path, "another"):
        assert "another" in (tmp_path / ".lock").read_text()


@pytest.mark.skipif(sys.platform == "win32", reason="Windows does not delete a file in use")
def test_a_folder_whose_lock_file_was_deleted_is_still_refused_to_a_second_server(tmp_path: Path) -> None:
    with folder_lock(tmp_path, "one"):
        (tmp_path / ".lock").unlink()
        for _ in range(2):
            with pytest.raises(ValueError, match="is in use by another process"), folder_lock(tmp_path, "two"):
                pass
    with folder_lock(tmp_path, "two"):
        assert "two" in (tmp_path / ".lock").read_text()


@pytest.mark.parametrize(
    ("command", "written"),
    [
        (["live", "--https", "--record"], ""),
        (["app", "--no-browser"], ".pdr_filter"),
        (["app", "--host", "0.0.0.0"], "phones"),
    ],
)
def test_the_commands_of_servers_end_at_a_locked_folder(tmp_path: Path, command: list[str], written: str) -> None:
    with folder_lock(tmp_path / written, "pdr-filter live at http://127.0.0.1:8000"):
        done = CliRunner().invoke(app, [*command, str(tmp_path), "--port", "0"])
    assert done.exit_code == 2
    assert "in use by pdr-filter live at http://127.0.0.1:8000" in " ".join(done.output.split())
    assert not (tmp_path / "certificate").exists()
