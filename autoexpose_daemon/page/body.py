"""Reading what a browser sends in a request."""

from __future__ import annotations

from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request


async def read_body(request: Request, longest: int) -> bytes:
    """The body of a request.

    Raises
    ------
    HTTPException
        If it has more than `longest` bytes, or the client hung up before its end.
    """
    body = b""
    try:
        async for chunk in request.stream():
            body += chunk
            if len(body) > longest:
                raise HTTPException(413, "too long\n")
    except ClientDisconnect:
        raise HTTPException(400, "incomplete\n") from None
    return body
