"""Whether wheels for other processors and Pythons are of the same sources as ours, as far as that can be seen.

    python -m tools.check_wheels FOLDER WHEEL...

In FOLDER are ours. What is compiled differs; all other files and the metadata must be the same.
"""

from __future__ import annotations

import sys
from pathlib import Path
from zipfile import ZipFile

_OF_THE_BUILD = (".so", ".dist-info/WHEEL", ".dist-info/RECORD")


def differences(ours: Path, wheel: Path) -> list[str]:
    """The files that only one of two wheels has, or that are not the same."""
    first, second = _contents(ours), _contents(wheel)
    return sorted(name for name in {*first, *second} if first.get(name) != second.get(name))


def _contents(wheel: Path) -> dict[str, bytes]:
    with ZipFile(wheel) as zipped:
        contents = {name: zipped.read(name) for name in zipped.namelist() if not name.endswith(_OF_THE_BUILD)}
    # The first line of the metadata is their version, which is that of the builder.
    return {name: text.partition(b"\n")[2] if name.endswith("/METADATA") else text for name, text in contents.items()}


def check(folder: Path, wheel: Path) -> None:
    """End with a sentence if a wheel is not of the sources of that in a folder."""
    name, version = wheel.name.split("-")[:2]
    ours = min(folder.glob(f"{name}-{version}-*.whl"), default=None)
    if ours is None:
        raise SystemExit(f"{wheel}: {folder} has no wheel of {name} {version}")
    if found := differences(ours, wheel):
        raise SystemExit(
            f"{wheel} is of other sources, or of another URL, than {ours.name}, from {found[0]} on: "
            "make it again, or delete it"
        )


if __name__ == "__main__":
    for argument in sys.argv[2:]:
        check(Path(sys.argv[1]), Path(argument))
