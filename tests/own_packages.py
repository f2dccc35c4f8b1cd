"""Packages with policies of their own, installed for a test in folders of their own."""

from __future__ import annotations

import contextlib
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

from autoexpose_daemon.control.policies.ids import OWN, UNFIT
from autoexpose_daemon.own_policy.installed import GROUP, register_policies
from tests import REPOSITORY

EXAMPLE = REPOSITORY / "examples" / "own_policy"


def installed(folder: Path, package: str, module: str, source: str, points: Mapping[str, str]) -> Path:
    """A folder as pip leaves it, with one module, and entry points for these policies."""
    information = folder / f"{package}-1.0.dist-info"
    information.mkdir(parents=True)
    (information / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    lines = [f"[{GROUP}]", *(f"{name} = {value}" for name, value in points.items())]
    (information / "entry_points.txt").write_text("\n".join(lines) + "\n")
    (folder / f"{module}.py").write_text(source)
    return folder


@contextlib.contextmanager
def with_packages(*folders: Path) -> Iterator[tuple[str, ...]]:
    """These packages are there; yields what is said of those that cannot be used."""
    before = set(sys.modules)
    with pytest.MonkeyPatch.context() as patch:
        for folder in folders:
            patch.syspath_prepend(folder)
        register_policies.cache_clear()
        try:
            yield register_policies()
        finally:
            register_policies.cache_clear()
            OWN.clear()
            UNFIT.clear()
            for name in set(sys.modules) - before:
                path = getattr(sys.modules[name], "__file__", None)
                if path is not None and Path(path).parent in folders:
                    del sys.modules[name]


def example_installed(folder: Path) -> Path:
    """The package of the examples, by pip."""
    source, site = folder / "source", folder / "site"
    shutil.copytree(EXAMPLE, source)  # setuptools leaves its traces where the sources are
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--no-build-isolation"]
    subprocess.run([*pip, "--target", str(site), str(source)], check=True)
    return site
