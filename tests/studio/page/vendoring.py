"""The packages that the studio's page carries: ``python -m tests.studio.page.vendoring`` fetches them anew.

Each is pinned to a version and to the hash of its archive that the registry had then; of each only the files that the
page needs are kept, as they are, with the licence. ``VENDORED.json`` has the SHA-256 of every file.
"""

from __future__ import annotations

import base64
import hashlib
import json
import subprocess
import tarfile
import tempfile
from pathlib import Path

from heartcase.studio.serving.app import PAGE

VENDOR = PAGE / "vendor"
TABLE = VENDOR / "VENDORED.json"
PACKAGES = {
    "three": {
        "version": "0.180.0",
        "integrity": "sha512-o+qycAMZrh+TsE01GqWUxUIKR1AL0S8pq7zDkYOQw8GqfX8b8VoCKYUoHbhiX5j+7hr8XsuHDVU6+gkQJQKg9w==",
        "licence": "MIT",
        "files": ("LICENSE", "build/three.module.min.js", "build/three.core.min.js"),
    }
}


def sha256(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def fetch() -> None:
    """Fetch all packages from the registry, refuse another archive than the pinned one, and write the table."""
    table = {}
    for name, package in PACKAGES.items():
        with tempfile.TemporaryDirectory() as folder:
            subprocess.run(["npm", "pack", "--silent", f"{name}@{package['version']}"], cwd=folder, check=True)
            archive = next(Path(folder).glob("*.tgz"))
            digest = "sha512-" + base64.b64encode(hashlib.sha512(archive.read_bytes()).digest()).decode()
            if digest != package["integrity"]:
                raise SystemExit(f"{name}: the archive is not the pinned one: {digest}")
            kept = VENDOR / name
            kept.mkdir(parents=True, exist_ok=True)
            hashes = {}
            with tarfile.open(archive) as opened:
                for inner in package["files"]:
                    member = opened.extractfile(f"package/{inner}")
                    assert member is not None
                    file = kept / Path(inner).name
                    file.write_bytes(member.read())
                    hashes[f"{name}/{file.name}"] = sha256(file)
        table[name] = {key: package[key] for key in ("version", "integrity", "licence")} | {"sha256": hashes}
    TABLE.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    fetch()
