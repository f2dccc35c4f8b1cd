"""Policies that other packages bring: chosen by name, recorded, replayed, in other processes; and what is refused."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from autoexpose_daemon.config.load import load_config
from autoexpose_daemon.config.request import new_request, read_request
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.policies.ids import check_policy_id, policy_ids
from autoexpose_daemon.recording.file import Setup
from autoexpose_daemon.recording.read import Recording
from autoexpose_daemon.runtime.setup import Tuning
from evaluation.arena.runs import Task, jobs_of
from evaluation.jobs import kept
from evaluation.pool import over_processes
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.response import ResponseFunction
from tests.autoexpose_daemon.recording.runs import VirtualRun, record
from tests.autoexpose_daemon.service.service_process import Within
from tests.own_packages import example_installed, installed, with_packages

RIG = "cameras: {left: {serial: A}, right: {serial: B}}\ncontrol: {policy: %s}\n"
POLICY = "highlights"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return example_installed(tmp_path_factory.mktemp("example"))


@pytest.fixture
def example(site: Path) -> Iterator[None]:
    with with_packages(site) as said:
        assert said == ()
        yield


@pytest.mark.usefixtures("example")
def test_it_is_chosen_in_the_configuration_and_by_requests(tmp_path: Path) -> None:
    file = tmp_path / "rig.yaml"
    file.write_text(RIG % POLICY)
    tuning = Tuning(load_config(file))
    assert tuning.loop(ExposureLimits(20, 7500, 0, 30)).setup.policy_id == POLICY
    asked = read_request(new_request({"by": "ana", "policy": POLICY}).to_json().encode())
    other = tuning.changed(read_request(b'{"by": "ana", "policy": "neves2009"}'))
    assert other.changed(asked).config.control.policy == POLICY


def test_a_client_asks_for_what_only_the_daemon_knows() -> None:
    request = new_request({"by": "ana", "policy": POLICY})
    with pytest.raises(ConfigurationError, match=f"policy: there is no policy '{POLICY}'; install the package"):
        read_request(request.to_json().encode())


def test_a_recording_names_it_and_replays_bit_for_bit_where_it_is_installed(
    site: Path, tmp_path: Path, within: Within
) -> None:
    file = tmp_path / "run.mcap"
    with with_packages(site):
        run = VirtualRun(POLICY)
        record(file, run, 40)
        setup = next(iter(Recording(file)))
        assert isinstance(setup, Setup) and setup.control.policy_id == POLICY
        assert len({decision.reason for decision in run.decisions.values()}) > 5
        code, out, _ = within("replay", str(file))
        assert (code, "replayed: 39, of which 39 are bit for bit" in out) == (0, True)
    assert f"'{POLICY}'; install the package" in within.refused("replay", str(file))


@pytest.mark.usefixtures("example")
def test_another_process_has_it_as_well() -> None:
    assert dict(over_processes(name_of_loop, [POLICY, "fixed"], 2)) == {POLICY: "Highlights", "fixed": "Fixed"}


def name_of_loop(policy_id: str) -> str:
    loop = ControlLoop(policy_id, ResponseFunction.linear(), ExposureLimits(20, 7500, 0, 30), ExposureSetting(1000, 0))
    return type(loop._policy).__name__


@pytest.mark.usefixtures("example")
def test_the_arena_takes_it_by_name(tmp_path: Path, within: Within) -> None:
    options = ("--quick", "--scenarios", "step_up", "--jobs", "1", "--kept", str(tmp_path))
    code, out, told = within("arena", "--policies", POLICY, *options)
    assert (code, POLICY in out) == (0, True), told
    assert "--count" in within.refused("arena", "--count", "--policy", POLICY)


def test_results_are_measured_again_when_its_code_changes(tmp_path: Path) -> None:
    source = "from autoexpose_daemon.control.policies.published.mean import Neves2009\nclass Mine(Neves2009): ...\n"
    (first, version), again, (other, other_version) = (
        key_and_version(installed(tmp_path / f"site{number}", "mine", "mine", text, {"mine": "mine:Mine"}))
        for number, text in enumerate((source, source, source + "# other\n"))
    )
    assert again == (first, version)
    assert first != other and version != other_version


def key_and_version(folder: Path) -> tuple[str, str]:
    """What a result of the policy `mine` is kept under, and what workers of a cluster must have."""
    kept._digest.cache_clear()
    kept.code_version.cache_clear()
    try:
        with with_packages(folder):
            (job,) = jobs_of(Task("step_up", "room", 0, (2,), "tune"), ["mine"])
            return kept.ResultCache(folder / "kept").key(job), kept.code_version()
    finally:
        kept._digest.cache_clear()
        kept.code_version.cache_clear()


HEAD = """
from autoexpose_daemon.own_policy import ExposurePolicy, Target
class Mine(ExposurePolicy):
    def __init__(self, setup):
        self.balance = setup.balance()
