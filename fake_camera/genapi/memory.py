"""A camera's memory: bytes at addresses, zero where nothing was written."""

from __future__ import annotations

from collections.abc import Callable, Iterable

_PAGE_BYTES = 4096
Fixed = Callable[[int, int], bytes | None]


class Memory:
    """Sparse bytes. `fixed` may answer for registers that are kept elsewhere, and returns None for all others."""

    def __init__(self, fixed: Fixed = lambda address, count: None) -> None:
        self.fixed = fixed
        self._pages: dict[int, bytearray] = {}

    def read(self, address: int, count: int) -> bytes:
        """`count` bytes from `address` on."""
        elsewhere = self.fixed(address, count)
        if elsewhere is not None:
            return elsewhere
        data = b""
        for page, start, stop in _spans(address, count):
            data += self._pages[page][start:stop] if page in self._pages else bytes(stop - start)
        return data

    def write(self, address: int, data: bytes) -> None:
        """Store `data` from `address` on."""
        for page, start, stop in _spans(address, len(data)):
            self._pages.setdefault(page, bytearray(_PAGE_BYTES))[start:stop] = data[: stop - start]
            data = data[stop - start :]


def _spans(address: int, count: int) -> Iterable[tuple[int, int, int]]:
    """The pages that a range touches, each with the start and the end of its bytes there."""
    while count > 0:
        page, start = divmod(address, _PAGE_BYTES)
        stop = min(start + count, _PAGE_BYTES)
        yield page, start, stop
        address += stop - start
        count -= stop - start
