"""At most one mutant in ten of those asked for may go unnoticed."""

from __future__ import annotations

import pytest

from tools.judge_mutants import judge


@pytest.mark.parametrize(
    ("fates", "wrong"),
    [
        (["killed"] * 18 + ["timeout", "survived"], False),
        (["killed"] * 9 + ["survived"], False),
        (["killed"] * 8 + ["survived"], True),
        (["killed"] * 8 + ["no tests"], True),
    ],
)
def test_more_than_one_in_ten_is_wrong(fates: list[str], wrong: bool, capsys: pytest.CaptureFixture[str]) -> None:
    results = [f"    imaging.pixels.x_bits__mutmut_{number}: {fate}\n" for number, fate in enumerate(fates)]
    complaint = judge([*results, "    imaging.response.x_at__mutmut_1: survived\n"], ["imaging.pixels.*"])
    assert (complaint is not None) == wrong
    printed = capsys.readouterr().out
    assert f"imaging.pixels.x_bits__mutmut_{len(fates) - 1}" in printed
    assert "imaging.response" not in printed
