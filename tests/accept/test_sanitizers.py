"""The tests of the C parts again, on a build that reports misused memory and undefined behaviour."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from fake_camera.usb3.run import CAMERAS_VARIABLE
from tests import REPOSITORY
from tests.accept.commands import output
from tools.stage_package import ROOMS

pytestmark = pytest.mark.timeout(590)

FLAGS = "-fsanitize=address,undefined -fno-sanitize-recover=undefined -fno-omit-frame-pointer -g"
NATIVE_TESTS = ["tests/autoexpose_daemon/control/test_native.py"]
SHIM_SUITES = [f"tests/fake_camera/usb3/{name}.py" for name in ("hostile_suite", "shim_suite")]
PARTS = [*ROOMS, "tests", "pyproject.toml", "setup.py"]


def sanitizers() -> list[str]:
    """The compiler's libraries, which must be loaded before any other; skips where it has none."""
    if shutil.which("gcc") is None:
        pytest.skip("gcc is not installed")
    paths = [output("gcc", f"-print-file-name={name}.so").strip() for name in ("libasan", "libubsan")]
    missing = [path for path in paths if not Path(path).is_file()]  # gcc then prints the name alone
    if missing:
        pytest.skip(f"the compiler has no {' and no '.join(missing)}: on Debian they are part of libgcc-*-dev")
    return paths


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the project whose C parts were compiled with sanitizers."""
    sanitizers()
    place = tmp_path_factory.mktemp("sanitized")
    for part in PARTS:
        if (REPOSITORY / part).is_dir():
            shutil.copytree(REPOSITORY / part, place / part, ignore=shutil.ignore_patterns("*.so", "__pycache__"))
        else:
            shutil.copy(REPOSITORY / part, place)
    (place / "tests/accept").rename(place / "left_out")
    said = output(
        sys.executable,
        "setup.py",
        "build_ext",
        "--inplace",
        folder=place,
        environment={"CFLAGS": FLAGS, "LDFLAGS": FLAGS},
    )
    built = list(place.glob("autoexpose_daemon/control/_native.*")) + list(place.glob("fake_camera/usb3/_shim.*"))
    assert sum(path.suffix == ".so" for path in built) == 2, said
    return place


def run(build: Path, tests: Sequence[str], preloaded: Sequence[str] = (), cameras: str = "") -> None:
    """Run tests of the copy; all must pass."""
    environment = {
        "PYTHONPATH": str(build),
        "PYTHONMALLOC": "malloc",  # else Python's small objects share blocks, in which nothing is seen
        "LD_PRELOAD": ":".join([*sanitizers(), *preloaded]),
        "ASAN_OPTIONS": "detect_leaks=0",  # of Python there are many
        "UBSAN_OPTIONS": "print_stacktrace=1",
        CAMERAS_VARIABLE: cameras,
    }
    said = output(
        sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *tests, folder=build, environment=environment
    )
    assert " passed" in said


def test_native_parts_mind_their_memory(build: Path) -> None:
    run(build, NATIVE_TESTS)


def test_the_shim_minds_its_memory(build: Path, tmp_path: Path) -> None:
    shim = next(build.glob("fake_camera/usb3/_shim.*.so"))
    run(build, SHIM_SUITES, [str(shim)], f"{tmp_path / 'left'}:{tmp_path / 'right'}")
