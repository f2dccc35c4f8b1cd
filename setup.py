"""The part of the build that pyproject.toml cannot say: two optional libraries in C.

Without a C compiler or Python's headers the build goes on without them: numpy and OpenCV do the work of the one, and
the fake USB3 Vision camera says that it lacks the other.
"""

from __future__ import annotations

from setuptools import Extension, setup

NATIVE = "autoexpose_daemon/control/native"
SHIM = "fake_camera/usb3/shim"

setup(
    ext_modules=[
        Extension(
            "autoexpose_daemon.control._native",
            sources=[f"{NATIVE}/{part}.c" for part in ("module", "gradient", "contrast")],
            depends=[f"{NATIVE}/{part}.h" for part in ("gradient", "gradient_kernel", "contrast")],
            # Square roots that set no errno and convert without traps can be vectorised.
            extra_compile_args=["-O3", "-std=c11", "-fno-math-errno", "-fno-trapping-math"],
            libraries=["m"],
            optional=True,
        ),
        # Not a Python module: it is preloaded into programs that use libusb.
        Extension(
            "fake_camera.usb3._shim",
            sources=[f"{SHIM}/{part}.c" for part in ("bus", "handle", "host", "interpose", "link", "udev", "usbip")],
            depends=[f"{SHIM}/shim.h"],
            extra_compile_args=["-std=gnu11", "-fvisibility=hidden", "-Wall", "-Wextra"],
            optional=True,
        ),
    ]
)
