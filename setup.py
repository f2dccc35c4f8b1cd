"""The part of the build that pyproject.toml cannot say: two libraries in C.

From Python 3.11 on, what is built serves all later ones, too (abi3).

Control needs the first, so there is no build without a C compiler and Python's headers. Only the fake USB3
Vision camera needs the second, and says so.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from setuptools import Extension, setup

NATIVE = "autoexpose_daemon/control/native"
SHIM = "fake_camera/usb3/shim"

# Buffers are in the stable interface since Python 3.11.
STABLE = sys.version_info >= (3, 11)
OPTIONS: dict[str, Any] = {"bdist_wheel": {"py_limited_api": "cp311"}} if STABLE else {}

setup(
    ext_modules=[
        Extension(
            "autoexpose_daemon.control._native",
            sources=sorted(str(path) for path in Path(NATIVE).rglob("*.c")),
            depends=sorted(str(path) for path in Path(NATIVE).rglob("*.h")),
            include_dirs=[NATIVE],
            # Square roots that set no errno and convert without traps can be vectorised.
            extra_compile_args=["-O3", "-std=c11", "-fno-math-errno", "-fno-trapping-math"],
            libraries=["m"],
            define_macros=[("Py_LIMITED_API", "0x030B0000")] if STABLE else [],
            py_limited_api=STABLE,
        ),
        # Not a Python module: it is preloaded into programs that use libusb.
        Extension(
            "fake_camera.usb3._shim",
            sources=sorted(str(path) for path in Path(SHIM).glob("*.c")),
            depends=sorted(str(path) for path in Path(SHIM).glob("*.h")),
            extra_compile_args=["-std=gnu11", "-fvisibility=hidden", "-Wall", "-Wextra"],
            py_limited_api=STABLE,
            optional=True,
        ),
    ],
    options=OPTIONS,
)
