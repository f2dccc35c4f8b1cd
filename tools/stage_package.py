"""Lay out the source of a package for others below one import name, from the rooms of this repository.

    python -m tools.stage_package NAME FOLDER

The rooms (`drivers`, `calibration` ...) are top-level packages here, and would be in anybody's environment, where such
names collide. So imports are rewritten: in the package `autoexpose-daemon` all other rooms are below
`autoexpose_daemon`. `autoexpose-client` gets the modules that its face imports, `camera-twin` the fake cameras, and
`autoexpose-lab` what is for a desk or on top of the daemon. What is laid out needs nothing else to be built. If the
project has a home page, it comes from the environment: URL=https://...
"""

from __future__ import annotations

import ast
import os
import re
import shutil
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

ROOMS = (
    "autoexpose_daemon",
    "calibration",
    "documents",
    "drivers",
    "evaluation",
    "fake_camera",
    "imaging",
    "navigation",
)
_DATA = (".msg", ".typed")
_WITHOUT = shutil.ignore_patterns("__pycache__", "*.so")


@dataclass(frozen=True)
class Package:
    """What is in a package, and where.

    Attributes
    ----------
    homes
        Its rooms, and the module that each becomes.
    beside
        The same of the rooms that it imports from another package.
    face
        A module: only what that imports, directly or not, is in the package; empty: all modules are.
    """

    homes: Mapping[str, str]
    beside: Mapping[str, str] = field(default_factory=dict)
    face: str = ""


_LAB = ("evaluation", "navigation")
_DAEMON = {room: f"autoexpose_daemon.{room}" for room in ROOMS[1:] if room not in _LAB} | {ROOMS[0]: ROOMS[0]}

PACKAGES = {
    "autoexpose-daemon": Package(_DAEMON),
    "autoexpose-lab": Package({room: f"autoexpose_lab.{room}" for room in _LAB}, beside=_DAEMON),
    "autoexpose-client": Package(
        {
            "autoexpose_daemon": "autoexpose_client",
            **{room: f"autoexpose_client.{room}" for room in ("calibration", "documents", "drivers", "imaging")},
        },
        face="autoexpose_daemon.client",
    ),
    "camera-twin": Package({"fake_camera": "camera_twin"}),
}


def stage(name: str, folder: Path) -> None:
    """Lay out a package in a folder, which is replaced."""
    package = PACKAGES[name]
    shutil.rmtree(folder, ignore_errors=True)
    for room, home in package.homes.items():
        shutil.copytree(room, folder / _path(home), ignore=_WITHOUT, dirs_exist_ok=True)
    if package.face:
        _leave(folder, {_home(module, package.homes) for module in reached(package.face)})
    own = Path("packages", name)
    if own.is_dir():
        shutil.copytree(own, folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns("__init__.py"))
        shutil.copy(own / "__init__.py", folder / name.replace("-", "_"))
    else:
        for source in ("setup.py", "README.md"):
            shutil.copy(source, folder)
    shutil.copy("LICENSE", folder)
    (folder / "pyproject.toml").write_text(_project(own) + _urls(os.environ.get("URL", "")), encoding="utf-8")
    rewrite = Rewriter({**package.homes, **package.beside})
    for file in [*folder.rglob("*.py"), folder / "pyproject.toml"]:
        file.write_text(rewrite(file.read_text(encoding="utf-8")), encoding="utf-8")


def _project(own: Path) -> str:
    """The pyproject.toml of a package: ours without its entry points, or its own with our version in place of 0.0.0."""
    tables = re.split(r"^(?=\[)", Path("pyproject.toml").read_text(encoding="utf-8"), flags=re.MULTILINE)
    points = [table for table in tables if table.startswith("[project.entry-points.")]
    if not own.is_dir():
        return "".join(table for table in tables if table not in points)
    (version,) = re.findall(r'^version = "(.+)"$', "".join(tables), re.MULTILINE)
    text = (own / "pyproject.toml").read_text(encoding="utf-8")
    return text.replace("0.0.0", version).replace("# @ENTRY-POINTS@\n", "".join(points))


def _urls(url: str) -> str:
    if url and not re.fullmatch(r'https?://[^\s"\\]+', url):
        raise SystemExit(f"{url} is no address of a project: give URL=https://...")
    return f'\n[project.urls]\nHomepage = "{url}"\n' if url else ""


class Rewriter:
    """Renames modules where a text imports them, or names them in quotes or in a command line."""

    def __init__(self, homes: Mapping[str, str]) -> None:
        rooms = "|".join(homes)
        self._homes = homes
        self._patterns = [
            re.compile(pattern, re.MULTILINE)
            for pattern in (
                rf"(?<=^from )({rooms})(?=[. ])",
                rf"(?<=^import )({rooms})(?=[.\s])",
                rf"(?<= from )({rooms})(?=[.\w]* import )",
                rf"(?<=[\"'])({rooms})(?=(?:\.\w+)+(?::\w+)?[\"'])",  # a module, an entry point
                rf"(?<=\"-m\", [\"'])({rooms})(?=[\"'])",
                rf"(?<=python -m )({rooms})\b",
                rf"(?<=[\"'/])({rooms})(?=/)",  # a path
            )
        ]

    def __call__(self, text: str) -> str:
        """The text with other names."""
        for pattern in self._patterns:
            text = pattern.sub(self._new, text)
        return text

    def _new(self, found: re.Match[str]) -> str:
        home = self._homes[found.group(1)]
        is_path = found.string[found.end() : found.end() + 1] == "/"
        return home.replace(".", "/") if is_path else home


def reached(module: str) -> set[str]:
    """A module of the repository and all that it imports of it, with their packages."""
    seen: set[str] = set()
    waiting = [module]
    while waiting:
        module = waiting.pop()
        if module not in seen:
            seen.add(module)
            waiting += _imported(module)
    return seen


def _imported(module: str) -> Iterator[str]:
    file = _file(module)
    assert file is not None, module
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] in ROOMS:
            yield node.module
            yield from (name for alias in node.names if _file(name := f"{node.module}.{alias.name}") is not None)
    if "." in module:
        yield module.rpartition(".")[0]


def _file(module: str) -> Path | None:
    path = Path(_path(module))
    return next((file for file in (path.with_suffix(".py"), path / "__init__.py") if file.is_file()), None)


def _home(module: str, homes: Mapping[str, str]) -> str:
    room, dot, rest = module.partition(".")
    return f"{homes[room]}{dot}{rest}"


def _path(module: str) -> str:
    return module.replace(".", "/")


def _leave(folder: Path, modules: set[str]) -> None:
    """Remove all modules but these, and what belongs to packages that are gone."""
    kept = {folder / _path(module) for module in modules}
    for file in [path for path in folder.rglob("*") if path.is_file()]:
        if file.suffix == ".py":
            stays = (file.parent if file.name == "__init__.py" else file.with_suffix("")) in kept
        else:
            stays = file.suffix in _DATA and any(parent in kept for parent in file.parents)
        if not stays:
            file.unlink()
    for path in sorted(folder.rglob("*"), reverse=True):
        if path.is_dir() and not any(path.iterdir()):
            path.rmdir()


if __name__ == "__main__":
    stage(sys.argv[1], Path(sys.argv[2]))
