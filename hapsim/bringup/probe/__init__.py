"""Judging a device against PROTOCOL.md, in the order in which its firmware is brought up."""

from hapsim.bringup.probe.checks import CHECKS, STEPS, Check, Leave
from hapsim.bringup.probe.judge import Judgement, judge, open_wire, steps_of

__all__ = ["CHECKS", "STEPS", "Check", "Judgement", "Leave", "judge", "open_wire", "steps_of"]
