"""Headless Chromium, driven through its DevTools protocol."""

from __future__ import annotations

import base64
import contextlib
import itertools
import json
import subprocess
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect

PATIENCE_S = 20.0
START_S = 30.0

SHRUNK = """((selector, width, height) => {
  const pen = new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true });
  pen.imageSmoothingQuality = "high";
  pen.drawImage(document.querySelector(selector), 0, 0, width, height);
  return [...pen.getImageData(0, 0, width, height).data].filter((_, index) => index % 4 === 0);
})"""
"""A function of JavaScript: red of a canvas shrunk to some width and height, row by row."""


LOOKED = """(async () => {
  for (const until = Date.now() + 500; Date.now() < until; await new Promise((next) => setTimeout(next, 20))) {
    if (%s) return true;
  }
  return false;
})()"""
"""Whether an expression comes true within half a second. The page itself watches: questions would keep it busy."""

NAVIGATED = ("navigated", "context was destroyed", "Promise was collected")


class NavigatedError(Exception):
    """The page went elsewhere before it answered."""


class Tab:
    """One page in the browser; `complaints` are what its console and its network had to say."""

    def __init__(self, socket: ClientConnection) -> None:
        self.complaints: list[str] = []
        self._socket = socket
        self._numbers = itertools.count(1)
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.command(f"{domain}.enable")

    def command(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Run a command of the protocol to its end, and return its result."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(PATIENCE_S))
            if message.get("id") == number:
                if any(words in str(message.get("error")) for words in NAVIGATED):
                    raise NavigatedError(method)
                assert "error" not in message, message
                result: dict[str, Any] = message["result"]
                return result
            self._note(message)

    def _note(self, event: dict[str, Any]) -> None:
        match event["method"], event["params"]:
            case "Runtime.exceptionThrown", {"exceptionDetails": details}:
                self.complaints.append(str(details.get("exception", details).get("description", details)))
            case "Runtime.consoleAPICalled", {"type": "error" | "warning", "args": args}:
                self.complaints.append(str(args))
            case "Log.entryAdded", {"entry": {"level": "error" | "warning", "text": text} as entry}:
                self.complaints.append(f"{text} {entry.get('url', '')}")

    def open(self, url: str) -> None:
        """Go there; what the page before complained of is forgotten."""
        self.command("Page.navigate", url="about:blank")
        self.complaints.clear()
        self.command("Page.navigate", url=url)
        self.wait_for("document.readyState === 'complete' && location.href !== 'about:blank'", f"{url} to load")

    def value(self, expression: str) -> Any:
        """What a JavaScript expression is on the page."""
        answer = self.command("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def text(self, selector: str) -> str:
        return str(self.value(f"document.querySelector({json.dumps(selector)}).innerText"))

    def wait_for(self, expression: str, what: str, patience_s: float = PATIENCE_S) -> None:
        deadline_s = time.monotonic() + patience_s
        while not self._is_true(expression):
            assert time.monotonic() < deadline_s, f"waited in vain for {what}: {self.value('document.body.innerText')}"

    def _is_true(self, expression: str) -> bool:
        try:
            return bool(self.value(LOOKED % expression))
        except NavigatedError:
            return False

    def screen(self, width: int, height: int, dark: bool = False, scale: float = 1.0) -> None:
        """The size of the window, CSS pixels, and the scheme of colours that is wished for."""
        self.command(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=scale,
            mobile=width < 600,
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.command("Emulation.setEmulatedMedia", features=[scheme])

    def screenshot(self, file: Path, whole: bool = True) -> None:
        picture = self.command("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        file.write_bytes(base64.b64decode(picture["data"]))


@contextlib.contextmanager
def browser() -> Iterator[Tab]:
    """A browser with an empty tab."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = ["chromium", "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"]
        command += ["--hide-scrollbars", "--no-first-run", "--disable-extensions", "--disable-background-networking"]
        command += [f"--user-data-dir={profile}", "--remote-debugging-port=0", "about:blank"]
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
            try:
                with connect(_first_tab(process), max_size=None) as socket:
                    yield Tab(socket)
            finally:
                process.kill()


def _first_tab(process: subprocess.Popen[str]) -> str:
    """The DevTools address of the tab the browser starts with."""
    assert process.stderr is not None
    heard = []
    for line in process.stderr:
        heard.append(line)
        if line.startswith("DevTools listening on ws://"):
            place = line.removeprefix("DevTools listening on ws://").partition("/")[0]
            break
    else:
        raise AssertionError(f"chromium did not start: {''.join(heard)}")
    deadline_s = time.monotonic() + START_S
    while time.monotonic() < deadline_s:
        with urllib.request.urlopen(f"http://{place}/json", timeout=START_S) as answer:
            for target in json.load(answer):
                if target["type"] == "page":
                    return str(target["webSocketDebuggerUrl"])
    raise AssertionError("chromium opened no tab")
