"""A script of faults: what it may say, and where what is wrong in it stands."""

from __future__ import annotations

from pathlib import Path

import pytest

from hapsim.bringup.faults import KINDS, load_script, parse_script
from hapsim.errors import UsageError
from hapsim.scene.shipped import shipped_script, shipped_scripts

ALL = ", ".join([*KINDS][:-1]) + f" or {[*KINDS][-1]}"


def errors_of(text: str) -> list[str]:
    with pytest.raises(UsageError) as caught:
        parse_script(text, "s.yaml")
    return str(caught.value).splitlines()


def test_every_error_is_reported_with_its_place() -> None:
    text = """\
version: 1
faults:
  - {kind: drp}
  - {knd: drop}
  - {kind: drop, probability: 2, directin: both}
  - {kind: leap, at: 1}
  - 7
  - {kind: nonsense, what: nan}
  - {kind: silence, at: 1, for: 1, for_samples: 3}
  - {kind: nonsense, register: channels, what: nan}
  - {kind: unplug}
  - {kind: drop, from: 1, after_samples: 2}
  - {kind: unplug, at: 1, after_samples: 2}
  - {kind: garbage, bytes: 1, every: 1, every_samples: 2}
  - {kind: leap, at: 1, metres: 1, counts: 1}
"""
    assert errors_of(text) == [
        f"s.yaml:3:12: kind: found 'drp' (text), expected {ALL}; did you mean 'drop'?",
        f"s.yaml:4:5: faults[1]: 'kind' is missing, expected {ALL}; is 'knd' meant to be 'kind'?",
        "s.yaml:5:31: probability: found 2, expected a number from 0 to 1 (1)",
        "s.yaml:5:34: directin: unknown key, expected kind, from, for, after_samples, for_samples, direction or "
        "probability; did you mean 'direction'?",
        "s.yaml:6:5: faults[3]: found neither metres nor counts, expected one of them",
        "s.yaml:7:5: faults[4]: found 7, expected a mapping such as {kind: drop, probability: 0.001}",
        "s.yaml:8:5: faults[5]: 'register' is missing, expected rate, position_scale, force_scale, force_limit, "
        "velocity_scale, channels, pacings, max_watchdog or schema",
        "s.yaml:9:5: faults[6]: found both for and for_samples, expected one of them",
        "s.yaml:10:5: faults[7]: found nan, expected zero, negative or huge of channels: it is a whole number, "
        "and none of them is nan",
        "s.yaml:11:5: faults[8]: found neither at nor after_samples, expected one of them",
        "s.yaml:12:5: faults[9]: found both from and after_samples, expected one of them",
        "s.yaml:13:5: faults[10]: found both at and after_samples, expected one of them",
        "s.yaml:14:5: faults[11]: found both every and every_samples, expected one of them",
        "s.yaml:15:5: faults[12]: found both metres and counts, expected one of them",
    ]


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("", "1:1: found nothing, expected a script: version and faults"),
        ("version: 2\nfaults: [{kind: drop}]", "1:10: version: found 2, expected 1: this hapsim reads version 1 of"),
        ("version: 1\nfaults: []", "2:9: faults: found an empty list, expected a list of faults, at least one"),
        ("version: 1\nfaults: drop", "2:9: faults: found 'drop' (text), expected a list of faults, at least one"),
        ("version: 1", "1:1: 'faults' is missing, expected a list of faults, at least one"),
        ("7", "1:1: found 7, expected a mapping with version and faults"),
        ("version: 1\nfaults: [{kind: drop}\n", "2:9: found [ without its ]; add it"),
        ("version: 1\nseed: -1\nfaults: [{kind: drop}]", "2:7: seed: found -1, expected a whole number from 0"),
        ("version: 1\nfaults: [{kind: delay}]", "2:10: faults[0]: 'seconds' is missing, expected a number > 0 (s)"),
    ],
)
def test_what_is_no_script_is_reported(text: str, error: str) -> None:
    (line,) = errors_of(text)
    assert error in line


def test_numbers_may_have_units() -> None:
    plain = "version: 1\nfaults:\n  - {kind: silence, at: 0.005, for: 0.1}\n  - {kind: leap, at: 1, metres: 0.002}\n"
    plain += "  - {kind: leap, at: 1, counts: 30}\n  - {kind: unplug, after_samples: 500}\n"
    written = plain
    for number, quantity in (("0.005", "5 ms"), ("0.1", "100 ms"), ("0.002", "2 mm"), ("30", "30 counts")):
        written = written.replace(f": {number}", f": {quantity}")
    assert parse_script(written.replace("500", "500 samples")).model_dump() == parse_script(plain).model_dump()
    assert errors_of(plain.replace("500", "500 ms").replace("0.1", "2 mm").replace("30", "3 s")) == [
        "s.yaml:3:37: for: found 2 mm, expected a time (s), such as 0.005 s or 5 ms",
        "s.yaml:5:33: counts: found 3 s, expected a number of counts (counts), such as 100 counts",
        "s.yaml:6:35: after_samples: found 500 ms, expected a number of samples (samples), such as 100 samples",
    ]


def test_a_file_that_is_not_there_is_reported_with_the_nearest_name(tmp_path: Path) -> None:
    (tmp_path / "noise.yaml").write_text("version: 1\nfaults: [{kind: drop}]\n")
    assert load_script(tmp_path / "noise.yaml").faults[0].kind == "drop"
    with pytest.raises(
        UsageError, match=r"no such file, expected a script of faults in YAML; did you mean 'noise.yaml'"
    ):
        load_script(tmp_path / "nois.yaml")


def test_the_scripts_that_ship_are_scripts_and_every_one_is_described_where_scenes_are() -> None:
    assert shipped_scripts() == ["bad_device", "loose_plug", "noisy_wire"]
    manual = (Path(__file__).parents[2] / "configs" / "faults" / "README.md").read_text("utf-8")
    for name in shipped_scripts():
        assert len(parse_script(shipped_script(name), name).faults) >= 3
        assert f"`{name}`" in manual
    assert [kind for kind in KINDS if f"`{kind}`" not in manual] == []
