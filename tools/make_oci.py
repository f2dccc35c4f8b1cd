"""Pack a root file system as an OCI image, in one tar file that podman, skopeo, umoci and docker read.

python -m tools.make_oci ROOT FILE NAME:TAG ARCHITECTURE
"""

from __future__ import annotations

import hashlib
import io
import json
import subprocess
import sys
import tarfile
import tempfile
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

PROGRAM = {
    "Entrypoint": ["autoexpose"],
    "Cmd": ["doctor"],
    "Env": [
        "PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin",
        "PYTHONUNBUFFERED=1",
        "STATE_DIRECTORY=/var/lib/autoexpose",
        "RUNTIME_DIRECTORY=/run/autoexpose",  # as systemd says it: where the rig's socket is
    ],
    "WorkingDir": "/var/lib/autoexpose",
    "StopSignal": "SIGTERM",
}
_KIND = "application/vnd.oci.image"
_BLOCK = 1 << 20


class Layout:
    """The files of an OCI image, which are written into a tar file."""

    def __init__(self, tar: tarfile.TarFile) -> None:
        self._tar = tar

    def add(self, name: str, document: Any) -> None:
        """Add a file of JSON."""
        content = json.dumps(document).encode()
        entry = tarfile.TarInfo(name)
        entry.size = len(content)
        self._tar.addfile(entry, io.BytesIO(content))

    def document(self, kind: str, document: Any) -> dict[str, Any]:
        """Add JSON under its digest; returns its descriptor."""
        content = json.dumps(document).encode()
        digest = hashlib.sha256(content).hexdigest()
        self.add(f"blobs/sha256/{digest}", document)
        return {"mediaType": f"{_KIND}.{kind}+json", "digest": f"sha256:{digest}", "size": len(content)}

    def layer(self, compressed: Path) -> dict[str, Any]:
        """Add a layer under its digest; returns its descriptor."""
        digest = sha256(compressed)
        self._tar.add(compressed, f"blobs/sha256/{digest}")
        return {
            "mediaType": f"{_KIND}.layer.v1.tar+gzip",
            "digest": f"sha256:{digest}",
            "size": compressed.stat().st_size,
        }


def sha256(file: Path) -> str:
    """The digest of a file that need not fit into memory."""
    digest = hashlib.sha256()
    with file.open("rb") as content:
        while block := content.read(_BLOCK):
            digest.update(block)
    return digest.hexdigest()


def pack(root: Path, file: Path, name: str, architecture: str) -> None:
    """Write the image, of one layer, of a root file system."""
    with tempfile.TemporaryDirectory(dir=file.parent) as folder, tarfile.open(file, "w") as tar:
        layer = Path(folder, "layer.tar")
        as_it_is = ["--sort=name", "--numeric-owner", "--xattrs", "--one-file-system"]
        subprocess.run(["tar", "-C", root, *as_it_is, "-cf", layer, "."], check=True)
        content = sha256(layer)
        subprocess.run(["gzip", "--no-name", layer], check=True)
        image = Layout(tar)
        layers = [image.layer(layer.with_suffix(".tar.gz"))]
        config = image.document(
            "config.v1",
            {
                "architecture": architecture,
                "os": "linux",
                "created": datetime.now(timezone.utc).isoformat(),
                "config": PROGRAM,
                "rootfs": {"type": "layers", "diff_ids": [f"sha256:{content}"]},
            },
        )
        kind = f"{_KIND}.manifest.v1+json"
        document = {"schemaVersion": 2, "mediaType": kind, "config": config, "layers": layers}
        names = {
            "org.opencontainers.image.ref.name": name.partition(":")[2],
            "io.containerd.image.name": f"docker.io/library/{name}",
        }
        manifest = image.document("manifest.v1", document) | {"annotations": names}
        image.add("index.json", {"schemaVersion": 2, "mediaType": f"{_KIND}.index.v1+json", "manifests": [manifest]})
        image.add("oci-layout", {"imageLayoutVersion": "1.0.0"})
        # Where a docker older than 25 looks.
        blobs = ["blobs/" + part["digest"].replace(":", "/") for part in (config, *layers)]
        image.add("manifest.json", [{"Config": blobs[0], "RepoTags": [name], "Layers": blobs[1:]}])


if __name__ == "__main__":
    pack(Path(sys.argv[1]), Path(sys.argv[2]), *sys.argv[3:])
