"""Each piece of advice is given where it applies, and nowhere else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hapsim.doctor.advice import Advice, Situation, advice_on
from hapsim.doctor.machine import Load, Machine, SystemFiles
from hapsim.loop.realtime import PrivilegeResult

SOUND = Machine("P", 4, 4, "6.12", True, ("performance",), "tsc", "", False, "")
FTDI = "/sys/bus/usb-serial/devices/ttyUSB0/latency_timer"
SWAP = "MemTotal: 8000000 kB\nSwapTotal: 4000000 kB\nSwapFree: {0} kB\n"


@pytest.fixture
def case(tree: Callable[..., SystemFiles]) -> Callable[..., Situation]:
    """A machine on which all is well, but for what is given; `files` are added to its tree."""

    def make(files: dict[str, str] | None = None, machine: dict[str, Any] | None = None, **known: Any) -> Situation:
        sound: dict[str, Any] = {"grants": [], "worst_wakeup_s": 5e-5, "load": Load(0.1, 0.0, 0.5)}
        return Situation(tree=tree(files), machine=replace(SOUND, **(machine or {})), **sound | known)

    return make


def only(case: Situation) -> Advice:
    """The one piece of advice that there is, which is whole."""
    (advice,) = advice_on(case)
    assert advice.found.endswith(".")
    assert advice.why.endswith(".")
    assert advice.do.endswith(":" if advice.commands else ".")
    return advice


def test_a_sound_machine_gets_no_advice(case: Callable[..., Situation]) -> None:
    assert advice_on(case()) == []


def test_a_machine_that_tells_nothing_gets_no_advice(tree: Callable[..., SystemFiles]) -> None:
    unknown = Machine("", None, None, "", False, (), "", "", None, "")
    assert advice_on(Situation(tree(), unknown, port="/dev/ttyACM0")) == []


@pytest.mark.parametrize("load", [Load(1.0, 0.0, None), Load(0.0, 0.0, 4.5), Load(3.0, 0.0, 5.0)])
def test_a_busy_machine_is_said_to_be_busy(case: Callable[..., Situation], load: Load) -> None:
    assert "The figures are of a busy machine" in only(case(load=load)).why


def test_what_a_load_means_depends_on_the_cores(case: Callable[..., Situation]) -> None:
    load = Load(0.6, 0.0, 3.5)
    assert advice_on(case(load=load)) == []
    assert "0.6 of 2 cores" in only(case(load=load, machine={"cores_online": 2})).found


def test_a_port_that_may_not_be_opened(case: Callable[..., Situation]) -> None:
    asked: list[Path] = []

    def may_open(path: Path) -> bool:
        asked.append(path)
        return False

    denied = case({"/dev/ttyUSB0": ""}, port="/dev/ttyUSB0", may_open=may_open)
    assert only(denied).commands == ("sudo usermod -aG dialout $USER",)
    assert asked == [denied.tree.root / "dev/ttyUSB0"]
    assert advice_on(replace(denied, may_open=lambda _: True)) == []
    assert advice_on(replace(denied, port="/dev/ttyUSB1")) == []  # that it is not there, the run says


@pytest.mark.parametrize(
    ("latency", "told"), [("16\n", True), ("2\n", True), ("1\n", False), ("", False), ("?", False)]
)
def test_an_ftdi_converter_that_gathers_bytes(case: Callable[..., Situation], latency: str, told: bool) -> None:
    gathering = case({FTDI: latency}, port="/dev/ttyUSB0")
    if not told:
        assert advice_on(gathering) == []
        return
    advice = only(gathering)
    assert f"up to {latency.strip()} ms" in advice.found
    assert advice.commands == (f"echo 1 | sudo tee {FTDI}",)
    assert advice_on(replace(gathering, port="/dev/ttyUSB1")) == []


def test_a_converter_is_found_behind_a_link(case: Callable[..., Situation]) -> None:
    gathering = case({FTDI: "16\n", "/dev/ttyUSB0": ""}, port="/dev/serial/by-id/usb-FTDI", may_open=lambda _: True)
    links = gathering.tree.root / "dev/serial/by-id"
    links.mkdir(parents=True)
    (links / "usb-FTDI").symlink_to("../../ttyUSB0")
    assert "ttyUSB0/latency_timer" in only(gathering).commands[0]


def test_modem_manager_matters_to_a_port_that_it_probes(case: Callable[..., Situation]) -> None:
    running = {"/proc/17/comm": "ModemManager\n", "/proc/18/comm": "bash\n"}
    assert only(case(running, port="/dev/ttyACM0")).commands == ("sudo systemctl disable --now ModemManager",)
    assert advice_on(case(running, port="/dev/ttyUSB0")) == []
    assert advice_on(case(running)) == []


def test_modem_manager_that_does_not_run_does_not_matter(case: Callable[..., Situation]) -> None:
    assert advice_on(case({"/proc/18/comm": "bash\n"}, port="/dev/ttyACM0")) == []


def test_what_was_denied_is_reported_with_what_it_takes(case: Callable[..., Situation]) -> None:
    grants = [PrivilegeResult("SCHED_FIFO", False, "it takes a limit"), PrivilegeResult("memory locked", True, "90 MB")]
    advice = only(case(grants=grants))
    assert advice.found == "Not granted: SCHED_FIFO."
    assert advice.do == "SCHED_FIFO: it takes a limit."
    assert advice_on(case(grants=grants[1:])) == []


def test_real_time_is_advised_where_it_was_not_asked_for_and_is_needed(case: Callable[..., Situation]) -> None:
    assert advice_on(case(grants=None)) == []
    assert only(case(grants=None, keeps_up=False)).commands == ("hapsim doctor --realtime",)
    assert only(case(grants=None, worst_wakeup_s=2e-3)).commands == ("hapsim doctor --realtime",)
    of_mine = case(grants=None, keeps_up=False, again="hapsim doctor mine.yaml")
    assert only(of_mine).commands == ("hapsim doctor mine.yaml --realtime",)


def test_a_governor_other_than_performance(case: Callable[..., Situation]) -> None:
    assert "the governor powersave." in only(case(machine={"governors": ("performance", "powersave")})).found
    assert advice_on(case(machine={"governors": ()})) == []


@pytest.mark.parametrize(
    ("source", "told"), [("tsc", False), ("arch_sys_counter", False), ("", False), ("hpet", True), ("acpi_pm", True)]
)
def test_a_clock_that_is_slow_to_read(case: Callable[..., Situation], source: str, told: bool) -> None:
    assert [source in advice.found for advice in advice_on(case(machine={"clock_source": source}))] == [True] * told


def test_a_single_core(case: Callable[..., Situation]) -> None:
    assert only(case(machine={"cores_allowed": 1})).commands == ("taskset -cp $$",)
    assert only(case(machine={"cores_allowed": 1, "cores_online": 1})).commands == ()


@pytest.mark.parametrize(
    ("group", "file"), [("0::/\n", "/sys/fs/cgroup/cpu.max"), ("1:x:/\n0::/a/b\n", "/sys/fs/cgroup/a/b/cpu.max")]
)
def test_a_container_that_is_held_back(case: Callable[..., Situation], group: str, file: str) -> None:
    held = case({"/proc/self/cgroup": group, file: "50000 100000\n"})
    assert "50 ms of processor time in every 100 ms" in only(held).found
    assert advice_on(case({file: "max 100000\n"})) == []


def test_memory_in_swap_matters_unless_it_is_locked(case: Callable[..., Situation]) -> None:
    swapping = case({"/proc/meminfo": SWAP.format(3_897_600)})
    assert "100 MB" in only(swapping).found
    assert advice_on(replace(swapping, grants=[PrivilegeResult("memory locked", True, "")])) == []
    assert advice_on(case({"/proc/meminfo": SWAP.format(4_000_000)})) == []


def test_another_kernel_is_advised_only_where_wake_ups_are_late(case: Callable[..., Situation]) -> None:
    assert "2 ms late" in only(case(machine={"preempt_rt": False}, worst_wakeup_s=2e-3)).found
    assert advice_on(case(machine={"preempt_rt": False})) == []
    assert advice_on(case(machine={"preempt_rt": True}, worst_wakeup_s=2e-3)) == []


def test_a_virtual_machine_is_reported_where_it_shows(case: Callable[..., Situation]) -> None:
    guest = case(machine={"virtual": "QEMU"})
    assert advice_on(guest) == []
    assert "QEMU" in only(replace(guest, worst_wakeup_s=2e-3)).found
    assert "took 3.0 %" in only(replace(guest, load=Load(0.0, 0.03, None))).found
    assert advice_on(case(load=Load(0.0, 0.03, None))) == []
