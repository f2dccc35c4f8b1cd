from __future__ import annotations

from pathlib import Path

import pytest

from calibration.document import CameraIdentity, Finding
from calibration.gain import GainFile
from imaging.errors import ConfigurationError
from imaging.gain_scale import GainScale
from tests.calibration.test_commands import calibrate

SCALE = GainScale("GainRaw", (0.0, 10.0, 20.0), (0.0, 1.5, 6.0))
MINIMUM = "format: autoexpose-gain/1\nnode: GainRaw\n"


def test_what_is_saved_is_loaded(tmp_path: Path) -> None:
    path = tmp_path / "left.gain.yaml"
    finding = Finding("warned", "light_changed", "one gain measured twice differs by 0.20 dB")
    identity = CameraIdentity("Maker", "Model 7", "0012")
    GainFile(SCALE, 0.05, camera=identity, tool="t", findings=(finding,)).save(path)
    loaded = GainFile.load(path)
    assert (loaded.scale, loaded.error_db, loaded.findings, loaded.path) == (SCALE, 0.05, (finding,), path)
    loaded.check_belongs("0012")
    with pytest.raises(ConfigurationError, match=r"camera.serial is 0012, but this is camera X: .*calibrate gain"):
        loaded.check_belongs("X")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "begin with 'format: autoexpose-gain/1'"),
        ("format: autoexpose-gain/2", "only 'autoexpose-gain/1' can be read"),
        (MINIMUM + "gains_db: [0.0, 1.0]", "the key 'settings' is missing"),
        (MINIMUM + "settings: [0.0, x]\ngains_db: [0.0, 1.0]", "give two or more numbers that rise"),
        (MINIMUM + "settings: [0.0]\ngains_db: [0.0]", "give two or more numbers that rise"),
        (MINIMUM + "settings: [0.0, 1.0, 2.0]\ngains_db: [0.0, 1.0]", "3 settings for 2 gains_db"),
        (MINIMUM + "settings: [0.0, 0.0]\ngains_db: [0.0, 1.0]", "settings must rise"),
        (MINIMUM + "settings: [0.0, 1.0]\ngains_db: [1.0, 0.0]", "gains_db must rise"),
        (MINIMUM + "settings: [0.0, 1.0]\ngains_db: [0.0, 0.0]", "gains_db must rise"),
        (MINIMUM + "settings: [0.0, 1.0]\ngains_db: [0.0, .inf]", "give two or more numbers that rise"),
        (
            MINIMUM + "settings: [0, 1, 2]\ngains_db: [0, 1, 1.0e+308]",
            "gains_db[2] is 1e+308: give two or more",
        ),
        (MINIMUM + "settings: [0, 1, 2]\ngains_db: [0, 1, 101]", "-60 to 100 dB"),
        (MINIMUM + "settings: [0, 1.0e+300]\ngains_db: [0, 1]", "settings[1] is 1e+300: give two or more numbers"),
        (MINIMUM + "settings: [0.0, 1.0]\ngains_db: [0, 1]\nerror_db: 1.0e+9", "is 1000000000.0: give 0 to 100 dB"),
        (MINIMUM + "settings: [0.0, 1.0]\ngains_db: [0, 1]\nerror_db: -1", "error_db is -1: give 0 to 100 dB"),
        (MINIMUM + "settings: [0.0, 1.0]\ngains_db: [0.0, 1.0]\nlaw: cubic", "unknown key 'law'"),
    ],
)
def test_what_is_no_gain_file_is_refused_in_one_sentence(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "left.gain.yaml"
    path.write_text(text)
    with pytest.raises(ConfigurationError) as refused:
        GainFile.load(path)
    assert str(path) in str(refused.value)
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("gain -o out.yaml", "one of --camera and --config"),
        ("gain --camera A --camera A -o rig", "left and right are the same camera, A"),
        ("gain --camera A -o missing/out.yaml", "out.yaml: cannot be written"),
        ("gain --camera A -o other.yaml", "not a gain file to replace"),
        ("gain --camera NO-SUCH -o out.yaml", "NO-SUCH"),
    ],
)
def test_what_cannot_be_measured_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: str, words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("other.yaml").write_text("cameras: {}")
    code, output = calibrate(*arguments.split())
    assert code == 1
    assert words in output
    assert "\n" not in output.strip()
