"""Judging a device against PROTOCOL.md, in the order in which its firmware is brought up."""

from hapsim.probe.checks import CHECKS, STEPS, Check
from hapsim.probe.judge import Judgement, judge, probe, steps_of
from hapsim.probe.probing import Leave

__all__ = ["CHECKS", "STEPS", "Check", "Judgement", "Leave", "judge", "probe", "steps_of"]
