"""The part of the build that pyproject.toml cannot say: an optional C extension.

Without a C compiler or Python's headers the build goes on without it, and numpy and OpenCV do its work.
"""

from __future__ import annotations

from setuptools import Extension, setup

NATIVE = "autoexpose_daemon/control/native"

setup(
    ext_modules=[
        Extension(
            "autoexpose_daemon.control._native",
            sources=[f"{NATIVE}/module.c", f"{NATIVE}/gradient.c"],
            depends=[f"{NATIVE}/gradient.h", f"{NATIVE}/gradient_kernel.h"],
            # Square roots that set no errno and convert without traps can be vectorised.
            extra_compile_args=["-O3", "-std=c11", "-fno-math-errno", "-fno-trapping-math"],
            libraries=["m"],
            optional=True,
        )
    ]
)
