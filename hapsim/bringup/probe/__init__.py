"""Judging a device against PROTOCOL.md, in the order in which its firmware is brought up."""

from hapsim.bringup.probe.checks import CHECKS, STEPS, Check, Leave
from hapsim.bringup.probe.judge import Judgement, judge, probe, steps_of

__all__ = ["CHECKS", "STEPS", "Check", "Judgement", "Leave", "judge", "probe", "steps_of"]
