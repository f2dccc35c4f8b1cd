"""Functions compiled by numba; their machine code is kept for the next start where files can be written."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit


def compiled(**options: Any) -> Any:
    """As `numba.njit`, without the GIL.

    Numba refuses to cache where neither the package's folder nor the user's cache is writable, as in a read-only
    container. Then every start compiles.
    """

    def compile_it(function: Callable[..., Any]) -> Any:
        try:
            return njit(cache=True, nogil=True, **options)(function)
        except RuntimeError:
            return njit(nogil=True, **options)(function)

    return compile_it