"""
UNFIT = {
    "no module": ("", "other:Mine", ["ModuleNotFoundError", "other"]),
    "no class": (HEAD, "mine:Yours", ["AttributeError", "Yours"]),
    "another base": ("class Mine: ...\n", "mine:Mine", ["mine:Mine", "autoexpose_daemon.own_policy.ExposurePolicy"]),
    "nothing decides": (HEAD, "mine:Mine", ["mine:Mine", "lacks decide"]),
    "no balance": (
        HEAD.replace("self.balance = setup.balance()", "pass")
        + "    def decide(self, observation):\n        return Target(12.0, 'still')\n",
        "mine:Mine",
        ["AttributeError", "balance"],
    ),
    "no target": (
        HEAD + "    def decide(self, observation):\n        return 12.0\n",
        "mine:Mine",
        ["on a picture", "float"],
    ),
    "black": (
        "import math\n" + HEAD + "    def decide(self, observation):\n"
        "        return Target(-math.log2(observation.mean), 'bright')\n",
        "mine:Mine",
        ["on a black picture"],
    ),
    "forgetful": (
        HEAD + "        self.seen = 0\n    def decide(self, observation):\n        self.seen += 1\n"
        "        return Target(10.0 + self.seen, 'more')\n",
        "mine:Mine",
        ["annotate", "replay"],
    ),
    "no plain state": (
        HEAD + "        self.seen = set()\n    seen: set\n    def decide(self, observation):\n"
        "        return Target(10.0, 'more')\n",
        "mine:Mine",
        ["TypeError", "set"],
    ),
    "numbers of 64 bits": (
        "import numpy as np\n" + HEAD + "        self.seen = np.zeros(2, np.int64)\n    seen: np.ndarray\n"
        "    def decide(self, observation):\n        return Target(10.0, 'more')\n",
        "mine:Mine",
        ["int64", "uint8, int16, float32, float64"],
    ),
}


@pytest.mark.parametrize(("source", "point", "words"), UNFIT.values(), ids=UNFIT)
def test_what_cannot_be_used_is_refused_in_a_sentence_when_it_is_asked_for(
    source: str, point: str, words: list[str], tmp_path: Path, within: Within
) -> None:
    file = tmp_path / "rig.yaml"
    file.write_text(RIG % "mine")
    with with_packages(installed(tmp_path / "site", "my-package", "mine", source, {"mine": point})) as said:
        refusal = within.refused("config", "check", str(file))
        for word in ["control.policy", "policy mine of my-package cannot be used", *words]:
            assert word in refusal
        assert len(said) == 1 and said[0] in refusal
        assert "mine" not in policy_ids()
        check_policy_id("belief")  # nothing else suffers


@pytest.mark.parametrize("name", ["belief", "fisher-map", "all", "Mine", "a,b"])
def test_a_name_that_is_taken_or_cannot_be_written_is_refused(name: str, tmp_path: Path) -> None:
    source = HEAD + "    def decide(self, observation):\n        return Target(10.0, 'still')\n"
    with with_packages(installed(tmp_path / "site", "my-package", "mine", source, {name: "mine:Mine"})) as said:
        assert len(said) == 1 and f"policy {name} of my-package" in said[0]
        assert name == "belief" or name not in policy_ids()


def test_two_packages_with_one_name_are_both_refused(tmp_path: Path) -> None:
    source = HEAD + "    def decide(self, observation):\n        return Target(10.0, 'still')\n"
    folders = [installed(tmp_path / each, each, each, source, {"mine": f"{each}:Mine"}) for each in ("one", "two")]
    with with_packages(*folders), pytest.raises(ConfigurationError, match="one and two"):
        check_policy_id("mine")
