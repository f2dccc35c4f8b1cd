"""Debian's Prometheus and our files for it: each alert on made-up series, then two rigs that are really scraped."""

from __future__ import annotations

import contextlib
import http.client
import json
import subprocess
import threading
import time
import urllib.parse
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests import REPOSITORY
from tests.autoexpose_daemon.page.server import PageProcess, running_page
from tests.autoexpose_daemon.publish.steps import endpoint
from tests.autoexpose_daemon.scripted import ScriptedRig, scripted_daemon
from tests.fakes import loopback_address

ALERTS = REPOSITORY / "examples" / "alerts.yaml"
BOARD = REPOSITORY / "examples" / "grafana.json"
CASES = Path(__file__).with_name("alerts.test.yaml")

TOKEN = "page.token"

PATIENCE_S = 120.0
"""An alert takes 30 s to fire."""

WITHOUT_ANSWER = ("ALERTS", "recorder", "consumer", "> 0")
"""What a panel is empty of, as long as nothing is wrong and nothing records or consumes."""

pytestmark = pytest.mark.needs("prometheus", "promtool")


def promtool(*arguments: str | Path) -> None:
    done = subprocess.run(["promtool", *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_file_of_alerts_is_valid() -> None:
    promtool("check", "rules", ALERTS)


def test_each_alert_fires_in_its_case_and_in_no_other() -> None:
    promtool("test", "rules", CASES)


@dataclass
class Prometheus:
    """A server that answers at `place`, an address and a port."""

    place: str

    def ask(self, path: str, **arguments: str) -> Any:
        """The data of an answer of its HTTP interface."""
        with contextlib.closing(http.client.HTTPConnection(self.place, timeout=PATIENCE_S)) as connection:
            connection.request("GET", f"/api/v1/{path}?{urllib.parse.urlencode(arguments)}")
            answer = json.loads(connection.getresponse().read())
        assert answer["status"] == "success", answer
        return answer["data"]

    def values(self, expression: str) -> dict[str, float]:
        """What an expression yields, by rig."""
        results = self.ask("query", query=expression)["result"]
        return {result["metric"].get("rig", ""): float(result["value"][1]) for result in results}

    @property
    def firing(self) -> set[tuple[str, str]]:
        """Which alerts fire for which rigs."""
        alerts = self.ask("alerts")["alerts"]
        return {(it["labels"]["alertname"], it["labels"].get("rig", "")) for it in alerts if it["state"] == "firing"}

    @property
    def is_ready(self) -> bool:
        with contextlib.closing(http.client.HTTPConnection(self.place, timeout=PATIENCE_S)) as connection:
            try:
                connection.request("GET", "/-/ready")
            except ConnectionRefusedError:
                return False
            return connection.getresponse().status == http.client.OK


@contextlib.contextmanager
def prometheus(folder: Path, *pages: PageProcess) -> Iterator[Prometheus]:
    """A server with our alerts that scrapes these pages each second, with the token in `folder`."""
    targets = [f"{page.host}:{page.port}" for page in pages]
    settings = {
        "global": {"scrape_interval": "1s", "evaluation_interval": "1s"},
        "rule_files": [str(ALERTS)],
        "scrape_configs": [
            {
                "job_name": "autoexpose",
                "authorization": {"credentials_file": TOKEN},
                "static_configs": [{"targets": targets}],
            }
        ],
    }
    file, log = folder / "prometheus.yml", folder / "log"
    file.write_text(yaml.safe_dump(settings))
    server = Prometheus(f"{loopback_address()}:9090")
    command = ["prometheus", f"--config.file={file}", f"--storage.tsdb.path={folder / 'data'}"]
    command += [f"--web.listen-address={server.place}", "--log.level=warn"]
    with log.open("wb") as output, subprocess.Popen(command, stdout=output, stderr=output) as process:
        try:
            wait_for(lambda: server.is_ready or process.poll() is not None, "Prometheus")
            assert process.poll() is None, log.read_text()
            yield server
        finally:
            process.terminate()


def wait_for(condition: Callable[[], object], what: str) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline_s, f"waited in vain for {what}"
        threading.Event().wait(0.2)


@contextlib.contextmanager
def rig_with_page(name: str, token: Path) -> Iterator[tuple[ScriptedRig, PageProcess]]:
    at = endpoint()
    with (
        scripted_daemon(control={"policy": "neves2009"}, publish={"listen": [at], "rig": name}) as (_, rig, _),
        running_page("--rig", name, "--connect", at, "--token-file", str(token)) as page,
    ):
        yield rig, page


@pytest.mark.timeout(400)
def test_two_rigs_are_scraped_and_the_one_that_degrades_is_told(tmp_path: Path) -> None:
    token = tmp_path / TOKEN
    token.write_text("0123456789abcdef" * 4 + "\n")
    token.chmod(0o600)
    with (
        rig_with_page("scout", token) as (_, first),
        rig_with_page("mule", token) as (mule, second),
        prometheus(tmp_path, first, second) as server,
    ):
        exposing = 'autoexpose_state{state="exposing"}'
        wait_for(lambda: server.values("autoexpose_up") == {"scout": 1.0, "mule": 1.0}, "both rigs")
        wait_for(lambda: server.values(exposing) == {"scout": 1.0, "mule": 1.0}, "both to expose")
        wait_for(lambda: set(server.values("rate(autoexpose_pairs_total[30s]) > 0")) == {"scout", "mule"}, "pairs")
        assert server.values("count(up == 1)") == {"": 2.0}
        check_board(server)
        assert server.firing == set()

        mule.pauses = True
        wait_for(lambda: server.values(f"{exposing} == 0") == {"mule": 0.0}, "the state")
        wait_for(lambda: server.firing, "an alert")
        assert server.firing == {("AutoexposeDegraded", "mule")}

        mule.pauses = False
        wait_for(lambda: server.firing == set(), "the alert to end")


def check_board(server: Prometheus) -> None:
    """Prometheus understands each expression of the dashboard, and both rigs are on every panel that has anything."""
    for panel in json.loads(BOARD.read_text())["panels"]:
        for target in panel.get("targets", ()):
            expression = target["expr"].replace("$rig", ".*").replace("$__rate_interval", "30s")
            found = server.values(expression)
            if not any(part in expression for part in WITHOUT_ANSWER):
                assert set(found) in ({"scout", "mule"}, {""}), expression
