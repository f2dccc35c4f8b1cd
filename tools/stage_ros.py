"""Lay out the packages for ROS 2 with who maintains them and where, for those to whom they are given.

    python -m tools.stage_ros "NAME <MAIL>" URL FOLDER

In the repository nobody's address is in that place, as the format demands one.
"""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path
from xml.sax.saxutils import escape

NAME, MAIL = "The autoexpose-daemon authors", "nobody@autoexpose-daemon.invalid"
_COMMENT = re.compile(r" *<!-- The format demands .*-->\n")


def stage(maintainer: str, url: str, folder: Path) -> None:
    """Lay out all packages, each with our licence, in a folder, which is replaced."""
    name, _, mail = maintainer.rstrip(">").rpartition(" <")
    licence = "<license>MIT</license>\n"
    address = f'{licence}  <url type="website">{escape(url)}</url>\n'
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree("ros", folder, ignore=shutil.ignore_patterns("__pycache__"))
    for manifest in folder.glob("*/package.xml"):
        shutil.copy("LICENSE", manifest.parent)
        text = _COMMENT.sub("", manifest.read_text(encoding="utf-8")).replace(licence, address)
        text = text.replace(MAIL, escape(mail)).replace(NAME, escape(name))
        manifest.write_text(text, encoding="utf-8")
    for setup in folder.glob("*/setup.py"):
        text = setup.read_text(encoding="utf-8")
        setup.write_text(text.replace(f'"{NAME}"', repr(name)).replace(f'"{MAIL}"', repr(mail)), encoding="utf-8")


if __name__ == "__main__":
    stage(sys.argv[1], sys.argv[2], Path(sys.argv[3]))
