"""The libraries of the pages, from npm into pdr_filter/apps/report/assets: `python .ci/vendor.py`.

Names, versions and npm's checksums stand in assets/libraries.json, with the checksum of each file that was written.
For a newer version change version and integrity there (`npm view NAME@VERSION dist.integrity`), and run this.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
import subprocess
import tarfile
import tempfile
from pathlib import Path

ASSETS = Path(__file__).parents[1] / "pdr_filter" / "apps" / "report" / "assets"
LIST = ASSETS / "libraries.json"


def packed(name: str, version: str, integrity: str) -> dict[str, bytes]:
    """The files of a package, if it is what npm had when the checksum was written."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(["npm", "pack", "--silent", f"{name}@{version}"], cwd=folder, check=True)
        (archive,) = Path(folder).iterdir()
        found = base64.b64encode(hashlib.sha512(archive.read_bytes()).digest()).decode()
        if integrity != f"sha512-{found}":
            raise SystemExit(f"{name} {version} has the checksum sha512-{found}, not {integrity}")
        with tarfile.open(archive) as opened:
            members = [m for m in opened.getmembers() if m.isfile()]
            return {m.name.removeprefix("package/"): opened.extractfile(m).read() for m in members}


def alone(path: str, content: bytes) -> bytes:
    """A file that names no other: no pictures of controls and markers that the pages do not have, no source map."""
    content = content.replace(b"\r\n", b"\n")
    if path.endswith(".css"):
        content = re.sub(rb"\s*[\w-]+:\s*url\([^)]*\);?", b"", content)
    return re.sub(rb"\s*//# sourceMappingURL=\S+\s*$", b"\n", content)


def main() -> None:
    """Write all of them."""
    libraries = json.loads(LIST.read_text(encoding="utf-8"))
    for library in libraries:
        files = packed(library["name"], library["version"], library["integrity"])
        for name, of in library["files"].items():
            content = alone(of["from"], files[of["from"]])
            (ASSETS / name).write_bytes(content)
            of["sha256"] = hashlib.sha256(content).hexdigest()
    LIST.write_text(json.dumps(libraries, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
