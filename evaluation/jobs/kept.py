"""The results of jobs, each kept under a hash of all that made it: code, libraries, arguments and files."""

from __future__ import annotations

import ast
import hashlib
import importlib.metadata
import json
import sys
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from autoexpose_daemon.control import _native
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY, OWN, PLACES
from evaluation.jobs.job import Job
from evaluation.jobs.native import NATIVE, ROOT, c_files, tree
from evaluation.long_runs import KeptResults
from imaging.errors import AutoexposeError

_OURS = (
    "autoexpose_daemon", "autoexpose_lab", "calibration", "camera_twin", "documents", "drivers", "evaluation",
    "fake_camera", "imaging", "navigation",
)  # fmt: skip
_LIBRARIES = ("numpy", "opencv-python-headless", "numba", "evo")


class ResultCache(KeptResults[Job]):
    """One file for each job, named by a hash of its function, its arguments and all of our code that it can reach. So a
    stopped run resumes where it was, and after a change of code only what that code affects is measured again."""

    def key(self, asked: Job) -> str:
        """Equal for jobs that have the same result."""
        policies = tuple(PLACES) if asked.policies is None else asked.policies
        digest = _digest(asked.measure.__module__, policies)
        arguments = dict(asked.arguments) | {name: content(Path(str(asked.arguments[name]))) for name in asked.files}
        parts = [asked.measure.__module__, asked.measure.__qualname__, arguments, digest]
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def content(path: Path) -> str:
    """A hash of what is in a file, or in all files of a folder. Raises AutoexposeError when one cannot be read."""
    files = sorted(each for each in path.rglob("*") if each.is_file()) if path.is_dir() else [path]
    try:
        found = [(each.name, _content_of(each, (now := each.stat()).st_size, now.st_mtime_ns)) for each in files]
    except OSError as error:
        raise AutoexposeError(f"{error.filename} cannot be read: {error.strerror}") from None
    return found[0][1] if not path.is_dir() else hashlib.sha256(repr(found).encode()).hexdigest()


# Of a larger file, a drive, this many pieces are read: any two recordings differ in each of them.
_LARGE_BYTES, _PIECES, _PIECE_BYTES = 1 << 26, 64, 1 << 16


@cache
def _content_of(file: Path, size: int, _changed_ns: int) -> str:
    state = hashlib.sha256(str(size).encode())
    with file.open("rb") as opened:
        if size <= _LARGE_BYTES:
            state.update(opened.read())
        else:
            for piece in range(_PIECES):
                opened.seek(piece * (size - _PIECE_BYTES) // (_PIECES - 1))
                state.update(opened.read(_PIECE_BYTES))
    return state.hexdigest()


# Loads policies by their names, so no import statement leads to them.
_TABLE = "autoexpose_daemon.control.policies.table"
_IDS = "autoexpose_daemon.control.policies.ids"  # Lists them: another policy in it changes no result of the others


@cache
def _digest(module: str, policies: tuple[str, ...] = tuple(PLACES)) -> str:
    """Of the sources that a module reaches, and of the versions of the libraries that produce numbers. It reaches what
    it imports, the C that this calls and, where it reaches the table of policies, those with these ids."""
    places = {policy: _place(policy.partition(":")[0]) for policy in policies}
    reached: dict[str, Path] = {}
    ahead = [module]
    while ahead:
        name = ahead.pop()
        if name in reached or name.split(".")[0] not in _packages() or (path := _source(name)) is None:
            continue
        reached[name] = path
        ahead += [".".join(name.split(".")[:depth]) for depth in range(1, name.count(".") + 1)]
        ahead += _imports(path)
        if name == _TABLE:
            ahead += [place.rpartition(".")[0] for place in places.values()]
    state = hashlib.sha256()
    for name in sorted(reached):
        if name != _IDS:
            state.update(name.encode() + b"\0" + reached[name].read_bytes() + b"\0")
        for weights in sorted(reached[name].parent.glob("*.npz")):  # of learned policies
            state.update(weights.read_bytes())
    for path in _c_files(list(reached.values())):
        state.update(path.read_bytes())
    state.update(repr([DEFAULT_POLICY, *places.items()]).encode())
    for library in _LIBRARIES:
        state.update(f"{library} {_version(library)}".encode())
    return state.hexdigest()


def _place(policy: str) -> str:
    """Where the class of a policy is."""
    if policy in OWN:
        return f"{OWN[policy].__module__}.{OWN[policy].__name__}"
    return f"{_TABLE.rpartition('.')[0]}.{PLACES[policy]}"


def _packages() -> tuple[str, ...]:
    """Those whose code counts: ours, and those of policies that are not ours."""
    return (*_OURS, *sorted({kind.__module__.partition(".")[0] for kind in OWN.values()}))


def _c_files(python: list[Path]) -> list[Path]:
    """The sources that these reach; where it came as a wheel, without them, the whole C extension."""
    return c_files(python) if (ROOT / NATIVE).is_dir() else [Path(_native.__file__)]


@cache
def code_version() -> str:
    """Of all our code and of what numbers depend on: processes with the same one get the same results."""
    state = hashlib.sha256(repr(sys.version_info[:2]).encode())
    for name in _packages():
        root = _source(name)
        if root is None:
            continue
        for path in sorted(root.parent.rglob("*")) if root.name == "__init__.py" else [root]:
            if path.suffix in (".py", ".c", ".h", ".npz"):
                state.update(str(path.relative_to(root.parent)).encode() + b"\0" + path.read_bytes() + b"\0")
    state.update(libraries().encode())
    return state.hexdigest()


def libraries() -> str:
    """Those that numbers depend on, with their versions."""
    return ", ".join(f"{library} {_version(library)}" for library in _LIBRARIES)


def _version(library: str) -> str:
    """Of an installed library; an absent one does not stop jobs that do not need it."""
    try:
        return importlib.metadata.version(library)
    except importlib.metadata.PackageNotFoundError:
        return "absent"


def _source(module: str) -> Path | None:
    """The file of a module; None for a name that is not a module."""
    try:
        spec = find_spec(module)
    except ModuleNotFoundError:
        return None
    return Path(spec.origin) if spec and spec.origin and spec.origin.endswith(".py") else None


@cache
def _imports(path: Path) -> tuple[str, ...]:
    names: list[str] = []
    for node in ast.walk(tree(path)):
        match node:
            case ast.Import(names=aliases):
                names += [alias.name for alias in aliases]
            case ast.ImportFrom(module=str(module), names=aliases):
                names += [module, *(f"{module}.{alias.name}" for alias in aliases)]
    return tuple(names)
