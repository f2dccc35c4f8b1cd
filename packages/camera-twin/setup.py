"""The part of the build that pyproject.toml cannot say: the library that lets programs see a camera on a USB bus."""

from pathlib import Path

from setuptools import Extension, setup

SHIM = "camera_twin/usb3/shim"

setup(
    ext_modules=[
        # Not a Python module: it is preloaded into programs that use libusb.
        Extension(
            "camera_twin.usb3._shim",
            sources=sorted(str(path) for path in Path(SHIM).glob("*.c")),
            depends=sorted(str(path) for path in Path(SHIM).glob("*.h")),
            extra_compile_args=["-std=gnu11", "-fvisibility=hidden", "-Wall", "-Wextra"],
            py_limited_api=True,
            optional=True,
        ),
    ],
    options={"bdist_wheel": {"py_limited_api": "cp310"}},
)
