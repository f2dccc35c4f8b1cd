"""Through a zenoh router in a process of its own: plain, with access control, with TLS both ways."""

from __future__ import annotations

import json
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest

from autoexpose_daemon.client import StereoClient
from autoexpose_daemon.config.document import PublishConfig
from autoexpose_daemon.publish.session import Endpoints, SessionError, open_session
from tests.autoexpose_daemon.publish.consumer import consumer
from tests.autoexpose_daemon.publish.router import router
from tests.autoexpose_daemon.publish.steps import PATIENCE_S, endpoint, publishing, wait_until

pytestmark = pytest.mark.wire

QUIET = {"multicast": {"enabled": False}}


def router_file(folder: Path, at: str, **more: Any) -> Path:
    file = folder / "router.json5"
    file.write_text(json.dumps({"mode": "router", "listen": {"endpoints": [at]}, "scouting": QUIET, **more}))
    return file


def test_a_process_takes_part_through_a_router(tmp_path: Path) -> None:
    at = endpoint()
    with (
        router(router_file(tmp_path, at)),
        publishing(PublishConfig(listen=(), connect=(at,))) as publisher,
        consumer("far", at) as far,
    ):
        far.wait_for_first()
        wait_until(lambda: "far" in publisher.tally.consumers.listed(time.monotonic_ns()), "its report")
        assert far.result()["tally"]["pairs"] > 0


def test_a_router_lets_nobody_have_what_it_does_not_allow(tmp_path: Path) -> None:
    at = endpoint()
    rule = {
        "id": "one",
        "permission": "allow",
        "flows": ["ingress", "egress"],
        "messages": ["put", "declare_subscriber"],
        "key_exprs": ["autoexpose/allowed/**"],
    }
    control = {
        "enabled": True,
        "default_permission": "deny",
        "rules": [rule],
        "subjects": [{"id": "all"}],
        "policies": [{"rules": ["one"], "subjects": ["all"]}],
    }
    with (
        router(router_file(tmp_path, at, access_control=control)),
        publishing(PublishConfig(rig="allowed", listen=(), connect=(at,))),
        publishing(PublishConfig(rig="secret", listen=(), connect=(at,))),
        StereoClient("allowed", [at]) as allowed,
        StereoClient("secret", [at]) as secret,
    ):
        assert allowed.next_pair(PATIENCE_S) is not None
        assert secret.next_pair(1.0) is None


def certify(folder: Path, address: str) -> None:
    """Keys and certificates of an authority, of a router at an address, and of a robot."""

    def openssl(*arguments: str) -> None:
        subprocess.run(["openssl", *arguments], cwd=folder, check=True, capture_output=True)

    new_key = ["-newkey", "rsa:2048", "-nodes"]
    openssl("req", "-x509", *new_key, "-keyout", "ca.key", "-out", "ca.pem", "-days", "2", "-subj", "/CN=authority")
    for name, alternative in (("router", f"IP:{address}"), ("robot", "DNS:robot")):
        openssl("req", *new_key, "-keyout", f"{name}.key", "-out", f"{name}.csr", "-subj", f"/CN={name}")
        (folder / f"{name}.ext").write_text(f"subjectAltName={alternative}\n")
        openssl(
            *("x509", "-req", "-in", f"{name}.csr", "-CA", "ca.pem", "-CAkey", "ca.key", "-CAcreateserial"),
            *("-days", "2", "-extfile", f"{name}.ext", "-out", f"{name}.pem"),
        )


@pytest.mark.needs("openssl")
def test_tls_both_ways(tmp_path: Path) -> None:
    at = endpoint().replace("tcp/", "tls/")
    certify(tmp_path, at.removeprefix("tls/").split(":")[0])
    authority = {"root_ca_certificate": str(tmp_path / "ca.pem"), "enable_mtls": True}

    def tls(end: str, name: str) -> dict[str, Any]:
        pair = {
            f"{end}_private_key": str(tmp_path / f"{name}.key"),
            f"{end}_certificate": str(tmp_path / f"{name}.pem"),
        }
        return {"link": {"tls": authority | pair}}

    robot, stranger = tmp_path / "robot.json5", tmp_path / "stranger.json5"
    ends = {"connect": {"endpoints": [at]}, "listen": {"endpoints": []}}
    robot.write_text(json.dumps(ends | {"transport": tls("connect", "robot")}))
    anonymous = {"link": {"tls": {"root_ca_certificate": str(tmp_path / "ca.pem")}}}
    stranger.write_text(json.dumps(ends | {"transport": anonymous}))
    with (
        router(router_file(tmp_path, at, transport=tls("listen", "router"))),
        publishing(PublishConfig(rig="rig", zenoh=robot)),
        consumer("far", file=robot) as far,
    ):
        far.wait_for_first()
        assert far.result()["tally"]["pairs"] > 0
        with pytest.raises(SessionError):
            open_session("client", Endpoints(file=stranger))
